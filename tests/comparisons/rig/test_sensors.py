from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from comparisons.rig import SensorSettings, gas, simulate
from comparisons.rig.sensors import counts_from_volts, lag, tube

FS = 10_000.0


def _gain(out: np.ndarray, frequency_hz: float) -> float:
    time_s = np.arange(out.size) / FS
    late = slice(out.size // 2, None)
    wave = np.exp(-2j * np.pi * frequency_hz * time_s[late])
    return float(2.0 * np.abs(np.mean(out[late] * wave)))


@pytest.mark.parametrize(("hz", "percent"), [(7.0, 0.03), (16.0, 0.14), (82.5, 3.8)])
def test_tube_gain_at_the_frequencies_of_the_paper(hz: float, percent: float) -> None:
    time_s = np.arange(40_000) / FS
    out = tube(np.sin(2.0 * np.pi * hz * time_s), frequency_hz=400.0, damping=0.25)
    assert 100.0 * (_gain(out, hz) - 1.0) == pytest.approx(percent, abs=0.05 + 0.02 * percent)


def test_thermocouple_reaches_63_percent_in_10_ms() -> None:
    # A step between two samples, as straight lines: half a sample late.
    step = np.r_[np.zeros(10), np.ones(990)]
    out = lag(step, time_constant_s=0.010)
    after = np.arange(990) + 0.5
    expected = 1.0 - np.exp(-after / FS / 0.010)
    assert np.max(np.abs(out[10:] - expected)) < 1e-4
    assert out[10 + 100] == pytest.approx(1.0 - np.exp(-1.0), abs=0.003)


def test_converter_rounds_and_clips_to_twelve_bits() -> None:
    volts = np.linspace(-6.0, 6.0, 5_001)
    codes = counts_from_volts(volts, 12)
    assert codes.min() == 0.0
    assert codes.max() == 4095.0
    assert np.all(codes == np.round(codes))
    inside = np.abs(volts) < 4.99
    back = codes[inside] * 10.0 / 4096.0 - 5.0
    assert np.max(np.abs(back - volts[inside])) <= 5.0 / 4096.0 + 1e-12
    exact = counts_from_volts(volts, None) * 10.0 / 4096.0 - 5.0
    assert exact == pytest.approx(volts)


def test_sensors_differ_from_one_another_as_much_as_stated() -> None:
    runs = (simulate("985", seed=seed, duration_s=0.2) for seed in range(8))
    sensors = [dict(run.truth_parameters["sensors"]) for run in runs]
    inlet = [entry for one in sensors for name, entry in one.items() if name.startswith("P25")]
    sensitivity = np.array([entry["sensitivity_V_Pa"] for entry in inlet])
    bias = np.array([entry["bias_V"] for entry in inlet])
    # Standard error of a standard deviation of n normal numbers.
    error = 4.0 / np.sqrt(2.0 * len(inlet))
    assert np.std(sensitivity) / np.mean(sensitivity) == pytest.approx(0.02, rel=error)
    assert np.std(bias) == pytest.approx(0.05, rel=error)


def test_noise_in_the_record_is_what_the_anti_alias_filter_leaves() -> None:
    settings = SensorSettings(bits=None, noise_percent=0.2, anti_alias_hz=None)
    raw = simulate("985", seed=1, duration_s=0.2, sensors=settings).raw
    spreads = [np.std(raw[name][:150]) for name in raw.channels if name.startswith("P")]
    # 0.2 % of 2048 counts, white; the mean of 16 channels of 150 samples.
    assert np.mean(spreads) == pytest.approx(4.096, rel=4.0 / np.sqrt(2.0 * 16 * 150))
    filtered = simulate(
        "985", seed=1, duration_s=0.2, sensors=replace(settings, anti_alias_hz=450.0)
    )
    left = [np.std(filtered.raw[n][:150]) for n in raw.channels if n.startswith("P")]
    # Noise bandwidth of the filter over half the plant's rate.
    assert np.mean(left) == pytest.approx(4.096 * np.sqrt(1.026 * 450.0 / 5_000.0), rel=0.1)


def test_flow_constant_is_that_of_the_paper_in_both_systems_of_units() -> None:
    assert pytest.approx(416.86, abs=0.01) == gas.FLOW_CONSTANT_KG_S_M2
    in_us = gas.FLOW_CONSTANT_KG_S_M2 / gas.LBM_KG * 0.3048**2
    assert in_us == pytest.approx(85.38, abs=0.005)
    choked = gas.corrected_flow_kg_s(1.0, 0.3048**2) / gas.LBM_KG
    assert choked == pytest.approx(49.4, abs=0.05)
