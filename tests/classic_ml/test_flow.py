"""Eq 1 to 4 against hand-worked numbers, their inverses, and the rule for reversed flow."""

from __future__ import annotations

import numpy as np
import pytest
from raw_data import AIR, GAMMA, GAS, corrected, make_test

from classic_ml.calibration import calibrate
from classic_ml.flow import (
    LBM_KG,
    P_STANDARD_PA,
    T_STANDARD_K,
    calculated_mach,
    corrected_flow,
    corrected_from_physical,
    local_flows,
    mach_from_corrected_flow,
    pair_flow,
    physical_flow,
    plane_averages,
    true_mach,
)
from classic_ml.records import Record
from surge_core.errors import InputError

MACH = np.linspace(-0.95, 0.95, 381)


def test_eq_3_has_the_constant_and_the_choke_of_air() -> None:
    small = corrected_flow(np.array([1e-6]), 1.0, AIR)[0] / 1e-6
    assert small == pytest.approx(416.86, abs=0.01)
    choke_lbm_s_ft2 = corrected_flow(np.array([1.0]), 0.3048**2, AIR)[0] / LBM_KG
    assert choke_lbm_s_ft2 == pytest.approx(49.4, abs=0.05)
    np.testing.assert_allclose(corrected_flow(MACH, 0.3, AIR), corrected(MACH, 0.3), rtol=1e-12)


@pytest.mark.parametrize("gamma", [1.3, 1.378, 1.4])
def test_the_inverse_holds_up_to_the_choke_for_any_gas(gamma: float) -> None:
    gas = AIR.model_copy(update={"gamma": gamma})
    mach = np.array([0.0, 1e-9, 0.5, 0.99, 1.0])
    back = mach_from_corrected_flow(corrected_flow(mach, 0.1, gas) * (1 - 1e-15), 0.1, gas)
    # Near the choke the flow hardly depends on the Mach number: 1e-15 of flow is 3e-8 of it.
    np.testing.assert_allclose(back, mach, atol=1e-6)


def test_more_flow_than_the_area_can_pass_is_refused() -> None:
    with pytest.raises(InputError, match=r"at most 24\.12 kg/s through 0.1 m²"):
        mach_from_corrected_flow(np.array([1.0, 30.0]), 0.1, AIR)


def test_eq_4_and_the_corrected_flow_are_the_identity() -> None:
    rng = np.random.default_rng(0)
    flow, pressure, temperature = rng.uniform((-20, 2e4, 200), (50, 2e6, 900), (100, 3)).T
    corrected_kg_s = corrected_from_physical(flow, pressure, temperature)
    np.testing.assert_allclose(
        physical_flow(corrected_kg_s, pressure, temperature), flow, rtol=1e-14
    )
    standard = physical_flow(flow, np.full(100, P_STANDARD_PA), np.full(100, T_STANDARD_K))
    np.testing.assert_allclose(standard, flow, rtol=1e-15)


def test_eq_1_returns_the_mach_number_of_an_isentropic_pair() -> None:
    static = np.full(MACH.size, 1e5)
    total = static * (1 + 0.2 * MACH**2) ** 3.5
    forward, aft = np.where(MACH > 0, total, static), np.where(MACH > 0, static, total)
    np.testing.assert_allclose(calculated_mach(forward, aft, GAMMA), MACH, atol=1e-7)


def test_swapping_the_probes_reverses_the_flow_and_nothing_else() -> None:
    rng = np.random.default_rng(1)
    forward, aft = rng.uniform(9e4, 1.1e5, (2, 50))
    one, other = calculated_mach(forward, aft, GAMMA), calculated_mach(aft, forward, GAMMA)
    np.testing.assert_array_equal(one, -other)
    np.testing.assert_array_equal(true_mach(one, 1.1, 0.012), -true_mach(other, 1.1, 0.012))


