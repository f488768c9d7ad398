"""Flow, pressure and work coefficients from the plane averages (Eq 5, 7 and 13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.airflow import T_STANDARD_K, mach_from_corrected_flow
from classic_ml.errors import InputError
from classic_ml.readers.test_description import Compressor, TestDescription
from classic_ml.records import Channel, Dropped, FloatArray, LedgerEntry, Record
from classic_ml.work_balance import EXIT_WEIGHT, delivered_power, exit_flow_at_inlet, flat_average

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

# ψ is a power over W25. On the 98.5 % record its 5 to 95 % range in stall is -7 to 9 for
# |φ| >= 0.03, and 1.2 to 5 for φ >= 0.05; in reversed flow T25 is the temperature of the exit's gas
# and ψ has no meaning.
PSI_MINIMUM_PHI = 0.05
# ψ_QS moves by a fifth of itself over the flows of a stall; where the two planes' flows disagree by
# half of that, Eq 13 shows their disagreement and not the work.
FLOW_MISMATCH_LIMIT = 0.1
WORK_FORMS = ("auto", "exit-flow", "mass-balance", "temperature-rise")
_FORM_WORDS = {
    "exit-flow": "the energy form of Eq 13",
    "mass-balance": "the energy form of Eq 13 with W31 from the mass balance",
    "temperature-rise": "the temperature rise",
}
_INSTEAD = {
    "exit-flow": "ψ by Eq 13 shows their disagreement more than the work",
    "mass-balance": "ψ takes the mean of both for W25, and W31 from it and dP31/dt",
    "temperature-rise": "ψ is taken from the temperature rise alone, which leaves out what is "
    "stored between the planes",
}


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
        raise InputError(
            "ψ'",
            expected="P31 + I·dW25/dt above zero",
            found=f"{np.min(blading_Pa):g} Pa in row {int(np.argmin(blading_Pa)) + 1}",
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

    Parameters
    ----------
    inlet_kg_s, exit_kg_s : ndarray of shape (n,)
        Physical flows W25 and W31.
    inlet_K, exit_K : ndarray of shape (n,)
        Total temperatures T25 and T31.
    storage_W : ndarray of shape (n,)
        V_c/(γ−1) dP̄/dt: the power that goes into the internal volume.
    rotor_velocity_m_s : float
        U.
    compressor : Compressor
        For c_p.

    Returns
    -------
    ndarray of shape (n,)
        ψ = (2 c_p T25/U²)(T2/T25 − 1), c_p W25 T2 = c_p W31 T31 + V_c/(γ−1) dP̄/dt.
    """
    heat = compressor.specific_heat_J_kg_K
    with np.errstate(divide="ignore", invalid="ignore"):
        delivered_K = (exit_kg_s * exit_K + storage_W / heat) / inlet_kg_s
    return np.asarray(2.0 * heat / rotor_velocity_m_s**2 * (delivered_K - inlet_K))


