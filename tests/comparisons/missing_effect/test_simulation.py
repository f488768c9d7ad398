"""The extended lag model against integrations of its equations, and its limits."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect import find_effect
from comparisons.missing_effect.catalogue.workings import shape_columns, stall_episodes
from comparisons.missing_effect.fit import Structure
from comparisons.missing_effect.kernels import varying_lag_pass
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.noise import Metric, projected
from comparisons.missing_effect.ports import respond

Array = np.ndarray
CUBIC = ("1", "phi", "phi^2", "phi^3")
BETA = np.array([0.30, 0.40, 2.2, -4.0])
TAU_S = 0.1
PERIOD_S = 0.01
N = 1500
# The equations are integrated from well before the record, so that no start is left in it.
LEAD_S = 2.0
SETTLED_S = 1.5
STEPS_PER_SAMPLE = 20
SURGE = 2.0 * np.pi * 1.1
PLAIN = np.array([np.log(TAU_S)])


def amplitude(t: Array) -> Array:
    return 0.22 * (1.0 + 0.2 * np.sin(2.0 * np.pi * 0.08 * t + 0.3))


def flow(t: Array) -> Array:
    return 0.2 + amplitude(t) * np.sin(SURGE * t + 0.4) + 0.03 * np.sin(2.0 * SURGE * t + 1.0)


def flow_rate(t: Array) -> Array:
    swing = 0.22 * 0.2 * 2.0 * np.pi * 0.08 * np.cos(2.0 * np.pi * 0.08 * t + 0.3)
    return (
        amplitude(t) * SURGE * np.cos(SURGE * t + 0.4)
        + swing * np.sin(SURGE * t + 0.4)
        + 0.06 * SURGE * np.cos(2.0 * SURGE * t + 1.0)
    )


def temperature(t: Array) -> Array:
    return 288.0 * (1.0 + 0.01 * np.sin(SURGE * t) + 0.01 * np.sin(0.4 * t))


def temperature_rate(t: Array) -> Array:
    return 288.0 * (0.01 * SURGE * np.cos(SURGE * t) + 0.004 * np.cos(0.4 * t))


def speed(t: Array) -> Array:
    return 0.95 * (1.0 + 0.01 * np.sin(0.6 * t) + 0.004 * np.sin(SURGE * t + 1.0))


def steady(phi: Array) -> Array:
    return np.polynomial.polynomial.polyval(phi, BETA)


def record(n: int = N, period_s: float = PERIOD_S, first_s: float = 0.0) -> CoefficientSeries:
    t = first_s + period_s * np.arange(n)
    return CoefficientSeries(
        t,
        flow(t),
        steady(flow(t)),
        np.ones(n, dtype=np.int64),
        T25_K=temperature(t),
        Nc_frac=speed(t),
        in_stall=flow(t) < 0.18,
    )


@pytest.fixture(scope="module")
def data() -> LagData:
    return load_data([record()])


def integrated(
    target: Callable[[Array], Array],
    tau: Callable[[Array], Array] | None = None,
    *,
    n: int = N,
    period_s: float = PERIOD_S,
) -> Array:
    """ψ' at the samples by Runge-Kutta steps of fourth order over τ(t) dψ'/dt + ψ' = u(t)."""
    h = period_s / STEPS_PER_SAMPLE
    lead = round(LEAD_S / period_s) * STEPS_PER_SAMPLE
    steps = lead + (n - 1) * STEPS_PER_SAMPLE
    half = 0.5 * h * (np.arange(2 * steps + 1) - 2 * lead)
    u = target(half)
    rate = 1.0 / (np.full(half.size, TAU_S) if tau is None else tau(half))
    y = np.empty(steps + 1)
    y[0] = u[0]
    for k in range(steps):
        now, u0, u1, u2 = y[k], u[2 * k], u[2 * k + 1], u[2 * k + 2]
        r0, r1, r2 = rate[2 * k], rate[2 * k + 1], rate[2 * k + 2]
        k1 = r0 * (u0 - now)
        k2 = r1 * (u1 - now - 0.5 * h * k1)
        k3 = r1 * (u1 - now - 0.5 * h * k2)
        k4 = r2 * (u2 - now - h * k3)
        y[k + 1] = now + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return y[lead::STEPS_PER_SAMPLE]


def plain_target(t: Array) -> Array:
    return steady(flow(t))


