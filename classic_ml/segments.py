"""The in-stall intervals inside the window of the surge cycles."""

from __future__ import annotations

import numpy as np

from classic_ml.columns.intervals import intervals_where, labelled, long_ones
from classic_ml.columns.order_statistics import median
from classic_ml.columns.workspace import IN_MEMORY, Workspace, evaluated
from classic_ml.cycles import first_reversal
from classic_ml.filters import period_average
from classic_ml.flow import LBM_KG
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from classic_ml.spectra import peak_frequency_hz, power_spectrum
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray

__all__ = [
    "HUB_LESS_TIP",
    "SHORTEST_S",
    "cell_frequency_hz",
    "hub_tip_difference",
    "hub_tip_stall",
    "in_stall_by_threshold",
    "knows_hub_and_tip",
    "segment",
    "window_rows",
]


# The difference of two plane averages, where it is looked at more often than they are.
HUB_LESS_TIP = "Wc25_hub_less_tip_kg_s"
# Surge and its harmonics are below, stall cells at half the rotor's frequency or so above.
LOWEST_CELL_HZ = 40.0
# Shorter than 20 ms is a graze of the threshold, not a regime: τ itself is about that long.
SHORTEST_S = 0.02
# A record of hours may graze the threshold thousands of times.
NAMED_INTERVALS = 20
# Share of the flow before surge that counts as recovery where no threshold says so: the paper's
# 50 lbm/s is 0.45 of the 112 lbm/s near stall.
RECOVERED_SHARE = 0.45


def window_rows(record: Record, window_s: tuple[float, float], where: str = "window") -> slice:
    """Return the rows of a window, or refuse one that the record does not hold.

    Parameters
    ----------
    record : Record
        For its clock.
    window_s : tuple of float
        First and last time.
    where : str
        What to call the window in an error, e.g. ``"test.toml: [window]"``.

    Returns
    -------
    slice
        Its rows.
    """
    half = 0.5 * record.sample_period_s
    first_s, last_s = record.time_at_s(0), record.time_at_s(record.n_samples - 1)
    if window_s[0] < first_s - half or window_s[1] > last_s + half:
        raise InputError(
            where,
            expected=f"a window inside the record ({first_s:.3f} to {last_s:.3f} s)",
            found=f"{window_s[0]:g} to {window_s[1]:g} s",
        )
    rows = record.rows_between(*window_s)
    if rows.stop - rows.start < SHORTEST_S * record.sample_rate_hz:
        raise InputError(
            where,
            expected="a window with surge cycles in it",
            found=f"{rows.stop - rows.start} rows from {window_s[0]:g} to {window_s[1]:g} s",
        )
    return rows


def in_stall_by_threshold(
    corrected_kg_s: FloatArray,
    threshold_kg_s: float,
    hysteresis_kg_s: float = 0.0,
    *,
    workspace: Workspace = IN_MEMORY,
) -> BoolArray:
    """Return the in-stall state by a threshold of the corrected inlet flow.

    Parameters
    ----------
    corrected_kg_s : ndarray of shape (n,)
        Corrected flow at plane 25.
    threshold_kg_s : float
        The paper's 50 lbm/s, in kg/s.
    hysteresis_kg_s : float
        Stall begins below threshold − hysteresis and ends above threshold + hysteresis.
    workspace : Workspace
        Where the flow lies and the state goes.

    Returns
    -------
    ndarray of bool, shape (n,)
        True in stall. Until the flow first leaves the band, the state is that of its middle.
    """
    last = bool(corrected_kg_s.size and corrected_kg_s[0] < threshold_kg_s)

    def state(rows: slice) -> BoolArray:
        nonlocal last
        flow = corrected_kg_s[rows]
        stalled = flow < threshold_kg_s - hysteresis_kg_s
        if hysteresis_kg_s > 0.0:
            decided = stalled | (flow >= threshold_kg_s + hysteresis_kg_s)
            since = np.maximum.accumulate(np.where(decided, np.arange(flow.size), -1))
            stalled = np.where(since < 0, last, stalled[since])
        last = bool(stalled[-1])
        return stalled

    return evaluated(workspace, corrected_kg_s.size, state, np.bool_)


