"""The one test of a uniform clock, shared by raw records and series files."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["CLOCK_TOLERANCE", "uniform_period_s"]

# A clock printed with few digits jitters by one digit, which is 0.12 of a step for 0.1 ms at
# 1234.5 Hz; a clock that jitters more has not told when its rows were taken.
CLOCK_TOLERANCE = 0.15
# Steps this near the median one count for the mean: wide, since the median is itself rounded.
NEAR_MEDIAN = 0.45


def uniform_period_s(time_s: FloatArray, where: str, *, workspace: Workspace = IN_MEMORY) -> float:
    """Return the step of a uniform clock, or refuse the clock.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Clock of each row, in seconds; at least two rows, all finite.
    where : str
        What to call the clock in an error, e.g. ``"run.csv: column time_s"``.
    workspace : Workspace
        Where the clock lies.

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
    # Where no step is further than this from the mean one, none is further from the median either
    # than NEAR_MEDIAN allows, so that the mean of the steps near the median is the mean of all.
    for rows, clock in _pieces(time_s, workspace):
        off = np.abs(np.diff(clock) - mean_s) > CLOCK_TOLERANCE * mean_s
        line = time_s[0] + np.arange(rows.start, rows.stop) * mean_s
        off |= np.abs(clock - line)[1:] > CLOCK_TOLERANCE * mean_s
        if mean_s <= 0.0 or off.any():
            raise _refusal(time_s, where, workspace)
    return mean_s


def _pieces(time_s: FloatArray, workspace: Workspace) -> Iterator[tuple[slice, FloatArray]]:
    """Yield the clock block by block, each with the first row of the next."""
    for block in blocks(time_s.size - 1):
        rows = slice(block.start, block.stop + 1)
        yield rows, time_s[rows]
        workspace.release()


def _refusal(time_s: FloatArray, where: str, workspace: Workspace) -> InputError:
    """Say what is wrong with a clock, by the step that most of its rows have."""
    from classic_ml.columns.order_statistics import mean, median

    for rows, clock in _pieces(time_s, workspace):
        back = np.flatnonzero(np.diff(clock) <= 0.0)
        if back.size:
            row = int(back[0])
            kind = "repeats" if clock[row + 1] == clock[row] else "runs back"
            return InputError(
                where,
                expected="a clock that runs forward",
                found=f"that it {kind} at row {rows.start + row + 2} ({clock[row + 1]:g} s)",
            )

    def steps() -> Iterator[FloatArray]:
        return (np.diff(clock) for _, clock in _pieces(time_s, workspace))

    # The median step of a rounded clock is itself rounded; the mean of the steps near it is not.
    middle = median(steps)

    def near_the_median() -> Iterator[FloatArray]:
        return (s[np.abs(s - middle) < NEAR_MEDIAN * middle] for s in steps())

    # Between two steps that are each half of all there is none.
    some = any(near.size for near in near_the_median())
    period = mean(near_the_median if some else steps)
    row = _first_off(time_s, period, workspace)
    step, before = time_s[row + 1] - time_s[row], time_s[row]
    return InputError(
        where,
        expected=f"a uniform step (here {period:g} s)",
        found=f"a step of {step:g} s after {before:g} s (row {row + 1})",
        remedy="fill the gap at the source or write one file a record",
    )


def _first_off(time_s: FloatArray, period: float, workspace: Workspace) -> int:
    """Return the row before the first step that is off, else before the first off the line."""
    for rows, clock in _pieces(time_s, workspace):
        off = np.flatnonzero(np.abs(np.diff(clock) - period) > CLOCK_TOLERANCE * period)
        if off.size:
            return int(rows.start + off[0])
    mean_s = float((time_s[-1] - time_s[0]) / (time_s.size - 1))
    for rows, clock in _pieces(time_s, workspace):
        line = time_s[0] + np.arange(rows.start, rows.stop) * mean_s
        off = np.flatnonzero(np.abs(clock - line)[1:] > CLOCK_TOLERANCE * period)
        if off.size:
            return int(rows.start + off[0])
    return 0
