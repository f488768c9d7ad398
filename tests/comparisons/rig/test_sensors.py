from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from comparisons.rig import CASES, RigRun, SensorSettings, simulate
from comparisons.rig.plant import run_plant
from comparisons.rig.readings import CALIBRATE_PA, Transducer, read_transducer
from comparisons.rig.sensors import (
    anti_alias,
    counts_from_volts,
    lag,
    rake_temperature_k,
    tube,
)
from surge_core.errors import InputError

FS = 10_000.0
Runs = Callable[[str], RigRun]


def _gain(out: np.ndarray, frequency_hz: float) -> float:
    time_s = np.arange(out.size) / FS
    late = slice(out.size // 2, None)
    wave = np.exp(-2j * np.pi * frequency_hz * time_s[late])
    return float(2.0 * np.abs(np.mean(out[late] * wave)))


@pytest.mark.parametrize(("hz", "percent"), [(7.0, 0.03), (16.0, 0.14), (82.5, 3.8)])
def test_tube_gain_at_the_frequencies_of_the_paper(hz: float, percent: float) -> None:
    time_s = np.arange(40_000) / FS
    out = tube(np.sin(2.0 * np.pi * hz * time_s), frequency_hz=400.0, damping=0.25, rate_hz=FS)
    assert 100.0 * (_gain(out, hz) - 1.0) == pytest.approx(percent, abs=0.05 + 0.02 * percent)


def test_tube_rings_at_400_hz_and_keeps_steady_pressure() -> None:
    step = np.r_[np.zeros(100), np.ones(4_000)]
    out = tube(step, frequency_hz=400.0, damping=0.25, rate_hz=FS)
    assert out[-1] == pytest.approx(1.0, abs=1e-6)
    ups = np.flatnonzero((out[100:-1] < 1.0) & (out[101:] >= 1.0))
    damped = 400.0 * np.sqrt(1.0 - 0.25**2)
    assert FS / np.mean(np.diff(ups[:5])) == pytest.approx(damped, rel=0.02)
    still = tube(np.full(500, 7.0), frequency_hz=400.0, damping=0.25, rate_hz=FS)
    assert np.max(np.abs(still - 7.0)) < 1e-9


def test_thermocouple_reaches_63_percent_in_10_ms() -> None:
    # A step between two samples, as straight lines: half a sample late.
    step = np.r_[np.zeros(10), np.ones(990)]
    out = lag(step, time_constant_s=0.010, rate_hz=FS)
    after = np.arange(990) + 0.5
    expected = 1.0 - np.exp(-after / FS / 0.010)
    assert np.max(np.abs(out[10:] - expected)) < 1e-4
    assert out[10 + 100] == pytest.approx(1.0 - np.exp(-1.0), abs=0.003)


def test_lag_of_zero_and_of_a_ramp() -> None:
    ramp = np.arange(20_000) / FS
    assert lag(ramp, time_constant_s=0.0, rate_hz=FS) is ramp
    behind = ramp - lag(ramp, time_constant_s=0.05, rate_hz=FS)
    assert behind[-1] == pytest.approx(0.05, rel=1e-9)


def test_anti_alias_is_3_db_down_at_its_corner() -> None:
    time_s = np.arange(20_000) / FS
    for hz, gain in ((450.0, np.sqrt(0.5)), (20.0, 1.0)):
        out = anti_alias(np.sin(2.0 * np.pi * hz * time_s), corner_hz=450.0, rate_hz=FS)
        assert _gain(out, hz) == pytest.approx(gain, rel=2e-3)


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


def test_zero_and_calibrate_readings_recover_sensitivity_and_bias() -> None:
    settings = SensorSettings()
    true = Transducer(sensitivity_v_pa=7.4e-5, bias_v=0.04)
    counts_v = 4096.0 / 10.0
    sensitivities, biases = [], []
    for seed in range(30):
        reading = read_transducer(true, -2e4, 25, settings, np.random.default_rng(seed))
        step = (reading.calibrate_count - reading.zero_count) / counts_v
        sensitivities.append(step / CALIBRATE_PA[25])
        biases.append(reading.zero_count - 2048.0)
        operate = (reading.operate_count - reading.zero_count) / counts_v
        assert operate / sensitivities[-1] == pytest.approx(-2e4, rel=3e-3)
    error = np.array(sensitivities) / true.sensitivity_v_pa - 1.0
    assert np.max(np.abs(error)) < 1e-3
    assert abs(np.mean(error)) < 4.0 * np.std(error) / np.sqrt(30)
    assert np.mean(biases) == pytest.approx(true.bias_v * counts_v, abs=0.2)


def test_rake_temperature_is_held() -> None:
    gas = np.r_[np.full(1_000, 255.0), np.full(30_000, 455.0)]
    settings = SensorSettings()
    oil = rake_temperature_k(25, gas, settings, rate_hz=FS)
    assert oil[0] == pytest.approx(310.93)
    assert 1.0 < oil[-1] - oil[0] < 0.02 * 200.0
    hot = rake_temperature_k(31, gas + 4_000.0 * (gas > 300.0), settings, rate_hz=FS)
    # 110 °F is the most that the water lets through.
    assert hot.max() <= (110.0 + 459.67) / 1.8 + 0.01
    stiff = rake_temperature_k(25, gas, replace(settings, rake_coupling=0.0), rate_hz=FS)
    assert np.all(stiff == stiff[0])


def test_same_arguments_same_run(default_run: Runs) -> None:
    again, first = simulate("985"), default_run("985")
    for name in first.raw.channels:
        assert np.array_equal(first.raw[name], again.raw[name])
    assert first.test == again.test
    assert first.truth_parameters == again.truth_parameters


def test_seeds_change_sensors_but_not_the_plant() -> None:
    runs = [simulate("985", seed=seed, duration_s=0.6) for seed in (1, 2, 3)]
    for name in runs[0].truth.channels:
        for run in runs[1:]:
            assert np.array_equal(runs[0].truth[name], run.truth[name])
    for name in runs[0].raw.channels:
        assert not np.array_equal(runs[0].raw[name], runs[1].raw[name]) or name.startswith("T31")
    entries = [run.truth_parameters["sensors"]["P25_A_tip_forward"] for run in runs]
    assert len({entry["sensitivity_V_Pa"] for entry in entries}) == 3
    assert len({entry["bias_V"] for entry in entries}) == 3


def test_sensors_differ_from_one_another_as_much_as_stated() -> None:
    values = [
        entry
        for seed in range(8)
        for name, entry in simulate("985", seed=seed, duration_s=0.2)
        .truth_parameters["sensors"]
        .items()
        if name.startswith("P25")
    ]
    sensitivity = np.array([entry["sensitivity_V_Pa"] for entry in values])
    bias = np.array([entry["bias_V"] for entry in values])
    n = len(values)
    assert n == 64
    for spread, stated in (
        (np.std(sensitivity) / np.mean(sensitivity), 0.02),
        (np.std(bias), 0.05),
    ):
        # Standard error of a standard deviation of n normal numbers.
        assert abs(spread - stated) < 4.0 * stated / np.sqrt(2.0 * n)


def test_switching_one_imperfection_off_leaves_the_others() -> None:
    full = simulate("985", seed=4, duration_s=0.6)
    quiet = simulate("985", seed=4, duration_s=0.6, sensors=SensorSettings(noise_percent=0.0))
    name = "P25_B_hub_aft"
    assert full.test["channels"][name] == quiet.test["channels"][name]
    assert np.std(full.raw[name][:140]) > 3.0 * np.std(quiet.raw[name][:140])


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


def test_leak_path_and_facility_errors_stay_small(default_run: Runs) -> None:
    run = default_run("985")
    near = run.test["near_stall"]
    rows = slice(0, 141)
    assert near["P25_Pa"] == pytest.approx(np.mean(run.truth["P25_Pa"][rows]), rel=1e-3)
    assert near["P31_Pa"] == pytest.approx(np.mean(run.truth["P31_Pa"][rows]), rel=1e-3)
    assert near["T25_K"] == pytest.approx(np.mean(run.truth["T25_K"][rows]), abs=1.0)
    assert near["T31_K"] == pytest.approx(np.mean(run.truth["T31_K"][rows]), abs=1.0)


def test_remote_transducer_on_the_leak_path_is_slow() -> None:
    from comparisons.rig.readings import read_near_stall

    # A throttle that closes from the first moment: P31 rises, and a slow transducer falls behind.
    run = run_plant(replace(CASES["985"], close_start_s=0.0, close_rate_per_s=0.1), n_rows=2_001)
    quiet = SensorSettings.ideal()
    prompt = read_near_stall(run, quiet, np.random.default_rng(0)).p31_pa
    slow = read_near_stall(run, replace(quiet, leak_lag_s=0.5), np.random.default_rng(0)).p31_pa
    assert run["P31"][0] < slow < prompt
    assert prompt == pytest.approx(float(np.mean(run["P31"][:1401])))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("noise_percent", -1.0),
        ("noise_percent", float("nan")),
        ("bits", 1),
        ("bits", 12.5),
        ("tube_frequency_hz", 0.0),
        ("anti_alias_hz", 6_000.0),
        ("reading_samples", 0),
        ("recovery_factor", 0.0),
        ("cells", "much"),
    ],
)
def test_settings_refuse_nonsense_by_name(field: str, value: object) -> None:
    with pytest.raises(InputError, match=f"SensorSettings.{field}"):
        SensorSettings(**{field: value})  # type: ignore[arg-type]
