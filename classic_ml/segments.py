"""The quasi-steady surge cycles, and the in-stall intervals inside them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from classic_ml.airflow import LBM_KG
from classic_ml.errors import InputError
from classic_ml.filtering import low_pass, period_average
from classic_ml.records import Channel, Dropped, FloatArray, LedgerEntry, Record
from classic_ml.spectra import peak_frequency_hz, power_spectrum

__all__ = [
    "SurgeCycles",
    "cell_frequency_hz",
    "find_cycles",
    "hub_tip_stall",
    "in_stall_by_threshold",
    "label_intervals",
    "segment",
    "window_rows",
]

# Surge is below 20 Hz; what lies above (cells, noise) must not make peaks of its own.
CYCLE_BAND_HZ = 30.0
# A cycle fills and empties the plenum: P31 rises by at least this share of its mean.
LEAST_SWING = 0.15
# Between deep cycles the machine may oscillate mildly in stall; a cycle has at least this share
# of the deepest one's rise.
DEEP_SHARE = 0.5
# How far a cycle may be from the median of the record and still repeat it.
RISE_SPREAD = 0.3
PERIOD_SPREAD = 0.4
# The inlet heats up after the first reversal; settled when N_c is this near its later median.
SPEED_SPREAD = 0.025
MINIMUM_CYCLES = 3
FEW_CYCLES = 6
# Shorter than 20 ms is a graze of the threshold, not a regime: τ itself is about that long.
SHORTEST_S = 0.02
# Share of the flow before surge that counts as recovery where no threshold says so: the paper's
# 50 lbm/s is 0.45 of the 112 lbm/s near stall.
RECOVERED_SHARE = 0.45


@dataclass(frozen=True)
class SurgeCycles:
    """The repetitive cycles of a record.

    Parameters
    ----------
    from_s, to_s : float
        The window that they fill, on the facility clock, from trough to trough of P31.
    n_cycles : int
        Complete cycles inside.
    period_s : float
        Their median period.
    first_reversal_s : float
        When the flow at plane 25 first ran backwards.
    left_out : int
        Cycles before or after that do not repeat the others.
    """

    from_s: float
    to_s: float
    n_cycles: int
    period_s: float
    first_reversal_s: float
    left_out: int


def find_cycles(record: Record) -> SurgeCycles:
    """Find the quasi-steady surge cycles of a record.

    A cycle is a rise of P31 by at least half of the deepest one's; those that count agree with
    the others in rise, period and corrected speed, and follow one another without a break.

    Parameters
    ----------
    record : Record
        With ``P31_Pa``, ``Wc25_kg_s`` and ``Nc_frac``.

    Returns
    -------
    SurgeCycles
        The window and what is in it.

    Raises
    ------
    InputError
        When there is no surge in the record, or fewer than three such cycles.
    """
    rate = record.sample_rate_hz
    pressure = _slow(record["P31_Pa"], rate)
    start = _first_reversal(record)
    peaks, rises = _deep_peaks(pressure, start)
    if peaks.size == 0:
        raise InputError(
            f"{record.source}: P31",
            expected="surge cycles after the first reversal of the flow",
            found=f"no surge in the record, no rise of P31 by {LEAST_SWING:.0%} of its mean",
        )
    if peaks.size < MINIMUM_CYCLES:
        raise _too_few(record, peaks.size)
    edges = _troughs(pressure, peaks, start)
    good = _repeats(record["Nc_frac"], peaks, rises, edges)
    first, last = _longest_run(good)
    if last - first < MINIMUM_CYCLES:
        raise _too_few(record, last - first)
    time_s = record.time_s
    return SurgeCycles(
        from_s=float(time_s[edges[first]]),
        to_s=float(time_s[edges[last]]),
        n_cycles=last - first,
        period_s=float(np.median(np.diff(peaks[first:last]))) / rate,
        first_reversal_s=float(time_s[start]),
        left_out=int(peaks.size - (last - first)),
    )


def _slow(values: FloatArray, rate_hz: float) -> FloatArray:
    if rate_hz <= 4.0 * CYCLE_BAND_HZ:
        return values
    return low_pass(values, rate_hz, order=3, cutoff_hz=CYCLE_BAND_HZ, phase="zero")


def _first_reversal(record: Record) -> int:
    flow = _slow(record["Wc25_kg_s"], record.sample_rate_hz)
    reversed_rows = np.flatnonzero(flow < 0.0)
    if reversed_rows.size == 0:
        raise InputError(
            f"{record.source}: plane 25",
            expected="reversed flow, with which every deep surge begins",
            found="no surge in the record, the corrected flow stays above "
            f"{flow.min() / LBM_KG:.1f} lbm/s",
        )
    return int(reversed_rows[0])


def _deep_peaks(pressure: FloatArray, start: int) -> tuple[NDArray[np.int64], FloatArray]:
    from scipy.signal import find_peaks

    after = pressure[start:]
    peaks, found = find_peaks(after, prominence=LEAST_SWING * float(np.median(after)))
    rises = np.asarray(found["prominences"], dtype=np.float64)
    if peaks.size == 0:
        return np.zeros(0, dtype=np.int64), rises
    # The second deepest of many, so that one freak cycle does not set the scale.
    scale = np.sort(rises)[-min(2, rises.size)]
    deep = rises >= DEEP_SHARE * scale
    return np.asarray(peaks[deep] + start, dtype=np.int64), rises[deep]


def _troughs(pressure: FloatArray, peaks: NDArray[np.int64], start: int) -> NDArray[np.int64]:
    """Rows of least P31 before, between and after the peaks: one more than there are peaks."""
    period = int(np.median(np.diff(peaks)))
    first = max(start, int(peaks[0]) - period)
    last = min(pressure.size, int(peaks[-1]) + period)
    bounds = [first, *peaks.tolist(), last]
    return np.array([a + int(np.argmin(pressure[a:b])) for a, b in pairwise(bounds)])


def _repeats(
    speed: FloatArray, peaks: NDArray[np.int64], rises: FloatArray, edges: NDArray[np.int64]
) -> NDArray[np.bool_]:
    lengths = np.diff(edges).astype(np.float64)
    speeds = np.array([np.mean(speed[a:b]) for a, b in pairwise(edges)])
    later = speeds[speeds.size // 2 :]
    good = np.abs(rises / np.median(rises) - 1.0) <= RISE_SPREAD
    good &= np.abs(lengths / np.median(np.diff(peaks)) - 1.0) <= PERIOD_SPREAD
    good &= np.abs(speeds - np.median(later)) <= SPEED_SPREAD
    return np.asarray(good)


def _longest_run(good: NDArray[np.bool_]) -> tuple[int, int]:
    """First and one past the last of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.astype(np.int8), [0]))))
    if edges.size == 0:
        return 0, 0
    runs = edges.reshape(-1, 2)
    first, last = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return int(first), int(last)