def switched(t: Array, low: float, high: float) -> Array:
    """1 from φ < low until φ > high, instant by instant."""
    state, out = 0.0, np.empty(t.size)
    for k, value in enumerate(flow(t)):
        if value < low:
            state = 1.0
        elif value > high:
            state = 0.0
        out[k] = state
    return out


def simulated(name: str, values: tuple[float, ...], own: Array, data: LagData) -> Array:
    structure = Structure(CUBIC, (find_effect(name),))
    nonlinear = np.concatenate([PLAIN, values])
    return structure.output(data, nonlinear, np.concatenate([BETA, own]))


NONE = np.zeros(0)
TIME_S = PERIOD_S * np.arange(N)
TRUTHS: dict[str, tuple[str, tuple[float, ...], Array, Callable[[], Array]]] = {
    "delay": (
        "transport_delay",
        (0.0137,),
        NONE,
        lambda: integrated(lambda t: plain_target(t - 0.0137)),
    ),
    "heating": (
        "facility_heating",
        (0.08, 4.0),
        NONE,
        lambda: integrated(
            lambda t: plain_target(t) * (1.0 - 0.08 * (1.0 - np.exp(-np.maximum(t, 0.0) / 4.0)))
        ),
    ),
    "droop": (
        "speed_droop",
        (3.0,),
        NONE,
        lambda: integrated(lambda t: plain_target(t) * (speed(t) / np.mean(speed(TIME_S))) ** 3.0),
    ),
    "hysteresis": (
        "hysteresis",
        (0.1, 0.3),
        np.array([0.05]),
        lambda: integrated(lambda t: plain_target(t) - 0.05 * switched(t, 0.1, 0.3)),
    ),
    "reverse, lagged": (
        "reverse_flow_branch",
        (1.0,),
        np.array([20.0]),
        lambda: integrated(
            lambda t: plain_target(t) + 20.0 * np.where(flow(t) < 0.0, flow(t) ** 2, 0.0)
        ),
    ),
    "reverse, not lagged": (
        "reverse_flow_branch",
        (0.0,),
        np.array([20.0]),
        lambda: (
            integrated(plain_target) + 20.0 * np.where(flow(TIME_S) < 0.0, flow(TIME_S) ** 2, 0.0)
        ),
    ),
    "amplitude": (
        "amplitude_dependent_lag",
        (0.5, 1.0),
        NONE,
        lambda: integrated(
            plain_target,
            lambda t: TAU_S * (1.0 + 0.5 * (amplitude(t) / np.mean(amplitude(TIME_S)) - 1.0)),
        ),
    ),
    "asymmetric": (
        "asymmetric_lag",
        (0.2,),
        NONE,
        lambda: integrated(plain_target, lambda t: TAU_S * (1.0 + 0.2 * np.sign(flow_rate(t)))),
    ),
    "flow-dependent": (
        "flow_dependent_lag",
        (0.5, 0.15),
        NONE,
        lambda: integrated(plain_target, lambda t: TAU_S * (1.0 + 0.5 * (flow(t) < 0.15))),
    ),
    "inertia": (
        "flow_inertia",
        (),
        np.array([0.003]),
        lambda: integrated(plain_target) - 0.003 * flow_rate(TIME_S),
    ),
    "thermocouple": (
        "thermocouple_lag",
        (0.4,),
        NONE,
        lambda: (
            integrated(plain_target)
            * temperature(TIME_S)
            / (temperature(TIME_S) + 0.4 * temperature_rate(TIME_S))
        ),
    ),
    "sensitivity": (
        "sensitivity_drift",
        (0.004,),
        NONE,
        lambda: integrated(plain_target) * (1.0 + 0.004 * TIME_S),
    ),
    "bias": (
        "bias_drift",
        (),
        np.array([0.002]),
        lambda: integrated(plain_target) + 0.002 * TIME_S,
    ),
}


@pytest.fixture(scope="module")
def plain_truth() -> Array:
    return integrated(plain_target)


def off_by(found: Array, truth: Array, skip_s: float = SETTLED_S) -> float:
    """The rms difference once the start has gone, in standard deviations of ψ'."""
    rows = TIME_S[: truth.size] > skip_s
    return float(np.sqrt(np.mean((found - truth)[rows] ** 2)) / np.std(truth[rows]))


def test_the_bare_model_is_the_integral_of_its_equation(data: LagData, plain_truth: Array) -> None:
    assert off_by(Structure(CUBIC).output(data, PLAIN, BETA), plain_truth) < 1e-4


