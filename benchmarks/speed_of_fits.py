"""Cost of a fit in passes of scipy's first-order filter over the same array, and its memory.

Run with one thread: ``OMP_NUM_THREADS=1 python benchmarks/speed_of_fits.py``.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from classic_ml import LagRegressor

PERIOD_S = 1e-3
TAU_S = 0.018
BETA = (0.30, 1.20, -1.50)
CASES: dict[str, dict[str, object]] = {
    "arx": {"noise": "arx"},
    "armax, C of order 1": {"noise": "armax"},
    "armax, C of order 2": {"noise": "armax", "noise_order": 2},
    "output error": {"noise": "output-error"},
    "output error, drift (1 s knots)": {"noise": "output-error", "drift": "spline"},
    "armax, drift (1 s knots)": {"noise": "armax", "drift": "spline"},
}


def record(n: int, drifting: bool) -> tuple[np.ndarray, np.ndarray]:
    """Make n rows of φ and ψ' with white noise in the equation and a moving average of -0.6."""
    rng = np.random.default_rng(0)
    t = np.arange(n) * PERIOD_S
    wander = lfilter([0.03], [1.0, -0.97], rng.standard_normal(n))
    phi = 0.3 + 0.15 * np.sin(2 * np.pi * 1.2 * t) + 0.6 * wander
    a = np.exp(-PERIOD_S / TAU_S)
    f = np.polynomial.polynomial.polyval(phi, BETA)
    e = 0.002 * rng.standard_normal(n + 1)
    y = lfilter([0.0, 1.0 - a], [1.0, -a], f) + lfilter([1.0], [1.0, -a], e[1:] - 0.6 * e[:-1])
    if drifting:
        y = y + 0.05 * np.sin(2 * np.pi * t / 37.0) + 0.02 * np.sin(2 * np.pi * t / 9.0)
    return phi[:, None], y


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of a few calls, in seconds (other jobs do not count)."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        call()
        times.append(time.process_time() - before)
    return min(times)


def values_a_sample(call: Callable[[], object], n: int) -> float:
    """Return the peak memory of a call, in float64 a sample."""
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 8.0 / n


def main() -> None:
    """Print the table."""
    print(f"{'fit':34s} {'rows':>9s} {'s':>8s} {'passes':>8s} {'float64/row':>12s} {'tau ms':>9s}")
    for name, options in CASES.items():
        for n in (10_000, 100_000, 1_000_000):
            X, y = record(n, "drift" in options)
            model = LagRegressor(PERIOD_S, **options)
            model.fit(X[:2000], y[:2000])
            one = seconds(lambda y=y: lfilter([1.0], [1.0, -0.9], y), 7)
            fit = seconds(lambda m=model, X=X, y=y: m.fit(X, y), 7)
            one = min(one, seconds(lambda y=y: lfilter([1.0], [1.0, -0.9], y), 7))
            memory = values_a_sample(lambda m=model, X=X, y=y: m.fit(X, y), n)
            tau = 1e3 * model.time_constant_s_
            print(f"{name:34s} {n:9d} {fit:8.4f} {fit / one:8.1f} {memory:12.1f} {tau:9.4f}")


if __name__ == "__main__":
    main()
