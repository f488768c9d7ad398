"""Leaving out a cycle, linearised: against real refits, and against what chance moves."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, coloured, flow, lagged
from scipy.stats import t

from classic_ml import LagRegressor
from classic_ml.likelihood import cycle_shifts

NOISES = ("arx", "armax", "output-error")


def cycles(seed: int, n_cycles: int = 10, n: int = 200) -> tuple[np.ndarray, ...]:
    """φ as one column, ψ' with a moving-average equation error, labels."""
    rng = np.random.default_rng(seed)
    phi = [flow(n, rng) for _ in range(n_cycles)]
    psi_p = [lagged(p, "first") + coloured(n, -0.6, 0.002, rng) for p in phi]
    return np.concatenate(phi)[:, None], np.concatenate(psi_p), np.repeat(np.arange(n_cycles), n)


@pytest.mark.parametrize("drift", [None, "spline"])
@pytest.mark.parametrize("noise", NOISES)
def test_the_errors_are_those_of_the_fit_and_their_derivatives_vanish_against_them(
    noise: str, drift: str | None
) -> None:
    X, y, _ = cycles(1, n_cycles=2, n=1200)
    y = y + np.linspace(0.0, 0.05, y.size)
    labels = np.repeat([0, 1], 1200)
    m = LagRegressor(
        PERIOD_S, noise=noise, hold="first", drift=drift, knot_spacing_s=0.4, exact_start=False
    ).fit(X, y, labels)
    fit = m.linearised(X, y, labels)
    size = np.linalg.norm(fit.jacobian, axis=0) * np.linalg.norm(fit.errors)
    assert np.all(np.abs(fit.jacobian.T @ fit.errors) < 1e-3 * size)
    assert np.std(fit.errors) == pytest.approx(m.residual_std_, rel=0.01)
    assert len(fit.pieces) == 2


@pytest.mark.parametrize("noise", NOISES)
def test_shifts_are_those_of_refits_without_each_cycle(noise: str) -> None:
    X, y, labels = cycles(2)
    model = LagRegressor(PERIOD_S, noise=noise, hold="first")
    tau = model.fit(X, y, labels).time_constant_s_
    beta = model.coef_
    fit = model.linearised(X, y, labels)
    shifts = cycle_shifts(fit).shift
    moved = np.column_stack([shifts[:, 0], shifts[:, 1:4] @ fit.back.T])
    refits = []
    for cycle in range(10):
        keep = labels != cycle
        refit = LagRegressor(PERIOD_S, noise=noise, hold="first").fit(
            X[keep], y[keep], labels[keep]
        )
        refits.append([refit.time_constant_s_ - tau, *(refit.coef_ - beta)])
    wanted = np.array(refits)
    assert np.all(np.abs(moved - wanted) < 0.25 * np.abs(wanted).max(axis=0))
    # The largest shift is off by its square; which cycle it is, is not.
    assert np.argmax(np.abs(shifts[:, 0])) == np.argmax(np.abs(wanted[:, 0]))


def test_a_row_of_weight_zero_counts_neither_itself_nor_in_the_equation_after_it() -> None:
    X, y, labels = cycles(3)
    weight = np.ones(y.size)
    weight[250:290] = 0.0
    bad = y.copy()
    bad[250:290] += 5.0
    for noise in NOISES:
        m = LagRegressor(PERIOD_S, noise=noise, hold="first").fit(X, bad, labels, weight)
        fit = m.linearised(X, bad, labels, weight)
        assert not np.isin(np.arange(250, 290), fit.rows).any()
        assert (290 in fit.rows) == (noise == "output-error")
        assert np.abs(fit.errors).max() < 0.1
        assert len(fit.pieces) == 11


def test_studentised_shifts_follow_student_where_all_cycles_are_alike() -> None:
    values = []
    for seed in range(25):
        X, y, labels = cycles(seed, n_cycles=12, n=120)
        m = LagRegressor(PERIOD_S, noise="armax", hold="first").fit(X, y, labels)
        shifts = cycle_shifts(m.linearised(X, y, labels))
        only_tau = np.eye(shifts.shift.shape[1])[:1]
        values.append(shifts.studentised(only_tau)[:, 0])
    found = np.concatenate(values)
    assert np.mean(np.abs(found) > t.isf(0.05, 10)) == pytest.approx(0.10, abs=0.04)
    assert abs(np.mean(found)) < 0.2
