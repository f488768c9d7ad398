"""Which rows one free run through a record passes, and which of them it is scored on.

What reaches the time constant on a record that passed the whole sensor chain is a free run through
all its cycles, scored only where the model holds: in forward flow, in stall, and away from the
changes between the regimes. The other rows are simulated through.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.filters import period_average
from classic_ml.records import Channel, Dropped, LedgerEntry, Record, fault_name
from classic_ml.segments import LOWEST_CELL_HZ, hub_tip_stall, shows_stall
from classic_ml.spectra import peak_frequency_hz, power_spectrum
from surge_core.types import BoolArray, FloatArray

__all__ = ["FreeRunRows", "cell_period_s", "extend_while_settled", "free_run_rows", "near"]


# Averaged φ below this is reversed or about to be: the probes' dead band is as wide.
MINIMUM_PHI = 0.0075
# The loss in reversed flow acts without the lag and reaches into every average that touches a
# reversed row: half a cell period and a sample before the reversal. It vanishes with φ² towards
# its end, where two milliseconds are enough.
BEFORE_REVERSAL_S = 0.001
AFTER_REVERSAL_S = 0.002
# The change between the branches takes some 3 ms, and the hub-minus-tip flow shows the entry into
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


@dataclass(frozen=True)
class FreeRunRows:
    """The rows of one free run.

    Parameters
    ----------
    stalled : ndarray of bool, shape (n,)
        In-stall state as the machine itself shows it.
    inside : slice
        Rows that the run passes.
    scored : ndarray of bool, shape (n,)
        Rows that it is scored on.
    entry : LedgerEntry
        What was left out and why.
    """

    stalled: BoolArray
    inside: slice
    scored: BoolArray
    entry: LedgerEntry

    @property
    def channels(self) -> list[Channel]:
        """Return ``stalled`` (0/1) and ``free_run`` (0 outside, 1 simulated, 2 scored)."""
        free_run = _inside(self.inside, self.stalled.size).astype(np.float64) + self.scored
        return [
            Channel("stalled", self.stalled.astype(np.float64), "1"),
            Channel.adopt("free_run", free_run, "1"),
        ]


def _inside(part: slice, n_rows: int) -> BoolArray:
    """Return True in the rows of a part of the record."""
    inside = np.zeros(n_rows, dtype=np.bool_)
    inside[part] = True
    return inside


def cell_period_s(record: Record, window: slice) -> tuple[float, bool]:
    """Return the period of the stall cells, and whether the spectrum shows any.

    Parameters
    ----------
    record : Record
        With ``P25_unfiltered_Pa``.
    window : slice
        Rows of the surge cycles.
    """
    frequency, density = power_spectrum(record["P25_unfiltered_Pa"][window], record.sample_rate_hz)
    cell_hz = peak_frequency_hz(frequency, density, LOWEST_CELL_HZ, 0.4 * record.sample_rate_hz)
    around = (frequency > 0.6 * cell_hz) & (frequency < 1.4 * cell_hz)
    peak = float(density[np.argmin(np.abs(frequency - cell_hz))])
    if peak < LEAST_PEAK * float(np.median(density[around])):
        return PLAIN_PERIOD_S, False
    return 1.0 / cell_hz, True


def extend_while_settled(
    record: Record, window: slice, in_use: Iterable[str] | None = None
) -> slice:
    """Return the window, extended to both sides over the rows of the same settled machine.

    The cycles need not repeat each other for a free run: it ends where N_c leaves 8 % of its
    median in the window, or where a reading in use does not count.

    Parameters
    ----------
    record : Record
        With ``Nc_frac`` and the fault channels of its readings.
    window : slice
        Rows of the cycles that repeat each other.
    in_use : iterable of str, optional
        Channels whose faults count; those of the record without it.

    Returns
    -------
    slice
        Rows of the free run.
    """
    speed = period_average(record["Nc_frac"], SETTLING_AVERAGE_S, record.sample_rate_hz)
    bad = np.abs(speed / np.median(speed[window]) - 1.0) > SETTLED_SHARE
    # A channel that was dropped does not count, whatever it reads.
    for name in record.channels if in_use is None else in_use:
        if fault_name(name) in record:
            bad |= record[fault_name(name)] != 0
    before = np.flatnonzero(bad[: window.start])
    behind = np.flatnonzero(bad[window.stop :])
    start = int(before[-1]) + 1 if before.size else 0
    stop = window.stop + int(behind[0]) if behind.size else record.n_samples
    return slice(start, stop)


def near(rows: BoolArray, before: int, behind: int) -> BoolArray:
    """Return the rows that lie up to so many before or behind a row of the given ones."""
    # How many of the given rows there are up to each row, and the same beyond both ends.
    counts = np.zeros(rows.size + before + behind + 1, dtype=np.int32)
    last = rows.size + behind + 1
    np.cumsum(rows, out=counts[behind + 1 : last])
    counts[last:] = counts[last - 1]
    reach = before + behind + 1
    return np.asarray(counts[reach : reach + rows.size] > counts[: rows.size])


def free_run_rows(
    record: Record,
    phi: FloatArray,
    window: slice,
    inside: slice,
    in_stall: FloatArray,
) -> FreeRunRows:
    """Choose the rows of one free run through the surge cycles.

    Parameters
    ----------
    record : Record
        With ``P25_unfiltered_Pa`` and, unfiltered, what :func:`hub_tip_difference` takes.
    phi : ndarray of shape (n,)
        Flow coefficient from unfiltered pressures.
    window : slice
        Rows of the surge cycles that repeat each other.
    inside : slice
        Rows that the run passes.
    in_stall : ndarray of shape (n,)
        State by a threshold of the flow (0/1), taken where hub and tip show none.

    Returns
    -------
    FreeRunRows
        With its ledger entry.
    """
    rate, n_rows = record.sample_rate_hz, record.n_samples
    period_s, has_cells = cell_period_s(record, window)
    stalled, rule, flags = _state(record, window, in_stall, period_s)

    def rows_of(seconds: float) -> int:
        return round(seconds * rate)

    half_s, ends = 0.5 * period_s, rows_of(END_S)
    running = _inside(inside, n_rows) & stalled
    reversal = period_average(phi, period_s, rate) <= MINIMUM_PHI
    backward = running & near(
        reversal, rows_of(half_s + BEFORE_REVERSAL_S), rows_of(AFTER_REVERSAL_S)
    )
    entries, recoveries = np.zeros(n_rows, np.bool_), np.zeros(n_rows, np.bool_)
    entries[1:] = stalled[1:] & ~stalled[:-1]
    recoveries[1:] = stalled[:-1] & ~stalled[1:]
    switching = near(entries, rows_of(OPPOSITE_S), rows_of(half_s + AFTER_ENTRY_S))
    switching |= near(recoveries, rows_of(half_s), rows_of(OPPOSITE_S))
    switching &= running & ~backward
    forward = running & ~backward & ~switching
    scored = forward & _inside(slice(inside.start + ends, inside.stop - ends), n_rows)
    if not has_cells:
        flags += (
            "no line of rotating stall stands out of the spectrum of P25: averages are taken over "
            f"{1e3 * PLAIN_PERIOD_S:g} ms",
        )
    pinned_phi = float(np.median(phi[backward])) if backward.any() else float("nan")
    count = np.count_nonzero
    left_out = (
        (
            int(count(backward)),
            "reversed flow: the plenum blows down while φ stays near "
            f"{pinned_phi:.3f}, and the loss acts without the lag"
            if pinned_phi < 0.0
            else "flow near zero, inside the dead band of the probes",
        ),
        (int(count(switching)), "the average smears them across stall entry or recovery"),
        (inside.stop - inside.start - int(count(running)), "unstalled"),
        (int(count(forward & ~scored)), "at the ends of the run"),
    )
    entry = _entry(record, inside, left_out, int(count(scored)), period_s)
    entry = replace(entry, parameters={**entry.parameters, "stall_rule": rule}, flags=flags)
    return FreeRunRows(stalled, inside, scored, entry)


def _state(
    record: Record, window: slice, in_stall: FloatArray, period_s: float
) -> tuple[BoolArray, str, tuple[str, ...]]:
    """Return the state by the hub-minus-tip flow where there is a shift, else by the threshold."""
    if shows_stall(record, window):
        return hub_tip_stall(record, window, 1.0 / period_s), "hub-tip", ()
    flag = (
        "hub and tip do not show the stall state: it is estimated by the threshold of the flow, "
        "which costs accuracy of the time constant"
    )
    return np.asarray(in_stall > 0.5), "threshold", (flag,)


def _entry(
    record: Record,
    inside: slice,
    left_out: tuple[tuple[int, str], ...],
    scored: int,
    period_s: float,
) -> LedgerEntry:
    """Name each row left out once, by the first reason that holds."""
    dropped = tuple(
        Dropped("rows", rows, why + "; simulated, not scored") for rows, why in left_out if rows
    )
    n_inside, unstalled = inside.stop - inside.start, left_out[2][0]
    from_s, to_s = record.time_at_s(inside.start), record.time_at_s(inside.stop - 1)
    parameters: dict[str, str | int | float | bool] = {
        "average_s": round(period_s, 7),
        "from_s": round(from_s, 6),
        "to_s": round(to_s, 6),
        "rows": n_inside,
        "scored": scored,
        "in_stall": n_inside - unstalled,
    }
    did = (
        f"one run from {from_s:.3f} to {to_s:.3f} s, scored on {scored} of {n_inside} rows; "
        f"unfiltered φ and ψ' are averaged over {1e3 * period_s:.2f} ms in the fit"
    )
    return LedgerEntry("free run", did, parameters, dropped)
