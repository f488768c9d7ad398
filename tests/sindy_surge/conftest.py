"""Records with a known truth, made without any code of the package under test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

TAU_S = 0.018
PERIOD_S = 1e-3

CURVES: dict[str, Callable[[Any], Any]] = {
    "quadratic": lambda p: 0.35 + 1.2 * p - 1.9 * p**2,
    "cubic": lambda p: 0.30 + 0.5 * p + 3 * p**2 - 7 * p**3,
    "hinge": lambda p: 0.35 + 0.8 * p - 1.6 * np.maximum(p - 0.3, 0),
    "reverse": lambda p: 0.35 + 1.2 * p - 1.9 * p**2 + 20 * p**2 * (p < 0),
}
TERMS = {
    "quadratic": {"1": 0.35, "phi": 1.2, "phi^2": -1.9},
    "cubic": {"1": 0.30, "phi": 0.5, "phi^2": 3.0, "phi^3": -7.0},
    "hinge": {"1": 0.35, "phi": 0.8, "relu(phi-0.3)": -1.6},
    "reverse": {"1": 0.35, "phi": 1.2, "phi^2": -1.9, "phi^2[phi<0]": 20.0},
}


@dataclass(frozen=True)
class Truth:
    phi: np.ndarray
    psi_p: np.ndarray
    clean_phi: np.ndarray
    clean_psi_p: np.ndarray


def relaxation_wave(n_fine: int, step_s: float, rng: np.random.Generator) -> np.ndarray:
    """φ of a surging machine: a Van der Pol oscillation (mu = 3) that wanders from 5 to 7 Hz."""
    mu, period = 3.0, 8.859  # period of the oscillator in its own time
    knots = np.arange(int(n_fine * step_s * 2) + 3) * 0.5
    frequency = np.interp(np.arange(n_fine) * step_s, knots, rng.uniform(5, 7, knots.size))
    lead = int((0.5 + rng.uniform(0, 1 / 6)) / step_s)
    frequency = np.concatenate((np.full(lead, frequency[0]), frequency))
    x, v, wave = 2.0, 0.0, np.empty(frequency.size)
    for i, f in enumerate(frequency):
        s = f * period * step_s
        xm, vm = x + s / 2 * v, v + s / 2 * (mu * (1 - x * x) * v - x)
        x, v = x + s * vm, v + s * (mu * (1 - xm * xm) * vm - xm)
        wave[i] = x
    return 0.235 + 0.1365 * wave[lead:]


def lag(forcing: np.ndarray, step_s: float, hold: str = "first", start: float = 0.4) -> np.ndarray:
    """Exact response of the lag, written out from the textbook and not from the package."""
    pole = np.exp(-step_s / TAU_S)
    ratio = (1 - pole) * TAU_S / step_s
    now, before = (1 - ratio, ratio - pole) if hold == "first" else (0.0, 1 - pole)
    drive = now * forcing[1:] + before * forcing[:-1]
    states, _ = lfilter([1.0], [1.0, -pole], drive, zi=[pole * start])
    return np.concatenate(([start], states))


@pytest.fixture(scope="session")
def surge() -> Callable[..., Truth]:
    """Return a maker of records, simulated at eight times the sample rate."""
    waves: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}

    def make(curve: str, noise: float, seed: int, n: int = 4000) -> Truth:
        key = (seed, n)
        if key not in waves:
            rng = np.random.default_rng(seed)
            waves[key] = relaxation_wave(8 * n, PERIOD_S / 8, rng), rng.standard_normal((2, n))
        fine, white = waves[key]
        psi_p = lag(CURVES[curve](fine), PERIOD_S / 8)[::8]
        phi = fine[::8]
        noisy = (s + noise * s.std() * w for s, w in zip((phi, psi_p), white, strict=True))
        return Truth(*noisy, phi, psi_p)

    return make
