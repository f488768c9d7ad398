"""A driven mass on a spring, hardening or not, as records and as a model file that lacks it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

PERIOD_S, NOISE_M = 0.05, 0.002
MASS, DAMPING, STIFFNESS, CUBIC = 1.0, 0.4, 8.0, 5.0

MODEL = """
from comparisons.missing_effect import Model, P

def rhs(t, x, u, p):
    return x.v, (u.F - p.c * x.v - p.k * x.q) / p.m

def output(t, x, u, p):
    return x.q

model = Model(
    states={"q": "m", "v": "m/s"},
    inputs={"F": "N"},
    outputs={"y": "m"},
    params={
        "m": P(1.3, 0.1, 10.0, "kg"),
        "c": P(0.5, 0.0, 5.0, "N s/m"),
        "k": P(10.0, 1.0, 100.0, "N/m"),
    },
    rhs=rhs,
    output=output,
    exact=("q",),
    balance={"v": ("m", "N")},
    name="mass on a spring",
)
"""


def table(seed: int, n: int = 600, cubic: float = CUBIC) -> pd.DataFrame:
    """A run from rest under a force of limited band."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(n) * PERIOD_S
    force = 8.0 * sosfilt(butter(3, 0.2, output="sos"), rng.standard_normal(n))
    between = CubicSpline(time_s, force)
    run = solve_ivp(
        lambda t, x: [
            x[1],
            (between(t) - DAMPING * x[1] - STIFFNESS * x[0] - cubic * x[0] ** 3) / MASS,
        ],
        (0.0, time_s[-1]),
        [0.0, 0.0],
        t_eval=time_s,
        rtol=1e-8,
        atol=1e-10,
    )
    read = run.y[0] + NOISE_M * rng.standard_normal(n)
    return pd.DataFrame({"time_s": time_s, "F": force, "y": read})


def files(folder: Path, cubic: float = CUBIC) -> tuple[Path, Path, Path]:
    """Model file, training record and check record in a folder."""
    paths = (folder / "model.py", folder / "train.csv", folder / "check.csv")
    paths[0].write_text(MODEL, "utf-8")
    for seed, path in enumerate(paths[1:]):
        table(seed, cubic=cubic).to_csv(path, index=False)
    return paths
