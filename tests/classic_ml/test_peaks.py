"""Peaks are those of scipy, wherever a block ends, and found in one pass where all are alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import find_peaks

from classic_ml.columns import workspace
from classic_ml.columns.peaks import prominent_peaks

# Few different values make plateaus and peaks of one height.
SIGNALS = st.one_of(
    st.lists(st.integers(0, 4).map(float), min_size=1, max_size=120),
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60),
    st.lists(st.integers(0, 3).map(float), min_size=1, max_size=12).map(lambda v: v * 9),
).map(np.array)


@given(
    signal=SIGNALS,
    start=st.integers(0, 8),
    least=st.sampled_from([0.01, 0.5, 1.0, 2.0, 3.0]),
    block=st.integers(1, 40),
)
@settings(max_examples=400, deadline=None)
def test_peaks_and_prominences_are_scipy_s(
    signal: np.ndarray, start: int, least: float, block: int
) -> None:
    expected, found = find_peaks(signal[start:], prominence=least)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace, "BLOCK_ROWS", block)
        rows, prominences = prominent_peaks(signal, least, start)
    np.testing.assert_array_equal(rows, expected + start)
    np.testing.assert_array_equal(prominences, found["prominences"])


def test_a_random_walk_has_the_peaks_that_scipy_finds() -> None:
    walk = np.cumsum(np.random.default_rng(2).standard_normal(200_000))
    expected, found = find_peaks(walk, prominence=8.0)
    rows, prominences = prominent_peaks(walk, 8.0)
    assert rows.size > 500
    np.testing.assert_array_equal(rows, expected)
    np.testing.assert_array_equal(prominences, found["prominences"])


def test_peaks_that_are_all_alike_are_each_as_prominent() -> None:
    wave = np.tile(-np.cos(2.0 * np.pi * np.arange(140) / 140), 20_000)
    rows, prominences = prominent_peaks(wave, 1.0)
    np.testing.assert_array_equal(rows, 70 + 140 * np.arange(20_000))
    # The last one has no trough behind it.
    assert np.all(prominences[:-1] == 2.0)
    assert prominences[-1] == 1.0 - wave[-1]
