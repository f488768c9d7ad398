"""Every hidden effect obeys its equation, held against integrations of the test's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import butter, hilbert, sosfiltfilt

from comparisons.rig.coefficient_kernels import backlash, constant_lag
from comparisons.rig.coefficient_plant import Plant, draw_plant
from comparisons.rig.coefficient_runs import run_record
from comparisons.rig.coefficient_tests import (
    CoefficientRecord,
    CoefficientTest,
    simulate_test,
)

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
    """One record, interpolated by the test's own means."""

    def __init__(
        self, record: CoefficientRecord, clean: FloatArray, tau: float, beta: tuple[float, ...]
    ) -> None:
        self.time, self.clean = record.time_s, clean
        self.tau, self.beta = tau, np.array(beta)
        self.p: dict[str, float] = {}
        self.phi = CubicSpline(record.time_s, record.phi)
        self.rate = self.phi.derivative()
        self.speed = CubicSpline(record.time_s, record.Nc_frac)
        self.temperature = CubicSpline(record.time_s, record.T25_K)

    @classmethod
    def of(cls, test: CoefficientTest, effect: str | None) -> Truth:
        """Take the second record of a test."""
        truth = cls(test.records[1], test.clean[1], test.tau_s, test.beta)
        truth.p = dict(test.effects[effect]) if effect else {}
        return truth

    def curve(self, phi: FloatArray | float) -> FloatArray:
        return np.asarray(np.polynomial.polynomial.polyval(phi, self.beta))

    def solve(
        self,
        right: Right,
        *,
        first: int = 0,
        start: FloatArray | None = None,
        method: str = "RK45",
    ) -> FloatArray:
        """Return the first state at the samples from `first` on."""
        time = self.time[first:]
        found = solve_ivp(
            right,
            (time[0], time[-1]),
            self.clean[first : first + 1] if start is None else start,
            t_eval=time,
            rtol=1e-7,
            atol=1e-9,
            max_step=0.02,
            method=method,
        )
        assert found.success
        return np.asarray(found.y[0])

    def lag(self, curve: Callable[[float], FloatArray | float], first: int = 0) -> FloatArray:
        return self.solve(lambda t, y: (curve(t) - y) / self.tau, first=first)


def assert_same(got: FloatArray, wanted: FloatArray, effect_size: float) -> None:
    assert effect_size > 0.0
    assert float(np.max(np.abs(got - wanted))) < 2e-3 * effect_size


def run_alone(name: str | None, parameters: dict[str, float]) -> Truth:
    """Run one record with an effect of any parameters."""
    plant = small_plant()
    time = plant.flows[0].origin_s + PERIOD_S * np.arange(2500)
    clean = run_record(plant, 0, time, {name: parameters} if name else {}, substeps=8)
    phi, level = plant.flows[0].values(time), np.ones_like(time)
    record = CoefficientRecord(time, phi, clean, T25_K=level, Nc_frac=level)
    return Truth(record, clean, plant.tau_s, plant.beta)


def effect_of(name: str) -> float:
    """Return the largest change that an effect makes."""
    pairs = zip(fine_test(name).clean, fine_test(None).clean, strict=True)
    return max(float(np.max(np.abs(a - b))) for a, b in pairs)


def test_without_an_effect_the_lag_alone_acts() -> None:
    truth = Truth.of(fine_test(None), None)
    assert np.ptp(truth.clean) > 0.1
    got = truth.lag(lambda t: truth.curve(truth.phi(t)))
    np.testing.assert_allclose(truth.clean, got, atol=1e-6)


def test_transport_delay_acts_on_what_the_flow_was() -> None:
    name = "transport_delay"
    truth = Truth.of(fine_test(name), name)
    first = int(np.ceil(truth.p["delay_s"] / PERIOD_S)) + 1
    got = truth.lag(lambda t: truth.curve(truth.phi(t - truth.p["delay_s"])), first)
    assert_same(truth.clean[first:], got, effect_of(name))


