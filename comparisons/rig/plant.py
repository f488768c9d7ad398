"""The plant: compressor with lag and branches, its plenums, and the facility around it.

Greitzer's lumped model with what the surge of a high-pressure-ratio compressor in a refrigerated
test cell adds to it:

    dW/dt = (P25 PR − P31) / I,    PR = (1 + ψ'_i U² / (2 c_p T25))^3.5
    ψ'_i = ψ' + k_rev φ² [φ < 0]                       the reverse loss is not lagged
    τ dψ'/dt = q ψ'_stall(φ) + (1 − q) ψ'_unstalled(φ, N_c) − ψ'
    P25 = P_in − loss − I_in dW/dt                     the spike at each flow reversal

with a discharge and an exhaust volume behind two orifices, an inlet volume fed by the
refrigeration plant, and a face volume that reversed gas and in-stall recirculation heat. What
`comparisons.rig.hidden` can hide in τ, ψ'_stall and k_rev acts here too.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, TypeAlias

import numpy as np

from comparisons.rig import plant_kernel as kernel
from comparisons.rig.cases import RigCase
from comparisons.rig.gas import (
    CP_J_KG_K,
    GAMMA,
    GAS_CONSTANT_J_KG_K,
    P_REF_PA,
    T_REF_K,
    corrected_flow_kg_s,
)
from comparisons.rig.hidden import UNTOUCHED, Alteration
from surge_core.errors import InputError
from surge_core.types import FloatArray

PLANT_RATE_HZ = 10_000.0
# Exit flow below which the storage correction of T31 fades; 3 kg/s is phi of about 0.03.
_MIXING_KG_S = 3.0
# The millisecond of a flow reversal, in which dW25/dt jumps, would make gas of any temperature.
_LARGEST_CORRECTION_K = 60.0


# What the plant did, at `PLANT_RATE_HZ`, before any sensor: one array a signal, all SI, named as in
# `comparisons.rig.plant_kernel.OUTPUTS`.
PlantRun: TypeAlias = Mapping[str, FloatArray]


def run_plant(
    case: RigCase, *, n_rows: int, substeps: int = 2, altered: Alteration = UNTOUCHED
) -> PlantRun:
    """Integrate the plant of a case from its near-stall equilibrium.

    The signals have `n_rows` at `PLANT_RATE_HZ`, each of so many Runge-Kutta steps. A case without
    an equilibrium, or one that does not stay finite, is refused.
    """
    constants, start = _equilibrium(case, altered)
    try:
        rows = kernel.integrate(constants, start, n_rows, 1.0 / PLANT_RATE_HZ, substeps)
    except ZeroDivisionError:
        # A pressure or a mass came to nought.
        rows = np.full((1, 1), np.nan)
    if not np.all(np.isfinite(rows)):
        raise InputError(
            f"case {case.name}",
            expected="a plant that stays finite",
            found="one that diverges",
            remedy="change its parameters by a few percent only",
        )
    columns = np.ascontiguousarray(rows.T)
    signals: dict[str, FloatArray] = dict(zip(kernel.OUTPUTS, columns, strict=True))
    return signals | {"T31": _exit_temperature_k(case, signals)}


def _exit_temperature_k(case: RigCase, signals: Mapping[str, FloatArray]) -> FloatArray:
    """Return the gas temperature at plane 31 from the compressor's energy balance (form E1).

    c_p (W25 T2 − W31 T31) = V_c/(γ − 1) dP̄/dt with P̄ = P25 + κ (P31 + I dW25/dt − P25) and T2 the
    temperature that the work ψ makes. Solved for T31 it divides by W31; below 3 kg/s, where the
    gas at the plane mixes with what lies behind it, the correction T31 − T2 fades instead. The
    discharge volume takes T2 itself: over a cycle the storage adds nothing.
    """
    t2 = signals["T25"] + signals["psi"] * case.rotor_velocity_m_s**2 / (2.0 * CP_J_KG_K)
    blading = signals["P31"] + case.inertia_per_m * signals["dW25"]
    mean = signals["P25"] + case.internal_weight * (blading - signals["P25"])
    storage = case.internal_volume_m3 / (GAMMA * GAS_CONSTANT_J_KG_K)
    stored = storage * np.gradient(mean, 1.0 / PLANT_RATE_HZ)
    flow = signals["W31"]
    left = (signals["W25"] - flow) * t2 - stored
    correction = left * flow**3 / (flow**4 + _MIXING_KG_S**4)
    correction = np.clip(correction, -_LARGEST_CORRECTION_K, _LARGEST_CORRECTION_K)
    return np.where(flow > 0.0, signals["T_exit"] + correction, signals["T_exit"])


def _equilibrium(case: RigCase, altered: Alteration) -> tuple[Any, FloatArray]:
    """Return the numbers of the compiled loop, and the state at rest just above stall.

    Flow, orifices and supply are sized by that state. Nothing that can be hidden moves it: it is
    cold, at full speed and unstalled.
    """
    u, t25, face_pa = case.rotor_velocity_m_s, case.supply_temperature_k, case.face_pressure_pa
    phi = case.stall_point(case.corrected_speed_frac)[0] * case.near_stall_phi_ratio
    # C_z = M sqrt(gamma R T / (1 + 0.2 M²)) solved for M.
    speed2 = (phi * u) ** 2 / (GAMMA * GAS_CONSTANT_J_KG_K * t25)
    if not 0.0 < speed2 < 1.0 / 1.2:
        raise InputError(
            f"case {case.name}",
            expected="a subsonic forward flow to start from",
            found=f"φ = {phi:.3f} at U = {u:.0f} m/s",
        )
    mach = np.sqrt(speed2 / (1.0 - 0.2 * speed2))
    corrected = corrected_flow_kg_s(mach, case.inlet_area_m2)
    flow = float(corrected * face_pa / P_REF_PA * np.sqrt(T_REF_K / t25))
    loss = case.inlet_loss_frac * face_pa / flow**2
    psi_p = float(case.unstalled_psi_p(np.asarray(phi), case.corrected_speed_frac))
    if psi_p <= 0.0:
        raise InputError(
            f"case {case.name}",
            expected="a pressure rise at the initial flow",
            found=f"ψ' = {psi_p:.3f} at φ = {phi:.3f}",
        )
    psi, head = psi_p / case.unstalled_efficiency, u**2 / (2.0 * CP_J_KG_K)
    p31, t31 = face_pa * (1.0 + psi_p * head / t25) ** 3.5, t25 + psi * head
    p_ex = case.exhaust_pressure_frac * p31
    start = {"W": flow, "psi_p": psi_p, "psi": psi, "P31": p31, "P_ex": p_ex, "throttle": 1.0}
    start["P_in"] = face_pa + loss * flow**2
    start |= dict.fromkeys(("T31", "T_ex"), t31) | dict.fromkeys(("T_in", "T_face", "T_coil"), t25)
    state = np.array([start.get(name, 0.0) for name in kernel.STATES])
    numbers: dict[str, Any] = {name: getattr(case, name) for name in kernel.CASE_FIELDS}
    numbers |= altered
    numbers |= {
        "reverse_loss": case.reverse_loss * altered["reverse_flow_branch"],
        "loss": loss,
        "supply_flow": flow,
        "supply_pressure": start["P_in"],
        "recirculation_heat": case.recirculation_work * u**2 / (2.0 * CP_J_KG_K),
        "throttle": flow / kernel.orifice_flow(1.0, p31, t31, p_ex, t31)[0],
        "exhaust": flow / kernel.orifice_flow(1.0, p_ex, t31, P_REF_PA, t31)[0],
        "open_ratio": case.open_reference * case.open_ratio,
        "sweep_rate": 2.0 * pi / case.throttle_sweep_s,
        "rotor_velocity": u,
    }
    # The compiled loop takes floats and tuples of floats.
    constants = {
        name: tuple(map(float, value)) if isinstance(value, tuple) else float(value)
        for name, value in numbers.items()
    }
    return kernel.Constants(**constants), state
