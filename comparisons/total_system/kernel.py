"""Compiled loops of the lumped model: rates, stall latch, integration, and the facility's states.

Imported only when a simulation runs, because it pulls in numba. `comparisons.total_system.model`
explains the model and its equations.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from math import exp, sqrt
from typing import Any

import numpy as np
from numba import njit

from comparisons.total_system.facility import Facility
from surge_core.types import FloatArray

__all__ = ["Constants", "integrate", "latches", "observe", "orifice"]


# Positions in the state vector and, behind it, in an output row; `model` names them.
W, PSI_P, PSI, P31, T31, P_IN, T_IN, P_EX, T_EX, T_COIL, T_FACE = range(11)
P25, PHI, PSI_P_TOTAL, BLEND, W31, W_THROTTLE, W_EXHAUST, W_SUPPLY = range(11, 19)
N_STATES, N_COLUMNS = 11, 19
# Positions in the latch: branch, armed for the other one, and when and from where the blend runs.
STALLED, ARMED, SINCE, FROM = range(4)

# Newton on Eq 3 from below doubles its digits each time; flows here are subsonic.
_NEWTON_STEPS = 12
_LARGEST_SHARE_OF_CHOKE = 0.999


def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with an on-disk cache where some directory can be written, else without."""
    try:
        compiled: Callable[..., Any] = njit(cache=True)(function)
    except RuntimeError:
        compiled = njit(function)
    return compiled


# The facility's numbers as table and key of its file, and what the model adds to them.
FACILITY_FIELDS = tuple(
    f"{table}_{key}"
    for table, field in Facility.model_fields.items()
    for key in field.annotation.model_fields  # type: ignore[union-attr]
)
MODEL_FIELDS = (
    "beta1", "beta2", "beta3", "tau", "inertia", "storage_volume", "discharge_volume", "loss",
    "supply_flow", "supply_pressure", "recirculation_heat", "throttle_area", "exhaust_area",
    "start", "speed", "velocity", "area", "flow_constant", "choke", "gamma", "gas", "heat",
)  # fmt: skip
# A named tuple, all in SI, which the compiled loops can take apart.
_named_tuple: Any = namedtuple
Constants = _named_tuple("Constants", FACILITY_FIELDS + MODEL_FIELDS)


@_compile
def _phi(c: Any, flow: float, pressure: float, temperature: float) -> float:
    """Return φ = C_z/U of a mass flow (Eq 4, inverse of Eq 3, Eq 7)."""
    share = abs(flow) * sqrt(temperature) / (pressure * c.flow_constant)
    # A trial state beyond choking has no Mach number; the search then sees a large residual.
    share = min(share, _LARGEST_SHARE_OF_CHOKE * c.choke)
    power = (c.gamma + 1.0) / (2.0 * (c.gamma - 1.0))
    mach = share
    for _ in range(_NEWTON_STEPS):
        bracket = 1.0 + 0.5 * (c.gamma - 1.0) * mach * mach
        swallowed = mach * bracket**-power
        step = (share - swallowed) * bracket * mach / (swallowed * (1.0 - mach * mach) + 1e-300)
        mach += step
        if abs(step) < 1e-12:
            break
    static = temperature / (1.0 + 0.5 * (c.gamma - 1.0) * mach * mach)
    size = mach * sqrt(c.gamma * c.gas * static) / c.velocity
    return float(size if flow >= 0.0 else -size)


@_compile
def orifice(
    c: Any, area: float, p_up: float, t_up: float, p_down: float, t_down: float
) -> tuple[float, float]:
    """Return flow and gas temperature through an effective area, either way, choked or not."""
    sign, high, low, temperature = 1.0, p_up, p_down, t_up
    if p_down > p_up:
        sign, high, low, temperature = -1.0, p_down, p_up, t_down
    g = c.gamma
    critical = (2.0 / (g + 1.0)) ** (g / (g - 1.0))
    ratio = max(low / high, critical)
    head = 2.0 * g / (g - 1.0) * (ratio ** (2.0 / g) - ratio ** ((g + 1.0) / g))
    return sign * area * high * sqrt(max(head, 0.0) / (c.gas * temperature)), temperature


