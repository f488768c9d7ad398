"""LagRegressor recovers known lags, and says how sure it is."""

from __future__ import annotations

import pickle

import numpy as np
import pandas as pd
import pytest
from lag_data import BETA, PERIOD_S, TAU_S, coloured, flow, lagged
from sklearn.base import clone
from sklearn.preprocessing import FunctionTransformer, SplineTransformer

from classic_ml import LagRegressor, PiecewiseLinear
from surge_core.errors import InputError
from surge_core.fit_state import FitState

NOISES = ("arx", "armax", "output-error")
HOLDS = ("zero", "first")


def clean(n: int = 1500, hold: str = "zero", seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    phi = flow(n, np.random.default_rng(seed))
    return phi[:, None], lagged(phi, hold)


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("noise", NOISES)
def test_exact_data_give_the_exact_answer(noise: str, hold: str) -> None:
    X, y = clean(hold=hold)
    m = LagRegressor(PERIOD_S, noise=noise, hold=hold).fit(X, y)
    assert m.time_constant_s_ == pytest.approx(TAU_S, rel=1e-7)
    np.testing.assert_allclose(m.coef_, BETA, rtol=1e-6)
    assert m.terms_ == ["1", "phi", "phi^2"]
    np.testing.assert_allclose(m.predict(X), y, atol=1e-8)


def segmented(seed: int, n_segments: int = 10, n: int = 300) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    X, y, labels = [], [], []
    for label in range(n_segments):
        phi = flow(n, rng)
        start = rng.uniform(-0.2, 0.2)
        decay = start * np.exp(-np.arange(n) * PERIOD_S / TAU_S)
        X.append(phi)
        y.append(lagged(phi, "zero") + decay + 0.001 * rng.standard_normal(n))
        labels.append(np.full(n, label + 1))
    return np.concatenate(X)[:, None], np.concatenate(y), np.concatenate(labels)


@pytest.mark.parametrize("noise", ["armax", "output-error"])
def test_segments_keep_their_own_start_and_linking_them_does_harm(noise: str) -> None:
    X, y, labels = segmented(7)
    apart = LagRegressor(PERIOD_S, noise=noise).fit(X, y, segments=labels)
    linked = LagRegressor(PERIOD_S, noise=noise, link_segments=True).fit(X, y, segments=labels)
    assert abs(apart.time_constant_s_ - TAU_S) < 4 * apart.time_constant_stderr_s_
    apart_off = np.abs(apart.characteristic([0.1, 0.3, 0.5])[0] - _truth([0.1, 0.3, 0.5])).max()
    linked_off = np.abs(linked.characteristic([0.1, 0.3, 0.5])[0] - _truth([0.1, 0.3, 0.5])).max()
    assert linked_off > 3 * apart_off


def _truth(phi: list[float]) -> np.ndarray:
    return np.polynomial.polynomial.polyval(np.asarray(phi), BETA)


def test_rows_of_weight_zero_are_simulated_through() -> None:
    X, y = clean(hold="first")
    weight = np.zeros(y.size)
    weight[500:520] = weight[700:730] = 1.0
    m = LagRegressor(PERIOD_S, noise="output-error", hold="first").fit(X, y, sample_weight=weight)
    assert m.n_scored_ == 50
    assert m.time_constant_s_ == pytest.approx(TAU_S, rel=1e-6)


def test_a_drift_is_read_as_a_long_lag_unless_it_has_a_spline() -> None:
    rng = np.random.default_rng(12)
    n = 8000
    phi = flow(n, rng)
    t = np.arange(n) * PERIOD_S
    drift = 0.15 * np.sin(2 * np.pi * t / 9.0)
    y = lagged(phi, "first") + drift + 0.002 * rng.standard_normal(n)
    plain = LagRegressor(PERIOD_S, noise="armax", hold="first").fit(phi[:, None], y)
    cured = LagRegressor(PERIOD_S, noise="output-error", drift="spline", hold="first")
    cured.fit(phi[:, None], y)
    assert plain.time_constant_s_ > 1.5 * TAU_S
    assert abs(cured.time_constant_s_ - TAU_S) < 4 * cured.time_constant_stderr_s_
    assert cured.time_constant_s_ == pytest.approx(TAU_S, rel=0.02)


def test_piecewise_linear_inputs_of_fig_22_recover_their_slopes() -> None:
    rng = np.random.default_rng(13)
    phi = flow(3000, rng)
    basis = PiecewiseLinear(breakpoints=(0.2, 0.35)).fit(phi[:, None])
    slopes = np.array([3.4, -12.0, 4.0, -3.0])
    f = basis.transform(phi[:, None]) @ slopes
    a = np.exp(-PERIOD_S / TAU_S)
    y = np.empty_like(f)
    y[0] = f[0]
    for k in range(1, f.size):
        y[k] = a * y[k - 1] + (1 - a) * f[k - 1]
    m = LagRegressor(PERIOD_S, basis=PiecewiseLinear(breakpoints=(0.2, 0.35)))
    m.fit(phi[:, None], y)
    np.testing.assert_allclose(m.coef_, slopes, rtol=1e-5)
    assert m.terms_ == ["1", "min(phi,0.2)", "clip(phi-0.2,0,0.15)", "relu(phi-0.35)"]


def test_any_transformer_and_several_inputs_serve_as_basis() -> None:
    rng = np.random.default_rng(14)
    phi, other = flow(2000, rng), flow(2000, rng)
    X = pd.DataFrame({"phi": phi, "speed": other})
    y = lagged(phi, "zero") + lagged(other, "zero")
    m = LagRegressor(PERIOD_S).fit(X, y)
    assert m.terms_ == ["1", "phi", "speed", "phi^2", "phi speed", "speed^2"]
    np.testing.assert_allclose(m.coef_, [0.6, 1.2, 1.2, -1.5, 0.0, -1.5], atol=1e-5)
    spline = LagRegressor(PERIOD_S, basis=SplineTransformer(n_knots=5, sparse_output=True))
    spline.fit(phi[:, None], lagged(phi, "zero"))
    assert spline.time_constant_s_ == pytest.approx(TAU_S, rel=1e-3)
    nameless = LagRegressor(PERIOD_S, basis=FunctionTransformer(lambda v: np.hstack([v**0, v])))
    nameless.fit(phi[:, None], lagged(phi, "zero"))
    assert nameless.terms_ == ["s1", "s2"]


def test_one_step_predictions_are_those_the_fit_minimised() -> None:
    X, y, labels = segmented(15, n_segments=3)
    for noise in NOISES:
        m = LagRegressor(PERIOD_S, noise=noise).fit(X, y, labels)
        prediction, known = m.one_step(X, y, labels)
        rms = np.sqrt(np.mean((y - prediction)[known] ** 2))
        assert rms == pytest.approx(m.residual_std_, rel=0.02)
        assert np.count_nonzero(~known) == (0 if noise == "output-error" else 3)


@pytest.mark.parametrize(("n_segments", "n_rows"), [(1, 5), (1500, 1)])
def test_a_free_run_through_every_row_is_no_fit(n_segments: int, n_rows: int) -> None:
    """Each segment has a start of its own, so that these have as many parameters as rows."""
    rng = np.random.default_rng(19)
    phi = flow(n_segments * n_rows, rng)
    y = lagged(phi, "first") + 0.01 * rng.standard_normal(phi.size)
    labels = np.repeat(np.arange(n_segments), n_rows)
    m = LagRegressor(PERIOD_S, noise="output-error", hold="first").fit(phi[:, None], y, labels)
    assert m.fit_state_ is FitState.TOO_FEW_ROWS
    assert np.isnan(m.time_constant_s_)
    _, stderr = m.characteristic(phi[:3])
    assert np.all(np.isnan(stderr))


@pytest.mark.parametrize("drift", [None, "spline"])
@pytest.mark.parametrize(("degree", "offset"), [(9, 0.0), (12, 0.0), (2, 1e3)])
def test_the_band_of_the_curve_does_not_depend_on_where_phi_is_counted_from(
    degree: int, offset: float, drift: str | None
) -> None:
    rng = np.random.default_rng(20)
    phi = flow(3000, rng)
    y = lagged(phi, "zero") + 0.01 * rng.standard_normal(3000)
    centre = float(phi.mean())
    at = np.linspace(*np.quantile(phi, [0.02, 0.98]), 9)
    model = LagRegressor(PERIOD_S, noise="output-error", degree=degree, drift=drift)
    value, stderr = clone(model).fit((phi - centre)[:, None], y).characteristic(at - centre)
    m = clone(model).fit((phi + offset)[:, None], y)
    raw, band = pickle.loads(pickle.dumps(m)).characteristic(at + offset)
    assert np.all(stderr > 0.0)
    np.testing.assert_allclose(band, stderr, rtol=1e-4)
    np.testing.assert_allclose(raw, value, atol=1e-3 * stderr.min())


@pytest.mark.parametrize("drift", [None, "spline"])
@pytest.mark.parametrize("level", [0.0, 0.3])
@pytest.mark.parametrize("noise", NOISES)
def test_a_constant_output_has_no_time_constant(
    noise: str, level: float, drift: str | None
) -> None:
    phi = flow(500, np.random.default_rng(22))[:, None]
    m = LagRegressor(PERIOD_S, noise=noise, drift=drift).fit(phi, np.full(500, level))
    assert m.fit_state_ is FitState.CONSTANT_SIGNAL
    assert np.isnan(m.time_constant_s_)
    np.testing.assert_allclose(m.predict(phi), level, atol=1e-12)


def test_data_without_a_lag_give_a_time_constant_far_below_the_sample_period() -> None:
    rng = np.random.default_rng(18)
    phi = rng.standard_normal(1000) * 0.1
    y = 0.3 + phi + 1e-4 * rng.standard_normal(1000)
    m = LagRegressor(PERIOD_S, noise="output-error", hold="first").fit(phi[:, None], y)
    assert m.time_constant_s_ < 0.1 * PERIOD_S


@pytest.mark.parametrize(
    ("name", "value"),
    [("noise", "bj"), ("hold", "second"), ("drift", "linear"), ("degree", -1), ("degree", 2.0),
     ("sample_period_s", 0.0), ("sample_period_s", "1 ms"), ("sample_period_s", True),
     ("noise_order", 3), ("knot_spacing_s", -1.0), ("time_constant_s", 0.0),
     ("time_constant_s", "18 ms"),
     ("basis", FunctionTransformer(lambda v: np.where(v > 0.3, np.nan, v)))],
)  # fmt: skip
def test_bad_parameters_are_refused_by_name(name: str, value: object) -> None:
    X, y = clean(200)
    with pytest.raises(InputError, match=rf"^{name}: expected .*, found [^(]"):
        LagRegressor(**{name: value}).fit(X, y)


def test_bad_data_are_refused() -> None:
    X, y = clean(200)
    for labels in (np.full(200, np.nan), np.full(200, 1.5), ["a"] * 200):
        with pytest.raises(InputError, match="segments: expected integer labels, found values"):
            LagRegressor().fit(X, y, segments=labels)
    for start in (1.0, [1.0], np.full(200, np.nan)):
        with pytest.raises(InputError, match="start: expected one ψ' a row"):
            LagRegressor().fit(X, y).predict(X, start=start)
    with pytest.raises(InputError, match="segments: expected one label for each of 200 rows"):
        LagRegressor().fit(X, y, segments=np.ones(150))
    with pytest.raises(ValueError, match="NaN"):
        LagRegressor().fit(np.where(X > 0.4, np.nan, X), y)
    with pytest.raises(ValueError, match=r"[Nn]egative"):
        LagRegressor().fit(X, y, sample_weight=-np.ones(200))
    with pytest.raises(InputError, match="breakpoints"):
        LagRegressor(basis=PiecewiseLinear(breakpoints=(0.3, 0.2))).fit(X, y)


def test_constant_flow_is_a_state_not_a_curve() -> None:
    rng = np.random.default_rng(22)
    y = 0.5 + 0.01 * rng.standard_normal(400)
    for noise in NOISES:
        m = LagRegressor(PERIOD_S, noise=noise).fit(np.full((400, 1), 0.3), y)
        assert m.fit_state_ is FitState.RANK_DEFICIENT
        assert np.abs(m.coef_).max() < 10.0


def test_too_many_knots_are_refused_before_memory_runs_out() -> None:
    with pytest.raises(InputError, match="knot_spacing_s"):
        LagRegressor(PERIOD_S, drift="spline", knot_spacing_s=1e-3).fit(
            np.linspace(0, 1, 40_000)[:, None], np.linspace(0, 1, 40_000)
        )


@pytest.mark.parametrize("noise", NOISES)
def test_labels_and_order_of_segments_do_not_matter(noise: str) -> None:
    X, y, labels = segmented(8, n_segments=4)
    m = LagRegressor(PERIOD_S, noise=noise).fit(X, y, segments=labels)
    renamed = LagRegressor(PERIOD_S, noise=noise).fit(X, y, segments=100 - 7 * labels)
    order = np.concatenate([np.flatnonzero(labels == k) for k in (3, 1, 4, 2)])
    shuffled = LagRegressor(PERIOD_S, noise=noise).fit(X[order], y[order], segments=labels[order])
    assert renamed.time_constant_s_ == m.time_constant_s_
    assert shuffled.time_constant_s_ == pytest.approx(m.time_constant_s_, rel=1e-6)
    np.testing.assert_allclose(shuffled.coef_, m.coef_, rtol=1e-5)


@pytest.mark.parametrize("noise", NOISES)
def test_a_held_time_constant_is_the_fit_when_it_is_the_fitted_one(noise: str) -> None:
    rng = np.random.default_rng(0)
    phi = flow(2000, rng)
    y = lagged(phi, "zero") + coloured(2000, -0.5, 0.002, rng)
    free = LagRegressor(PERIOD_S, noise=noise).fit(phi[:, None], y)
    held = LagRegressor(PERIOD_S, noise=noise, time_constant_s=free.time_constant_s_)
    held.fit(phi[:, None], y)
    assert held.time_constant_s_ == free.time_constant_s_
    assert held.time_constant_stderr_s_ == 0.0
    np.testing.assert_allclose(held.coef_, free.coef_, rtol=1e-6)
    np.testing.assert_allclose(held.moving_average_, free.moving_average_, atol=1e-6)
    assert np.all(np.diag(held.covariance_) <= 1.5 * np.diag(free.covariance_))
    assert np.all(held.parameter_covariance_[0] == 0.0)