def heating(truth: Truth, t: float) -> FloatArray:
    p = truth.p
    return truth.curve(truth.phi(t)) * (
        1.0 - p["loss_frac"] * (1.0 - np.exp(-t / p["heating_time_s"]))
    )


def droop(truth: Truth, t: float) -> FloatArray:
    ratio = truth.speed(t) / truth.p["reference_frac"]
    return np.asarray(truth.curve(truth.phi(t)) * ratio ** truth.p["exponent"])


def bump(truth: Truth, t: float) -> FloatArray:
    p, phi = truth.p, truth.phi(t)
    return np.asarray(
        truth.curve(phi) + p["height"] * np.exp(-0.5 * ((phi - p["centre"]) / p["width"]) ** 2)
    )


@pytest.mark.parametrize(
    ("name", "curve"),
    [("facility_heating", heating), ("speed_droop", droop), ("characteristic_shape", bump)],
)
def test_effect_on_the_characteristic(
    name: str, curve: Callable[[Truth, float], FloatArray]
) -> None:
    truth = Truth.of(fine_test(name), name)
    got = truth.lag(lambda t: curve(truth, t))
    assert_same(truth.clean, got, effect_of(name))


def test_hysteresis_switches_low_and_back_high() -> None:
    name = "hysteresis"
    truth = Truth.of(fine_test(name), name)
    low, high, step = (truth.p[k] for k in ("phi_lo", "phi_hi", "step"))
    assert low < high
    phi = truth.phi(truth.time)
    first = int(np.flatnonzero(phi < low)[0])
    edges = truth.time[first] + np.arange(0.0, truth.time[-1] - truth.time[first], 1e-5)
    # A loop that an eye can follow, over a clock finer than the record's.
    state, states = True, []
    for value in truth.phi(edges):
        state = True if value < low else False if value > high else state
        states.append(state)
    switched = np.array(states)

    def curve(t: float) -> FloatArray:
        index = min(int((t - edges[0]) / 1e-5), switched.size - 1)
        return truth.curve(truth.phi(t)) - step * switched[index]

    assert 0.1 < switched.mean() < 0.9
    assert_same(truth.clean[first:], truth.lag(curve, first), effect_of(name))


@pytest.mark.parametrize("lagged", [True, False])
def test_reverse_flow_branch_with_and_without_the_lag(lagged: bool) -> None:
    coefficient = 20.0
    truth = run_alone("reverse_flow_branch", {"coefficient": coefficient, "lagged": float(lagged)})

    def loss(t: FloatArray | float) -> FloatArray:
        phi = truth.phi(t)
        return np.asarray(np.where(phi < 0.0, coefficient * phi**2, 0.0))

    assert np.max(loss(truth.time)) > 0.01
    base = run_alone(None, {}).clean
    if lagged:
        got = truth.lag(lambda t: truth.curve(truth.phi(t)) + loss(t))
    else:
        got = base + loss(truth.time)
    assert_same(truth.clean, got, float(np.max(np.abs(truth.clean - base))))


def second_order(truth: Truth, a2_s2: float) -> FloatArray:
    def right(t: float, y: FloatArray) -> list[float]:
        return [y[1], float(truth.curve(truth.phi(t)) - y[0] - truth.tau * y[1]) / a2_s2]

    slope = float(CubicSpline(truth.time, truth.clean).derivative()(truth.time[0]))
    return truth.solve(right, start=np.array([truth.clean[0], slope]), method="LSODA")


def test_second_order_lag() -> None:
    name = "second_order_lag"
    truth = Truth.of(fine_test(name), name)
    assert_same(truth.clean, second_order(truth, truth.p["a2_s2"]), effect_of(name))