@_compile
def _stall_point(c: Any, t25: float) -> tuple[float, float]:
    """Return φ_s and ψ'_s at the corrected speed that T25 leaves of the constant rotor speed."""
    x = (c.speed / sqrt(t25) - c.compressor_stall_speed_low_frac) / (
        c.compressor_stall_speed_high_frac - c.compressor_stall_speed_low_frac
    )
    return c.compressor_stall_phi_low + x * (
        c.compressor_stall_phi_high - c.compressor_stall_phi_low
    ), c.compressor_stall_psi_p_low + x * (
        c.compressor_stall_psi_p_high - c.compressor_stall_psi_p_low
    )


@_compile
def _characteristics(c: Any, phi: float, t25: float, q: float) -> tuple[float, float]:
    """Return ψ'_QS and ψ_QS, both branches blended by q; stall never raises the pressure."""
    phi_s, psi_s = _stall_point(c, t25)
    over = max(phi - phi_s, 0.0)
    free = psi_s - c.compressor_unstalled_droop * over * over
    stalled = min(c.beta1 + phi * (c.beta2 + phi * c.beta3), free)
    work = (
        c.compressor_work_intercept
        + c.compressor_work_slope_1 * min(phi, c.compressor_work_break_1)
        + c.compressor_work_slope_2
        * min(
            max(phi - c.compressor_work_break_1, 0.0),
            c.compressor_work_break_2 - c.compressor_work_break_1,
        )
        + c.compressor_work_slope_3 * max(phi - c.compressor_work_break_2, 0.0)
    )
    return free + q * (stalled - free), free / c.compressor_unstalled_efficiency + q * (
        work - free / c.compressor_unstalled_efficiency
    )


@_compile
def _throttle(c: Any, time: float) -> float:
    """Return the throttle area over its initial one, which the surge start sets to opening."""
    closed = 1.0 - c.throttle_close_rate_per_s * max(
        min(time, c.start) - c.throttle_close_start_s, 0.0
    )
    if time <= c.start:
        return float(closed)
    return float(
        c.throttle_open_ratio
        + (closed - c.throttle_open_ratio) * exp(-(time - c.start) / c.throttle_open_lag_s)
    )


@_compile
def _blend(c: Any, latch: FloatArray, time: float) -> float:
    """Return the share of the stalled branch: an exponential since the last switch."""
    fade = exp(-max(time - latch[SINCE], 0.0) / c.compressor_blend_s)
    return float(latch[STALLED] + (latch[FROM] - latch[STALLED]) * fade)


@_compile
def _rates(
    c: Any, time: float, s: FloatArray, latch: FloatArray, d: FloatArray, out: FloatArray
) -> None:
    """Fill in the state's rates and the output row."""
    t25 = s[T_FACE]
    q = _blend(c, latch, time)
    # Momentum of the inlet duct and of the compressor, one flow through both.
    before = s[P_IN] - c.loss * s[W] * abs(s[W])
    psi_p = s[PSI_P]
    if s[W] < 0.0:
        # φ before the duct's inertia: with P25 itself the loss would feed back on its own spike.
        psi_p += c.compressor_reverse_loss * _phi(c, s[W], before, t25) ** 2
    head = c.velocity**2 / (2.0 * c.heat)
    ratio = max(1.0 + psi_p * head / t25, 0.05) ** (c.gamma / (c.gamma - 1.0))
    d[W] = (before * ratio - s[P31]) / (c.inertia + c.inlet_inertia_per_m * ratio)
    p25 = before - c.inlet_inertia_per_m * d[W]
    phi = _phi(c, s[W], p25, t25)
    quasi_p, quasi_w = _characteristics(c, phi, t25, q)
    d[PSI_P] = (quasi_p - s[PSI_P]) / c.tau
    d[PSI] = (quasi_w - s[PSI]) / c.tau
    _behind(c, time, s, d, out)
    _before(c, s, p25, q, d, out)
    out[:N_STATES] = s
    out[P25], out[PHI], out[PSI_P_TOTAL], out[BLEND] = p25, phi, psi_p, q


