"""A lag model with effects: saved and read back, run on other records, fitted again, compared."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_data import series_of

from classic_ml.io.series import write_series
from classic_ml.series import CoefficientSeries
from comparisons.cli import main
from comparisons.cli.saved_models import load_any_models
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.harness.rows import stack_rows
from comparisons.missing_effect.candidates import Bench
from comparisons.missing_effect.extended_file import load_extended, save_extended
from comparisons.missing_effect.extended_lag import ExtendedLag
from comparisons.missing_effect.extended_refit import extended_specs, model_of, refitted
from comparisons.missing_effect.fit import Structure, fit_structure
from comparisons.missing_effect.loading import block_rows, load_data
from comparisons.missing_effect.noise import Metric
from comparisons.rig.coefficient_tests import CoefficientTest, simulate_test
from surge_core.errors import InputError

TERMS = ("1", "phi", "phi^2", "phi^3")
ADDED = {
    "hysteresis": 1.5,
    "characteristic_shape": 3.0,
    "second_order_lag": 3.0,
    "amplitude_dependent_lag": 1.5,
    "thermocouple_lag": 1.5,
    "facility_heating": 1.5,
}


def plain_lag(records: list[CoefficientSeries]) -> ExtendedLag:
    """Fit the lag alone to all rows; effects are then added to it by name, no search involved."""
    data = load_data(records)
    everything = data.all_fitted()
    metric = Metric(0.01 * float(np.std(data.measured)))
    fit = fit_structure(Structure(TERMS), everything, metric, [np.array([np.log(0.1)])])
    return model_of(fit, Bench(everything, fit, metric, block_rows(data), 1))


@pytest.fixture(scope="module")
def tests() -> dict[str, CoefficientTest]:
    return {
        name: simulate_test(name, strength=strength, seed=3, n_samples=1000, gaps=True)
        for name, strength in ADDED.items()
    }


@pytest.fixture(scope="module")
def models(tests: dict[str, CoefficientTest]) -> dict[str, ExtendedLag]:
    out = {}
    for name, test in tests.items():
        records = series_of(test)[:2]
        out[name] = refitted(plain_lag(records).with_effect(name), records)
    return out


@pytest.mark.parametrize("name", ADDED)
def test_read_back_it_leaves_on_an_unseen_record_noise_and_the_lag_alone_more(
    name: str, models: dict[str, ExtendedLag], tests: dict[str, CoefficientTest], tmp_path: Path
) -> None:
    test = tests[name]
    records = series_of(test)
    unseen = records[2]
    save_extended({name: models[name]}, tmp_path / "model.json")
    again = load_extended(tmp_path / "model.json")[name]
    assert repr(again) == repr(models[name])  # Some numbers are NaN, which equals nothing
    with_it = reconstruct_record(again, unseen)
    without = reconstruct_record(plain_lag(records[:2]), unseen)
    # Beyond the φ that was fitted a free shape is a guess; else the noise of one row stays in the
    # first rows of each segment.
    shape = name == "characteristic_shape"
    assert with_it.score.rms < (2.2 if shape else 1.12) * test.sigma
    assert without.score.rms > (1.15 if shape else 1.25) * with_it.score.rms
    assert with_it.score.n_rows == np.count_nonzero(unseen.segment)


@pytest.mark.parametrize(
    ("name", "parameter"), [("flow_inertia", "length_s"), ("asymmetric_lag", "slope")]
)
def test_adding_an_effect_and_fitting_again_recovers_it_within_its_errors(
    name: str, parameter: str
) -> None:
    z = []
    for seed in range(5):
        test = simulate_test(name, strength=1.5, seed=seed, n_samples=600)
        records = series_of(test)
        model = refitted(plain_lag(records).with_effect(name), records)
        (added,) = model.effects
        z.append((added.values[0] - test.effects[name][parameter]) / added.stderr[0])
        z.append((model.time_constant_s - test.tau_s) / model.lag.time_constant_stderr_s)
    # Ten numbers: their rms is above 1.7 but once in a thousand times.
    assert float(np.sqrt(np.mean(np.square(z)))) < 1.9
    assert float(np.max(np.abs(z))) < 4.5


def test_a_wrong_start_dies_away_with_the_lag() -> None:
    record = series_of(simulate_test(None, seed=1, n_samples=400))[0]
    model = plain_lag([record])
    off = record.psi_p.copy()
    off[0] += 0.5
    difference = model.simulate(replace(record, psi_p=off)) - model.simulate(record)
    age = np.arange(400) * record.sample_period_s / model.time_constant_s
    np.testing.assert_allclose(difference, 0.5 * np.exp(-age), rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("name", ["sensitivity_drift", "bias_drift"])
def test_a_drift_counts_from_the_clock_of_the_fit_and_not_of_the_record(name: str) -> None:
    test = simulate_test(name, strength=3.0, seed=4, n_samples=900)
    records = series_of(test)
    model = refitted(plain_lag(records).with_effect(name), records)
    whole = records[2]
    # The last third of a record, by itself: its own clock starts at its own first row.
    cut = slice(600, 900)
    columns = {key: values[cut] for key, values in whole.columns().items() if key != "time_s"}
    late = CoefficientSeries(time_s=whole.time_s[cut], source="late", **columns)  # type: ignore[arg-type]
    settled = 10 * int(model.time_constant_s / whole.sample_period_s)
    difference = model.simulate(late)[settled:] - model.simulate(whole)[cut][settled:]
    assert float(np.max(np.abs(difference))) < 0.05 * test.sigma


def test_a_record_without_the_channel_that_an_effect_needs_is_refused(
    models: dict[str, ExtendedLag], tests: dict[str, CoefficientTest]
) -> None:
    record = replace(series_of(tests["thermocouple_lag"])[2], T25_K=None)
    with pytest.raises(InputError, match=r"record-3\.csv: expected the column T25_K"):
        models["thermocouple_lag"].simulate(record)
    with pytest.raises(InputError, match="it needs the column T25_K"):
        refitted(models["thermocouple_lag"], [record])


def edited(change: Callable[[dict[str, Any]], None]) -> Callable[[dict[str, Any]], None]:
    return lambda document: change(document["models"]["m"])


BAD_FILES: dict[str, Callable[[dict[str, Any]], None]] = {
    "another schema": lambda d: d.update(schema="sindy-surge/model/1"),
    "no model": lambda d: d.update(models={}),
    "a negative time constant": edited(lambda m: m.update(time_constant_s=-0.1)),
    "a term that is code": edited(lambda m: m["terms"][0].update(name="__import__('os')")),
    "an unknown effect": edited(lambda m: m["effects"][0].update(effect="rust")),
    "a missing parameter": edited(lambda m: m["effects"][0]["parameters"].pop()),
    "beyond the bounds": edited(lambda m: m["effects"][0]["parameters"][1].update(value=9.0)),
    "too many coefficients": edited(lambda m: m["effects"][0].update(coefficients=[1.0, 2.0])),
    "an infinite number": edited(lambda m: m["terms"][0].update(coefficient=1e999)),
}


@pytest.mark.parametrize("fault", BAD_FILES)
def test_a_file_that_is_no_such_model_is_refused_in_one_sentence(
    fault: str, models: dict[str, ExtendedLag], tmp_path: Path
) -> None:
    file = tmp_path / "m.json"
    save_extended({"m": models["hysteresis"]}, file)
    document = json.loads(file.read_text("utf-8"))
    BAD_FILES[fault](document)
    file.write_text(json.dumps(document), "utf-8")
    whole = fault == "another schema"
    begins = r"expected a file of a lag model with effects" if whole else r"models.*: expected"
    with pytest.raises(InputError, match=rf"m\.json: {begins}"):
        load_extended(file)
    file.write_text("{", "utf-8")
    with pytest.raises(InputError, match="expected a file of a lag model with effects"):
        load_extended(file)


def test_beside_other_estimators_it_wins_where_its_effect_is(
    models: dict[str, ExtendedLag], tests: dict[str, CoefficientTest]
) -> None:
    test, records = tests["hysteresis"], series_of(tests["hysteresis"])
    plain = [spec for spec in default_estimators(degree=3) if spec.name == "classic_ml_arx"]
    specs = (*plain, *extended_specs({"extended": models["hysteresis"]}))
    comparison = compare_records(records, estimators=specs)
    assert comparison.first.name == "extended"
    result = comparison.result("extended")
    assert result.held_out is not None
    assert result.held_out.rms < 1.12 * test.sigma
    assert result.extended is not None
    assert result.equation == result.extended.equation()
    other = comparison.result("classic_ml_arx").model.time_constant_s
    assert abs(result.model.time_constant_s / test.tau_s - 1.0) < 0.01
    assert abs(other / test.tau_s - 1.0) > 0.02
    # One row ahead from a noisy row: the start's noise dies away by one step.
    step = np.exp(-records[0].sample_period_s / test.tau_s)
    assert result.one_step.rms == pytest.approx(test.sigma * np.hypot(1.0, step), rel=0.06)


def test_held_out_rows_take_no_part_in_the_fit(
    models: dict[str, ExtendedLag], tests: dict[str, CoefficientTest]
) -> None:
    records = series_of(tests["hysteresis"])
    rows = stack_rows(records)
    train = rows.part(rows.train)
    spoilt = []
    for i, record in enumerate(records):
        seen = np.isin(record.time_s, train.time_s[train.record == i])
        spoilt.append(replace(record, psi_p=np.where(seen, record.psi_p, record.psi_p + 1.0)))
    (spec,) = extended_specs({"extended": models["hysteresis"]})
    one = spec.fitted(train, records, None).extended_
    two = spec.fitted(train, spoilt, None).extended_
    assert two.time_constant_s == pytest.approx(one.time_constant_s, rel=1e-12)
    assert two.effects[0].values == pytest.approx(one.effects[0].values, rel=1e-9)


def test_the_commands_take_the_file(
    models: dict[str, ExtendedLag],
    tests: dict[str, CoefficientTest],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    record = series_of(tests["hysteresis"])[2]
    model, scores = tmp_path / "model.json", tmp_path / "scores.json"
    write_series(record, tmp_path / "r.csv")
    save_extended({"extended": models["hysteresis"]}, model)
    assert main(["reconstruct", str(model), str(tmp_path / "r.csv"), "--json", str(scores)]) == 0
    (row,) = json.loads(scores.read_text("utf-8"))["reconstructions"]
    assert row["estimator"] == "extended"
    assert row["free_run"]["rms"] < 1.12 * tests["hysteresis"].sigma
    out = tmp_path / "compare.json"
    arguments = ["compare", str(tmp_path / "r.csv"), "--degree", "3", "--model", str(model)]
    kept = tmp_path / "kept.json"
    assert main([*arguments, "--json", str(out), "--save", str(kept)]) == 0
    estimators = json.loads(out.read_text("utf-8"))["estimators"]
    rms = {name: e["fit"]["held_out"]["rms"] for name, e in estimators.items()}
    assert min(rms, key=lambda name: rms[name]) == "extended"
    # More than its characteristic and τ, it has a file of its own.
    assert "extended" not in load_any_models(kept)
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "r.csv"), "--model", str(kept)]) == 2
    assert "expected a file of a lag model with effects" in capsys.readouterr().err
