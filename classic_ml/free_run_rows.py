"""Which rows one free run through a record passes, and which of them it is scored on.

What reaches the time constant on a record that passed the whole sensor chain is a free run through
all its cycles, scored only where the model holds: in forward flow, in stall, and away from the
changes between the regimes. The other rows are simulated through.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from classic_ml.airflow import LBM_KG
from classic_ml.filtering import period_average
from classic_ml.records import Channel, Dropped, FloatArray, LedgerEntry, Record
from classic_ml.segments import cell_frequency_hz, hub_tip_stall
from classic_ml.spectra import power_spectrum

__all__ = ["FreeRunRows", "cell_period_s", "extend_while_settled", "free_run_rows", "near"]

# Averaged φ below this is reversed or about to be: the probes' dead band is as wide.
MINIMUM_PHI = 0.0075
# The loss in reversed flow acts without the lag and reaches into every average that touches a
# reversed row: half a cell period and a sample before the reversal. It vanishes with φ² towards
# its end, where two milliseconds are enough.
BEFORE_REVERSAL_S = 0.001
AFTER_REVERSAL_S = 0.002
# The change between the branches takes some 3 ms, and the hub-minus-tip flow tells the entry into
# stall later than it happens: half a cell period, and 6 ms behind the entry.
AFTER_ENTRY_S = 0.006
OPPOSITE_S = 0.008
END_S = 0.008
# The inlet heats up after the first reversal; before N_c has settled the machine is another one.
SETTLED_SHARE = 0.08
SETTLING_AVERAGE_S = 0.15
# A line of rotating stall stands at least this far above the spectrum around it.
LEAST_PEAK = 20.0
# Without cells there is nothing to average out but noise.
PLAIN_PERIOD_S = 0.010
LEAST_SHIFT_KG_S = 2.0 * LBM_KG


@dataclass(frozen=True)
class FreeRunRows:
    """The rows of one free run.

    Parameters
    ----------
    stalled : ndarray of bool, shape (n,)
        In-stall state as the machine itself shows it.
    inside : ndarray of bool, shape (n,)
        Rows that the run passes.
    scored : ndarray of bool, shape (n,)
        Rows that it is scored on.
    entry : LedgerEntry
        What was left out and why.
    """

    stalled: NDArray[np.bool_]
    inside: NDArray[np.bool_]
    scored: NDArray[np.bool_]
    entry: LedgerEntry

    @property
    def channels(self) -> list[Channel]:
        """Return ``stalled`` (0/1) and ``free_run`` (0 outside, 1 simulated, 2 scored)."""
        state = self.inside.astype(np.float64) + self.scored
        return [
            Channel("stalled", self.stalled.astype(np.float64), "1"),
            Channel("free_run", state, "1"),
        ]


def cell_period_s(record: Record, window: NDArray[np.bool_]) -> tuple[float, bool]:
    """Return the period of the stall cells, and whether the spectrum shows any.

    Parameters
    ----------
    record : Record
        With ``P25_unfiltered_Pa``.
    window : ndarray of bool, shape (n_samples,)
        Rows of the surge cycles.
    """
    frequency, density = power_spectrum(record["P25_unfiltered_Pa"][window], record.sample_rate_hz)
    cell_hz = cell_frequency_hz(record, window)
    around = (frequency > 0.6 * cell_hz) & (frequency < 1.4 * cell_hz)
    peak = float(density[np.argmin(np.abs(frequency - cell_hz))])
    if peak < LEAST_PEAK * float(np.median(density[around])):
        return PLAIN_PERIOD_S, False
    return 1.0 / cell_hz, True


def extend_while_settled(record: Record, window: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the window, extended to both sides over the rows of the same settled machine.

    The cycles need not repeat each other for a free run: it ends where N_c leaves 8 % of its
    median in the window, or where a reading in use does not count.

    Parameters
    ----------
    record : Record
        With ``Nc_frac`` and the fault channels of its readings.
    window : ndarray of bool, shape (n_samples,)
        Rows of the cycles that repeat each other.
    """
    speed = period_average(record["Nc_frac"], SETTLING_AVERAGE_S, record.sample_rate_hz)
    good = np.abs(speed / np.median(speed[window]) - 1.0) <= SETTLED_SHARE
    for name in record.channels:
        # A channel that was dropped does not count, whatever it reads.
        if name.startswith("fault_") and name.removeprefix("fault_") in record:
            good &= record[name] == 0.0
    rows = np.flatnonzero(window)
    before = np.flatnonzero(~good[: rows[0]])
    behind = np.flatnonzero(~good[rows[-1] :])
    start = int(before[-1]) + 1 if before.size else 0
    stop = int(rows[-1] + behind[0]) if behind.size else good.size
    out = window.copy()
    out[start : max(stop, int(rows[-1]) + 1)] = True
    return out


def near(rows: NDArray[np.bool_], before: int, behind: int) -> NDArray[np.bool_]:
    """Return the rows that lie up to so many before or behind a row of the given ones."""
    out = rows.copy()
    for step in range(1, before + 1):
        out[:-step] |= rows[step:]
    for step in range(1, behind + 1):
        out[step:] |= rows[:-step]
    return out


