"""The twenty channels of a record: every probe of every rake through its instruments.

In the frame of the rakes the cell turns with ω = (ω/Ω) Ω. At the angle θ of a rake

    φ = Φ + A r sin θ ± D,   P = P25 + ρ U² (ω/Ω) A r cos θ

with r the reach of the cell at hub or tip. The ripple of the total pressure is that of the
irrotational flow in front of the machine, ∂φ̃/∂t + P/ρ = const, for one cell (Moore and Greitzer
1986). The shift D between hub and tip grows as the flow falls below the peak: the tip stalls first.

The calibration of a pair, its own law, is smooth and odd through zero flow:

    M = a m + b tanh(m/m_0),   P_wake = P (1 + (γ−1)/2 m²)^(−γ/(γ−1))

with m what Eq 1 of the paper calls the calculated Mach number. Well above m_0 it is Eq 2; at zero
flow it has no jump. The calibration that the description states, a and b, is that of the flows well
above.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from comparisons.rig_distributed.gas import CP, GAMMA, R
from comparisons.rig_distributed.instruments import (
    SPANS_PA,
    Instruments,
    codes,
    thermocouple,
    transducer_pa,
)
from comparisons.rig_distributed.machine import Machine
from comparisons.rig_distributed.plant import PLANT_HZ, PlantRun
from surge_core.types import FloatArray

# Share of cell and shift that the gas at plane 31 still has.
EXIT_SHARE = 0.1
# Angle of the second rake behind the first.
_RAKES = {"A": 0.0, "B": np.radians(130.0)}
# Flows of the table by which the law is inverted.
_TABLE = np.linspace(0.0, 1.0, 20_001)
NEAR_STALL_S = 0.14
# Samples of a zero and of a calibrate reading.
_READINGS = 500
# The reference stands at the pressure before the surge, to the nearest of these steps in Pa.
_REFERENCE_STEP_PA = 5e3
# Of the largest departure from the reference that the surge brings, the span must hold so much.
_HEADROOM = 1.25
_CALIBRATE_SHARE = 0.6


@dataclass(frozen=True)
class Channels:
    """The channels of one record in the order of the file."""

    values: dict[str, FloatArray] = field(default_factory=dict)  # Codes or kelvin
    # Table of each channel in ``test.toml``.
    described: dict[str, dict[str, Any]] = field(default_factory=dict)
    # Sensitivity in V/Pa and zero in V of each transducer.
    truth: dict[str, dict[str, float]] = field(default_factory=dict)


def read_rakes(
    machine: Machine, run: PlantRun, fitted: Instruments, rng: np.random.Generator
) -> Channels:
    """Read two rakes at each plane, with a pair of probes at hub and tip and a thermocouple."""
    out = Channels()
    for plane in (25, 31):
        laws = {}
        for immersion in ("tip", "hub"):
            slope = float(np.round(rng.uniform(1.04, 1.12), 3))
            laws[immersion] = slope, float(np.round(rng.uniform(0.006, 0.015), 4))
        holes = {
            (rake, immersion): hole_pressures_pa(
                *_local_flow(machine, run, plane, rake, immersion),
                slope=slope,
                offset=offset,
                knee=fitted.probe_knee,
            )
            for rake in _RAKES
            for immersion, (slope, offset) in laws.items()
        }
        before_pa = run[f"P{plane}"][0]
        reference_pa = _REFERENCE_STEP_PA * float(np.round(before_pa / _REFERENCE_STEP_PA))
        off_pa = (float(np.max(np.abs(p - reference_pa))) for both in holes.values() for p in both)
        largest_pa = _HEADROOM * max(off_pa)
        span_pa = next((span for span in SPANS_PA if span >= largest_pa), largest_pa)
        for rake in _RAKES:
            for immersion, (slope, offset) in laws.items():
                pressures = zip(("forward", "aft"), holes[rake, immersion], strict=True)
                for facing, pressure_pa in pressures:
                    table = {
                        "kind": "pressure",
                        "unit": "count",
                        "plane": plane,
                        "rake": rake,
                        "immersion": immersion,
                        "facing": facing,
                        "probe_slope": slope,
                        "probe_offset": offset,
                        "zoc_reference_Pa": reference_pa,
                    }
                    name = f"P{plane}_{rake}_{immersion}_{facing}"
                    _read_pressure(name, pressure_pa, span_pa, table, fitted, rng, out)
            name = f"T{plane}_{rake}"
            out.values[name] = thermocouple(run[f"T{plane}"], fitted, rng)
            out.described[name] = {
                "kind": "temperature",
                "unit": "K",
                "plane": plane,
                "rake": rake,
                "recovery_factor": fitted.recovery_factor,
                "time_constant_s": fitted.junction_s,
            }
    return out


def _read_pressure(
    name: str,
    pressure_pa: FloatArray,
    span_pa: float,
    table: dict[str, Any],
    fitted: Instruments,
    rng: np.random.Generator,
    out: Channels,
) -> None:
    """Add one transducer: its zero and calibrate readings, and its record of the surge."""
    gain = fitted.half_scale_v / span_pa * (1.0 + fitted.gain_scatter * rng.standard_normal())
    zero_v = fitted.bias_v * rng.standard_normal()
    calibrate_pa = _CALIBRATE_SHARE * span_pa
    scale = 2**fitted.bits / (2.0 * fitted.half_scale_v)
    for key, difference_pa in (("zero_count", 0.0), ("calibrate_count", calibrate_pa)):
        noise_v = fitted.noise_frac * fitted.half_scale_v * rng.standard_normal(_READINGS)
        steps = np.round((zero_v + gain * difference_pa + noise_v) * scale)
        table[key] = float(np.mean(steps)) + 2.0 ** (fitted.bits - 1)
    table["calibrate_pressure_Pa"] = calibrate_pa
    volts = zero_v + gain * (transducer_pa(pressure_pa, fitted) - table["zoc_reference_Pa"])
    out.values[name] = codes(volts, fitted, rng)
    out.described[name] = table
    out.truth[name] = {"sensitivity_V_Pa": float(gain), "zero_V": float(zero_v)}


def near_stall_reading(
    run: PlantRun, fitted: Instruments, rng: np.random.Generator
) -> dict[str, float]:
    """Return the facility's reading of the steady flow before the surge."""
    rows = slice(0, round(NEAR_STALL_S * PLANT_HZ) + 1)
    reading = {"from_s": 0.0, "to_s": NEAR_STALL_S}
    for plane in (25, 31):
        off_pa, off_k = rng.standard_normal(2) * (fitted.facility_frac, fitted.facility_k)
        reading[f"P{plane}_Pa"] = float(np.mean(run[f"P{plane}"][rows]) * (1.0 + off_pa))
        reading[f"T{plane}_K"] = float(np.mean(run[f"T{plane}"][rows]) + off_k)
    return reading


