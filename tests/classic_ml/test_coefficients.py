"""φ, ψ' and ψ against hand-worked states, and the limits they must obey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from raw_data import AIR, GAMMA, GAS, INERTIA_PER_M, U_M_S, make_test

from classic_ml.coefficients import (
    PSI_MINIMUM_PHI,
    coefficients,
    corrected_speed_fraction,
    flow_coefficient,
    pressure_coefficient,
    psi_is_known,
    work_coefficient,
)
from classic_ml.description import TestDescription
from classic_ml.flow import corrected_flow, corrected_from_physical
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.work.balance import with_work
from surge_core.errors import InputError

HEAT = GAMMA * GAS / (GAMMA - 1)
ONE = np.ones(5)


def test_phi_is_the_axial_velocity_over_the_rotor_s() -> None:
    mach, total_K = np.array([-0.3, 0.0, 0.525]), np.array([450.0, 400.0, 288.15])
    static = total_K / (1 + 0.2 * mach**2)
    velocity = mach * np.sqrt(GAMMA * GAS * static)
    got = flow_coefficient(corrected_flow(mach, 0.2938, AIR), total_K, 0.2938, 360.8, AIR)
    np.testing.assert_allclose(got, velocity / 360.8, atol=1e-12)
    # The design point of the machine: 174 m/s over 360.8 m/s.
    assert got[2] == pytest.approx(0.48, abs=0.005)


def test_the_design_point_of_the_machine_has_psi_p_6_45() -> None:
    got = pressure_coefficient(
        101325 * ONE, 23 * 101325 * ONE, 288.15 * ONE, 0 * ONE, 10.7, 360.8, AIR
    )
    assert got[0] == pytest.approx(6.45, abs=0.02)


def test_the_inertia_term_is_a_pressure_in_pascal() -> None:
    rate = np.array([-3.6e3, 0.0, 1.0, 3.6e3, 100.0])
    with_inertia = pressure_coefficient(1e5 * ONE, 3e5 * ONE, 450 * ONE, rate, 10.7, 334.0, AIR)
    moved = pressure_coefficient(
        1e5 * ONE, 3e5 * ONE + 10.7 * rate, 450 * ONE, 0 * ONE, 10.7, 334.0, AIR
    )
    np.testing.assert_allclose(with_inertia, moved, rtol=1e-14)
    without = pressure_coefficient(1e5 * ONE, 3e5 * ONE, 450 * ONE, rate, 0.0, 334.0, AIR)
    assert np.ptp(without) == 0.0


def test_a_negative_blading_pressure_is_refused() -> None:
    rates = np.array([0, 0, -4e5, 0, 0.0])
    with pytest.raises(InputError, match=r"P31 \+ I·dW25/dt above zero, found -4e\+06 Pa in row 3"):
        pressure_coefficient(1e5 * ONE, 2.8e5 * ONE, 450 * ONE, rates, 10.7, 334.0, AIR)


def test_steady_flow_gives_the_work_of_its_temperature_rise() -> None:
    flow = np.array([5.0, 10.0, 20.0])
    got = work_coefficient(
        flow, flow, np.full(3, 450.0), np.full(3, 630.0), np.zeros(3), 334.0, AIR
    )
    np.testing.assert_allclose(got, 2 * HEAT * 180.0 / 334.0**2, rtol=1e-12)


def test_stored_power_is_delivered_by_the_blades() -> None:
    flow, power = np.full(3, 10.0), np.array([-2e5, 0.0, 3e5])
    got = work_coefficient(flow, flow, np.full(3, 450.0), np.full(3, 630.0), power, 334.0, AIR)
    np.testing.assert_allclose(got - got[1], 2 / 334.0**2 * power / 10.0, rtol=1e-12, atol=1e-12)


def test_the_corrected_speed_falls_with_the_root_of_the_temperature() -> None:
    _, test = make_test(seconds=0.5).load()
    cold, hot = corrected_speed_fraction(np.array([255.0, 255.0 * 1.98]), test)
    assert cold == pytest.approx(0.985, abs=2e-4)
    # T25 up by (98.5/70)² = 1.98 takes N_c from 98.5 to 70 %.
    assert hot == pytest.approx(0.70, abs=2e-3)


def planes(phi: np.ndarray) -> tuple[Record, TestDescription]:
    """Plane averages of a slow sweep of φ at constant pressures, with T31 known."""
    _, test = make_test(seconds=0.5).load()
    n = phi.size
    inlet_K, inlet_Pa, exit_Pa = np.full(n, 440.0), np.full(n, 1.2e5), np.full(n, 3e5)
    velocity = phi * U_M_S
    static = inlet_K - velocity**2 / (2 * HEAT)
    mach = velocity / np.sqrt(GAMMA * GAS * static)
    corrected = corrected_flow(mach, 0.2938, test.compressor)
    flow = corrected * inlet_Pa / 101325 * np.sqrt(288.15 / inlet_K)
    record = Record.from_arrays(
        {
            "P25_Pa": (inlet_Pa, "Pa"),
            "P31_Pa": (exit_Pa, "Pa"),
            "T25_K": (inlet_K, "K"),
            "T31_K": (np.full(n, 620.0), "K"),
            "Wc25_kg_s": (corrected, "kg/s"),
            "W25_kg_s": (flow, "kg/s"),
            "W31_kg_s": (flow, "kg/s"),
        },
        sample_rate_hz=1000.0,
    )
    return record, test


def with_psi(
    record: Record, test: TestDescription, form: str = "auto", cell_period_s: float | None = None
) -> Record:
    """φ and ψ of plane averages."""
    return with_work(coefficients(record, test), test, form, cell_period_s)


def test_phi_survives_the_way_through_flow_and_back() -> None:
    phi = np.linspace(-0.05, 0.35, 400)
    record, test = planes(phi)
    np.testing.assert_allclose(coefficients(record, test)["phi"], phi, atol=1e-10)


def test_psi_is_finite_through_zero_flow_and_the_ledger_counts_the_rows() -> None:
    phi = 0.1 + 0.15 * np.sin(np.linspace(0, 20, 2000))
    record, test = planes(phi)
    light = replace(test, compressor=test.compressor.model_copy(update={"inertia_per_m": 0.0}))
    out = with_psi(record, light)
    known = psi_is_known(out["phi"])
    assert np.all(np.isfinite(out["psi"]))
    steady = 2 * HEAT * 180.0 / U_M_S**2
    np.testing.assert_allclose(out["psi"], steady, rtol=1e-6)
    entry = out.history[-1]
    assert entry.parameters["interpolated_rows"] == np.count_nonzero(~known)
    assert entry.dropped[0].count == np.count_nonzero(phi < PSI_MINIMUM_PHI)
    assert "weight 0" in entry.dropped[0].why


@pytest.mark.parametrize(
    ("invert", "form"),
    [(None, "temperature-rise"), (False, "temperature-rise"), (True, "mass-balance")],
)
def test_where_the_planes_disagree_the_form_depends_on_the_thermocouples(
    invert: bool | None, form: str
) -> None:
    record, test = planes(0.12 + 0.06 * np.sin(np.linspace(0, 20, 2000)))
    rng = np.random.default_rng(5)
    # Slow: a surge cycle is, and ψ holds the second derivative of the flow.
    error = np.convolve(rng.standard_normal(2000), np.hanning(200) / 10.0, mode="same")
    noisy = Channel("W31_kg_s", record["W31_kg_s"] + error, "kg/s")
    record = record.after(LedgerEntry("test", "W31 with noise"), add=[noisy])
    if invert is not None:
        record = record.after(LedgerEntry("thermocouples", "lag", {"invert": invert}))
    out = with_psi(record, test)
    entry = out.history[-1]
    assert entry.parameters["form"] == form
    assert "disagree by an equivalent of" in entry.flags[0]
    rows = psi_is_known(out["phi"])
    by_eq_13 = with_psi(record, test, "exit-flow")
    steady = 2 * HEAT * 180.0 / U_M_S**2
    error, eq_13 = (np.std(o["psi"][rows] - steady) for o in (out, by_eq_13))
    assert error < 0.2 * eq_13


def test_a_cell_period_averages_the_mass_balance_before_it_divides() -> None:
    phi = 0.12 + 0.05 * np.sin(2 * np.pi * 7 * np.arange(1500) / 1000)
    record, test = planes(phi)
    ripple = 0.2 * np.sin(2 * np.pi * 82.5 * np.arange(1500) / 1000)
    flow = Channel("W25_kg_s", record["W25_kg_s"] * (1 + ripple), "kg/s")
    record = record.after(LedgerEntry("test", "cells"), add=[flow])
    rows = slice(50, -50)
    raw, mean = (with_psi(record, test, "mass-balance", p)["psi"][rows] for p in (None, 1 / 82.5))
    clean = with_psi(planes(phi)[0], test, "mass-balance")["psi"][rows]
    assert np.std(mean - clean) < 0.1 * np.std(raw - clean)


def test_the_inertia_scales_its_term() -> None:
    phi = 0.1 + 0.05 * np.sin(2 * np.pi * 7 * np.arange(600) / 1000)
    record, test = planes(phi)

    def with_inertia(factor: float) -> Record:
        inertia = factor * test.compressor.inertia_per_m
        machine = test.compressor.model_copy(update={"inertia_per_m": inertia})
        return coefficients(record, replace(test, compressor=machine))

    none, one, two = (with_inertia(factor) for factor in (0.0, 1.0, 2.0))
    assert one.history[-1].parameters["inertia_per_m"] == INERTIA_PER_M
    assert np.ptp(none["psi_p"]) < 1e-9
    # ψ' is concave in the pressure, so the second half adds a little less than the first.
    first, second = one["psi_p"] - none["psi_p"], two["psi_p"] - one["psi_p"]
    assert np.corrcoef(first, second)[0, 1] > 0.999
    assert np.all(second <= first + 1e-12)
    # The mass flow is consistent with the corrected one.
    np.testing.assert_allclose(
        corrected_from_physical(record["W25_kg_s"], record["P25_Pa"], record["T25_K"]),
        record["Wc25_kg_s"],
        rtol=1e-12,
    )
