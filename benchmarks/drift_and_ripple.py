"""τ under a drift three times the signal, a ripple and a low-pass: the failure of the paper's day.

ψ' drifts by 3.3 of its own standard deviations (half a ramp, half an exponential of 1 s) and
carries an 82 Hz ripple of 0.03 and white noise of 0.004; ψ' and the s_i pass the same causal 48 Hz
filter. Run: ``OMP_NUM_THREADS=1 python benchmarks/drift_and_ripple.py [seeds]``.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.stats import t as student
from sklearn.preprocessing import FunctionTransformer

from classic_ml import LagRegressor

PERIOD_S = 1e-3
TAU_S = 0.018
BETA = np.array([0.30, 1.20, -1.50])
POLE = float(np.exp(-PERIOD_S / TAU_S))
N_ROWS = 10_000
DRIFT_STD = 3.3


def record(seed: int, filtered: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Make the terms s_i and ψ' as they come out of the filter."""
    rng = np.random.default_rng(seed)
    t = np.arange(N_ROWS) * PERIOD_S
    low = butter(2, 6.0, fs=1.0 / PERIOD_S)
    wander = lfilter(*low, rng.standard_normal(N_ROWS + 2000))[2000:]
    sweep = 0.03 * np.sin(2 * np.pi * 1.2 * t + rng.uniform(0, 6))
    phi = 0.3 + sweep + 0.05 * wander / wander.std()
    terms = phi[:, None] ** np.arange(3)
    f = terms @ BETA
    y = f[0] * POLE ** np.arange(N_ROWS) + lfilter([0.0, 1.0 - POLE], [1.0, -POLE], f)
    drift = 0.5 * t / t[-1] + 0.5 * (1.0 - np.exp(-t))
    y = y + DRIFT_STD * y.std() * drift
    y += 0.03 * np.sin(2 * np.pi * 82.0 * t + rng.uniform(0, 6))
    y += 0.004 * rng.standard_normal(N_ROWS)
    if not filtered:
        return terms, y
    b, a = butter(5, 48.0, fs=1.0 / PERIOD_S)
    both = np.column_stack([terms, y])
    start = lfilter_zi(b, a)[:, None] * both[0]
    both, _ = lfilter(b, a, both, axis=0, zi=start)
    return both[:, :3], both[:, 3]


def study(n_seeds: int, filtered: bool, options: dict[str, object]) -> dict[str, float]:
    """Return what the fits of many seeds come to."""
    taus, inside, ratio = [], [], []
    for seed in range(n_seeds):
        terms, y = record(seed, filtered)
        m = LagRegressor(
            PERIOD_S, noise="output-error", basis=FunctionTransformer(), **options
        ).fit(terms, y)
        off = np.log(m.time_constant_s_ / TAU_S)
        stderr = m.time_constant_stderr_s_ / m.time_constant_s_
        taus.append(m.time_constant_s_)
        inside.append(abs(off) < student.isf(0.025, m.n_blocks_ - 1) * stderr)
        ratio.append(off / stderr)
    worst = np.max(np.abs(np.asarray(taus) / TAU_S - 1.0))
    return {
        "median off, %": 100 * (np.median(taus) / TAU_S - 1.0),
        "worst off, %": 100 * worst,
        "scatter, %": 100 * np.std(taus) / TAU_S,
        "covered": float(np.mean(inside)),
        "rms z": float(np.sqrt(np.mean(np.square(ratio)))),
        "blocks": float(m.n_blocks_),
    }


def main(n_seeds: int) -> None:
    """Print the table."""
    cases: dict[str, tuple[bool, dict[str, object]]] = {
        "drift='spline', as it comes": (True, {"drift": "spline"}),
        "not filtered": (False, {"drift": "spline"}),
        "knots 0.5 s": (True, {"drift": "spline", "knot_spacing_s": 0.5}),
        "knots 0.25 s": (True, {"drift": "spline", "knot_spacing_s": 0.25}),
        "knots 2 s": (True, {"drift": "spline", "knot_spacing_s": 2.0}),
        "no drift allowed for": (True, {}),
    }
    print(f"{n_seeds} seeds of {N_ROWS} rows, drift of {DRIFT_STD} std, tau {1e3 * TAU_S:g} ms")
    for number, (name, (filtered, options)) in enumerate(cases.items()):
        result = study(n_seeds, filtered, options)
        if number == 0:
            print(f"{'':28s} " + " ".join(f"{key:>13s}" for key in result))
        print(f"{name:28s} " + " ".join(f"{value:13.3f}" for value in result.values()))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
