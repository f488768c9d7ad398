"""A fitted model as a value: the same numbers as the estimator, and safe to save."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from comparison_data import fit_rows
from lag_data import PERIOD_S, TAU_S, flow, lagged

from classic_ml import LagRegressor
from comparisons.harness.compare import fitted_value
from comparisons.harness.saved_models import load_models, save_models
from comparisons.results import FittedLag
from surge_core.errors import InputError


def fitted(hold: str = "first") -> tuple[LagRegressor, FittedLag, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    phi = flow(2000, rng)
    y = lagged(phi, hold) + 0.002 * rng.standard_normal(2000)
    m = LagRegressor(PERIOD_S, hold=hold).fit(phi[:, None], y)
    return m, fitted_value(m, "classic_ml", fit_rows(phi, y), hold), phi, y


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_free_run_and_one_step_are_the_estimators_own(hold: str) -> None:
    m, value, phi, y = fitted(hold)
    labels = np.repeat([1, 2], 1000)
    rows = fit_rows(phi, y, 2)
    free = value.free_run_over(rows, [])
    np.testing.assert_allclose(free, m.predict(phi[:, None], labels, start=y), atol=1e-12)
    step = value.one_step_over(rows)
    a = math.exp(-PERIOD_S / value.time_constant_s)
    residual = y - step
    assert residual[0] == residual[1000] == 0.0
    np.testing.assert_allclose(step[1], free[1], atol=1e-12)
    np.testing.assert_allclose(step[500], free[500] + a * (y[499] - free[499]), atol=1e-12)


def test_a_model_runs_at_another_sample_rate() -> None:
    _, value, _, _ = fitted()
    rng = np.random.default_rng(4)
    fine = np.repeat(flow(800, rng), 4)
    fine = np.convolve(fine, np.ones(40) / 40, mode="valid")
    coarse = fine[::4]
    at_rate = value.free_run_over(fit_rows(coarse, coarse), [])
    rows = replace(fit_rows(fine, fine), sample_period_s=PERIOD_S / 4)
    at_four = value.free_run_over(rows, [])[::4]
    np.testing.assert_allclose(at_rate, at_four, atol=2e-3)


def test_saved_models_come_back_bit_for_bit(tmp_path: Path) -> None:
    _, value, _, _ = fitted()
    save_models({"classic_ml": value}, tmp_path / "m.json")
    again = load_models(tmp_path / "m.json")["classic_ml"]
    assert repr(again) == repr(value)  # Some numbers are NaN, which equals nothing
    low, high = value.ci95_s
    assert 0.0 < low < value.time_constant_s < high
    assert low < TAU_S < high


def test_the_error_of_a_free_run_is_that_of_records_measured_again() -> None:
    rng = np.random.default_rng(20)
    phi = flow(600, rng)
    truth = lagged(phi, "first")
    rows = fit_rows(phi, truth)
    runs, stderr, inside = [], [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        seen = flow(1500, rng)
        y = lagged(seen, "first") + 0.01 * rng.standard_normal(1500)
        m = LagRegressor(PERIOD_S, noise="output-error", hold="first").fit(seen[:, None], y)
        value = fitted_value(m, "x", fit_rows(seen, y), "first")
        runs.append(value.free_run_over(rows, [])[100:])
        stderr.append(value.free_run_stderr(rows)[100:])
        inside.append(np.mean(np.abs(runs[-1] - truth[100:]) <= value.quantile * stderr[-1]))
    scatter = np.sqrt(np.mean(np.var(runs, axis=0, ddof=1)))
    assert np.sqrt(np.mean(np.square(stderr))) == pytest.approx(scatter, rel=0.25)
    assert 0.85 < np.mean(inside) <= 1.0
    assert value.free_run_stderr(rows)[0] == 0.0  # the start is measured
    unknown = FittedLag(**{**value.__dict__, "covariance": ()})
    assert np.isnan(unknown.free_run_stderr(rows)).all()


@pytest.mark.parametrize(
    "text", ["", "not json", "[]", '{"schema": "sindy-surge/model/2", "models": {}}']
)
def test_what_is_not_a_model_file_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "m.json"
    file.write_text(text)
    for wrong in (file, tmp_path / "none.json"):
        with pytest.raises(InputError, match="expected a model file written by"):
            load_models(wrong)


def spoiled(tmp_path: Path, key: str, value: object) -> Path:
    _, model, _, _ = fitted()
    save_models({"m": model}, tmp_path / "m.json")
    document = json.loads((tmp_path / "m.json").read_text())
    *places, last = (int(part) if part.isdigit() else part for part in key.split("/"))
    table = document["models"]["m"]
    for place in places:
        table = table[place]
    table[last] = value
    # As the file may have it: 1e999 is a number without end for Python's reader.
    text = json.dumps(document).replace("-Infinity", "-1e999").replace("Infinity", "1e999")
    (tmp_path / "m.json").write_text(text)
    return tmp_path / "m.json"


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        *(
            ("time_constant_s", value, "a time constant above 0 s, or null")
            for value in (-0.1, 0, math.inf, 10**400, math.nan, "0.1", True)
        ),
        ("time_constant_stderr_s", -0.1, "a standard error in s, or null"),
        ("target", "tau", '"psi_p" or "psi"'),
        ("hold", None, 'the hold "zero" or "first"'),
        ("terms", {}, "a list"),
        ("terms/0", 3, "a table"),
        ("terms/0/coefficient", math.inf, "a coefficient, a finite number"),
        ("dead_time_s", -math.inf, "a dead time in s"),
        ("valid_phi", [0.5, 0.1], "two numbers, the smaller first"),
        ("n_blocks", 2.5, "a whole number of blocks from 0 on"),
        ("characteristic/3", [0.1], "φ, value and standard error"),
    ],
)
def test_a_key_that_cannot_be_is_named_with_its_remedy(
    tmp_path: Path, key: str, value: object, expected: str
) -> None:
    file = spoiled(tmp_path, key, value)
    with pytest.raises(InputError) as refused:
        load_models(file)
    # Entries of a list are counted from 1, as people do.
    name = re.sub(r"/(\d+)", lambda m: f"[{int(m[1]) + 1}]", key).replace("/", ".")
    sentence = str(refused.value)
    assert sentence.startswith(f"{file}: models.m.{name}: expected {expected}")


def test_a_time_constant_that_was_not_identified_comes_back(tmp_path: Path) -> None:
    model = load_models(spoiled(tmp_path, "time_constant_s", None))["m"]
    assert math.isnan(model.time_constant_s)