def test_amplitude_dependent_lag_follows_the_envelope() -> None:
    name = "amplitude_dependent_lag"
    test = simulate_test(name, strength=3.0, seed=SEED, n_samples=4000)
    truth = Truth.of(test, name)
    phi = test.records[1].phi
    cycles = np.sum(np.diff(np.sign(phi - phi.mean())) > 0)
    low_pass = butter(2, 0.2 * cycles / 40.0, fs=100.0, output="sos")
    amplitude = CubicSpline(truth.time, sosfiltfilt(low_pass, abs(hilbert(phi - phi.mean()))))
    inside = slice(500, 3500)
    assert np.ptp(amplitude(truth.time[inside])) > 0.1 * truth.p["mean_amplitude"]
    share = amplitude(truth.time[inside]) / truth.p["mean_amplitude"]
    assert 0.6 < share.min() < 1.4

    def right(t: float, y: FloatArray) -> FloatArray:
        slope = truth.p["slope"] * (amplitude(t) / truth.p["mean_amplitude"] - 1.0)
        return np.asarray((truth.curve(truth.phi(t)) - y) / (truth.tau * (1.0 + slope)))

    got = truth.solve(right, first=500)[: 3500 - 500]
    untouched = simulate_test(None, seed=SEED, n_samples=4000).clean[1][inside]
    effect = truth.clean[inside] - untouched
    # The envelope of a record alone differs a little from that of the flow that goes on.
    assert np.std(truth.clean[inside] - got) < 0.03 * np.std(effect)
    # Written out: the mean of A over all records.
    envelopes = [abs(hilbert(r.phi - r.phi.mean())).mean() for r in test.records]
    assert np.mean(envelopes) == pytest.approx(truth.p["mean_amplitude"], rel=0.01)


def asymmetric(truth: Truth, t: float) -> float:
    return float(1.0 + truth.p["slope"] * np.sign(truth.rate(t)))


def flow_dependent(truth: Truth, t: float) -> float:
    return 1.0 + truth.p["slope"] * float(truth.phi(t) < truth.p["phi_threshold"])


def speed_dependent(truth: Truth, t: float) -> float:
    return float((truth.speed(t) / truth.p["reference_frac"]) ** truth.p["exponent"])


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("asymmetric_lag", asymmetric),
        ("flow_dependent_lag", flow_dependent),
        ("speed_dependent_lag", speed_dependent),
    ],
)
def test_time_constant_that_varies(name: str, factor: Callable[[Truth, float], float]) -> None:
    truth = Truth.of(fine_test(name), name)
    got = truth.solve(lambda t, y: (truth.curve(truth.phi(t)) - y) / (truth.tau * factor(truth, t)))
    assert_same(truth.clean, got, effect_of(name))


def test_nonlinear_relaxation() -> None:
    name = "nonlinear_relaxation"
    truth = Truth.of(fine_test(name), name)

    def right(t: float, y: FloatArray) -> FloatArray:
        e = truth.curve(truth.phi(t)) - y
        return np.asarray((e + truth.p["kappa"] * e * np.abs(e)) / truth.tau)

    assert_same(truth.clean, truth.solve(right), effect_of(name))


def test_second_slow_mode() -> None:
    name = "second_slow_mode"
    test = fine_test(name)
    truth, base = Truth.of(test, name), fine_test(None).clean[1]
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


def inertia(truth: Truth, psi: FloatArray) -> FloatArray:
    return np.asarray(psi - truth.p["length_s"] * truth.rate(truth.time))


def thermocouple(truth: Truth, psi: FloatArray) -> FloatArray:
    shown = truth.temperature(truth.time)
    gas = shown + truth.p["lag_s"] * truth.temperature.derivative()(truth.time)
    return np.asarray(psi * shown / gas)


def sensitivity(truth: Truth, psi: FloatArray) -> FloatArray:
    return np.asarray(psi * (1.0 + truth.p["rate_per_s"] * truth.time))


def bias(truth: Truth, psi: FloatArray) -> FloatArray:
    return np.asarray(psi + truth.p["rate_per_s"] * truth.time)


