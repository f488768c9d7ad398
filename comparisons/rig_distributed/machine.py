"""One machine with its ducts: the numbers, and how one is drawn at random (machine.toml).

Characteristic and stall cell are those of Moore and Greitzer. Round the annulus the flow
coefficient is φ(θ) = Φ + A sin(θ − ωt), and each part of it sees their
cubic (J. Eng. Gas Turbines Power 108, 1986, p. 68),

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

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from math import exp, log

import numpy as np

from comparisons.rig_distributed.gas import CP
from surge_core.types import FloatArray


@dataclass(frozen=True)
class Machine:
    """A compressor of medium pressure ratio between a long inlet duct and a plenum.

    Parameters
    ----------
    rotor_velocity_m_s, mean_radius_m, design_speed_ratio : float
        U, the radius it belongs to, and corrected speed before the surge over that of design.
    level, rise, valley, span : float
        Characteristic: ψ'_0, H, φ_0, W.
    cell_share, blade_lag, outer_lag, distortion : float
        Cell: share κ of the span, a, m, and the distortion ε that it grows from. Moore and
        Greitzer's example of three stages has a = 1/3.5 and m = 1.75; a falls with the stages.
    tau_s : float
        Lag of the blading.
    reverse_loss : float
        Loss k of reversed flow, in ψ' per φ².
    work_zero, work_slope : float
        Work coefficient in stall and out of it, ψ_QS = work_zero − work_slope max(φ, 0).
    transfer_units : float
        How well the metal cools reversed gas, N.
    supply_pa, supply_k : float
        Total state in front of the inlet duct.
    inlet_area_m2, exit_area_m2, plenum_area_m2 : float
        Areas of the path at plane 25, at plane 31 and of the plenum.
    inlet_m, compressor_m, cone_m, plenum_m : float
        Lengths of inlet duct, compressor, the cone to the plenum, and plenum.
    friction : float
        Darcy's friction factor λ of the walls.
    start_phi : float
        φ of the first steady flow over that of the peak.
    close_start_s, close_per_s, after_stall, after_lag_s : float
        The throttle closes at this rate from then on until the machine stalls, and goes, with a
        lag, to this share of its first opening.
    cell_turn : float
        Speed of the cell over that of the rotor.
    cell_reach : float
        What is left of the cell's flow as far in front of the compressor as plane 25: exp(−d/r).
    cell_frac_hub : float
        Amplitude of the cell at the hub over that at the tip.
    hub_tip : float
        What φ at the hub has more, and at the tip less, than the mean, in deep stall.
    """

    rotor_velocity_m_s: float = 300.0
    mean_radius_m: float = 0.25
    design_speed_ratio: float = 0.8
    level: float = 1.0
    rise: float = 1.1
    valley: float = 0.0
    span: float = 0.15
    cell_share: float = 0.12
    blade_lag: float = 0.15
    outer_lag: float = 1.75
    distortion: float = 0.02
    tau_s: float = 0.018
    reverse_loss: float = 500.0
    work_zero: float = 5.5
    work_slope: float = 5.0
    transfer_units: float = 1.0
    supply_pa: float = 90_000.0
    supply_k: float = 288.0
    inlet_area_m2: float = 0.24
    exit_area_m2: float = 0.10
    plenum_area_m2: float = 0.40
    inlet_m: float = 2.0
    compressor_m: float = 1.4
    cone_m: float = 0.8
    plenum_m: float = 1.5
    friction: float = 0.02
    inlet_loss: float = 1.5
    start_phi: float = 1.05
    close_start_s: float = 0.16
    close_per_s: float = 0.5
    after_stall: float = 0.65
    after_lag_s: float = 0.2
    cell_turn: float = 0.45
    cell_reach: float = 0.4
    cell_frac_hub: float = 0.5
    hub_tip: float = 0.03

    @property
    def peak_phi(self) -> float:
        """φ of the peak, where stall begins."""
        return self.valley + 2.0 * self.span

    @property
    def growth_per_s(self) -> float:
        """Growth g of the cell; H in ψ' is twice that of Moore and Greitzer's Ψ = Δp/ρU²."""
        slope = 1.5 * self.blade_lag * self.rise / self.span
        return self.rotation_per_s * slope / (1.0 + self.outer_lag * self.blade_lag)

    def cell_amplitude(self, phi: FloatArray) -> FloatArray:
        """Return the amplitude of the cell in equilibrium, 2 W √(1 − y²), zero outside of stall."""
        y = (phi - self.valley) / self.span - 1.0
        return np.asarray(2.0 * self.span * np.sqrt(np.maximum(1.0 - y * y, 0.0)))

    def steady_psi_p(self, phi: FloatArray) -> FloatArray:
        """Return ψ'_QS with the cell in equilibrium: in stall the true in-stall characteristic."""
        y = (phi - self.valley) / self.span - 1.0
        j = (self.cell_amplitude(phi) / self.span) ** 2
        part = 1.0 + 1.5 * y * (1.0 - 0.5 * self.cell_share * j) - 0.5 * y**3
        return np.asarray(self.level + self.rise * part)

    @property
    def rotation_per_s(self) -> float:
        """Angular velocity of the rotor."""
        return self.rotor_velocity_m_s / self.mean_radius_m

    def temperature_rise_k(self, psi: float) -> float:
        """Return the rise of total temperature that a work coefficient makes."""
        return psi * self.rotor_velocity_m_s**2 / (2.0 * CP)


def draw(rng: np.random.Generator) -> Machine:
    """Draw a machine; not every one surges.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    """
    text = files("comparisons.rig_distributed").joinpath("machine.toml").read_text("utf-8")
    drawn = {
        name: exp(rng.uniform(log(low), log(high))) if law else float(rng.uniform(low, high))
        for name, (low, high, *law) in tomllib.loads(text).items()
    }
    for area in ("exit_area_m2", "plenum_area_m2"):
        drawn[area] *= drawn["inlet_area_m2"]
    drawn["cell_reach"] = exp(-drawn["cell_reach"])
    work_peak = (drawn["level"] + 2.0 * drawn["rise"]) / drawn.pop("efficiency")
    peak_phi = drawn["valley"] + 2.0 * drawn["span"]
    return Machine(**drawn, work_zero=work_peak + drawn["work_slope"] * peak_phi)
