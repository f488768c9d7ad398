"""ψ from the plane averages: by which form of Eq 13, and where it is known.

Where the measured W31 is too poor, the work of the blading comes from one mass balance. Eq 13
divides a difference of two energy fluxes by W25. At 90 % speed the two measured flows
disagree by several kg/s in the stall cells, and T31 times that swamps ψ. Here W31 enters only as a
second reading of the same flow: what the gas between the planes stores follows from P31.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from classic_ml.coefficients import PSI_MINIMUM_PHI, psi_is_known, work_coefficient
from classic_ml.description import TestDescription
from classic_ml.filters import period_average
from classic_ml.flow import choked_flow, corrected_from_physical, physical_flow
from classic_ml.intervals import bridged
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from surge_core.types import BoolArray, FloatArray

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
    rate_Pa_s = np.gradient(mean_Pa, record.sample_period_s)
    return work_coefficient(
        record["W25_kg_s"],
        record["W31_kg_s"],
        record["T25_K"],
        record["T31_K"],
        machine.internal_volume_m3 / (machine.gamma - 1.0) * rate_Pa_s,
        test.rotor_velocity_m_s,
        machine,
    )


# Weight κ of the exit in the mean pressure of the internal volume: a linear rise from 25 to 31.
EXIT_WEIGHT = 0.5
# Flow below which T31 no longer says what left the blading. One plane's flow is known to 1.5 kg/s
# at an instant (root of half the variance of W25 − W31 − storage, 90 % record), so that below twice
# that, 3 kg/s or φ of 0.035, it is not sure which way the gas at plane 31 moves. The simulated rig
# mixes the gas there below 3 kg/s too; a machine that does not would want 0. On the rig 0.01 less
# or more moves the fitted curve by 0.1 at φ = 0.05, by 0.02 at 0.02 and 0.1, and τ by 2.5 ms.
MIXING_PHI = 0.035
# T̄ of the internal volume needs the T2 that it helps to find; a third pass moves T2 by 0.03 K.
PASSES = 2
# Storage moves T2 by up to 40 K of 640 in the rows that are scored; beyond three times that share
# it is noise over little flow.
LARGEST_SHARE = 0.2


def flat_average(values: FloatArray, period_s: float, sample_rate_hz: float) -> FloatArray:
    """Average over one period twice such that slow signals keep their curvature.

    2A − A² of the signal, A the centred average over the period (Tukey's twicing): the nulls of A
    at 1/period and its harmonics, but an error of fourth and not second order at rest.
    """
    once = period_average(values, period_s, sample_rate_hz)
    return np.asarray(2.0 * once - period_average(once, period_s, sample_rate_hz))


def exit_flow_at_inlet(
    record: Record, test: TestDescription, exit_K: FloatArray | None = None
) -> FloatArray:
    """Return W25 as plane 31 shows it, by the mass balance of what lies between.

    T31 is the record's, or ``exit_K``.

    W31 + κ V_c/(R T̄) dP31/dt, κ = ``EXIT_WEIGHT``, T̄ the mean of T25 and T31. The measured planes
    agree with this form: on the 90 % record W25 − W31 goes with dP31/dt by 0.5 to 0.7 of
    V_c/(R T̄), and with the inertia term of Eq 5 not at all (−0.2 where 0.5 would mean that the
    blading's own pressure stores the gas).
    """
    machine = test.compressor
    if exit_K is None:
        exit_K, flow = record["T31_K"], record["W31_kg_s"]
    else:
        flow = physical_flow(record["Wc31_kg_s"], record["P31_Pa"], exit_K)
    mean_K = 0.5 * (record["T25_K"] + exit_K)
    rate_Pa_s = np.gradient(record["P31_Pa"], record.sample_period_s)
    volume = EXIT_WEIGHT * machine.internal_volume_m3 / machine.gas_constant_J_kg_K
    return np.asarray(flow + volume / mean_K * rate_Pa_s)


def impossible_rows(record: Record, test: TestDescription) -> BoolArray:
    """Return the rows in which plane 31 shows more flow than the area of plane 25 passes."""
    flow = exit_flow_at_inlet(record, test)
    corrected = corrected_from_physical(flow, record["P25_Pa"], record["T25_K"])
    return np.asarray(np.abs(corrected) > choked_flow(test.areas_m2[25], test.compressor))


def credit_of_storage(phi: FloatArray, mixing_phi: float = MIXING_PHI) -> FloatArray:
    """Return how far T31 is that of the gas that leaves: φ⁴/(φ⁴ + φ₀⁴), 0 in reversed flow.

    With a φ₀ (``mixing_phi``) of 0, T31 counts in all forward flow.
    """
    forward = phi > 0.0
    power = np.where(forward, phi, 1.0) ** 4
    return np.asarray(np.where(forward, power / (power + mixing_phi**4), 0.0))


def delivered_power(
    record: Record,
    test: TestDescription,
    flow_kg_s: FloatArray,
    phi: FloatArray,
    *,
    mixing_phi: float = MIXING_PHI,
    smooth: Callable[[FloatArray], FloatArray] = np.asarray,
    stores: bool = True,
) -> FloatArray:
    """Return W25 ψ in kg/s, finite through zero flow (Eq 13 with W31 from the mass balance).

    The record holds plane averages, the lag of the thermocouples undone; ``flow_kg_s`` is W25, or
    what both planes say of it, and ``phi`` that of this flow, best without the cells' ripple.
    ``mixing_phi`` is φ₀ of :func:`credit_of_storage`. ``smooth`` is for I d²W25/dt² and what T̄ is
    made of: the second derivative of a noisy flow is most of the noise of ψ. Where nothing
    ``stores`` between the blading and T31, T2 = T31.

    ψ = (2 c_p/U²)(T2 − T25) and c_p (W25 T2 − W31 T31) = V_c/(γ−1) dP̄/dt with
    P̄ = P25 + κ (P31 + I dW25/dt − P25) and W31 = W25 − κ V_c/(R T̄) dP31/dt, so that

        W25 (T2 − T31) = V_c/(γR) dP̄/dt − κ V_c/(R T̄) T31 dP31/dt,  T̄ = (T25 + T2)/2.

    Near zero flow the right-hand side counts by ``credit_of_storage``.
    """
    machine, period_s = test.compressor, record.sample_period_s
    inlet_K, exit_K = record["T25_K"], record["T31_K"]
    scale = 2.0 * machine.specific_heat_J_kg_K / test.rotor_velocity_m_s**2
    if not stores:
        return np.asarray(scale * flow_kg_s * (exit_K - inlet_K))
    exit_Pa_s = np.gradient(record["P31_Pa"], period_s)
    inlet_Pa_s = np.gradient(record["P25_Pa"], period_s)
    surge_Pa_s = machine.inertia_per_m * np.gradient(np.gradient(flow_kg_s, period_s), period_s)
    mean_Pa_s = inlet_Pa_s + EXIT_WEIGHT * (exit_Pa_s + smooth(surge_Pa_s) - inlet_Pa_s)
    volume = machine.internal_volume_m3 / machine.gas_constant_J_kg_K
    credit = credit_of_storage(phi, mixing_phi)
    span = float(np.ptp(flow_kg_s))
    divisor = np.where(phi > 0.0, np.maximum(smooth(flow_kg_s), 1e-3 * span), np.inf)
    delivered_K = exit_K
    stored = np.zeros_like(phi)
    for _ in range(PASSES):
        mean_K = 0.5 * (inlet_K + delivered_K)
        mass = EXIT_WEIGHT * volume / mean_K * exit_Pa_s * exit_K
        stored = credit * (volume / machine.gamma * mean_Pa_s - mass)
        share = np.clip(smooth(stored) / divisor / exit_K, -LARGEST_SHARE, LARGEST_SHARE)
        delivered_K = exit_K * (1.0 + share)
    return np.asarray(scale * (flow_kg_s * (exit_K - inlet_K) + stored))
