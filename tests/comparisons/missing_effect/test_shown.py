"""What is shown of a diagnosis: contributions, curves and held-out runs against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_diagnosis import BETA, PERIOD_S, SIGMA, TAU_S, made_diagnosis, made_fit, swept

from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.diagnosis import Diagnosis
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.shown import (
    contributions,
    held_out_run,
    residual_runs,
    steady_curves,
    stretch,
    tau_before_stderr_s,
    where_of,
)


def with_after(name: str, *values: float) -> Diagnosis:
    d = made_diagnosis("named")
    fit = made_fit(find_effect(name), values)
    return replace(d, after=fit, after_fitted=fit)


def contribution(d: Diagnosis) -> np.ndarray:
    (part,) = contributions(d)
    seen = np.isfinite(part.value)
    assert part.rms == pytest.approx(float(np.sqrt(np.mean(part.value[seen] ** 2))))
    return part.value


def test_a_drift_contributes_its_line() -> None:
    d = with_after("bias_drift", 3e-4)
    value, time_s = contribution(d), d.data.sampled(d.data["time_s"])
    seen = np.isfinite(value)
    np.testing.assert_allclose(value[seen], 3e-4 * time_s[seen], atol=1e-12)


def test_a_wrong_inertia_contributes_the_slope_of_phi() -> None:
    d = with_after("flow_inertia", 0.002)
    value, phi = contribution(d), d.data.sampled(d.data["phi"])
    inside = np.arange(100, 300)
    slope = np.gradient(phi, PERIOD_S)[inside]
    np.testing.assert_allclose(value[inside], -0.002 * slope, atol=2e-3 * 0.002 * slope.max())


def test_a_hysteresis_contributes_no_more_than_its_step() -> None:
    value = contribution(with_after("hysteresis", 0.11, 0.32, 0.021))
    assert -0.021 <= np.nanmin(value) < -0.018
    assert -0.005 < np.nanmax(value) <= 0.0


def test_an_effect_without_amplitude_contributes_nothing() -> None:
    assert np.nanmax(np.abs(contribution(with_after("transport_delay", 0.0)))) < 1e-12


def test_the_start_of_a_run_is_not_an_effect() -> None:
    d = with_after("hysteresis", 0.11, 0.32, 0.021)
    value = contribution(d)
    lead = round(5.0 * TAU_S / PERIOD_S)
    for rows in d.data.slices:
        assert np.all(np.isnan(value[rows][: lead - 1]))
        assert np.all(np.isfinite(value[rows][lead + 1 :]))


def test_a_heated_characteristic_is_drawn_at_both_ends_of_the_test() -> None:
    d = with_after("facility_heating", 0.2, 10.0)
    first, last = steady_curves(d.after, d.data)
    clock = d.data["time_s"]
    assert clock.min() == 0.0
    np.testing.assert_allclose(first.value, swept(first.phi), atol=1e-12)
    lost = 1.0 - 0.2 * (1.0 - np.exp(-clock.max() / 10.0))
    np.testing.assert_allclose(last.value, lost * swept(last.phi), atol=1e-12)


def test_a_loss_in_reversed_flow_shows_in_the_curve_lagged_or_not() -> None:
    data = made_diagnosis("named").data
    data = replace(data, signals={**data.signals, "phi": data["phi"] - 0.15})
    effect = find_effect("reverse_flow_branch")
    for lagged in (1.0, 0.0):
        (curve,) = steady_curves(made_fit(effect, (lagged, 2.0)), data)
        extra = np.where(curve.phi < 0.0, 2.0 * curve.phi**2, 0.0)
        assert extra.max() > 0.005
        np.testing.assert_allclose(curve.value, swept(curve.phi) + extra, atol=1e-12)


@pytest.mark.parametrize("name", ["transport_delay", "second_order_lag", "sensitivity_drift"])
def test_what_acts_elsewhere_leaves_the_curve_as_it_is(name: str) -> None:
    d = with_after(name, 1e-3)
    (curve,) = steady_curves(d.after, d.data)
    np.testing.assert_allclose(curve.value, swept(curve.phi), atol=1e-12)


def test_held_out_rows_are_those_that_no_fit_saw() -> None:
    d = made_diagnosis("named")
    run = held_out_run(d)
    assert np.count_nonzero(run.held_out) == 160 + 400
    assert not run.held_out[:240].any()
    # The base has a τ of its own but the true curve; with the true τ only noise would be left.
    true = Fit(d.before.structure, np.array([np.log(TAU_S)]), np.array(BETA), 0.0)
    alone = held_out_run(replace(d, before_fitted=true))
    left = (alone.measured - alone.before)[alone.held_out]
    assert float(np.std(left)) == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize(("bad", "record"), [(slice(300, 330), 0), (slice(600, 700), 1)])
def test_the_stretch_shown_is_where_the_model_before_is_worst(bad: slice, record: int) -> None:
    d = made_diagnosis("named")
    run = held_out_run(d)
    off = run.measured + 0.001
    off[bad] += 0.05
    shown = stretch(d, replace(run, before=off))
    assert run.held_out[shown].all()
    assert set(d.data.record[shown]) == {record}
    assert shown.start <= bad.start
    assert shown.stop >= bad.stop


def test_where_is_told_of_the_residual_of_the_fit_that_is_given() -> None:
    d = made_diagnosis("named")
    before = residual_runs(d, d.before)
    assert before.record_names == ("run-1.csv", "run-2.csv")
    assert before.sample_rate_hz == pytest.approx(100.0)
    true = Fit(d.before.structure, np.array([np.log(TAU_S)]), np.array(BETA), 0.0)
    assert where_of(d, d.before).standing_out
    assert not where_of(d, true).standing_out


def test_the_error_of_tau_before_is_positive_and_below_tau() -> None:
    d = made_diagnosis("nothing_missing")
    assert 0.0 < tau_before_stderr_s(d) < 0.1 * d.tau_before_s
