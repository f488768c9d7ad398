"""Processor time of a fit beside the same fit by plain scipy, without any package of ours.

The script of plain scipy is variable projection by ``lfilter`` and ``least_squares`` from a given
start near τ, with a block jackknife of twenty blocks; ours finds its own start.
Run with one thread: ``OMP_NUM_THREADS=1 python benchmarks/speed_of_fits.py``.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import numpy as np
import pandas as pd
from lag_problem import MOVING_AVERAGE, PERIOD_S, simulate
from scipy.optimize import least_squares
from scipy.signal import lfilter

from classic_ml import LagRegressor

START_S = 0.03
ROWS = {2_000: 15, 20_000: 7, 1_000_000: 2}
N_BLOCKS = 20


def columns(
    theta: np.ndarray, phi: np.ndarray, y: np.ndarray, noise: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return target and columns of the linear problem at (log τ, ρ)."""
    a = np.exp(-PERIOD_S / np.exp(theta[0]))
    terms = np.vander(phi, 3, increasing=True)
    if noise == "output-error":
        runs, _ = lfilter([0.0, 1.0 - a], [1.0, -a], terms, axis=0, zi=a * terms[:1])
        return y, np.column_stack([runs, a ** np.arange(y.size)])
    target, driven = y[1:] - a * y[:-1], (1.0 - a) * terms[:-1]
    if noise == "armax":
        c = [1.0, np.tanh(theta[1])]
        target, driven = lfilter([1.0], c, target), lfilter([1.0], c, driven, axis=0)
    return target, driven


def by_scipy(phi: np.ndarray, y: np.ndarray, noise: str) -> tuple[float, float]:
    """Return τ and its standard error, in seconds."""

    def errors(theta: np.ndarray) -> np.ndarray:
        target, own = columns(theta, phi, y, noise)
        return np.asarray(target - own @ np.linalg.lstsq(own, target)[0])

    start = [np.log(START_S), 0.0][: 2 if noise == "armax" else 1]
    theta = least_squares(errors, start, ftol=1e-12, xtol=1e-10, gtol=1e-12).x
    target, own = columns(theta, phi, y, noise)
    beta = np.linalg.lstsq(own, target)[0]
    slopes = []
    for step in 1e-5 * np.eye(theta.size):
        sides = [columns(theta + sign * step, phi, y, noise) for sign in (1.0, -1.0)]
        ahead, behind = (one - table @ beta for one, table in sides)
        slopes.append((ahead - behind) / 2e-5)
    jacobian, left = np.column_stack([*slopes, -own]), target - own @ beta
    scale = np.linalg.norm(jacobian, axis=0)
    jacobian /= scale
    normal = jacobian.T @ jacobian
    moves = []
    for rows in np.array_split(np.arange(left.size), N_BLOCKS):
        part = jacobian[rows[0] : rows[-1] + 1]
        score = part.T @ left[rows[0] : rows[-1] + 1]
        moves.append(np.linalg.lstsq(normal - part.T @ part, score)[0][0] / scale[0])
    tau_s = float(np.exp(theta[0]))
    return tau_s, tau_s * float(np.sqrt(N_BLOCKS - 1) * np.std(moves))


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of a few calls, in seconds (other jobs do not count)."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        call()
        times.append(time.process_time() - before)
    return min(times)


def main() -> None:
    """Print the table."""
    rows = []
    for noise, (n, repeats) in itertools.product(("arx", "armax", "output-error"), ROWS.items()):
        made = simulate(n, 0, MOVING_AVERAGE)
        phi, y = made.phi, made.y
        model = LagRegressor(PERIOD_S, noise=noise).fit(phi[:2000, None], y[:2000])
        plain_s = seconds(lambda p=phi, y=y, k=noise: by_scipy(p, y, k), repeats)
        own_s = seconds(lambda m=model, p=phi, y=y: m.fit(p[:, None], y), repeats)
        tau_s, stderr_s = by_scipy(phi, y, noise)
        rows.append({
            "noise": noise,
            "rows": n,
            "scipy ms": 1e3 * plain_s,
            "ours ms": 1e3 * own_s,
            "ratio": plain_s / own_s,
            "tau ms": 1e3 * model.time_constant_s_,
            "scipy": 1e3 * tau_s,
            "stderr ms": 1e3 * model.time_constant_stderr_s_,
            "of scipy": 1e3 * stderr_s,
        })  # fmt: skip
    print(pd.DataFrame(rows).to_string(index=False, float_format="%.5g"))


if __name__ == "__main__":
    main()