def _mach_of_velocity(velocity_m_s: FloatArray, total_k: FloatArray) -> FloatArray:
    """Return the signed Mach number of an axial velocity at a total temperature."""
    static_k = total_k - velocity_m_s**2 / (2.0 * CP)
    return np.asarray(velocity_m_s / np.sqrt(GAMMA * R * static_k))


def _local_flow(
    machine: Machine, run: PlantRun, plane: int, rake: str, immersion: str
) -> tuple[FloatArray, FloatArray]:
    """Return Mach number and total pressure in Pa at one pair of probes, at `PLANT_HZ`."""
    total_pa, total_k = run[f"P{plane}"], run[f"T{plane}"]
    share = 1.0 if plane == 25 else EXIT_SHARE
    time_s = np.arange(total_pa.size) / PLANT_HZ
    angle = machine.cell_turn * machine.rotation_per_s * time_s - _RAKES[rake]
    reach = share * machine.cell_reach * run["amplitude"]
    reach = reach * (machine.cell_frac_hub if immersion == "hub" else 1.0)
    side = share * (1.0 if immersion == "hub" else -1.0)
    phi = run["phi" if plane == 25 else "phi31"] + reach * np.sin(angle)
    phi = phi + side * _hub_tip_shift(machine, run["phi"])
    velocity = machine.rotor_velocity_m_s
    ripple_pa = total_pa / (R * total_k) * velocity**2 * machine.cell_turn * reach * np.cos(angle)
    return _mach_of_velocity(phi * velocity, total_k), total_pa + ripple_pa


def _hub_tip_shift(machine: Machine, phi: FloatArray) -> FloatArray:
    """Return the shift D of φ between the mean and hub or tip, from φ at plane 25."""
    below = np.maximum(machine.peak_phi - phi, 0.0) / machine.span
    return np.asarray(machine.hub_tip * (1.0 - np.exp(-2.0 * below)))


def hole_pressures_pa(
    mach: FloatArray, total_pa: FloatArray, *, slope: float, offset: float, knee: float
) -> tuple[FloatArray, FloatArray]:
    """Return the pressures in Pa of the forward and the aft hole of a pair; a, b, m_0 the law's."""
    law = slope * _TABLE + offset * np.tanh(_TABLE / knee)
    calculated = np.interp(np.abs(mach), law, _TABLE)
    exponent = GAMMA / (GAMMA - 1.0)
    wake = total_pa * (1.0 + 0.5 * (GAMMA - 1.0) * calculated**2) ** -exponent
    forward = mach >= 0.0
    return np.where(forward, total_pa, wake), np.where(forward, wake, total_pa)
