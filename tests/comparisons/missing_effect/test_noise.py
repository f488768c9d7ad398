"""What errors look like: colour, tails, noise on φ, and the metric in which they are white."""

from __future__ import annotations

import numpy as np
import pytest
from effect_data import hidden, series_of
from scipy.linalg import cholesky, solve_triangular
from scipy.signal import lfilter

from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.noise import FlowNoise, Metric, NoiseModel, noise_of, weights_of

Array = np.ndarray
SIGMA = 0.002
TAU_S = 0.1


@pytest.fixture(scope="module")
def data() -> LagData:
    return load_data(series_of(hidden(None, seed=6, n_samples=1000)))


def drawn(data: LagData, rng: np.random.Generator) -> Array:
    return SIGMA * rng.standard_normal(data.n_samples)


def coloured(data: LagData, ar: tuple[float, ...], rng: np.random.Generator) -> Array:
    """Autoregressive errors in every run by itself, each new part of size SIGMA."""
    out = np.empty(data.n_samples)
    for run in data.slices:
        drive = SIGMA * rng.standard_normal(run.stop - run.start + 200)
        out[run] = lfilter([1.0], [1.0, *(-np.array(ar))], drive)[200:]
    return out


def described(data: LagData, errors: Array, slope: Array | None = None) -> NoiseModel:
    return noise_of(errors, data.scored(), data, slope, TAU_S)


def test_white_noise_is_white_and_of_its_size(data: LagData) -> None:
    found = [described(data, drawn(data, np.random.default_rng(k))) for k in range(40)]
    assert not any(noise.coloured or noise.heavy_tailed for noise in found)
    for noise in found:
        # 3 000 errors: 1.3 % of a standard deviation.
        assert noise.sigma == pytest.approx(SIGMA, rel=0.055)
        assert noise.innovation == noise.sigma
        assert noise.flow_sigma == 0.0


@pytest.mark.parametrize(
    "ar", [(0.7,), (-0.4,), (0.2,), (1.2, -0.5), (0.5, 0.0, 0.3)], ids=lambda ar: f"{ar}"
)
def test_the_order_and_the_numbers_of_an_autoregression(
    data: LagData, ar: tuple[float, ...]
) -> None:
    for seed in range(3):
        noise = described(data, coloured(data, ar, np.random.default_rng(seed)))
        assert len(noise.ar) == len(ar)
        # Asymptotic standard errors are below 1/√n.
        assert np.allclose(noise.ar, ar, atol=4.0 / np.sqrt(data.n_samples))
        assert noise.innovation == pytest.approx(SIGMA, rel=0.06)
        assert noise.sigma > noise.innovation
        assert noise.coloured
        assert not noise.heavy_tailed


def test_errors_are_white_in_their_own_metric(data: LagData) -> None:
    errors = coloured(data, (1.2, -0.5), np.random.default_rng(4))
    metric = described(data, errors).metric()
    white = metric.whitened(errors, data)[metric.rows(data) > 0.0]
    assert np.std(white) == pytest.approx(1.0, abs=0.05)
    for back in (1, 2, 3):
        assert abs(np.mean(white[back:] * white[:-back])) < 4.0 / np.sqrt(white.size)


def test_whitening_is_the_recursion_row_by_row(data: LagData) -> None:
    errors = drawn(data, np.random.default_rng(1))
    found = Metric(0.5, np.array([0.6, -0.1])).whitened(errors, data)
    expected = np.zeros(errors.size)
    for run in data.slices:
        e = errors[run]
        expected[run.start + 2 : run.stop] = (e[2:] - 0.6 * e[1:-1] + 0.1 * e[:-2]) / 0.5
    assert np.allclose(found, expected)


@pytest.mark.parametrize("kind", ["t3", "outliers"])
def test_heavy_tails_and_outliers_are_seen_and_do_not_swell_the_noise(
    data: LagData, kind: str
) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        if kind == "t3":
            # Median of |t| with three degrees of freedom: 0.765, of |z|: 0.674.
            errors = SIGMA * rng.standard_t(3, data.n_samples)
            bulk = 0.765 / 0.674 * SIGMA
        else:
            errors = drawn(data, rng)
            errors[rng.random(errors.size) < 0.015] *= 15.0
            bulk = SIGMA
        noise = described(data, errors)
        assert noise.heavy_tailed
        assert not noise.ar
        assert noise.innovation == pytest.approx(bulk, rel=0.12)
        assert noise.innovation < 0.8 * np.std(errors)


def test_colour_is_told_through_outliers(data: LagData) -> None:
    rng = np.random.default_rng(9)
    errors = coloured(data, (0.7,), rng)
    # Spikes of the recorder, not of the noise: they have no memory.
    errors[rng.random(errors.size) < 0.01] += 30.0 * SIGMA
    noise = described(data, errors)
    assert len(noise.ar) >= 1
    assert 0.4 < sum(noise.ar) < 0.75
    assert noise.heavy_tailed


