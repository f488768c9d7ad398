"""The recursions of the extended lag model, compiled: every column of its inputs in one pass."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IntArray

# No "nnan" and no "ninf": outliers must still come out as what they are.
FAST = {"reassoc", "contract", "nsz", "arcp"}
compiled: Callable[..., Any] = njit(cache=True, fastmath=FAST, error_model="numpy")


@compiled
def varying_lag_pass(
    columns: FloatArray,
    a: FloatArray,
    now: FloatArray,
    before: FloatArray,
    runs: IntArray,
    every: int,
) -> FloatArray:
    """Answer of τ(t) dx/dt + x = u to each column, kept at every so many rows; starts at rest.

    ``a[k]``, ``now[k]`` and ``before[k]`` lead from row k-1 to k.
    """
    q = columns.shape[1]
    out = np.empty((np.sum((runs[:, 1] - runs[:, 0] - 1) // every + 1), q))
    state = np.empty(q)
    row = 0
    for r in range(runs.shape[0]):
        start, stop = runs[r, 0], runs[r, 1]
        for j in range(q):
            state[j] = columns[start, j]
            out[row, j] = state[j]
        row += 1
        left = every
        for k in range(start + 1, stop):
            for j in range(q):
                state[j] = a[k] * state[j] + now[k] * columns[k, j] + before[k] * columns[k - 1, j]
            left -= 1
            if left == 0:
                left = every
                for j in range(q):
                    out[row, j] = state[j]
                row += 1
    return out


def lag_pass(
    columns: FloatArray, tau_s: float, step_s: float, runs: IntArray, every: int = 1
) -> FloatArray:
    """Answer of τ dx/dt + x = u to each column, kept at every so many rows; starts at rest."""
    lag = FirstOrderLag(tau_s, step_s, "first")
    steps = np.broadcast_to([[lag.a], [lag.gain_now], [lag.gain_before]], (3, columns.shape[0]))
    answer: FloatArray = varying_lag_pass(columns, *np.ascontiguousarray(steps), runs, every)
    return answer


def second_order_pass(
    columns: FloatArray, tau_s: float, a2_s2: float, step_s: float, runs: IntArray, every: int
) -> FloatArray:
    """Answer of a₂ d²x/dt² + τ dx/dt + x = u; starts as after a long ramp, which x follows by τ."""
    from scipy.signal import lfilter

    ahead, back = _second_order_step(a2_s2 / step_s**2, tau_s / step_s)
    out = []
    for start, stop in runs:
        u = columns[start:stop]
        ramp = u[0] + np.arange(stop - start)[:, None] * (u[1] - u[0])
        x = lfilter(ahead, back, u - ramp, axis=0) + ramp - tau_s / step_s * (u[1] - u[0])
        out.append(x[::every])
    return np.concatenate(out)


@lru_cache(maxsize=64)
def _second_order_step(a2_steps: float, tau_steps: float) -> tuple[FloatArray, FloatArray]:
    """Return the exact difference equation of a₂ ẍ + τ ẋ + x = u for u joined by straight lines."""
    from scipy.signal import cont2discrete

    ahead, back, _ = cont2discrete(
        (np.array([1.0]), np.array([a2_steps, tau_steps, 1.0])), 1.0, "foh"
    )
    return ahead[0], back


def shifted(signal: FloatArray, steps: float, runs: IntArray) -> FloatArray:
    """Return a signal later by any number of steps, by cubics through four rows of each run."""
    out = np.empty_like(signal)
    for start, stop in runs:
        last = stop - start - 1
        at = np.clip(np.arange(last + 1) - steps, 0.0, last)
        left = np.minimum(at.astype(np.int64), last - 1)
        f = at - left
        y0, y1, y2, y3 = (signal[start + np.clip(left + k, 0, last)] for k in (-1, 0, 1, 2))
        out[start:stop] = (
            -f * (f - 1.0) * (f - 2.0) / 6.0 * y0
            + (f + 1.0) * (f - 1.0) * (f - 2.0) / 2.0 * y1
            - (f + 1.0) * f * (f - 2.0) / 2.0 * y2
            + (f + 1.0) * f * (f - 1.0) / 6.0 * y3
        )
    return out


def whiten(columns: FloatArray, ar: FloatArray, weight: FloatArray, runs: IntArray) -> FloatArray:
    """Return w[k] (x[k] - Σ a_i x[k-i]) of each column, zero where a row before is missing."""
    out = columns.copy()
    for back, a in enumerate(ar, 1):
        out[back:] -= a * columns[:-back]
    out *= weight[:, None]
    out[weight == 0.0] = 0.0
    for start, stop in runs:
        out[start : min(start + ar.size, stop)] = 0.0
    return out


@compiled
def flow_noise_whiten(
    columns: FloatArray,
    a: float,
    now: float,
    before: float,
    slope: FloatArray,
    ratio: float,
    weight: FloatArray,
    runs: IntArray,
) -> tuple[FloatArray, float]:
    """Whiten errors that hold the lag's answer to noise on φ beside white noise of variance one.

    A Kalman filter over the lag's answer and the last noise; returns the innovations over their
    standard deviations, and half the sum of the logarithms of their variances.
    """
    q = columns.shape[1]
    out = np.zeros_like(columns)
    x, u = np.zeros(q), np.zeros(q)
    half_log = 0.0
    for r in range(runs.shape[0]):
        x[:] = 0.0
        u[:] = 0.0
        pxx, pxu, puu = 0.0, 0.0, 0.0
        for k in range(runs[r, 0], runs[r, 1]):
            new = ratio * slope[k] * slope[k]
            pxx = a * a * pxx + 2.0 * a * before * pxu + before * before * puu + now * now * new
            pxu, puu = now * new, new
            for j in range(q):
                x[j] = a * x[j] + before * u[j]
                u[j] = 0.0
            w = weight[k]
            if w == 0.0:
                continue
            s = pxx + 1.0
            kx, ku = pxx / s, pxu / s
            root = np.sqrt(s)
            half_log += 0.5 * np.log(s)
            for j in range(q):
                v = columns[k, j] - x[j]
                out[k, j] = w * v / root
                x[j] += kx * v
                u[j] += ku * v
            puu -= ku * pxu
            pxu -= kx * pxu
            pxx -= kx * pxx
    return out, half_log
