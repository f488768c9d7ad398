"""The lumped model of the whole system: compressor, plenums, throttle, inlet, supply.

    I dW/dt = P25 PR − P31,    PR = (1 + ψ'_i U²/(2 c_p T25))^(γ/(γ−1))
    P25 = P_in − loss − I_in dW/dt
    ψ'_i = ψ' + k_rev φ² [φ < 0],    τ dψ'/dt + ψ' = q ψ'_QS(φ) + (1 − q) ψ'_unstalled(φ, N_c)
    mass and energy of a discharge, an exhaust and an inlet volume; compressible orifices; the gas
    at the face, heated by reversed flow and by in-stall recirculation

The throttle follows its schedule from the surge start on. Source: the idea is that of the paper's
Reference 6.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from math import exp, sqrt
from typing import Any

import numpy as np
from numba import njit

from classic_ml.description import TestDescription
from classic_ml.flow import T_STANDARD_K
from comparisons.total_system.facility import Facility
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Names and positions in the state vector and, behind it, in an output row.
STATES = ("W25", "psi_p_lagged", "psi", "P31", "T31", "P_in", "T_in", "P_ex", "T_ex", "T_coil",
          "T25")  # fmt: skip
COLUMNS = (*STATES, "P25", "phi", "W31", "W_throttle", "W_exhaust", "W_supply")
N_STATES, N_COLUMNS = len(STATES), len(COLUMNS)
W, PSI_P, PSI, P31, T31, P_IN, T_IN, P_EX, T_EX, T_COIL, T_FACE = range(N_STATES)
P25, PHI, W31, W_THROTTLE, W_EXHAUST, W_SUPPLY = range(N_STATES, N_COLUMNS)
# States that are read off a record; the others follow from the balances.
MEASURED = (W, PSI_P, P31, P_IN, T_FACE)
# Where neither is given; as defaults they would keep numba from its cache.
NO_LATCH, NO_STATES = np.empty((0, 4)), np.empty((0, len(MEASURED)))
# Positions in the latch: branch, armed for the other one, and when and from where the blend runs.
STALLED, ARMED, SINCE, FROM = range(4)

# A linear rise of the pressure from plane 25 to plane 31 puts half of P31 on the stored gas.
_STORAGE_SHARE = 0.5
# The fastest of the model is the loss in reversed flow. Against steps a fifth as long, five a
# millisecond change P31 and W25 by 1e-4 of their swing; half as many miss P25 in the blowdown by a
# third of its swing.
STEPS_PER_SECOND = 5_000.0
# Newton on Eq 3 from below doubles its digits each time; flows here are subsonic.
_NEWTON_STEPS = 12
_LARGEST_SHARE_OF_CHOKE = 0.999

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


@njit(cache=True)
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


@njit(cache=True)
def _orifice(
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


@njit(cache=True)
def _stall_point(c: Any, t25: float) -> tuple[float, float]:
    """Return φ_s and ψ'_s at the corrected speed that T25 leaves of the constant rotor speed."""
    x = (c.speed / sqrt(t25) - c.compressor_stall_speed_low_frac) / (
        c.compressor_stall_speed_high_frac - c.compressor_stall_speed_low_frac
    )
    phi_low, psi_low = c.compressor_stall_phi_low, c.compressor_stall_psi_p_low
    phi = phi_low + x * (c.compressor_stall_phi_high - phi_low)
    return phi, psi_low + x * (c.compressor_stall_psi_p_high - psi_low)


