"""An effect is named firmly only where all that it does is told from nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_data import CUBIC, hidden, series_of

from comparisons.missing_effect import find_effect
from comparisons.missing_effect.candidates import Bench, LagRound
from comparisons.missing_effect.conclusion import (
    LEAST_SIZE,
    concluded,
    covariance_of,
    fitted_parameters,
    size_in_errors,
)
from comparisons.missing_effect.diagnosis import WEIGHT_ROUNDS, first_bench
from comparisons.missing_effect.fit import Fit, fit_structure
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.probes import Leftover
from comparisons.missing_effect.results import SIZE

SHORT = {"seed": 3, "n_samples": 1000}


def bench_of(planted: str | None, noise: str = "white") -> Bench:
    return first_bench(load_data(series_of(hidden(planted, **SHORT, noise=noise))), CUBIC, 15)


def with_effect(bench: Bench, name: str, *values: float) -> Bench:
    """The model with an effect, fitted from these values on."""
    structure = bench.fit.structure.with_effect(find_effect(name))
    start = np.array([*bench.fit.nonlinear, *values])
    fit = fit_structure(structure, bench.train, bench.train_metric, [start])
    return replace(bench, fit=fit)


def size_of(bench: Bench, fit: Fit | None = None) -> float:
    whole = bench.on_all_rows(bench.fit) if fit is None else fit
    return size_in_errors(whole.structure.effects[-1], whole, bench)


@pytest.mark.parametrize("planted", ["flow_inertia", "bias_drift", None])
def test_of_an_effect_of_one_coefficient_the_size_is_its_t(planted: str | None) -> None:
    bench = with_effect(bench_of(planted), planted or "bias_drift")
    whole = bench.on_all_rows(bench.fit)
    (number,) = fitted_parameters(whole, bench, covariance_of(whole, bench))[
        planted or "bias_drift"
    ]
    assert size_of(bench, whole) == pytest.approx(abs(number.value) / number.stderr, rel=1e-3)
    assert (size_of(bench, whole) > 10.0) is (planted is not None)


def test_large_errors_are_held_down_by_the_model_that_stands() -> None:
    bench = with_effect(bench_of("facility_heating", "t3"), "facility_heating", 0.01, 20.0)
    settled = [bench]
    for _ in range(WEIGHT_ROUNDS + 1):
        settled.append(settled[-1].in_metric_of(settled[-1].fit, settled[-1].own_noise))
    first, own, again = (settled[i].metric.weight for i in (0, -2, -1))
    assert np.mean(np.abs(own - first)) > 0.02
    assert np.max(np.abs(again - own)) < 0.01


def test_a_race_begins_in_white_noise() -> None:
    """A metric of noise on φ would whiten away what the model lacks."""
    metric = bench_of(None, "phi3").metric
    assert (metric.flow, metric.ar.size) == (None, 0)


def test_a_drift_is_told_though_neither_its_size_nor_its_time_is() -> None:
    """Much slower than the records are long, only the ratio of the two is in them."""
    bench = with_effect(bench_of("sensitivity_drift"), "facility_heating", -0.5, 2e3)
    held = np.array([*bench.fit.nonlinear[:-1], 3e4])
    held[-2] = bench.fit.nonlinear[-2] * 3e4 / bench.fit.nonlinear[-1]
    slow = replace(bench.fit, nonlinear=held)
    numbers = fitted_parameters(slow, bench, covariance_of(slow, bench))["facility_heating"]
    assert all(number.stderr > abs(number.value) for number in numbers)
    assert size_of(bench, slow) > 10.0


def test_a_name_whose_effect_is_not_told_from_nothing_is_not_firm() -> None:
    base, name = bench_of(None), "facility_heating"
    rounds = [LagRound(base, (), None, leftover=Leftover(0.0, 0, 1.0))]
    d = concluded(base, with_effect(base, name, 0.01, 20.0), rounds, {name: ()}, "", (), 1e-3)
    assert d.missing[0].evidence[SIZE] < LEAST_SIZE
    assert (d.missing[0].provisional, d.verdict) == (True, "provisional")
