"""Spectra: trend out, power kept, peaks where they are."""

from __future__ import annotations

import numpy as np
import pytest

from classic_ml.filters import peak_frequency_hz, power_spectrum

RATE = 1000.0
TIME = np.arange(4000) / RATE


def test_a_straight_line_has_no_spectrum() -> None:
    line = 8.0 + 3.0 * TIME
    _, density = power_spectrum(line, RATE)
    assert density.max() < 1e-18


def test_the_trend_does_not_hide_the_surge() -> None:
    surge = np.sin(2 * np.pi * 7.0 * TIME)
    frequency, with_trend = power_spectrum(surge + 40.0 * TIME, RATE)
    _, without = power_spectrum(surge, RATE)
    band = (frequency > 5) & (frequency < 9)
    np.testing.assert_allclose(with_trend[band], without[band], rtol=0.05)
    assert with_trend[frequency < 2].max() < 0.02 * with_trend.max()


def test_the_integral_is_the_variance() -> None:
    noise = np.random.default_rng(3).standard_normal(40_000)
    frequency, density = power_spectrum(noise, RATE)
    # 49 half-overlapping records of 800 free bins: the total scatters by about 1 %.
    assert np.trapezoid(density, frequency) == pytest.approx(np.var(noise), rel=0.03)


def test_1600_samples_give_bins_that_hold_81_2_and_162_hz() -> None:
    cell = np.sin(2 * np.pi * 81.25 * TIME) + 0.3 * np.sin(2 * np.pi * 162.5 * TIME)
    frequency, density = power_spectrum(cell, RATE)
    assert frequency[1] == pytest.approx(0.625)
    assert frequency[np.argmax(density)] == pytest.approx(81.25)
    assert peak_frequency_hz(frequency, density, 150, 200) == pytest.approx(162.5, abs=0.01)


@pytest.mark.parametrize("true_hz", [6.9, 82.5, 82.37])
def test_a_peak_between_two_bins_is_found(true_hz: float) -> None:
    frequency, density = power_spectrum(np.sin(2 * np.pi * true_hz * TIME), RATE)
    assert peak_frequency_hz(frequency, density, 3, 200) == pytest.approx(true_hz, abs=0.06)
