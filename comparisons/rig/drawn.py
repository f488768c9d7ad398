"""Machines of the rig drawn at random, each with instruments of its own.

Volumes, ducts, cells, hub-tip deficit and profile, τ, curve, loss in reversed flow, law of the
probes near zero flow, noise, sample rate, number of rakes and of immersions are drawn; some curves
are no parabola.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.rig.cases import CASES, RigCase
from comparisons.rig.sensors import SensorSettings
from comparisons.rig.simulation import RigRun, simulate, write_run
from surge_core.errors import InputError

# With fewer reversals of the flow a machine does not surge, and another is drawn.
FEWEST_REVERSALS = 8
RATES_HZ = (500.0, 1000.0, 1000.0, 2000.0)
SPEEDS = ("985", "90", "95")
# What the in-stall curve has beside a parabola: pressure_kink max(φ − 0.08, 0) + pressure_cubic φ³.
SHAPES = {"parabola": (0.0, 0.0), "kink 25": (25.0, 0.0)}
SHAPES |= {f"+{size:g} φ³": (0.0, size) for size in (150.0, 300.0, 600.0)}
# Ranges of what is drawn, in the order of the draws: shares of the case's own numbers, but for τ.
_SHARES = {
    "cells": (0.6, 1.6),
    "discharge_volume_m3": (0.8, 1.3),
    "exhaust_volume_m3": (0.7, 1.4),
    "inlet_volume_m3": (0.7, 1.4),
    "inertia_per_m": (0.85, 1.2),
    "cell_frequency_hz": (0.75, 1.4),
    "hub_tip_flow_kg_s": (0.6, 1.3),
}
_TAU_S, _TERMS, _REVERSE_LOSS = (0.010, 0.030), [(0.85, 1.15), (0.7, 1.3), (0.85, 1.15)], (0.5, 1.5)


def draw_run(
    rng: np.random.Generator, speed: str, shape: str | None = None
) -> tuple[RigRun, dict[str, Any]]:
    """Draw machines until one surges, and return its run and what was drawn.

    They are drawn about a case, out of `SPEEDS`. The shape, out of `SHAPES`, is what the in-stall
    curve has beside its parabola; without it one in four has a bell.
    """
    while True:
        try:
            run, about = _machine(rng, speed, shape)
        except InputError:
            # A machine that does not stay finite is none.
            continue
        phi = run.truth["phi"]
        if np.count_nonzero((phi[1:] < 0.0) & (phi[:-1] >= 0.0)) >= FEWEST_REVERSALS:
            return run, about


def draw_record(seed: int, folder: str | Path) -> None:
    """Draw a machine that surges and write its record, description and truth into a new folder."""
    rng = np.random.default_rng(seed)
    run, _ = draw_run(rng, str(rng.choice(SPEEDS)))
    write_run(run, folder)


def _machine(
    rng: np.random.Generator, speed: str, shape: str | None
) -> tuple[RigRun, dict[str, Any]]:
    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    base = CASES[speed]
    shares = {name: between(*ends) for name, ends in _SHARES.items()}
    cells = shares.pop("cells")
    moved: dict[str, Any] = {name: getattr(base, name) * share for name, share in shares.items()}
    tau_s = between(*_TAU_S)
    a, b, c = (
        term * between(*ends) for term, ends in zip(base.pressure_terms, _TERMS, strict=True)
    )
    case = replace(
        base,
        name="drawn",
        **moved,
        cell_pressure_frac=base.cell_pressure_frac * cells,
        cell_flow_kg_s=base.cell_flow_kg_s * cells,
        tau_s=tau_s,
        pressure_terms=(a, b, c),
        reverse_loss=base.reverse_loss * between(*_REVERSE_LOSS),
        segmentation=None,
        window_s=None,
    )
    case = shaped(case, *SHAPES[shape or "parabola"])
    noise = math.exp(between(math.log(0.05), math.log(0.5)))
    bent = rng.random() < 0.25 and shape is None
    # A stream of its own leaves every other number as it was.
    other = rng.spawn(1)[0]
    rate_hz = float(other.choice(RATES_HZ))
    sensors = SensorSettings(
        noise_percent=noise,
        probe_offset=between(0.5, 1.5),
        probe_ramp=float(other.uniform(0.01, 0.05)) if other.random() < 0.25 else 0.0,
        hub_tip_bend=float(other.uniform(-0.5, 0.5)),
        sample_rate_hz=rate_hz,
        anti_alias_hz=0.45 * rate_hz,
    )
    hide = "characteristic_shape" if bent else None
    run = simulate(case, seed=int(rng.integers(1 << 30)), sensors=sensors, hide=hide)
    rakes = 1 if rng.random() < 0.15 else 2
    immersions = 1 if other.random() < 0.1 else 2
    if rakes == 1:
        run = _without(run, "rake", "B")
    if immersions == 1:
        run = _without(run, "immersion", "hub")
    return run, {
        "tau_s": case.tau_s,
        "beta": None if bent else list(case.pressure_terms),
        "noise": noise,
        "rakes": rakes,
        "immersions": immersions,
        "rate_hz": rate_hz,
        "ramp": sensors.probe_ramp,
        "curve": "bent" if bent else "parabola",
        "speed": base.name,
    }


def shaped(case: RigCase, kink: float, cubic: float) -> RigCase:
    """Add kink max(φ − its place, 0) + cubic φ³ to the in-stall curve, less the nearest parabola.

    Bent by the whole of it the machine would surge otherwise.
    """
    phi = np.linspace(0.0, case.recovery_phi, 151)
    bend = kink * np.maximum(phi - case.kink_phi, 0.0) + cubic * phi**3
    nearest = np.polynomial.polynomial.polyfit(phi, bend, 2)
    level, slope, bow = map(float, np.array(case.pressure_terms) - nearest)
    return replace(
        case, pressure_terms=(level, slope, bow), pressure_kink=kink, pressure_cubic=cubic
    )


def _without(run: RigRun, what: str, which: str) -> RigRun:
    """Take a rake or an immersion out of the record and of its description."""
    gone = [name for name, channel in run.test["channels"].items() if channel.get(what) == which]
    channels = {name: c for name, c in run.test["channels"].items() if name not in gone}
    limits = {n: pair for n, pair in run.test.get("limits", {}).items() if n not in gone}
    test = {**run.test, "channels": channels, "limits": limits}
    return replace(run, raw=run.raw.without(gone), test=test)