@_compile
def _behind(c: Any, time: float, s: FloatArray, d: FloatArray, out: FloatArray) -> None:
    """Fill in discharge and exhaust: mass and energy of two volumes behind two orifices."""
    t25 = s[T_FACE]
    area = c.throttle_area * _throttle(c, time)
    wt, tt = orifice(c, area, s[P31], s[T31], s[P_EX], s[T_EX])
    t2 = t25 + s[PSI] * c.velocity**2 / (2.0 * c.heat)
    stored = c.storage_volume / (c.gas * 0.5 * (t25 + t2))
    gain = c.gamma * c.gas / c.discharge_volume
    d[P31] = gain * (s[W] * t2 - wt * tt) / (1.0 + gain * stored * t2)
    w31 = s[W] - stored * d[P31]
    if w31 < 0.0:
        # Gas that comes back out of the discharge volume has that volume's temperature.
        d[P31] = gain * (s[W] * s[T31] - wt * tt) / (1.0 + gain * stored * s[T31])
        w31 = s[W] - stored * d[P31]
    mass = s[P31] * c.discharge_volume / (c.gas * s[T31])
    d[T31] = s[T31] * (d[P31] / s[P31] - (w31 - wt) / mass)
    out[W31], out[W_THROTTLE], out[W_EXHAUST] = w31, wt, _exhaust(c, wt, tt, s, d)


@_compile
def _exhaust(c: Any, wt: float, tt: float, s: FloatArray, d: FloatArray) -> float:
    """Fill in the exhaust volume, fed by the throttle, and return what flows out of it."""
    we, te = orifice(
        c, c.exhaust_area, s[P_EX], s[T_EX], c.throttle_ambient_pressure_Pa, c.supply_temperature_K
    )
    d[P_EX] = c.gamma * c.gas / c.volumes_exhaust_m3 * (wt * tt - we * te)
    mass = s[P_EX] * c.volumes_exhaust_m3 / (c.gas * s[T_EX])
    d[T_EX] = s[T_EX] * (d[P_EX] / s[P_EX] - (wt - we) / mass)
    return float(we)


@_compile
def _supply(c: Any, p_in: float, t_coil: float) -> tuple[float, float]:
    """Return flow and temperature of what the refrigeration plant supplies."""
    flow = max(c.supply_flow - c.supply_slope_kg_s_Pa * (p_in - c.supply_pressure), 0.0)
    share, temperature = c.supply_coil_effectiveness, c.supply_temperature_K
    return flow, temperature + share * (t_coil - temperature)


@_compile
def _stirred(c: Any, q: float, p25: float, t25: float) -> float:
    """Return the flow that recirculates at the tips in stall."""
    return float(q * c.heat_recirculation_frac * p25 / (c.gas * t25) * c.velocity * c.area)


@_compile
def _before(c: Any, s: FloatArray, p25: float, q: float, d: FloatArray, out: FloatArray) -> None:
    """Fill in inlet volume and face: supply, compressor, and what recirculation stirs and heats."""
    t25 = s[T_FACE]
    supply, t_supply = _supply(c, s[P_IN], s[T_COIL])
    stirred = _stirred(c, q, p25, t25)
    mixed = c.heat_recirculation_exchange * stirred
    out_flow, back = max(s[W], 0.0), max(-s[W], 0.0)
    heat = supply * t_supply - out_flow * s[T_IN] + back * t25 + mixed * (t25 - s[T_IN])
    d[P_IN] = c.gamma * c.gas / c.volumes_inlet_m3 * heat
    mass = s[P_IN] * c.volumes_inlet_m3 / (c.gas * s[T_IN])
    d[T_IN] = s[T_IN] * (d[P_IN] / s[P_IN] - (supply - s[W]) / mass)
    d[T_COIL] = (s[T_IN] - s[T_COIL]) / c.supply_coil_lag_s
    warming = (
        (out_flow + mixed) * (s[T_IN] - t25)
        + back * c.heat_reverse_heat_frac * (s[T31] - t25)
        + stirred * c.recirculation_heat
        + c.volumes_face_m3 / c.heat * d[P_IN]
    )
    d[T_FACE] = warming * c.gas * t25 / (s[P_IN] * c.volumes_face_m3)
    out[W_SUPPLY] = supply


