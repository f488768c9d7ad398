"""A diagnosis of a user's model as JSON and as text: keys, numbers and units."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_systems import made_diagnosis

from comparisons.missing_effect.document import diagnosis_document
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.words import verdict_words
from surge_core.files import to_strict_json

KEYS = {"schema", "verdict", "words", "missing", "gap", "time_constant_s", "where", "candidates"}
KEYS |= {"cannot_be_told", "not_there", "parameters", "timing_offsets", "input_between_samples"}
KEYS |= {"test_rmse", "training_rmse", "unavailable", "remarks", "model"}


def read_back(d: SystemDiagnosis) -> dict[str, Any]:
    text = to_strict_json(diagnosis_document(d))
    # json reads NaN and Infinity, which are no JSON.
    found: dict[str, Any] = json.loads(text, parse_constant=pytest.fail)
    return found


@pytest.mark.parametrize("nothing", [False, True])
def test_the_document_is_strict_json_of_plain_types(nothing: bool) -> None:
    found = read_back(made_diagnosis(nothing=nothing))
    assert set(found) == KEYS
    assert found["schema"] == "sindy-surge/diagnose/1"
    assert found["time_constant_s"] == {"before": None, "after": None, "by_alias": {}}
    assert all(found["where"][name] for name in ("time", "frequency", "flow"))


def test_a_simulation_that_failed_is_null() -> None:
    d = made_diagnosis(runs={"train": "training", "check": "check"})
    (run,) = d.checks
    found = read_back(replace(d, checks=(replace(run, before=np.full_like(run.before, np.nan)),)))
    assert found["gap"]["before_rms"] is None
    assert found["where"] == {"time": [], "frequency": [], "flow": []}
    assert found["test_rmse"]["position_check"]["before"] is None


def test_a_check_that_got_worse_comes_first_and_each_doubt_is_said() -> None:
    d = made_diagnosis()
    check = d.checks[0]
    worse = replace(check, after=check.before + 2.0 * (check.before - check.measured))
    doubted = replace(d.missing[0], provisional=True, doubts=("the reason",))
    d = replace(d, missing=(doubted, *d.missing[1:]), checks=(worse, *d.checks[1:]))
    words = verdict_words(d)
    assert words.index(worse.name) < words.index("lacks")
    assert "the reason" in words
    assert read_back(d)["missing"][0]["doubts"] == ["the reason"]