@pytest.mark.parametrize("case", TRUTHS)
def test_every_effect_is_the_integral_of_its_equation(
    case: str, data: LagData, plain_truth: Array
) -> None:
    name, values, own, integral = TRUTHS[case]
    truth = integral()
    assert off_by(simulated(name, values, own, data), truth) < 1e-3
    assert off_by(plain_truth, truth) > 1e-2


@pytest.mark.parametrize("share", [0.05, 0.2, 0.25, 0.6], ids=lambda s: f"a2 = {s} tau^2")
def test_second_order_is_the_integral_of_its_equation(
    share: float, data: LagData, plain_truth: Array
) -> None:
    a2 = share * TAU_S**2
    solution = solve_ivp(
        lambda t, y: [y[1], (steady(flow(np.array(t))) - y[0] - TAU_S * y[1]) / a2],
        (-LEAD_S, 6.0),
        [float(plain_target(np.array(-LEAD_S))), 0.0],
        t_eval=TIME_S[TIME_S <= 6.0],
        rtol=1e-7,
        atol=1e-9,
    )
    truth = solution.y[0]
    found = simulated("second_order_lag", (a2,), NONE, data)[: truth.size]
    assert off_by(found, truth) < 1e-3
    assert off_by(plain_truth[: truth.size], truth) > 1e-2


def test_a_ripple_has_a_phase_of_its_own_in_each_episode(data: LagData, plain_truth: Array) -> None:
    rng = np.random.default_rng(3)
    stalled = flow(TIME_S) < 0.18
    number = np.cumsum(np.diff(stalled.astype(int), prepend=0) > 0)
    theta = rng.uniform(0.0, 6.0, number[-1] + 1)
    wave = stalled * np.sin(2.0 * np.pi * 13.7 * TIME_S + theta[number])
    truth = plain_truth + 0.01 * wave
    episodes = stall_episodes(data, 0.0)
    structure = Structure(CUBIC, (find_effect("rotating_stall_ripple"),))
    ports = structure.ports(data, np.concatenate([PLAIN, [13.7, 0.0]]))
    columns = respond(ports, data, float(np.exp(PLAIN[0])))[:, 4:]
    assert columns.shape == (N, 2 * len(episodes))
    # Sine and cosine of an episode make up its wave, whatever instant they count from.
    own = np.linalg.lstsq(columns, 0.01 * wave, rcond=None)[0]
    assert np.allclose(np.hypot(*own.reshape(-1, 2).T), 0.01, rtol=1e-9)
    found = simulated("rotating_stall_ripple", (13.7, 0.0), own, data)
    inside = np.zeros(N, dtype=bool)
    for rows in episodes:
        inside[rows] = True
    # An episode of less than eight samples has no phase to speak of and is left out.
    assert np.count_nonzero(stalled & ~inside) < 8 * (len(theta) - len(episodes)) + 1
    use = inside | ~stalled
    assert off_by(np.where(use, found, 0.0), np.where(use, truth, 0.0)) < 1e-3
    assert off_by(plain_truth, truth) > 1e-2


def test_a_finer_sample_brings_the_model_to_its_equation() -> None:
    errors = []
    for period_s in (0.04, 0.02, 0.01):
        n = round(12.0 / period_s)
        truth = integrated(plain_target, n=n, period_s=period_s)
        found = Structure(CUBIC).output(load_data([record(n, period_s)]), PLAIN, BETA)
        settled = period_s * np.arange(n) > SETTLED_S
        errors.append(float(np.sqrt(np.mean((found - truth)[settled] ** 2))))
    # Inputs joined by straight lines: the error falls with the square of the step.
    for coarse, fine in pairwise(errors):
        assert 3.0 < coarse / fine < 6.0


def test_what_is_left_of_a_start_falls_with_the_integral_of_one_over_tau(data: LagData) -> None:
    structure = Structure(CUBIC, (find_effect("asymmetric_lag"),))
    decay = structure.respond_decay(data, np.append(PLAIN, 0.4))
    fine = np.linspace(0.0, 0.5, 100_001)
    tau = TAU_S * (1.0 + 0.4 * np.sign(flow_rate(fine)))
    integral = np.concatenate([[0.0], np.cumsum(np.diff(fine) / tau[1:])])
    expected = np.exp(-np.interp(TIME_S[:51], fine, integral))
    assert np.allclose(decay[:51], expected, atol=5e-3)
    assert not np.allclose(decay[:51], np.exp(-TIME_S[:51] / TAU_S), atol=5e-2)


