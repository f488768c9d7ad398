"""Gradients against finite differences, the exact start of C, and passes against whole matrices.

The errors and gradients are checked on the dense reference; one pass of the streaming fit is then
held against the same columns.
"""

from __future__ import annotations

import numpy as np
import pytest
from dense_reference import EquationError, LagData, OutputError, PredictionModel
from lag_data import BETA, PERIOD_S, TAU_S, flow, lagged
from scipy.linalg import toeplitz

from classic_ml.characteristics import polynomial_basis
from classic_ml.lag.prediction import LagProblem
from classic_ml.likelihood import Bench, pseudo_inverse
from classic_ml.noise_models import MovingAverage


def made(hold: str, drifting: bool) -> LagData:
    rng = np.random.default_rng(0)
    phi = flow(90, rng)
    y = lagged(phi, hold) + 0.05 * rng.standard_normal(90)
    weight = rng.uniform(0.5, 2.0, 90)
    weight[[20, 21, 50]] = 0.0
    drift = np.linspace(-1.0, 1.0, 90)[:, None] if drifting else np.zeros((90, 0))
    runs = (slice(0, 40), slice(40, 90))
    terms = polynomial_basis(2).fit_transform(phi[:, None])
    return LagData(y, terms, drift, weight, runs, PERIOD_S, hold)


def cost(model: PredictionModel, shape: np.ndarray) -> float:
    target, columns = model.linear(shape)
    coef = np.linalg.lstsq(columns, target)[0]
    return float(np.sum((target - columns @ coef) ** 2))


@pytest.mark.parametrize("exact_start", [False, True])
@pytest.mark.parametrize("drifting", [False, True])
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        ("output-error", [-4.0]),
        ("arx", [-4.0]),
        ("armax", [-4.0, -0.7]),
        ("armax", [-4.0, 0.5, -0.3]),
    ],
)
def test_gradients_are_exact(
    kind: str, shape: list[float], hold: str, drifting: bool, exact_start: bool
) -> None:
    data = made(hold, drifting)
    at = np.array(shape)
    model: PredictionModel = (
        OutputError(data)
        if kind == "output-error"
        else EquationError(data, at.size - 1, exact_start)
    )
    target, columns = model.linear(at)
    coef = np.linalg.lstsq(columns, target)[0]
    errors = target - columns @ coef
    gradient = 2.0 * model.sensitivities(at, coef, errors).T @ errors
    assert sum(model.piece_lengths()) == errors.size
    for i in range(at.size):
        step = np.zeros(at.size)
        step[i] = 1e-5
        numeric = (cost(model, at + step) - cost(model, at - step)) / 2e-5
        assert gradient[i] == pytest.approx(numeric, rel=2e-6, abs=1e-9)


@pytest.mark.parametrize("c", [[-0.6], [0.9], [0.5, 0.3]])
def test_the_cost_of_a_stretch_is_that_of_the_exact_likelihood(c: list[float]) -> None:
    """Unconditional least squares is r' Σ⁻¹ r with Σ the covariance of a moving average."""
    data = made("zero", False)
    n = 30
    one = LagData(
        data.y[:n],
        np.zeros((n, 0)),
        np.zeros((n, 0)),
        np.ones(n),
        (slice(0, n),),
        PERIOD_S,
        "zero",
    )
    shape = np.concatenate([[np.log(TAU_S)], MovingAverage.from_coefficients(np.array(c)).free])
    target, _ = EquationError(one, len(c)).linear(shape)
    a = np.exp(-PERIOD_S / TAU_S)
    equation = one.y[1:] - a * one.y[:-1]
    full = np.array([1.0, *MovingAverage(shape[1:]).coefficients])
    autocovariance = np.zeros(n - 1)
    autocovariance[: full.size] = [full[k:] @ full[: full.size - k] for k in range(full.size)]
    exact = equation @ np.linalg.solve(toeplitz(autocovariance), equation)
    assert target @ target == pytest.approx(exact, rel=1e-9)


