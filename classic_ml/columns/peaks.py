"""Peaks of a signal that may be larger than memory, with what they rise above their surroundings.

They are those of ``scipy.signal.find_peaks`` with a prominence, which walks from each peak to both
sides until the signal is higher: without an end to it where all peaks are alike. Here one pass
keeps the peaks that nothing higher has followed so far.
"""

from __future__ import annotations

import numpy as np

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks
from surge_core.types import FloatArray, IntArray

__all__ = ["prominent_peaks"]


# What the pass remembers between two blocks, in whole numbers: open peaks, peaks found, whether
# the signal rises (1), falls (0) or has not moved yet (-1), first row of its present value.
N_OPEN, N_FOUND, RISING, SINCE = range(4)
# And in numbers: its present value, and the least one since the last peak.
LEVEL, VALLEY = range(2)
# Of each open peak: its height, the least value to its left as far as nothing is higher, and the
# least value between it and the next open one.
HEIGHT, LEFT, GAP = range(3)


def prominent_peaks(
    values: FloatArray, least: float, start: int = 0, *, workspace: Workspace = IN_MEMORY
) -> tuple[IntArray, FloatArray]:
    """Return the peaks of a signal that stand out by so much, and by how much they do.

    A peak's prominence is its height above the higher of the two least values to its left and
    right, each as far as the signal is not higher than the peak.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal, finite.
    least : float
        Least prominence.
    start : int
        Row with which the signal begins; what is before does not count.
    workspace : Workspace
        Where the signal lies.

    Returns
    -------
    rows : ndarray of int, shape (m,)
        Row of each peak, the middle one of equal values.
    prominence : ndarray of shape (m,)
        Their prominences.
    """
    if start >= values.size:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    counts = np.array([0, 0, -1, start])
    levels = np.array([values[start], values[start]])
    open_rows, open_levels = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    rows: list[IntArray] = []
    prominences: list[FloatArray] = []
    for block in blocks(values.size, start):
        n_peaks = (block.stop - block.start) // 2 + 1
        open_rows, open_levels = _with_room(open_rows, open_levels, counts[N_OPEN] + n_peaks)
        found_rows = np.empty(counts[N_OPEN] + n_peaks, dtype=np.int64)
        found = np.empty(found_rows.size)
        counts[N_FOUND] = 0
        _pass(
            values[block],
            block.start,
            least,
            counts,
            levels,
            open_rows,
            open_levels,
            found_rows,
            found,
        )
        if block.stop == values.size:
            _close(least, counts, levels, open_rows, open_levels, found_rows, found)
        rows.append(found_rows[: counts[N_FOUND]].copy())
        prominences.append(found[: counts[N_FOUND]].copy())
        workspace.release()
    all_rows, all_prominences = np.concatenate(rows), np.concatenate(prominences)
    order = np.argsort(all_rows)
    return all_rows[order], all_prominences[order]


def _with_room(rows: IntArray, levels: FloatArray, room: int) -> tuple[IntArray, FloatArray]:
    if room <= rows.size:
        return rows, levels
    more = 2 * room - rows.size
    return np.pad(rows, (0, more)), np.pad(levels, ((0, more), (0, 0)))


@as_written
def _pass(
    values: FloatArray,
    first_row: int,
    least: float,
    counts: IntArray,
    levels: FloatArray,
    open_rows: IntArray,
    open_levels: FloatArray,
    found_rows: IntArray,
    found: FloatArray,
) -> None:
    """Go through one block; a peak is a value that was risen to and is fallen from."""
    for k in range(values.size):
        value = values[k]
        level = levels[LEVEL]
        if value == level:
            continue
        if value > level:
            levels[VALLEY] = min(levels[VALLEY], level)
            counts[RISING] = 1
        else:
            if counts[RISING] == 1:
                row = (counts[SINCE] + first_row + k - 1) // 2
                _add(level, row, least, counts, levels, open_rows, open_levels, found_rows, found)
            counts[RISING] = 0
        levels[LEVEL] = value
        counts[SINCE] = first_row + k


@as_written
def _add(
    height: float,
    row: int,
    least: float,
    counts: IntArray,
    levels: FloatArray,
    open_rows: IntArray,
    open_levels: FloatArray,
    found_rows: IntArray,
    found: FloatArray,
) -> None:
    """Close the open peaks that are lower than a new one, and open that."""
    lowest = levels[VALLEY]
    top = counts[N_OPEN] - 1
    while top >= 0 and open_levels[top, HEIGHT] < height:
        _tell(top, lowest, least, counts, open_rows, open_levels, found_rows, found)
        beyond = open_levels[top - 1, GAP] if top > 0 else open_levels[top, LEFT]
        lowest = min(lowest, beyond)
        top -= 1
    left = lowest
    if top >= 0:
        open_levels[top, GAP] = lowest
        if open_levels[top, HEIGHT] == height:
            left = min(lowest, open_levels[top, LEFT])
    top += 1
    open_rows[top] = row
    open_levels[top, HEIGHT] = height
    open_levels[top, LEFT] = left
    counts[N_OPEN] = top + 1
    levels[VALLEY] = height


@as_written
def _close(
    least: float,
    counts: IntArray,
    levels: FloatArray,
    open_rows: IntArray,
    open_levels: FloatArray,
    found_rows: IntArray,
    found: FloatArray,
) -> None:
    """Close all peaks at the end of the signal."""
    lowest = min(levels[VALLEY], levels[LEVEL])
    for top in range(counts[N_OPEN] - 1, -1, -1):
        _tell(top, lowest, least, counts, open_rows, open_levels, found_rows, found)
        if top > 0:
            lowest = min(lowest, open_levels[top - 1, GAP])


@as_written
def _tell(
    top: int,
    right: float,
    least: float,
    counts: IntArray,
    open_rows: IntArray,
    open_levels: FloatArray,
    found_rows: IntArray,
    found: FloatArray,
) -> None:
    """Note a peak whose surroundings are known if it stands out."""
    prominence = open_levels[top, HEIGHT] - max(open_levels[top, LEFT], right)
    if prominence >= least:
        found_rows[counts[N_FOUND]] = open_rows[top]
        found[counts[N_FOUND]] = prominence
        counts[N_FOUND] += 1
