"""One record of a test at the level of coefficients, without noise, for effects of given size.

The compiled loops run over steps of any length and take their input at the start, the middle and
the end of each (rows 0, 1, 2), so that a step may end exactly where a branch of the model begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba import njit
from scipy.optimize.elementwise import find_root

from comparisons.rig.coefficient_effects import FORMS, Parameters
from comparisons.rig.coefficient_plant import LEAD_TIME_CONSTANTS, Plant, Points
from surge_core.types import FloatArray, IntArray

Planted = Mapping[str, Parameters]

# Below this h/τ the recurrence of the weights cancels; the series has converged to 1e-17 there.
_SERIES_BELOW = 0.5
_SERIES_TERMS = 14


def run_record(
    plant: Plant,
    record: int,
    time_s: FloatArray,
    planted: Planted,
    *,
    substeps: int,
    curve_offset: FloatArray | None = None,
) -> FloatArray:
    """Return ψ' of one record, at its uniform samples on the facility clock.

    A lag with constant τ is exact for a ψ'_QS that is a parabola over a step, of which there are
    `substeps` from one sample to the next; any other is of fourth order in it. `curve_offset` is
    added to ψ'_QS, held from each sample to the next.
    """
    at, step_s, samples = lay_steps(plant, record, time_s, planted, substeps)
    curve = plant.quasi_steady(at.phi)
    for name, parameters in planted.items():
        change = FORMS[name].curve
        if change is not None:
            curve = change(parameters, at, curve)
    if curve_offset is not None:
        place = np.clip(np.searchsorted(time_s, at.time_s[1]) - 1, 0, time_s.size - 1)
        curve = curve + curve_offset[place]
    psi = _lagged(at, step_s, np.ascontiguousarray(curve), planted)
    if "sensor_backlash" in planted:
        psi = backlash(psi, planted["sensor_backlash"]["half_width"])
    shown = psi[samples]
    flow = plant.flows[record]
    # Sensors see φ before any delay.
    at = Points(plant, record, time_s, *flow.at(time_s))
    for name, parameters in planted.items():
        change = FORMS[name].output
        if change is not None:
            shown = change(parameters, at, shown)
    return shown


def lay_steps(
    plant: Plant, record: int, time_s: FloatArray, planted: Planted, substeps: int
) -> tuple[Points, FloatArray, IntArray]:
    """Lay the m steps of integration over a record, one of them ending at every event.

    Returned are their starts, middles and ends with the φ that acts there, from twelve of the
    longest time constants before the first sample to the last one; their lengths; and where the
    samples are among their m + 1 ends.
    """
    flow = plant.flows[record]
    delay_s = planted.get("transport_delay", {}).get("delay_s", 0.0)
    longest_s = max(plant.tau_s, planted.get("second_slow_mode", {}).get("slow_tau_s", 0.0))
    step_s = float(time_s[1] - time_s[0]) / substeps
    n_lead = int(np.ceil(LEAD_TIME_CONSTANTS * longest_s / step_s))
    steps = np.arange(-n_lead, (time_s.size - 1) * substeps + 1)
    nodes = time_s[0] + step_s * steps
    phi = flow.values(nodes - delay_s)
    samples = np.arange(n_lead, nodes.size, substeps)
    acting = nodes - delay_s
    levels = [level for name, p in planted.items() for level in FORMS[name].levels(p)]
    events = [_crossings(flow.values, acting, level) for level in levels]
    if "asymmetric_lag" in planted:
        events.append(_crossings(flow.rates, acting, 0.0))
    if events:
        extra = np.sort(np.concatenate(events)) + delay_s
        place = np.searchsorted(nodes, extra)
        samples = samples + np.searchsorted(extra, nodes[samples], side="left")
        nodes = np.insert(nodes, place, extra)
        phi = np.insert(phi, place, flow.values(extra - delay_s))
    middles = 0.5 * (nodes[:-1] + nodes[1:])
    instants = np.stack((nodes[:-1], middles, nodes[1:]))
    middle_phi, rate = flow.at(middles - delay_s)
    acting_phi = np.stack((phi[:-1], middle_phi, phi[1:]))
    return Points(plant, record, instants, acting_phi, rate), np.diff(nodes), samples


def _crossings(
    function: Callable[[FloatArray], FloatArray], time_s: FloatArray, level: float
) -> FloatArray:
    """Return where a function of time crosses a level, between two of the times given."""
    values = function(time_s) - level
    at = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    found = find_root(lambda t: function(t) - level, (time_s[at], time_s[at + 1]))
    return np.asarray(found.x)


def _lagged(at: Points, step_s: FloatArray, curve: FloatArray, planted: Planted) -> FloatArray:
    """Pass ψ'_QS through the lag, begun from the quasi-steady value."""
    tau, start = at.plant.tau_s, float(curve[0, 0])
    if "second_order_lag" in planted:
        return _second_order(step_s, curve, tau, planted["second_order_lag"]["a2_s2"])
    factors = [f(p, at) for name, p in planted.items() if (f := FORMS[name].lag) is not None]
    kappa = planted.get("nonlinear_relaxation", {}).get("kappa", 0.0)
    psi: FloatArray
    if factors or kappa:
        rate_hz = np.ones_like(at.phi) / tau
        for factor in factors:
            rate_hz = rate_hz / factor
        psi = _varying_lag(step_s, curve, rate_hz, kappa, start)
    else:
        psi = constant_lag(step_s, curve, tau, start)
    if "second_slow_mode" in planted:
        share, slow_s = (planted["second_slow_mode"][k] for k in ("share", "slow_tau_s"))
        psi = (1.0 - share) * psi + share * constant_lag(step_s, curve, slow_s, start)
    return psi


