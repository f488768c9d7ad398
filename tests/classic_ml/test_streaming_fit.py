"""The one-pass fit against whole matrices: same τ, β, C, drift, cost and covariance."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from dense_reference import dense_fit
from lag_data import PERIOD_S, coloured, flow, lagged
from sklearn.preprocessing import FunctionTransformer

from classic_ml import LagRegressor
from classic_ml.lag.conditioning import condition
from surge_core.fit_state import FitState

FITS = [
    ("arx", 0, True),
    ("output-error", 0, True),
    ("armax", 0, True),
    ("armax", 1, True),
    ("armax", 1, False),
    ("armax", 2, True),
    ("armax", 2, False),
]


def made(
    hold: str, layout: str, drifting: bool, n: int = 1100
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    rng = np.random.default_rng(3)
    phi = flow(n, rng)
    y = lagged(phi, hold) + coloured(n, -0.5, 0.002, rng)
    if drifting:
        y = y + 0.02 * np.sin(np.arange(n) / 150)
    labels = weight = None
    if "segments" in layout:
        labels = np.repeat([1, 2, 3], [n // 3, n // 4, n - n // 3 - n // 4])
    if "weights" in layout:
        weight = rng.uniform(0.5, 2.0, n)
        weight[400:450] = 0.0
        weight[[0, 700, 901]] = 0.0
    return phi, y, labels, weight


@pytest.mark.parametrize("drift", [False, True])
@pytest.mark.parametrize("layout", ["plain", "segments and weights"])
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(("noise", "order", "exact"), FITS)
def test_same_answers_as_with_whole_matrices(
    noise: str, order: int, exact: bool, hold: str, layout: str, drift: bool
) -> None:
    phi, y, labels, weight = made(hold, layout, drift)
    dense = dense_fit(
        phi,
        y,
        sample_period_s=PERIOD_S,
        noise=noise,
        hold=hold,
        order=order,
        drift=drift,
        knot_spacing_s=0.2,
        segments=labels,
        weight=weight,
        exact_start=exact,
    )
    m = LagRegressor(
        PERIOD_S,
        noise=noise,
        hold=hold,
        noise_order=order,
        drift="spline" if drift else None,
        knot_spacing_s=0.2,
        exact_start=exact,
    ).fit(phi[:, None], y, labels, weight)
    assert m.fit_state_ is FitState.CONVERGED
    assert m.time_constant_s_ == pytest.approx(dense.time_constant_s, rel=1e-6)
    np.testing.assert_allclose(m.coef_, dense.coef, rtol=1e-6)
    if noise == "armax":
        np.testing.assert_allclose(m.moving_average_, dense.moving_average, atol=1e-6)
    np.testing.assert_allclose(m.drift_coef_, dense.drift_coef, atol=1e-7)
    assert m.residual_std_ == pytest.approx(dense.residual_std, rel=1e-9)
    assert (m.n_blocks_, m.residual_lag_) == (dense.n_blocks, dense.n_lags)
    scale = np.sqrt(np.diag(dense.parameter_covariance))
    np.testing.assert_allclose(
        m.parameter_covariance_ / np.outer(scale, scale),
        dense.parameter_covariance / np.outer(scale, scale),
        atol=3e-6,
    )


@pytest.mark.parametrize("noise", ["arx", "armax", "output-error"])
def test_a_drift_keeps_its_zero_mean_where_no_term_is_constant(noise: str) -> None:
    phi, y, labels, weight = made("first", "segments and weights", True)
    wave = np.column_stack([phi, phi**2])
    dense = LagRegressor(
        PERIOD_S,
        noise=noise,
        hold="first",
        drift="spline",
        knot_spacing_s=0.2,
        basis=FunctionTransformer(),
    ).fit(wave, y, labels, weight)
    values = np.concatenate([dense.drift_coef_, [0.0]])
    assert values.size == dense.drift_coef_.size + 1
    # A constant of 0.3 has nowhere to go but into these two terms: the same as by least squares.
    from dense_reference import EquationError, LagData, OutputError, runs_of, search, spline_columns

    runs = runs_of(labels, y.size)
    data = LagData(
        y,
        wave,
        spline_columns(weight, runs, PERIOD_S, 0.2),
        weight,
        tuple(runs),
        PERIOD_S,
        "first",
    )
    order = int(noise == "armax")
    model = OutputError(data) if noise == "output-error" else EquationError(data, order)
    start = np.concatenate([[np.log(dense.time_constant_s_)], np.zeros(order)])
    outcome = search(model, [start])
    assert dense.time_constant_s_ == pytest.approx(float(np.exp(outcome.shape[0])), rel=1e-5)
    np.testing.assert_allclose(dense.coef_, outcome.coef[:2], rtol=1e-5)
    np.testing.assert_allclose(dense.drift_coef_, outcome.coef[2:], atol=1e-5)


@pytest.mark.parametrize("noise", ["armax", "output-error"])
def test_a_long_record_fits_in_constant_memory_a_row(noise: str) -> None:
    rng = np.random.default_rng(0)
    n = 250_000
    phi = 0.3 + 0.1 * np.sin(np.arange(n) / 130.0) + 0.02 * rng.standard_normal(n)
    y = 0.3 + 1.2 * phi - 1.5 * phi**2 + 0.01 * rng.standard_normal(n)
    m = LagRegressor(PERIOD_S, noise=noise, drift="spline")
    m.fit(phi[:3000, None], y[:3000])
    tracemalloc.start()
    m.fit(phi[:, None], y)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert m.drift_coef_.size == 250
    assert peak / 8 / n < 30


def test_the_head_of_a_long_record_does_not_decide() -> None:
    # φ stands still for the first tenth: what starts from there must still find the truth.
    rng = np.random.default_rng(1)
    phi = flow(260_000, rng)
    phi[:26_000] = 0.3 + 1e-5 * rng.standard_normal(26_000)
    y = lagged(phi, "zero") + 0.001 * rng.standard_normal(phi.size)
    for noise in ("armax", "output-error"):
        m = LagRegressor(PERIOD_S, noise=noise).fit(phi[:, None], y)
        assert abs(m.time_constant_s_ - 0.018) < 4 * m.time_constant_stderr_s_
        assert m.time_constant_s_ == pytest.approx(0.018, rel=0.01)


def test_terms_that_are_nearly_alike_keep_their_digits() -> None:
    rng = np.random.default_rng(2)
    phi = 0.3 + 0.02 * (flow(3000, rng) - 0.3)
    f = phi**5
    y = np.empty_like(f)
    y[0], a = f[0], np.exp(-1.0 / 18.0)
    for k in range(1, f.size):
        y[k] = a * y[k - 1] + (1.0 - a) * f[k - 1]
    m = LagRegressor(PERIOD_S, noise="output-error", degree=5).fit(phi[:, None], y)
    assert m.time_constant_s_ == pytest.approx(0.018, rel=1e-5)
    np.testing.assert_allclose(m.predict(phi[:, None]), y, atol=1e-9)


def test_combinations_span_the_terms_and_leave_the_constant_out_when_told() -> None:
    rng = np.random.default_rng(4)
    phi = rng.uniform(0.1, 0.5, 400)
    terms = phi[:, None] ** np.arange(4)
    plain = condition(terms, without_constant=False)
    np.testing.assert_allclose(plain.rows, (terms @ plain.back).T, atol=1e-9)
    np.testing.assert_allclose(plain.rows @ plain.rows.T / 400, np.eye(4), atol=1e-5)
    bare = condition(terms, without_constant=True)
    assert bare.rows.shape == (3, 400)
    np.testing.assert_allclose(terms @ bare.constant, 1.0, atol=1e-9)
    twice = condition(np.column_stack([terms, terms[:, 1]]), without_constant=False)
    assert twice.deficient
    assert twice.rows.shape == (4, 400)
