"""From a raw record to the answer: one command, one page, one JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from commands import refused
from comparison_data import made_comparison
from raw_data import make_test

from classic_ml.records import LedgerEntry
from comparisons.cli import main
from comparisons.harness.answer import TauReading, _others, answer_of
from comparisons.rig import simulate, write_run

TAU_S = 0.018


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Run the command on a record of the rig; return its folder and what it printed."""
    folder = tmp_path_factory.mktemp("run")
    write_run(simulate("985", seed=0), folder / "rig")
    raw, test = (str(folder / "rig" / name) for name in ("raw.csv", "test.toml"))
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["run", raw, "--test", test, "--out", str(folder / "out"), "--no-twins"]) == 0
    return folder / "out", printed.getvalue()


def test_the_answer_is_right_and_holds_the_truth(made: tuple[Path, str]) -> None:
    folder, printed = made
    document = json.loads((folder / "run.json").read_text("utf-8"))
    answer = document["answer"]
    low_s, high_s = answer["time_constant_s"]["ci95"]
    assert answer["estimator"] == document["compare"]["recommended"] == "classic_ml"
    assert abs(answer["time_constant_s"]["value"] - TAU_S) < 0.0025
    assert low_s < TAU_S < high_s
    curve = answer["characteristic"]
    beta = simulate("985", seed=0).truth_parameters["beta"]
    true = np.polynomial.polynomial.polyval(np.array(curve["phi"]), beta)
    assert np.abs(np.array(curve["psi_p"]) - true).max() < 0.15
    assert curve["valid_phi"][0] <= min(curve["phi"]) < max(curve["phi"]) <= curve["valid_phi"][1]
    tau_ms = 1e3 * answer["time_constant_s"]["value"]
    assert f"{tau_ms:.1f} ± " in printed.splitlines()[1]


def test_each_step_has_its_own_document_or_the_sentence_that_refused(
    made: tuple[Path, str],
) -> None:
    document = json.loads((made[0] / "run.json").read_text("utf-8"))
    assert document["schema"] == "sindy-surge/run/1"
    for step in ("inspect", "compare", "structure", "diagnose"):
        assert document[step]["schema"] == f"sindy-surge/{step}/1"
    # Above 90 % speed T31 leaves the limits of its acquisition.
    assert "T31" in document["work"]["refused"]
    (refused,) = document["answer"]["refused"]
    assert refused.startswith("ψ is not known: it needs T31, and both T31 probes were")
    assert (made[0] / "series.csv").is_file()


def test_a_series_without_its_ledger_is_not_diagnosed(
    made: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing says how its unfiltered columns were made: it read 10.7 ms for 20.8."""
    alone = tmp_path / "alone.csv"
    alone.write_bytes((made[0] / "series.csv").read_bytes())
    assert ".ledger.json" in refused(capsys, "diagnose", alone)


def test_without_a_recommended_estimator_no_tau_is_stated_and_the_reason_is() -> None:
    comparison = made_comparison()
    entry = LedgerEntry("choose channels", "", flags=("P25_A has drifted",))
    noted = tuple(dataclasses.replace(each, history=(entry,)) for each in comparison.records)
    answer = answer_of(dataclasses.replace(comparison, records=noted, quotable=()), test="x")
    assert math.isnan(answer.time_constant_s)
    assert answer.estimator == ""
    assert re.search("`sindy-surge reduce`.* P25_A has drifted\\.$", answer.why)
    assert answer.curve is None
    held = dataclasses.replace(comparison.results[0].model, time_constant_stderr_s=0.0)
    results = (dataclasses.replace(comparison.results[0], model=held), *comparison.results[1:])
    answer = answer_of(dataclasses.replace(comparison, results=results, quotable=()))
    assert "held, not fitted" in answer.why
    bare = tuple(dataclasses.replace(each, history=()) for each in comparison.records)
    for first, said in ((0, "fits that nothing speaks against"), (1, "against every fit as well")):
        fits = comparison.results[first:]
        none = dataclasses.replace(comparison, records=bare, results=fits, quotable=())
        assert said in answer_of(none).why


def test_an_error_that_both_have_is_none_of_their_difference() -> None:
    """4 ms apart with 3 ms between them, of which 2.8 ms move both alike."""
    reading, other = ("structure", 0.022, 0.0022), TauReading("work", 0.003, 0.0002)
    readings = [TauReading(*reading), other, TauReading("orders", 0.036, 0.0162)]
    agree, apart = _others(0.018, 0.002, 0.1, readings).split("It does not agree with ")
    assert "structure 22.0 ± 2.2 ms" in agree
    assert "work 3.00 ± 0.20 ms" in apart
    assert "too uncertain to compare" in apart
    assert "does not agree" in _others(0.018, 0.002, 0.1, [TauReading(*reading, 0.1)])


@pytest.mark.parametrize("wrong", ["raw", "test", "out"])
def test_what_cannot_be_used_is_one_sentence_and_nothing_is_left(
    wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw, test = make_test().write(tmp_path)
    given = {"raw": raw, "test": test, "out": tmp_path / "out"}
    given[wrong] = raw if wrong == "out" else tmp_path / "nothing.csv"
    said = refused(capsys, "run", given["raw"], "--test", given["test"], "--out", given["out"])
    assert str(given[wrong]) in said
    assert not (tmp_path / "out").exists()
