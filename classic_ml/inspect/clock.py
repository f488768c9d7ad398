"""The clock of a file of channels: which column it is, and its gaps, repeats and steps back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.raw import CLOCK_NAMES
from classic_ml.io.table import Columns, RawFile
from classic_ml.units import Conversion, time_conversion
from surge_core.errors import InputError
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
        What it is where it is no column of times.
    first_s, last_s : float
        Its ends.
    rate_hz : float
        Rows a second, over the steps that are neither gaps nor back; NaN without any.
    jitter : float
        The largest deviation of these from the usual step, in steps.
    gaps, repeats, steps_back : int
        How often it jumps, stands still and runs back.
    first_gap, first_repeat, first_step_back : int or None
        The row after the first of them, counted from 1.
    """

    name: str
    unit: str
    about: str
    first_s: float
    last_s: float
    rate_hz: float
    jitter: float
    gaps: int
    repeats: int
    steps_back: int
    first_gap: int | None
    first_repeat: int | None
    first_step_back: int | None


def clock_column(stored: RawFile, block: Columns, layout: FileLayout, *, named: bool) -> int | None:
    """Return which column is the clock; None where none looks like one.

    Parameters
    ----------
    stored : RawFile
        The file as it is.
    block : tuple of ndarray of shape (n_rows,)
        Its first rows, in which a clock without a known name is looked for.
    layout : FileLayout
        Which column is the clock.
    named : bool
        Whether the layout is test.toml's: then no other column is looked for.
    """
    if layout.time in stored.names:
        return stored.names.index(layout.time)
    if named:
        return None
    folded = [name.strip().lower() for name in stored.names]
    for name in CLOCK_NAMES:
        if name in folded:
            return folded.index(name)
    if stored.stamps:
        return stored.names.index(next(iter(stored.stamps)))
    for number, values in enumerate(block):
        steps = np.diff(values.astype(np.float64))
        # A clock rises, and by the same step nearly always.
        if steps.size > 1 and np.all(steps > 0.0):
            usual = float(np.median(steps))
            if np.mean(np.abs(steps - usual) < 0.5 * usual) > 0.99:
                return number
    return None


class ClockTally:
    """What is found of the clock from block to block.

    Parameters
    ----------
    stored : RawFile
        The file.
    column : int
        Which of its columns is the clock.
    layout : FileLayout
        Its unit, where test.toml says it.
    """

    def __init__(self, stored: RawFile, column: int, layout: FileLayout) -> None:
        name = stored.names[column]
        stated = (layout.time_unit if name == layout.time else None) or stored.units.get(name, "")
        self.name, self.unit, self._conversion = name, stated or "s", Conversion()
        self._about = stored.stamps.get(name, stored.clock if name == layout.time else "")
        try:
            self._conversion = time_conversion(self.unit, name)
        except InputError:
            self.unit = "s"
        self.usual_s = self._first_s = self._last_s = np.nan
        self._good_steps, self._good_time_s, self._jitter = 0, 0.0, 0.0
        self._counts, self._firsts = dict[str, int](), dict[str, int]()

    def add(self, values: FloatArray, first_row: int) -> FloatArray:
        """Take the next rows into account, and return their times in s.

        Parameters
        ----------
        values : ndarray of shape (n_rows,)
            Readings of the clock, in its unit.
        first_row : int
            Rows before them.
        """
        read_s = self._conversion.to_si(values)
        rows = first_row + 1 + np.flatnonzero(np.isfinite(read_s))
        time_s = read_s[np.isfinite(read_s)]
        if time_s.size == 0:
            return read_s
        if np.isnan(self._first_s):
            self._first_s = float(time_s[0])
            forward = np.diff(time_s)
            forward = forward[forward > 0.0]
            self.usual_s = float(np.median(forward)) if forward.size else np.nan
        else:
            time_s = np.concatenate(([self._last_s], time_s))
            rows = np.concatenate(([first_row], rows))
        self._last_s = float(time_s[-1])
        steps = np.diff(time_s)
        kinds = {
            "gap": steps > GAP_STEPS * self.usual_s,
            "repeat": steps == 0.0,
            "step_back": steps < 0.0,
        }
        good = steps[~(kinds["gap"] | kinds["repeat"] | kinds["step_back"])]
        self._good_steps += good.size
        self._good_time_s += float(np.sum(good))
        if good.size:
            off = float(np.max(np.abs(good - self.usual_s))) / self.usual_s
            self._jitter = max(self._jitter, off)
        for kind, where in kinds.items():
            self._counts[kind] = self._counts.get(kind, 0) + int(np.count_nonzero(where))
            if where.any():
                self._firsts.setdefault(kind, int(rows[1:][np.argmax(where)]))
        return read_s

    def facts(self) -> ClockFacts:
        """Return what was found."""
        return ClockFacts(
            self.name,
            self.unit,
            self._about,
            self._first_s,
            self._last_s,
            self._good_steps / self._good_time_s if self._good_time_s > 0.0 else np.nan,
            self._jitter,
            self._counts.get("gap", 0),
            self._counts.get("repeat", 0),
            self._counts.get("step_back", 0),
            self._firsts.get("gap"),
            self._firsts.get("repeat"),
            self._firsts.get("step_back"),
        )
