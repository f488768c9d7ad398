"""The clock of a file of channels: which column it is, and its gaps, repeats and steps back."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from classic_ml.readers.passed_over_clock import CLOCK_NAMES
from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.test_description import FileLayout
from classic_ml.units import Conversion, time_conversion
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ClockFacts", "ClockTally", "clock_tally"]

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


def clock_tally(
    stored: RawFile, block: FloatArray, layout: FileLayout, *, named: bool
) -> ClockTally | None:
    """Return a tally for the column that is the clock, with its usual step.

    Parameters
    ----------
    stored : RawFile
        The file as it is.
    block : ndarray of shape (n_rows, n_columns)
        Its first rows, which the usual step is taken from.
    layout : FileLayout
        Which column is the clock, and its unit.
    named : bool
        Whether the layout is test.toml's: then no other column is looked for.

    Returns
    -------
    ClockTally or None
        None where no column looks like a clock.
    """
    column = _clock_column(stored, block, layout, named=named)
    if column is None:
        return None
    name = stored.names[column]
    unit = (layout.time_unit if name == layout.time else None) or stored.units.get(name, "") or "s"
    try:
        conversion = time_conversion(unit, name)
    except InputError:
        conversion, unit = Conversion(), "s"
    steps = np.diff(conversion.to_si(block[:, column]))
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    usual = float(np.median(steps)) if steps.size else np.nan
    about = stored.stamps.get(name, stored.clock if name == layout.time else "")
    return ClockTally(column, name, unit, about, conversion, usual)


def _clock_column(
    stored: RawFile, block: FloatArray, layout: FileLayout, *, named: bool
) -> int | None:
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
    for number in range(len(stored.names)):
        steps = np.diff(block[:, number])
        # A clock rises, and by the same step nearly always.
        if steps.size > 1 and np.all(steps > 0.0):
            usual = float(np.median(steps))
            if np.mean(np.abs(steps - usual) < 0.5 * usual) > 0.99:
                return number
    return None


@dataclass
class ClockTally:
    """What is kept of the clock from chunk to chunk.

    Parameters
    ----------
    column : int
        Its number.
    name, unit, about : str
        As of :class:`ClockFacts`.
    conversion : Conversion
        From its unit to s.
    usual_s : float
        Its usual step, in s; NaN where no step is known.
    first_s, last_s : float
        Its first and last time so far.
    good_steps : int
        Steps that are neither gaps nor back.
    good_time_s : float
        What they amount to.
    jitter : float
        The largest deviation of these from the usual step, in steps.
    counts, firsts : dict of str to int
        How often there was a ``"gap"``, ``"repeat"`` or ``"step_back"``, and the row after the
        first of them, counted from 1.
    """

    column: int
    name: str
    unit: str
    about: str
    conversion: Conversion
    usual_s: float
    first_s: float = np.nan
    last_s: float = np.nan
    good_steps: int = 0
    good_time_s: float = 0.0
    jitter: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    firsts: dict[str, int] = field(default_factory=dict)

    def add(self, values: FloatArray, first_row: int) -> None:
        """Take the next rows into account.

        Parameters
        ----------
        values : ndarray of shape (n_rows,)
            Readings of the clock, in its unit.
        first_row : int
            Rows before them.
        """
        time_s = self.conversion.to_si(values)
        rows = first_row + 1 + np.flatnonzero(np.isfinite(time_s))
        time_s = time_s[np.isfinite(time_s)]
        if time_s.size == 0:
            return
        if np.isnan(self.first_s):
            self.first_s = float(time_s[0])
        else:
            time_s = np.concatenate(([self.last_s], time_s))
            rows = np.concatenate(([first_row], rows))
        self.last_s = float(time_s[-1])
        steps = np.diff(time_s)
        kinds = {
            "gap": steps > GAP_STEPS * self.usual_s,
            "repeat": steps == 0.0,
            "step_back": steps < 0.0,
        }
        good = ~(kinds["gap"] | kinds["repeat"] | kinds["step_back"])
        self.good_steps += int(np.count_nonzero(good))
        self.good_time_s += float(np.sum(steps[good]))
        if good.any():
            off = np.max(np.abs(steps[good] - self.usual_s)) / self.usual_s
            self.jitter = max(self.jitter, float(off))
        for kind, where in kinds.items():
            count = int(np.count_nonzero(where))
            self.counts[kind] = self.counts.get(kind, 0) + count
            if count and kind not in self.firsts:
                self.firsts[kind] = int(rows[1:][np.argmax(where)])

    def facts(self) -> ClockFacts:
        """Return what was found."""
        return ClockFacts(
            self.name,
            self.unit,
            self.about,
            self.first_s,
            self.last_s,
            self.good_steps / self.good_time_s if self.good_time_s > 0.0 else np.nan,
            self.jitter,
            self.counts.get("gap", 0),
            self.counts.get("repeat", 0),
            self.counts.get("step_back", 0),
            self.firsts.get("gap"),
            self.firsts.get("repeat"),
            self.firsts.get("step_back"),
        )