@_compile
def _switch(
    c: Any, latch: FloatArray, t25: float, old: float, new: float, time: float, h: float
) -> bool:
    """Move the latch after φ went from ``old`` to ``new`` in the step that ends at ``time``.

    Out of stall above φ_rec, armed only once φ has been below φ_rec − rearm; into stall below
    φ_s, armed only once φ has been above it, and in any case below φ_rec − rearm.
    """
    low = c.compressor_recovery_phi - c.compressor_rearm_phi
    phi_s, _ = _stall_point(c, t25)
    edge = 0.0
    if latch[STALLED] > 0.5:
        if new < low:
            latch[ARMED] = 1.0
        if latch[ARMED] < 0.5 or new <= c.compressor_recovery_phi:
            return False
        edge = c.compressor_recovery_phi
    else:
        if new > phi_s:
            latch[ARMED] = 1.0
            return False
        if latch[ARMED] < 0.5 and new >= low:
            return False
        edge = phi_s if latch[ARMED] > 0.5 else low
    # Where the line between the two values meets the edge: the switch must not hang on the step.
    back = h * min(max((new - edge) / (new - old), 0.0), 1.0) if new != old else 0.0
    latch[FROM] = _blend(c, latch, time - back)
    latch[SINCE] = time - back
    latch[STALLED], latch[ARMED] = 1.0 - latch[STALLED], 0.0
    return True


@_compile
def _step(
    c: Any, time: float, h: float, s: FloatArray, latch: FloatArray, work: FloatArray,
    row: FloatArray,
) -> None:  # fmt: skip
    """Advance the state by one classical Runge-Kutta step whose first rates are in ``work[0]``."""
    k1, k2, k3, k4, trial = work[0], work[1], work[2], work[3], work[4]
    trial[:] = s + 0.5 * h * k1
    _rates(c, time + 0.5 * h, trial, latch, k2, row)
    trial[:] = s + 0.5 * h * k2
    _rates(c, time + 0.5 * h, trial, latch, k3, row)
    trial[:] = s + h * k3
    _rates(c, time + h, trial, latch, k4, row)
    s += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@_compile
def integrate(
    c: Any, state: FloatArray, begin_latch: FloatArray, begin: float, first: float,
    n_rows: int, row_s: float, substeps: int, forced: FloatArray,
) -> FloatArray:  # fmt: skip
    """Integrate from ``begin`` and return one row at ``first`` and each ``row_s`` after it.

    ``forced`` holds a latch for each row, which the branches then follow in place of φ; with no
    rows in it the model switches by itself.
    """
    rows = np.empty((n_rows, N_COLUMNS))
    s, latch = state.copy(), begin_latch.copy()
    work, scratch = np.empty((5, N_STATES)), np.empty(N_COLUMNS)
    phi, last_h = np.nan, 0.0
    # Row -1 is the stretch up to the first row, which need not be a whole row long.
    for i in range(-1, n_rows):
        length = max(first - begin, 0.0) if i < 0 else row_s
        n_steps = int(np.ceil(length / row_s * substeps - 1e-9)) if i < 0 else substeps
        if i == n_rows - 1:
            n_steps = 1
        h = length / max(n_steps, 1)
        origin = begin if i < 0 else first + i * row_s
        for j in range(n_steps):
            time = origin + j * h
            row = rows[i] if i >= 0 and j == 0 else scratch
            if 0 <= i < forced.shape[0] - 1:
                # A switch inside the row is written to the latch of the next one.
                after = time >= forced[i + 1, SINCE] and forced[i + 1, SINCE] > first
                latch[:] = forced[i + 1] if after else forced[i]
            _rates(c, time, s, latch, work[0], row)
            if not np.isnan(phi) and forced.shape[0] == 0:
                new = row[PHI]
                if _switch(c, latch, s[T_FACE], phi, new, time, last_h):
                    _rates(c, time, s, latch, work[0], row)
            phi, last_h = row[PHI], h
            if i < n_rows - 1:
                _step(c, time, h, s, latch, work, scratch)
    return rows