def free_run_rows(
    record: Record,
    phi: FloatArray,
    window: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    in_stall: NDArray[np.bool_],
) -> FreeRunRows:
    """Choose the rows of one free run through the surge cycles.

    Parameters
    ----------
    record : Record
        With ``P25_unfiltered_Pa``, ``Wc25_hub_kg_s`` and ``Wc25_tip_kg_s``, unfiltered.
    phi : ndarray of shape (n,)
        Flow coefficient from unfiltered pressures.
    window : ndarray of bool, shape (n,)
        Rows of the surge cycles that repeat each other.
    inside : ndarray of bool, shape (n,)
        Rows that the run passes, without a break.
    in_stall : ndarray of bool, shape (n,)
        State by a threshold of the flow, taken where hub and tip show none.

    Returns
    -------
    FreeRunRows
        With its ledger entry.
    """
    rate = record.sample_rate_hz
    period_s, has_cells = cell_period_s(record, window)
    stalled, rule, flags = _state(record, window, in_stall, period_s)
    average = period_average(phi, period_s, rate)

    def rows_of(seconds: float) -> int:
        return round(seconds * rate)

    half_s = 0.5 * period_s
    backward = near(
        average <= MINIMUM_PHI, rows_of(half_s + BEFORE_REVERSAL_S), rows_of(AFTER_REVERSAL_S)
    )
    changes = np.flatnonzero(stalled[1:] != stalled[:-1]) + 1
    entries, recoveries = (np.zeros(phi.size, dtype=np.bool_) for _ in range(2))
    entries[changes[stalled[changes]]] = True
    recoveries[changes[~stalled[changes]]] = True
    switching = near(entries, rows_of(OPPOSITE_S), rows_of(half_s + AFTER_ENTRY_S))
    switching |= near(recoveries, rows_of(half_s), rows_of(OPPOSITE_S))
    ends = inside.copy()
    rows = np.flatnonzero(inside)
    ends[rows[0] + rows_of(END_S) : rows[-1] + 1 - rows_of(END_S)] = False
    scored = inside & stalled & ~backward & ~switching & ~ends
    if not has_cells:
        flags += (
            "no line of rotating stall stands out of the spectrum of P25: averages are taken over "
            f"{1e3 * PLAIN_PERIOD_S:g} ms",
        )
    entry = _entry(record, phi, inside, stalled, backward, switching, scored, period_s, rule)
    return FreeRunRows(stalled, inside, scored, replace(entry, flags=flags))


def _state(
    record: Record, window: NDArray[np.bool_], in_stall: NDArray[np.bool_], period_s: float
) -> tuple[NDArray[np.bool_], str, tuple[str, ...]]:
    """Tell the state by the hub-minus-tip flow where there is a shift, else by the threshold."""
    if "Wc25_hub_kg_s" in record and "Wc25_tip_kg_s" in record:
        shift = record["Wc25_hub_kg_s"] - record["Wc25_tip_kg_s"]
        if float(np.median(shift[window])) > LEAST_SHIFT_KG_S:
            return hub_tip_stall(record, window, 1.0 / period_s), "hub-tip", ()
    return (
        in_stall,
        "threshold",
        (
            "hub and tip do not show the stall state: it is told by the threshold of the flow, "
            "which costs accuracy of the time constant",
        ),
    )


def _entry(
    record: Record,
    phi: FloatArray,
    inside: NDArray[np.bool_],
    stalled: NDArray[np.bool_],
    backward: NDArray[np.bool_],
    switching: NDArray[np.bool_],
    scored: NDArray[np.bool_],
    period_s: float,
    rule: str,
) -> LedgerEntry:
    """Name each row left out once, by the first reason that holds."""
    unstalled = inside & ~stalled
    reversed_rows = inside & stalled & backward
    smeared = inside & stalled & ~backward & switching
    rest = inside & ~(scored | unstalled | reversed_rows | smeared)
    pinned = float(np.median(phi[reversed_rows])) if reversed_rows.any() else float("nan")
    reasons = (
        (
            reversed_rows,
            "reversed flow: the plenum blows down while φ stays near "
            f"{pinned:.3f}, and the loss acts without the lag"
            if pinned < 0.0
            else "flow near zero, inside the dead band of the probes",
        ),
        (smeared, "the average smears them across stall entry or recovery"),
        (unstalled, "unstalled"),
        (rest, "at the ends of the run"),
    )
    dropped = tuple(
        Dropped("rows", int(np.count_nonzero(rows)), why + "; simulated, not scored")
        for rows, why in reasons
        if rows.any()
    )
    time_s = record.time_s[inside]
    parameters: dict[str, str | int | float | bool] = {
        "average_s": round(period_s, 7),
        "stall_rule": rule,
        "from_s": round(float(time_s[0]), 6),
        "to_s": round(float(time_s[-1]), 6),
        "rows": int(np.count_nonzero(inside)),
        "scored": int(np.count_nonzero(scored)),
        "in_stall": int(np.count_nonzero(inside & stalled)),
    }
    return LedgerEntry(
        "free run",
        f"one run from {time_s[0]:.3f} to {time_s[-1]:.3f} s, scored on "
        f"{np.count_nonzero(scored)} of {np.count_nonzero(inside)} rows; unfiltered φ and ψ' are "
        f"averaged over {1e3 * period_s:.2f} ms in the fit",
        parameters,
        dropped,
    )
