"""The one test of a uniform clock, shared by raw records and series files."""

from __future__ import annotations

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray

# A clock printed with few digits jitters by one digit, which is 0.12 of a step for 0.1 ms at
# 1234.5 Hz; a clock that jitters more does not say when its rows were taken.
CLOCK_TOLERANCE = 0.15


def uniform_period_s(time_s: FloatArray, where: str) -> float:
    """Return the mean step of a uniform clock, or refuse one that is called ``where``.

    It may not repeat, run back, have a gap or drift off its straight line by more than 0.15 of a
    step, nor may a step differ from the others by as much.
    """
    steps = np.diff(time_s)
    mean_s = float((time_s[-1] - time_s[0]) / steps.size)
    line = time_s[0] + np.arange(1, time_s.size) * mean_s
    off = (steps <= 0.0) | (np.abs(steps - mean_s) > CLOCK_TOLERANCE * mean_s)
    off |= np.abs(time_s[1:] - line) > CLOCK_TOLERANCE * mean_s
    if not off.any():
        return mean_s
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        kind = "repeats" if steps[row - 1] == 0.0 else "runs back"
        raise InputError(
            where,
            expected="a clock that runs forward",
            found=f"that it {kind} at row {row + 1} ({time_s[row]:g} s)",
        )
    # A gap moves the mean: what is off is judged by the step that most rows have.
    usual_s = float(np.median(steps))
    worst = np.flatnonzero(np.abs(steps - usual_s) > CLOCK_TOLERANCE * usual_s)
    row = int(worst[0]) if worst.size else int(np.argmax(off))
    raise InputError(
        where,
        expected=f"a uniform step (here {usual_s:g} s)",
        found=f"a step of {steps[row]:g} s after {time_s[row]:g} s (row {row + 1})",
        remedy="fill the gap at the source or write one file a record",
    )
