"""Decimation: what is emptied is seen, nothing leaks, and a whitening noise model works again."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, flow, lagged
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt
from sklearn.preprocessing import FunctionTransformer

from classic_ml import LagRegressor
from classic_ml.decimation import Decimated, decimate, emptied_above_hz, needed_factor
from surge_core.errors import InputError


def low_pass(values: np.ndarray, order: int, cutoff_hz: float, phase: str) -> np.ndarray:
    sections = butter(order, cutoff_hz, fs=1.0 / PERIOD_S, output="sos")
    if phase == "zero":
        return sosfiltfilt(sections, values, axis=0)
    start = sosfilt_zi(sections)[:, :, None] * np.atleast_2d(values[0])[None]
    rows = values if values.ndim == 2 else values[:, None]
    return sosfilt(sections, rows, axis=0, zi=start)[0].reshape(values.shape)


def drifting(seed: int, n: int = 10_000) -> tuple[np.ndarray, np.ndarray]:
    """Terms and ψ' of 10 s with a throttle sweep, a drift, the stall cells' ripple and noise."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(n)
    fast = sosfilt(butter(2, 6.0, fs=1.0 / PERIOD_S, output="sos"), rng.standard_normal(n))
    phi = 0.3 + 0.15 * np.sin(2 * np.pi * 0.15 * t + rng.uniform(0, 6)) + 0.05 * fast / fast.std()
    drift = 0.06 * (0.5 * t / t[-1] + 0.5 * np.exp(-t))
    ripple = 0.03 * np.sin(2 * np.pi * 82.0 * t + rng.uniform(0, 6))
    psi_p = lagged(phi, "first") + drift + ripple + 0.004 * rng.standard_normal(n)
    return np.column_stack([np.ones(n), phi, phi**2]), psi_p


def fitted(data: Decimated, noise: str = "armax", noise_order: int = 2) -> LagRegressor:
    return LagRegressor(
        data.sample_period_s,
        noise=noise,
        noise_order=noise_order,
        drift="spline",
        hold="first",
        basis=FunctionTransformer(),
    ).fit(data.terms, data.y, data.segments, data.sample_weight)


def test_armax_with_a_drift_gives_tau_again_after_a_causal_filter_at_48_hz() -> None:
    whole, decimated = [], []
    for seed in range(6):
        terms, psi_p = (low_pass(v, 5, 48.0, "causal") for v in drifting(seed))
        factor = needed_factor(psi_p, sample_period_s=PERIOD_S)
        assert factor in (4, 5, 6)
        data = decimate(terms, psi_p, factor=factor, sample_period_s=PERIOD_S)
        decimated.append([1e3 * fitted(data, noise_order=c).time_constant_s_ for c in (2, 1)])
        data = decimate(terms, psi_p, factor=1, sample_period_s=PERIOD_S)
        whole.append(1e3 * fitted(data, noise_order=1).time_constant_s_)
    # 18.00 ± 0.12 ms, within the error of a mean of six and the 0.05 ms of the longer step.
    assert np.mean(decimated, axis=0) == pytest.approx(18.0, abs=0.12)
    assert np.std(decimated, axis=0).max() < 0.15
    # At the full rate C of first order reads the skirt of the filter.
    assert np.mean(whole) < 17.85


@pytest.mark.parametrize(
    ("order", "cutoff_hz", "phase"),
    [(5, 48.0, "causal"), (3, 48.0, "causal"), (3, 48.0, "zero"), (5, 100.0, "causal")],
)
def test_the_corner_of_a_low_pass_is_found(order: int, cutoff_hz: float, phase: str) -> None:
    for seed in range(3):
        signal = low_pass(drifting(seed)[1], order, cutoff_hz, phase)
        corner = emptied_above_hz(signal, sample_period_s=PERIOD_S)
        assert corner == pytest.approx(cutoff_hz, rel=0.3)
        # Rounding to five decimals is a floor far below.
        rounded = emptied_above_hz(np.round(signal, 5), sample_period_s=PERIOD_S)
        assert rounded == pytest.approx(corner, rel=0.05)


