"""What no catalogue has obeys its equation, held against integrations of the test's own.

The effects of the catalogue are held to their equations by test_simulation.py, where the model of
the diagnosis is integrated by other means, and by test_fit.py, which recovers from these records
the numbers that were hidden in them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from comparisons.rig.coefficient_plant import draw_plant
from comparisons.rig.coefficient_runs import backlash, constant_lag, run_record
from comparisons.rig.coefficient_tests import CoefficientTest, simulate_test

FloatArray = NDArray[np.float64]
Right = Callable[[float, FloatArray], FloatArray | float | list[float]]

# Fine enough that a spline through the samples of φ is φ to 1e-9.
PERIOD_S = 0.002
SEED = 3


@cache
def fine_test(effect: str | None) -> CoefficientTest:
    return simulate_test(
        effect, strength=3.0, seed=SEED, n_samples=2500, sample_period_s=PERIOD_S, n_records=2
    )


class Truth:
    """The second record of a test, interpolated by the test's own means."""

    def __init__(self, effect: str | None) -> None:
        test = fine_test(effect)
        record = test.records[1]
        self.time, self.clean = record.time_s, test.clean[1]
        self.tau, self.beta = test.tau_s, np.array(test.beta)
        self.p: dict[str, float] = dict(test.effects[effect]) if effect else {}
        self.phi = CubicSpline(record.time_s, record.phi)
        self.speed = CubicSpline(record.time_s, record.Nc_frac)

    def curve(self, phi: FloatArray | float) -> FloatArray:
        return np.asarray(np.polynomial.polynomial.polyval(phi, self.beta))

    def solve(self, right: Right, *, first: int = 0) -> FloatArray:
        """Return the first state at the samples from `first` on."""
        time = self.time[first:]
        found = solve_ivp(
            right,
            (time[0], time[-1]),
            self.clean[first : first + 1],
            t_eval=time,
            rtol=1e-7,
            atol=1e-9,
            max_step=0.02,
        )
        assert found.success
        return np.asarray(found.y[0])

    def lag(self, curve: Callable[[float], FloatArray | float], first: int = 0) -> FloatArray:
        return self.solve(lambda t, y: (curve(t) - y) / self.tau, first=first)


def assert_same(got: FloatArray, wanted: FloatArray, effect_size: float) -> None:
    assert effect_size > 0.0
    assert float(np.max(np.abs(got - wanted))) < 2e-3 * effect_size


def effect_of(name: str) -> float:
    """Return the largest change that an effect makes."""
    pairs = zip(fine_test(name).clean, fine_test(None).clean, strict=True)
    return max(float(np.max(np.abs(a - b))) for a, b in pairs)


def test_without_an_effect_the_lag_alone_acts() -> None:
    truth = Truth(None)
    assert np.ptp(truth.clean) > 0.1
    got = truth.lag(lambda t: truth.curve(truth.phi(t)))
    np.testing.assert_allclose(truth.clean, got, atol=1e-6)


def test_time_constant_that_varies_with_the_speed() -> None:
    name = "speed_dependent_lag"
    truth = Truth(name)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        tau = truth.tau * (truth.speed(t) / truth.p["reference_frac"]) ** truth.p["exponent"]
        return (truth.curve(truth.phi(t)) - y) / tau

    got = truth.solve(rate)
    assert_same(truth.clean, got, effect_of(name))


def test_nonlinear_relaxation() -> None:
    name = "nonlinear_relaxation"
    truth = Truth(name)

    def right(t: float, y: FloatArray) -> FloatArray:
        e = truth.curve(truth.phi(t)) - y
        return np.asarray((e + truth.p["kappa"] * e * np.abs(e)) / truth.tau)

    assert_same(truth.clean, truth.solve(right), effect_of(name))


def test_second_slow_mode() -> None:
    name = "second_slow_mode"
    truth, base = Truth(name), fine_test(None).clean[1]
    share, slow_s = truth.p["share"], truth.p["slow_tau_s"]
    slow = (truth.clean - (1.0 - share) * base) / share
    got = solve_ivp(
        lambda t, y: (truth.curve(truth.phi(t)) - y) / slow_s,
        (truth.time[0], truth.time[-1]),
        slow[:1],
        t_eval=truth.time,
        rtol=1e-8,
        atol=1e-10,
    ).y[0]
    np.testing.assert_allclose(slow, got, atol=1e-5 * np.ptp(slow) / share)


