"""The text format of a feed: a header, then one line of numbers a row, as in raw.csv."""

from __future__ import annotations

import numpy as np

from classic_ml.io.csv import row_of_units
from comparisons.live.rows import End, Header, Item, Rows, Tally, Units
from surge_core.types import FloatArray

__all__ = ["LONGEST_LINE", "TEXT_FORMAT", "TextDecoder"]

# 2,000 columns of 30 characters: more than any test has, and nothing beside the memory.
LONGEST_LINE = 65_536
END_LINE = b"#end"
# What a finite number in plain decimal notation is made of. Python reads more than that ("1_0",
# "nan", digits of other scripts), which the reader of raw files refuses.
_NUMBER = b"0123456789+-.eE"
_BLANK = b" \t\r"
_TOO_LONG = "a line longer than the limit"

TEXT_FORMAT = f"""\
csv: lines of text, as `cat raw.csv` gives them. The first line of every connection holds the names
of the columns, the second one may hold their units, every further one a row of plain decimal
numbers, separated by commas. Lines end with a line feed and have at most {LONGEST_LINE:,} bytes.
Empty lines, and lines that begin with #, count for nothing, but for "{END_LINE.decode()}", which
ends the run."""


class TextDecoder:
    """Decode lines of CSV.

    Parameters
    ----------
    tally : Tally
        Where refused lines are counted.
    """

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._rest = b""
        self._skipping = False
        self._header: bytes | None = None
        self._n_columns = 0
        self._below_header = False

    def feed(self, data: bytes) -> list[Item]:
        """Return what is complete by now.

        Parameters
        ----------
        data : bytes
            The next bytes of the connection, cut anywhere.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if lines and self._skipping:
            # The end of a line whose beginning was too long already.
            self._skipping = False
            del lines[0]
        if len(self._rest) > LONGEST_LINE:
            if not self._skipping:
                self._tally.refuse(_TOO_LONG)
            self._rest, self._skipping = b"", True
        items: list[Item] = []
        rows: list[bytes] = []
        for line in lines:
            stripped = line.strip()
            if not stripped or stripped == self._header:
                continue
            if len(line) > LONGEST_LINE:
                self._tally.refuse(_TOO_LONG)
                continue
            if stripped.startswith(b"#"):
                if stripped == END_LINE:
                    return [*items, *self._rows(rows), End()]
                continue
            if self._header is None:
                items += self._head(stripped)
                self._below_header = True
            else:
                units = self._units(stripped) if self._below_header else ()
                self._below_header = False
                if units:
                    items.append(Units(units, stripped))
                else:
                    rows.append(line)
        return [*items, *self._rows(rows)]

    def close(self) -> None:
        """Count a line that the end of the connection cut off."""
        if self._rest.strip() or self._skipping:
            self._tally.refuse("a line cut off by the end of the connection")
        self._rest, self._skipping = b"", False

    def _head(self, line: bytes) -> list[Item]:
        text = line.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="replace")
        self._header = line
        names = tuple(name.strip().strip('"') for name in text.split(","))
        self._n_columns = len(names)
        return [Header(names)]

    def _units(self, line: bytes) -> tuple[str, ...]:
        if _numbers([line], self._n_columns) is not None:
            return ()
        return row_of_units(line.decode("utf-8", "replace"), self._n_columns)

    def _rows(self, lines: list[bytes]) -> list[Item]:
        if not lines:
            return []
        values = _numbers(lines, self._n_columns)
        if values is None:
            good = []
            for line in lines:
                row = _numbers([line], self._n_columns)
                if row is None:
                    self._tally.refuse("a line that is no row of numbers")
                else:
                    good.append(Rows(row, (_tight(line),)))
            return [Rows.joined(good)] if good else []
        return [Rows(values, tuple(_tight(line) for line in lines))]


def _tight(line: bytes) -> bytes:
    return line.translate(None, _BLANK)


def _numbers(lines: list[bytes], n_columns: int) -> FloatArray | None:
    """Return the numbers of the lines, or None when one of them is no row of finite numbers."""
    commas = n_columns - 1
    text = b",".join(lines)
    if text.translate(None, _NUMBER + b"," + _BLANK):
        return None
    if any(line.count(b",") != commas for line in lines):
        return None
    try:
        values = np.array(list(map(float, text.split(b","))), dtype=np.float64)
    except ValueError:
        return None
    if not np.isfinite(values).all():
        return None
    return values.reshape(len(lines), n_columns)