@njit(cache=True)
def _characteristics(c: Any, phi: float, t25: float, q: float) -> tuple[float, float]:
    """Return ψ'_QS and ψ_QS, both branches blended by q; stall never raises the pressure."""
    phi_s, psi_s = _stall_point(c, t25)
    free = psi_s - c.compressor_unstalled_droop * max(phi - phi_s, 0.0) ** 2
    free_work = free / c.compressor_unstalled_efficiency
    stalled = min(c.beta1 + phi * (c.beta2 + phi * c.beta3), free)
    first, second = c.compressor_work_break_1, c.compressor_work_break_2
    work = (
        c.compressor_work_intercept
        + c.compressor_work_slope_1 * min(phi, first)
        + c.compressor_work_slope_2 * min(max(phi - first, 0.0), second - first)
        + c.compressor_work_slope_3 * max(phi - second, 0.0)
    )
    return free + q * (stalled - free), free_work + q * (work - free_work)


@njit(cache=True)
def _throttle(c: Any, time: float) -> float:
    """Return the throttle area over its initial one, which the surge start sets to opening."""
    shut_s = max(min(time, c.start) - c.throttle_close_start_s, 0.0)
    closed = 1.0 - c.throttle_close_rate_per_s * shut_s
    if time <= c.start:
        return float(closed)
    left = exp(-(time - c.start) / c.throttle_open_lag_s)
    return float(c.throttle_open_ratio + (closed - c.throttle_open_ratio) * left)


@njit(cache=True)
def _blend(c: Any, latch: FloatArray, time: float) -> float:
    """Return the share of the stalled branch: an exponential since the last switch."""
    fade = exp(-max(time - latch[SINCE], 0.0) / c.compressor_blend_s)
    return float(latch[STALLED] + (latch[FROM] - latch[STALLED]) * fade)


@njit(cache=True)
def _rates(
    c: Any, time: float, s: FloatArray, latch: FloatArray, d: FloatArray, out: FloatArray
) -> None:
    """Fill in the state's rates and the output row."""
    flow, t25, g = s[W], s[T_FACE], c.gamma
    q = _blend(c, latch, time)
    # Momentum of the inlet duct and of the compressor, one flow through both.
    before = s[P_IN] - c.loss * flow * abs(flow)
    psi_p = s[PSI_P]
    if flow < 0.0:
        # φ before the duct's inertia: with P25 itself the loss would feed back on its own spike.
        psi_p += c.compressor_reverse_loss * _phi(c, flow, before, t25) ** 2
    head = c.velocity**2 / (2.0 * c.heat)
    ratio = max(1.0 + psi_p * head / t25, 0.05) ** (g / (g - 1.0))
    d[W] = (before * ratio - s[P31]) / (c.inertia + c.inlet_inertia_per_m * ratio)
    p25 = before - c.inlet_inertia_per_m * d[W]
    phi = _phi(c, flow, p25, t25)
    quasi_p, quasi_w = _characteristics(c, phi, t25, q)
    d[PSI_P] = (quasi_p - s[PSI_P]) / c.tau
    d[PSI] = (quasi_w - s[PSI]) / c.tau

    # Mass and energy of discharge and exhaust behind two orifices.
    wt, tt = _orifice(c, c.throttle_area * _throttle(c, time), s[P31], s[T31], s[P_EX], s[T_EX])
    t2 = t25 + s[PSI] * head
    stored = c.storage_volume / (c.gas * 0.5 * (t25 + t2))
    gain = g * c.gas / c.discharge_volume
    d[P31] = gain * (flow * t2 - wt * tt) / (1.0 + gain * stored * t2)
    w31 = flow - stored * d[P31]
    if w31 < 0.0:
        # Gas that comes back out of the discharge volume has that volume's temperature.
        d[P31] = gain * (flow * s[T31] - wt * tt) / (1.0 + gain * stored * s[T31])
        w31 = flow - stored * d[P31]
    mass = s[P31] * c.discharge_volume / (c.gas * s[T31])
    d[T31] = s[T31] * (d[P31] / s[P31] - (w31 - wt) / mass)
    we, te = _orifice(
        c, c.exhaust_area, s[P_EX], s[T_EX], c.throttle_ambient_pressure_Pa, c.supply_temperature_K
    )
    d[P_EX] = g * c.gas / c.volumes_exhaust_m3 * (wt * tt - we * te)
    mass = s[P_EX] * c.volumes_exhaust_m3 / (c.gas * s[T_EX])
    d[T_EX] = s[T_EX] * (d[P_EX] / s[P_EX] - (wt - we) / mass)

    # Inlet volume and face: supply, compressor, and what recirculation stirs and heats.
    supply = max(c.supply_flow - c.supply_slope_kg_s_Pa * (s[P_IN] - c.supply_pressure), 0.0)
    cold = c.supply_temperature_K
    t_supply = cold + c.supply_coil_effectiveness * (s[T_COIL] - cold)
    stirred = q * c.heat_recirculation_frac * p25 / (c.gas * t25) * c.velocity * c.area
    mixed = c.heat_recirculation_exchange * stirred
    ahead, back = max(flow, 0.0), max(-flow, 0.0)
    heat = supply * t_supply - ahead * s[T_IN] + back * t25 + mixed * (t25 - s[T_IN])
    d[P_IN] = g * c.gas / c.volumes_inlet_m3 * heat
    mass = s[P_IN] * c.volumes_inlet_m3 / (c.gas * s[T_IN])
    d[T_IN] = s[T_IN] * (d[P_IN] / s[P_IN] - (supply - flow) / mass)
    d[T_COIL] = (s[T_IN] - s[T_COIL]) / c.supply_coil_lag_s
    warming = (
        (ahead + mixed) * (s[T_IN] - t25)
        + back * c.heat_reverse_heat_frac * (s[T31] - t25)
        + stirred * c.recirculation_heat
        + c.volumes_face_m3 / c.heat * d[P_IN]
    )
    d[T_FACE] = warming * c.gas * t25 / (s[P_IN] * c.volumes_face_m3)
    out[:N_STATES] = s
    out[P25], out[PHI], out[W31] = p25, phi, w31
    out[W_THROTTLE], out[W_EXHAUST], out[W_SUPPLY] = wt, we, supply


