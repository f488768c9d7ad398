"""The study of missing effects counts rightly, whatever engine it is given."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

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


def test_gap_is_closed_down_to_the_true_noise(tables: ModuleType) -> None:
    half = row("named", item(DELAY), before_rms=3.0, after_rms=np.sqrt(5.0), sigma=1.0)
    assert tables.gap_closed(half) == pytest.approx(0.5)
    assert np.isnan(tables.gap_closed(row("nothing_missing", before_rms=0.9)))