def _too_few(record: Record, found: int) -> InputError:
    return InputError(
        f"{record.source}: P31",
        expected=f"at least {MINIMUM_CYCLES} surge cycles that repeat each other",
        found=f"{found}",
        remedy="name the window in test.toml ([window] from_s, to_s) if there are more",
    )


def window_rows(
    record: Record, window_s: tuple[float, float], where: str = "window"
) -> NDArray[np.bool_]:
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
    ndarray of bool, shape (n_samples,)
        True inside.
    """
    half = 0.5 * record.sample_period_s
    time_s = record.time_s
    if window_s[0] < time_s[0] - half or window_s[1] > time_s[-1] + half:
        raise InputError(
            where,
            expected=f"a window inside the record ({time_s[0]:.3f} to {time_s[-1]:.3f} s)",
            found=f"{window_s[0]:g} to {window_s[1]:g} s",
        )
    rows = (time_s >= window_s[0] - half) & (time_s <= window_s[1] + half)
    if np.count_nonzero(rows) < SHORTEST_S * record.sample_rate_hz:
        raise InputError(
            where,
            expected="a window with surge cycles in it",
            found=f"{np.count_nonzero(rows)} rows from {window_s[0]:g} to {window_s[1]:g} s",
        )
    return np.asarray(rows)


def in_stall_by_threshold(
    corrected_kg_s: FloatArray, threshold_kg_s: float, hysteresis_kg_s: float = 0.0
) -> NDArray[np.bool_]:
    """Return the in-stall state by a threshold of the corrected inlet flow.

    Parameters
    ----------
    corrected_kg_s : ndarray of shape (n,)
        Corrected flow at plane 25.
    threshold_kg_s : float
        The paper's 50 lbm/s, in kg/s.
    hysteresis_kg_s : float
        Stall begins below threshold − hysteresis and ends above threshold + hysteresis.

    Returns
    -------
    ndarray of bool, shape (n,)
        True in stall. Until the flow first leaves the band, the state is that of its middle.
    """
    decided = np.full(corrected_kg_s.size, -1, dtype=np.int64)
    decided[corrected_kg_s < threshold_kg_s - hysteresis_kg_s] = 1
    decided[corrected_kg_s >= threshold_kg_s + hysteresis_kg_s] = 0
    if decided.size and decided[0] < 0:
        decided[0] = int(corrected_kg_s[0] < threshold_kg_s)
    rows = np.where(decided >= 0, np.arange(decided.size), 0)
    return np.asarray(decided[np.maximum.accumulate(rows)] == 1)


def cell_frequency_hz(record: Record, window: NDArray[np.bool_]) -> float:
    """Return the rotating-stall frequency: the highest peak of P25's spectrum above surge.

    Parameters
    ----------
    record : Record
        With the plane average ``P25_unfiltered_Pa``.
    window : ndarray of bool, shape (n_samples,)
        Rows of the surge cycles.

    Returns
    -------
    float
        Frequency in Hz.
    """
    frequency, density = power_spectrum(record["P25_unfiltered_Pa"][window], record.sample_rate_hz)
    return peak_frequency_hz(frequency, density, 40.0, 0.4 * record.sample_rate_hz)


def hub_tip_stall(record: Record, window: NDArray[np.bool_], cell_hz: float) -> NDArray[np.bool_]:
    """Return the in-stall state by the machine itself: in stall the hub passes more than the tip.

    Parameters
    ----------
    record : Record
        With ``Wc25_hub_kg_s`` and ``Wc25_tip_kg_s``.
    window : ndarray of bool, shape (n_samples,)
        Rows of the surge cycles, whose median difference is the scale.
    cell_hz : float
        Rotating-stall frequency; the difference is averaged over one of its periods.

    Returns
    -------
    ndarray of bool, shape (n_samples,)
        True where the difference is above half its median in the window.
    """
    difference = period_average(
        record["Wc25_hub_kg_s"] - record["Wc25_tip_kg_s"], 1.0 / cell_hz, record.sample_rate_hz
    )
    scale = float(np.median(difference[window]))
    if scale <= 0.0:
        raise InputError(
            f"{record.source}: plane 25",
            expected="more flow at the hub than at the tip while in stall",
            found=f"a median difference of {scale / LBM_KG:.2f} lbm/s",
            remedy='use stall_rule="threshold"',
        )
    return np.asarray(difference > 0.5 * scale)


def label_intervals(
    state: NDArray[np.bool_], least_rows: int
) -> tuple[NDArray[np.int64], list[int]]:
    """Give numbers to the intervals of True.

    Parameters
    ----------
    state : ndarray of bool, shape (n,)
        True inside an interval.
    least_rows : int
        Shorter intervals are left out.

    Returns
    -------
    labels : ndarray of int, shape (n,)
        1, 2, … in the intervals, 0 elsewhere.
    left_out : list of int
        Rows of each interval that was too short.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0], state.astype(np.int8), [0]))))
    labels = np.zeros(state.size, dtype=np.int64)
    left_out, number = [], 0
    for start, stop in edges.reshape(-1, 2):
        if stop - start < least_rows:
            left_out.append(int(stop - start))
            continue
        number += 1
        labels[start:stop] = number
    return labels, left_out