def _second_order(step_s: FloatArray, curve: FloatArray, tau: float, a2_s2: float) -> FloatArray:
    """Integrate a₂ ψ'' + τ ψ' + ψ = u as the sum of its two modes, which need not be real."""
    start = complex(curve[0, 0])
    spread = np.sqrt(complex(tau**2 - 4.0 * a2_s2))
    slow, fast = 0.5 * (tau + spread), 0.5 * (tau - spread)
    if abs(fast) < np.finfo(np.float64).eps * tau:
        return np.asarray(constant_lag(step_s, curve, tau, start.real))
    first = constant_lag(step_s, curve, slow, start)
    second = constant_lag(step_s, curve, fast, start)
    return np.asarray(((slow * first - fast * second) / spread).real)


@njit(cache=True)
def _moment(z: Any, power: int) -> Any:
    """Return z ∫₀¹ exp(−z (1 − s)) s^power ds by its series."""
    term = z / (power + 1.0)
    total = term
    for j in range(1, _SERIES_TERMS):
        term = -term * z / (power + 1.0 + j)
        total = total + term
    return total


@njit(cache=True)
def constant_lag(step_s: Any, inputs: Any, tau_s: Any, start: Any) -> Any:
    """Integrate τ dy/dt + y = u exactly for an input that is a parabola over each of m steps.

    `inputs` has u at the start, the middle and the end of each step (3, m); y comes at their m + 1
    ends. τ is complex for one of the two modes of a lag that rings, and `start` of its type.
    """
    y = np.full(step_s.size + 1, start)
    last = -1.0
    # Moments of s⁰, s¹ and s² over the step; they change only with its length.
    decay = m0 = m1 = m2 = start
    for i in range(step_s.size):
        h = step_s[i]
        if h != last:
            z = h / tau_s
            decay = np.exp(-z)
            if abs(z) < _SERIES_BELOW:
                m0 = _moment(z, 0)
                m1 = _moment(z, 1)
                m2 = _moment(z, 2)
            else:
                m0 = 1.0 - decay
                m1 = 1.0 - m0 / z
                m2 = 1.0 - 2.0 * m1 / z
            last = h
        u0, um, u1 = inputs[0, i], inputs[1, i], inputs[2, i]
        slope = -3.0 * u0 + 4.0 * um - u1
        bend = 2.0 * (u0 - 2.0 * um + u1)
        y[i + 1] = decay * y[i] + m0 * u0 + m1 * slope + m2 * bend
    return y


@njit(cache=True)
def _varying_lag(step_s: Any, inputs: Any, rate_hz: Any, kappa: float, start: float) -> Any:
    """Integrate dy/dt = (e + κ e|e|) r(t), e = u − y, by Runge-Kutta steps of fourth order.

    As `constant_lag`, with r = 1/τ in 1/s at the start, the middle and the end of each step.
    """
    y = np.empty(step_s.size + 1)
    y[0] = start
    for i in range(step_s.size):
        h, now = step_s[i], y[i]
        e = inputs[0, i] - now
        k1 = (e + kappa * e * abs(e)) * rate_hz[0, i]
        e = inputs[1, i] - now - 0.5 * h * k1
        k2 = (e + kappa * e * abs(e)) * rate_hz[1, i]
        e = inputs[1, i] - now - 0.5 * h * k2
        k3 = (e + kappa * e * abs(e)) * rate_hz[1, i]
        e = inputs[2, i] - now - h * k3
        k4 = (e + kappa * e * abs(e)) * rate_hz[2, i]
        y[i + 1] = now + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return y


@njit(cache=True)
def backlash(values: Any, half_width: float) -> Any:
    """Return what a sensor with play shows: it follows only when pushed by either edge.

    The signal is monotone between neighbours; the play starts in its middle.
    """
    shown = np.empty_like(values)
    shown[0] = values[0]
    for i in range(1, values.size):
        shown[i] = min(max(shown[i - 1], values[i] - half_width), values[i] + half_width)
    return shown
