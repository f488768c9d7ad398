"""Compiled loop of the plant: right-hand side, stall logic and fixed-step integration.

`comparisons.rig.plant` explains the model and its equations.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from math import exp, sin, sqrt
from typing import Any

import numpy as np
from numba import njit

from comparisons.rig.cases import RigCase
from comparisons.rig.gas import (
    CP_J_KG_K,
    FLOW_CONSTANT_KG_S_M2,
    GAMMA,
    GAS_CONSTANT_J_KG_K,
    P_REF_PA,
    T_REF_K,
)
from comparisons.rig.hidden import (
    BRANCH_PHIS,
    BUMP_PHI,
    BUMP_WIDTH_PHI,
    HEAT_SOAK_S,
    HIDEABLE,
    LOW_FLOW_PHI,
    SETTLED_SPEED_FRAC,
)
from surge_core.types import FloatArray

# What the equilibrium of a case sizes, and what is made of its numbers.
SIZED_FIELDS = (
    "loss", "supply_flow", "supply_pressure", "recirculation_heat", "throttle", "exhaust",
    "sweep_rate", "rotor_velocity",
)  # fmt: skip
# Of a case all its numbers under their own names, but for those that only the sensors and the test
# description need; and the size of each hidden effect.
CASE_FIELDS = tuple(
    field.name
    for field in fields(RigCase)
    if field.name not in ("name", "t31_limit_k", "segmentation", "window_s")
)
# A named tuple, which the compiled loop can take apart.
_named_tuple: Any = namedtuple
Constants = _named_tuple("Constants", (*CASE_FIELDS, *HIDEABLE, *SIZED_FIELDS))

# Positions in the state vector.
STATES = ("W", "psi_p", "psi", "P31", "T31", "P_in", "T_in", "T_face", "P_ex", "T_ex", "blend",
          "cells", "T_coil", "throttle")  # fmt: skip
(W, PSI_P, PSI, P31, T31, P_IN, T_IN, T_FACE, P_EX, T_EX, BLEND, CELLS, T_COIL, THROTTLE) = range(
    14
)
# Positions in the latch: what the plant remembers beside its states.
(STALLED, ARMED, EVER, DEEP, WAY, LAST_PHI) = range(6)
# Positions in the output row.
OUTPUTS = ("phi", "psi_p_total", "psi_p_lagged", "psi_p_qs", "psi", "psi_qs", "W25", "dW25",
           "W31", "P25", "P31", "T25", "T_exit", "blend", "cells", "in_stall", "P_in", "T_in",
           "W_throttle", "throttle", "T_plenum")  # fmt: skip

_R = GAS_CONSTANT_J_KG_K
_G = GAMMA
_FLOW = float(FLOW_CONSTANT_KG_S_M2)
_CHOKED = 1.2**-3
_CRITICAL = (2.0 / (_G + 1.0)) ** (_G / (_G - 1.0))
# Mass flow of a choked orifice: W = A P sqrt(gamma/(R T)) (2/(gamma+1))^((gamma+1)/(2(gamma-1))).
_CHOKED_FLOW = sqrt(_G / _R) * (2.0 / (_G + 1.0)) ** ((_G + 1.0) / (2.0 * (_G - 1.0)))


@njit(cache=True)
def _phi_of(
    flow: float, pressure: float, temperature: float, area: float, velocity: float
) -> float:
    """Return φ of a mass flow (Eq 3, 4 and 7)."""
    w = abs(flow) * sqrt(temperature / T_REF_K) * P_REF_PA / (pressure * area * _FLOW)
    # A trial state beyond choking would leave Newton without a root; the plant stays far below.
    w = min(w, 0.999 * _CHOKED)
    m = w
    for _ in range(60):
        b = 1.0 + 0.2 * m * m
        step = (w - m / (b * b * b)) * b * b * b * b / (1.0 - m * m)
        m += step
        if abs(step) < 1e-13:
            break
    phi = m * sqrt(_G * _R * temperature / (1.0 + 0.2 * m * m)) / velocity
    return phi if flow >= 0.0 else -phi


@njit(cache=True)
def orifice_flow(
    area: float, p_up: float, t_up: float, p_down: float, t_down: float
) -> tuple[float, float]:
    """Return mass flow through a compressible orifice, either way, and its temperature."""
    if p_up >= p_down:
        high, low, temperature, sign = p_up, p_down, t_up, 1.0
    else:
        high, low, temperature, sign = p_down, p_up, t_down, -1.0
    ratio = low / high
    base = area * high / sqrt(temperature)
    if ratio <= _CRITICAL:
        return sign * base * _CHOKED_FLOW, temperature
    head = ratio ** (2.0 / _G) - ratio ** ((_G + 1.0) / _G)
    return sign * base * sqrt(2.0 * _G / ((_G - 1.0) * _R) * max(head, 0.0)), temperature


@njit(cache=True)
def _stall_point(c: Any, face_temperature: float) -> tuple[float, float]:
    """Return φ_s and ψ'_s at the present corrected speed (a table of two points)."""
    speed = c.corrected_speed_frac * sqrt(c.supply_temperature_k / face_temperature)
    low, high = c.stall_speeds
    x = (speed - low) / (high - low)
    (phi_low, phi_high), (psi_low, psi_high) = c.stall_phis, c.stall_psi_ps
    return phi_low + x * (phi_high - phi_low), psi_low + x * (psi_high - psi_low)