def psi_is_known(phi: FloatArray) -> NDArray[np.bool_]:
    """Return the rows where ψ was computed rather than interpolated: φ ≥ ``PSI_MINIMUM_PHI``."""
    return np.asarray(phi >= PSI_MINIMUM_PHI)


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

    Returns
    -------
    Record
        With ``phi``, ``psi_p``, ``pressure_ratio``, ``Nc_frac`` and, where plane 31 has a flow,
        ``psi``, which is interpolated across φ < ``PSI_MINIMUM_PHI``.
    """
    machine, speed = test.compressor, test.rotor_velocity_m_s
    inlet_Pa, exit_Pa, inlet_K = record["P25_Pa"], record["P31_Pa"], record["T25_K"]
    inertia = inertia_factor * machine.inertia_per_m
    flow_rate = rate_of_change(record["W25_kg_s"], record.sample_period_s)
    phi = flow_coefficient(record["Wc25_kg_s"], inlet_K, test.areas_m2[25], speed, machine)
    psi_p = pressure_coefficient(inlet_Pa, exit_Pa, inlet_K, flow_rate, inertia, speed, machine)
    added = [
        Channel("phi", phi, "1"),
        Channel("psi_p", psi_p, "1"),
        Channel("pressure_ratio", exit_Pa / inlet_Pa, "1"),
        Channel("Nc_frac", corrected_speed_fraction(inlet_K, test), "1"),
        Channel("dW25_dt_kg_s2", flow_rate, "kg/s2"),
    ]
    entry = LedgerEntry(
        "coefficients",
        f"φ (Eq 7) from {phi.min():.3f} to {phi.max():.3f}, ψ' (Eq 5) from {psi_p.min():.2f} to "
        f"{psi_p.max():.2f}",
        {"inertia_per_m": inertia, "U_m_s": round(speed, 3), "inertia_factor": inertia_factor},
    )
    record = record.after(entry, add=added)
    if "W31_kg_s" not in record:
        why = "no T31 that counts, so no W31"
        return record.after(
            LedgerEntry("work coefficient", "ψ is not known", {}, (Dropped("ψ", phi.size, why),))
        )
    return _with_work(record, test, inertia, work_form, cell_period_s)


def _with_work(
    record: Record,
    test: TestDescription,
    inertia: float,
    form: str,
    cell_period_s: float | None,
) -> Record:
    known = psi_is_known(record["phi"])
    gaps = int(np.count_nonzero(~known))
    parameters: dict[str, str | int | float | bool] = {
        "minimum_phi": PSI_MINIMUM_PHI,
        "interpolated_rows": gaps,
    }
    if not known.any():
        why = f"φ stays below {PSI_MINIMUM_PHI}"
        return record.after(
            LedgerEntry(
                "work coefficient", "ψ is not known", parameters, (Dropped("ψ", gaps, why),)
            )
        )
    by_flow, by_rise = _energy_form(record, test, inertia), _temperature_rise(record, test)
    # Half of what lies between the 16th and 84th percentile is a standard deviation that single
    # rows near zero flow do not decide.
    low, high = np.percentile((by_flow - by_rise)[known], [16.0, 84.0])
    mismatch = 0.5 * float(high - low) / float(np.median(by_rise[known]))
    parameters["flow_mismatch"] = round(mismatch, 4)
    too_far = mismatch > FLOW_MISMATCH_LIMIT
    if form == "auto":
        # 48 Hz zero phase, 90 % record: rms error of ψ 0.24 by the mass balance and 0.37 by the
        # rise with the lag undone, 0.33 and 0.26 without.
        instead = "mass-balance" if _lag_undone(record) else "temperature-rise"
        form = instead if too_far else "exit-flow"
    parameters["form"] = form
    flags: tuple[str, ...] = ()
    if too_far:
        flags = (
            f"the measured W31 and W25 disagree by an equivalent of {100.0 * mismatch:.0f} % in ψ: "
            + _INSTEAD[form],
        )
    by_form = {"exit-flow": by_flow, "temperature-rise": by_rise}
    psi = by_form[form] if form in by_form else _mass_balance(record, test, inertia, cell_period_s)
    entry = LedgerEntry(
        "work coefficient",
        f"ψ by {_FORM_WORDS[form]}, interpolated over {gaps} of {known.size} rows",
        parameters,
        (
            Dropped(
                "rows of ψ",
                gaps,
                f"φ < {PSI_MINIMUM_PHI}, where ψ is a power over no flow: give them weight 0",
            ),
        )
        if gaps
        else (),
        flags,
    )
    return record.after(entry, add=[Channel("psi", _bridge(psi, known), "1")])


def _temperature_rise(record: Record, test: TestDescription) -> FloatArray:
    """ψ with T2 = T31 (nothing stored between the planes)."""
    rise_K = record["T31_K"] - record["T25_K"]
    heat = test.compressor.specific_heat_J_kg_K
    return np.asarray(2.0 * heat / test.rotor_velocity_m_s**2 * rise_K)


def _lag_undone(record: Record) -> bool:
    said = [e.parameters.get("invert") for e in record.history if e.step == "thermocouples"]
    return bool(said) and said[-1] is True


def _mass_balance(
    record: Record, test: TestDescription, inertia: float, cell_period_s: float | None
) -> FloatArray:
    """ψ by Eq 13 with the mean of both planes' flows and W31 from the mass balance."""

    def smooth(values: FloatArray) -> FloatArray:
        if cell_period_s is None:
            return values
        return flat_average(values, cell_period_s, record.sample_rate_hz)

    flow = 0.5 * (record["W25_kg_s"] + exit_flow_at_inlet(record, test))
    power = delivered_power(
        record, test, flow, smooth(record["phi"]), inertia_per_m=inertia, smooth=smooth
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        psi = np.asarray(smooth(power) / smooth(flow))
    # The averaged flow may be at zero where that of the row is not.
    return _bridge(psi, psi_is_known(smooth(record["phi"])))


def _energy_form(record: Record, test: TestDescription, inertia: float) -> FloatArray:
    """ψ by Eq 13, W31 as measured."""
    machine = test.compressor
    blading_Pa = record["P31_Pa"] + inertia * record["dW25_dt_kg_s2"]
    mean_Pa = record["P25_Pa"] + EXIT_WEIGHT * (blading_Pa - record["P25_Pa"])
    storage_W = (
        machine.internal_volume_m3
        / (machine.gamma - 1.0)
        * rate_of_change(mean_Pa, record.sample_period_s)
    )
    return work_coefficient(
        record["W25_kg_s"],
        record["W31_kg_s"],
        record["T25_K"],
        record["T31_K"],
        storage_W,
        test.rotor_velocity_m_s,
        machine,
    )


def _bridge(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    rows = np.arange(values.size)
    return np.asarray(np.interp(rows, rows[known], values[known]))
