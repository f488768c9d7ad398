"""Flow, pressure and work coefficients from the plane averages (Eq 5, 7 and 13)."""

from __future__ import annotations

import numpy as np

from classic_ml.description import Compressor, TestDescription
from classic_ml.flow import T_STANDARD_K, mach_from_corrected_flow
from classic_ml.intervals import bridged
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray

# ψ is a power over W25. On the 98.5 % record its 5 to 95 % range in stall is -7 to 9 for
# |φ| >= 0.03, and 1.2 to 5 for φ >= 0.05; in reversed flow T25 is the temperature of the exit's gas
# and ψ has no meaning.
PSI_MINIMUM_PHI = 0.05
# One row in a hundred is noise; more is a wrong inertia or unit.
IMPOSSIBLE_SHARE = 0.01


def flow_coefficient(
    corrected_kg_s: FloatArray,
    temperature_K: FloatArray,
    area_m2: float,
    rotor_velocity_m_s: float,
    compressor: Compressor,
) -> FloatArray:
    """Return φ = C_z/U from signed corrected flow and total temperature at plane 25 (Eq 7).

    M √(γ R T_s)/U with M from the inverse of Eq 3, T_s = T/(1 + (γ−1)/2 M²), and U the mean rotor
    velocity from the physical speed.
    """
    gamma = compressor.gamma
    mach = mach_from_corrected_flow(corrected_kg_s, area_m2, compressor)
    static_K = temperature_K / (1.0 + 0.5 * (gamma - 1.0) * mach**2)
    sound_m_s = np.sqrt(gamma * compressor.gas_constant_J_kg_K * static_K)
    return np.asarray(mach * sound_m_s / rotor_velocity_m_s)


def pressure_coefficient(
    inlet_Pa: FloatArray,
    exit_Pa: FloatArray,
    inlet_K: FloatArray,
    flow_rate_kg_s2: FloatArray,
    inertia_per_m: float,
    rotor_velocity_m_s: float,
    compressor: Compressor,
) -> FloatArray:
    """Return the instantaneous pressure coefficient ψ' from total P25, P31 and T25 (Eq 5).

    ψ' = (2 c_p T25/U²) [((P31 + I dW25/dt)/P25)^((γ−1)/γ) − 1], dW25/dt of the physical flow and
    I = ∫dx/A between the planes; refused where P31 + I dW25/dt is not positive.
    """
    gamma = compressor.gamma
    blading_Pa = exit_Pa + inertia_per_m * flow_rate_kg_s2
    row = int(np.argmin(blading_Pa))
    if blading_Pa[row] <= 0.0:
        raise InputError(
            "ψ'",
            expected="P31 + I·dW25/dt above zero",
            found=f"{blading_Pa[row]:g} Pa in row {row + 1}",
            remedy="check inertia_per_m, or filter the pressures",
        )
    rise = (blading_Pa / inlet_Pa) ** ((gamma - 1.0) / gamma) - 1.0
    scale = 2.0 * compressor.specific_heat_J_kg_K * inlet_K / rotor_velocity_m_s**2
    return np.asarray(scale * rise)


def work_coefficient(
    inlet_kg_s: FloatArray,
    exit_kg_s: FloatArray,
    inlet_K: FloatArray,
    exit_K: FloatArray,
    storage_W: FloatArray,
    rotor_velocity_m_s: float,
    compressor: Compressor,
) -> FloatArray:
    """Return the instantaneous work coefficient ψ (energy form of Eq 13); infinite at W25 = 0.

    ψ = (2 c_p T25/U²)(T2/T25 − 1), c_p W25 T2 = c_p W31 T31 + V_c/(γ−1) dP̄/dt: the last is
    ``storage_W``, the power that goes into the internal volume.
    """
    heat = compressor.specific_heat_J_kg_K
    with np.errstate(divide="ignore", invalid="ignore"):
        delivered_K = (exit_kg_s * exit_K + storage_W / heat) / inlet_kg_s
    return np.asarray(2.0 * heat / rotor_velocity_m_s**2 * (delivered_K - inlet_K))


def psi_is_known(phi: FloatArray) -> BoolArray:
    """Return the rows where ψ was computed rather than interpolated: φ ≥ ``PSI_MINIMUM_PHI``."""
    return np.asarray(phi >= PSI_MINIMUM_PHI)


def corrected_speed_fraction(temperature_K: FloatArray, test: TestDescription) -> FloatArray:
    """Return N_c = N/√θ as a fraction of the design corrected speed."""
    corrected = test.rotor_speed_rpm / np.sqrt(temperature_K / T_STANDARD_K)
    return np.asarray(corrected / test.design_corrected_speed_rpm)


def coefficients(record: Record, test: TestDescription) -> Record:
    """Add ``phi``, ``psi_p``, ``Nc_frac``, ``pressure_ratio`` and ``dW25_dt_kg_s2`` to averages.

    Refused where the flow is more than the area passes, or P31 + I dW25/dt is not positive.
    """
    machine, speed = test.compressor, test.rotor_velocity_m_s
    inertia = machine.inertia_per_m
    inlet_Pa, exit_Pa, inlet_K = record["P25_Pa"], record["P31_Pa"], record["T25_K"]
    # A central difference delays nothing.
    flow_rate = np.gradient(record["W25_kg_s"], record.sample_period_s)
    phi = flow_coefficient(record["Wc25_kg_s"], inlet_K, test.areas_m2[25], speed, machine)
    # A single row in which noise makes the flow change faster than the air could is left out.
    possible = exit_Pa + inertia * flow_rate > 0.0
    flags: tuple[str, ...] = ()
    n_bad = possible.size - int(np.count_nonzero(possible))
    if 0 < n_bad <= IMPOSSIBLE_SHARE * possible.size:
        flow_rate = bridged(flow_rate, possible)
        flags = (f"{n_bad} rows in which dW25/dt leaves no pressure, bridged",)
    psi_p = pressure_coefficient(inlet_Pa, exit_Pa, inlet_K, flow_rate, inertia, speed, machine)
    entry = LedgerEntry(
        "coefficients",
        f"φ (Eq 7) from {phi.min():.3f} to {phi.max():.3f}, "
        f"ψ' (Eq 5) from {psi_p.min():.2f} to {psi_p.max():.2f}",
        {"inertia_per_m": inertia, "U_m_s": round(speed, 3)},
        flags=flags,
    )
    added = {
        "phi": (phi, "1"),
        "psi_p": (psi_p, "1"),
        "Nc_frac": (corrected_speed_fraction(inlet_K, test), "1"),
        "pressure_ratio": (exit_Pa / inlet_Pa, "1"),
        "dW25_dt_kg_s2": (flow_rate, "kg/s2"),
    }
    return record.after(entry, add=[Channel(n, v, u) for n, (v, u) in added.items()])
