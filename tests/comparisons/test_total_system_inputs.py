"""The total-system method as it is asked: facilities, settings, records and the command."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from total_system_runs import TRUE_TAU_S, ideal, model_of, near_truth, settings, signals

from classic_ml.records import Channel, LedgerEntry, Record
from comparisons.cli.total_system import add_total_system_parser
from comparisons.rig import CASES, SensorSettings, simulate, write_run
from comparisons.total_system import (
    Facility,
    cost_section,
    facility_toml,
    fit_total_system,
    measured_signals,
    read_facility,
    sensitivity_rows,
)
from comparisons.total_system.rig_facility import facility_of_case, rig_case_of_test
from surge_core.errors import InputError


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
        (_edit("discharge_m3 = 0.33637", "discharge_m3 = true"), "found true"),
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
