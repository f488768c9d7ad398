"""Flow, pressure and work coefficients from the plane averages (Eq 5, 7 and 13)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from classic_ml.columns.computed import is_computed
from classic_ml.columns.elementary import powers
from classic_ml.columns.order_statistics import lowest
from classic_ml.columns.workspace import blocks
from classic_ml.flow import T_STANDARD_K, mach_from_corrected_flow
from classic_ml.rates import rate_in
from classic_ml.readers.test_description import Compressor, TestDescription
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from classic_ml.work.forms import (
    PSI_MINIMUM_PHI,
    WORK_FORMS,
    psi_is_known,
    with_work,
    work_coefficient,
)
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "PSI_MINIMUM_PHI",
    "WORK_FORMS",
    "coefficients",
    "corrected_speed_fraction",
    "flow_coefficient",
    "pressure_coefficient",
    "psi_is_known",
    "rate_of_change",
    "work_coefficient",
]


def rate_of_change(values: FloatArray, sample_period_s: float) -> FloatArray:
    """Return the central difference, which delays nothing."""
    return np.asarray(np.gradient(values, sample_period_s))


def flow_coefficient(
    corrected_kg_s: FloatArray,
    temperature_K: FloatArray,
    area_m2: float,
    rotor_velocity_m_s: float,
    compressor: Compressor,
) -> FloatArray:
    """Return φ = C_z/U from corrected flow and total temperature (Eq 7).

    Parameters
    ----------
    corrected_kg_s : ndarray of shape (n,)
        Signed corrected flow at plane 25.
    temperature_K : ndarray of shape (n,)
        Total temperature there.
    area_m2 : float
        Flow area there.
    rotor_velocity_m_s : float
        Mean rotor velocity U, from the physical speed.
    compressor : Compressor
        For γ and R.

    Returns
    -------
    ndarray of shape (n,)
        M √(γ R T_s)/U with M from the inverse of Eq 3 and T_s = T/(1 + (γ−1)/2 M²).
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
    """Return the instantaneous pressure coefficient ψ' (Eq 5).

    Parameters
    ----------
    inlet_Pa, exit_Pa : ndarray of shape (n,)
        Total pressures P25 and P31.
    inlet_K : ndarray of shape (n,)
        Total temperature T25.
    flow_rate_kg_s2 : ndarray of shape (n,)
        dW25/dt of the physical flow.
    inertia_per_m : float
        I = ∫dx/A between the planes.
    rotor_velocity_m_s : float
        U.
    compressor : Compressor
        For γ and R.

    Returns
    -------
    ndarray of shape (n,)
        ψ' = (2 c_p T25/U²) [((P31 + I dW25/dt)/P25)^((γ−1)/γ) − 1].

    Raises
    ------
    InputError
        When P31 + I dW25/dt is not positive.
    """
    gamma = compressor.gamma
    blading_Pa = exit_Pa + inertia_per_m * flow_rate_kg_s2
    if np.min(blading_Pa) <= 0.0:
        raise _no_pressure(*lowest(blading_Pa))
    rise = powers(blading_Pa / inlet_Pa, (gamma - 1.0) / gamma) - 1.0
    scale = 2.0 * compressor.specific_heat_J_kg_K * inlet_K / rotor_velocity_m_s**2
    return np.asarray(scale * rise)


def _no_pressure(blading_Pa: float, row: int) -> InputError:
    return InputError(
        "ψ'",
        expected="P31 + I·dW25/dt above zero",
        found=f"{blading_Pa:g} Pa in row {row + 1}",
        remedy="check inertia_per_m, or filter the pressures",
    )


def corrected_speed_fraction(temperature_K: FloatArray, test: TestDescription) -> FloatArray:
    """Return N_c = N/√θ as a fraction of the design corrected speed."""
    corrected = test.rotor_speed_rpm / np.sqrt(temperature_K / T_STANDARD_K)
    return np.asarray(corrected / test.design_corrected_speed_rpm)


