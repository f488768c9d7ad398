"""The study of missing effects counts rightly, whatever engine it is given."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import comparisons.missing_effect
from comparisons.rig.coefficient_tests import EFFECTS, OUTSIDE, simulate_test

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import effect_study

    return effect_study


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import effect_study_tables

    return effect_study_tables


def item(effect: str, *aliases: str, provisional: bool = False) -> dict[str, Any]:
    return {"effect": effect, "alias_set": [effect, *aliases], "provisional": provisional}


def row(verdict: str, *missing: dict[str, Any], **changes: Any) -> dict[str, Any]:
    usual = {
        "kind": "effect",
        "planted": ["transport_delay"],
        "strength": 1.5,
        "reached": {"transport_delay": 1.5},
        "noise": "white",
        "seed": 0,
        "n_samples": 2000,
        "tau_true_s": 0.1,
        "sigma": 1.0,
        "verdict": verdict,
        "missing": list(missing),
        "error": "",
        "before_rms": 2.0,
        "after_rms": 1.0,
        "floor_rms": 1.0,
        "shrink": 1.0,
        "tau_before_s": 0.105,
        "tau_after_s": 0.1001,
        "seconds": 0.5,
    }
    return usual | changes


DELAY, SECOND, BIAS = "transport_delay", "second_order_lag", "bias_drift"


@pytest.mark.parametrize(
    ("verdict", "missing", "wanted"),
    [
        ("named", [item(DELAY)], "unique"),
        ("alias_set", [item(DELAY, SECOND)], "set"),
        ("alias_set", [item(SECOND, DELAY)], "set"),
        ("named", [item(SECOND)], "WRONG"),
        ("named", [item(DELAY), item(BIAS)], "extra"),
        ("alias_set", [item(SECOND, DELAY), item(DELAY, SECOND)], "set"),
        ("provisional", [item(DELAY, provisional=True)], "prov. right"),
        ("provisional", [item(BIAS, provisional=True)], "prov. other"),
        ("unnamed_term", [item("phi^2 dphi")], "unnamed"),
        ("unexplained_structure", [], "unexpl."),
        ("noise_model_wrong", [], "noise"),
        ("nothing_missing", [], "missed"),
    ],
)
def test_outcome_of_one_effect(
    tables: ModuleType, verdict: str, missing: list[dict[str, Any]], wanted: str
) -> None:
    assert wanted in tables.OUTCOMES
    assert tables.outcome(row(verdict, *missing)) == wanted


def test_what_is_ranked_first(tables: ModuleType) -> None:
    first = tables.first_ranked
    assert first(row("alias_set", item(SECOND, DELAY))) == SECOND
    assert first(row("provisional", item(BIAS, provisional=True))) == BIAS
    assert first(row("unnamed_term", item("phi psi"))) == "unnamed_term"
    assert first(row("nothing_missing")) == "nothing_missing"
    assert first(row("", error="ValueError: no")) == "error"
    assert {*EFFECTS, "flow_noise"} < set(tables.SHORT)


@pytest.mark.parametrize(
    ("noise", "verdict", "name", "n_false"),
    [
        ("white", "named", "flow_noise", 1),
        ("phi3", "named", "flow_noise", 0),
        ("phi1", "named", BIAS, 1),
        ("ar1", "noise_model_wrong", None, 0),
        ("t3", "provisional", BIAS, 0),
        ("white", "nothing_missing", None, 0),
        ("white", "unnamed_term", "phi psi", 0),
    ],
)
def test_false_names(
    tables: ModuleType, noise: str, verdict: str, name: str | None, n_false: int
) -> None:
    missing = [item(name, provisional=verdict == "provisional")] if name else []
    null = row(verdict, *missing, kind="null", planted=[], noise=noise)
    assert len(tables.false_names(null)) == n_false


@pytest.mark.parametrize(
    ("verdict", "missing", "wanted"),
    [
        ("named", [item(DELAY), item(BIAS)], "both"),
        ("alias_set", [item(SECOND, DELAY), item(BIAS)], "both"),
        ("named", [item(DELAY), item(BIAS), item("hysteresis")], "both +"),
        ("named", [item(BIAS)], "one"),
        ("provisional", [item(BIAS), item("hysteresis")], "prov. one +"),
        ("unexplained_structure", [], "prov. none"),
    ],
)
def test_outcome_of_a_pair(
    tables: ModuleType, verdict: str, missing: list[dict[str, Any]], wanted: str
) -> None:
    assert tables.pair_outcome(row(verdict, *missing, planted=[DELAY, BIAS])) == wanted


def test_figures_count_what_they_say(tables: ModuleType) -> None:
    rows = [row("named", item(DELAY)) for _ in range(6)]
    rows += [row("alias_set", item(SECOND, DELAY)), row("provisional", item(DELAY))]
    rows += [row("named", item(BIAS)), row("named", item(DELAY), item(BIAS))]
    rows += [row("named", item("hysteresis"), planted=["characteristic_shape"])]
    rows += [row("nothing_missing", kind="null", planted=[]) for _ in range(3)]
    rows += [row("named", item(BIAS), kind="null", planted=[])]
    weak = {OUTSIDE[0]: 1.2}
    rows += [row("named", item(BIAS), kind="outside", planted=[OUTSIDE[0]], reached=weak)]
    told = " ".join(tables.figures(rows).split())
    assert "exact-form effects, 10 tests" in told
    assert "truth inside the named set 90.0 % (wanted: 99; firmly 80.0)" in told
    assert "named uniquely and rightly 60.0 %" in told
    assert "largest set 2 " in told
    assert "wrong names 20.00 % (wanted: at most 0.3; 1 of 2 beside the right one)" in told
    assert "a bump in the characteristic, 1 tests" in told
    assert "white 1 of 4" in told
    assert "in 1000 250.0" in told
    assert "firm names 1 (wanted: none)" in told
    assert "held-out gap closed at 1.5 sigma 100.0 %" in told
    assert "error of tau after 0.100 % (median, wanted: at most 0.2; before 5.000)" in told
    assert "a diagnosis 0.50" in told
    assert told.endswith(f"stronger: {{'{OUTSIDE[0]}': 1}}")
    listed = tables.failures(rows)
    assert listed.count("seed") == 5
    # The rule of three.
    assert tables.upper_bound(0, 1000) == pytest.approx(3.0 / 1000.0, rel=0.01)
    assert tables.upper_bound(1, 1) == 1.0


def test_gap_is_closed_down_to_the_true_noise(tables: ModuleType) -> None:
    half = row("named", item(DELAY), before_rms=3.0, after_rms=np.sqrt(5.0), sigma=1.0)
    assert tables.gap_closed(half) == pytest.approx(0.5)
    assert np.isnan(tables.gap_closed(row("nothing_missing", before_rms=0.9)))


def test_time_by_length(tables: ModuleType) -> None:
    rows = [
        row("nothing_missing", kind="speed", n_samples=n, seconds=n / 4000.0)
        for n in (1000, 2000, 4000)
    ]
    assert "power 1.00" in tables.speed_table(rows)


def answer(*names: str) -> SimpleNamespace:
    return SimpleNamespace(
        verdict="named" if names else "nothing_missing",
        missing=tuple(SimpleNamespace(effect=n, alias_set=(n,), provisional=False) for n in names),
        gap=SimpleNamespace(before_rms=2.0, after_rms=1.0, floor_rms=1.0, shrink=1.0),
        tau_before_s=0.1,
        tau_after_s=0.1,
        tau_by_alias_s=dict.fromkeys(names, 0.1),
    )


def test_study_of_an_engine_that_always_says_the_same(
    study: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    seen: list[bool] = []

    def diagnose(records: Any, degree: int) -> SimpleNamespace:
        assert degree == 3
        assert [r.time_s[0] for r in records] == sorted(r.time_s[0] for r in records)
        seen.append(records[0].in_stall is not None)
        return answer(BIAS)

    monkeypatch.setattr(comparisons.missing_effect, "diagnose", diagnose, raising=False)
    file = tmp_path / "rows.json"
    effects = f"{BIAS},sensitivity_drift"
    arguments = ["--seeds", "2", "--null-seeds", "1", "--strengths", "3", "--effects", effects]
    study.main([*arguments, "--only", "effects,nulls,pairs", "--json", str(file)])
    told = capsys.readouterr().out
    rows = json.loads(file.read_text("utf-8"))
    assert len(rows) == 2 * 2 + 6 + 5 * 2
    # The flag is in the records of even seeds: the warm-up and half of the pairs and effects.
    assert 0 < sum(seen) < len(seen)
    flat = " ".join(told.split())
    assert "named uniquely and rightly 50.0 %" in flat
    assert "in 1000 1000.0" in flat
    assert "flow_inertia + bias_drift 2" in flat
    right = {
        row["planted"][0] for row in rows if row["kind"] == "effect" and row["pysindy"]["right"]
    }
    assert right == {BIAS, "sensitivity_drift"}
    study.main(["--from", str(file)])
    assert capsys.readouterr().out == told


def test_study_outlives_an_engine_that_breaks(
    study: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def diagnose(records: Any, degree: int) -> SimpleNamespace:
        raise ArithmeticError(f"{len(records)} records of degree {degree}")

    monkeypatch.setattr(comparisons.missing_effect, "diagnose", diagnose, raising=False)
    arguments = ["--seeds", "1", "--strengths", "1.5", "--effects", BIAS, "--without-pysindy"]
    study.main([*arguments, "--only", "effects"])
    told = capsys.readouterr().out
    assert "ArithmeticError: 3 records of degree 3" in told


def test_what_the_study_plants(study: ModuleType) -> None:
    cases = study.cases_of(study.options_of(["--seeds", "20"]))
    kinds = [case.kind for case in cases]
    assert kinds.count("effect") == 15 * 20 * 3
    assert kinds.count("null") >= 1000
    assert kinds.count("outside") == len(OUTSIDE) * 20 * 3
    assert kinds.count("pair") == 5 * 20
    assert {case.noise for case in cases if case.kind == "null"} == {
        "white", "ar1", "t3", "outliers", "phi1", "phi3",
    }  # fmt: skip
    alone = study.cases_of(study.options_of(["--only", "pysindy", "--null-seeds", "1"]))
    assert {case.kind for case in alone} == {"effect", "null"}
    with pytest.raises(SystemExit):
        study.options_of(["--only", "efects"])


def test_published_recipe_finds_what_it_can_say(study: ModuleType) -> None:
    import effect_study_pysindy as recipe

    assert len(recipe.TERMS) == 17
    assert tuple(recipe.RIGHT_TERMS) == EFFECTS
    for right in recipe.RIGHT_TERMS.values():
        assert right is None or set(right) < set(recipe.TERMS)
    for name in ("bias_drift", "asymmetric_lag", "second_order_lag"):
        test = simulate_test(name, strength=5.0, seed=1, n_records=2)
        terms, explained = recipe.sparse_discrepancy(test.records, 3)
        assert terms[0] in recipe.RIGHT_TERMS[name]
        assert 0.0 < explained < 1.0
