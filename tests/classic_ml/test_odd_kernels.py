"""The compiled search for odd readings marks what the same search by whole arrays marks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter1d, median_filter

from classic_ml.faults import odd_readings as odd


def around(values: np.ndarray, reach: int, gap: int) -> np.ndarray:
    largest = maximum_filter1d(values, reach, axis=1, mode="nearest")
    shift = gap + reach // 2
    both = np.zeros_like(values)
    both[:, shift:] = largest[:, :-shift]
    both[:, :-shift] = np.maximum(both[:, :-shift], largest[:, shift:])
    return both


def spikes_by_arrays(values: np.ndarray) -> np.ndarray:
    off = np.abs(values - median_filter(values, (1, 5)))
    off[:, :2] = off[:, -2:] = 0.0
    ratio = off / np.maximum(around(off, odd.SPIKE_REACH, odd.SPIKE_GAP), 0.1 * odd.SPIKE_SHARE)
    marked = (ratio > odd.SPIKE_RATIO) & (off > odd.SPIKE_SHARE)
    marked &= off > 0.5 * maximum_filter1d(off, 5, axis=1, mode="nearest")
    marked[:, : odd.SPIKE_MARGIN] = marked[:, -odd.SPIKE_MARGIN :] = False
    for channel, row in np.argwhere(marked):
        beside = slice(row - 2, row + 3)
        seen = ratio[:, beside] > odd.QUIET_RATIO
        seen &= off[:, beside] > odd.SEEN_SHARE * off[channel, row]
        marked[channel, row] = not np.delete(seen, channel, axis=0).any()
    return marked


def splices_by_arrays(values: np.ndarray) -> np.ndarray:
    steps = np.abs(np.diff(values, axis=1))
    ratio = steps / np.maximum(around(steps, odd.SPLICE_REACH, odd.SPLICE_GAP), odd.SPLICE_STEP)
    fewest = int(np.floor((1.0 - odd.SPLICE_SHARE) * len(values)))
    most = np.sort(ratio, axis=0)[fewest]
    most[: odd.SPLICE_MARGIN] = most[-odd.SPLICE_MARGIN :] = 0.0
    return np.flatnonzero(most > odd.SPLICE_RATIO) + 1


@pytest.mark.parametrize("seed", range(40))
def test_the_same_rows_are_marked(seed: int) -> None:
    rng = np.random.default_rng(seed)
    channels, n = int(rng.integers(4, 9)), int(rng.integers(60, 2000))
    values = np.cumsum(rng.normal(size=(channels, n)), axis=1) * rng.choice([0.0, 1e-4, 1e-3])
    values += rng.normal(size=(channels, n)) * rng.choice([1e-5, 1e-4, 1e-3])
    for _ in range(8):
        values[rng.integers(channels), rng.integers(n)] += 0.3 * rng.normal()
    for _ in range(3):
        values[:, rng.integers(n) :] += 0.02 * rng.normal()
    if seed % 2:
        # Codes of a converter: ties everywhere.
        values = np.round(4096.0 * values) / 4096.0
    assert np.array_equal(odd.spikes(list(values)), spikes_by_arrays(values))
    assert np.array_equal(odd.splices(list(values)), splices_by_arrays(values))


def test_spikes_and_cuts_are_there_to_be_marked() -> None:
    rng = np.random.default_rng(3)
    values = 1e-4 * rng.normal(size=(6, 1000))
    values[2, 400] += 0.1
    values[:, 700:] += 0.05
    marked = odd.spikes(list(values))
    assert np.argwhere(marked).tolist() == [[2, 400]]
    assert odd.splices(list(values)).tolist() == [700]
