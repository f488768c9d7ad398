"""The characteristic of a fitted lag model, and what its JSON says of it and of its records."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comparisons.missing_effect.catalogue.workings import clock_s
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData, Run, laid_out
from comparisons.missing_effect.ports import Ports
from comparisons.missing_effect.quantities import model_equation
from surge_core.types import FloatArray

CURVE_POINTS = 241


@dataclass(frozen=True)
class Curve:
    """A quasi-steady characteristic ψ'_QS over φ; its label is empty where it is the only one."""

    label: str
    phi: FloatArray
    value: FloatArray


def steady_curves(fit: Fit, data: LagData) -> tuple[Curve, ...]:
    """Return the characteristic of a fit over the range of φ, as a slow sweep would draw it.

    A model with two branches gives one curve while φ falls and one while it rises; one whose
    characteristic moves with time or corrected speed gives it at both ends of what was recorded.
    """
    names = fit.structure.names
    clock = clock_s(data)
    middle = float(np.mean(clock))
    states: list[tuple[str, float, float]] = [("", middle, data.references.mean_speed)]
    if "facility_heating" in names:
        states = [
            (f"at {at:.3g} s", at, data.references.mean_speed)
            for at in (float(clock.min()), float(clock.max()))
        ]
    elif "speed_droop" in names:
        ends = (float(data["Nc_frac"].min()), float(data["Nc_frac"].max()))
        states = [(f"at N_c {end:.4g}", middle, end) for end in ends]
    return tuple(curve for state in states for curve in _sweep(fit, data, *state))


def records_document(data: LagData) -> list[dict[str, Any]]:
    """Return what the JSON says of the records."""
    time_s = data.sampled(data["time_s"])
    out = []
    for number, source in enumerate(data.sources):
        rows = data.record == number
        parts = {
            name: int(np.count_nonzero(rows & data.scored(part)))
            for name, part in (("fitted", TRAIN), ("later_time", LATER), ("other_record", OTHER))
        }
        out.append(
            {
                "source": source,
                "from_s": time_s[rows].min(),
                "to_s": time_s[rows].max(),
                "sample_rate_hz": 1.0 / data.sample_period_s,
                "rows": parts,
            }
        )
    return out


def model_document(fit: Fit, data: LagData) -> dict[str, Any]:
    """Return what the JSON says of a fitted model."""
    terms = fit.structure.terms
    return {
        "equation": model_equation(fit),
        "time_constant_s": fit.tau_s,
        "terms": [
            {"name": name, "coefficient": value}
            for name, value in zip(terms, fit.coefficients, strict=False)
        ],
        "effects": list(fit.structure.names),
        "characteristic": [
            {"label": curve.label, "phi": curve.phi.tolist(), "psi_p": curve.value.tolist()}
            for curve in steady_curves(fit, data)
        ],
    }


def _sweep(fit: Fit, data: LagData, label: str, clock: float, speed: float) -> tuple[Curve, ...]:
    """Sweep φ slowly from the top of its range to the bottom and back.

    The clock is in seconds from its zero.
    """
    shown = data.scored()
    if "stalled" in data:
        # The unstalled branch has a curve of its own.
        shown &= data.sampled(data["stalled"]) > 0.5
    seen = data.sampled(data["phi"])[shown]
    low, high = float(seen.min()), float(seen.max())
    grid = np.linspace(low, high, CURVE_POINTS)
    phi = np.concatenate([grid[::-1], grid])
    slow = _slow_data(data, phi, clock, speed)
    ports = Ports.of(slow, phi, fit.structure.terms)
    slow = slow.with_signal("state", ports.driven @ fit.coefficients[: len(fit.structure.terms)])
    for effect in fit.structure.in_order:
        if effect.port == "characteristic":
            ports = effect.acts(ports, slow, fit.values_of(effect))
    q = ports.driven.shape[1]
    # A loss without the lag is part of what a steady test would find.
    behind = fit.coefficients[q + data.nuisance.shape[1] :][: ports.added.shape[1]]
    value = ports.driven @ fit.coefficients[:q] * ports.gain + ports.added @ behind
    falling, rising = value[:CURVE_POINTS][::-1], value[CURVE_POINTS:]
    if np.allclose(falling, rising, rtol=0.0, atol=1e-9 * float(np.ptp(value) or 1.0)):
        return (Curve(label, grid, rising),)
    return (
        Curve(f"φ falling {label}".strip(), grid, falling),
        Curve(f"φ rising {label}".strip(), grid, rising),
    )


def _slow_data(data: LagData, phi: FloatArray, clock: float, speed: float) -> LagData:
    """Return rows in which φ moves so slowly that the lag has nothing to do."""
    n = phi.size
    still = np.zeros(n)
    direction = np.concatenate([np.full(n // 2, -1e-12), np.full(n - n // 2, 1e-12)])
    signals = {name: np.full(n, float(np.mean(values))) for name, values in data.signals.items()}
    for name in signals:
        if name.startswith("phi"):
            signals[name] = phi
        elif name.startswith("d"):
            signals[name] = direction if name.startswith("dphi") else still
    signals |= {
        "time_s": np.full(n, clock),
        "amplitude": np.full(n, data.references.mean_amplitude),
        "amplitude_as_is": np.full(n, data.references.mean_amplitude_as_is),
        "Nc_frac": np.full(n, speed),
        "relaxation": still,
        "state": still,
    }
    rows = Run(signals, np.zeros((n, 0)), still, np.ones(n))
    return replace(
        data,
        **laid_out([rows], 1),
        part=np.zeros(n, dtype=np.int8),
        record=np.zeros(n, dtype=np.int64),
        every=1,
        average_s=0.0,
        # The clock is given as the effects count it.
        references=replace(data.references, clock_zero_s=0.0),
    )
