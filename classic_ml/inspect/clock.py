"""The clock of a file of channels: which column it is, and its gaps, repeats and steps back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.raw import CLOCK_NAMES
from classic_ml.io.table import StoredTable
from classic_ml.units import Conversion, conversion_to_si, kind_of_unit
from surge_core.types import FloatArray

__all__ = ["ClockFacts", "ClockTally", "clock_column"]

# A step this much longer than the usual one is a gap: 1.5 leaves room for any jitter below.
GAP_STEPS = 1.5


@dataclass(frozen=True)
class ClockFacts:
    """The column of times.

    Parameters
    ----------
    name : str
        Its name in the file.
    unit : str
        Its unit; ``"s"`` where the file states none.
    about : str
        What its seconds count from where it is a column of dates.
    first_s, last_s : float
        Its ends.
    rate_hz : float
        Rows a second, over the steps that are neither gaps nor back; NaN without any.
    jitter : float
        The largest deviation of these from the usual step, in steps.
    troubles : mapping of str to (int, int)
        How often there is a ``"gap"``, a ``"repeat"`` or a ``"step back"``, and the row after the
        first of them, counted from 1.
    """

    name: str
    unit: str
    about: str
    first_s: float
    last_s: float
    rate_hz: float
    jitter: float
    troubles: Mapping[str, tuple[int, int]]


def clock_column(
    stored: StoredTable, values: Mapping[str, FloatArray], layout: FileLayout, *, named: bool
) -> str | None:
    """Return which column is the clock; None where none looks like one.

    Parameters
    ----------
    stored : StoredTable
        The file as it is.
    values : mapping of str to ndarray of shape (n_rows,)
        Its first rows, in which a clock without a known name is looked for.
    layout : FileLayout
        Which column is the clock.
    named : bool
        Whether the layout is test.toml's: then no other column is looked for.
    """
    if layout.time in stored.names or named:
        return layout.time if layout.time in stored.names else None
    folded = {name.strip().lower(): name for name in stored.names}
    known = [folded[name] for name in CLOCK_NAMES if name in folded]
    rising = (name for name, column in values.items() if _rises_evenly(column))
    return next(iter((*known, *stored.dates, *rising)), None)


def _rises_evenly(values: FloatArray) -> bool:
    """Return whether a column rises, and by the same step nearly always."""
    steps = np.diff(values)
    if steps.size < 2 or not np.all(steps > 0.0):
        return False
    usual = float(np.median(steps))
    return bool(np.mean(np.abs(steps - usual) < 0.5 * usual) > 0.99)


class ClockTally:
    """What is found of the clock from block to block.

    Parameters
    ----------
    stored : StoredTable
        The file.
    name : str
        Which of its columns is the clock.
    layout : FileLayout
        Its unit, where test.toml says it.
    """

    def __init__(self, stored: StoredTable, name: str, layout: FileLayout) -> None:
        unit = (layout.time_unit if name == layout.time else None) or stored.unit(name)
        self.name, self.unit, self._conversion = name, "s", Conversion()
        if kind_of_unit(unit) == "time":
            self.unit, self._conversion = unit, conversion_to_si(unit, "time", name)
        self._about = stored.counts_from(name)
        self.usual_s = self._first_s = self._last_s = np.nan
        self._n_good, self._good_s, self._jitter = 0, 0.0, 0.0
        self._troubles: dict[str, tuple[int, int]] = {}

    def add(self, values: FloatArray, first_row: int) -> FloatArray:
        """Take the next rows into account, and return their times in s.

        Parameters
        ----------
        values : ndarray of shape (n_rows,)
            Readings of the clock, in its unit.
        first_row : int
            Rows before them.
        """
        time_s = self._conversion.to_si(values)
        # What is no number makes no step.
        steps = np.diff(time_s, prepend=self._last_s)
        self._last_s = float(time_s[-1])
        if first_row == 0:
            self._first_s = float(time_s[0])
            self.usual_s = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.nan
        is_gap = steps > GAP_STEPS * self.usual_s
        for kind, where in (("gap", is_gap), ("repeat", steps == 0.0), ("step back", steps < 0.0)):
            if where.any():
                n, first = self._troubles.get(kind, (0, first_row + int(np.argmax(where)) + 1))
                self._troubles[kind] = n + int(np.count_nonzero(where)), first
        good = steps[(steps > 0.0) & ~is_gap]
        self._n_good += good.size
        self._good_s += float(np.sum(good))
        off = np.abs(good - self.usual_s) / self.usual_s
        self._jitter = max(self._jitter, float(np.max(off, initial=0.0)))
        return time_s

    def facts(self) -> ClockFacts:
        """Return what was found."""
        rate_hz = self._n_good / self._good_s if self._good_s > 0.0 else np.nan
        ends_s = self._first_s, self._last_s
        return ClockFacts(
            self.name, self.unit, self._about, *ends_s, rate_hz, self._jitter, self._troubles
        )
