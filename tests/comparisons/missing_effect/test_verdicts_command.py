"""Every verdict through the command line: text, numbers and report of small simulated series."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from effect_data import series_of

from classic_ml.io.series import write_series
from comparisons.cli import main
from comparisons.missing_effect.catalogue import CATALOGUE
from comparisons.rig.coefficient_tests import simulate_test

SMALL = {"n_samples": 800, "n_records": 2}
# Verdict, effect that is hidden, names that are found, and what the test is made of.
CASES: dict[str, tuple[str, str | None, list[list[str]], dict[str, Any]]] = {
    "nothing": ("nothing_missing", None, [], {"seed": 1}),
    "name": ("named", "flow_inertia", [["flow_inertia"]], {"strength": 1.5}),
    "aliases": (
        "alias_set",
        "transport_delay",
        [["transport_delay", "second_order_lag"]],
        {"strength": 1.5},
    ),
    # Outside the catalogue: no name may be firm.
    "provisional": ("provisional", "sensor_quadratic", [], {"strength": 3.0, "seed": 2}),
    "unnamed": ("unnamed_term", "sensor_quadratic", [], {"strength": 3.0, "seed": 1}),
    "unexplained": ("unexplained_structure", "amplitude_memory", [], {"strength": 3.0, "seed": 1}),
    "coloured": ("noise_model_wrong", None, [], {"noise": "ar1"}),
    "noise on φ": (
        "noise_model_wrong",
        None,
        [["flow_noise"]],
        {"noise": "phi1", "seed": 1, "n_samples": 1000, "n_records": 3},
    ),
}


CANDIDATE = {"name", "accepted", "score", "train_gain", "later_gain", "other_record_gain"}
CANDIDATE |= {"held_out_z", "p_value", "time_constant_s", "parameters_added"}


@pytest.mark.parametrize("case", CASES)
def test_a_verdict_is_printed_and_written(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The pictures are drawn elsewhere.
    monkeypatch.setattr("comparisons.page.style.figure_to_data_uri", lambda _: "data:,")
    verdict, effect, names, options = CASES[case]
    files = []
    for record in series_of(simulate_test(effect, **{**SMALL, **options})):
        files.append(tmp_path / record.source)
        write_series(record, files[-1])
    numbers, page = tmp_path / "d.json", tmp_path / "d.html"
    outputs = ("--degree", 3, "--json", numbers, "--report", page)
    assert main(["diagnose", *map(str, files), *map(str, outputs)]) == 0
    said = capsys.readouterr()
    assert f"VERDICT: {verdict}" in said.out
    assert said.err == ""
    document = json.loads(numbers.read_text("utf-8"))
    assert document["schema"] == "sindy-surge/diagnose/1"
    assert document["verdict"] == verdict
    if names:
        assert [item["alias_set"] for item in document["missing"]] == names
    for item in document["missing"]:
        assert {"effect", "alias_set", "provisional", "parameters", "evidence"} <= set(item)
        assert item["provisional"] == (verdict == "provisional")
        for parameter in item["parameters"]:
            assert {"name", "value", "stderr", "unit"} <= set(parameter)
    gap = document["gap"]
    assert set(gap) == {"before_rms", "after_rms", "floor_rms", "shrink"}
    before, after, floor = (gap[f"{name}_rms"] for name in ("before", "after", "floor"))
    if names:
        share = (before**2 - after**2) / (before**2 - floor**2)
        assert gap["shrink"] == pytest.approx(max(share, 0.0), abs=1e-3)
    assert {"before", "after", "by_alias"} <= set(document["time_constant_s"])
    assert all(document["where"][name] for name in ("time", "frequency", "flow"))
    assert all(set(row) >= CANDIDATE for row in document["candidates"] if row["fitted"])
    known = {row["name"] for row in document["candidates"]} | set(document["unavailable"])
    assert {effect.name for effect in CATALOGUE} <= known
    assert verdict.replace("_", " ") in page.read_text("utf-8")
