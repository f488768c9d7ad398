"""Which rows one free run through a record passes, and which of them it is scored on.

What reaches the time constant on a record that passed the whole sensor chain is a free run through
all its cycles, scored only where the model holds: in forward flow, in stall, and away from the
changes between the regimes. The other rows are simulated through.
"""

from __future__ import annotations

import numpy as np

from classic_ml.filters import period_average
from classic_ml.records import Dropped, LedgerEntry, Record, fault_name
from surge_core.types import BoolArray, IntArray

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


def extend_while_settled(record: Record, window: slice) -> slice:
    """Return the window, extended to both sides over the rows of the same settled machine.

    The cycles need not repeat each other for a free run: it ends where N_c leaves 8 % of its
    median in the window, or where a reading does not count.
    """
    speed = period_average(record["Nc_frac"], SETTLING_AVERAGE_S, record.sample_rate_hz)
    bad = np.abs(speed / np.median(speed[window]) - 1.0) > SETTLED_SHARE
    for name in record.channels:
        if name.startswith(fault_name("")):
            bad |= record[name] != 0
    before = np.flatnonzero(bad[: window.start])
    behind = np.flatnonzero(bad[window.stop :])
    start = int(before[-1]) + 1 if before.size else 0
    stop = window.stop + int(behind[0]) if behind.size else record.n_samples
    return slice(start, stop)


def near(rows: BoolArray, before: int, behind: int) -> BoolArray:
    """Return the rows that lie up to so many before or behind a row of the given ones."""
    reach = np.ones(before + behind + 1)
    return np.convolve(rows, reach)[before : before + rows.size] > 0.5


def free_run_rows(
    record: Record, stalled: BoolArray, inside: slice, period_s: float
) -> tuple[IntArray, LedgerEntry]:
    """Choose the rows of one free run that passes some rows of a record with unfiltered φ.

    ``period_s`` is what the fit averages over: one period of the stall cells. Returned are 0
    outside, 1 where the run is simulated through, 2 where it is scored, and the entry that says
    what was left out, each row once, by the first reason that holds.
    """
    rate, n_rows, phi = record.sample_rate_hz, record.n_samples, record["phi"]

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
    pinned_phi = float(np.median(phi[backward])) if backward.any() else float("nan")
    why_backward = "flow near zero, inside the dead band of the probes"
    if pinned_phi < 0.0:
        why_backward = (
            "reversed flow: the plenum blows down while φ stays near "
            f"{pinned_phi:.3f}, and the loss acts without the lag"
        )
    count = np.count_nonzero
    n_inside, n_scored = inside.stop - inside.start, int(count(scored))
    unstalled = n_inside - int(count(running))
    left_out = {
        why_backward: int(count(backward)),
        "the average smears them across stall entry or recovery": int(count(switching)),
        "unstalled": unstalled,
        "at the ends of the run": int(count(forward & ~scored)),
    }
    from_s, to_s = record.time_at_s(inside.start), record.time_at_s(inside.stop - 1)
    entry = LedgerEntry(
        "free run",
        f"one run from {from_s:.3f} to {to_s:.3f} s, scored on {n_scored} of {n_inside} rows; "
        f"unfiltered φ and ψ' are averaged over {1e3 * period_s:.2f} ms in the fit",
        {
            "average_s": round(period_s, 7),
            "from_s": round(from_s, 6),
            "to_s": round(to_s, 6),
            "rows": n_inside,
            "scored": n_scored,
            "in_stall": n_inside - unstalled,
        },
        tuple(
            Dropped("rows", rows, why + "; simulated, not scored")
            for why, rows in left_out.items()
            if rows
        ),
    )
    return _inside(inside, n_rows).astype(np.int64) + scored, entry


def _inside(part: slice, n_rows: int) -> BoolArray:
    """Return True in the rows of a part of the record."""
    inside = np.zeros(n_rows, dtype=np.bool_)
    inside[part] = True
    return inside
