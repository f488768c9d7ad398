"""Fit both estimators to arrays of your own, without any file of this project.

φ sweeps through a parabola behind a lag of 18 ms; both should find the lag and the parabola.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from classic_ml import LagRegressor
from sindy_surge import SparseLagRegressor

PERIOD_S = 1e-3
TAU_S = 0.018


def make_record(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.arange(4000) * PERIOD_S
    phi = 0.2 + 0.18 * np.sin(2 * np.pi * 6.9 * t + 2.0 * np.sin(2 * np.pi * 0.7 * t))
    quasi_steady = 0.35 + 1.2 * phi - 1.9 * phi**2
    a = np.exp(-PERIOD_S / TAU_S)
    ramp = (1 - a) * TAU_S / PERIOD_S
    drive = (1 - ramp) * quasi_steady[1:] + (ramp - a) * quasi_steady[:-1]
    lagged, _ = lfilter([1.0], [1.0, -a], drive, zi=[a * quasi_steady[0]])
    psi_p = np.concatenate([quasi_steady[:1], lagged])
    return phi[:, None], psi_p + 0.002 * rng.standard_normal(psi_p.size)


def main() -> None:
    X, y = make_record(seed=0)
    classical = LagRegressor(PERIOD_S, noise="output-error", hold="first").fit(X, y)
    print(classical.equation())
    print(f"tau = {classical.time_constant_s_:.5f} ± {classical.time_constant_stderr_s_:.5f} s")
    sparse = SparseLagRegressor(PERIOD_S).fit(X, y)
    print(sparse.equation())
    value, stderr = classical.characteristic([0.1, 0.2, 0.3])
    print("characteristic at 0.1, 0.2, 0.3:", value.round(4), "±", stderr.round(4))


if __name__ == "__main__":
    main()
