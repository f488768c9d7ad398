"""Single wrong readings: one or two rows far off those before and behind, in one channel alone."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from scipy.ndimage import maximum_filter1d

from surge_core.types import BoolArray, FloatArray, IntArray

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
# From a row to the middle of the rows that it is compared with.
MIDDLE = GAP + REACH // 2
NEAR = np.arange(-2, 3)
# Rows that are looked at at once: what is computed of them stays in the cache.
BLOCK_ROWS = 1 << 13


def spike_rows(
    channels: Mapping[str, FloatArray], ranges: Mapping[str, float]
) -> dict[str, IntArray]:
    """Return the rows, by channel, where one of some channels alike is far off its neighbours.

    The two or more channels see the same: what another shows at once is no fault of one. ``ranges``
    is the width of the range of each.
    """
    off = {name: _off_neighbours(values) / ranges[name] for name, values in channels.items()}

    @cache
    def largest(name: str) -> FloatArray:
        return np.asarray(maximum_filter1d(off[name], REACH))

    def standing_out(name: str, rows: IntArray, ratio: float) -> BoolArray:
        beside = np.maximum(largest(name)[rows - MIDDLE], largest(name)[rows + MIDDLE])
        return np.asarray(off[name][rows] > ratio * np.maximum(LEAST, beside))

    found = {}
    for name, own in off.items():
        rows = np.flatnonzero(own[MARGIN : own.size - MARGIN] > SHARE) + MARGIN
        if not rows.size:
            continue
        rows = rows[standing_out(name, rows, RATIO)]
        near = rows[:, None] + NEAR
        # On a steep slope the rows beside a spike stand out a little too.
        alone = np.all(own[rows, None] > 0.5 * own[near], axis=1)
        for other in off.keys() - {name}:
            shown = off[other][near] > SEEN_SHARE * own[rows, None]
            alone &= ~np.any(shown & standing_out(other, near, QUIET_RATIO), axis=1)
        if alone.any():
            found[name] = rows[alone]
    return found


def _off_neighbours(values: FloatArray) -> FloatArray:
    """Return how far each reading is off the median of itself and two on either side."""
    off = np.zeros(values.size)
    for start in range(2, values.size - 2, BLOCK_ROWS):
        stop = min(start + BLOCK_ROWS, values.size - 2)
        first, second, own, fourth, fifth = (values[start + k : stop + k] for k in range(-2, 3))
        # The least and the largest of the four are on either side of the median of all five.
        one = np.maximum(np.minimum(first, second), np.minimum(fourth, fifth))
        other = np.minimum(np.maximum(first, second), np.maximum(fourth, fifth))
        median = np.clip(own, np.minimum(one, other), np.maximum(one, other))
        off[start:stop] = np.abs(own - median)
    return off