@njit(cache=True)
def _unstalled_psi_p(c: Any, phi: float, face_temperature: float) -> float:
    """Return ψ'_QS of the unstalled branch: flat up to the stall point, a parabola beyond."""
    phi_s, psi_s = _stall_point(c, face_temperature)
    value: float = psi_s - c.unstalled_droop * max(phi - phi_s, 0.0) ** 2
    return value


@njit(cache=True)
def _targets(
    c: Any, time: float, phi: float, face_temperature: float, q: float, deep: float
) -> tuple[float, float]:
    """Return ψ'_QS and ψ_QS, both branches blended by q; stalled never above unstalled.

    What may be hidden in ψ'_QS leaves every bit of it as it is where its size is zero.
    """
    free = _unstalled_psi_p(c, phi, face_temperature)
    scale = (sqrt(c.supply_temperature_k / face_temperature) / SETTLED_SPEED_FRAC) ** c.speed_droop
    extra = (
        c.characteristic_shape * exp(-(((phi - BUMP_PHI) / BUMP_WIDTH_PHI) ** 2))
        - c.hysteresis * deep
        + c.pressure_cubic * phi**3
        + c.pressure_kink * max(phi - c.kink_phi, 0.0)
    )
    level, slope, bow = c.pressure_terms
    p = min((level + slope * phi + bow * phi * phi + extra) * scale, free)
    first, second = c.work_breaks
    w = c.work_intercept + c.work_slopes[0] * min(phi, first)
    w += c.work_slopes[1] * min(max(phi - first, 0.0), second - first)
    w += c.work_slopes[2] * max(phi - second, 0.0)
    kept = 1.0 - c.facility_heating * (1.0 - exp(-time / HEAT_SOAK_S))
    return (q * p + (1.0 - q) * free) * kept, q * w + (1.0 - q) * free / c.unstalled_efficiency


@njit(cache=True)
def _duct(c: Any, s: FloatArray) -> tuple[float, float, float]:
    """Return dW/dt, P25 and the total ψ'.

    The reverse loss takes φ at the pressure before the inlet duct's inertia. Taken at P25 itself,
    the loss and the spike that it makes in P25 feed back on each other with a gain above one in
    the first blowdown, and no unique pressure exists.
    """
    p_free = s[P_IN] - c.loss * s[W] * abs(s[W])
    psi_p = s[PSI_P]
    if s[W] < 0.0:
        phi = _phi_of(s[W], p_free, s[T_FACE], c.inlet_area_m2, c.rotor_velocity)
        psi_p += c.reverse_loss * phi**2
    head = c.rotor_velocity**2 / (2.0 * CP_J_KG_K * s[T_FACE])
    ratio = max(1.0 + psi_p * head, 0.05) ** 3.5
    both = c.inertia_per_m + c.inlet_inertia_per_m * ratio
    p25 = (c.inertia_per_m * p_free + c.inlet_inertia_per_m * s[P31]) / both
    return (p25 * ratio - s[P31]) / c.inertia_per_m, p25, psi_p


