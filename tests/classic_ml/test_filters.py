"""The low-pass attenuates as Butterworth's formula says, and delays as it must."""

from __future__ import annotations

import numpy as np
import pytest

from classic_ml.filters import filter_channels, low_pass, period_average, phase_delay_s
from classic_ml.records import Record
from surge_core.errors import InputError

RATE = 1000.0
TIME = np.arange(4000) / RATE


def amplitude(values: np.ndarray, frequency_hz: float) -> float:
    middle = slice(1000, 3000)
    carrier = np.exp(-2j * np.pi * frequency_hz * TIME[middle])
    return 2 * abs(np.mean(values[middle] * carrier))


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize(("phase", "passes"), [("causal", 1), ("zero", 2)])
def test_a_sine_comes_out_with_butterworth_s_gain(order: int, phase: str, passes: int) -> None:
    for frequency in (8.0, 48.0, 80.0):
        sine = np.sin(2 * np.pi * frequency * TIME)
        out = low_pass(sine, RATE, order=order, cutoff_hz=48.0, phase=phase)
        # The bilinear map of a filter at 1 kHz warps the frequencies.
        ratio = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * 48.0 / RATE)
        gain = (1.0 + ratio ** (2 * order)) ** -0.5
        assert amplitude(out, frequency) == pytest.approx(gain**passes, rel=2e-3)


def delay_of(order: int, phase: str, frequency: float = 7.0) -> float:
    sine = np.sin(2 * np.pi * frequency * TIME)
    out = low_pass(sine, RATE, order=order, cutoff_hz=48.0, phase=phase)
    middle = slice(1000, 3000)
    carrier = np.exp(-2j * np.pi * frequency * TIME[middle])
    turn = np.angle(np.mean(out[middle] * carrier) / np.mean(sine[middle] * carrier))
    return float(-turn / (2 * np.pi * frequency))


@pytest.mark.parametrize(("order", "delay_ms"), [(3, 6.6), (5, 10.7)])
def test_the_causal_filter_delays_surge_by_the_known_time(order: int, delay_ms: float) -> None:
    assert 1e3 * delay_of(order, "causal") == pytest.approx(delay_ms, abs=0.15)
    stated = phase_delay_s(7.0, RATE, order=order, cutoff_hz=48.0)
    assert stated == pytest.approx(delay_of(order, "causal"), abs=2e-5)
    assert abs(delay_of(order, "zero")) < 1e-6


@pytest.mark.parametrize("width", [0.4, 1.0, 1.7, 2.0, 12.12, 13.0, 150.0])
def test_the_moving_average_is_the_weighted_mean_of_what_there_is(width: float) -> None:
    values = np.random.default_rng(8).standard_normal(120)
    out = period_average(values, width / RATE, RATE)
    offset = np.abs(np.arange(120) - np.arange(120)[:, None])
    # Each sample stands for one period around it, of which a part is inside of the average.
    weights = np.clip(0.5 * width + 0.5 - offset, 0.0, 1.0)
    if width > 1.0:
        np.testing.assert_allclose(out, weights @ values / weights.sum(axis=1), rtol=0, atol=1e-13)
    else:
        np.testing.assert_array_equal(out, values)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 500.0, 700.0])
def test_a_cutoff_that_the_sample_rate_cannot_hold_is_refused(cutoff: float) -> None:
    with pytest.raises(InputError, match=r"below half the sample rate \(500 Hz\)"):
        low_pass(TIME, RATE, order=3, cutoff_hz=cutoff, phase="zero")


def test_the_average_over_one_cell_period_has_nulls_at_the_cell_and_its_harmonics() -> None:
    surge = 30 + 20 * np.sin(2 * np.pi * 7.0 * TIME)
    for harmonic in (1, 2, 3):
        cells = 9.0 * np.sin(2 * np.pi * 82.5 * harmonic * TIME + 0.4)
        left = period_average(surge + cells, 1 / 82.5, RATE) - period_average(surge, 1 / 82.5, RATE)
        # Fractional end weights are linear interpolation of the integral: good to (f/rate)².
        assert np.abs(left[50:-50]).max() < 9.0 * 0.06 * harmonic**2
    kept = period_average(surge, 1 / 82.5, RATE)[50:-50] - surge[50:-50]
    assert np.abs(kept).max() < 20 * 0.013


@pytest.mark.parametrize("phase", ["zero", "causal"])
def test_the_undershoot_of_the_filter_makes_no_negative_pressure(phase: str) -> None:
    """A blowdown to 2 kPa within some rows: the filter swings below, the probe has not."""
    falling = np.where(TIME < 2.0, 2e5, 2e3)
    record = Record.from_arrays(
        {"P": (falling, "Pa"), "Q": (falling + 1e5, "Pa"), "X": (falling, "1")}, sample_rate_hz=RATE
    )
    settings = {"order": 3, "cutoff_hz": 48.0, "phase": phase}
    plain = low_pass(falling, RATE, **settings)
    assert plain.min() < -1e3
    out = filter_channels(record, ("P", "Q", "X"), **settings)
    np.testing.assert_array_equal(out["P"], np.maximum(plain, 2e3))
    np.testing.assert_array_equal(out["X"], plain)
    assert out["Q"].min() < 1.02e5
    (flag,) = out.history[-1].flags
    assert flag.startswith("P: the filter undershoots zero pressure")
