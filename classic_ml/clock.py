"""The one test of a uniform clock, shared by raw records and series files."""

from __future__ import annotations

import numpy as np

from classic_ml.errors import InputError
from classic_ml.records import FloatArray

__all__ = ["uniform_period_s"]

# A clock printed with few digits jitters by one digit, which is 0.12 of a step for 0.1 ms at
# 1234.5 Hz; a clock that jitters more has not told when its rows were taken.
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
    steps = np.diff(time_s)
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        kind = "repeats" if steps[back[0]] == 0.0 else "runs back"
        raise InputError(
            where,
            expected="a clock that runs forward",
            found=f"that it {kind} at row {back[0] + 2} ({time_s[back[0] + 1]:g} s)",
        )
    period = float(np.median(steps))
    # The median step of a rounded clock is itself rounded; the mean of the steps near it is not.
    period = float(np.mean(steps[np.abs(steps - period) < NEAR_MEDIAN * period]))
    off = np.flatnonzero(np.abs(steps - period) > CLOCK_TOLERANCE * period)
    mean_s = float((time_s[-1] - time_s[0]) / steps.size)
    if off.size == 0:
        line = time_s[0] + np.arange(time_s.size) * mean_s
        off = np.flatnonzero(np.abs(time_s - line)[1:] > CLOCK_TOLERANCE * period)
    if off.size:
        raise InputError(
            where,
            expected=f"a uniform step (here {period:g} s)",
            found=f"a step of {steps[off[0]]:g} s after {time_s[off[0]]:g} s",
            remedy="fill the gap at the source or write one file a record",
        )
    return mean_s
