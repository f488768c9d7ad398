"""Inner loops of the search for single wrong readings and for rows cut out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.records import FloatArray

__all__ = ["jumping_rows", "off_neighbours", "standing_out"]


@as_written
def off_neighbours(values: FloatArray, off: FloatArray) -> None:
    """Write how far each reading is off the median of itself and two on either side.

    Parameters
    ----------
    values : ndarray of shape (n_channels, n)
        The readings.
    off : ndarray of shape (n_channels, n)
        Takes the result; 0 in the first and the last two rows.
    """
    n = values.shape[1]
    for channel in range(values.shape[0]):
        v, o = values[channel], off[channel]
        o[:2] = 0.0
        o[n - 2 :] = 0.0
        for r in range(2, n - 2):
            # The least and the largest of the four are on either side of the median of all five.
            low = max(min(v[r - 2], v[r - 1]), min(v[r + 1], v[r + 2]))
            high = min(max(v[r - 2], v[r - 1]), max(v[r + 1], v[r + 2]))
            # Of the two in the middle of four, either may be the larger.
            lower, upper = min(low, high), max(low, high)
            o[r] = abs(v[r] - max(lower, min(upper, v[r])))


@as_written
def _ratio(off: FloatArray, row: int, reach: int, gap: int, least: float) -> float:
    """Return a value over the largest of ``reach`` before and behind it, ``gap`` away and more."""
    largest = least
    for k in range(gap, gap + reach):
        largest = max(largest, off[row - k], off[row + k])
    ratio: float = off[row] / largest
    return ratio


@as_written
def standing_out(
    off: FloatArray,
    marked: NDArray[np.bool_],
    reach: int,
    gap: int,
    share: float,
    limits: tuple[float, float, float],
) -> None:
    """Mark values far above those around them in one channel, where no other shows the same.

    Parameters
    ----------
    off : ndarray of shape (n_channels, n)
        From :func:`off_neighbours`, of channels that see the same.
    marked : ndarray of bool, shape (n_channels, n)
        False; takes the marks.
    reach, gap : int
        What a value is compared with: so many before and behind it, so far away.
    share : float
        A value below this never stands out.
    limits : tuple of float
        Ratio to those around it, beyond which a value stands out; ratio and share of it, beyond
        which another channel shows it too.
    """
    ratio_limit, quiet_ratio, seen_share = limits
    channels, n = off.shape
    # Of another channel two rows more are looked at, and two at the ends are off by nothing.
    margin = reach + gap + 3
    least = 0.1 * share
    for channel in range(channels):
        o = off[channel]
        for row in range(margin, n - margin):
            if not o[row] > share:
                continue
            # On a steep slope the rows beside a spike stand out a little too.
            beside = max(o[row - 2], o[row - 1], o[row], o[row + 1], o[row + 2])
            if not o[row] > 0.5 * beside or not _ratio(o, row, reach, gap, least) > ratio_limit:
                continue
            seen = False
            for other in range(channels):
                for at in range(row - 2, row + 3):
                    if other == channel or seen or not off[other, at] > seen_share * o[row]:
                        continue
                    seen = _ratio(off[other], at, reach, gap, least) > quiet_ratio
            marked[channel, row] = not seen


@as_written
def jumping_rows(
    steps: FloatArray,
    jumps: NDArray[np.bool_],
    reach: int,
    gap: int,
    least: float,
    fewest: int,
    limit: float,
) -> None:
    """Mark the rows in which all but ``fewest`` channels step by more than around.

    Parameters
    ----------
    steps : ndarray of shape (n_channels, n)
        Magnitude of the step behind each row.
    jumps : ndarray of bool, shape (n,)
        False; takes the marks.
    reach, gap : int
        As for :func:`standing_out`.
    least : float
        What a step is compared with at least.
    fewest : int
        How many channels need not jump.
    limit : float
        Ratio to the steps around.
    """
    channels, n = steps.shape
    margin = reach + gap + 1
    for row in range(margin, n - margin):
        quiet = 0
        for channel in range(channels):
            # Most steps are outdone by the next ones: only the others are looked at all around.
            near = max(least, steps[channel, row - gap], steps[channel, row + gap])
            if (
                not steps[channel, row] / near > limit
                or not _ratio(steps[channel], row, reach, gap, least) > limit
            ):
                quiet += 1
                if quiet > fewest:
                    break
        jumps[row] = quiet <= fewest
