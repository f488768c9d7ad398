"""A fitted model as a value: the same numbers as the estimator, and safe to save."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from lag_data import PERIOD_S, TAU_S, flow, lagged

from classic_ml import LagRegressor
from classic_ml.errors import InputError
from comparisons.lag_value import FittedLag, load_models, save_models


def fitted(hold: str = "first") -> tuple[LagRegressor, FittedLag, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    phi = flow(2000, rng)
    y = lagged(phi, hold) + 0.002 * rng.standard_normal(2000)
    m = LagRegressor(PERIOD_S, hold=hold).fit(phi[:, None], y)
    grid = np.linspace(0.0, 0.6, 50)
    return m, FittedLag.from_estimator(m, "classic_ml", "psi_p", hold, grid, (0.1, 0.5)), phi, y


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_free_run_and_one_step_are_the_estimators_own(hold: str) -> None:
    m, value, phi, y = fitted(hold)
    labels = np.repeat([1, 2], 1000)
    np.testing.assert_allclose(
        value.free_run(phi, PERIOD_S, labels), m.predict(phi[:, None], labels), atol=1e-12
    )
    np.testing.assert_allclose(
        value.free_run(phi, PERIOD_S, labels, start=y),
        m.simulate(phi[:, None], labels, start=y),
        atol=1e-12,
    )
    step = value.one_step(phi, y, PERIOD_S, labels)
    a = math.exp(-PERIOD_S / value.time_constant_s)
    residual = y - step
    assert residual[0] == residual[1000] == 0.0
    free = value.free_run(phi, PERIOD_S, labels, start=y)
    np.testing.assert_allclose(step[1], free[1], atol=1e-12)
    np.testing.assert_allclose(step[500], free[500] + a * (y[499] - free[499]), atol=1e-12)


def test_a_model_runs_at_another_sample_rate() -> None:
    _, value, _, _ = fitted()
    rng = np.random.default_rng(4)
    fine = np.repeat(flow(800, rng), 4)
    fine = np.convolve(fine, np.ones(40) / 40, mode="valid")
    coarse = fine[::4]
    at_rate = value.free_run(coarse, PERIOD_S)
    at_four = value.free_run(fine, PERIOD_S / 4)[::4]
    np.testing.assert_allclose(at_rate, at_four, atol=2e-3)


def test_saved_models_come_back_bit_for_bit(tmp_path: Path) -> None:
    _, value, phi, _ = fitted()
    save_models({"classic_ml": value}, tmp_path / "m.json")
    again = load_models(tmp_path / "m.json")["classic_ml"]
    assert again == value
    np.testing.assert_array_equal(again.quasi_steady(phi), value.quasi_steady(phi))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.json"]


def test_the_interval_of_tau_is_positive_and_holds_tau() -> None:
    _, value, _, _ = fitted()
    low, high = value.ci95_s
    assert 0.0 < low < value.time_constant_s < high
    assert low < TAU_S < high


def test_terms_without_a_known_name_run_from_the_table() -> None:
    m, value, phi, _ = fitted()
    anonymous = FittedLag(**{**value.__dict__, "terms": ("s1", "s2", "s3")})
    inside = np.clip(phi, 0.0, 0.6)
    np.testing.assert_allclose(
        anonymous.quasi_steady(inside), m.characteristic(inside)[0], atol=1e-3
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "not json",
        "[]",
        "{}",
        '{"schema": "sindy-surge/model/2", "models": {}}',
        '{"schema": "sindy-surge/model/1", "models": {}}',
        '{"schema": "sindy-surge/model/1", "models": {"a": {}}}',
        '{"schema": "sindy-surge/model/1", "models": 3}',
    ],
)
def test_what_is_not_a_model_file_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "m.json"
    file.write_text(text)
    with pytest.raises(InputError, match="expected a model file written by"):
        load_models(file)


def test_a_model_with_an_impossible_time_constant_is_refused(tmp_path: Path) -> None:
    _, value, _, _ = fitted()
    save_models({"m": value}, tmp_path / "m.json")
    document = json.loads((tmp_path / "m.json").read_text())
    document["models"]["m"]["time_constant_s"] = -0.1
    (tmp_path / "m.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="time constant"):
        load_models(tmp_path / "m.json")


def test_a_missing_model_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_models(tmp_path / "none.json")