def quadratic(truth: Truth, psi: FloatArray) -> FloatArray:
    return np.asarray(psi + truth.p["curvature"] * (psi - truth.p["centre"]) ** 2)


def saturation(truth: Truth, psi: FloatArray) -> FloatArray:
    soft = truth.p["softness"]
    return np.asarray(
        psi - truth.p["share"] * soft * np.log1p(np.exp((psi - truth.p["knee"]) / soft))
    )


@pytest.mark.parametrize(
    ("name", "shown"), [("sensor_quadratic", quadratic), ("sensor_saturation", saturation)]
)
def test_effect_on_the_output(name: str, shown: Callable[[Truth, FloatArray], FloatArray]) -> None:
    truth = Truth(name)
    assert_same(truth.clean, shown(truth, fine_test(None).clean[1]), effect_of(name))


def test_amplitude_memory_is_the_depth_of_the_cycle_before() -> None:
    name = "amplitude_memory"
    truth = Truth(name)
    phi = truth.phi(truth.time)
    falls = np.flatnonzero((phi[:-1] >= truth.p["phi_mean"]) & (phi[1:] < truth.p["phi_mean"])) + 1
    assert falls.size >= 4
    deepest = np.array([phi[a:b].min() for a, b in pairwise(falls)])
    depth = truth.p["phi_mean"] - deepest
    gain = 1.0 + truth.p["slope"] * (depth / truth.p["mean_depth"] - 1.0)
    # Within cycle i the gain is that of cycle i - 1: from the second fall on.
    at = truth.time[falls[1:]]

    def curve(t: float) -> FloatArray:
        return truth.curve(truth.phi(t)) * gain[np.searchsorted(at, t, side="right") - 1]

    got = truth.lag(curve, int(falls[1]))
    assert_same(truth.clean[falls[1] :], got, 10.0 * effect_of(name))


def test_backlash_holds_until_the_play_is_used_up() -> None:
    shown = backlash(np.array([0.0, 0.5, 1.0, 3.0, 2.0, 1.5, 0.0, 0.5]), 1.0)
    np.testing.assert_array_equal(shown, [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 1.0, 1.0])
    name = "sensor_backlash"
    truth, base = Truth(name), fine_test(None).clean[1]
    assert np.max(np.abs(truth.clean - base)) == pytest.approx(truth.p["half_width"], rel=1e-6)


@pytest.mark.parametrize("z", [1e-6, 0.49, 0.51, 40.0])
def test_constant_lag_is_exact_for_a_parabola(z: float) -> None:
    step, tau = 0.1, 0.1 / z
    time = step * np.arange(6)
    a, b, c = 0.3, -2.0, 7.0

    def particular(t: FloatArray) -> FloatArray:
        # y of u = a + bt + ct² by undetermined coefficients.
        return np.asarray(a - b * tau + 2.0 * c * tau**2 + (b - 2.0 * c * tau) * t + c * t**2)

    nodes = np.stack((time[:-1], time[:-1] + step / 2, time[1:]))
    got = constant_lag(np.full(5, step), a + b * nodes + c * nodes**2, tau, 1.0)
    start = 1.0 - particular(time[:1])
    wanted = particular(time) + start * np.exp(-time / tau)
    size = float(np.max(np.abs(particular(time))))
    np.testing.assert_allclose(got, wanted, atol=1e-12 * max(size, 1.0))


@pytest.mark.parametrize("name", [None, "hysteresis", "asymmetric_lag", "flow_dependent_lag"])
def test_the_grid_is_fine_enough(name: str | None) -> None:
    test = simulate_test(name, strength=3.0, seed=1, n_samples=1000, n_records=1)
    plant = draw_plant(
        np.random.default_rng([1, *b"plant"]),
        n_records=1,
        duration_s=10.0,
        sample_period_s=0.01,
        degree=3,
    )
    time = test.records[0].time_s
    finer = run_record(plant, 0, time, test.effects, substeps=40)
    np.testing.assert_allclose(test.clean[0], finer, atol=1e-4 * test.sigma)
