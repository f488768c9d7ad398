"""Single wrong readings: one or two rows far off those before and behind, in one channel alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from surge_core.types import FloatArray, IntArray

__all__ = ["spike_rows"]

# A spike is one row or two wide, and is compared with what its channel does for 25 rows on either
# side. On 52 records of the simulated rigs, stall cells and all, no reading stands out by more than
# 3.5 times that while the probes beside it are quiet; 0.01 of the range are 41 codes of 12 bits.
# One of 700 codes does so by more than 4 times in nearly all places at plane 31, and in three of
# four among the stall cells at plane 25, where those that pass move τ by less than its error.
REACH, GAP = 23, 3
RATIO, SHARE, QUIET_RATIO, SEEN_SHARE = 4.0, 0.01, 1.5, 0.1
LEAST = 0.1 * SHARE
# Rows at either end of a record that are not looked at.
MARGIN = REACH + GAP + 3


def spike_rows(
    channels: Mapping[str, FloatArray], ranges: Mapping[str, float]
) -> dict[str, IntArray]:
    """Return where one of some channels alike is far off its neighbours in time.

    Parameters
    ----------
    channels : mapping of str to ndarray of shape (n,)
        Channels that see the same, two or more: what another shows at once is no fault of one.
    ranges : mapping of str to float
        Width of the range of each.

    Returns
    -------
    dict of str to ndarray of int
        Rows, of those channels that have some.
    """
    candidates = {name: _candidates(values, ranges[name]) for name, values in channels.items()}
    found = {}
    for name, rows in candidates.items():
        others = [(values, ranges[n]) for n, values in channels.items() if n != name]
        kept = rows[~_seen(rows, _off(channels[name], rows) / ranges[name], others)]
        if kept.size:
            found[name] = kept
    return found


def _candidates(values: FloatArray, width: float) -> IntArray:
    """Return the rows of a channel that stand out of those around them."""
    # A reading that is off the median of five is off one of its two neighbours.
    edges = np.flatnonzero(np.abs(np.diff(values)) > SHARE * width)
    rows = np.union1d(edges, edges + 1)
    rows = rows[(rows >= MARGIN) & (rows < values.size - MARGIN)]
    off = _off(values, rows) / width
    rows, off = rows[off > SHARE], off[off > SHARE]
    # On a steep slope the rows beside a spike stand out a little too.
    beside = _largest_off(values, rows, np.arange(-2, 3)) / width
    rows, off = rows[off > 0.5 * beside], off[off > 0.5 * beside]
    return rows[off > RATIO * np.maximum(LEAST, _around(values, rows, width))]


def _seen(
    rows: IntArray, off: FloatArray, others: Sequence[tuple[FloatArray, float]]
) -> np.ndarray:
    """Return at which rows another channel stands out, too."""
    seen = np.zeros(rows.size, dtype=np.bool_)
    for values, width in others:
        for shift in range(-2, 3):
            at = rows + shift
            other = _off(values, at) / width
            apart = other > QUIET_RATIO * np.maximum(LEAST, _around(values, at, width))
            seen |= (other > SEEN_SHARE * off) & apart
    return seen


def _around(values: FloatArray, rows: IntArray, width: float) -> FloatArray:
    """Return by how much a channel is off its neighbours for some rows before and behind."""
    away = np.arange(GAP, GAP + REACH)
    return _largest_off(values, rows, np.concatenate([-away, away])) / width


def _largest_off(values: FloatArray, rows: IntArray, shifts: IntArray) -> FloatArray:
    """Return the largest distance from the neighbours among rows beside some."""
    largest = np.zeros(rows.size)
    for shift in shifts:
        np.maximum(largest, _off(values, rows + shift), out=largest)
    return largest


def _off(values: FloatArray, rows: IntArray) -> FloatArray:
    """Return how far readings are off the median of themselves and two on either side."""
    inside = (rows >= 2) & (rows < values.size - 2)
    five = values[np.clip(rows[:, None] + np.arange(-2, 3), 0, values.size - 1)]
    return np.where(inside, np.abs(five[:, 2] - np.median(five, axis=1)), 0.0)