def quadratic(truth: Truth, psi: FloatArray) -> FloatArray:
    return np.asarray(psi + truth.p["curvature"] * (psi - truth.p["centre"]) ** 2)


def saturation(truth: Truth, psi: FloatArray) -> FloatArray:
    soft = truth.p["softness"]
    return np.asarray(
        psi - truth.p["share"] * soft * np.log1p(np.exp((psi - truth.p["knee"]) / soft))
    )


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("flow_inertia", inertia),
        ("thermocouple_lag", thermocouple),
        ("sensitivity_drift", sensitivity),
        ("bias_drift", bias),
        ("sensor_quadratic", quadratic),
        ("sensor_saturation", saturation),
    ],
)
def test_effect_on_the_output(name: str, shown: Callable[[Truth, FloatArray], FloatArray]) -> None:
    truth = Truth.of(fine_test(name), name)
    assert_same(truth.clean, shown(truth, fine_test(None).clean[1]), effect_of(name))


def test_ripple_has_one_frequency_and_a_phase_of_its_own_in_each_episode() -> None:
    name = "rotating_stall_ripple"
    test = fine_test(name)
    truth, stalled = Truth.of(test, name), test.records[1].in_stall
    assert stalled is not None
    np.testing.assert_array_equal(stalled, truth.phi(truth.time) < truth.p["phi_threshold"])
    ripple = truth.clean - fine_test(None).clean[1]
    assert np.max(np.abs(ripple[~stalled])) == 0.0
    assert 5.0 < truth.p["frequency_hz"] < 0.4 / PERIOD_S
    angle = 2.0 * np.pi * truth.p["frequency_hz"] * truth.time
    starts = np.flatnonzero(np.diff(stalled.astype(int), prepend=0) == 1)
    phases = []
    for begin in starts[:-1]:
        end = begin + int(np.argmin(stalled[begin:]))
        waves = np.column_stack((np.sin(angle[begin:end]), np.cos(angle[begin:end])))
        (s, c), *_ = np.linalg.lstsq(waves, ripple[begin:end])
        np.testing.assert_allclose(waves @ [s, c], ripple[begin:end], atol=1e-9)
        assert np.hypot(s, c) == pytest.approx(truth.p["amplitude"])
        phases.append(np.arctan2(c, s))
    assert len(phases) >= 4
    assert np.min(np.abs(np.subtract.outer(phases, phases) + 9.0 * np.eye(len(phases)))) > 1e-3


def test_amplitude_memory_is_the_depth_of_the_cycle_before() -> None:
    name = "amplitude_memory"
    truth = Truth.of(fine_test(name), name)
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
    truth, base = Truth.of(fine_test(name), name), fine_test(None).clean[1]
    assert np.max(np.abs(truth.clean - base)) == pytest.approx(truth.p["half_width"], rel=1e-6)


@pytest.mark.parametrize("z", [1e-6, 1e-2, 0.49, 0.51, 3.0, 40.0])
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


def small_plant() -> Plant:
    return draw_plant(
        np.random.default_rng(5),
        n_records=1,
        duration_s=6.0,
        sample_period_s=PERIOD_S,
        degree=3,
    )


@pytest.mark.parametrize("name", [None, "hysteresis", "asymmetric_lag", "flow_dependent_lag"])
def test_the_grid_is_fine_enough(name: str | None) -> None:
    test = simulate_test(name, strength=3.0, seed=1, n_samples=1000, n_records=1)
    plant = simulate_plant_of(1, 1000)
    time = test.records[0].time_s
    finer = run_record(plant, 0, time, test.effects, substeps=40)
    np.testing.assert_allclose(test.clean[0], finer, atol=1e-4 * test.sigma)


def simulate_plant_of(seed: int, n_samples: int) -> Plant:
    return draw_plant(
        np.random.default_rng([seed, *b"plant"]),
        n_records=1,
        duration_s=n_samples * 0.01,
        sample_period_s=0.01,
        degree=3,
    )
