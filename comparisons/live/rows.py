"""Lines of text into rows in the order of their clock, cut where the record has a gap."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

END_LINE = b"#end"
# So many rows that follow one another, but not on what was had: the record has a gap. Fewer may be
# a row whose clock was garbled.
ROWS_TO_BELIEVE = 16

# Clock and line of a row; what is missing before rows, empty where they follow on, and their lines.
Row = tuple[float, bytes]
Run = tuple[str, list[bytes]]


class Lines:
    """Decode the lines of one connection; ``clock`` names the column with the clock."""

    def __init__(self, clock: str, refused: Counter[str]) -> None:
        self._clock = clock
        self._refused = refused
        self._separator = b","
        self._place = 0
        self._n_lines = 0
        self.names: list[str] = []  # Of the columns
        # The first line, and the second where it is no row of numbers; empty before they have come.
        self.header = self.units = b""
        self.ended = False  # Whether the end of the run was announced

    def take(self, lines: Iterable[bytes]) -> list[Row]:
        """Return the rows among the next lines of the connection, each with its clock."""
        rows = []
        for line in map(bytes.strip, lines):
            if self.ended or not line:
                continue
            if line.startswith(b"#"):
                self.ended = line == END_LINE
                continue
            self._n_lines += 1
            if self._n_lines == 1:
                self._begin(line)
            elif (row := self._row(line)) is not None:
                rows.append(row)
            elif self._n_lines == 2 and line.count(self._separator) == len(self.names) - 1:
                self.units = line
            else:
                self._refused["a line that is no row of numbers"] += 1
        return rows

    def _begin(self, line: bytes) -> None:
        self.header = line
        text = line.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
        # As the reader of files chooses it.
        separator = max((",", ";", "\t"), key=text.count)
        cells = next(csv.reader([text], delimiter=separator), [])
        self.names = [name.strip() for name in cells]
        self._separator = separator.encode()
        self._place = self.names.index(self._clock) if self._clock in self.names else 0

    def _row(self, line: bytes) -> Row | None:
        cells = line.split(self._separator)
        # Python takes 1_000 for a number.
        if len(cells) != len(self.names) or b"_" in line:
            return None
        try:
            values = [float(cell.replace(b",", b".")) for cell in cells]
        except ValueError:
            return None
        return (values[self._place], line) if all(map(math.isfinite, values)) else None


class RowOrder:
    """Drop rows that were had, and cut the record where rows are missing.

    The sample period is that of the first rows, in whatever unit their clock is. Rows that fit
    nowhere are counted in ``refused``; in ``repeated`` those whose clock was had already, as after
    a connection that was lost.
    """

    def __init__(self, refused: Counter[str]) -> None:
        self._refused = refused
        self._period = math.nan
        self._last = -math.inf
        self._waiting: list[Row] = []
        self.repeated = 0

    def take(self, rows: Sequence[Row]) -> list[Run]:
        """Return those of the rows, and of those that wait, that are in order by now."""
        if math.isnan(self._period):
            rows = [*self._waiting, *rows]
            self._waiting = []
            if len(rows) < ROWS_TO_BELIEVE:
                self._waiting = list(rows)
                return []
            self._period = float(np.median(np.diff([clock for clock, _ in rows])))
        runs: list[Run] = []
        for clock, line in rows:
            if self._follows(clock, self._last):
                self.close()
                if not runs:
                    runs.append(("", []))
                runs[-1][1].append(line)
                self._last = clock
            elif clock <= self._last:
                self.repeated += 1
            elif self._waiting and self._follows(clock, self._waiting[-1][0]):
                self._waiting.append((clock, line))
                if len(self._waiting) == ROWS_TO_BELIEVE:
                    runs.append(self._behind_a_gap())
            else:
                self.close()
                self._waiting = [(clock, line)]
        return runs

    def close(self) -> None:
        """Give up rows that fit nowhere."""
        if self._waiting:
            self._refused["a row whose clock fits nowhere"] += len(self._waiting)
            self._waiting = []

    def _follows(self, clock: float, before: float) -> bool:
        # To the nearest sample; whether the clock is even enough is for the reader to judge.
        return self._period > 0.0 and abs((clock - before) / self._period - 1.0) < 0.5

    def _behind_a_gap(self) -> Run:
        begins, gap = self._waiting[0][0], ""
        if math.isfinite(self._last):
            missing = round((begins - self._last) / self._period) - 1
            count = "1 row is" if missing == 1 else f"{missing} rows are"
            gap = f"{count} missing before the clock {begins:.10g}"
        self._last = self._waiting[-1][0]
        lines = [line for _, line in self._waiting]
        self._waiting = []
        return gap, lines
