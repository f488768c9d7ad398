"""The gas at the probes of the rakes, and what the two holes of a pair feel.

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

import numpy as np

from comparisons.rig_distributed.gas import CP, GAMMA, R
from comparisons.rig_distributed.machine import Machine
from comparisons.rig_distributed.plant import PLANT_HZ, PlantRun
from surge_core.types import FloatArray

# Share of cell and shift that the gas at plane 31 still has.
EXIT_SHARE = 0.1
# Angle of the second rake behind the first.
_RAKES = {"A": 0.0, "B": np.radians(130.0)}
# Flows of the table by which the law is inverted.
_TABLE = np.linspace(0.0, 1.0, 20_001)


def mach_of_velocity(velocity_m_s: FloatArray, total_k: FloatArray) -> FloatArray:
    """Return the signed Mach number of an axial velocity at a total temperature."""
    static_k = total_k - velocity_m_s**2 / (2.0 * CP)
    return np.asarray(velocity_m_s / np.sqrt(GAMMA * R * static_k))


def local_flow(
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
    phi = phi + side * hub_tip_shift(machine, run["phi"])
    velocity = machine.rotor_velocity_m_s
    ripple_pa = total_pa / (R * total_k) * velocity**2 * machine.cell_turn * reach * np.cos(angle)
    return mach_of_velocity(phi * velocity, total_k), total_pa + ripple_pa


def hub_tip_shift(machine: Machine, phi: FloatArray) -> FloatArray:
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
