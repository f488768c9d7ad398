"""Records: parameters of each record; readings that are missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import system_models as make
import system_truths as truth

from comparisons.missing_effect.systems.bench import base_bench
from comparisons.missing_effect.systems.diagnosis import diagnose_model
from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.fit import settled
from comparisons.missing_effect.systems.metric import raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.quantities import covariance
from comparisons.missing_effect.systems.records import Records, check_run

def biased_body(**changes: Any) -> Model:
    """The body with a force whose zero was set anew for each record."""
    given = {
        "params": {**make.body().params, "zero": P(0.0, -50.0, 50.0, "N", per_record=True)},
        "rhs": lambda t, x, u, p: (
            x.speed,
            (u.F + p.zero - p.c * x.speed - p.k * x.at) / p.M,
        ),
    }
    return make.body(**{**given, **changes})


def record(name: str, seed: int, zero: float, n: int = 600) -> Experiment:
    made = truth.body(seed, n, force=lambda t, q, v: zero, noise=0.01)
    return make.experiment("body", made, name)


ZEROS = {"one": 6.0, "two": -9.0}


def test_each_record_has_a_value_of_its_own() -> None:
    """Two records and a check with zeros of 6, −9 and 2 N; the check's from its first rows."""
    model = biased_body()
    assert "zero (of each record)" in str(model)
    given = [record(name, seed, zero) for seed, (name, zero) in enumerate(ZEROS.items())]
    check = replace(record("check", 7, 2.0), settle=100)
    found = diagnose_model(model, given, check, most_effects=0)
    rows = {row.name: row for row in found.parameters}
    assert list(rows) == ["M", "c", "k", "zero of one", "zero of two"]
    for name, zero in ZEROS.items():
        row = rows[f"zero of {name}"]
        assert row.unit == "N"
        assert abs(row.after - zero) < 4.0 * row.after_stderr < 2.0
    for name, wanted in truth.BODY.items():
        assert abs(rows[name].after - wanted) < 4.0 * rows[name].after_stderr
    run = found.checks[0]
    assert run.after_rms[0] < 1.3 * 0.01 * np.std(run.measured)


def test_a_value_of_a_record_keeps_its_bounds() -> None:
    zero = P(0.0, -5.0, 5.0, "N", per_record=True)
    model = biased_body(params={**make.body().params, "zero": zero})
    bench = base_bench(Records.of(model, [record("one", 1, 6.0)]))
    assert bench.fit.starts[0][2] == 5.0


def test_a_check_begins_from_the_values_of_the_training_records() -> None:
    """With no row of its own a check has their mean, as far as they scatter."""
    records = Records.of(biased_body(), [record(n, i, z) for i, (n, z) in enumerate(ZEROS.items())])
    fit = base_bench(records).fit
    run = check_run(records, record("check", 7, 2.0).of(records.model), fit)
    assert run.x0_mean[2] == pytest.approx(-1.5, abs=0.5)
    assert run.x0_sd[2] == pytest.approx(np.std([6.0, -9.0], ddof=1), rel=0.05)
    there = settled(fit, [run], raw_metric([run.outputs]), rows=100)
    assert there.starts[0][2] == pytest.approx(2.0, abs=0.5)
    cov = covariance(fit, base_bench(records).train, raw_metric([run.outputs]))
    assert cov.shape == (fit.theta.size + 2,) * 2
