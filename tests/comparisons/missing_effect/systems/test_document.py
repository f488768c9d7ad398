"""A diagnosis of a user's model as JSON and as text: keys, numbers and units."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_mass import CUBIC, NOISE_M, files
from made_systems import made_diagnosis

from comparisons.missing_effect.document import diagnosis_document
from comparisons.missing_effect.systems.diagnosis import diagnose_model
from comparisons.missing_effect.systems.files import load_model, read_experiment
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.words import verdict_words
from surge_core.files import to_strict_json

KEYS = {
    "schema",
    "verdict",
    "words",
    "missing",
    "gap",
    "time_constant_s",
    "where",
    "candidates",
    "cannot_be_told",
    "not_there",
    "parameters",
    "timing_offsets",
    "input_between_samples",
    "test_rmse",
    "training_rmse",
    "unavailable",
    "remarks",
    "model",
}


def diagnosed(folder: Path, cubic: float) -> SystemDiagnosis:
    model_file, train, check = files(folder, cubic)
    model = load_model(model_file)
    runs = [read_experiment(path, model) for path in (train, check)]
    return diagnose_model(model, runs[0], runs[1], most_effects=1)


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> SystemDiagnosis:
    return diagnosed(tmp_path_factory.mktemp("hidden"), CUBIC)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> SystemDiagnosis:
    """Records of the very system that the model describes."""
    return diagnosed(tmp_path_factory.mktemp("whole"), 0.0)


def refuse(word: str) -> float:
    raise AssertionError(word)


def read_back(d: SystemDiagnosis) -> dict[str, Any]:
    text = to_strict_json(diagnosis_document(d))
    # json reads NaN and Infinity, which are no JSON.
    found: dict[str, Any] = json.loads(text, parse_constant=refuse)
    return found


def test_the_document_is_strict_json_of_plain_types(
    hidden: SystemDiagnosis, whole: SystemDiagnosis
) -> None:
    for d in (hidden, whole):
        found = read_back(d)
        assert set(found) == KEYS
        assert found["schema"] == "sindy-surge/diagnose/1"
        assert found["time_constant_s"] == {"before": None, "after": None, "by_alias": {}}
        assert all(found["where"][name] for name in ("time", "frequency", "flow"))
        assert found["model"]["outputs"] == {"y": "m"}


def test_the_effect_its_place_and_its_number_are_written(hidden: SystemDiagnosis) -> None:
    found = read_back(hidden)
    assert found["verdict"] in ("named", "alias_set")
    (item,) = found["missing"]
    assert item["effect"] == "cubic_stiffness"
    assert item["place"] == {"equation": "dv/dt", "signal": "q"}
    (number,) = item["parameters"]
    assert abs(abs(number["value"]) - CUBIC) < 4.0 * number["stderr"]
    assert number["unit"].startswith("N/")
    assert [row["fate"] for row in found["candidates"]].count("added") == 1
    scores = [row["score"] for row in found["candidates"] if row["fitted"]]
    assert scores == sorted(scores, reverse=True)


def test_the_gap_is_the_error_on_check_records(hidden: SystemDiagnosis) -> None:
    found = read_back(hidden)
    gap, errors = found["gap"], found["test_rmse"]["check"]
    assert gap["unit"] == errors["unit"] == "m"
    for which in ("before", "after"):
        assert gap[f"{which}_rms"] == pytest.approx(errors[which], rel=1e-12)
    assert gap["after_rms"] == pytest.approx(NOISE_M, rel=0.1)
    assert gap["floor_rms"] == pytest.approx(NOISE_M, rel=0.1)
    assert gap["before_rms"] > 50.0 * NOISE_M
    assert 0.99 < gap["shrink"] <= 1.0
    assert set(found["training_rmse"]) == {"train"}


def test_nothing_missing_is_said_with_the_error_that_is_left(whole: SystemDiagnosis) -> None:
    found = read_back(whole)
    assert found["verdict"] == "nothing_missing"
    assert found["missing"] == []
    assert found["gap"]["shrink"] == 0.0
    errors = found["test_rmse"]["check"]
    assert errors["unit"] == "mm"
    assert errors["before"] == errors["after"] == pytest.approx(1e3 * NOISE_M, rel=0.1)
    assert "Nothing is missing" in found["words"]
    assert " mm in y" in found["words"]


def test_a_simulation_that_failed_is_null(hidden: SystemDiagnosis) -> None:
    (run,) = hidden.checks
    failed = replace(run, before=np.full_like(run.before, np.nan))
    found = read_back(replace(hidden, checks=(failed,)))
    assert found["gap"]["before_rms"] is None
    assert found["where"] == {"time": [], "frequency": [], "flow": []}
    assert found["test_rmse"]["check"]["before"] is None


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