def test_weights_of_one_are_no_weights() -> None:
    data = made("zero", False)
    assert np.all(BETA)  # the characteristic of the made data is not empty
    shape = np.array([-4.0, -0.5])
    plain, _ = EquationError(data, 1).linear(shape)
    scaled = LagData(
        data.y,
        data.terms,
        data.drift,
        4.0 * data.weight,
        data.runs,
        data.sample_period_s,
        data.hold,
    )
    doubled, _ = EquationError(scaled, 1).linear(shape)
    np.testing.assert_allclose(doubled, 2.0 * plain, rtol=1e-12)


@pytest.mark.parametrize("exact_start", [False, True])
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    ("noise", "shape"),
    [
        ("output-error", [-4.0]),
        ("arx", [-4.0]),
        ("armax", [-4.0, -0.7]),
        ("armax", [-4.0, 0.5, -0.3]),
    ],
)
def test_one_pass_gives_cost_and_gradient_of_the_whole_matrices(
    noise: str, shape: list[float], hold: str, exact_start: bool
) -> None:
    data = made(hold, False)
    at = np.array(shape)
    problem = LagProblem(
        data.y,
        np.ascontiguousarray(data.terms.T),
        data.weight,
        np.sqrt(data.weight),
        data.runs,
        PERIOD_S,
        hold,
        noise,
        at.size - 1,
        exact_start,
    )
    bench = Bench.of(problem)
    fit = bench.at_optimum(bench.fit_at(bench.origin(np.concatenate([at[:1], [0.0], at[1:]]))))
    model: PredictionModel = (
        OutputError(data)
        if noise == "output-error"
        else EquationError(data, at.size - 1, exact_start)
    )
    target, columns = model.linear(at)
    coef = np.linalg.lstsq(columns, target)[0]
    errors = target - columns @ coef
    assert fit.cost == pytest.approx(float(errors @ errors), rel=1e-11)
    np.testing.assert_allclose(bench.errors, errors, atol=1e-12)
    slopes = model.sensitivities(at, coef, errors)
    np.testing.assert_allclose(fit.gradient, -slopes.T @ errors, rtol=1e-8, atol=1e-12)
    left = slopes - columns @ np.linalg.lstsq(columns, slopes)[0]
    np.testing.assert_allclose(fit.curvature, left.T @ left, rtol=1e-7, atol=1e-14)


@pytest.mark.parametrize("noise", ["arx", "armax", "output-error"])
def test_the_gradient_in_the_dead_time_is_exact(noise: str) -> None:
    data = made("first", False)
    problem = LagProblem(
        data.y,
        np.ascontiguousarray(data.terms.T),
        data.weight,
        np.sqrt(data.weight),
        data.runs,
        PERIOD_S,
        "first",
        noise,
        int(noise == "armax"),
        fit_dead=True,
        longest_dead=9.0,
    )
    bench = Bench.of(problem)

    def profile(dead: float) -> tuple[float, float]:
        shape = np.concatenate([[-4.0, dead], [-0.4] * problem.order])
        fit = bench.at_optimum(bench.fit_at(bench.origin(shape)))
        return fit.cost, float(fit.gradient[1])

    for dead in (0.4, 2.7):
        rise = (profile(dead + 1e-5)[0] - profile(dead - 1e-5)[0]) / 2e-5
        assert -2.0 * profile(dead)[1] == pytest.approx(rise, rel=2e-5, abs=1e-9)


def test_copies_and_empty_columns_get_nothing() -> None:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((50, 3))
    whole = np.column_stack([columns, columns[:, 0], np.zeros(50)])
    inverse = pseudo_inverse(whole.T @ whole)
    target = columns @ [1.0, 2.0, 3.0]
    solution = inverse @ (whole.T @ target)
    np.testing.assert_allclose(whole @ solution, target, atol=1e-10)
    np.testing.assert_allclose(solution, [0.5, 2.0, 3.0, 0.5, 0.0], atol=1e-10)