def test_runs_do_not_know_of_each_other() -> None:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((90, 3))
    runs = np.array([[0, 41], [41, 90]])
    steps = rng.uniform(0.1, 0.4, (3, 90))
    both = varying_lag_pass(columns, *steps, runs, 4)
    second = varying_lag_pass(
        np.ascontiguousarray(columns[41:]),
        *np.ascontiguousarray(steps[:, 41:]),
        np.array([[0, 49]]),
        4,
    )
    assert both.shape == (11 + 13, 3)
    assert np.allclose(both[11:], second)
    # By hand: the exact answer to straight lines, one row at a time.
    a, now, before = 0.7, 0.16, 0.14
    constant = np.repeat([[a], [now], [before]], 90, axis=1)
    found = varying_lag_pass(columns, *constant, np.array([[0, 90]]), 1)
    state = columns[0]
    for k in range(1, 90):
        state = a * state + now * columns[k] + before * columns[k - 1]
        assert np.allclose(found[k], state)


def test_a_wrong_start_leaves_no_trace(data: LagData) -> None:
    """Errors of a start that is off lie wholly in what is projected out."""
    two = load_data([record(500), record(500, first_s=30.0)])
    structure = Structure(CUBIC)
    decay = structure.respond_decay(two, PLAIN)
    start = np.where(two.record == 0, 0.7, -0.4) * decay
    rng = np.random.default_rng(1)
    errors = rng.standard_normal(two.n_samples)
    for metric in (Metric(), Metric(0.3, np.array([0.6])), Metric(1.0, np.array([0.5, -0.2]))):
        with_start = metric.seen(errors + start, decay, two)
        assert np.allclose(with_start, metric.seen(errors, decay, two), atol=1e-10)
    once = projected(errors[:, None], decay, two)
    assert np.allclose(projected(once, decay, two), once)


def test_several_effects_act_at_their_ports_together(data: LagData) -> None:
    """A delay, a lag that rises and falls apart, and a drift of the sensor, all at once."""
    names = ("sensitivity_drift", "asymmetric_lag", "transport_delay")
    structure = Structure(CUBIC, tuple(find_effect(name) for name in names))
    found = structure.output(data, np.concatenate([PLAIN, [0.004, 0.2, 0.02]]), BETA)
    # The sign of dφ/dt is that of the φ that was measured.
    truth = integrated(
        lambda t: plain_target(t - 0.02), lambda t: TAU_S * (1.0 + 0.2 * np.sign(flow_rate(t)))
    ) * (1.0 + 0.004 * TIME_S)
    assert off_by(found, truth) < 1e-3


@pytest.mark.parametrize("n_base", [2, 3, 4])
def test_splines_leave_the_powers_of_the_base_alone(n_base: int) -> None:
    span = (-0.12, 0.55)
    phi = np.linspace(*span, 4001)
    columns = shape_columns(phi, span, 7, n_base)
    assert columns.shape[1] == 7 + 3 - n_base
    powers = np.vander((phi - span[0]) / (span[1] - span[0]), n_base, increasing=True)
    # Over the range no power of the base has a share in them, and none doubles another.
    assert np.max(np.abs(powers.T @ columns)) / phi.size < 0.02
    normal = columns.T @ columns / phi.size
    assert np.allclose(normal, np.eye(columns.shape[1]), atol=0.05)
    # What a base of degree below three lacks of a cubic, the splines have.
    lacking = phi**3 - np.polynomial.Polynomial.fit(phi, phi**3, n_base - 1)(phi)
    both = np.column_stack([powers, columns])
    left = phi**3 - both @ np.linalg.lstsq(both, phi**3, rcond=None)[0]
    assert np.max(np.abs(left)) < 1e-9
    assert np.max(np.abs(lacking)) > 1e-3 or n_base == 4


def test_splines_are_constant_beyond_the_range() -> None:
    span = (-0.12, 0.55)
    for side, end in (((-0.5, -0.12), -0.12), ((0.55, 0.9), 0.55)):
        beyond = shape_columns(np.linspace(*side, 50), span, 12, 4)
        assert np.allclose(beyond, shape_columns(np.array([end]), span, 12, 4))
