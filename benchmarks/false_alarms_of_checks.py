"""How often checks cry on records that are right, and how often BIC finds the right orders.

Run with one thread: ``OMP_NUM_THREADS=1 python benchmarks/false_alarms_of_checks.py [--quick]``.
Every residual check states 1 % (the leverage of cycles 2 %, for it fails on either of two tests);
the records are 12 cycles of 120 rows whose equation error is white and normal, so that arx is
right. Behind each count stands its binomial standard deviation. The orders are those of four noise
models with an input lag of 0, 1 or 2 samples and a characteristic of second degree.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.signal import lfilter

from classic_ml import LagRegressor
from classic_ml.checks import residual_checks
from classic_ml.orders import select_order

PERIOD_S = 1e-3
TAU_S = 0.018
POLE = float(np.exp(-PERIOD_S / TAU_S))
BETA = np.array([0.30, 1.20, -1.50])
STATED = {"whiteness": 0.01, "input_correlation": 0.01, "normality": 0.01, "leverage": 0.02}
# Noise model, order of C, and the numerator of the error over A; None is white error of the output.
TRUTHS: dict[str, tuple[str, int, list[float] | None]] = {
    "arx": ("arx", 0, [1.0]),
    "armax C1": ("armax", 1, [1.0, -0.6]),
    "armax C2": ("armax", 2, [1.0, -0.9, 0.5]),
    "output-error": ("output-error", 0, None),
}


def cycle(
    n: int, c: list[float] | None, input_lag: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Make φ and ψ' of one cycle: first-order hold, error of one kind."""
    t = np.arange(n) * PERIOD_S
    wander = lfilter([0.03], [1.0, -0.97], rng.standard_normal(n))
    sweep = 0.15 * np.sin(2 * np.pi * 1.2 * t + rng.uniform(0, 6))
    fast = 0.05 * np.sin(2 * np.pi * 6.0 * t + rng.uniform(0, 6))
    phi = 0.3 + sweep + fast + 0.6 * wander
    acting = np.concatenate([np.full(input_lag, phi[0]), phi[: n - input_lag]])
    f = np.polynomial.polynomial.polyval(acting, BETA)
    ratio = (1.0 - POLE) * TAU_S / PERIOD_S
    drive = (1.0 - ratio) * f[1:] + (ratio - POLE) * f[:-1]
    states, _ = lfilter([1.0], [1.0, -POLE], drive, zi=[POLE * f[0]])
    noise = 0.002 * rng.standard_normal(n)
    error = noise if c is None else lfilter(c, [1.0, -POLE], noise)
    return phi, np.concatenate([[f[0]], states]) + error


def record(
    seed: int, n_cycles: int, n: int, c: list[float] | None, input_lag: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    phi, psi_p = zip(*(cycle(n, c, input_lag, rng) for _ in range(n_cycles)), strict=True)
    return (
        np.concatenate(phi)[:, None],
        np.concatenate(psi_p),
        np.repeat(np.arange(n_cycles), n),
    )


def alarms(n_seeds: int) -> Counter[str]:
    """Count the failed checks of right models."""
    found: Counter[str] = Counter()
    for seed in range(n_seeds):
        X, y, labels = record(seed, 12, 120, [1.0])
        model = LagRegressor(PERIOD_S, noise="arx", hold="first").fit(X, y, labels)
        found.update(r.check for r in residual_checks(model, X, y, labels) if not r.passed)
    return found


def right_orders(truth: str, n_seeds: int, n: int) -> int:
    """Count the records of which BIC finds noise model, C, input lag and degree."""
    noise, order, c = TRUTHS[truth]
    right = 0
    for seed in range(n_seeds):
        X, y, labels = record(seed, 4, n, c, seed % 3)
        best = select_order(
            X, y, labels, sample_period_s=PERIOD_S, input_lags=(0, 1, 2), degrees=(2, 3),
        ).rows[0]  # fmt: skip
        found = (best.noise, best.noise_order, best.input_lag, best.degree)
        right += found == (noise, order, seed % 3, 2)
    return right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few seeds, to see that it runs")
    quick = parser.parse_args().quick
    n_checks, n_orders = (20, 2) if quick else (500, 50)
    found = alarms(n_checks)
    print(f"{'check':<20}{'stated':>8}{'found':>10}   of {n_checks} fits")
    for check, p in STATED.items():
        deviation = np.sqrt(p * (1.0 - p) / n_checks)
        print(f"{check:<20}{p:>8.1%}{found[check] / n_checks:>10.1%} ± {deviation:.1%}")
    print(f"\n{'truth':<20}{'rows':>8}{'right':>10}   of {n_orders} selections by BIC")
    for truth in TRUTHS:
        for n in (250, 400):
            print(f"{truth:<20}{4 * n:>8}{right_orders(truth, n_orders, n) / n_orders:>10.0%}")


if __name__ == "__main__":
    main()
