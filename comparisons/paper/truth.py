"""The rig's own characteristics, written out for the claims and pictures that show the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.coefficients import flow_coefficient
from classic_ml.flow import LBM_KG
from comparisons.paper.instabilities import InstabilityRun
from surge_core.types import FloatArray

PSI_PA = 6_894.757_293
RANKINE_PER_K = 1.8
# Paper, "Model Identification for 98.5% Corrected Speed": between in-stall and unstalled flow.
THRESHOLD_LBM_S = 50.0


def in_stall_psi_p(run: InstabilityRun, phi: ArrayLike) -> FloatArray:
    """Return the rig's quasi-steady ψ' in stall, without the loss of reversed flow (Eq 12)."""
    case, flow = run.machine, np.asarray(phi, dtype=np.float64)
    bend = case.pressure_kink * np.maximum(flow - case.kink_phi, 0.0)
    bend = bend + case.pressure_cubic * flow**3
    return np.asarray(np.polynomial.polynomial.polyval(flow, case.pressure_terms) + bend)


def in_stall_psi(run: InstabilityRun, phi: ArrayLike) -> FloatArray:
    """Return the rig's quasi-steady ψ in stall: three straight pieces (Eq 14)."""
    case, flow = run.machine, np.asarray(phi, dtype=np.float64)
    first, second = case.work_breaks
    pieces = (
        np.minimum(flow, first),
        np.clip(flow - first, 0.0, second - first),
        np.maximum(flow - second, 0.0),
    )
    steps = [slope * piece for slope, piece in zip(case.work_slopes, pieces, strict=True)]
    return np.asarray(case.work_intercept + np.sum(steps, axis=0))


def stall_point(run: InstabilityRun, speed_frac: float) -> tuple[float, float]:
    """Return φ and ψ' of the rig's stall point at a corrected speed."""
    case = run.machine
    low, high = case.stall_speeds
    along = (speed_frac - low) / (high - low)
    phi, psi_p = (
        values[0] + along * (values[1] - values[0])
        for values in (case.stall_phis, case.stall_psi_ps)
    )
    return float(phi), float(psi_p)


def unstalled_psi_p(run: InstabilityRun, phi: ArrayLike, speed_frac: float) -> FloatArray:
    """Return the rig's unstalled ψ' at a corrected speed: flat up to the stall point, then down."""
    phi_s, psi_s = stall_point(run, speed_frac)
    beyond = np.maximum(np.asarray(phi, dtype=np.float64) - phi_s, 0.0)
    return np.asarray(psi_s - run.machine.unstalled_droop * beyond**2)


def temperature_K(run: InstabilityRun, speed_frac: float) -> float:
    """Return the inlet temperature at which the machine turns at a corrected speed."""
    case = run.machine
    return case.supply_temperature_k * (case.corrected_speed_frac / speed_frac) ** 2


def phi_of_flow(run: InstabilityRun, flow_lbm_s: ArrayLike, inlet_K: float) -> FloatArray:
    """Return φ of a corrected flow in lbm/s at an inlet temperature (Eq 7)."""
    test = run.paper.test
    flow = LBM_KG * np.atleast_1d(np.asarray(flow_lbm_s, dtype=np.float64))
    return flow_coefficient(
        flow,
        np.full(flow.size, inlet_K),
        test.areas_m2[25],
        test.rotor_velocity_m_s,
        test.compressor,
    )


def pressure_ratio(run: InstabilityRun, psi_p: ArrayLike, inlet_K: float) -> FloatArray:
    """Return the pressure ratio of a ψ' at an inlet temperature."""
    test = run.paper.test
    gas: Any = test.compressor
    head = test.rotor_velocity_m_s**2 / (2.0 * gas.specific_heat_J_kg_K * inlet_K)
    power = gas.gamma / (gas.gamma - 1.0)
    return np.asarray(np.maximum(1.0 + np.asarray(psi_p) * head, 0.0) ** power)