def cell_frequency_hz(record: Record, window: slice) -> float:
    """Return the rotating-stall frequency: the highest peak of P25's spectrum above surge.

    Parameters
    ----------
    record : Record
        With the plane average ``P25_unfiltered_Pa``.
    window : slice
        Rows of the surge cycles.

    Returns
    -------
    float
        Frequency in Hz.
    """
    frequency, density = power_spectrum(
        record["P25_unfiltered_Pa"][window], record.sample_rate_hz, workspace=record.workspace
    )
    return peak_frequency_hz(frequency, density, LOWEST_CELL_HZ, 0.4 * record.sample_rate_hz)


def knows_hub_and_tip(record: Record) -> bool:
    """Tell whether :func:`hub_tip_difference` can be told of a record."""
    return HUB_LESS_TIP in record or ("Wc25_hub_kg_s" in record and "Wc25_tip_kg_s" in record)


def hub_tip_difference(record: Record) -> FloatArray:
    """Return how much more corrected flow the hub passes than the tip, in kg/s.

    Parameters
    ----------
    record : Record
        With ``Wc25_hub_kg_s`` and ``Wc25_tip_kg_s``, or with ``HUB_LESS_TIP``.
    """
    if HUB_LESS_TIP in record:
        return record[HUB_LESS_TIP]
    hub, tip = record["Wc25_hub_kg_s"], record["Wc25_tip_kg_s"]
    return record.workspace.derived(record.n_samples, lambda rows: hub[rows] - tip[rows])


def hub_tip_stall(record: Record, window: slice, cell_hz: float) -> BoolArray:
    """Return the in-stall state by the machine itself: in stall the hub passes more than the tip.

    Parameters
    ----------
    record : Record
        As for :func:`hub_tip_difference`.
    window : slice
        Rows of the surge cycles, whose median difference is the scale.
    cell_hz : float
        Rotating-stall frequency; the difference is averaged over one of its periods.

    Returns
    -------
    ndarray of bool, shape (n_samples,)
        True where the difference is above half its median in the window.

    Raises
    ------
    InputError
        When that median is not above zero.
    """
    difference = period_average(
        hub_tip_difference(record),
        1.0 / cell_hz,
        record.sample_rate_hz,
        workspace=record.workspace,
    )
    scale = median(difference, window, workspace=record.workspace)
    if scale <= 0.0:
        raise InputError(
            f"{record.source}: plane 25",
            expected="more flow at the hub than at the tip while in stall",
            found=f"a median difference of {scale / LBM_KG:.2f} lbm/s",
            remedy='use stall_rule="threshold"',
        )
    return evaluated(
        record.workspace,
        record.n_samples,
        lambda rows: difference[rows] > 0.5 * scale,
        np.bool_,
    )


def segment(
    record: Record,
    window: slice,
    *,
    threshold_lbm_s: float | None,
    hysteresis_lbm_s: float = 0.0,
    stall_rule: str = "threshold",
) -> Record:
    """Mark the in-stall rows and number the in-stall intervals inside the window.

    Parameters
    ----------
    record : Record
        Plane averages.
    window : slice
        Rows of the quasi-steady cycles.
    threshold_lbm_s : float or None
        Corrected inlet flow between the regimes; None for a record without an unstalled regime,
        whose window is one segment.
    hysteresis_lbm_s : float
        Half width of the band around the threshold.
    stall_rule : {"threshold", "hub-tip"}
        How the state is told: :func:`in_stall_by_threshold` or :func:`hub_tip_stall`.

    Returns
    -------
    Record
        With ``in_stall`` (0/1), ``window`` (0/1) and ``segment`` (1, 2, …; 0 elsewhere).
    """
    place, n_rows = record.workspace, record.n_samples
    parameters: dict[str, str | int | float | bool] = {"stall_rule": stall_rule}
    state = _state(record, window, threshold_lbm_s, hysteresis_lbm_s, parameters)
    stalled = intervals_where(window, lambda rows: state[rows], workspace=place)
    inside = np.array([[window.start, window.stop]]) if threshold_lbm_s is None else stalled
    segments, short = long_ones(inside, round(SHORTEST_S * record.sample_rate_hz))
    if not segments.size:
        raise InputError(
            f"{record.source}: segmentation",
            expected="in-stall intervals inside the window",
            found="none",
            remedy="check the threshold and the window",
        )
    n_scored = int(np.sum(segments[:, 1] - segments[:, 0]))
    why = f"shorter than {SHORTEST_S * 1e3:g} ms"
    dropped = tuple(Dropped("in-stall interval", rows, why) for rows in short[:NAMED_INTERVALS])
    if short[NAMED_INTERVALS:]:
        further = short[NAMED_INTERVALS:]
        dropped += (Dropped(f"{len(further)} more such intervals", sum(further), why),)
    dropped += (
        Dropped(
            "rows",
            n_rows - n_scored,
            "unstalled, or outside the window: simulated, not fitted",
        ),
    )
    entry = LedgerEntry(
        "segment",
        f"{len(segments)} segments with {n_scored} rows",
        parameters,
        dropped,
        _regime_flags(record, window, stalled, threshold_lbm_s),
    )
    whole = np.array([[window.start, window.stop]])
    columns = {
        "in_stall": place.widened(state),
        "window": place.derived(n_rows, lambda rows: labelled(whole, rows).astype(np.float64)),
        "segment": place.widened(
            place.derived(n_rows, lambda rows: labelled(segments, rows), np.int64)
        ),
    }
    return record.after(entry, add=[Channel(n, values, "1") for n, values in columns.items()])