def coefficients(
    record: Record,
    test: TestDescription,
    *,
    inertia_factor: float = 1.0,
    work_form: str = "auto",
    cell_period_s: float | None = None,
    wanted: Collection[str] | None = None,
    stored: Collection[str] = (),
) -> Record:
    """Compute φ, ψ' and, where W31 is known, ψ.

    Parameters
    ----------
    record : Record
        Plane averages.
    test : TestDescription
        Machine and speed.
    inertia_factor : float
        Multiplies ∫dx/A; 0 drops the inertia term of Eq 5.
    work_form : {"auto", "exit-flow", "mass-balance", "temperature-rise"}
        ψ by the energy form of Eq 13, which takes W31 as measured; the same with W31 from W25 and
        the mass balance of the gas between the planes; from the temperature rise alone, as if
        nothing were stored there; or the first, unless the flows of the two planes disagree by
        more than ψ can bear: then the second where the lag of the thermocouples was undone, and
        else the third, whose error that lag halves.
    cell_period_s : float, optional
        Stall-cell period, where the record holds unfiltered pressures: flows and powers of the
        mass balance are averaged over it before they are divided.
    wanted : collection of str, optional
        Which of φ, ψ' and N_c are kept; without it all of them, and what follows from the averages.
    stored : collection of str
        Plane averages that are put away while they are at hand, where they are columns that are
        computed each time that they are asked for.

    Returns
    -------
    Record
        With ``phi``, ``psi_p``, ``pressure_ratio``, ``Nc_frac`` and, where plane 31 has a flow,
        ``psi``, which is interpolated across φ < ``PSI_MINIMUM_PHI``.

    Raises
    ------
    InputError
        When the flow is more than the area passes, or P31 + I dW25/dt is not positive.
    """
    speed = test.rotor_velocity_m_s
    inertia = inertia_factor * test.compressor.inertia_per_m
    units = {"phi": "1", "psi_p": "1", "Nc_frac": "1"}
    kept = [name for name in units if wanted is None or name in wanted]
    columns = {name: record.workspace.writer(record.n_samples) for name in kept}
    put_away = {
        name: record.workspace.writer(record.n_samples)
        for name in stored
        if is_computed(record[name])
    }
    # Least and largest of φ and ψ', for the ledger.
    ranges = {"phi": (np.inf, -np.inf), "psi_p": (np.inf, -np.inf)}
    for rows in blocks(record.n_samples):
        try:
            found = _block(record, test, inertia, rows)
        except InputError:
            _refuse_worst(record, test, inertia)
            raise
        for name, column in columns.items():
            column.append(found[name])
        for name, column in put_away.items():
            column.append(record[name][rows])
        for name, (low, high) in ranges.items():
            ranges[name] = min(low, found[name].min()), max(high, found[name].max())
        record.workspace.release()
    entry = LedgerEntry(
        "coefficients",
        "φ (Eq 7) from {:.3f} to {:.3f}, ".format(*ranges["phi"])
        + "ψ' (Eq 5) from {:.2f} to {:.2f}".format(*ranges["psi_p"]),
        {"inertia_per_m": inertia, "U_m_s": round(speed, 3), "inertia_factor": inertia_factor},
    )
    added = [Channel(name, column.finished(), units[name]) for name, column in columns.items()]
    added += [replace(record.channel(n), values=c.finished()) for n, c in put_away.items()]
    record = record.after(entry, add=added)
    if wanted is None:
        record = replace(record, channels={**record.channels, **_derived(record)})
    if "W31_kg_s" not in record:
        why = "no T31 that counts, so no W31"
        return record.after(
            LedgerEntry(
                "work coefficient", "ψ is not known", {}, (Dropped("ψ", record.n_samples, why),)
            )
        )
    return with_work(record, test, inertia, work_form, cell_period_s)


def _block(
    record: Record, test: TestDescription, inertia: float, rows: slice
) -> dict[str, FloatArray]:
    """Return the new channels in some rows."""
    machine, speed = test.compressor, test.rotor_velocity_m_s
    inlet_Pa, exit_Pa = record["P25_Pa"][rows], record["P31_Pa"][rows]
    inlet_K, corrected = record["T25_K"][rows], record["Wc25_kg_s"][rows]
    flow_rate = rate_in(record["W25_kg_s"], rows, record.sample_period_s)
    return {
        "phi": flow_coefficient(corrected, inlet_K, test.areas_m2[25], speed, machine),
        "psi_p": pressure_coefficient(
            inlet_Pa, exit_Pa, inlet_K, flow_rate, inertia, speed, machine
        ),
        "Nc_frac": corrected_speed_fraction(inlet_K, test),
    }


def _derived(record: Record) -> dict[str, Channel]:
    """Return what follows from averages at once and is looked at by few."""
    place, n_rows, period_s = record.workspace, record.n_samples, record.sample_period_s
    inlet_Pa, exit_Pa, flow = record["P25_Pa"], record["P31_Pa"], record["W25_kg_s"]
    ratio = place.derived(n_rows, lambda rows: exit_Pa[rows] / inlet_Pa[rows])
    rate = place.derived(n_rows, lambda rows: rate_in(flow, rows, period_s))
    channels = Channel("pressure_ratio", ratio, "1"), Channel("dW25_dt_kg_s2", rate, "kg/s2")
    return {channel.name: channel for channel in channels}


def _refuse_worst(record: Record, test: TestDescription, inertia: float) -> None:
    """Raise with the worst row of the whole record what one block of it was refused for."""

    def blading_Pa() -> Iterator[FloatArray]:
        for rows in blocks(record.n_samples):
            rate = rate_in(record["W25_kg_s"], rows, record.sample_period_s)
            yield record["P31_Pa"][rows] + inertia * rate

    def flows() -> Iterator[FloatArray]:
        return (-np.abs(record["Wc25_kg_s"][rows]) for rows in blocks(record.n_samples))

    most = np.array([-lowest(flows, workspace=record.workspace)[0]])
    try:
        mach_from_corrected_flow(most, test.areas_m2[25], test.compressor)
    except InputError as error:
        raise InputError(
            f"{record.source}: {error.where} at plane 25",
            expected=error.expected,
            found=error.found,
            remedy=f"check area_m2 of [planes.25] in {test.source}, and the calibration of the "
            "probes",
        ) from error
    least_Pa, row = lowest(blading_Pa, workspace=record.workspace)
    if least_Pa <= 0.0:
        raise _no_pressure(least_Pa, row)
