"""One machine with its ducts: the numbers, and how one is drawn at random."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log, pi

import numpy as np

from comparisons.rig_distributed.gas import CP


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
    def rotation_per_s(self) -> float:
        """Angular velocity of the rotor."""
        return self.rotor_velocity_m_s / self.mean_radius_m

    @property
    def cell_hz(self) -> float:
        """Frequency of the cell in the frame of the rakes."""
        return self.cell_turn * self.rotation_per_s / (2.0 * pi)

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

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def spread(low: float, high: float) -> float:
        return exp(between(log(low), log(high)))

    velocity = between(250.0, 340.0)
    level, rise, span = between(0.9, 1.4), between(0.7, 1.1), between(0.12, 0.18)
    peak = level + 2.0 * rise
    valley = between(-0.02, 0.02)
    work_peak = peak / between(0.80, 0.88)
    work_slope = between(3.0, 7.0)
    inlet = between(0.15, 0.30)
    return Machine(
        rotor_velocity_m_s=velocity,
        mean_radius_m=between(0.20, 0.30),
        design_speed_ratio=between(0.70, 0.90),
        level=level,
        rise=rise,
        valley=valley,
        span=span,
        cell_share=between(0.0, 0.25),
        blade_lag=spread(0.08, 0.30),
        outer_lag=between(1.5, 2.0),
        distortion=between(0.01, 0.03),
        tau_s=between(0.010, 0.030),
        reverse_loss=spread(300.0, 2000.0),
        work_zero=work_peak + work_slope * (valley + 2.0 * span),
        work_slope=work_slope,
        transfer_units=between(0.5, 1.5),
        supply_pa=between(85_000.0, 100_000.0),
        supply_k=between(260.0, 300.0),
        inlet_area_m2=inlet,
        exit_area_m2=inlet * between(0.35, 0.50),
        plenum_area_m2=inlet * between(1.2, 2.2),
        inlet_m=between(1.0, 3.0),
        compressor_m=between(1.0, 1.8),
        cone_m=between(0.5, 1.0),
        plenum_m=between(1.0, 2.0),
        inlet_loss=between(0.5, 3.0),
        start_phi=between(1.04, 1.10),
        close_per_s=between(0.3, 0.7),
        after_stall=between(0.55, 0.75),
        after_lag_s=between(0.1, 0.4),
        cell_turn=between(0.35, 0.65),
        cell_reach=exp(-between(0.5, 1.5)),
        cell_frac_hub=between(0.3, 0.7),
        hub_tip=between(0.02, 0.045),
    )