@njit(cache=True)
def _switch(
    c: Any, latch: FloatArray, t25: float, old: float, new: float, time: float, h: float
) -> None:
    """Move the latch where φ, from ``old`` to ``new`` within ``h``, crosses an edge.

    Into stall below φ_s once φ has been above it, or below φ_rec − Δφ; out of stall above φ_rec
    once φ has been below φ_rec − Δφ.
    """
    phi_s, _ = _stall_point(c, t25)
    low = c.compressor_recovery_phi - c.compressor_rearm_phi
    if latch[STALLED] > 0.5:
        if new < low:
            latch[ARMED] = 1.0
        if latch[ARMED] < 0.5 or new <= c.compressor_recovery_phi:
            return
        edge = c.compressor_recovery_phi
    else:
        if new > phi_s:
            latch[ARMED] = 1.0
            return
        if latch[ARMED] < 0.5 and new >= low:
            return
        edge = phi_s if latch[ARMED] > 0.5 else low
    # Where the line between the two values meets the edge: the switch must not hang on the step.
    back = h * min(max((new - edge) / (new - old), 0.0), 1.0) if new != old else 0.0
    latch[FROM] = _blend(c, latch, time - back)
    latch[SINCE] = time - back
    latch[STALLED], latch[ARMED] = 1.0 - latch[STALLED], 0.0


