"""Inner loops that look for readings that stand still."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from surge_core.types import FloatArray, IntArray

__all__ = ["count_moved", "find_runs", "tally_codes", "tally_steps"]


@as_written
def tally_steps(values: FloatArray, counts: IntArray, ends: FloatArray) -> int:
    """Count the steps of a channel by size, as codes make them, and note its ends.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Some rows of the channel behind one that has been counted before, or behind the first.
    counts : ndarray of int64
        Where the number of steps of 0, 1, 2, … is added up.
    ends : ndarray of shape (3,)
        Least and largest reading so far, and the least step that is one but no such number.

    Returns
    -------
    int
        Steps that are no whole number, or larger than ``counts`` has room for.
    """
    others = 0
    low, high, least = ends[0], ends[1], ends[2]
    before = values[0]
    for row in range(1, values.size):
        value = values[row]
        low = value if value < low else low
        high = value if value > high else high
        step = abs(value - before)
        before = value
        whole = int(step) if step < counts.size else 0
        if step == whole:
            counts[whole] += 1
        else:
            others += 1
            least = step if step < least else least
    ends[0], ends[1], ends[2] = low, high, least
    return others


@as_written
def tally_codes(values: NDArray[np.uint16], counts: IntArray) -> None:
    """Count the steps of a channel by size, as :func:`tally_steps`, where it is stored as codes.

    Parameters
    ----------
    values : ndarray of uint16, shape (n,)
        Some rows of the channel behind one that has been counted before, or behind the first.
    counts : ndarray of int64, shape (2, 65536)
        Where the number of steps of 0, 1, 2, … is added up; steps into odd and even rows apart,
        since what is counted twice in a row waits for itself.
    """
    n = values.size - 1
    before, after = values[:n], values[1:]
    for row in range(n):
        counts[row & 1, abs(np.int64(after[row]) - np.int64(before[row]))] += 1


@as_written
def find_runs(
    values: NDArray[Any],
    first: int,
    n_rows: int,
    least_rows: int,
    carried: IntArray,
    jump: FloatArray,
    runs: IntArray,
    jumps: FloatArray,
) -> int:
    """Find the runs of equal values that end before a row of a channel, or at its end.

    Parameters
    ----------
    values : ndarray of shape (m,)
        Rows of the channel from ``first`` on, up to the row where the search stops; the next
        search begins there, with ``least_rows`` rows before it or more.
    first : int
        Row of the first of them.
    n_rows : int
        Rows of the whole channel.
    least_rows : int
        Shortest run that counts, two rows or more.
    carried : ndarray of int64, shape (2,)
        The row to look at next, and where the run begins that it may continue, or -1. At first
        ``(least_rows - 1, -1)``.
    jump : ndarray of shape (1,)
        The step into the run that may be continued.
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
    row, start, before = carried[0] - first, carried[1], jump[0]
    stop = values.size
    found = 0
    while True:
        if start < 0:
            while row < stop and values[row] != values[row - 1]:
                row += stride
            if row >= stop:
                break
            begin = row - 1
            while begin > 0 and values[begin - 1] == values[begin]:
                begin -= 1
            start = begin + first
            before = abs(float(values[begin]) - float(values[begin - 1])) if start > 0 else np.inf
        while row < stop and values[row] == values[row - 1]:
            row += 1
        if row == stop and first + stop < n_rows:
            break
        if row + first - start >= least_rows:
            behind = abs(float(values[row]) - float(values[row - 1])) if row < stop else np.inf
            runs[found, 0], runs[found, 1] = start, row + first
            jumps[found] = min(before, behind)
            found += 1
        # The next run begins in this row at the earliest.
        row += stride - (row + first) % stride
        start = -1
    carried[0], carried[1], jump[0] = row + first, start, before
    return found


@as_written
def count_moved(
    values: FloatArray, first: int, runs: IntArray, more_than: float, moved: IntArray
) -> None:
    """Add 1 for each run of rows during which a channel moves by more than so much.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Rows of the channel from ``first`` on, those of all runs among them.
    first : int
        Row of the first of them.
    runs : ndarray of int64, shape (m, 2)
        First rows, and rows behind the last.
    more_than : float
        Largest less least value must be above it.
    moved : ndarray of int64, shape (m,)
        What is added to.
    """
    for run in range(runs.shape[0]):
        low, high = np.inf, -np.inf
        for row in range(runs[run, 0] - first, runs[run, 1] - first):
            low = min(low, values[row])
            high = max(high, values[row])
            if high - low > more_than:
                moved[run] += 1
                break
