"""Lines of text into rows in the order of their clock, cut where the record has a gap."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

__all__ = ["TEXT_FORMAT", "Lines", "RowOrder", "Run"]

# 2,000 columns of 30 characters: more than any test has, and nothing beside the memory.
LONGEST_LINE = 65_536
END_LINE = b"#end"
# What a finite number in plain decimal notation is made of; Python reads more ("1_0", "nan").
NUMBERS = b"0123456789+-.eE, \t"
# So many rows that follow one another, but not on what was had: the record has a gap, or its clock
# was set. Fewer may be a row whose clock was garbled.
ROWS_TO_BELIEVE = 16
# Rows whose clock was had already are repeats, as after a reconnection, but not for longer.
REPEATED_S = 10.0

TEXT_FORMAT = f"""\
The feed is lines of text, as `cat raw.csv` gives them. The first line of every connection holds the
names of the columns, the second one may hold their units, every further one a row of plain decimal
numbers, separated by commas. Lines end with a line feed and have at most {LONGEST_LINE:,} bytes.
Empty lines, and lines that begin with #, count for nothing, but for "{END_LINE.decode()}", which
ends the run."""

Row = tuple[float, bytes]


class Lines:
    """Decode the lines of one connection.

    Parameters
    ----------
    clock : str
        Name of the column with the clock.
    refused : Counter
        Where lines that are left out are counted, by reason.

    Attributes
    ----------
    header, units : bytes
        First line; second line where it is no row of numbers; empty before they have come.
    ended : bool
        Whether the end of the run was announced.
    """

    def __init__(self, clock: str, refused: Counter[str]) -> None:
        self._clock = clock
        self._refused = refused
        self._rest = b""
        self._n_lines = 0
        self._place: int | None = None
        self.header = self.units = b""
        self.ended = False

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        text = self.header.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
        return [name.strip().strip('"') for name in text.split(",")]

    def take(self, data: bytes) -> list[Row]:
        """Return the rows that are complete by now, each with its clock.

        Parameters
        ----------
        data : bytes
            The next bytes of the connection, cut anywhere.
        """
        if self.ended:
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            # What follows up to the next line feed is no row either.
            self._rest = self._rest[:LONGEST_LINE]
        rows = []
        for line in map(bytes.strip, lines):
            if line == END_LINE:
                self.ended = True
                break
            if line and not line.startswith(b"#") and line != self.header:
                row = self._line(line)
                if row is not None:
                    rows.append(row)
        return rows

    def close(self) -> None:
        """Count a line that the end of the connection cut off."""
        if self._rest.strip():
            self._refused["a line cut off by the end of the connection"] += 1
        self._rest = b""

    def _line(self, line: bytes) -> Row | None:
        self._n_lines += 1
        if self._n_lines == 1:
            self.header = line
            names = self.names
            self._place = names.index(self._clock) if self._clock in names else None
            return None
        row = self._row(line)
        if row is None and self._n_lines == 2 and line.count(b",") == self.header.count(b","):
            self.units = line
        elif row is None:
            self._refused["a line that is no row of numbers"] += 1
        return row

    def _row(self, line: bytes) -> Row | None:
        cells = line.split(b",")
        if len(cells) != self.header.count(b",") + 1 or line.translate(None, NUMBERS):
            return None
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            return None
        if not all(map(math.isfinite, values)):
            return None
        return (values[self._place] if self._place is not None else math.nan), line


@dataclass
class Run:
    """Rows that follow on what was had, or begin a new piece of the record.

    Parameters
    ----------
    why_new : str
        Why a new piece begins with them; empty where they follow on.
    lines : list of bytes
        The rows.
    begins : bool
        Whether they begin a piece.
    """

    why_new: str = ""
    lines: list[bytes] = field(default_factory=list)
    begins: bool = False


class RowOrder:
    """Drop rows that were had, and cut the record where rows are missing.

    The sample period is that of the first rows, in whatever unit their clock is.

    Parameters
    ----------
    rate_hz : float
        Sample rate of the test.
    refused : Counter
        Where rows that fit nowhere are counted.
    """

    def __init__(self, rate_hz: float, refused: Counter[str]) -> None:
        self._rate_hz = rate_hz
        self._refused = refused
        self._period: float | None = None
        self._first = self._last = math.nan
        self._pending: list[Row] = []
        self.repeated = 0

    def take(self, rows: Iterable[Row]) -> list[Run]:
        """Return the rows that are in order by now.

        Parameters
        ----------
        rows : iterable of tuple of float and bytes
            Clock and line of each, as they came.
        """
        if self._period is None:
            self._pending += rows
            if len(self._pending) < ROWS_TO_BELIEVE:
                return []
            rows, self._pending = self._pending, []
            self._period = max(float(np.median(np.diff([clock for clock, _ in rows]))), 0.0)
        runs: list[Run] = []
        for row in rows:
            if self._follows(row[0], self._last):
                self._give_up()
                if not runs:
                    runs.append(Run())
                runs[-1].lines.append(row[1])
                self._last = row[0]
            elif self._pending and self._follows(row[0], self._pending[-1][0]):
                self._pending.append(row)
                if len(self._pending) >= self._needed():
                    runs.append(self._new_piece())
            else:
                self._give_up()
                self._pending = [row]
        return runs

    def close(self) -> list[Run]:
        """Return what still waited when the feed ended."""
        first = math.isnan(self._last)
        # One row alone proves nothing: its clock may be garbled.
        if self._pending and (first or (len(self._pending) > 1 and not self._was_had())):
            return [self._new_piece()]
        self._give_up()
        return []

    def _follows(self, clock: float, before: float) -> bool:
        if self._period is None or self._period == 0.0:
            return False
        # To the nearest sample; whether the clock is even enough is for the reader to judge.
        return abs((clock - before) / self._period - 1.0) < 0.5

    def _was_had(self) -> bool:
        return self._first <= self._pending[0][0] <= self._last

    def _needed(self) -> float:
        return REPEATED_S * self._rate_hz if self._was_had() else ROWS_TO_BELIEVE

    def _give_up(self) -> None:
        if self._pending and self._was_had():
            self.repeated += len(self._pending)
        elif self._pending:
            self._refused["a row whose clock fits nowhere"] += len(self._pending)
        self._pending = []

    def _new_piece(self) -> Run:
        begins = self._pending[0][0]
        why = ""
        # NaN before the first piece.
        if begins > self._last:
            missing = round((begins - self._last) / (self._period or 1.0)) - 1
            count = "1 row is" if missing == 1 else f"{missing} rows are"
            why = f"{count} missing before the clock {begins:.10g}"
        elif begins <= self._last:
            why = f"the clock was set back from {self._last:.10g} to {begins:.10g}"
        self._first, self._last = begins, self._pending[-1][0]
        run = Run(why, [line for _, line in self._pending], begins=True)
        self._pending = []
        return run
