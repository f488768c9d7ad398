"""The total-system method: what its model conserves, what it recovers, and what it costs."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from classic_ml.errors import InputError
from classic_ml.readers import TestDescription, read_raw
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.reduction import ReductionSettings, reduce_record
from comparisons.rig import CASES, RigRun, SensorSettings, simulate, write_run
from comparisons.total_system import (
    Drive,
    Facility,
    Measured,
    TotalSystemModel,
    TotalSystemSettings,
    TotalSystemState,
    cost_section,
    facility_toml,
    fit_total_system,
    measured_signals,
    read_facility,
    sensitivity_rows,
    sensitivity_table,
    start_error_table,
)
from comparisons.total_system.gauss_newton import solve
from comparisons.total_system.rig_facility import facility_of_case, rig_case_of_test
from comparisons.total_system_command import add_total_system_parser

GAS, GAMMA = 287.05, 1.4
TRUE_TAU_S = 0.018
PHI = np.array([0.0, 0.05, 0.1, 0.15])


@cache
def ideal(case: str, duration_s: float) -> tuple[RigRun, Record, TestDescription]:
    """A short record with sensors that hide nothing."""
    return _run(case, duration_s, SensorSettings.ideal())


@cache
def real(case: str, duration_s: float) -> tuple[RigRun, Record, TestDescription]:
    """A record with the paper's instrumentation."""
    return _run(case, duration_s, None)


def _run(
    case: str, duration_s: float, sensors: SensorSettings | None
) -> tuple[RigRun, Record, TestDescription]:
    run = simulate(case, seed=3, duration_s=duration_s, sensors=sensors)
    with TemporaryDirectory() as folder:
        write_run(run, Path(folder) / "run")
        record, test = read_raw(
            Path(folder) / "run" / "raw.csv", Path(folder) / "run" / "test.toml"
        )
    return run, record, test


@cache
def signals(case: str, duration_s: float) -> Measured:
    run, _, test = ideal(case, duration_s)
    return measured_signals(run.truth, test, smoothing_s=0.0)


def settings(case: str, **given: object) -> TotalSystemSettings:
    return TotalSystemSettings(facility_of_case(case), smoothing_s=0.0, **given)  # type: ignore[arg-type]


def near_truth(case: str, **given: object) -> TotalSystemSettings:
    beta = CASES[case].pressure_terms
    return settings(case, initial_beta=beta, initial_tau_s=TRUE_TAU_S, **given)


def true_curve(case: str) -> np.ndarray:
    return np.polynomial.polynomial.polyval(PHI, CASES[case].pressure_terms)


def model_of(case: str, start_s: float = np.inf, **facility: float) -> TotalSystemModel:
    plant, (_, _, test) = CASES[case], ideal(case, 2.0)
    changed = replace(facility_of_case(case), **facility)
    flow = signals(case, 2.0).near_stall_flow_kg_s
    return TotalSystemModel(test, changed, flow, plant.pressure_terms, plant.tau_s, start_s)


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
        record, test, TotalSystemSettings(facility_of_case("90"), window_s=(1.2, 2.15))
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
        settings("90", window_s=(1.3, 1.95)),
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
        near_truth("985", window_s=(1.3, 1.95), max_iterations=12),
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


@pytest.mark.parametrize("case", sorted(CASES))
def test_a_facility_survives_its_file(case: str, tmp_path: Path) -> None:
    facility = facility_of_case(case)
    file = tmp_path / "facility.toml"
    file.write_text(facility_toml(facility), "utf-8")
    assert read_facility(file) == facility
    assert rig_case_of_test(f"simulated rig, case {case}") == case
    assert rig_case_of_test("cell 7, run 12") is None


def _edit(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (_edit("discharge_m3 = 0.33637\n", ""), r"\[volumes\] discharge_m3"),
        (_edit("discharge_m3 = 0.33637", "discharge_m3 = -1"), "above 0"),
        (_edit("discharge_m3 = 0.33637", "discharge_m3 = true"), "True"),
        (_edit("discharge_m3", "discharge_m4"), "discharge_m4"),
        (_edit("[heat]", "[heta]"), r"\[heat\]"),
        (_edit("[volumes]", "[volumes"), "TOML"),
        (_edit("exhaust_pressure_frac = 0.562", "exhaust_pressure_frac = 1.5"), "below 1"),
        (_edit("work_break_1 = 0.05", "work_break_1 = 0.5"), "smaller first"),
        (lambda text: text + "\n[extra]\nx = 1\n", "extra"),
    ],
)
def test_an_unusable_facility_is_told_by_file_and_key(
    edit: Callable[[str], str], message: str, tmp_path: Path
) -> None:
    file = tmp_path / "facility.toml"
    file.write_text(edit(facility_toml(facility_of_case("985"))), "utf-8")
    with pytest.raises(InputError, match=message) as told:
        read_facility(file)
    assert "facility.toml" in str(told.value)


def test_a_missing_facility_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_facility(tmp_path / "none.toml")
    with pytest.raises(InputError, match="folder"):
        read_facility(tmp_path)
    with pytest.raises(InputError, match="985"):
        facility_of_case("986")


