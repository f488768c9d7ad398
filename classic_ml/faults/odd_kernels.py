"""Inner loops of the search for single wrong readings and for rows cut out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from surge_core.types import FloatArray, IntArray

__all__ = ["jumping_rows", "off_neighbours", "standing_out"]


@as_written
def off_neighbours(values: FloatArray, off: FloatArray) -> None:
    """Write how far each reading is off the median of itself and two on either side.

    Parameters
    ----------
    values : ndarray of shape (n_channels, n)
        The readings, four or more of each.
    off : ndarray of shape (n_channels, n)
        Takes the result; 0 in the first and the last two rows.
    """
    n = values.shape[1] - 4
    for channel in range(values.shape[0]):
        v, o = values[channel], off[channel]
        o[:2] = 0.0
        o[n + 2 :] = 0.0
        # Shifted views, since no loop is vectorised over an index that may be below zero.
        a, b, c, d, e, out = v[:n], v[1:], v[2:], v[3:], v[4:], o[2:]
        for r in range(n):
            # The least and the largest of the four are on either side of the median of all five.
            low = max(min(a[r], b[r]), min(d[r], e[r]))
            high = min(max(a[r], b[r]), max(d[r], e[r]))
            # Of the two in the middle of four, either may be the larger.
            lower, upper = min(low, high), max(low, high)
            out[r] = abs(c[r] - max(lower, min(upper, c[r])))


@as_written
def _outdoes(off: FloatArray, row: int, reach: int, gap: int, least: float, limit: float) -> bool:
    """Tell whether a value is above a multiple of ``reach`` before and behind, from a gap on."""
    largest = least
    for k in range(gap, gap + reach):
        largest = max(largest, off[row - k], off[row + k])
        # It can but become less.
        if not off[row] / largest > limit:
            return False
    return True


@as_written
def standing_out(
    off: FloatArray,
    channel: int,
    rows: IntArray,
    marked: NDArray[np.bool_],
    reach: int,
    gap: int,
    least: float,
    limits: tuple[float, float, float],
) -> None:
    """Mark values far above those around them in one channel, where no other shows the same.

    Parameters
    ----------
    off : ndarray of shape (n_channels, n)
        From :func:`off_neighbours`, of channels that see the same.
    channel : int
        The channel to be looked at.
    rows : ndarray of int
        Its rows to be looked at.
    marked : ndarray of bool, shape (n,)
        False; takes the marks.
    reach, gap : int
        What a value is compared with: so many before and behind it, so far away.
    least : float
        What it is compared with at least.
    limits : tuple of float
        Ratio to those around it, beyond which a value stands out; ratio and share of it, beyond
        which another channel shows it too.
    """
    ratio_limit, quiet_ratio, seen_share = limits
    o, n = off[channel], off.shape[1]
    # Of another channel two rows more are looked at, and two at the ends are off by nothing.
    margin = reach + gap + 3
    for row in rows:
        if row < margin or row >= n - margin:
            continue
        # On a steep slope the rows beside a spike stand out a little too.
        beside = max(o[row - 2], o[row - 1], o[row], o[row + 1], o[row + 2])
        if not o[row] > 0.5 * beside or not _outdoes(o, row, reach, gap, least, ratio_limit):
            continue
        seen = False
        for other in range(off.shape[0]):
            for at in range(row - 2, row + 3):
                if other == channel or seen or not off[other, at] > seen_share * o[row]:
                    continue
                seen = _outdoes(off[other], at, reach, gap, least, quiet_ratio)
        marked[row] = not seen


@as_written
def jumping_rows(
    values: FloatArray,
    quiet: NDArray[np.uint16],
    reach: int,
    gap: int,
    least: float,
    fewest: int,
    limit: float,
) -> None:
    """Count the channels that do not step by more than around, as far as that decides.

    Parameters
    ----------
    values : ndarray of shape (n_channels, n)
        The readings.
    quiet : ndarray of uint16, shape (n - 1,)
        Takes the counts, of the step behind each row: ``fewest`` or less where no more channels
        than that are quiet. The first and the last ``reach + gap + 1`` steps count as quiet.
    reach, gap : int
        As for :func:`standing_out`.
    least : float
        What a step is compared with at least.
    fewest : int
        How many channels need not jump.
    limit : float
        Ratio to the steps around.
    """
    n = quiet.size - 2 * gap
    quiet[:] = 0
    inner = quiet[gap:]
    for channel in range(values.shape[0]):
        v = values[channel]
        # Most steps are outdone by the next ones: only the others are looked at all around.
        before, at, behind = v, v[gap:], v[2 * gap :]
        before_1, at_1, behind_1 = v[1:], v[gap + 1 :], v[2 * gap + 1 :]
        for r in range(n):
            near = max(least, abs(before_1[r] - before[r]), abs(behind_1[r] - behind[r]))
            inner[r] += 0 if abs(at_1[r] - at[r]) / near > limit else 1
    margin = reach + gap + 1
    for row in range(quiet.size):
        if row < margin or row >= quiet.size - margin:
            quiet[row] = fewest + 1
        elif quiet[row] <= fewest:
            quiet[row] = _quiet_around(values, row, reach, gap, least, fewest, limit)


@as_written
def _quiet_around(
    values: FloatArray, row: int, reach: int, gap: int, least: float, fewest: int, limit: float
) -> int:
    """Return how many channels do not step by more than around a row, or one more than few."""
    quiet = 0
    for channel in range(values.shape[0]):
        v = values[channel]
        largest = least
        for k in range(gap, gap + reach):
            before, behind = abs(v[row - k + 1] - v[row - k]), abs(v[row + k + 1] - v[row + k])
            largest = max(largest, before, behind)
        quiet += 0 if abs(v[row + 1] - v[row]) / largest > limit else 1
        if quiet > fewest:
            break
    return quiet