def _state(
    record: Record,
    window: slice,
    threshold_lbm_s: float | None,
    hysteresis_lbm_s: float,
    parameters: dict[str, str | int | float | bool],
) -> BoolArray:
    """Return the in-stall state by the rule that the parameters name, and complete them."""
    if threshold_lbm_s is None:
        start = first_reversal(record)
        parameters["threshold_lbm_s"] = "none"
        return evaluated(
            record.workspace,
            record.n_samples,
            lambda rows: np.arange(rows.start, rows.stop) >= start,
            np.bool_,
        )
    if parameters["stall_rule"] == "hub-tip":
        if not knows_hub_and_tip(record):
            raise InputError(
                f"{record.source}: plane 25",
                expected='probe pairs at hub and tip, which stall_rule="hub-tip" compares',
                found="none at one of them",
                remedy='use stall_rule="threshold"',
            )
        cell_hz = cell_frequency_hz(record, window)
        parameters["cell_hz"] = round(cell_hz, 3)
        return hub_tip_stall(record, window, cell_hz)
    parameters["threshold_lbm_s"] = threshold_lbm_s
    parameters["hysteresis_lbm_s"] = hysteresis_lbm_s
    return in_stall_by_threshold(
        record["Wc25_kg_s"],
        threshold_lbm_s * LBM_KG,
        hysteresis_lbm_s * LBM_KG,
        workspace=record.workspace,
    )


def _regime_flags(
    record: Record, window: slice, stalled: IntArray, threshold_lbm_s: float | None
) -> tuple[str, ...]:
    """Say where rows of an unstalled regime may have been taken for stall."""
    if threshold_lbm_s is None:
        if not _recovers(record, window):
            return ()
        return ("no unstalled regime was declared; rows after recovery, if any, are in the fit",)
    if stalled.tolist() != [[window.start, window.stop]]:
        return ()
    flow = record["Wc25_kg_s"]
    above = intervals_where(
        window,
        lambda rows: flow[rows] >= threshold_lbm_s * LBM_KG,
        workspace=record.workspace,
    )
    if above.size:
        return ("all rows in the window are in stall: unstalled rows, if any, are fitted as such",)
    return (
        f"the corrected flow never rises above {threshold_lbm_s:g} lbm/s in the window: unstalled "
        "rows, if any, are fitted as in-stall",
    )


def _recovers(record: Record, window: slice) -> bool:
    """Tell whether the flow comes back, for 20 ms or more, to a good part of that before surge."""
    shortest = round(SHORTEST_S * record.sample_rate_hz)
    flow, reversal = record["Wc25_kg_s"], first_reversal(record)
    if reversal < shortest:
        return False
    before = median(flow, slice(0, reversal), workspace=record.workspace)
    back = intervals_where(
        window, lambda rows: flow[rows] > RECOVERED_SHARE * before, workspace=record.workspace
    )
    return long_ones(back, shortest)[0].size > 0