@njit(cache=True)
def integrate(
    c: Any, start: FloatArray, begin_latch: FloatArray, begin: float,
    n_rows: int, row_s: float, substeps: int,
    forced: FloatArray, measured: FloatArray,
) -> FloatArray:  # fmt: skip
    """Integrate by classical Runge-Kutta and return a row at ``begin`` and each ``row_s`` after it.

    ``forced`` holds a latch for each row, which the branches then follow in place of φ; with no
    rows in it the model switches by itself. ``measured`` holds the states of `MEASURED` for each
    row, put in there: what no probe reads follows from the balances, and forgets its start.
    """
    rows = np.empty((n_rows, N_COLUMNS))
    s, latch, scratch = start.copy(), begin_latch.copy(), np.empty(N_COLUMNS)
    k = np.empty((4, N_STATES))
    h, phi = row_s / substeps, np.nan
    for i in range(n_rows):
        if measured.shape[0] > 0:
            # What the pressures rise beyond their balances warms the gas of their volumes.
            share = (c.gamma - 1.0) / c.gamma
            s[T31] *= (measured[i, 2] / s[P31]) ** share
            s[T_IN] *= (measured[i, 3] / s[P_IN]) ** share
            for j, at in enumerate(MEASURED):
                s[at] = measured[i, j]
        for j in range(substeps):
            time = begin + i * row_s + j * h
            row = rows[i] if j == 0 else scratch
            if i < forced.shape[0] - 1:
                # A switch inside the row is written to the latch of the next one.
                after = time >= forced[i + 1, SINCE] > begin
                latch[:] = forced[i + 1] if after else forced[i]
            _rates(c, time, s, latch, k[0], row)
            if forced.shape[0] == 0 and not np.isnan(phi):
                _switch(c, latch, s[T_FACE], phi, row[PHI], time, h)
            phi = row[PHI]
            for n, part in ((1, 0.5), (2, 0.5), (3, 1.0)):
                ahead = s + part * h * k[n - 1]
                _rates(c, time + part * h, ahead, latch, k[n], scratch)
            s += h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
    return rows


@njit(cache=True)
def latches_of(c: Any, phi: FloatArray, t25: FloatArray, first: float, row_s: float) -> FloatArray:
    """Return the latch of each row of a measured φ, in stall from the surge start on."""
    out = np.empty((phi.size, 4))
    latch = np.array([0.0, 0.0, first, 0.0])
    begun = False
    for i in range(phi.size):
        time = first + i * row_s
        if begun:
            _switch(c, latch, t25[i], phi[i - 1], phi[i], time, row_s)
        elif time >= c.start:
            begun = True
            latch[STALLED], latch[SINCE] = 1.0, c.start
        out[i] = latch
    return out


