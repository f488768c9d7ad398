"""The discrete lag against the differential equation it stands for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from surge_core.lag import FirstOrderLag

HOLDS = ("zero", "first")


def test_pole_is_the_papers_number_for_18_and_243_ms() -> None:
    # The paper prints a = 0.945959 for 18 ms and a = 0.995893 for 243 ms.
    assert FirstOrderLag(0.018, 1e-3, "zero").a == pytest.approx(0.945959, abs=5e-7)
    assert FirstOrderLag(0.243, 1e-3, "zero").a == pytest.approx(0.995893, abs=5e-7)


def test_zero_hold_is_equations_9_to_11_to_the_letter() -> None:
    lag = FirstOrderLag(0.018, 1e-3, "zero")
    rng = np.random.default_rng(1)
    f = rng.standard_normal(50)
    x = lag.respond(f, 0.3)
    a = np.exp(-1.0 / 18.0)
    np.testing.assert_allclose(x[1:], a * x[:-1] + (1.0 - a) * f[:-1], rtol=1e-13)


@pytest.mark.parametrize("hold", HOLDS)
def test_the_recursion_solves_the_differential_equation(hold: str) -> None:
    tau, h = 0.018, 1e-3
    rng = np.random.default_rng(2)
    f = np.cumsum(rng.standard_normal(80)) * 0.1
    t = np.arange(80) * h

    def f_between(time: float) -> float:
        if hold == "first":
            return float(np.interp(time, t, f))
        return float(f[min(int(time / h + 1e-9), 79)])

    expected = [0.4]
    for k in range(1, 80):
        piece = solve_ivp(
            lambda time, x: [(f_between(time) - x[0]) / tau],
            (t[k - 1], t[k] - 1e-12),
            [expected[-1]],
            rtol=1e-10,
            atol=1e-12,
            max_step=h / 4,
        )
        expected.append(float(piece.y[0, -1]))
    x = FirstOrderLag(tau, h, hold).respond(f, 0.4)
    np.testing.assert_allclose(x, expected, atol=2e-8)


@pytest.mark.parametrize("hold", HOLDS)
def test_limits(hold: str) -> None:
    f = np.sin(np.linspace(0.0, 6.0, 400))
    quick = FirstOrderLag(1e-7, 1e-3, hold).respond(f, f[0])
    delayed = np.concatenate([[f[0]], f[:-1]]) if hold == "zero" else f
    np.testing.assert_allclose(quick, delayed, atol=2e-4)
    slow = FirstOrderLag(1e9, 1e-3, hold).respond(f, 0.7)
    np.testing.assert_allclose(slow, 0.7, atol=1e-8)
    assert np.all(FirstOrderLag(0.02, 1e-3, hold).respond(np.zeros(10), 0.0) == 0.0)
    constant = FirstOrderLag(0.02, 1e-3, hold).respond(np.full(30, 2.5), 2.5)
    np.testing.assert_allclose(constant, 2.5, rtol=1e-13)


@pytest.mark.parametrize("hold", HOLDS)
def test_derivative_matches_finite_differences(hold: str) -> None:
    rng = np.random.default_rng(3)
    f = rng.standard_normal(60)
    step = 1e-5
    tau = 0.018

    def run(log_tau: float) -> np.ndarray:
        return FirstOrderLag(float(np.exp(log_tau)), 1e-3, hold).respond(f, 0.2)

    lag = FirstOrderLag(tau, 1e-3, hold)
    exact = lag.d_respond(f, lag.respond(f, 0.2))
    numeric = (run(np.log(tau) + step) - run(np.log(tau) - step)) / (2 * step)
    np.testing.assert_allclose(exact, numeric, atol=1e-9)
