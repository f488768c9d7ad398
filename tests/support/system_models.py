"""Models as a user would write them, of the systems in `system_truths`, and their records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import system_truths as truth

from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.fit import Fit, fit_runs
from comparisons.missing_effect.systems.metric import Metric, raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.places import Place, Placed
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Run, Structure

PERIOD_S = {
    "thermal": truth.THERMAL_PERIOD_S,
    "tanks": truth.TANKS_PERIOD_S,
    "pipe": truth.PIPE_PERIOD_S,
    "circuit": truth.CIRCUIT_PERIOD_S,
    "body": truth.BODY_PERIOD_S,
}


GIVEN: dict[str, dict[str, Any]] = {
    # Heater and body.
    "thermal": {
        "states": {"hot": "K", "mild": "K"},
        "inputs": {"P": "W"},
        "outputs": {"T_h": "K", "T_b": "K"},
        "params": {
            "C_h": P(30.0, 5.0, 200.0, "J/K"),
            "C_b": P(120.0, 20.0, 1000.0, "J/K"),
            "G": P(3.0, 0.5, 20.0, "W/K"),
            "G_a": P(2.0, 0.3, 20.0, "W/K"),
        },
        "rhs": lambda t, x, u, p: (
            (u.P - p.G * (x.hot - x.mild)) / p.C_h,
            (p.G * (x.hot - x.mild) - p.G_a * x.mild) / p.C_b,
        ),
        "output": lambda t, x, u, p: (x.hot, x.mild),
        "name": "heater",
    },
    # Two tanks.
    "tanks": {
        "states": {"upper": "dm", "lower": "dm"},
        "inputs": {"q": "dm³/s"},
        "outputs": {"h_1": "dm", "h_2": "dm"},
        "params": {
            "A_1": P(1.5, 0.2, 20.0, "dm²"),
            "A_2": P(2.0, 0.2, 20.0, "dm²"),
            "k": P(0.1, 0.01, 2.0, "dm²/s"),
            "k_o": P(0.2, 0.01, 2.0, "dm²/s"),
        },
        "rhs": lambda t, x, u, p: (
            (u.q - p.k * (x.upper - x.lower)) / p.A_1,
            (p.k * (x.upper - x.lower) - p.k_o * x.lower) / p.A_2,
        ),
        "output": lambda t, x, u, p: (x.upper, x.lower),
        "name": "tanks",
    },
    # A pipe between a pump and a vessel.
    "pipe": {
        "states": {"flow": "dm³/s", "back": "kPa"},
        "inputs": {"p": "kPa"},
        "outputs": {"Q": "dm³/s"},
        "params": {
            "I": P(1.5, 0.2, 20.0, "kPa s²/dm³"),
            "R": P(2.0, 0.01, 20.0, "kPa s/dm³"),
            "C": P(0.8, 0.05, 5.0, "dm³/kPa"),
            "R_o": P(3.0, 0.3, 50.0, "kPa s/dm³"),
        },
        "rhs": lambda t, x, u, p: (
            (u.p - p.R * x.flow - x.back) / p.I,
            (x.flow - x.back / p.R_o) / p.C,
        ),
        "output": lambda t, x, u, p: x.flow,
        "balance": {"flow": ("I", "kPa")},
        "name": "pipe",
    },
    # A series circuit.
    "circuit": {
        "states": {"current": "A", "v_C": "V"},
        "inputs": {"v": "V"},
        "outputs": {"i": "A"},
        "params": {
            "L": P(0.08, 0.005, 1.0, "H"),
            "R": P(2.0, 0.1, 50.0, "Ω"),
            "C": P(3e-3, 1e-4, 2e-2, "F"),
        },
        "rhs": lambda t, x, u, p: ((u.v - p.R * x.current - x.v_C) / p.L, x.current / p.C),
        "output": lambda t, x, u, p: x.current,
        "name": "circuit",
    },
    # A body on a spring.
    "body": {
        "states": {"at": "m", "speed": "m/s"},
        "inputs": {"F": "N"},
        "outputs": {"q": "m"},
        "params": {
            "M": P(1.5, 0.2, 20.0, "kg"),
            "c": P(1.0, 0.01, 50.0, "N s/m"),
            "k": P(60.0, 5.0, 500.0, "N/m"),
        },
        "rhs": lambda t, x, u, p: (x.speed, (u.F - p.c * x.speed - p.k * x.at) / p.M),
        "output": lambda t, x, u, p: x.at,
        "exact": ("at",),
        "balance": {"speed": ("M", "N")},
        "name": "body",
    },
}


@cache
def _plain(kind: str) -> Model:
    return Model(**GIVEN[kind])


def _made(kind: str, **changes: Any) -> Model:
    """A model of one of the systems; that without changes is made, and compiled, once."""
    return Model(**{**GIVEN[kind], **changes}) if changes else _plain(kind)


thermal, tanks, pipe, circuit, body = (partial(_made, kind) for kind in GIVEN)


def experiment(
    kind: str, channels: Mapping[str, np.ndarray], name: str = "record", first_s: float = 0.0
) -> Experiment:
    """A record of one of the systems."""
    return Experiment(name, PERIOD_S[kind], channels, first_s)


def runs_on(
    model: Model,
    experiments: Sequence[Experiment],
    between: str = "cubic",
    known: tuple[Sequence[float], Sequence[float]] | None = None,
) -> tuple[Run, ...]:
    """Records as runs; of their starts nothing is known, or values with errors."""
    n_x = len(model.states)
    x0 = (np.zeros(n_x), np.full(n_x, np.inf)) if known is None else known
    last = max(e.first_s + e.n_samples * e.sample_period_s for e in experiments)
    span = (min(e.first_s for e in experiments), last)
    mean, sd = (np.array(v, dtype=float) for v in x0)
    return tuple(Run.of(model, e.of(model), between, span, (mean, sd)) for e in experiments)


def fitted(
    structure: Structure,
    runs: Sequence[Run],
    theta: Sequence[float] | None = None,
    metric: Metric | None = None,
) -> Fit:
    """A structure fitted to runs, from its starts and in the raw metric unless told otherwise."""
    raw = metric or raw_metric([run.outputs for run in runs])
    begun = structure.start() if theta is None else np.array(theta, dtype=float)
    return fit_runs(structure, runs, raw, begun, [run.x0_mean for run in runs])


def placed(
    name: str,
    kind: Kind,
    at: int,
    signal: int = -1,
    other: int = -1,
    *,
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0),
    code: int | None = None,
) -> Placed:
    """A catalogue effect at a place, with scales and without starts."""
    effect = next(
        e
        for e in SYSTEM_CATALOGUE
        if e.name == name and e.kind == kind and (code is None or e.code == code)
    )
    return Placed(effect, Place(at, signal, other), scales, ())