@_compile
def latches(c: Any, phi: FloatArray, t25: FloatArray, first: float, row_s: float) -> FloatArray:
    """Return the latch of each row of a measured φ, in stall from the surge start on."""
    out = np.empty((phi.size, 4))
    latch = np.zeros(4)
    latch[SINCE] = first
    begun = False
    for i in range(phi.size):
        time = first + i * row_s
        if not begun and time >= c.start:
            begun = True
            latch[STALLED], latch[ARMED], latch[SINCE], latch[FROM] = 1.0, 0.0, c.start, 0.0
        elif begun:
            _switch(c, latch, t25[i], phi[i - 1], phi[i], time, row_s)
        out[i] = latch
    return out


@_compile
def observe(
    c: Any, measured: FloatArray, latch: FloatArray, first: float, row_s: float,
    state: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the model's states at each row with the measured ones put in for the compressor.

    ``measured`` has the columns W25, ψ', P31, P_in, P25, φ and T25. What no probe reads (gas
    temperatures of the volumes, exhaust pressure, ψ) follows from the same balances, driven by
    what was measured; nothing unstable is left in them, so that they forget their start.
    """
    n = measured.shape[0]
    rows = np.empty((n, N_STATES))
    s, ahead = state.copy(), np.empty(N_STATES)
    here, there = np.zeros(N_STATES), np.zeros(N_STATES)
    for i in range(n):
        s[W], s[PSI_P], s[P31], s[P_IN] = measured[i, :4]
        s[T_FACE] = measured[i, 6]
        rows[i] = s
        if i == n - 1:
            break
        slopes = (measured[i + 1] - measured[i]) / row_s
        _unmeasured(c, first + i * row_s, measured[i], slopes, latch[i], s, here)
        ahead[:] = s + row_s * here
        j = i + 1
        _unmeasured(c, first + j * row_s, measured[j], slopes, latch[j], ahead, there)
        s += 0.5 * row_s * (here + there)
    return rows


@_compile
def _unmeasured(
    c: Any, time: float, at: FloatArray, slopes: FloatArray, latch: FloatArray,
    s: FloatArray, d: FloatArray,
) -> None:  # fmt: skip
    """Fill in the rates of the states that no probe reads, with the measured ones put in."""
    flow, p31, p_in, p25, phi, t25 = at[0], at[2], at[3], at[4], at[5], at[6]
    q = _blend(c, latch, time)
    k = (c.gamma - 1.0) / c.gamma
    t2 = t25 + s[PSI] * c.velocity**2 / (2.0 * c.heat)
    _, quasi_w = _characteristics(c, phi, t25, q)
    d[PSI] = (quasi_w - s[PSI]) / c.tau
    # With P measured, mass and energy give dT/T = k dP/P + W_in (T_in − T)/(m T).
    w31 = flow - c.storage_volume / (c.gas * 0.5 * (t25 + t2)) * slopes[2]
    mass = p31 * c.discharge_volume / (c.gas * s[T31])
    d[T31] = k * s[T31] * slopes[2] / p31 + max(w31, 0.0) * (t2 - s[T31]) / mass
    wt, tt = orifice(c, c.throttle_area * _throttle(c, time), p31, s[T31], s[P_EX], s[T_EX])
    _exhaust(c, wt, tt, s, d)
    supply, t_supply = _supply(c, p_in, s[T_COIL])
    mixed = c.heat_recirculation_exchange * _stirred(c, q, p25, t25) + max(-flow, 0.0)
    mass = p_in * c.volumes_inlet_m3 / (c.gas * s[T_IN])
    gained = supply * (t_supply - s[T_IN]) + mixed * (t25 - s[T_IN])
    d[T_IN] = k * s[T_IN] * slopes[3] / p_in + gained / mass
    d[T_COIL] = (s[T_IN] - s[T_COIL]) / c.supply_coil_lag_s