def test_unfiltered_records_and_white_noise_are_left_as_they_are() -> None:
    factors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        phi = flow(2000, rng)
        noisy = lagged(phi, "first") + 0.003 * rng.standard_normal(2000)
        segments = np.arange(2000) * 10 // 2000
        factors.append(needed_factor(noisy, segments, sample_period_s=PERIOD_S))
        factors.append(needed_factor(drifting(seed, 3000)[1], sample_period_s=PERIOD_S))
        factors.append(needed_factor(rng.standard_normal(400), sample_period_s=PERIOD_S))
        factors.append(needed_factor(rng.standard_normal(400).cumsum(), sample_period_s=PERIOD_S))
    assert set(factors) == {1}
    assert needed_factor(np.arange(20.0), sample_period_s=PERIOD_S) == 1


def test_nothing_leaks_across_a_joint() -> None:
    labels = np.repeat([3, 7], 100)
    y = np.where(labels == 3, 0.0, 1e6)
    data = decimate(y[:, None], y, labels, factor=4, sample_period_s=PERIOD_S)
    assert np.abs(data.y[data.segments == 3]).max() == 0.0
    np.testing.assert_allclose(data.y[data.segments == 7], 1e6, rtol=1e-12)
    np.testing.assert_array_equal(labels[data.rows], data.segments)
    assert np.all(np.diff(data.rows[data.segments == 3]) == 4)


def test_slow_signals_pass_without_gain_or_delay_and_fast_ones_do_not_fold_back() -> None:
    t = PERIOD_S * np.arange(4000)
    slow, fast = np.sin(2 * np.pi * 10.0 * t), np.sin(2 * np.pi * 190.0 * t)
    data = decimate(np.column_stack([slow, fast]), slow, factor=5, sample_period_s=PERIOD_S)
    np.testing.assert_allclose(data.y, slow[data.rows], atol=2e-3)
    assert np.abs(data.terms[:, 1]).max() < 0.02
    assert data.sample_period_s == pytest.approx(5e-3)
    narrow = decimate(fast[:, None], slow, factor=5, sample_period_s=PERIOD_S, cutoff_hz=60.0)
    assert np.abs(narrow.terms).max() < 0.01


def test_psi_and_the_terms_pass_the_same_filter() -> None:
    terms, psi_p = drifting(0, 2000)
    data = decimate(np.column_stack([terms, psi_p]), psi_p, factor=3, sample_period_s=PERIOD_S)
    np.testing.assert_array_equal(data.terms[:, -1], data.y)
    np.testing.assert_allclose(data.terms[:, 0], 1.0, rtol=1e-12)


def test_a_row_of_weight_zero_leaves_every_new_row_that_it_enters_unscored() -> None:
    weight = np.ones(400)
    weight[200] = 0.0
    y = np.random.default_rng(0).standard_normal(400)
    data = decimate(y[:, None], y, factor=4, sample_period_s=PERIOD_S, sample_weight=weight)
    touched = np.abs(data.rows - 200) <= 8
    assert np.all(data.sample_weight[touched] == 0.0)
    np.testing.assert_allclose(data.sample_weight[~touched], 1.0)


def test_a_factor_of_one_changes_nothing() -> None:
    terms, psi_p = drifting(1, 500)
    data = decimate(terms, psi_p, factor=1, sample_period_s=PERIOD_S)
    np.testing.assert_array_equal(data.terms, terms)
    np.testing.assert_array_equal(data.y, psi_p)
    np.testing.assert_array_equal(data.sample_weight, np.ones(500))


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"factor": 0}, "factor"),
        ({"factor": 2.5}, "factor"),
        ({"factor": 4, "cutoff_hz": 600.0}, "cutoff_hz"),
        ({"factor": 4, "cutoff_hz": 0.0}, "cutoff_hz"),
        ({"factor": 4, "sample_period_s": 0.0}, "sample_period_s"),
        ({"factor": 50}, "decimate"),
    ],
)
def test_what_cannot_be_decimated_is_refused(options: dict[str, float], where: str) -> None:
    y = np.arange(100.0)
    with pytest.raises(InputError) as error:
        decimate(y[:, None], y, **({"sample_period_s": PERIOD_S} | options))
    assert error.value.where == where


def test_a_table_that_does_not_match_is_refused() -> None:
    with pytest.raises(InputError, match="a table of 100 rows"):
        decimate(np.ones((99, 2)), np.ones(100), factor=2, sample_period_s=PERIOD_S)
