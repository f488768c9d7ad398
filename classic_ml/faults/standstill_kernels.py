"""Inner loops that look for readings that stand still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.records import FloatArray

__all__ = ["count_moved", "count_steps", "find_runs", "least_step"]

IntArray = NDArray[np.int64]


@as_written
def count_steps(values: FloatArray, first: int, stop: int, counts: IntArray) -> int:
    """Count the steps into some rows of a channel, by size, as codes make them.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The whole channel.
    first, stop : int
        The rows; nothing steps into row 0.
    counts : ndarray of int64
        Where the number of steps of 0, 1, 2, … is added up.

    Returns
    -------
    int
        Steps that are no whole number, or larger than ``counts`` has room for.
    """
    others = 0
    for row in range(max(first, 1), stop):
        step = abs(values[row] - values[row - 1])
        if step < counts.size and step == int(step):
            counts[int(step)] += 1
        else:
            others += 1
    return others


@as_written
def least_step(values: FloatArray, first: int, stop: int) -> float:
    """Return the least step into some rows of a channel that is one; infinite without any."""
    least = np.inf
    for row in range(max(first, 1), stop):
        step = abs(values[row] - values[row - 1])
        step = step if step > 0.0 else np.inf
        least = step if step < least else least
    return least


@as_written
def find_runs(
    values: FloatArray,
    stop: int,
    least_rows: int,
    carried: IntArray,
    runs: IntArray,
    jumps: FloatArray,
) -> int:
    """Find the runs of equal values that end before a row of a channel, or at its end.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The whole channel.
    stop : int
        How far to search; the next search begins there.
    least_rows : int
        Shortest run that counts, two rows or more.
    carried : ndarray of int64, shape (2,)
        The row to look at next, and where the run begins that it may continue, or -1. At first
        ``(least_rows - 1, -1)``.
    runs : ndarray of int64, shape (m, 2)
        Where first rows, and rows behind the last, go.
    jumps : ndarray of shape (m,)
        Where the lesser of the steps at both ends of each goes; an end of the record has none
        and counts as infinite.

    Returns
    -------
    int
        How many there are.
    """
    # A run of five rows has four steps of zero, one of them into a row divisible by four.
    stride = least_rows - 1
    row, start = carried
    found = 0
    while True:
        if start < 0:
            while row < stop and values[row] != values[row - 1]:
                row += stride
            if row >= stop:
                break
            start = row - 1
            while start > 0 and values[start - 1] == values[start]:
                start -= 1
        while row < stop and values[row] == values[row - 1]:
            row += 1
        if row == stop and stop < values.size:
            break
        if row - start >= least_rows:
            before = abs(values[start] - values[start - 1]) if start > 0 else np.inf
            behind = abs(values[row] - values[row - 1]) if row < values.size else np.inf
            runs[found, 0], runs[found, 1] = start, row
            jumps[found] = min(before, behind)
            found += 1
        # The next run begins in this row at the earliest.
        row += stride - row % stride
        start = -1
    carried[0], carried[1] = row, start
    return found


@as_written
def count_moved(values: FloatArray, runs: IntArray, more_than: float, moved: IntArray) -> None:
    """Add 1 for each run of rows during which a channel moves by more than so much.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The whole channel.
    runs : ndarray of int64, shape (m, 2)
        First rows, and rows behind the last.
    more_than : float
        Largest less least value must be above it.
    moved : ndarray of int64, shape (m,)
        What is added to.
    """
    for run in range(runs.shape[0]):
        low, high = np.inf, -np.inf
        for row in range(runs[run, 0], runs[run, 1]):
            low = min(low, values[row])
            high = max(high, values[row])
            if high - low > more_than:
                moved[run] += 1
                break