@njit(cache=True)
def _face(c: Any, s: FloatArray, p25: float, t_back: float, d: FloatArray) -> None:
    """Fill in the rates of inlet volume, face volume and coil.

    In stall the tips stir `c_rec ρ U A` of gas, heat it by `psi_rec U²/2` and exchange `c_x` times
    as much between face and inlet volume.
    """
    forward, backward = max(s[W], 0.0), max(-s[W], 0.0)
    stirred = s[BLEND] * c.recirculation_frac * p25 / (_R * s[T_FACE])
    stirred = stirred * c.rotor_velocity * c.inlet_area_m2
    exchange = c.recirculation_exchange * stirred
    supply = max(c.supply_flow - c.supply_pump_kg_s_pa * (s[P_IN] - c.supply_pressure), 0.0)
    t_supply = c.supply_temperature_k + c.coil_effectiveness * (s[T_COIL] - c.supply_temperature_k)
    enthalpy = supply * t_supply - forward * s[T_IN] + backward * s[T_FACE]
    enthalpy += exchange * (s[T_FACE] - s[T_IN])
    d[P_IN] = _G * _R / c.inlet_volume_m3 * enthalpy
    mass = s[P_IN] * c.inlet_volume_m3 / (_R * s[T_IN])
    d[T_IN] = s[T_IN] * (d[P_IN] / s[P_IN] - (supply - s[W]) / mass)
    t_reversed = s[T_FACE] + c.reverse_heat_frac * (t_back - s[T_FACE])
    heat = forward * (s[T_IN] - s[T_FACE]) + backward * (t_reversed - s[T_FACE])
    heat = heat + stirred * c.recirculation_heat - exchange * (s[T_FACE] - s[T_IN])
    heat += c.face_volume_m3 / CP_J_KG_K * d[P_IN]
    d[T_FACE] = heat * _R * s[T_FACE] / (s[P_IN] * c.face_volume_m3)
    d[T_COIL] = (s[T_IN] - s[T_COIL]) / c.coil_lag_s


@njit(cache=True)
def _discharge(c: Any, s: FloatArray, t2: float, d: FloatArray) -> tuple[float, float]:
    """Fill in the rates behind the compressor; return W31 and the throttle flow.

    Gas is stored inside the compressor at its mean temperature T̄ while κ of the exit pressure acts
    on V_c: W25 − W31 = κ V_c/(R T̄) dP31/dt.
    """
    wt, tt = orifice_flow(c.throttle * s[THROTTLE], s[P31], s[T31], s[P_EX], s[T_EX])
    storage = c.internal_weight * c.internal_volume_m3 / (_R * 0.5 * (s[T_FACE] + t2))
    k31 = _G * _R / c.discharge_volume_m3
    # The gas that crosses plane 31 has the temperature of the side it comes from.
    d[P31] = k31 * (s[W] * t2 - wt * tt) / (1.0 + k31 * storage * t2)
    w31 = s[W] - storage * d[P31]
    if w31 < 0.0:
        d[P31] = k31 * (s[W] * s[T31] - wt * tt) / (1.0 + k31 * storage * s[T31])
        w31 = s[W] - storage * d[P31]
    mass = s[P31] * c.discharge_volume_m3 / (_R * s[T31])
    d[T31] = s[T31] * (d[P31] / s[P31] - (w31 - wt) / mass)

    we, te = orifice_flow(c.exhaust, s[P_EX], s[T_EX], P_REF_PA, c.supply_temperature_k)
    d[P_EX] = _G * _R / c.exhaust_volume_m3 * (wt * tt - we * te)
    mass = s[P_EX] * c.exhaust_volume_m3 / (_R * s[T_EX])
    d[T_EX] = s[T_EX] * (d[P_EX] / s[P_EX] - (wt - we) / mass)
    return w31, wt