def test_weights_lie_between_nothing_and_one_and_fall_with_the_size(data: LagData) -> None:
    rng = np.random.default_rng(2)
    errors = SIGMA * rng.standard_t(3, data.n_samples)
    noise = described(data, errors)
    weights = weights_of(errors, noise, data)
    assert weights is not None
    assert np.all((weights > 0.0) & (weights <= 1.0))
    z = np.abs(errors) / noise.innovation
    assert np.all(weights[z < 1.3] == 1.0)
    assert np.all(np.diff(weights[np.argsort(z)]) <= 1e-12)
    # In proportion, not in square: the pull of an error on the fit is bounded.
    assert np.max(weights**2 * z) < 1.5
    assert weights_of(drawn(data, rng), described(data, drawn(data, rng)), data) is None


def flow_driven(data: LagData, slope: Array, flow_sigma: float, rng: np.random.Generator) -> Array:
    """Errors of a free run whose φ is noisy: the lag's answer to slope times the noise."""
    noise = flow_sigma * rng.standard_normal(data.n_samples)
    r = data.sample_period_s / TAU_S
    a = np.exp(-r)
    now, before = 1.0 - (1.0 - a) / r, (1.0 - a) / r - a
    out = np.empty(data.n_samples)
    for run in data.slices:
        out[run] = lfilter([now, before], [1.0, -a], (slope * noise)[run])
    return out


def slope_at(data: LagData) -> Array:
    """dψ'/dφ of a characteristic of surge."""
    phi = data.sampled(data["phi"])
    return 1.2 + 2.0 * phi - 9.0 * phi**2


@pytest.mark.parametrize("flow_sigma", [0.005, 0.01])
def test_noise_on_the_flow_is_told_from_colour_and_measured(
    data: LagData, flow_sigma: float
) -> None:
    slope = slope_at(data)
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        errors = drawn(data, rng) + flow_driven(data, slope, flow_sigma, rng)
        # A φ whose own readings are steadier has no such noise.
        assert described(data, errors, slope).flow is None
        read = data["phi"] + flow_sigma * rng.standard_normal(data["phi"].size)
        noise = described(data.with_signal("phi", read), errors, slope)
        assert noise.innovation == pytest.approx(SIGMA, rel=0.1)
        found.append(noise.flow_sigma)
        metric = noise.metric()
        white = metric.whitened(errors, data)
        assert np.std(white) == pytest.approx(1.0, abs=0.06)
        assert abs(np.mean(white[1:] * white[:-1])) < 4.0 / np.sqrt(white.size)
    assert np.mean(found) == pytest.approx(flow_sigma, rel=0.08)
    assert np.allclose(found, flow_sigma, rtol=0.2)


def test_neither_white_nor_coloured_noise_is_taken_for_noise_on_the_flow(data: LagData) -> None:
    slope = slope_at(data)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        assert described(data, drawn(data, rng), slope).flow is None
        assert described(data, coloured(data, (0.6,), rng), slope).flow is None
        assert described(data, coloured(data, (-0.3,), rng), slope).flow is None


def test_the_filter_of_noise_on_the_flow_is_its_likelihood() -> None:
    """Innovations and variances against the covariance matrix of all errors at once."""
    rng = np.random.default_rng(5)
    n, a, now, before, ratio = 50, 0.8, 0.12, 0.08, 30.0
    slope = rng.uniform(-1.0, 2.0, n)
    response = np.zeros((n, n))
    for k in range(n):
        response[k, k] = now
        if k:
            response[k, k - 1] = before
            response[k] += a * response[k - 1]
    covariance = response @ np.diag(ratio * slope**2) @ response.T + np.eye(n)
    errors = rng.standard_normal((n, 2))
    runs = np.array([[0, n]])
    white, half_log = FlowNoise(a, now, before, slope, ratio).whitened(errors, np.ones(n), runs)
    lower = cholesky(covariance, lower=True)
    assert np.allclose(white, solve_triangular(lower, errors, lower=True), atol=1e-9)
    assert half_log == pytest.approx(np.sum(np.log(np.diag(lower))))


def test_runs_start_afresh(data: LagData) -> None:
    """The noise of one run says nothing about the next."""
    rng = np.random.default_rng(8)
    errors = drawn(data, rng)
    first = data.slices[0]
    changed = errors.copy()
    changed[first] = 50.0 * SIGMA
    slope = slope_at(data)
    for metric in (
        Metric(SIGMA, np.array([0.7])),
        Metric(SIGMA, flow=FlowNoise(0.9, 0.06, 0.04, slope, 5.0)),
    ):
        one, other = metric.whitened(errors, data), metric.whitened(changed, data)
        assert np.array_equal(one[first.stop :], other[first.stop :])
