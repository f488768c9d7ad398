"""The JSON of a diagnosis: the contract for every verdict, strict and whole."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_diagnosis import Told, made_diagnosis

from comparisons.missing_effect.document import diagnosis_document
from comparisons.missing_effect.shown import where_of
from surge_core.files import to_strict_json

PANELS = ("time", "frequency", "flow")


def document_of(verdict: str) -> dict[str, Any]:
    d = made_diagnosis(verdict)
    written = to_strict_json(diagnosis_document(d, where_of(d)))
    parsed: dict[str, Any] = json.loads(written, parse_constant=_refuse)
    return parsed


def _refuse(word: str) -> None:
    raise AssertionError(f"JSON has no {word}")


def test_tau_stands_under_every_name_of_an_alias_set() -> None:
    document = document_of("alias_set")
    assert document["missing"][0]["alias_set"] == ["transport_delay", "second_order_lag"]
    tau = document["time_constant_s"]
    assert tau["by_alias"] == {"transport_delay": pytest.approx(0.1), "second_order_lag": 0.1043}
    assert tau["before"] == pytest.approx(0.11)
    assert tau["after_stderr"] == 0.0004
    assert [row["name"] for row in document["candidates"] if row["alias"]] == [
        "transport_delay",
        "second_order_lag",
    ]


def test_place_label_and_doubts_stand_beside_each_name() -> None:
    (item,) = document_of("named")["missing"]
    assert item["label"] == "hysteresis in the characteristic ψ'_QS"
    assert item["place"] == {"port": "characteristic"}
    assert item["alias_labels"] == [item["label"]]
    assert item["doubts"] == []
    assert all(item["doubts"] for item in document_of("provisional")["missing"])


def test_what_is_not_known_is_null() -> None:
    d = made_diagnosis("named")
    step = d.rounds[0]
    first = step.candidates[0]
    alone = replace(first, evidence=replace(first.evidence, other=math.nan))
    d = replace(d, rounds=(replace(step, candidates=(alone, *step.candidates[1:])),))
    document = json.loads(to_strict_json(diagnosis_document(d, None)))
    assert document["candidates"][0]["other_record_gain"] is None
    assert document["where"] == {name: [] for name in PANELS}


def test_limits_and_separation_are_null_until_they_are_looked_for() -> None:
    d = made_diagnosis("alias_set")
    plain = diagnosis_document(d, None)
    assert plain["limits"] is None
    assert plain["separation"] is None
    asked = diagnosis_document(d, None, Told("a"), Told("b"), base={"source": "sindy"})
    assert asked["limits"] == {"lines": ["a"]}
    assert asked["separation"] == {"lines": ["b"]}
    assert asked["base"] == {"terms": ["1", "phi", "phi^2"], "source": "sindy"}


def test_both_branches_of_a_hysteresis_are_written() -> None:
    model = document_of("named")["model"]["after"]
    falling, rising = model["characteristic"]
    phi = np.array(falling["phi"])
    apart = np.array(falling["psi_p"]) - np.array(rising["psi_p"])
    between = (phi > 0.13) & (phi < 0.30)
    # The lower branch, Δ below, holds on the way up between the thresholds alone.
    np.testing.assert_allclose(apart[between], 0.021, atol=1e-12)
    np.testing.assert_allclose(apart[(phi < 0.10) | (phi > 0.33)], 0.0, atol=1e-12)
