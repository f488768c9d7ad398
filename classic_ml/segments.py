"""The in-stall state, its intervals inside the window of the surge cycles, and the free run's rows.

What reaches the time constant on a record that passed the whole sensor chain is a free run through
all its cycles, scored only where the model holds: in forward flow, in stall, and away from the
changes between the regimes. The other rows are simulated through.
"""

from __future__ import annotations

import math

import numpy as np

from classic_ml.cycles import first_reversal
from classic_ml.faults.search import SPIKED
from classic_ml.filters import peak_frequency_hz, period_average, power_spectrum
from classic_ml.flow import LBM_KG
from classic_ml.intervals import label_intervals
from classic_ml.records import Channel, Dropped, LedgerEntry, Record, counted, fault_name
from surge_core.errors import InputError
from surge_core.segments import intervals_where
from surge_core.types import BoolArray, FloatArray, IntArray

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
    median in the window, or where readings do not count; a bridged spike does not end it.
    """
    speed = period_average(record["Nc_frac"], SETTLING_AVERAGE_S, record.sample_rate_hz)
    bad = np.abs(speed / np.median(speed[window]) - 1.0) > SETTLED_SHARE
    for name in record.channels:
        if name.startswith(fault_name("")):
            bad |= (record[name] != 0) & (record[name] != SPIKED)
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


# Of the rotor's frequency: stall cells turn at 0.2 to 0.7 of it (Greitzer 1980, Journal of Fluids
# Engineering 102, 134), surge and its harmonics are below.
LOWEST_CELL_SHARE = 0.2
# Of the sample rate: there the sampled line still has ten samples in four periods.
HIGHEST_SHARE = 0.4
# What two rakes read differently at plane 25.
RAKE_DIFFERENCE = "P25_rake_difference_Pa"
# A line of rotating stall stands at least this far above the spectrum around it.
LEAST_PEAK = 20.0
# Without cells there is nothing to average out but noise.
PLAIN_PERIOD_S = 0.010
# A smaller shift of hub against tip, as a share of the largest flow, shows no state: 2 lbm/s of the
# paper's 112. It was 0.10 to 0.30 on 33 records of two rigs that nothing here was tuned on.
LEAST_SHIFT = 0.018
# Shorter than 20 ms is a graze of the threshold, not a regime: τ itself is about that long.
SHORTEST_S = 0.02
# Share of the flow before surge that counts as recovery where no threshold says so: the paper's
# 50 lbm/s is 0.45 of the 112 lbm/s near stall.
RECOVERED_SHARE = 0.45
# Share of the window beyond which unstalled rows are a regime, and no error of the state.
LEAST_UNSTALLED = 0.02


def window_rows(record: Record, window_s: tuple[float, float], where: str = "window") -> slice:
    """Return the rows of a window, or refuse one, called ``where``, that is not in the record."""
    half = 0.5 * record.sample_period_s
    first_s, last_s = record.time_at_s(0), record.time_at_s(record.n_samples - 1)
    rows = record.rows_between(*window_s)
    inside = window_s[0] >= first_s - half and window_s[1] <= last_s + half
    if not inside or rows.stop - rows.start < SHORTEST_S * record.sample_rate_hz:
        raise InputError(
            where,
            expected=f"a window with surge cycles inside the record ({first_s:.3f} to "
            f"{last_s:.3f} s)",
            found=f"{rows.stop - rows.start} rows from {window_s[0]:g} to {window_s[1]:g} s",
        )
    return rows


def in_stall_by_threshold(
    corrected_kg_s: FloatArray, threshold_kg_s: float, hysteresis_kg_s: float = 0.0
) -> BoolArray:
    """Return the in-stall state by a threshold of the corrected inlet flow, the paper's 50 lbm/s.

    Stall begins below threshold − hysteresis and ends above threshold + hysteresis; until the flow
    first leaves that band, the state is that of its middle.
    """
    stalled = corrected_kg_s < threshold_kg_s - hysteresis_kg_s
    if hysteresis_kg_s > 0.0 and stalled.size:
        at_first = bool(corrected_kg_s[0] < threshold_kg_s)
        decided = stalled | (corrected_kg_s >= threshold_kg_s + hysteresis_kg_s)
        since = np.maximum.accumulate(np.where(decided, np.arange(stalled.size), -1))
        stalled = np.where(since < 0, at_first, stalled[since])
    return np.asarray(stalled)


def lowest_cell_hz(rotor_speed_rpm: float) -> float:
    """Return the frequency above which stall cells pass a rake."""
    return LOWEST_CELL_SHARE * rotor_speed_rpm / 60.0


def cell_frequency_hz(record: Record, window: slice, rotor_speed_rpm: float) -> float:
    """Return the rotating-stall frequency: the highest peak of P25's spectrum above surge.

    Where two rakes were read the spectrum is that of their difference, if a line stands out there.
    """
    return _cell_line(record, window, rotor_speed_rpm)[0]


def cell_period_s(record: Record, window: slice, rotor_speed_rpm: float) -> tuple[float, bool]:
    """Return the period of the stall cells, and whether that spectrum shows any."""
    cell_hz, above = _cell_line(record, window, rotor_speed_rpm)
    return (1.0 / cell_hz, True) if above >= LEAST_PEAK else (PLAIN_PERIOD_S, False)


def _cell_line(record: Record, window: slice, rotor_speed_rpm: float) -> tuple[float, float]:
    """Return the highest line above surge in Hz, and how far it stands above what is around it."""
    # A resonance of the ducts is alike at both rakes, and higher than the cells in their mean; in
    # the mean of opposite rakes one cell cancels (its line: 29 000 times what is around it in the
    # difference, 13 in the mean).
    rate, line, lowest_hz = record.sample_rate_hz, (math.nan, 0.0), lowest_cell_hz(rotor_speed_rpm)
    for name in (RAKE_DIFFERENCE, "P25_unfiltered_Pa"):
        if name in record and np.ptp(record[name][window]) > 0.0 and line[1] < LEAST_PEAK:
            frequency, density = power_spectrum(record[name][window], rate)
            cell_hz = peak_frequency_hz(frequency, density, lowest_hz, HIGHEST_SHARE * rate)
            around = density[(frequency > 0.6 * cell_hz) & (frequency < 1.4 * cell_hz)]
            peak = density[np.argmin(np.abs(frequency - cell_hz))]
            line = cell_hz, float(peak / np.median(around))
    return line


def stall_by_shift(
    shift: FloatArray, inside: BoolArray, n_before: int, *, by_median: bool = False
) -> tuple[BoolArray, float]:
    """Return the in-stall state by the hub-minus-tip flow, and how far stall moves that.

    In stall it is beyond the middle between its level before the surge, in ``n_before`` rows, and
    the farther of its two levels ``inside``, whichever immersion passes more; ``by_median`` that is
    the median of all rows where most are in stall.
    """
    unstalled = float(np.median(shift[:n_before])) if n_before else 0.0
    own = shift[inside] - unstalled
    own = np.clip(own, *np.percentile(own, [2.0, 98.0]))
    between = threshold_between(own)
    high, low = float(np.median(own[own >= between])), float(np.median(own[own <= between]))
    sign = 1.0 if high + low > 0.0 else -1.0
    middle, far = sign * float(np.median(own)), max(sign * high, sign * low)
    # Both levels far from that before the surge: the machine never left stall.
    never_left = min(sign * high, sign * low) > 0.4 * far
    if never_left or (by_median and middle > sign * between):
        far = middle
    return np.asarray(sign * (shift - unstalled) > 0.5 * far), far


def hub_tip_stall(record: Record, window: slice, cell_hz: float, known: slice) -> BoolArray | None:
    """Return the in-stall state by the machine itself: in stall hub and tip pass other shares.

    The difference is averaged over one period of the stall cells. None where it hardly moves, or
    where it shows stall in rows that are ``known`` to be unstalled.
    """
    if "Wc25_hub_kg_s" not in record or "Wc25_tip_kg_s" not in record:
        return None
    shift = record["Wc25_hub_kg_s"] - record["Wc25_tip_kg_s"]
    shift = period_average(shift, 1.0 / cell_hz, record.sample_rate_hz)
    inside = _inside(window, shift.size)
    # Matched near stall, hub and tip pass alike before the surge, which a record may begin behind.
    state, far = stall_by_shift(shift, inside, 0, by_median=True)
    largest = float(np.max(record["Wc25_hub_kg_s"] + record["Wc25_tip_kg_s"])) / 2.0
    wrong = 2 * np.count_nonzero(state[known]) > state[known].size
    return None if wrong or far <= LEAST_SHIFT * largest else state


def estimated_threshold_lbm_s(
    record: Record, corrected_kg_s: FloatArray, window: slice, state: BoolArray | None
) -> tuple[float | None, LedgerEntry]:
    """Estimate the corrected flow between the regimes from the record itself.

    The machine shows its state by the shift between hub and tip; the threshold is the middle of
    the flows that divide the rows of the window as that state does, as nearly as the switches
    decide: within one standard error of the fewest rows on the wrong side. Without
    such a shift (``state`` None) it is the flow that leaves the least variance on its two sides
    (Otsu's method), where the flow comes back to a good part of that before surge at all. It is
    None where hardly a row of the window is unstalled.

    The record holds the unfiltered averages; ``corrected_kg_s`` is the filtered flow, which the
    threshold will be applied to.
    """
    flow = corrected_kg_s[window]
    if state is not None:
        unstalled = 1.0 - float(np.mean(state[window]))
        how = "the shift between hub and tip"
    else:
        unstalled = 1.0 if _recovers(record, window) else 0.0
        how = "the spread of the flow"
    parameters: dict[str, str | int | float | bool] = {"origin": "estimated", "by": how}
    if unstalled < LEAST_UNSTALLED:
        did = f"estimated: none, since {how} shows no unstalled regime"
        return None, LedgerEntry("threshold", did, parameters)
    between = threshold_between(flow)
    if state is not None:
        between = _dividing(flow, state[window], _before_surge(record, corrected_kg_s))
    threshold = between / LBM_KG
    parameters["threshold_lbm_s"] = round(threshold, 3)
    did = f"estimated: {threshold:.1f} lbm/s of corrected flow, by {how}"
    return threshold, LedgerEntry("threshold", did, parameters)


def threshold_between(values: FloatArray) -> float:
    """Return the value that leaves the least variance on its two sides (Otsu's method)."""
    ordered = np.sort(values)
    below = np.arange(1, ordered.size)
    sums = np.cumsum(ordered)[:-1]
    gap = (ordered.sum() - sums) / (ordered.size - below) - sums / below
    best = int(np.argmax(below * (ordered.size - below) * gap**2))
    return 0.5 * float(ordered[best] + ordered[best + 1])


def _before_surge(record: Record, corrected_kg_s: FloatArray) -> float:
    """Return a flow that the machine passes unstalled before it surges; inf where no row shows it.

    The median: the swings that lead into the surge may last longer than a twentieth of those rows.
    """
    reversal = first_reversal(record) or 0
    before = corrected_kg_s[: max(reversal - round(SHORTEST_S * record.sample_rate_hz), 0)]
    return float(np.median(before)) if before.size else math.inf


def _dividing(flow: FloatArray, stalled: BoolArray, below: float) -> float:
    """Return the flow, below a limit, that divides rows as their state does.

    As nearly as the switches decide.
    """
    order = np.argsort(flow)
    in_order, upto = flow[order], np.cumsum(stalled[order])
    # Rows that a threshold behind each flow in turn gives the wrong state.
    cost = np.arange(1, flow.size) - 2 * upto[:-1] + upto[-1]
    cost = cost[: max(int(np.searchsorted(in_order, below)), 2) - 1]
    wrong = (flow <= in_order[int(np.argmin(cost))]) != stalled
    # The standard error of their number: those of one stretch are wrong together.
    slack = float(np.linalg.norm(np.diff(intervals_where(wrong), axis=1)))
    good = np.flatnonzero(cost <= cost.min() + slack)
    return 0.5 * float(in_order[good[0]] + in_order[good[-1] + 1])


def segment(
    record: Record, window: slice, *, threshold_lbm_s: float | None, hysteresis_lbm_s: float = 0.0
) -> Record:
    """Mark the in-stall rows and number the in-stall intervals inside the window.

    The record gets ``in_stall`` (0/1), ``window`` (0/1) and ``segment`` (1, 2, …; 0 elsewhere).
    Without a threshold there is no unstalled regime and the window is one segment; it is refused
    where no row of it is in stall.
    """
    n_rows, flow = record.n_samples, record["Wc25_kg_s"]
    inside = _inside(window, n_rows)
    parameters: dict[str, str | int | float | bool] = {"threshold_lbm_s": "none"}
    flags: tuple[str, ...] = ()
    if threshold_lbm_s is None:
        reversal, fitted = first_reversal(record), inside
        state = inside if reversal is None else np.arange(n_rows) >= reversal
        if reversal is None:
            flags = ("the flow never reverses: τ shows only as far as the throttle moves it",)
        elif _recovers(record, window):
            flags = (
                "no unstalled regime was declared; rows after recovery, if any, are in the fit",
            )
    else:
        parameters = {"threshold_lbm_s": threshold_lbm_s, "hysteresis_lbm_s": hysteresis_lbm_s}
        state = in_stall_by_threshold(flow, threshold_lbm_s * LBM_KG, hysteresis_lbm_s * LBM_KG)
        fitted = inside & state
        if state[window].all():
            flags = (
                "all rows in the window are in stall by the threshold: unstalled rows, if any, "
                "are fitted as such",
            )
    labels, short = label_intervals(fitted, round(SHORTEST_S * record.sample_rate_hz))
    n_segments, n_scored = int(labels.max(initial=0)), int(np.count_nonzero(labels))
    if n_segments == 0:
        below = f" below {threshold_lbm_s:.4g} lbm/s" if threshold_lbm_s is not None else ""
        raise InputError(
            f"{record.source}: segmentation",
            expected="in-stall intervals inside the window",
            found=f"none{below}",
            remedy="check the threshold and the window",
        )
    why = f"shorter than {SHORTEST_S * 1e3:g} ms"
    dropped: tuple[Dropped, ...] = (
        (Dropped(counted(len(short), "in-stall interval"), sum(short), why),) if short else ()
    )
    why = "unstalled, or outside the window: simulated, not fitted"
    dropped += (Dropped("rows", n_rows - n_scored, why),)
    did = f"{counted(n_segments, 'segment')} with {n_scored} rows"
    columns = {"in_stall": state, "window": inside, "segment": labels}
    entry = LedgerEntry("segment", did, parameters, dropped, flags)
    return record.after(entry, add=[Channel(n, v.astype(float), "1") for n, v in columns.items()])


def _recovers(record: Record, window: slice) -> bool:
    """Return whether the flow comes back, for 20 ms, to a good part of that before surge."""
    shortest = round(SHORTEST_S * record.sample_rate_hz)
    flow, reversal = record["Wc25_kg_s"], first_reversal(record) or 0
    if reversal < shortest:
        return False
    before = float(np.median(flow[:reversal]))
    back = intervals_where(flow[window] > RECOVERED_SHARE * before)
    return bool(np.any(back[:, 1] - back[:, 0] >= shortest))