@dataclass(frozen=True)
class TotalSystemModel:
    """Compressor and facility with numbers in them.

    Parameters
    ----------
    test : TestDescription
        Machine, speed, areas, near-stall reading.
    facility : Facility
        All that stands around the compressor.
    near_stall_flow_kg_s : float
        Flow of the near-stall reading, which sizes throttle, exhaust and supply.
    beta : tuple of float
        β₁, β₂, β₃ of ψ'_QS = β₁ + β₂ φ + β₃ φ² in stall.
    tau_s : float
        Time constant of ψ' and ψ, in seconds.
    start_s : float
        Surge start: when the first stall begins, on the clock of the record; infinite for none.
    volume_factor : float
        Multiplies the discharge volume.
    """

    test: TestDescription
    facility: Facility
    near_stall_flow_kg_s: float
    beta: tuple[float, float, float]
    tau_s: float
    start_s: float = np.inf
    volume_factor: float = 1.0

    def near_stall_state(self) -> FloatArray:
        """Return the state of the near-stall reading, of shape (11,), in the order of `STATES`."""
        near, machine = self.test.near_stall, self.test.compressor
        work = 2.0 * machine.specific_heat_J_kg_K / self.test.rotor_velocity_m_s**2
        rise = (near.P31_Pa / near.P25_Pa) ** ((machine.gamma - 1.0) / machine.gamma) - 1.0
        state = {"W25": self.near_stall_flow_kg_s, "P31": near.P31_Pa}
        state["psi_p_lagged"] = work * near.T25_K * rise
        state["psi"] = work * (near.T31_K - near.T25_K)
        state["P_in"] = near.P25_Pa * (1.0 + self.facility.inlet.loss_frac)
        state["P_ex"] = self.facility.throttle.exhaust_pressure_frac * near.P31_Pa
        state |= dict.fromkeys(("T25", "T_in", "T_coil"), near.T25_K)
        state |= dict.fromkeys(("T31", "T_ex"), near.T31_K)
        return np.array([state[name] for name in STATES])

    def constants(self) -> Any:
        """Return the numbers of the compiled loops, orifices sized by the near-stall reading.

        Raises
        ------
        InputError
            When the exhaust would be below the ambient pressure.
        """
        test, f, near = self.test, self.facility, self.test.near_stall
        machine, flow = test.compressor, self.near_stall_flow_kg_s
        g, velocity = machine.gamma, test.rotor_velocity_m_s
        middle = f.throttle.exhaust_pressure_frac * near.P31_Pa
        ambient = f.throttle.ambient_pressure_Pa
        if not middle > ambient:
            raise InputError(
                "[throttle] exhaust_pressure_frac",
                expected=f"an exhaust pressure above ambient near stall, {ambient:g} Pa",
                found=f"{middle:g} Pa",
            )
        loss = f.inlet.loss_frac * near.P25_Pa / flow**2
        stirring = f.heat.recirculation_work * velocity**2 / (2.0 * machine.specific_heat_J_kg_K)
        known = [float(value) for table in f.model_dump().values() for value in table.values()]
        c = Constants(
            **dict(zip(FACILITY_FIELDS, known, strict=True)),
            **dict(zip(("beta1", "beta2", "beta3"), self.beta, strict=True)),
            tau=self.tau_s,
            inertia=machine.inertia_per_m,
            storage_volume=_STORAGE_SHARE * machine.internal_volume_m3,
            discharge_volume=self.volume_factor * f.volumes.discharge_m3,
            loss=loss,
            supply_flow=flow,
            supply_pressure=near.P25_Pa + loss * flow**2,
            recirculation_heat=stirring,
            throttle_area=1.0,
            exhaust_area=1.0,
            start=self.start_s,
            speed=test.rotor_speed_rpm * np.sqrt(T_STANDARD_K) / test.design_corrected_speed_rpm,
            velocity=velocity,
            area=test.areas_m2[25],
            flow_constant=test.areas_m2[25] * np.sqrt(g / machine.gas_constant_J_kg_K),
            choke=(2.0 / (g + 1.0)) ** ((g + 1.0) / (2.0 * (g - 1.0))),
            gamma=g,
            gas=machine.gas_constant_J_kg_K,
            heat=machine.specific_heat_J_kg_K,
        )
        through, _ = _orifice(c, 1.0, near.P31_Pa, near.T31_K, middle, near.T31_K)
        out, _ = _orifice(c, 1.0, middle, near.T31_K, ambient, near.T31_K)
        return c._replace(
            throttle_area=f.throttle.area_factor * flow / through, exhaust_area=flow / out
        )

    def simulate(
        self, *, n_rows: int, period_s: float, state: FloatArray | None = None
    ) -> dict[str, FloatArray]:
        """Run the model from its surge start, or at rest without one.

        Parameters
        ----------
        n_rows : int
            Rows wanted; the first is the surge start.
        period_s : float
            Distance of rows.
        state : ndarray of shape (11,), optional
            State to start from; the near-stall reading without it.

        Returns
        -------
        dict of str to ndarray of shape (n_rows,)
            The columns of `COLUMNS`: pressures in Pa, temperatures in K, flows in kg/s.
        """
        surging = bool(np.isfinite(self.start_s))
        begin = self.start_s if surging else 0.0
        # Branch, armed, when it was switched to, and the blend it was switched from.
        latch = np.array([float(surging), 0.0, begin, 0.0])
        first = self.near_stall_state() if state is None else state
        steps = max(1, round(period_s * STEPS_PER_SECOND))
        own = self.constants(), first, latch, begin, n_rows, period_s, steps
        rows = integrate(*own, NO_LATCH, NO_STATES)
        return {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(COLUMNS)}
