"""Counts become the pressures that made them; the match moves biases and nothing else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from raw_data import first_order, make_test

from classic_ml.calibration import (
    calibrate,
    invert_thermocouples,
    near_stall_match,
    near_stall_rows,
    total_reading,
)
from classic_ml.description import TestDescription
from classic_ml.records import Channel, Record
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def loaded():
    made = make_test(seconds=0.6, quantise=False)
    return made, *made.load()


def test_zero_and_calibrate_codes_give_their_own_pressures(loaded) -> None:
    _, _, test = loaded
    for probe in test.pressures:
        got = total_reading(probe, test, np.array([probe.zero_count, probe.calibrate_count]))
        expected = probe.zoc_reference_Pa + np.array([0.0, probe.calibrate_pressure_Pa])
        np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_calibration_returns_the_true_pressures_and_temperatures(loaded) -> None:
    made, record, test = loaded
    out = calibrate(record, test)
    forward = out["P25_A_hub_forward"]
    np.testing.assert_allclose(forward[:200], 55e3, rtol=1e-9)
    assert out.channel("P25_A_hub_forward").unit == "Pa"
    np.testing.assert_allclose(out["T25_A"], made.truth["T25"], atol=0.01)
    assert [e.step for e in out.history] == ["read", "calibrate"]


def matched(record: Record, test: TestDescription) -> Record:
    shifts, entry = near_stall_match(calibrate(record, test), test)
    return calibrate(record, test, shifts).after(entry)


def test_the_match_takes_out_a_bias_of_the_amplifier_and_keeps_the_difference_of_a_pair() -> None:
    made = make_test(seconds=0.6, quantise=False)
    biased = {
        name: values + (25.0 if name.startswith("P25_A_hub") else 0.0)
        for name, values in made.columns.items()
    }
    record, test = made.load()
    shifted, _ = dataclasses.replace(made, columns=biased).load()
    clean, found = matched(record, test), matched(shifted, test)
    for name in ("P25_A_hub_forward", "P25_B_tip_aft"):
        np.testing.assert_allclose(found[name], clean[name], rtol=2e-3)
    rows = near_stall_rows(found, test)
    for name, target in (("P25_A_hub_forward", 55e3), ("P31_B_tip_forward", 1.285e6)):
        assert np.mean(found[name][rows]) == pytest.approx(target, rel=1e-12)
    assert np.mean(found["T25_B"][rows]) == pytest.approx(255.0, rel=1e-12)
    plain = calibrate(shifted, test)
    before, after = (r["P25_A_hub_forward"] - r["P25_A_hub_aft"] for r in (plain, found))
    np.testing.assert_allclose(after, before, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("P25_A_tip_forward", lambda v: 0.145038e-3 * v),
        ("T25_A", lambda v: 1.8 * v),
        ("P31_A_hub_forward", lambda v: 2 * 758423.27 - v),
    ],
    ids=["psi", "rankine", "zero and calibrate swapped"],
)
def test_a_reading_far_from_the_facility_s_is_refused(loaded, name: str, change) -> None:
    _, record, test = loaded
    record = calibrate(record, test)
    wrong = Channel(name, change(record[name]), record.channel(name).unit)
    sign = "sign reversed" if name.startswith("P31") else "dead channel"
    with pytest.raises(InputError, match=rf"channel {name}: expected about .* at near .*{sign}"):
        near_stall_match(record.after(record.history[-1], add=[wrong]), test)


def test_the_lag_of_a_thermocouple_is_undone() -> None:
    time_s = np.arange(2000) / 1000.0
    gas = 450.0 + 20.0 * np.sin(2 * np.pi * 7.0 * time_s)
    _, test = make_test(seconds=0.5).load()
    seen = first_order(gas, 0.010, 1000.0)
    assert np.abs(seen - gas)[200:].max() > 5.0
    record = Record.from_arrays({"T25_A": (seen, "K"), "T25_B": (gas, "K")}, sample_rate_hz=1000.0)
    out = invert_thermocouples(record, test)
    # The central difference is short by (2πf·h)²/6 = 3e-4 of 20 K·2πf·τ, plus the straight lines.
    assert np.abs(out["T25_A"] - gas)[200:-1].max() < 0.02
    left = invert_thermocouples(record, test, invert=False)
    np.testing.assert_array_equal(left["T25_A"], seen)
    assert left.history[-1].parameters == {"invert": False}