@njit(cache=True)
def _rates(
    c: Any, time: float, s: FloatArray, latch: FloatArray, d: FloatArray, out: FloatArray
) -> None:  # fmt: skip
    """Fill in the state's rates and the output row."""
    rate, p25, psi_p = _duct(c, s)
    phi = _phi_of(s[W], p25, s[T_FACE], c.inlet_area_m2, c.rotor_velocity)
    stalled, ever = latch[STALLED], latch[EVER]
    qs_p, qs_w = _targets(c, time, phi, s[T_FACE], s[BLEND], latch[DEEP])
    slower = 1.0 + c.asymmetric_lag * latch[WAY]
    if phi < LOW_FLOW_PHI:
        slower *= 1.0 + c.flow_dependent_lag
    d[W] = rate
    d[PSI_P] = (qs_p - s[PSI_P]) / (c.tau_s * slower)
    d[PSI] = (qs_w - s[PSI]) / (c.tau_s * slower)
    d[BLEND] = (stalled - s[BLEND]) / c.blend_s
    d[CELLS] = (max(stalled, c.always_cells * ever) - s[CELLS]) / c.cell_rise_s
    if ever > 0.0:
        opened = c.open_ratio * (1.0 + c.throttle_sweep * sin(c.sweep_rate * time))
        d[THROTTLE] = (opened - s[THROTTLE]) / c.open_lag_s
    elif time >= c.close_start_s:
        d[THROTTLE] = -c.close_rate_per_s
    else:
        d[THROTTLE] = 0.0
    t2 = s[T_FACE] + s[PSI] * c.rotor_velocity**2 / (2.0 * CP_J_KG_K)
    _face(c, s, p25, s[T31], d)
    w31, wt = _discharge(c, s, t2, d)
    t_exit = t2 if w31 >= 0.0 else s[T31]
    row = (phi, psi_p, s[PSI_P], qs_p, s[PSI], qs_w, s[W], rate, w31, p25, s[P31], s[T_FACE],
           t_exit, s[BLEND], s[CELLS], stalled, s[P_IN], s[T_IN], wt, s[THROTTLE],
           s[T31])  # fmt: skip
    for i in range(len(row)):
        out[i] = row[i]


@njit(cache=True)
def _switch(c: Any, phi: float, t_face: float, latch: FloatArray) -> None:
    """Move the latch: stalled, armed, ever stalled; deep stall; the way of φ since the last step.

    Into stall below φ_s, armed only once φ has been above φ_s; out of stall above φ_rec, armed
    only once φ has been below φ_rec − 0.05. A flow that never reaches φ_s again and falls through
    φ_rec − 0.05 stalls too, or the compressor would reverse on its unstalled branch.
    """
    phi_s, _ = _stall_point(c, t_face)
    if latch[STALLED] > 0.0:
        if phi < c.recovery_phi - c.rearm_phi:
            latch[ARMED] = 1.0
        elif latch[ARMED] > 0.0 and phi > c.recovery_phi:
            latch[STALLED], latch[ARMED] = 0.0, 0.0
    elif phi > phi_s:
        latch[ARMED] = 1.0
    elif latch[ARMED] > 0.0 or phi < c.recovery_phi - c.rearm_phi:
        latch[STALLED], latch[ARMED], latch[EVER] = 1.0, 0.0, 1.0
    if phi < BRANCH_PHIS[0]:
        latch[DEEP] = 1.0
    elif phi > BRANCH_PHIS[1]:
        latch[DEEP] = 0.0
    latch[WAY] = np.sign(phi - latch[LAST_PHI])
    latch[LAST_PHI] = phi


@njit(cache=True)
def integrate(c: Any, start: FloatArray, n_rows: int, row_s: float, substeps: int) -> FloatArray:
    """Integrate by classical Runge-Kutta with a fixed step; one output row each `row_s`."""
    rows, scratch = np.empty((n_rows, 21)), np.empty(21)
    s, trial, k, latch = start.copy(), np.empty(14), np.empty((4, 14)), np.zeros(6)
    latch[ARMED] = 1.0
    latch[LAST_PHI] = np.inf
    h = row_s / substeps
    for i in range(n_rows):
        for j in range(substeps):
            time = i * row_s + j * h
            out = rows[i] if j == 0 else scratch
            _rates(c, time, s, latch, k[0], out)
            _switch(c, out[0], s[T_FACE], latch)
            for n, part in ((1, 0.5), (2, 0.5), (3, 1.0)):
                trial[:] = s + part * h * k[n - 1]
                _rates(c, time + part * h, trial, latch, k[n], scratch)
            s += h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
    return rows
