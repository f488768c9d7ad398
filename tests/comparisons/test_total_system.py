"""The total-system method: what its model conserves, what it recovers, and what it costs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from total_system_runs import TRUE_TAU_S, ideal, model_of, near_truth, settings, signals

from classic_ml.records import Channel, LedgerEntry, Record
from comparisons.cli import main
from comparisons.rig import CASES, write_run
from comparisons.total_system import (
    TotalSystemState,
    fit_total_system,
    measured_signals,
    read_facility,
    sensitivity_rows,
    sensitivity_table,
)
from comparisons.total_system.facility import facility_of_case
from surge_core.errors import InputError
from surge_core.types import FloatArray

GAS, GAMMA = 287.05, 1.4
PHI = np.array([0.0, 0.05, 0.1, 0.15])


def surge(rows_per_step: int = 1) -> dict[str, FloatArray]:
    """A surge at rows of 0.2 ms, integrated in steps of that or of a share of it."""
    model = model_of("985", start_s=0.3)
    run = model.simulate(n_rows=6000 * rows_per_step, period_s=2e-4 / rows_per_step)
    return {name: values[::rows_per_step] for name, values in run.items()}


def test_near_stall_is_a_steady_state_while_the_throttle_stands() -> None:
    # The facility's ψ' beyond the stall point differs from the reading's by less than 1e-3.
    model = model_of("985")
    still = model.facility.throttle.model_copy(update={"close_rate_per_s": 0.0})
    facility = model.facility.model_copy(update={"throttle": still})
    run = replace(model, facility=facility).simulate(n_rows=1000, period_s=1e-3)
    for name in ("W25", "P31", "T31", "P_in", "T_in", "P_ex", "T_ex", "T25"):
        assert np.ptp(run[name]) < 2e-3 * abs(run[name][0]), name
    assert run["W_supply"][-1] == pytest.approx(run["W_exhaust"][-1], rel=2e-3)


@pytest.mark.parametrize(
    ("mass_in", "mass_out", "pressure", "temperature", "volume"),
    [
        ("W31", "W_throttle", "P31", "T31", "discharge_m3"),
        ("W_throttle", "W_exhaust", "P_ex", "T_ex", "exhaust_m3"),
        ("W_supply", "W25", "P_in", "T_in", "inlet_m3"),
    ],
)
def test_each_volume_keeps_its_mass_through_a_surge(
    mass_in: str, mass_out: str, pressure: str, temperature: str, volume: str
) -> None:
    run = surge()
    mass = run[pressure] * getattr(facility_of_case("985").volumes, volume)
    mass = mass / (GAS * run[temperature])
    net = run[mass_in] - run[mass_out]
    gained = np.concatenate([[0.0], np.cumsum(0.5 * (net[1:] + net[:-1]) * 2e-4)])
    # 2e-4 s rows leave the jumps of W31 at each switch to the trapezoidal rule.
    assert np.max(np.abs(mass - mass[0] - gained)) < 2e-3 * np.max(mass)


def test_what_flows_out_of_the_discharge_volume_takes_its_energy() -> None:
    run = surge()
    # V/(γ−1) dP/dt + c_p (W_t T31): what came in, W31 at the temperature of the work.
    heat = GAMMA * GAS / (GAMMA - 1.0)
    volume = facility_of_case("985").volumes.discharge_m3
    stored = volume / (GAMMA - 1.0) * np.gradient(run["P31"], 2e-4)
    out = heat * run["W_throttle"] * run["T31"]
    work = run["psi"] * ideal("985")[2].rotor_velocity_m_s ** 2 / 2.0
    hot = np.where(run["W31"] > 0.0, run["T25"] + work / heat, run["T31"])
    error = np.convolve(stored + out - heat * run["W31"] * hot, np.ones(50) / 50, "valid")
    assert np.sqrt(np.mean(error**2)) < 2e-3 * np.max(np.abs(out))


def test_half_the_step_changes_nothing_to_speak_of() -> None:
    # Over the first cycles; later the smallest difference grows.
    coarse, fine = surge(), surge(2)
    rows = slice(0, 2500)
    for name, tolerance in (("P31", 5e-4), ("W25", 5e-4), ("P25", 2e-3)):
        swing = np.std(fine[name][rows])
        assert np.std(coarse[name][rows] - fine[name][rows]) < tolerance * swing, name


@pytest.mark.parametrize("case", ["985", "90"])
def test_multiple_shooting_recovers_the_truth_from_ideal_sensors(case: str) -> None:
    fit = fit_total_system(signals(case), settings(case, window_s=(1.3, 1.95)))
    assert fit.state is TotalSystemState.CONVERGED
    assert fit.tau_s == pytest.approx(TRUE_TAU_S, rel=0.01)
    true = np.polynomial.polynomial.polyval(PHI, CASES[case].pressure_terms)
    assert np.max(np.abs(fit.quasi_steady(PHI) - true)) < 0.025
    assert 0.0 < fit.tau_stderr_s < 1e-3
    assert fit.n_segments >= 6


def test_it_ends_at_the_same_place_from_far_away() -> None:
    near = near_truth("90", window_s=(1.3, 1.95))
    far = replace(near, initial_beta=(1.3, 4.0, 30.0), initial_tau_s=0.035)
    a, b = (fit_total_system(signals("90"), s) for s in (near, far))
    assert a.tau_s == pytest.approx(b.tau_s, rel=2e-3)
    np.testing.assert_allclose(a.quasi_steady(PHI), b.quasi_steady(PHI), atol=5e-3)


def test_the_surge_start_is_aligned_on_the_first_reversal() -> None:
    stalled = ideal("985")[0].truth_parameters["stall_times_s"][0]
    fit = fit_total_system(signals("985"), near_truth("985", start="aligned"))
    # The rig's own latch moves within the row before.
    assert fit.start_s == pytest.approx(stalled, abs=1e-3)
    assert fit.tau_s == pytest.approx(TRUE_TAU_S, rel=0.02)
    assert fit.relative_rms["P31"] < 0.01


def test_a_fit_that_lost_the_record_says_so() -> None:
    chosen = near_truth("985", start="aligned", start_error_s=0.04, max_iterations=5)
    fit = fit_total_system(signals("985"), chosen)
    assert fit.state is TotalSystemState.LOST_THE_CYCLES


def test_a_wrong_volume_lands_in_beta_and_a_wrong_start_in_a_single_run() -> None:
    _, record, test = ideal("985")
    chosen = near_truth("985", window_s=(1.3, 1.95), max_iterations=8)
    rows = sensitivity_rows(record, test, chosen, errors=((0.01, 1.0), (0.0, 1.1)))
    found = {(row["method"], row["perturbation"]): row for row in rows}
    for wrong in ("start +10 ms", "volume x 1.1"):
        assert found["component", wrong]["curve_change"] < 0.01
        assert abs(found["component", wrong]["tau_change"]) < 0.005
    multiple = found["multiple-shooting", "volume x 1.1"]
    assert multiple["curve_change"] > 0.05
    # Measured 7 to 8 % in β₁ (both cases, ideal sensors).
    right = found["multiple-shooting", "none"]
    assert 0.04 < multiple["beta_change"][0] / right["beta"][0] < 0.12
    assert abs(found["multiple-shooting", "start +10 ms"]["tau_change"]) < 0.01
    assert found["aligned", "start +10 ms"]["curve_change"] > 0.05
    assert "start +10 ms" in sensitivity_table(rows)


def test_a_record_that_cannot_be_used_is_refused() -> None:
    run, _, test = ideal("985")

    def with_flow(values: FloatArray) -> Record:
        truth: Record = run.truth
        return truth.after(LedgerEntry("t", "t"), add=[Channel("W25_kg_s", values, "kg/s")])

    with pytest.raises(InputError, match="P31_Pa"):
        measured_signals(run.truth.without(["P31_Pa"]), test)
    with pytest.raises(InputError, match="no reversed flow"):
        measured_signals(with_flow(np.abs(run.truth["W25_kg_s"]) + 1.0), test)
    with pytest.raises(InputError, match="near-stall"):
        measured_signals(replace(run.truth, start_s=5.0), test)
    with pytest.raises(InputError, match="segments"):
        fit_total_system(signals("985"), settings("985", window_s=(1.4, 1.42)))


def test_the_command_fits_a_record_of_the_rig_and_writes_what_it_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "90"
    write_run(ideal("90")[0], folder)
    words = ["total-system", str(folder / "raw.csv"), "--test", str(folder / "test.toml")]
    numbers, facility = str(tmp_path / "fit.json"), tmp_path / "facility.toml"
    assert main([*words, "--json", numbers, "--save-facility", str(facility)]) == 0
    assert "converged" in capsys.readouterr().out
    document = json.loads(Path(numbers).read_text("utf-8"))
    assert document["schema"] == "sindy-surge/total-system/1"
    # Averaging over a cell period, which ideal sensors do not need, rounds the switches off.
    assert document["fit"]["time_constant_s"]["value"] == pytest.approx(TRUE_TAU_S, rel=0.08)
    assert read_facility(facility) == facility_of_case("90")