def segment(
    record: Record,
    window: NDArray[np.bool_],
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
    window : ndarray of bool, shape (n_samples,)
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
    parameters: dict[str, str | int | float | bool] = {"stall_rule": stall_rule}
    if threshold_lbm_s is None:
        state = np.arange(record.n_samples) >= _first_reversal(record)
        parameters["threshold_lbm_s"] = "none"
    elif stall_rule == "hub-tip":
        cell_hz = cell_frequency_hz(record, window)
        state = hub_tip_stall(record, window, cell_hz)
        parameters["cell_hz"] = round(cell_hz, 3)
    else:
        state = in_stall_by_threshold(
            record["Wc25_kg_s"], threshold_lbm_s * LBM_KG, hysteresis_lbm_s * LBM_KG
        )
        parameters["threshold_lbm_s"] = threshold_lbm_s
        parameters["hysteresis_lbm_s"] = hysteresis_lbm_s
    inside = window if threshold_lbm_s is None else state & window
    labels, short = label_intervals(inside, round(SHORTEST_S * record.sample_rate_hz))
    if labels.max() == 0:
        raise InputError(
            f"{record.source}: segmentation",
            expected="in-stall intervals inside the window",
            found="none",
            remedy="check the threshold and the window",
        )
    dropped = tuple(
        Dropped("in-stall interval", rows, f"shorter than {SHORTEST_S * 1e3:g} ms")
        for rows in short
    )
    outside = int(np.count_nonzero(labels == 0))
    dropped += (
        Dropped("rows", outside, "unstalled, or outside the window: simulated, not fitted"),
    )
    entry = LedgerEntry(
        "segment",
        f"{labels.max()} segments with {np.count_nonzero(labels)} rows",
        parameters,
        dropped,
        _regime_flags(record, window, state, threshold_lbm_s),
    )
    return record.after(
        entry,
        add=[
            Channel("in_stall", state.astype(np.float64), "1"),
            Channel("window", window.astype(np.float64), "1"),
            Channel("segment", labels.astype(np.float64), "1"),
        ],
    )


def _regime_flags(
    record: Record,
    window: NDArray[np.bool_],
    state: NDArray[np.bool_],
    threshold_lbm_s: float | None,
) -> tuple[str, ...]:
    """Say where rows of an unstalled regime may have been taken for stall."""
    if threshold_lbm_s is None:
        if not _recovers(record, window):
            return ()
        return ("no unstalled regime was declared; rows after recovery, if any, are in the fit",)
    if not state[window].all():
        return ()
    if np.any(record["Wc25_kg_s"][window] >= threshold_lbm_s * LBM_KG):
        return ("all rows in the window are in stall: unstalled rows, if any, are fitted as such",)
    return (
        f"the corrected flow never rises above {threshold_lbm_s:g} lbm/s in the window: unstalled "
        "rows, if any, are fitted as in-stall",
    )


def _recovers(record: Record, window: NDArray[np.bool_]) -> bool:
    """Tell whether the flow comes back, for 20 ms or more, to a good part of that before surge."""
    shortest = round(SHORTEST_S * record.sample_rate_hz)
    before = record["Wc25_kg_s"][: _first_reversal(record)]
    if before.size < shortest:
        return False
    back = window & (record["Wc25_kg_s"] > RECOVERED_SHARE * float(np.median(before)))
    return bool(label_intervals(back, shortest)[0].any())
