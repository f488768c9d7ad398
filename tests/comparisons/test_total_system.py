"""The total-system method: what its model conserves, what it recovers, and what it costs."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from total_system_runs import TRUE_TAU_S, ideal, model_of, near_truth, real, settings, signals

from classic_ml.reduction import ReductionSettings, reduce_record
from comparisons.rig import CASES
from comparisons.total_system import (
    Drive,
    TotalSystemSettings,
    TotalSystemState,
    cost_section,
    fit_total_system,
    sensitivity_rows,
    sensitivity_table,
    start_error_table,
)
from comparisons.total_system.gauss_newton import solve
from comparisons.total_system.rig_facility import facility_of_case

GAS, GAMMA = 287.05, 1.4
PHI = np.array([0.0, 0.05, 0.1, 0.15])


def true_curve(case: str) -> np.ndarray:
    return np.polynomial.polynomial.polyval(PHI, CASES[case].pressure_terms)


def still_air(case: str = "985") -> Drive:
    return Drive(0.0, 1e-3, np.full(2, CASES[case].supply_temperature_k))


def surge(case: str = "985", steps_per_second: float = 5000.0) -> dict[str, np.ndarray]:
    model = model_of(case, start_s=0.3)
    return dict(
        model.simulate(
            still_air(case), n_rows=6000, period_s=2e-4, steps_per_second=steps_per_second
        )
    )


def test_near_stall_is_a_steady_state_while_the_throttle_stands() -> None:
    # The facility's ψ' beyond the stall point differs from the reading's by less than 1e-3.
    run = model_of("985", close_rate_per_s=0.0).simulate(still_air(), n_rows=1000, period_s=1e-3)
    for name in ("W25", "P31", "T31", "P_in", "T_in", "P_ex", "T_ex", "T25"):
        assert np.ptp(run[name]) < 2e-3 * abs(run[name][0]), name
    assert run["W_supply"][-1] == pytest.approx(run["W_exhaust"][-1], rel=2e-3)


@pytest.mark.parametrize(
    ("mass_in", "mass_out", "pressure", "temperature", "volume"),
    [
        ("W31", "W_throttle", "P31", "T31", "discharge_volume_m3"),
        ("W_throttle", "W_exhaust", "P_ex", "T_ex", "exhaust_volume_m3"),
        ("W_supply", "W25", "P_in", "T_in", "inlet_volume_m3"),
    ],
)
def test_each_volume_keeps_its_mass_through_a_surge(
    mass_in: str, mass_out: str, pressure: str, temperature: str, volume: str
) -> None:
    run = surge()
    mass = run[pressure] * getattr(facility_of_case("985"), volume) / (GAS * run[temperature])
    net = run[mass_in] - run[mass_out]
    gained = np.concatenate([[0.0], np.cumsum(0.5 * (net[1:] + net[:-1]) * 2e-4)])
    # 2e-4 s rows leave the jumps of W31 at each switch to the trapezoidal rule.
    assert np.max(np.abs(mass - mass[0] - gained)) < 2e-3 * np.max(mass)


def test_what_flows_out_of_the_discharge_volume_takes_its_energy() -> None:
    run = surge()
    facility = facility_of_case("985")
    # V/(γ−1) dP/dt + c_p (W_t T31): what came in, W31 at the temperature of the work.
    heat = GAMMA * GAS / (GAMMA - 1.0)
    stored = facility.discharge_volume_m3 / (GAMMA - 1.0) * np.gradient(run["P31"], 2e-4)
    out = heat * run["W_throttle"] * run["T31"]
    work = run["psi"] * ideal("985", 2.0)[2].rotor_velocity_m_s ** 2 / 2.0
    hot = np.where(run["W31"] > 0.0, run["T25"] + work / heat, run["T31"])
    into = heat * run["W31"] * hot
    smooth = np.ones(50) / 50
    error = np.convolve(stored + out - into, smooth, "valid")
    assert np.sqrt(np.mean(error**2)) < 2e-3 * np.max(np.abs(out))


@pytest.mark.parametrize("case", ["985", "90"])
def test_half_the_step_changes_nothing_to_speak_of(case: str) -> None:
    # Over the first cycles; later the smallest difference grows.
    coarse, fine = surge(case, 5000.0), surge(case, 10_000.0)
    rows = slice(0, 2500)
    for name, tolerance in (("P31", 5e-4), ("W25", 5e-4), ("P25", 2e-3)):
        swing = np.std(fine[name][rows])
        assert np.std(coarse[name][rows] - fine[name][rows]) < tolerance * swing, name


@pytest.mark.parametrize("case", ["985", "90"])
def test_told_the_truth_it_follows_the_rig_through_the_blowdown(case: str) -> None:
    measured = signals(case, 2.0)
    chosen = near_truth(case, start="aligned", max_iterations=3)
    fit = fit_total_system(measured, measured.test, chosen)
    assert fit.relative_rms["P31"] < 0.01
    assert fit.relative_rms["W25"] < 0.05


def test_the_measured_t25_holds_a_long_run_near_the_record() -> None:
    # T25 swings with the record's own cycles: a run that it drives is pulled towards them.
    measured = signals("985", 4.0)
    free = near_truth("985", start="aligned", horizon_s=3.0)
    held = replace(free, measured_t25=True)
    misfit = [
        np.median(cost_section(measured, measured.test, s, "tau", span=0.02, n_points=8).P31_rms)
        for s in (free, held)
    ]
    assert misfit[1] < 0.6 * misfit[0]


@pytest.mark.parametrize("case", ["985", "90"])
@pytest.mark.parametrize("nodes", ["fitted", "measured"])
def test_multiple_shooting_recovers_the_truth_from_ideal_sensors(case: str, nodes: str) -> None:
    measured = signals(case, 2.0)
    fit = fit_total_system(
        measured, measured.test, settings(case, nodes=nodes, window_s=(1.3, 1.95))
    )
    assert fit.state is TotalSystemState.CONVERGED
    assert fit.tau_s == pytest.approx(TRUE_TAU_S, rel=0.01)
    assert np.max(np.abs(fit.characteristic(PHI)[0] - true_curve(case))) < 0.025
    assert fit.cost_trace[-1] >= 0.0
    assert fit.n_segments >= 6


def test_it_ends_at_the_same_place_from_far_away() -> None:
    measured = signals("90", 2.0)
    near = near_truth("90", window_s=(1.3, 1.95))
    far = replace(near, initial_beta=(1.3, 4.0, 30.0), initial_tau_s=0.035)
    a, b = (fit_total_system(measured, measured.test, s) for s in (near, far))
    assert a.tau_s == pytest.approx(b.tau_s, rel=2e-3)
    np.testing.assert_allclose(a.characteristic(PHI)[0], b.characteristic(PHI)[0], atol=5e-3)


def test_a_raw_record_and_its_reduction_give_the_same() -> None:
    run, record, test = ideal("90", 2.0)
    chosen = settings("90", window_s=(1.3, 1.95), nodes="measured")
    from_raw = fit_total_system(record, test, chosen)
    from_truth = fit_total_system(run.truth, test, chosen)
    assert from_raw.tau_s == pytest.approx(from_truth.tau_s, rel=1e-4)
    # The thermocouples of ideal sensors have no lag, so that T25 needs no inversion.
    reduction = reduce_record(record, test, ReductionSettings(phase="none"))
    from_reduction = fit_total_system(reduction, test, chosen)
    assert from_reduction.tau_s == pytest.approx(from_truth.tau_s, rel=1e-4)


def test_the_surge_start_is_fitted_or_aligned_on_the_first_reversal() -> None:
    measured, truth = signals("985", 2.0), ideal("985", 2.0)[0].truth_parameters
    stalled = truth["stall_times_s"][0]
    for start in ("aligned", "fitted"):
        fit = fit_total_system(measured, measured.test, near_truth("985", start=start))
        # The rig's own latch moves within the row before.
        assert fit.start_s == pytest.approx(stalled, abs=1e-3)
        assert fit.tau_s == pytest.approx(TRUE_TAU_S, rel=0.02)
    assert fit.others["start"][0] == fit.start_s


def test_a_wrong_volume_is_found_when_it_is_fitted() -> None:
    measured = signals("90", 2.0)
    chosen = settings("90", window_s=(1.3, 1.95), volume_factor=1.1, fit_also=("volume",))
    fit = fit_total_system(measured, measured.test, chosen)
    assert fit.others["volume"][0] == pytest.approx(1.0 / 1.1, rel=0.01)
    assert fit.tau_s == pytest.approx(TRUE_TAU_S, rel=0.02)


def test_real_sensors_and_a_true_facility_give_tau_within_a_tenth() -> None:
    _, record, test = real("90", 2.2)
    fit = fit_total_system(
        record, test, TotalSystemSettings(facility_of_case("90"), window_s=(1.2, 1.75))
    )
    assert fit.state is TotalSystemState.CONVERGED
    assert fit.tau_s == pytest.approx(TRUE_TAU_S, rel=0.1)
    assert np.max(np.abs(fit.characteristic(PHI)[0] - true_curve("90"))) < 0.1
    assert 0.0 < fit.tau_stderr_s < 2e-3


def test_one_run_beyond_the_first_cycle_has_a_needle_and_many_minima() -> None:
    measured = signals("985", 4.0)
    long = cost_section(
        measured, measured.test, near_truth("985", start="aligned", horizon_s=2.5), n_points=21
    )
    short = cost_section(
        measured, measured.test, near_truth("985", start="aligned", horizon_s=0.3), n_points=21
    )
    many = cost_section(
        measured, measured.test, near_truth("985", window_s=(1.3, 2.6)), n_points=21
    )
    assert long.n_minima >= 4
    assert max(abs(edge) for edge in long.basin) <= 0.03
    assert short.n_minima == many.n_minima == 1
    for section in (short, many):
        assert section.basin == pytest.approx((-0.1, 0.1), abs=1e-12)


@pytest.fixture(scope="module")
def wrong_volume() -> dict[tuple[str, str], tuple[float, np.ndarray, float]]:
    _, record, test = ideal("90", 2.0)
    rows = sensitivity_rows(
        record,
        test,
        settings("90", window_s=(1.3, 1.7)),
        start_errors_s=(0.04,),
        methods=("component", "multiple-shooting"),
    )
    return {
        (r.method, r.perturbation): (r.curve_change, np.array(r.beta), r.tau_change) for r in rows
    }


def test_a_wrong_volume_lands_in_beta(
    wrong_volume: dict[tuple[str, str], tuple[float, np.ndarray, float]],
) -> None:
    told_right = wrong_volume["multiple-shooting", "none"][1]
    curve, beta, _ = wrong_volume["multiple-shooting", "volume x 1.1"]
    assert curve > 0.05
    # Measured 7 to 8 % in β₁ and −16 % in β₃ (both cases, ideal sensors).
    assert 0.04 < beta[0] / told_right[0] - 1.0 < 0.12
    assert -0.25 < beta[2] / told_right[2] - 1.0 < -0.08


def test_the_component_method_moves_with_neither(
    wrong_volume: dict[tuple[str, str], tuple[float, np.ndarray, float]],
) -> None:
    for perturbation in ("start +40 ms", "volume x 1.1"):
        curve, _, tau = wrong_volume["component", perturbation]
        assert curve < 0.01
        assert abs(tau) < 0.005
    # Recomputed, not copied: 40 ms later other rows are matched with the near-stall reading.
    assert wrong_volume["component", "start +40 ms"][0] > 0.0


def test_a_start_error_spoils_a_single_run_and_not_multiple_shooting() -> None:
    _, record, test = ideal("985", 2.0)
    rows = start_error_table(
        record,
        test,
        near_truth("985", window_s=(1.3, 1.95), max_iterations=6),
        start_errors_s=(0.002, 0.01),
        methods=("multiple-shooting", "aligned"),
    )
    change = {(r.method, r.start_error_s): r for r in rows}
    assert (
        change["aligned", 0.002].curve_change > 3 * change["multiple-shooting", 0.01].curve_change
    )
    assert change["aligned", 0.01].curve_change > 0.05
    assert abs(change["multiple-shooting", 0.01].tau_change) < 0.01
    text = sensitivity_table(rows)
    assert len(text.splitlines()) == 2 + len(rows) + 2
    assert "start +10 ms" in text
    json.dumps([row.to_json() for row in rows])


def test_a_fit_that_lost_the_record_says_so() -> None:
    measured = signals("985", 2.0)
    chosen = near_truth("985", start="aligned", start_error_s=0.04, max_iterations=5)
    fit = fit_total_system(measured, measured.test, chosen)
    assert fit.state is TotalSystemState.LOST_THE_CYCLES
    assert "multiple shooting" in fit.state.advice


def test_the_search_solves_a_linear_problem_with_nuisance_states() -> None:
    rng = np.random.default_rng(5)
    common, nodes = np.array([1.0, -2.0]), rng.normal(size=(30, 1))
    designs = [rng.normal(size=(12, 2)) for _ in range(30)]
    data = [d @ common + n + 0.1 * rng.normal(size=12) for d, n in zip(designs, nodes, strict=True)]

    def residuals(z: np.ndarray, own: np.ndarray) -> list[np.ndarray]:
        return [d @ z + n - y for d, n, y in zip(designs, own, data, strict=True)]

    found = solve(residuals, np.zeros(2), np.zeros((30, 1)), max_iterations=30, tolerance=1e-12)
    assert found is not None
    assert found.converged
    # Ordinary least squares with a dummy a segment.
    full = np.block([[d, np.eye(30)[[i]].repeat(12, axis=0)] for i, d in enumerate(designs)])
    expected = np.linalg.lstsq(full, np.concatenate(data), rcond=None)[0]
    np.testing.assert_allclose(found.common, expected[:2], atol=1e-6)
    np.testing.assert_allclose(found.nodes[:, 0], expected[2:], atol=1e-6)
    # 330 rows left for a noise of 0.1: the sandwich agrees with the textbook within its scatter.
    textbook = 0.1**2 * np.linalg.inv(full.T @ full)[:2, :2]
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(textbook), rtol=0.7)


def test_parameters_that_do_nothing_are_told() -> None:
    def residuals(z: np.ndarray, own: np.ndarray) -> list[np.ndarray]:
        return [np.full(5, z[0] - 1.0) for _ in range(8)]

    found = solve(residuals, np.zeros(2), np.zeros((8, 0)), max_iterations=10)
    assert found is not None
    assert found.singular
    assert np.all(np.isnan(found.covariance))
