"""Limits: an effect planted into the user's own records, and found again from a size on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_data import series_of
from scipy.stats import kurtosis

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.catalogue import CATALOGUE, find_effect
from comparisons.missing_effect.diagnosis import diagnose
from comparisons.missing_effect.fit import fit_structure
from comparisons.missing_effect.limits import Limits, planted_limits
from comparisons.missing_effect.noise import Metric
from comparisons.missing_effect.planting import Planter
from comparisons.missing_effect.results import Diagnosis
from comparisons.rig.coefficient_tests import Noise, simulate_test
from surge_core.errors import InputError

ROWS = 600


def records(
    noise: Noise = "white", noise_frac: float = 0.01, rows: int = ROWS
) -> list[CoefficientSeries]:
    test = simulate_test(None, seed=1, n_samples=rows, noise=noise, noise_frac=noise_frac)
    return series_of(test)


@pytest.fixture(scope="module")
def nothing_missing() -> Diagnosis:
    diagnosis = diagnose(records(), degree=3)
    assert diagnosis.verdict == "nothing_missing"
    return diagnosis


@pytest.fixture(scope="module")
def limits(nothing_missing: Diagnosis) -> Limits:
    return planted_limits(nothing_missing, effects=["flow_inertia", "hysteresis"], trials=6)


@pytest.fixture(scope="module")
def planter(nothing_missing: Diagnosis) -> Planter:
    return Planter.of(nothing_missing)


def test_a_half_larger_effect_is_named_in_fresh_trials(limits: Limits) -> None:
    for row in limits.rows:
        assert row.found
        assert row.named >= 6 * limits.share
        assert row.check_size == pytest.approx(1.5 * row.size)
        assert row.check_named >= 5


def test_half_the_limit_is_not_named(limits: Limits, planter: Planter) -> None:
    from comparisons.missing_effect.diagnosis import diagnose_data

    row = limits["flow_inertia"]
    effect = find_effect("flow_inertia")
    named = 0
    for seed in range(4):
        rng = np.random.default_rng([9, seed])
        data = planter.measured(planter.planted(effect, 0.5 * row.size, rng), rng)
        found = diagnose_data(data, ("1", "phi", "phi^2", "phi^3"))
        named += "flow_inertia" in {name for item in found.missing for name in item.alias_set}
    assert named <= 2


def test_twice_the_noise_makes_the_limit_twice_as_large(limits: Limits) -> None:
    noisy = diagnose(records(noise_frac=0.02), degree=3)
    loud = planted_limits(noisy, effects=["flow_inertia"], trials=6)["flow_inertia"]
    quiet = limits["flow_inertia"]
    assert loud.size == pytest.approx(2.0 * quiet.size, rel=0.25)
    # In units of the noise it is the same effect.
    assert loud.excess_sigma == pytest.approx(quiet.excess_sigma, rel=0.25)


@pytest.mark.parametrize(
    "name", [e.name for e in CATALOGUE if e.port != "noise" and not e.episodes]
)
def test_the_excess_is_what_a_refit_leaves(name: str, planter: Planter) -> None:
    effect = find_effect(name)
    size = 20.0 * effect.parameters[0].step
    for _ in range(3):
        clean = planter.planted(effect, size, np.random.default_rng(0))
        size *= 0.3 / planter.promise(clean)[1]
    clean = planter.planted(effect, size, np.random.default_rng(0))
    _, excess = planter.promise(clean)
    train = planter.data.with_measured(clean).train
    metric = Metric(planter.noise.sigma)
    fit = fit_structure(planter.fit.structure, train, metric, [planter.fit.nonlinear])
    left = np.sqrt(2.0 * fit.cost / np.count_nonzero(train.weight))
    assert excess == pytest.approx(left, rel=0.05)
    assert excess == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize("noise", ["white", "ar1", "t3", "outliers"])
def test_the_noise_that_is_drawn_is_like_that_of_the_records(noise: Noise) -> None:
    diagnosis = diagnose(records(noise, rows=1500), degree=3)
    planter = Planter.of(diagnosis)
    own = diagnosis.after.errors(diagnosis.data, Metric())
    drawn = planter.draw(np.random.default_rng(0))
    assert drawn.std() == pytest.approx(own.std(), rel=0.15)
    memory = [float(np.corrcoef(e[1:], e[:-1])[0, 1]) for e in (drawn, own)]
    assert memory[0] == pytest.approx(memory[1], abs=0.06)
    heavy = [float(kurtosis(e)) for e in (drawn, own)]
    assert (heavy[0] > 2.0) == (heavy[1] > 2.0) == (noise in ("t3", "outliers"))
    assert not np.array_equal(drawn, planter.draw(np.random.default_rng(1)))


def test_an_effect_that_leaves_no_trace_has_no_limit() -> None:
    forward = [replace(r, phi=r.phi + 0.2 - min(r.phi.min(), 0.0)) for r in records(rows=400)]
    diagnosis = diagnose([replace(r, T25_K=None) for r in forward], degree=3)
    found = planted_limits(diagnosis, effects=["reverse_flow_branch", "thermocouple_lag"])
    assert "no trace" in found["reverse_flow_branch"].why_none
    assert "T25_K" in found["thermocouple_lag"].why_none
    assert not any(row.found for row in found.rows)
    assert "reverse_flow_branch: no limit" in "\n".join(found.lines)
    assert found.to_json()["effects"][0]["size"] is None


def test_what_the_records_have_is_not_planted_again(nothing_missing: Diagnosis) -> None:
    test = simulate_test("flow_inertia", strength=3.0, seed=1, n_samples=ROWS)
    own = [
        replace(r, psi_p=m.psi_p, phi=m.phi) for r, m in zip(records(), test.records, strict=True)
    ]
    diagnosis = diagnose(own, degree=3)
    assert diagnosis.names == ("flow_inertia",)
    found = planted_limits(diagnosis, effects=["flow_inertia"])
    assert "already" in found["flow_inertia"].why_none


@pytest.mark.parametrize(
    ("options", "words"),
    [({"trials": 0}, "expected at least 1"), ({"effects": ["rust"]}, "found 'rust'")],
)
def test_what_makes_no_drill_is_refused(
    options: dict[str, object], words: str, nothing_missing: Diagnosis
) -> None:
    with pytest.raises(InputError, match=words):
        planted_limits(nothing_missing, **options)  # type: ignore[arg-type]
