"""The command `diagnose`: known truths, what is written, and every bad option.

The records come from the simulated tests at the level of coefficients, which share no code with
what finds the effect again.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused, run
from effect_data import series_of

from classic_ml.io.series import read_series, write_series
from comparisons.missing_effect.base_terms import discovered_terms
from comparisons.rig.coefficient_tests import CoefficientTest, simulate_test

N = 1000


def written(test: CoefficientTest, folder: Path) -> list[Path]:
    """The records of a test as series files."""
    paths = []
    for record in series_of(test):
        paths.append(folder / record.source)
        write_series(record, paths[-1])
    return paths


class Case:
    """A test with its truth, and what the command wrote of it."""

    def __init__(self, folder: Path, effect: str | None, *options: object) -> None:
        self.test = simulate_test(effect, strength=2.0, seed=3, n_samples=N)
        self.folder = folder
        self.paths = written(self.test, folder)
        self.model, self.page = folder / "model.json", folder / "page.html"
        self.numbers = folder / "numbers.json"
        self.code = run("diagnose", *self.paths, "--json", self.numbers, *options)

    @property
    def document(self) -> dict[str, Any]:
        document: dict[str, Any] = json.loads(self.numbers.read_text("utf-8"))
        return document


@pytest.fixture(scope="module")
def branch(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Records with a hidden hysteresis, and all that is written of them."""
    folder = tmp_path_factory.mktemp("branch")
    outputs = ("--report", folder / "page.html", "--save", folder / "model.json")
    return Case(folder, "hysteresis", "--degree", 3, *outputs)


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Records in which nothing is hidden."""
    return Case(tmp_path_factory.mktemp("untouched"), None, "--degree", 3)


def test_a_hidden_hysteresis_is_named_with_its_number_and_tau(branch: Case) -> None:
    assert branch.code == 0
    document = branch.document
    assert document["verdict"] == "named"
    (item,) = document["missing"]
    assert item["effect"] == "hysteresis"
    truth = branch.test.effects["hysteresis"]
    found = {p["name"]: p for p in item["parameters"]}
    for name, value in (("Delta", "step"), ("phi_lo", "phi_lo"), ("phi_hi", "phi_hi")):
        assert abs(found[name]["value"] - truth[value]) < 4.0 * found[name]["stderr"]
    tau = document["time_constant_s"]
    assert abs(tau["after"] - branch.test.tau_s) < 4.0 * tau["after_stderr"]
    assert abs(tau["after"] - branch.test.tau_s) < 0.2 * abs(tau["before"] - branch.test.tau_s)
    gap = document["gap"]
    assert gap["floor_rms"] == pytest.approx(branch.test.sigma, rel=0.05)
    assert gap["shrink"] > 0.9
    assert document["base"] == {
        "terms": ["1", "phi", "phi^2", "phi^3"],
        "source": "polynomial",
        "degree": 3,
    }


def test_the_saved_model_simulates_the_records(branch: Case) -> None:
    from comparisons.missing_effect.extended_file import load_extended

    (model,) = load_extended(branch.model).values()
    assert model.time_constant_s == pytest.approx(branch.document["time_constant_s"]["after"])
    assert [added.name for added in model.effects] == ["hysteresis"]
    record = read_series(branch.paths[2])
    left = (model.simulate(record) - record.psi_p)[200:]
    assert float(np.sqrt(np.mean(left**2))) < 1.1 * branch.test.sigma


def test_a_delay_comes_out_as_an_alias_set_on_a_discovered_base(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = Case(tmp_path, "transport_delay", "--base", "sindy")
    document = case.document
    assert case.code == 0
    names = document["missing"][0]["alias_set"]
    assert "transport_delay" in names
    assert document["base"]["source"] == "sindy"
    assert document["base"]["terms"] != ["1", "phi", "phi^2"]
    tau = document["time_constant_s"]["by_alias"]["transport_delay"]
    assert tau == pytest.approx(case.test.tau_s, rel=0.01)
    out = capsys.readouterr().out
    assert f"VERDICT: {document['verdict']}" in out
    assert out.rstrip().endswith(f"numbers: {case.numbers}")


def test_the_discovered_base_does_not_see_what_is_held_out(untouched: Case) -> None:
    records = [read_series(path) for path in untouched.paths]
    found = discovered_terms(records)
    other = records[2].psi_p.copy()
    other += 0.3 * np.sin(40.0 * records[2].phi)
    assert discovered_terms([*records[:2], replace(records[2], psi_p=other)]) == found
    assert {"1", "phi^2", "phi^3"} <= set(found[0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--degree", 0), "a whole number from 1 to 8"),
        (("--base", "ml"), "choose from 'polynomial', 'sindy'"),
    ],
)
def test_options_that_cannot_be_are_refused(
    untouched: Case, capsys: pytest.CaptureFixture[str], options: tuple[object, ...], words: str
) -> None:
    with pytest.raises(SystemExit) as refused:
        run("diagnose", *untouched.paths, *options)
    assert refused.value.code == 2
    assert words in capsys.readouterr().err


def test_records_that_cannot_be_used_are_refused_in_one_sentence(
    untouched: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = untouched.paths[0].read_text("utf-8").splitlines(keepends=True)
    short = tmp_path / "short.csv"
    short.write_text("".join(lines[:110]), "utf-8")
    for files, words in (
        ([untouched.paths[0], untouched.paths[0]], "each record once"),
        ([short], "rows to hold out"),
        ([tmp_path / "none.csv"], "none.csv"),
        ([tmp_path], "found a folder"),
        ([untouched.paths[0], "--max-effects", 9], "a whole number from 1 to 3, found 9"),
        ([untouched.paths[0], "--max-effects", 0], "a whole number from 1 to 3, found 0"),
    ):
        assert words in refused(capsys, "diagnose", *files)


def test_a_model_without_a_name_is_not_saved_and_no_error(
    untouched: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = simulate_test("nonlinear_relaxation", strength=2.0, seed=0, n_samples=N)
    paths = written(test, tmp_path)
    target = tmp_path / "model.json"
    assert run("diagnose", *paths, "--degree", 3, "--save", target, "--max-effects", 1) == 0
    out = capsys.readouterr().out
    assert "VERDICT: unnamed_term" in out
    assert "model: not saved" in out
    assert not target.exists()
