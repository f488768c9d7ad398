"""Spectra, correlations and densities of signals whose answer is known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from comparisons.harness.residual_analysis import (
    dwelt_on,
    error_correlation,
    segment_spectrum,
    stall_inception,
)

PERIOD_S = 1e-3


def segments(*lengths: int) -> list[slice]:
    edges = np.concatenate([[0], np.cumsum(lengths)])
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


@pytest.mark.parametrize("frequency_hz", [23.4375, 82.03125, 164.0625])
def test_a_sinusoid_has_its_peak_at_its_frequency_and_its_power_under_it(
    frequency_hz: float,
) -> None:
    runs = segments(700, 300, 800, 512)
    time_s = PERIOD_S * np.arange(2312)
    signal = 3.0 * np.sin(2 * np.pi * frequency_hz * time_s) + 40.0 + 7.0 * time_s
    spectrum = segment_spectrum(signal, runs, PERIOD_S)
    assert spectrum.frequency_hz[np.argmax(spectrum.density)] == pytest.approx(frequency_hz)
    power = float(np.sum(spectrum.density)) * spectrum.frequency_hz[0]
    assert power == pytest.approx(4.5, rel=0.02)  # level and trend do not count


def test_white_noise_lies_inside_its_band() -> None:
    rng = np.random.default_rng(11)
    runs = segments(150, 400, 90, 333, 600, 427)
    inside, levels = [], []
    for _ in range(60):
        spectrum = segment_spectrum(2.0 * rng.standard_normal(2000), runs, PERIOD_S)
        # Detrending takes from the first bins, and the last has no mirror image.
        ratio = spectrum.density[3:-1] / (2.0 * 4.0 * PERIOD_S)
        low, high = spectrum.band99
        inside.append(np.mean((ratio > low) & (ratio < high)))
        levels.append(ratio.mean())
    assert np.mean(levels) == pytest.approx(1.0, abs=0.02)
    assert 0.98 < np.mean(inside) < 0.998


def test_no_piece_straddles_two_segments() -> None:
    runs = segments(128, 128)
    signal = np.concatenate([np.zeros(128), np.full(128, 1e6)])
    spectrum = segment_spectrum(signal, runs, PERIOD_S)
    assert spectrum.density.max() < 1e-9  # each segment is constant; only the border is not


def test_autocorrelation_of_a_first_order_process() -> None:
    rng = np.random.default_rng(5)
    n, a = 40_000, 0.8
    noise = rng.standard_normal(n)
    signal = np.zeros(n)
    for k in range(1, n):
        signal[k] = a * signal[k - 1] + noise[k]
    runs = segments(*[2000] * 20)
    correlation = error_correlation(signal, runs, PERIOD_S, n_lags=10)
    assert correlation.lag_s == pytest.approx(PERIOD_S * np.arange(1, 11))
    assert correlation.value == pytest.approx(a ** np.arange(1, 11), abs=0.05)


def test_white_errors_stay_inside_the_band_at_99_percent_of_the_lags() -> None:
    rng = np.random.default_rng(6)
    runs = segments(300, 500, 1200)
    outside = [
        np.mean(np.abs(c.value) > c.limit99)
        for c in (error_correlation(rng.standard_normal(2000), runs, PERIOD_S) for _ in range(100))
    ]
    assert 0.004 < np.mean(outside) < 0.016


def test_errors_that_follow_phi_show_at_a_positive_lag() -> None:
    rng = np.random.default_rng(7)
    phi = 0.3 + rng.standard_normal(3000)
    errors = 0.1 * rng.standard_normal(3000)
    errors[7:] += phi[:-7] - 0.3
    correlation = error_correlation(errors, segments(3000), PERIOD_S, 20, phi=phi)
    assert correlation.lag_s[np.argmax(correlation.value)] == pytest.approx(7 * PERIOD_S)
    assert np.mean(np.abs(correlation.value) > correlation.limit99) < 0.1


def test_bartletts_band_holds_for_two_signals_with_memory() -> None:
    rng = np.random.default_rng(8)
    narrow, outside = [], []
    for _ in range(60):
        smooth = [np.convolve(rng.standard_normal(2030), np.ones(15), "valid")[:2000] for _ in "ab"]
        correlation = error_correlation(smooth[0], segments(2000), PERIOD_S, phi=smooth[1])
        outside.append(np.mean(np.abs(correlation.value) > correlation.limit99))
        narrow.append(np.mean(np.abs(correlation.value) > 2.576 / np.sqrt(2000)))
    assert np.mean(outside) < 0.03
    assert np.mean(narrow) > 0.1  # without the memory the band would be too narrow


def test_a_hole_in_phi_is_not_dwelt_on() -> None:
    phi = np.concatenate([np.linspace(-0.1, -0.05, 50), np.linspace(0.05, 0.3, 300)])
    grid = np.array([-0.12, -0.1, -0.06, -0.045, 0.0, 0.04, 0.045, 0.2, 0.31])
    expected = [False, True, True, True, False, False, True, True, False]
    assert dwelt_on(grid, phi).tolist() == expected


def test_stall_inception_is_the_last_summit_before_the_first_stall() -> None:
    ratio = np.concatenate(
        [np.full(400, 22.0), np.linspace(22.0, 23.7, 80), np.linspace(23.7, 2.0, 120)]
    )
    in_stall = np.arange(600) > 500
    assert ratio[stall_inception(ratio, in_stall, 1000.0)] == 23.7
    assert stall_inception(ratio, np.zeros(600, dtype=bool), 1000.0) is None
    assert stall_inception(ratio, np.ones(600, dtype=bool), 1000.0) is None