def test_eq_2_adds_the_offset_away_from_zero_and_none_at_zero() -> None:
    got = true_mach(np.array([-0.2, 0.0, 0.2]), 1.1, 0.012)
    np.testing.assert_allclose(got, [-0.232, 0.0, 0.232], atol=1e-15)
    # A negative offset must not turn a slow forward flow into a reversed one.
    assert true_mach(np.array([0.005]), 1.0, -0.01)[0] == 0.0


@pytest.mark.parametrize("gamma", [1.2, 1.378, 1.4])
def test_a_pair_shows_the_flow_that_its_pressures_were_made_of(gamma: float) -> None:
    """Isentropic pressures of a Mach number, read by a probe whose Eq 2 is known."""
    gas = AIR.model_copy(update={"gamma": gamma})
    mach = np.linspace(-0.8, 0.8, 161)
    seen = np.sign(mach) * np.maximum((np.abs(mach) - 0.012) / 1.1, 0.0)
    total = 9e4 * (1.0 + 0.5 * (gamma - 1.0) * seen**2) ** (gamma / (gamma - 1.0))
    forward, aft = np.where(seen > 0, total, 9e4), np.where(seen < 0, total, 9e4)
    found = pair_flow(forward, aft, 1.1, 0.012, 0.3, gas)
    fast = np.abs(mach) > 0.02
    exponent = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    constant = 0.3 * 101325.0 * np.sqrt(gamma / (GAS * 288.15))
    expected = constant * mach / (1.0 + 0.5 * (gamma - 1.0) * mach**2) ** exponent
    np.testing.assert_allclose(found[fast], expected[fast], rtol=1e-9)
    np.testing.assert_array_equal(found[seen == 0.0], 0.0)


def averages(drop: tuple[str, ...] = ()) -> tuple[Record, Record]:
    """Local flows and plane averages of a small test in pascal and kelvin, given as they are."""
    record, test = make_test(seconds=0.6, quantise=False).load()
    record = calibrate(record, test)
    local = local_flows(record.without(drop), test)
    return local, plane_averages(local, test)


def test_plane_averages_are_the_plain_mean_of_the_four_pairs() -> None:
    local, plane = averages()
    four = [local[f"Wc25_{rake}_{place}_kg_s"] for rake in "AB" for place in ("tip", "hub")]
    np.testing.assert_allclose(plane["Wc25_kg_s"], np.mean(four, axis=0), rtol=1e-12)
    np.testing.assert_allclose(plane["Wc25_tip_kg_s"], np.mean(four[::2], axis=0), rtol=1e-12)
    np.testing.assert_allclose(
        plane["W25_kg_s"],
        physical_flow(plane["Wc25_kg_s"], plane["P25_Pa"], plane["T25_K"]),
        rtol=1e-14,
    )


def test_a_missing_tip_pair_does_not_tilt_the_mean_to_the_hub() -> None:
    _, whole = averages()
    _, part = averages(drop=("P25_A_tip_forward", "P25_A_tip_aft"))
    np.testing.assert_allclose(part["Wc25_kg_s"], whole["Wc25_kg_s"], atol=0.02)


def test_a_plane_without_a_thermocouple() -> None:
    _, plane = averages(drop=("T31_A", "T31_B"))
    assert "W31_kg_s" not in plane
    assert "Wc31_kg_s" in plane


def test_the_law_of_the_probes_with_a_ramp_has_no_jump_and_is_eq_2_above_it() -> None:
    low, high = np.linspace(-0.03, 0.03, 61), np.array([-0.4, 0.031, 0.2])
    plain, ramped = (true_mach(low, 1.1, 0.012, ramp) for ramp in (0.0, 0.03))
    assert np.max(np.abs(np.diff(plain))) > 0.012
    np.testing.assert_allclose(ramped, (1.1 + 0.012 / 0.03) * low, atol=1e-15)
    np.testing.assert_allclose(
        true_mach(high, 1.1, 0.012, 0.03), true_mach(high, 1.1, 0.012), rtol=1e-12
    )
