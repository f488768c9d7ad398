"""Parameter sets of the simulated rig: the plants that surge, by name (cases.toml)."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from math import pi, sqrt
from typing import Any

import numpy as np

from comparisons.rig.gas import T_REF_K
from surge_core.types import FloatArray


@dataclass(frozen=True)
class RigCase:
    """One plant: compressor, its branches, the facility around it, throttle schedule and cells.

    Parameters
    ----------
    name : str
        Name of the case.
    corrected_speed_frac : float
        Corrected speed before the surge, as a fraction of design (``nc0``).
    supply_temperature_k, face_pressure_pa : float
        Total temperature and pressure at plane 25 before the surge (``T_ref``, ``P_in0``).
    pressure_terms : tuple of float
        ψ'_QS in stall = β₁ + β₂ φ + β₃ φ² (Eq 12).
    pressure_cubic, pressure_kink, kink_phi : float
        What else ψ'_QS in stall may have: pressure_cubic φ³ + pressure_kink max(φ − kink_phi, 0).
    work_intercept, work_slopes, work_breaks : float, tuple, tuple
        ψ_QS in stall at φ = 0, the slopes of its three straight pieces, and where they meet.
    tau_s : float
        Time constant of the lag of both coefficients (Eq 6).
    reverse_loss : float
        Loss k_rev φ² in reverse flow, which acts without the lag.
    recovery_phi, rearm_phi : float
        φ above which stall ends, and how far below it φ must have been first.
    stall_speeds, stall_phis, stall_psi_ps : tuple of float
        Table over N_c of the stall point φ_s and its ψ'.
    unstalled_droop : float
        ψ' lost beyond the stall point, per unit of (φ − φ_s)².
    unstalled_efficiency : float
        ψ'/ψ on the unstalled branch.
    blend_s, cell_rise_s : float
        Time constants of the change between the branches and of the cell amplitude.
    always_cells : float
        Least cell amplitude once the first stall has happened (0: cells only in stall).
    near_stall_phi_ratio : float
        φ of the initial equilibrium over φ_s.
    inertia_per_m, inlet_inertia_per_m : float
        ∫dx/A of the compressor (``La_c``) and of the duct before it (``La_in``).
    internal_volume_m3, internal_weight : float
        Storage V_c inside the compressor and the weight κ of the exit in its mean pressure.
    discharge_volume_m3, exhaust_volume_m3, inlet_volume_m3, face_volume_m3 : float
        Volumes V31, V_ex, V_in, V_f.
    exhaust_pressure_frac : float
        P_ex/P31 of the initial equilibrium (``Pex_frac``); sizes both orifices.
    supply_pump_kg_s_pa : float
        Fall of the supply flow with inlet pressure (``Gpump``).
    inlet_loss_frac : float
        Pressure loss from inlet volume to face in the initial equilibrium, over face pressure.
    recirculation_frac, recirculation_work, recirculation_exchange : float
        In-stall tip recirculation: ``c_rec``, ``psi_rec`` and ``c_x``.
    reverse_heat_frac : float
        Share of the discharge temperature that reversed gas still carries to the face.
    coil_effectiveness, coil_lag_s : float
        Share of the inlet's heating that comes back through the refrigeration coil, and its lag.
    close_start_s, close_rate_per_s : float
        Start and rate of the throttle's closing that leads into stall.
    open_reference, open_ratio, open_lag_s : float
        Throttle area after stall is their product, over the initial area; lag on the way there.
    throttle_sweep, throttle_sweep_s : float
        After stall the throttle is moved to and fro by this share of its area, and the period; the
        slow motion in which a low-speed test takes its steady points. 0: not moved.
    cell_frequency_hz, cell_second_harmonic : float
        Rotating stall: fundamental and the relative amplitude of its harmonic.
    cell_pressure_frac, cell_flow_kg_s : float
        Amplitude of the cells in P25 and in corrected flow at plane 25.
    hub_tip_flow_kg_s : float
        In stall the hub passes this much corrected flow more, the tip as much less.
    exit_cell_frac : float
        What is left at plane 31 of cells and hub/tip shift.
    mean_radius_m, inlet_area_m2, exit_area_m2, design_speed_rpm : float
        Geometry and design speed.
    t31_limit_k : tuple of float or None
        Range of the T31 acquisition, beyond which readings clip; None: no limit.
    zoc_inlet_pa, zoc_exit_pa : float
        ZOC reference pressures of the two planes.
    segmentation : float or None
        Corrected flow in lbm/s that splits in-stall from unstalled; None where cells never leave.
    window_s : tuple of float or None
        Part of the record that ``test.toml`` names for the fit; None: it is left to be found.
    """

    name: str
    corrected_speed_frac: float
    supply_temperature_k: float
    face_pressure_pa: float
    pressure_terms: tuple[float, float, float]
    pressure_cubic: float
    pressure_kink: float
    kink_phi: float
    work_intercept: float
    work_slopes: tuple[float, float, float]
    work_breaks: tuple[float, float]
    tau_s: float
    reverse_loss: float
    recovery_phi: float
    rearm_phi: float
    stall_speeds: tuple[float, float]
    stall_phis: tuple[float, float]
    stall_psi_ps: tuple[float, float]
    unstalled_droop: float
    unstalled_efficiency: float
    blend_s: float
    cell_rise_s: float
    always_cells: float
    near_stall_phi_ratio: float
    inertia_per_m: float
    inlet_inertia_per_m: float
    internal_volume_m3: float
    internal_weight: float
    discharge_volume_m3: float
    exhaust_volume_m3: float
    inlet_volume_m3: float
    face_volume_m3: float
    exhaust_pressure_frac: float
    supply_pump_kg_s_pa: float
    inlet_loss_frac: float
    recirculation_frac: float
    recirculation_work: float
    recirculation_exchange: float
    reverse_heat_frac: float
    coil_effectiveness: float
    coil_lag_s: float
    close_start_s: float
    close_rate_per_s: float
    open_reference: float
    open_ratio: float
    open_lag_s: float
    throttle_sweep: float
    throttle_sweep_s: float
    cell_frequency_hz: float
    cell_second_harmonic: float
    cell_pressure_frac: float
    cell_flow_kg_s: float
    hub_tip_flow_kg_s: float
    exit_cell_frac: float
    mean_radius_m: float
    inlet_area_m2: float
    exit_area_m2: float
    design_speed_rpm: float
    t31_limit_k: tuple[float, float] | None
    zoc_inlet_pa: float
    zoc_exit_pa: float
    segmentation: float | None
    window_s: tuple[float, float] | None

    @property
    def rotor_speed_rpm(self) -> float:
        """Physical speed N = N_c · N_design · √(T/T_o), constant through the test."""
        theta = self.supply_temperature_k / T_REF_K
        return self.corrected_speed_frac * self.design_speed_rpm * sqrt(theta)

    @property
    def rotor_velocity_m_s(self) -> float:
        """Mean rotor velocity U."""
        return 2.0 * pi * self.rotor_speed_rpm / 60.0 * self.mean_radius_m

    def in_stall_psi_p(self, phi: FloatArray) -> FloatArray:
        """Return ψ'_QS in stall, without the loss of reversed flow (Eq 12)."""
        terms = [*self.pressure_terms, self.pressure_cubic]
        bend = self.pressure_kink * np.maximum(phi - self.kink_phi, 0.0)
        return np.asarray(np.polynomial.polynomial.polyval(phi, terms) + bend)

    def in_stall_psi(self, phi: FloatArray) -> FloatArray:
        """Return ψ_QS in stall: three straight pieces (Eq 14)."""
        first, second = self.work_breaks
        pieces = (
            np.minimum(phi, first),
            np.clip(phi - first, 0.0, second - first),
            np.maximum(phi - second, 0.0),
        )
        return np.asarray(self.work_intercept + np.tensordot(self.work_slopes, pieces, 1))

    def stall_point(self, speed_frac: float) -> tuple[float, float]:
        """Return φ and ψ' of the stall point at a corrected speed."""
        low, high = self.stall_speeds
        x = (speed_frac - low) / (high - low)
        (phi_low, phi_high), (psi_low, psi_high) = self.stall_phis, self.stall_psi_ps
        return phi_low + x * (phi_high - phi_low), psi_low + x * (psi_high - psi_low)

    def unstalled_psi_p(self, phi: FloatArray, speed_frac: float) -> FloatArray:
        """Return ψ'_QS out of stall at a corrected speed: flat up to the stall point, then down."""
        phi_s, psi_s = self.stall_point(speed_frac)
        return np.asarray(psi_s - self.unstalled_droop * np.maximum(phi - phi_s, 0.0) ** 2)


def _cases() -> dict[str, RigCase]:
    text = files("comparisons.rig").joinpath("cases.toml").read_text("utf-8")
    sets = tomllib.loads(text)
    base = next(iter(sets.values()))
    cases = {}
    for name, own in sets.items():
        numbers: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else None if value == "none" else value
            for key, value in (base | own).items()
        }
        cases[name] = RigCase(name, **numbers)
    return cases


CASES: Mapping[str, RigCase] = _cases()
