"""The compressor's characteristic and its stall cell, after Moore and Greitzer.

Round the annulus the flow coefficient is φ(θ) = Φ + A sin(θ − ωt), and each part of it sees the
cubic of Moore and Greitzer (J. Eng. Gas Turbines Power 108, 1986, p. 68),

    ψ'(φ) = ψ'_0 + H [1 + 3/2 y − 1/2 y³],  y = (φ − φ_0)/W − 1.

The cell covers a share κ of the span, at the tip. Averaged over annulus and span, with
J = (A/W)², the pressure coefficient that the blading tends to is

    ψ'_QS(Φ, J) = ψ'_0 + H [1 + 3/2 y (1 − κ J/2) − 1/2 y³],

and one Galerkin mode gives the amplitude (theirs, with a small steady distortion ε besides):

    dA/dt = g/2 [A (1 − y² − J/4) + ε W],  g = (U/r) 3 a H/2 / ((1 + m a) W),

whose equilibrium in stall is J = 4 (1 − y²). The averaged blading follows with the lag of Greitzer
(J. Eng. Power 98, 1976, p. 190; Eq 6 of the paper):

    τ dψ'/dt + ψ' = ψ'_QS(Φ, J).

**The true τ is that of this lag.** The true in-stall characteristic is ψ'_QS with J at its
equilibrium; that the amplitude takes 2/g, some milliseconds, to grow e times is physics on top,
which the lag model does not have. In reversed flow the blading loses k Φ² besides, without a lag.
"""

from __future__ import annotations

import numpy as np

from comparisons.rig_distributed.machine import Machine
from surge_core.types import FloatArray


def cell_amplitude(machine: Machine, phi: FloatArray) -> FloatArray:
    """Return the amplitude of the cell in equilibrium, 2 W √(1 − y²), zero outside of stall."""
    y = (phi - machine.valley) / machine.span - 1.0
    return np.asarray(2.0 * machine.span * np.sqrt(np.maximum(1.0 - y * y, 0.0)))


def steady_psi_p(machine: Machine, phi: FloatArray) -> FloatArray:
    """Return ψ'_QS with the cell in equilibrium: in stall the true in-stall characteristic."""
    y = (phi - machine.valley) / machine.span - 1.0
    j = (cell_amplitude(machine, phi) / machine.span) ** 2
    part = 1.0 + 1.5 * y * (1.0 - 0.5 * machine.cell_share * j) - 0.5 * y**3
    return np.asarray(machine.level + machine.rise * part)


def growth_per_s(machine: Machine) -> float:
    """Return g; H in ψ' is twice that of Moore and Greitzer's Ψ = Δp/ρU²."""
    slope = 1.5 * machine.blade_lag * machine.rise / machine.span
    return machine.rotation_per_s * slope / (1.0 + machine.outer_lag * machine.blade_lag)
