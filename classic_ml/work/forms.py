"""ψ from the plane averages: by which form of Eq 13, and where it is known."""

from __future__ import annotations

import numpy as np

from classic_ml.coefficients import PSI_MINIMUM_PHI, psi_is_known, rate_of_change, work_coefficient
from classic_ml.description import TestDescription
from classic_ml.intervals import bridged
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from classic_ml.work.balance import EXIT_WEIGHT, delivered_power, exit_flow_at_inlet, flat_average
from surge_core.types import FloatArray

# ψ_QS moves by a fifth of itself over the flows of a stall; where the two planes' flows disagree by
# half of that, Eq 13 shows their disagreement and not the work.
FLOW_MISMATCH_LIMIT = 0.1
WORK_FORMS = ("auto", "exit-flow", "mass-balance", "temperature-rise")
# What ψ is taken by.
_FORM_WORDS = {
    "exit-flow": "the energy form of Eq 13",
    "mass-balance": "the energy form of Eq 13 with W31 from the mass balance",
    "temperature-rise": "the temperature rise",
}


def with_work(
    record: Record, test: TestDescription, form: str, cell_period_s: float | None
) -> Record:
    """Add ``psi`` by one of ``WORK_FORMS`` to plane averages with W31, φ and dW25/dt.

    It is interpolated across φ < ``PSI_MINIMUM_PHI``, where φ is above it at all; the mass balance
    averages over ``cell_period_s``.
    """
    n, known = record.n_samples, psi_is_known(record["phi"])
    gaps = n - int(np.count_nonzero(known))
    parameters: dict[str, str | int | float | bool] = {
        "minimum_phi": PSI_MINIMUM_PHI,
        "interpolated_rows": gaps,
    }
    if gaps == n:
        why = f"φ stays below {PSI_MINIMUM_PHI}"
        return record.after(
            LedgerEntry(
                "work coefficient", "ψ is not known", parameters, (Dropped("ψ", gaps, why),)
            )
        )
    by_flow = _energy_form(record, test)
    # With T2 = T31 nothing is stored between the planes.
    heat = 2.0 * test.compressor.specific_heat_J_kg_K / test.rotor_velocity_m_s**2
    rise = heat * (record["T31_K"] - record["T25_K"])
    # Half of what lies between the 16th and 84th percentile is a standard deviation that single
    # rows near zero flow do not decide.
    low, high = np.percentile((by_flow - rise)[known], [16.0, 84.0])
    mismatch = 0.5 * float(high - low) / float(np.median(rise[known]))
    parameters["flow_mismatch"] = round(mismatch, 4)
    too_far = mismatch > FLOW_MISMATCH_LIMIT
    if form == "auto":
        # 48 Hz zero phase, 90 % record: rms error of ψ 0.24 by the mass balance and 0.37 by the
        # rise with the lag undone, 0.33 and 0.26 without.
        undone = [e.parameters["invert"] for e in record.history if e.step == "thermocouples"]
        instead = "mass-balance" if undone[-1:] == [True] else "temperature-rise"
        form = instead if too_far else "exit-flow"
    parameters["form"] = form
    words = _FORM_WORDS[form]
    flag = f"the measured W31 and W25 disagree by an equivalent of {mismatch:.0%} in ψ"
    flags = (f"{flag}: it is taken by {words}",) if too_far else ()
    if form == "mass-balance":
        by_flow = _mass_balance(record, test, cell_period_s)
    psi = bridged(rise if form == "temperature-rise" else by_flow, known)
    why = f"φ < {PSI_MINIMUM_PHI}, where ψ is a power over no flow: give them weight 0"
    entry = LedgerEntry(
        "work coefficient",
        f"ψ by {words}, interpolated over {gaps} of {n} rows",
        parameters,
        (Dropped("rows of ψ", gaps, why),) if gaps else (),
        flags,
    )
    return record.after(entry, add=[Channel("psi", psi, "1")])


def _mass_balance(record: Record, test: TestDescription, cell_period_s: float | None) -> FloatArray:
    """ψ by Eq 13 with the mean of both planes' flows and W31 from the mass balance."""

    def smooth(values: FloatArray) -> FloatArray:
        if cell_period_s is None:
            return values
        return flat_average(values, cell_period_s, record.sample_rate_hz)

    flow = 0.5 * (record["W25_kg_s"] + exit_flow_at_inlet(record, test))
    phi = smooth(record["phi"])
    power = delivered_power(record, test, flow, phi, smooth=smooth)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.asarray(smooth(power) / smooth(flow))
    # The averaged flow may be at zero where that of the row is not.
    return bridged(ratio, psi_is_known(phi))


def _energy_form(record: Record, test: TestDescription) -> FloatArray:
    """ψ by Eq 13, W31 as measured."""
    machine = test.compressor
    inlet_Pa = record["P25_Pa"]
    blading_Pa = record["P31_Pa"] + machine.inertia_per_m * record["dW25_dt_kg_s2"]
    mean_Pa = inlet_Pa + EXIT_WEIGHT * (blading_Pa - inlet_Pa)
    rate_Pa_s = rate_of_change(mean_Pa, record.sample_period_s)
    return work_coefficient(
        record["W25_kg_s"],
        record["W31_kg_s"],
        record["T25_K"],
        record["T31_K"],
        machine.internal_volume_m3 / (machine.gamma - 1.0) * rate_Pa_s,
        test.rotor_velocity_m_s,
        machine,
    )
