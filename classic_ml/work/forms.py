"""ψ from the plane averages: by which form of Eq 13, and where it is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from math import ceil

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.order_statistics import median, percentile
from classic_ml.columns.workspace import Workspace, blocks, evaluated
from classic_ml.description import Compressor, TestDescription
from classic_ml.faults.bridging import bridged_rows
from classic_ml.rates import rate_in
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from classic_ml.work.balance import EXIT_WEIGHT, delivered_power, exit_flow_at_inlet, flat_average
from surge_core.types import FloatArray

__all__ = ["PSI_MINIMUM_PHI", "WORK_FORMS", "psi_is_known", "with_work", "work_coefficient"]

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


def with_work(
    record: Record,
    test: TestDescription,
    inertia_per_m: float,
    form: str,
    cell_period_s: float | None,
) -> Record:
    """Add ψ to a record with W31.

    Parameters
    ----------
    record : Record
        Plane averages, with ``phi`` and ``dW25_dt_kg_s2``.
    test : TestDescription
        Machine and speed.
    inertia_per_m : float
        I = ∫dx/A of Eq 5.
    form : {"auto", "exit-flow", "mass-balance", "temperature-rise"}
        One of ``WORK_FORMS``.
    cell_period_s : float or None
        What the mass balance averages over.

    Returns
    -------
    Record
        With ``psi``, interpolated across φ < ``PSI_MINIMUM_PHI``, where φ is above it at all.
    """
    place, n = record.workspace, record.n_samples

    def known(rows: slice) -> NDArray[np.bool_]:
        return psi_is_known(record["phi"][rows])

    gaps = n - _count(known, n, place)
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
    by_flow = evaluated(place, n, partial(_energy_form, record, test, inertia_per_m))

    def rise(rows: slice) -> FloatArray:
        return _temperature_rise(record, test, rows)

    def gap() -> Iterator[FloatArray]:
        return ((by_flow[rows] - rise(rows))[known(rows)] for rows in blocks(n))

    def level() -> Iterator[FloatArray]:
        return (rise(rows)[known(rows)] for rows in blocks(n))

    # Half of what lies between the 16th and 84th percentile is a standard deviation that single
    # rows near zero flow do not decide.
    low, high = percentile(gap, [16.0, 84.0], workspace=place)
    mismatch = 0.5 * float(high - low) / median(level, workspace=place)
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
    if form == "mass-balance":
        by_flow = _mass_balance(record, test, inertia_per_m, cell_period_s)
    chosen = rise if form == "temperature-rise" else by_flow.__getitem__
    psi = Channel("psi", evaluated(place, n, bridged_rows(place, n, chosen, known)), "1")
    entry = LedgerEntry(
        "work coefficient",
        f"ψ by {_FORM_WORDS[form]}, interpolated over {gaps} of {n} rows",
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
    return record.after(entry, add=[psi])


def _count(holds: Callable[[slice], NDArray[np.bool_]], n_rows: int, place: Workspace) -> int:
    count = 0
    for rows in blocks(n_rows):
        count += int(np.count_nonzero(holds(rows)))
        place.release()
    return count


def _temperature_rise(record: Record, test: TestDescription, rows: slice) -> FloatArray:
    """ψ with T2 = T31 (nothing stored between the planes)."""
    rise_K = record["T31_K"][rows] - record["T25_K"][rows]
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

    width = 0.0 if cell_period_s is None else cell_period_s * record.sample_rate_hz
    # What a row of ψ depends on: eight averages over one period, half of it to each side, and
    # four derivatives, each in the other.
    reach = 8 * (1 + ceil(0.5 * width))
    place, n = record.workspace, record.n_samples

    def flow_in(part: Record) -> FloatArray:
        return np.asarray(0.5 * (part["W25_kg_s"] + exit_flow_at_inlet(part, test)))

    # The span of the flow sets the least divisor: that of the whole record, not of a block.
    low, high = np.inf, -np.inf
    for rows in blocks(n):
        flow = _inner(flow_in(_around(record, rows, reach)), rows, reach)
        low, high = min(low, flow.min()), max(high, flow.max())
        place.release()

    def ratio(rows: slice) -> FloatArray:
        part = _around(record, rows, reach)
        flow, phi = flow_in(part), smooth(part["phi"])
        power = delivered_power(
            part, test, flow, phi, inertia_per_m=inertia, smooth=smooth, flow_span_kg_s=high - low
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            return _inner(np.asarray(smooth(power) / smooth(flow)), rows, reach)

    def known(rows: slice) -> NDArray[np.bool_]:
        return psi_is_known(_inner(smooth(_around(record, rows, reach)["phi"]), rows, reach))

    # The averaged flow may be at zero where that of the row is not.
    return evaluated(place, n, bridged_rows(place, n, ratio, known))


def _around(record: Record, rows: slice, reach: int) -> Record:
    """Return what the mass balance needs of a record, so many rows more to each side."""
    part = slice(max(0, rows.start - reach), min(record.n_samples, rows.stop + reach))
    names = ("phi", "W25_kg_s", "W31_kg_s", "T25_K", "T31_K", "P25_Pa", "P31_Pa")
    channels = {n: Channel(n, record[n][part], record.channel(n).unit) for n in names}
    return Record(channels, record.sample_rate_hz)


def _inner(values: FloatArray, rows: slice, reach: int) -> FloatArray:
    """Return the rows of a slice without those around them."""
    first = rows.start - max(0, rows.start - reach)
    return values[first : first + rows.stop - rows.start]


def _energy_form(record: Record, test: TestDescription, inertia: float, rows: slice) -> FloatArray:
    """ψ by Eq 13, W31 as measured."""
    machine = test.compressor
    # One row more to each side, for the derivative.
    around = slice(max(0, rows.start - 1), min(record.n_samples, rows.stop + 1))
    blading_Pa = record["P31_Pa"][around] + inertia * record["dW25_dt_kg_s2"][around]
    inlet_Pa = record["P25_Pa"][around]
    mean_Pa = inlet_Pa + EXIT_WEIGHT * (blading_Pa - inlet_Pa)
    inside = slice(rows.start - around.start, rows.stop - around.start)
    storage_W = (
        machine.internal_volume_m3
        / (machine.gamma - 1.0)
        * rate_in(mean_Pa, inside, record.sample_period_s)
    )
    return work_coefficient(
        record["W25_kg_s"][rows],
        record["W31_kg_s"][rows],
        record["T25_K"][rows],
        record["T31_K"][rows],
        storage_W,
        test.rotor_velocity_m_s,
        machine,
    )
