"""What is hidden on the pages of the general catalogue: a small system for each name.

The truths and the models are those of the tests: an own Runge-Kutta method, and a model that lacks
the effect and starts from wrong parameters.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

import system_models
import system_truths

from comparisons.missing_effect import Experiment, Model, SystemDiagnosis, diagnose_model

__all__ = ["CASES", "NOISE", "Case", "Found", "found"]

FloatArray = NDArray[np.float64]
ROWS, CHECK_ROWS, NOISE = 2000, 800, 0.01
CHECK_SEED = 5000
# Corner and spread of the recorder's filter, in samples and their square.
ALPHA, BETA = 0.5, 1.0
FINER = 4


@dataclass(frozen=True)
class Case:
    """One system with one effect in its truth.

    Parameters
    ----------
    system : str
        Which.
    told : str
        What is hidden, in words.
    hidden : mapping
        Options of its truth.
    model : mapping
        What its model has otherwise.
    every : int
        Rows of the truth to a row of the record.
    """

    system: str
    told: str
    hidden: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    every: int = 1


def _force(shape: Callable[[float, float], float]) -> dict[str, Any]:
    return {"force": lambda t, q, v: shape(q, v)}


def _stribeck(_: float, v: float) -> float:
    return -1.2 * float(np.tanh(v / 1e-3)) * (1.0 + 1.5 * float(np.exp(-((v / 0.15) ** 2))))


def _hardening(t: float, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
    return x.speed, (u.F - p.c * x.speed - p.k * x.at - p.k3 * x.at**3) / p.M


CASES: dict[str, Case] = {
    "cubic_stiffness": Case(
        "body", "a force of −100 N/m³ · q³", _force(lambda q, v: -100.0 * q**3)
    ),
    "quadratic_stiffness": Case(
        "body", "a force of −15 N/m² · q²", _force(lambda q, v: -15.0 * q**2)
    ),
    "quadratic_drag": Case("pipe", "0.3 kPa/(dm³/s)² against Q|Q|", {"drag": 0.3}),
    "coulomb_friction": Case(
        "body", "1.5 N against the motion", _force(lambda q, v: -1.5 * float(np.tanh(v / 1e-3)))
    ),
    "stribeck_friction": Case(
        "body", "1.2 N against the motion, 3 N where it is slower than about 0.15 m/s",
        _force(_stribeck),
    ),
    "dead_zone": Case("circuit", "a drive that gives nothing within ± 1 V", {"drive_gap": 1.0}),
    "backlash": Case("body", "a play of ± 2 N in the drive", {"play": 2.0}),
    "hysteresis": Case(
        "body", "a Dahl force of 4 N that builds up over 0.05 m", {"hysteresis": (4.0, 0.05)}
    ),
    "saturation": Case("circuit", "a drive that gives no more than ± 10 V", {"drive_limit": 10.0}),
    "overflow": Case("tanks", "a first tank that spills above 9.5 dm", {"rim": 9.5}),
    "absolute_value_sensor": Case("body", "a sensor that reads |q|", {"sensor": np.abs}),
    "rectifying_sensor": Case(
        "body", "a sensor that reads nothing below zero", {"sensor": lambda q: np.maximum(q, 0.0)}
    ),
    "gravity": Case("body", "a constant force of 3 N", _force(lambda q, v: 3.0)),
    "constant_bias": Case("thermal", "a body sensor that reads 2 K too high", {"bias": 2.0}),
    "transport_delay": Case("thermal", "a power that acts 3 s late", {"delay_s": 3.0}),
    "further_lag": Case(
        "thermal", "a body sensor with a lag of 10 s", {"sensor_lag_s": 10.0}
    ),
    "asymmetric_damping": Case("pipe", "0.5 kPa/(dm³/s) against |Q|", {"asymmetric": 0.5}),
    "softening_damping": Case(
        "body", "3 N · tanh(v / 1 m/s) against the motion",
        _force(lambda q, v: -3.0 * float(np.tanh(v / 1.0))),
    ),
    "recording_filter": Case(
        "body", "a recorder's all-pass on force and position, α = 0.04 s and β = 0.0064 s²",
        _force(lambda q, v: -150.0 * q**3),
        {
            "rhs": _hardening,
            "params": {
                **system_models.body().params,
                "k3": system_models.P(100.0, 0.0, 2000.0, "N/m³"),
            },
        },
        every=4,
    ),
    "parameter_drift": Case("thermal", "a loss to the room that grows by 30 % in 1000 s",
                            {"drift": 0.3}),
}  # fmt: skip


@dataclass(frozen=True)
class Found:
    """A case of one seed: model, records and what the diagnosis says.

    Parameters
    ----------
    model : Model
        It lacks the effect.
    training, check : Experiment
        Records.
    diagnosis : SystemDiagnosis
        What was said.
    """

    model: Model
    training: Experiment
    check: Experiment
    diagnosis: SystemDiagnosis


@cache
def found(name: str, seed: int) -> Found:
    """Return a case with its diagnosis.

    Parameters
    ----------
    name : str
        Of the effect.
    seed : int
        Of the training record.
    """
    case = CASES[name]
    model = getattr(system_models, case.system)(**case.model)
    period_s = case.every * system_models.PERIOD_S[case.system]
    training = Experiment("train.csv", period_s, _record(name, seed, ROWS))
    check = Experiment("check.csv", period_s, _record(name, seed + CHECK_SEED, CHECK_ROWS))
    return Found(model, training, check, diagnose_model(model, training, check))


def _record(name: str, seed: int, rows: int) -> dict[str, FloatArray]:
    case = CASES[name]
    made = getattr(system_truths, case.system)
    every = case.every
    kept = {
        key: values[::every]
        for key, values in made(seed, every * rows, noise=NOISE, **case.hidden).items()
    }
    if name != "recording_filter":
        return kept
    clean = made(seed, every * rows, noise=0.0, **case.hidden)
    rng = np.random.default_rng([seed, 1])
    filtered = {key: _all_pass(values, every) for key, values in clean.items()}
    return filtered | {"q": system_truths.noisy(filtered["q"], NOISE, rng)}


def _all_pass(values: FloatArray, every: int) -> FloatArray:
    """Return every so many rows of a channel behind (1 − αs + βs²)/(1 + αs + βs²).

    s is in rows that are kept; the recorder starts from rest at the first row.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import lsim

    time = np.arange(values.size) / every
    fine = np.linspace(0.0, time[-1], FINER * (values.size - 1) + 1)
    about = values[0]
    between = CubicSpline(time, values - about)(fine)
    _, out, _ = lsim(([BETA, -ALPHA, 1.0], [BETA, ALPHA, 1.0]), between, fine)
    return np.asarray(out[:: FINER * every] + about)
