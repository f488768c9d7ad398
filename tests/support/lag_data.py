"""Signals with a known lag, made without the code that recovers it."""

from __future__ import annotations

import numpy as np

TAU_S = 0.018
BETA = np.array([0.30, 1.20, -1.50])
PERIOD_S = 1e-3


def flow(n: int, rng: np.random.Generator) -> np.ndarray:
    """A flow coefficient that sweeps and wanders, as a throttle does."""
    t = np.arange(n) * PERIOD_S
    wander = np.zeros(n)
    noise = rng.standard_normal(n)
    for k in range(1, n):
        wander[k] = 0.97 * wander[k - 1] + 0.03 * noise[k]
    sweep = 0.15 * np.sin(2 * np.pi * 1.2 * t + rng.uniform(0, 6))
    fast = 0.05 * np.sin(2 * np.pi * 6.0 * t + rng.uniform(0, 6))
    return 0.3 + sweep + fast + 0.6 * wander


def lagged(phi: np.ndarray, hold: str, tau_s: float = TAU_S) -> np.ndarray:
    """The exact lag response by a plain loop over samples, from rest."""
    f = BETA[0] + BETA[1] * phi + BETA[2] * phi**2
    a = np.exp(-PERIOD_S / tau_s)
    r = (1.0 - a) * tau_s / PERIOD_S
    now, before = (0.0, 1.0 - a) if hold == "zero" else (1.0 - r, r - a)
    x = np.empty_like(f)
    x[0] = f[0]
    for k in range(1, f.size):
        x[k] = a * x[k - 1] + now * f[k] + before * f[k - 1]
    return x


def coloured(n: int, c: float, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Error of an armax model on the output: A n = C e."""
    a = np.exp(-PERIOD_S / TAU_S)
    e = sigma * rng.standard_normal(n)
    out = np.zeros(n)
    for k in range(1, n):
        out[k] = a * out[k - 1] + e[k] + c * e[k - 1]
    return out
