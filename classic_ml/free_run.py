"""Which rows one free run through a record passes, and which of them it is scored on.

What reaches the time constant on a record that passed the whole sensor chain is a free run through
all its cycles, scored only where the model holds: in forward flow, in stall, and away from the
changes between the regimes. The other rows are simulated through.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.computed import as_stored
from classic_ml.columns.growing import GrowingColumns
from classic_ml.columns.order_statistics import median
from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks, evaluated
from classic_ml.filters import period_average
from classic_ml.flow import LBM_KG
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from classic_ml.segments import (
    LOWEST_CELL_HZ,
    hub_tip_difference,
    hub_tip_stall,
    knows_hub_and_tip,
)
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
    inside : slice
        Rows that the run passes.
    scored : ndarray of bool, shape (n,)
        Rows that it is scored on.
    entry : LedgerEntry
        What was left out and why.
    workspace : Workspace
        Where the columns lie.
    """

    stalled: BoolArray
    inside: slice
    scored: BoolArray
    entry: LedgerEntry
    workspace: Workspace = IN_MEMORY

    @property
    def channels(self) -> list[Channel]:
        """Return ``stalled`` (0/1) and ``free_run`` (0 outside, 1 simulated, 2 scored)."""

        def state(rows: slice) -> NDArray[np.int8]:
            return np.add(_inside(self.inside, rows), self.scored[rows], dtype=np.int8)

        place = self.workspace
        free_run = evaluated(place, self.stalled.size, state, np.int8)
        return [
            Channel("stalled", place.widened(self.stalled), "1"),
            Channel("free_run", place.widened(free_run), "1"),
        ]


def _inside(part: slice, rows: slice) -> BoolArray:
    """Tell which of the rows are in a part of the record."""
    number = np.arange(rows.start, rows.stop)
    return np.asarray((number >= part.start) & (number < part.stop))


def cell_period_s(record: Record, window: slice) -> tuple[float, bool]:
    """Return the period of the stall cells, and whether the spectrum shows any.

    Parameters
    ----------
    record : Record
        With ``P25_unfiltered_Pa``.
    window : slice
        Rows of the surge cycles.
    """
    frequency, density = power_spectrum(
        record["P25_unfiltered_Pa"][window], record.sample_rate_hz, workspace=record.workspace
    )
    cell_hz = peak_frequency_hz(frequency, density, LOWEST_CELL_HZ, 0.4 * record.sample_rate_hz)
    around = (frequency > 0.6 * cell_hz) & (frequency < 1.4 * cell_hz)
    peak = float(density[np.argmin(np.abs(frequency - cell_hz))])
    if peak < LEAST_PEAK * float(np.median(density[around])):
        return PLAIN_PERIOD_S, False
    return 1.0 / cell_hz, True


