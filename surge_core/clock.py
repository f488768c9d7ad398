"""The one test of a uniform clock, shared by raw records and series files."""

from __future__ import annotations

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["CLOCK_TOLERANCE", "uniform_period_s"]

# A clock printed with few digits jitters by one digit, which is 0.12 of a step for 0.1 ms at
# 1234.5 Hz; a clock that jitters more does not show when its rows were taken.
CLOCK_TOLERANCE = 0.15
# Steps this near the median one count for the mean: wide, since the median is itself rounded.
NEAR_MEDIAN = 0.45


def uniform_period_s(time_s: FloatArray, where: str) -> float:
    """Return the step of a uniform clock, or refuse the clock.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Clock of each row, in seconds; at least two rows, all finite.
    where : str
        What to call the clock in an error, e.g. ``"run.csv: column time_s"``.

    Returns
    -------
    float
        The mean step, in seconds.

    Raises
    ------
    InputError
        When the clock repeats, runs back, has a gap or drifts off its straight line by more
        than 0.15 of a step, or a step differs from the others by as much.
    """
    mean_s = float((time_s[-1] - time_s[0]) / (time_s.size - 1))
    steps = np.diff(time_s)
    off_line = (time_s - (time_s[0] + np.arange(time_s.size) * mean_s))[1:]
    off = (np.abs(steps - mean_s) > CLOCK_TOLERANCE * mean_s) | (
        np.abs(off_line) > CLOCK_TOLERANCE * mean_s
    )
    if mean_s > 0.0 and not off.any():
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
    # The median step of a rounded clock is itself rounded; the mean of the steps near it is not.
    middle = float(np.median(steps))
    near = steps[np.abs(steps - middle) < NEAR_MEDIAN * middle]
    period = float(np.mean(near if near.size else steps))
    uneven = np.flatnonzero(np.abs(steps - period) > CLOCK_TOLERANCE * period)
    drifting = np.flatnonzero(np.abs(off_line) > CLOCK_TOLERANCE * period)
    row = int([*uneven[:1], *drifting[:1], 0][0])
    raise InputError(
        where,
        expected=f"a uniform step (here {period:g} s)",
        found=f"a step of {steps[row]:g} s after {time_s[row]:g} s (row {row + 1})",
        remedy="fill the gap at the source or write one file a record",
    )
