"""Rows by their clock: what was had already, what comes late, and where the record breaks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comparisons.live.rows import Rows, Tally
from surge_core.types import FloatArray

__all__ = ["RowOrder", "Stretch"]

# So many rows that follow one another, but not on what was had: the record has a gap, or its clock
# was set anew. Fewer may be rows out of order or a row whose clock was garbled.
ROWS_TO_BELIEVE = 16
# Rows that are known again when they are sent once more: a quarter of an hour at 1 kHz, 16 MB.
REMEMBERED_ROWS = 1_000_000


@dataclass(frozen=True)
class Stretch:
    """Rows that follow on what was had, or begin a new piece of the record.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Clock of the rows.
    rows : Rows
        The rows.
    why_new : str
        Why a new piece begins with them; empty where they follow on.
    """

    time_s: FloatArray
    rows: Rows
    why_new: str = ""


@dataclass
class _Memory:
    """Clock and content of the rows of a piece, the newest at the end."""

    time_s: FloatArray = field(default_factory=lambda: np.empty(1024))
    content: NDArray[np.int64] = field(default_factory=lambda: np.empty(1024, dtype=np.int64))
    n_rows: int = 0

    def add(self, time_s: FloatArray, rows: Rows) -> None:
        needed = self.n_rows + len(rows)
        if needed > REMEMBERED_ROWS:
            kept = max(0, REMEMBERED_ROWS // 2 - len(rows))
            old = slice(self.n_rows - kept, self.n_rows)
            self.time_s[:kept], self.content[:kept] = self.time_s[old], self.content[old]
            self.n_rows, needed = kept, kept + len(rows)
        if needed > self.time_s.size:
            size = 2 * needed
            self.time_s = np.resize(self.time_s, size)
            self.content = np.resize(self.content, size)
        new = slice(self.n_rows, needed)
        self.time_s[new], self.content[new] = time_s, _content(rows)
        self.n_rows = needed

    def holds(self, time_s: FloatArray, rows: Rows) -> NDArray[np.bool_]:
        """Tell which rows were had, to the last digit."""
        known = self.time_s[: self.n_rows]
        places = np.minimum(np.searchsorted(known, time_s), max(self.n_rows - 1, 0))
        if not self.n_rows:
            return np.zeros(len(rows), dtype=np.bool_)
        alike = known[places] == time_s
        return np.asarray(alike & (self.content[: self.n_rows][places] == _content(rows)))


def _content(rows: Rows) -> NDArray[np.int64]:
    return np.array([hash(line) for line in rows.lines], dtype=np.int64)


class RowOrder:
    """Put rows in order and cut the record where it has a gap.

    Parameters
    ----------
    rate_hz : float
        Sample rate of the test.
    tally : Tally
        Where rows that belong nowhere are counted.
    """

    def __init__(self, rate_hz: float, tally: Tally) -> None:
        self._rate_hz = rate_hz
        self._tally = tally
        self._memory = _Memory()
        self._last_s: float | None = None
        self._waiting: list[Stretch] = []
        self.repeated = 0
        self.late = 0

    def take(self, time_s: FloatArray, rows: Rows) -> list[Stretch]:
        """Return the rows that are in order by now.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clock of the rows, in seconds.
        rows : Rows
            As they came.
        """
        out: list[Stretch] = []
        new = ~self._memory.holds(time_s, rows)
        if not new.all():
            self.repeated += int(np.sum(~new))
            time_s, rows = time_s[new], rows.those(new)
        while len(rows):
            n = self._following(time_s)
            if n:
                out.append(self._placed(Stretch(time_s[:n], rows.part(slice(n)))))
                out += self._late_ones()
            else:
                n = 1
                out += self._set_aside(Stretch(time_s[:1], rows.part(slice(1))))
            time_s, rows = time_s[n:], rows.part(slice(n, None))
        return out

    def close(self) -> list[Stretch]:
        """Return what still waited when the feed ended."""
        waiting, self._waiting = self._by_clock(), []
        if not waiting:
            return []
        # One row alone tells nothing: its clock may be garbled.
        whole = len(waiting) > 1 and self._one_behind_another(waiting)
        if whole and (self._last_s is None or waiting[0].time_s[0] > self._last_s):
            return [self._new_piece(waiting)]
        self._tally.refuse(_NOWHERE, len(waiting))
        return []

    def _following(self, time_s: FloatArray) -> int:
        """Return how many rows from the first on follow one another and what was had."""
        before = time_s[0] - 1.0 / self._rate_hz if self._last_s is None else self._last_s
        steps = np.diff(time_s, prepend=before) * self._rate_hz
        # To the nearest sample; whether the clock is even enough is for the reader to judge.
        breaks = np.flatnonzero(np.abs(steps - 1.0) >= 0.5)
        return int(breaks[0]) if breaks.size else time_s.size

    def _placed(self, stretch: Stretch) -> Stretch:
        self._memory.add(stretch.time_s, stretch.rows)
        self._last_s = float(stretch.time_s[-1])
        return stretch

    def _late_ones(self) -> list[Stretch]:
        """Return waiting rows whose turn has come, and give up those whose turn has passed."""
        out: list[Stretch] = []
        for one in self._by_clock():
            if self._following(one.time_s):
                out.append(self._placed(one))
                self.late += 1
            elif self._last_s is not None and one.time_s[0] > self._last_s:
                continue
            elif self._memory.holds(one.time_s, one.rows)[0]:
                self.repeated += 1
            else:
                self._tally.refuse(_OTHER_VALUES)
            self._waiting.remove(one)
        return out

    def _set_aside(self, row: Stretch) -> list[Stretch]:
        if self._memory.holds(row.time_s, row.rows)[0]:
            self.repeated += 1
            return []
        self._waiting.append(row)
        if len(self._waiting) < ROWS_TO_BELIEVE:
            return []
        waiting = self._by_clock()
        if self._one_behind_another(waiting):
            self._waiting = []
            return [self._new_piece(waiting)]
        self._tally.refuse(_NOWHERE)
        del self._waiting[0]
        return []

    def _by_clock(self) -> list[Stretch]:
        return sorted(self._waiting, key=lambda one: float(one.time_s[0]))

    def _one_behind_another(self, waiting: list[Stretch]) -> bool:
        steps = np.diff([one.time_s[0] for one in waiting]) * self._rate_hz
        return bool(np.all(np.abs(steps - 1.0) < 0.5))

    def _new_piece(self, waiting: list[Stretch]) -> Stretch:
        time_s = np.concatenate([one.time_s for one in waiting])
        rows = Rows.joined([one.rows for one in waiting])
        if self._last_s is None or time_s[0] > self._last_s:
            missing = time_s[0] - (self._last_s or 0.0) - 1.0 / self._rate_hz
            why = f"{missing:.4g} s are missing before {time_s[0]:.4f} s"
        else:
            why = f"the clock was set back from {self._last_s:.4f} to {time_s[0]:.4f} s"
            # Times before the jump must not be taken for those behind it.
            self._memory = _Memory()
        return self._placed(Stretch(time_s, rows, why))


_NOWHERE = "a row whose clock fits nowhere"
_OTHER_VALUES = "a row with the clock of another one"
