"""Compiled loops behind the tests at the level of coefficients.

Every loop runs over steps of any length and takes its input at the start, the middle and the end of
each (rows 0, 1, 2), so that a step may end exactly where a branch of the model begins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

__all__ = ["backlash", "constant_lag", "varying_lag"]

# Below this h/τ the recurrence of the weights cancels; the series has converged to 1e-17 there.
_SERIES_BELOW = 0.5
_SERIES_TERMS = 14


def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with an on-disk cache where some directory can be written, else without."""
    try:
        compiled: Callable[..., Any] = njit(cache=True)(function)
    except RuntimeError:
        compiled = njit(function)
    return compiled


@_compile
def _moment(z: Any, power: int) -> Any:
    """Return z ∫₀¹ exp(−z (1 − s)) s^power ds by its series."""
    term = z / (power + 1.0)
    total = term
    for j in range(1, _SERIES_TERMS):
        term = -term * z / (power + 1.0 + j)
        total = total + term
    return total


@_compile
def constant_lag(step_s: Any, inputs: Any, tau_s: Any, start: Any) -> Any:
    """Integrate τ dy/dt + y = u exactly for an input that is a parabola over each step.

    Parameters
    ----------
    step_s : ndarray of shape (m,)
        Length of each step, in seconds.
    inputs : ndarray of shape (3, m)
        u at the start, the middle and the end of each step.
    tau_s : float or complex
        Time constant; complex for one of the two modes of a lag that rings.
    start : float or complex
        y at the start of the first step, of the type of `tau_s`.

    Returns
    -------
    ndarray of shape (m + 1,)
        y at the ends of the steps, the start first.
    """
    y = np.full(step_s.size + 1, start)
    last = -1.0
    # Moments of s⁰, s¹ and s² over the step; they change only with its length.
    decay = start
    m0 = start
    m1 = start
    m2 = start
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


@_compile
def varying_lag(step_s: Any, inputs: Any, rate_hz: Any, kappa: float, start: float) -> Any:
    """Integrate dy/dt = (e + κ e|e|) r(t), e = u − y, by Runge-Kutta steps of fourth order.

    Parameters
    ----------
    step_s : ndarray of shape (m,)
        Length of each step, in seconds.
    inputs, rate_hz : ndarray of shape (3, m)
        u, and r = 1/τ in 1/s, at the start, the middle and the end of each step.
    kappa : float
        Share of the relaxation that grows with the distance itself; 0: a lag.
    start : float
        y at the start of the first step.

    Returns
    -------
    ndarray of shape (m + 1,)
        y at the ends of the steps, the start first.
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


@_compile
def backlash(values: Any, half_width: float) -> Any:
    """Return what a sensor with play shows: it follows only when pushed by either edge.

    Parameters
    ----------
    values : ndarray of shape (m,)
        Signal, fine enough to be monotone between neighbours.
    half_width : float
        Half the play.

    Returns
    -------
    ndarray of shape (m,)
        The reading; it starts in the middle of the play.
    """
    shown = np.empty_like(values)
    shown[0] = values[0]
    for i in range(1, values.size):
        shown[i] = min(max(shown[i - 1], values[i] - half_width), values[i] + half_width)
    return shown