def extend_while_settled(
    record: Record, window: slice, in_use: Container[str] | None = None
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
    in_use : container of str, optional
        Channels whose faults count; those of the record without it.

    Returns
    -------
    slice
        Rows of the free run.
    """
    place = record.workspace
    speed = period_average(
        record["Nc_frac"], SETTLING_AVERAGE_S, record.sample_rate_hz, workspace=place
    )
    settled = median(speed, window, workspace=place)
    # A channel that was dropped does not count, whatever it reads.
    faults = [
        as_stored(record[name])
        for name in record.channels
        if name.startswith("fault_")
        and name.removeprefix("fault_") in (record if in_use is None else in_use)
    ]

    def bad(rows: slice) -> BoolArray:
        out = np.abs(speed[rows] / settled - 1.0) > SETTLED_SHARE
        for fault in faults:
            out |= fault[rows] != 0
        return np.asarray(out)

    start = 0
    for rows in reversed(list(blocks(window.start))):
        found = np.flatnonzero(bad(rows))
        place.release()
        if found.size:
            start = rows.start + int(found[-1]) + 1
            break
    stop = record.n_samples
    for rows in blocks(record.n_samples, window.stop):
        found = np.flatnonzero(bad(rows))
        place.release()
        if found.size:
            stop = rows.start + int(found[0])
            break
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


@dataclass(frozen=True)
class _Reach:
    """What decides over the rows, and how far, in rows."""

    average: FloatArray
    stalled: BoolArray
    inside: slice
    backward: tuple[int, int]
    entry: tuple[int, int]
    recovery: tuple[int, int]
    ends: int

    @property
    def widest(self) -> int:
        """Rows that one row may reach."""
        return 1 + max(*self.backward, *self.entry, *self.recovery)

    def masks(self, rows: slice) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Return the rows with reversed flow near, those near a switch, and those scored."""
        around = slice(
            max(0, rows.start - self.widest), min(self.stalled.size, rows.stop + self.widest)
        )
        own = slice(rows.start - around.start, rows.stop - around.start)
        stalled = self.stalled[around]
        entries, recoveries = np.zeros(stalled.size, np.bool_), np.zeros(stalled.size, np.bool_)
        entries[1:] = stalled[1:] & ~stalled[:-1]
        recoveries[1:] = stalled[:-1] & ~stalled[1:]
        backward = near(self.average[around] <= MINIMUM_PHI, *self.backward)[own]
        switching = (near(entries, *self.entry) | near(recoveries, *self.recovery))[own]
        middle = slice(self.inside.start + self.ends, self.inside.stop - self.ends)
        scored = _inside(middle, rows) & stalled[own] & ~backward & ~switching
        return backward, switching, scored


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
    rate, place = record.sample_rate_hz, record.workspace
    period_s, has_cells = cell_period_s(record, window)
    stalled, rule, flags = _state(record, window, in_stall, period_s)

    def rows_of(seconds: float) -> int:
        return round(seconds * rate)

    half_s = 0.5 * period_s
    reach = _Reach(
        period_average(phi, period_s, rate, workspace=place, stored=False),
        stalled,
        inside,
        (rows_of(half_s + BEFORE_REVERSAL_S), rows_of(AFTER_REVERSAL_S)),
        (rows_of(OPPOSITE_S), rows_of(half_s + AFTER_ENTRY_S)),
        (rows_of(half_s), rows_of(OPPOSITE_S)),
        rows_of(END_S),
    )
    scored, counts = _scored(reach, phi, place)
    if not has_cells:
        flags += (
            "no line of rotating stall stands out of the spectrum of P25: averages are taken over "
            f"{1e3 * PLAIN_PERIOD_S:g} ms",
        )
    entry = _entry(record, inside, counts, period_s, rule, flags)
    return FreeRunRows(stalled, inside, scored, entry, place)


def _state(
    record: Record, window: slice, in_stall: FloatArray, period_s: float
) -> tuple[BoolArray, str, tuple[str, ...]]:
    """Tell the state by the hub-minus-tip flow where there is a shift, else by the threshold."""
    place = record.workspace
    if knows_hub_and_tip(record):
        shift = hub_tip_difference(record)
        if median(shift, window, workspace=place) > LEAST_SHIFT_KG_S:
            return hub_tip_stall(record, window, 1.0 / period_s), "hub-tip", ()
    return (
        evaluated(place, record.n_samples, lambda rows: in_stall[rows] > 0.5, np.bool_),
        "threshold",
        (
            "hub and tip do not show the stall state: it is told by the threshold of the flow, "
            "which costs accuracy of the time constant",
        ),
    )


@dataclass
class _Counts:
    """Rows inside the run by the first reason for which they are left out, and the others."""

    backward: int = 0
    switching: int = 0
    unstalled: int = 0
    ends: int = 0
    scored: int = 0
    # Median φ of the rows with reversed flow.
    pinned_phi: float = float("nan")


def _scored(reach: _Reach, phi: FloatArray, place: Workspace) -> tuple[BoolArray, _Counts]:
    """Mark the rows that are scored, and count those that are not."""
    counts, reversed_phi = _Counts(), GrowingColumns(place, 1)

    def scored(rows: slice) -> BoolArray:
        inside = _inside(reach.inside, rows)
        if not inside.any():
            return inside
        stalled = reach.stalled[rows] & inside
        backward, switching, chosen = reach.masks(rows)
        backward &= stalled
        switching &= stalled & ~backward
        counts.backward += int(np.count_nonzero(backward))
        counts.switching += int(np.count_nonzero(switching))
        counts.unstalled += int(np.count_nonzero(inside) - np.count_nonzero(stalled))
        counts.ends += int(np.count_nonzero(stalled & ~backward & ~switching & ~chosen))
        counts.scored += int(np.count_nonzero(chosen))
        reversed_phi.append(phi[rows][backward][:, None])
        return chosen

    column = evaluated(place, phi.size, scored, np.bool_)
    if counts.backward:
        counts.pinned_phi = median(reversed_phi.finished()[0], workspace=place)
    return column, counts


def _entry(
    record: Record,
    inside: slice,
    counts: _Counts,
    period_s: float,
    rule: str,
    flags: tuple[str, ...],
) -> LedgerEntry:
    """Name each row left out once, by the first reason that holds."""
    reasons = (
        (
            counts.backward,
            "reversed flow: the plenum blows down while φ stays near "
            f"{counts.pinned_phi:.3f}, and the loss acts without the lag"
            if counts.pinned_phi < 0.0
            else "flow near zero, inside the dead band of the probes",
        ),
        (counts.switching, "the average smears them across stall entry or recovery"),
        (counts.unstalled, "unstalled"),
        (counts.ends, "at the ends of the run"),
    )
    dropped = tuple(
        Dropped("rows", count, why + "; simulated, not scored") for count, why in reasons if count
    )
    n_inside = inside.stop - inside.start
    from_s, to_s = record.time_at_s(inside.start), record.time_at_s(inside.stop - 1)
    parameters: dict[str, str | int | float | bool] = {
        "average_s": round(period_s, 7),
        "stall_rule": rule,
        "from_s": round(from_s, 6),
        "to_s": round(to_s, 6),
        "rows": n_inside,
        "scored": counts.scored,
        "in_stall": n_inside - counts.unstalled,
    }
    return LedgerEntry(
        "free run",
        f"one run from {from_s:.3f} to {to_s:.3f} s, scored on "
        f"{counts.scored} of {n_inside} rows; unfiltered φ and ψ' are "
        f"averaged over {1e3 * period_s:.2f} ms in the fit",
        parameters,
        dropped,
        flags,
    )
