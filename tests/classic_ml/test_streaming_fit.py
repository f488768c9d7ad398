"""The fit against whole matrices in scipy: same τ, β, C, drift, cost and stated error."""

from __future__ import annotations

import numpy as np
import pytest
from dense_reference import Dense
from lag_data import PERIOD_S, coloured, flow, lagged
from sklearn.preprocessing import FunctionTransformer

from classic_ml import LagRegressor
from surge_core.fit_state import FitState
from surge_core.leave_out import block_edges, correlation_length

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
    model = Dense(
        phi, y, PERIOD_S, noise, hold, order, exact, labels, weight, 0.2 if drift else None
    )
    dense = model.fit(np.array([np.log(0.02), *[-0.3] * order]))
    assert m.time_constant_s_ == pytest.approx(float(np.exp(dense.theta[0])), rel=2e-6)
    np.testing.assert_allclose(m.coef_, dense.coef[:3], rtol=1e-5)
    np.testing.assert_allclose(m.moving_average_, model.c(dense.theta), atol=1e-5)
    np.testing.assert_allclose(m.drift_coef_, dense.coef[3 : 3 + m.drift_coef_.size], atol=1e-6)
    n_parameters = order + 1 + dense.coef.size
    mean_weight = 1.0 if weight is None else weight.sum() / np.count_nonzero(weight)
    std = np.sqrt(dense.cost / (dense.errors.size - n_parameters) / mean_weight)
    assert m.residual_std_ == pytest.approx(std, rel=1e-8)
    n_lags = correlation_length(dense.errors, dense.lengths)
    assert m.residual_lag_ == n_lags
    edges = block_edges(dense.lengths, n_lags)
    first = np.concatenate([[0], np.cumsum(dense.lengths)])
    cuts = np.concatenate([a + np.r_[0, inner] for a, inner in zip(first, edges, strict=False)])
    blocks = np.split(np.arange(dense.errors.size), cuts[1:].astype(int))
    assert m.n_blocks_ == len(blocks)
    stderr = np.exp(dense.theta[0]) * np.sqrt(dense.covariance_of_shape(blocks)[0, 0])
    assert m.time_constant_stderr_s_ == pytest.approx(stderr, rel=1e-3)


@pytest.mark.parametrize("noise", ["arx", "armax", "output-error"])
def test_a_drift_keeps_its_zero_mean_where_no_term_is_constant(noise: str) -> None:
    phi, y, labels, weight = made("first", "segments and weights", True)
    m = LagRegressor(
        PERIOD_S,
        noise=noise,
        hold="first",
        drift="spline",
        knot_spacing_s=0.2,
        basis=FunctionTransformer(),
    ).fit(np.column_stack([phi, phi**2]), y, labels, weight)
    # A constant of 0.3 has nowhere to go but into these two terms: the same as by least squares.
    order = int(noise == "armax")
    model = Dense(phi, y, PERIOD_S, noise, "first", order, True, labels, weight, 0.2, powers=(1, 2))
    start = np.concatenate([[np.log(m.time_constant_s_)], np.arctanh(m.moving_average_)])
    dense = model.fit(start)
    assert m.time_constant_s_ == pytest.approx(float(np.exp(dense.theta[0])), rel=1e-5)
    np.testing.assert_allclose(m.coef_, dense.coef[:2], rtol=1e-5)
    np.testing.assert_allclose(m.drift_coef_, dense.coef[2 : 2 + m.drift_coef_.size], atol=1e-5)


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
