"""The cost, its slope in every shape parameter, and the exact start of C."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, TAU_S, flow, lagged
from scipy.linalg import toeplitz

from classic_ml.lag_data import LagData
from classic_ml.lag_fit import newton
from classic_ml.likelihood import jacobian, profile
from classic_ml.noise_models import MovingAverage


def made(noise: str, hold: str, order: int, exact_start: bool, drifting: bool) -> LagData:
    rng = np.random.default_rng(0)
    phi = flow(90, rng)
    y = lagged(phi, hold) + 0.05 * rng.standard_normal(90)
    weight = rng.uniform(0.5, 2.0, 90)
    weight[[20, 21, 50]] = 0.0
    runs = (slice(0, 40), slice(40, 90))
    return LagData(
        y,
        phi[:, None] ** np.arange(3),
        weight,
        runs,
        PERIOD_S,
        hold,
        noise,
        order,
        exact_start,
        knot_spacing_s=0.02 if drifting else None,
    )


@pytest.mark.parametrize("exact_start", [False, True])
@pytest.mark.parametrize("drifting", [False, True])
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    ("noise", "rho"),
    [("output-error", []), ("arx", []), ("armax", [-0.7]), ("armax", [0.5, -0.3])],
)
def test_the_slope_of_the_cost_is_exact(
    noise: str, rho: list[float], hold: str, drifting: bool, exact_start: bool
) -> None:
    data = made(noise, hold, len(rho), exact_start, drifting)
    at = np.array([-4.0, *rho])
    slope = -2.0 * newton(data, profile(data, at)).slope
    for i in range(at.size):
        step = np.zeros(at.size)
        step[i] = 1e-5
        sides = [profile(data, at + sign * step).cost for sign in (1.0, -1.0)]
        assert slope[i] == pytest.approx((sides[0] - sides[1]) / 2e-5, rel=5e-6, abs=2e-8)


@pytest.mark.parametrize("noise", ["output-error", "arx", "armax"])
def test_errors_at_the_optimum_owe_nothing_to_what_is_linear(noise: str) -> None:
    data = made(noise, "first", int(noise == "armax"), True, True)
    at = profile(data, np.array([-4.0, *[-0.4] * data.order]))
    both = jacobian(data, at)
    linear = both[:, int(data.free.sum()) :]
    size = np.linalg.norm(at.errors)
    assert np.max(np.abs(linear.T @ at.errors)) < 1e-9 * size * np.linalg.norm(linear)
    drift = data.drift @ at.levels
    assert abs(data.weight @ drift) < 1e-9 * data.weight @ np.abs(drift)


@pytest.mark.parametrize("c", [[-0.6], [0.9], [0.5, 0.3]])
def test_the_cost_of_a_stretch_is_that_of_the_exact_likelihood(c: list[float]) -> None:
    """Unconditional least squares is r' Σ⁻¹ r with Σ the covariance of a moving average."""
    n = 30
    y = made("armax", "zero", 1, True, False).y[:n]
    whole = (slice(0, n),)
    one = LagData(y, np.zeros((n, 0)), np.ones(n), whole, PERIOD_S, "zero", "armax", len(c))
    free = MovingAverage.from_coefficients(np.array(c)).free
    cost = profile(one, np.concatenate([[np.log(TAU_S)], free])).cost
    a = np.exp(-PERIOD_S / TAU_S)
    equation = y[1:] - a * y[:-1]
    full = np.array([1.0, *MovingAverage(free).coefficients])
    autocovariance = np.zeros(n - 1)
    autocovariance[: full.size] = [full[k:] @ full[: full.size - k] for k in range(full.size)]
    exact = equation @ np.linalg.solve(toeplitz(autocovariance), equation)
    assert cost == pytest.approx(exact, rel=1e-9)