def test_every_number_of_a_facility_must_be_finite() -> None:
    good = facility_of_case("985")
    for field in fields(Facility):
        with pytest.raises(InputError, match=field.name):
            replace(good, **{field.name: float("nan")})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"start": "guessed"}, "start"),
        ({"nodes": "none"}, "nodes"),
        ({"switches": "none"}, "switches"),
        ({"fit_also": ("colour",)}, "fit_also"),
        ({"start_error_s": 2.0}, "start_error_s"),
        ({"volume_factor": 0.0}, "volume_factor"),
        ({"initial_tau_s": float("nan")}, "initial_tau_s"),
        ({"initial_beta": (1.0, 2.0)}, "initial_beta"),
        ({"window_s": (2.0, 1.0)}, "window_s"),
        ({"segment_s": 0.001}, "segment_s"),
        ({"horizon_s": 0.0}, "horizon_s"),
        ({"max_iterations": 0}, "max_iterations"),
    ],
)
def test_an_unusable_setting_is_told(given: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        settings("985", **given)


def _without(truth: Record, name: str, values: np.ndarray) -> Record:
    entry = LedgerEntry("test", "altered")
    return truth.after(entry, add=[Channel(name, values, truth.channel(name).unit)])


def test_a_record_that_cannot_be_used_is_told() -> None:
    run, _, test = ideal("985", 2.0)
    truth = run.truth
    chosen = settings("985")
    with pytest.raises(InputError, match="P31_Pa"):
        fit_total_system(truth.after(LedgerEntry("t", "t"), drop=["P31_Pa"]), test, chosen)
    bad = truth["P31_Pa"].copy()
    bad[7] = np.nan
    with pytest.raises(InputError, match="row 8"):
        fit_total_system(_without(truth, "P31_Pa", bad), test, chosen)
    forward = np.abs(truth["W25_kg_s"]) + 1.0
    with pytest.raises(InputError, match="no reversed flow"):
        fit_total_system(_without(truth, "W25_kg_s", forward), test, chosen)
    with pytest.raises(InputError, match="near-stall"):
        fit_total_system(replace(truth, start_s=5.0), test, chosen)
    with pytest.raises(InputError, match="horizon_s"):
        fit_total_system(truth, test, near_truth("985", start="aligned", horizon_s=5.0))
    with pytest.raises(InputError, match="segments"):
        fit_total_system(truth, test, replace(chosen, window_s=(1.4, 1.42)))
    with pytest.raises(InputError, match="smoothing_s"):
        measured_signals(truth, test, -1.0)


def test_a_model_or_table_that_cannot_be_is_told() -> None:
    model = model_of("985")
    with pytest.raises(InputError, match="tau_s"):
        replace(model, tau_s=0.0)
    with pytest.raises(InputError, match="beta"):
        replace(model, beta=(1.0, np.nan, 0.0))
    with pytest.raises(InputError, match="exhaust pressure above ambient"):
        model_of("985", exhaust_pressure_frac=0.01).constants()
    measured = signals("985", 2.0)
    with pytest.raises(InputError, match="parameter"):
        cost_section(measured, measured.test, near_truth("985"), "gamma")
    with pytest.raises(InputError, match="3 points"):
        cost_section(measured, measured.test, near_truth("985"), n_points=2)
    _, record, test = ideal("985", 2.0)
    with pytest.raises(InputError, match="methods"):
        sensitivity_rows(record, test, settings("985"), methods=("magic",))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw") / "90"
    write_run(simulate("90", duration_s=2.0, sensors=SensorSettings.ideal()), folder)
    return folder


def command(*words: object) -> None:
    parser = argparse.ArgumentParser(prog="sindy-surge")
    add_total_system_parser(parser.add_subparsers(required=True))
    arguments = parser.parse_args(["total-system", *map(str, words)])
    arguments.run(arguments)


def test_the_command_fits_a_record_of_the_rig_and_writes_what_it_found(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers, facility = tmp_path / "fit.json", tmp_path / "facility.toml"
    raw = (files / "raw.csv", "--test", files / "test.toml")
    command(*raw, "--json", numbers, "--save-facility", facility)
    shown = capsys.readouterr()
    assert "converged" in shown.out
    assert shown.err == ""
    document = json.loads(numbers.read_text("utf-8"))
    assert document["schema"] == "sindy-surge/total-system/1"
    # Averaging over a cell period, which ideal sensors do not need, rounds the switches off.
    assert document["fit"]["time_constant_s"]["value"] == pytest.approx(TRUE_TAU_S, rel=0.08)
    assert read_facility(facility) == facility_of_case("90")
    command(*raw, "--facility", facility, "--volume-factor", 1.1, "--json", numbers)
    wrong = json.loads(numbers.read_text("utf-8"))
    first = (d["fit"]["terms"][0]["coefficient"] for d in (document, wrong))
    right, biased = first
    assert biased > 1.04 * right


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--volume-factor", 0), "--volume-factor"),
        (("--start-error", 900), "--start-error"),
        (("--start", "aligned", "--horizon", 9), "--horizon"),
        (("--facility", "nowhere.toml"), "nowhere.toml"),
        (("--json", "nowhere/fit.json"), "existing folder"),
    ],
)
def test_the_command_refuses_in_one_sentence(
    files: Path, words: tuple[object, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        command(files / "raw.csv", "--test", files / "test.toml", *words)


def test_another_test_needs_its_own_facility(files: Path, tmp_path: Path) -> None:
    described = (files / "test.toml").read_text("utf-8")
    other = tmp_path / "test.toml"
    other.write_text(described.replace("simulated rig, case 90", "cell 7"), "utf-8")
    with pytest.raises(InputError, match="--facility"):
        command(files / "raw.csv", "--test", other)
