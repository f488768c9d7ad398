"""From coefficient series to the rows and fine signals of a diagnosis, and what φ did in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from classic_ml.filters import period_average
from classic_ml.record_reading import RecordReading
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record.branches import design, has_loss, scored_rows
from classic_ml.whole_record.rakes import rake_signals_of
from classic_ml.whole_record_run import has_rakes, window_of
from classic_ml.whole_run import check_rates
from comparisons.harness.rows import MINIMUM_SEGMENT_ROWS
from comparisons.missing_effect.lag_data import (
    LATER,
    OTHER,
    TRAIN,
    FrozenReferences,
    LagData,
    Run,
    laid_out,
)
from comparisons.missing_effect.noise import white_part
from surge_core.errors import require
from surge_core.segments import runs_of
from surge_core.types import FloatArray, IntArray

# Simulated at the sample step alone, the integration error of surge with harmonics reads as a
# delay (research: distance 4 to 25 standard errors); at four steps to a sample none is left.
FINE_STEPS = 4
TRAIN_SHARE = 0.6
PSI_SHARES = (0.25, 0.75, 0.92)
# A step of P31 by which its part in ψ' is found.
STEP_PA = 100.0
# Signals whose slope is one too.
RATES = {"phi_smooth": "dphi_s", "T25_K": "dT25_K_s"}
# Rows ahead of a segment that are simulated, so that a late φ is known at its first row.
LEAD_ROWS = 10
# An averaged signal changes little from row to row: four rows to the average lose nothing and
# leave errors whose colour an autoregression can describe.
ROWS_OF_AVERAGE = 4.0
# A block of errors holds at least one surge cycle, or it is not independent of the next.
CYCLES_OF_BLOCK = 1.0
LEAST_BLOCK_ROWS = 15
MOST_BLOCK_SHARE = 1.0 / 12.0
# Share of the surge frequency below which its amplitude is taken to change.
AMPLITUDE_BAND = 0.25
# Resolution of the amplitude, and how much of it is predicted at each end.
POINTS_PER_CYCLE = 48.0
LEAD_CYCLES = 8.0
MOST_PREDICTORS = 160
# A channel whose sample-to-sample noise is below this share of its range is left as it is.
CLEAN_SHARE = 2e-4
LONGEST_WINDOW = 201
# What a window takes off may exceed the noise by this factor, or it took signal too.
MOST_REMOVED = 1.04


def is_whole(record: CoefficientSeries) -> bool:
    """Return whether a record is taken as a free run from raw counts."""
    return record.psi_p_unfiltered is not None and has_rakes(record)


def load_data(records: Sequence[CoefficientSeries]) -> LagData:
    """Return the rows of one or several records, split into fitted, later and another record.

    The last record, where there are two or more, is never fitted; of the others the last 40 % of
    the scored rows are held out. Records that carry the signals of their probe pairs are taken as
    free runs, as in `compare`. Records that do not go together or hold too few rows are refused.
    """
    check_rates(records)
    ordered = sorted(records, key=lambda record: float(record.time_s[0]))
    whole = all(map(is_whole, ordered))
    if whole:
        data = whole_data(ordered, readings_of(ordered))
    else:
        pieces = [_segments(record) for record in ordered]
        step_s = ordered[0].sample_period_s / FINE_STEPS
        data = _joined(pieces, [r.source for r in ordered], FINE_STEPS, step_s)
    least = 4 * MINIMUM_SEGMENT_ROWS
    for part, what in ((TRAIN, "to fit"), (LATER, "to hold out")):
        if whole and part == LATER:
            # Whole runs leave out cycles, not the last of them.
            continue
        found = int(np.count_nonzero(data.scored(part)))
        where, expected = ", ".join(data.sources), f"at least {least} rows {what}"
        remedy = "take a longer record or wider segments"
        require(found >= least, where, expected, f"{found}", remedy)
    return data


def readings_of(records: Sequence[CoefficientSeries]) -> list[RecordReading]:
    """Read records from raw counts, all with the longest average that one of them asks for."""
    readings = [reading_of(record) for record in records]
    longest = max(readings, key=lambda one: one.spec.average_s).spec
    return [
        replace(one, spec=replace(one.spec, average_s=longest.average_s, guard_s=longest.guard_s))
        for one in readings
    ]


def reading_of(record: CoefficientSeries) -> RecordReading:
    """Read a record from raw counts; its stated window, if there is one, holds."""
    signals = rake_signals_of(record)
    assert signals is not None
    stalled = None if record.stalled is None else np.asarray(record.stalled, dtype=np.bool_)
    return RecordReading.of(signals, window_of(record), stalled=stalled)


def whole_data(records: Sequence[CoefficientSeries], readings: Sequence[RecordReading]) -> LagData:
    """Return the rows of free runs: all that flow forward, of both branches, are scored."""
    found = [_whole_runs(*both) for both in zip(records, readings, strict=True)]
    widths = [runs[0].nuisance.shape[1] - 2 for runs, _ in found]
    # The unstalled branch is each record's own, the loss in reversed flow that of the machine.
    pieces = []
    for i, (runs, amplitudes) in enumerate(found):
        beside = (sum(widths[:i]), sum(widths[i + 1 :]))
        laid = []
        for run in runs:
            own, shared = np.split(run.nuisance, [-2], axis=1)
            nuisance = np.column_stack([np.pad(own, ((0, 0), beside)), shared])
            laid.append(replace(run, nuisance=nuisance))
        pieces.append((laid, amplitudes))
    passes, average_s = readings[0].passes, readings[0].spec.average_s
    sources = [record.source for record in records]
    return _joined(pieces, sources, _every(readings[0]), passes.sample_period_s, average_s)


# The runs of a record, and the mean amplitude of φ with its ends prolonged and as they stand.
_Piece: TypeAlias = tuple[list[Run], tuple[float, float]]


def _segments(record: CoefficientSeries) -> _Piece:
    # In the order of the clock, whatever the intervals are called: what is held out is later.
    spans = [
        span
        for span in runs_of(record.segment, record.n_samples)
        if record.segment[span.start] > 0 and span.stop - span.start >= MINIMUM_SEGMENT_ROWS
    ]
    expected = f"a segment of at least {MINIMUM_SEGMENT_ROWS} rows"
    remedy = "mark the rows to be fitted in the column 'segment'"
    require(bool(spans), record.source, expected, "none", remedy)
    known, amplitudes = _record_signals(record)
    runs = []
    for span in spans:
        first = max(span.start - LEAD_ROWS, 0)
        fine = slice(first * FINE_STEPS, (span.stop - 1) * FINE_STEPS + 1)
        runs.append(
            Run(
                {name: values[fine] for name, values in known.items()},
                np.zeros((fine.stop - fine.start, 0)),
                record.psi_p[first : span.stop],
                (np.arange(first, span.stop) >= span.start).astype(np.float64),
            )
        )
    return runs, amplitudes


def _record_signals(record: CoefficientSeries) -> tuple[dict[str, FloatArray], tuple[float, float]]:
    """Return each known signal of a record on the fine grid, and the mean amplitudes of φ."""
    from scipy.interpolate import CubicSpline

    rows = np.arange(record.n_samples, dtype=np.float64)
    fine = np.arange((record.n_samples - 1) * FINE_STEPS + 1) / FINE_STEPS
    amplitude = amplitude_of(record.phi, record.sample_rate_hz)
    as_is = amplitude_of(record.phi, record.sample_rate_hz, prolonged=False)
    straight = {"time_s": record.time_s, "amplitude": amplitude, "amplitude_as_is": as_is}
    if record.in_stall is not None:
        straight["in_stall"] = record.in_stall.astype(np.float64)
    known = {name: np.interp(fine, rows, values) for name, values in straight.items()}
    known["phi"] = CubicSpline(rows, record.phi)(fine)
    channels = {"phi_smooth": record.phi, "T25_K": record.T25_K, "Nc_frac": record.Nc_frac}
    for name, channel in channels.items():
        if channel is None:
            continue
        smooth = CubicSpline(rows, smooth_channel(channel))
        known[name] = smooth(fine)
        if name in RATES:
            known[RATES[name]] = smooth.derivative()(fine) / record.sample_period_s
    used = record.segment > 0
    return known, (float(np.mean(amplitude[used])), float(np.mean(as_is[used])))


def _every(reading: RecordReading) -> int:
    return max(1, round(reading.spec.average_s / reading.passes.sample_period_s / ROWS_OF_AVERAGE))


def _whole_runs(record: CoefficientSeries, reading: RecordReading) -> _Piece:
    """Take the free runs through a record; the fine grid is its own rows."""
    passes, spec, signals = reading.passes, reading.spec, reading.signals
    rate_hz, period_s = 1.0 / passes.sample_period_s, passes.period_s
    every, runs = _every(reading), []
    inputs, psi_p = design(passes, spec, reading.in_stall)
    nuisance = inputs[:, spec.degree + 1 :]
    if not has_loss(passes):
        nuisance = np.column_stack([nuisance, np.zeros((passes.phi.size, 2))])
    phi, _, speed = signals.coefficients(passes.planes)
    amplitude = amplitude_of(period_average(phi, period_s, rate_hz), rate_hz)[passes.row]
    averaged = passes.smooth(passes.phi, spec.average_s)
    # Averaged over the cells too, or the noise of dφ/dt, which ψ' shares, explains itself.
    slow = passes.smooth(passes.phi, period_s)
    more = replace(passes.planes, exit_Pa=passes.planes.exit_Pa + STEP_PA)
    per_Pa = (signals.coefficients(more)[1][passes.row] - passes.psi_p) / STEP_PA
    signal = {
        "time_s": record.time_s[passes.row],
        "phi": passes.phi,
        "phi_averaged": averaged,
        "phi_smooth": averaged,
        "amplitude": amplitude,
        "amplitude_as_is": amplitude,
        "stalled": passes.smooth(reading.in_stall.astype(np.float64), spec.blend_s),
        "Nc_frac": period_average(speed, period_s, rate_hz)[passes.row],
        "exit_Pa": passes.planes.exit_Pa[passes.row],
        "psi_p_per_Pa": np.where(np.isfinite(per_Pa), per_Pa, 0.0),
    }
    if record.T25_K is not None:
        signal["T25_K"] = period_average(record.T25_K, period_s, rate_hz)[passes.row]
    weight = scored_rows(passes, spec).astype(np.float64)
    for run in passes.pieces:
        kept = slice(run.start, run.start + (run.stop - run.start - 1) // every * every + 1)
        own = {name: np.ascontiguousarray(values[kept]) for name, values in signal.items()}
        own["dphi_s"] = np.gradient(slow[kept], passes.sample_period_s)
        if "T25_K" in own:
            own["dT25_K_s"] = np.gradient(own["T25_K"], passes.sample_period_s)
        samples = slice(kept.start, kept.stop, every)
        runs.append(Run(own, nuisance[kept], psi_p[samples], weight[samples]))
    return runs, (float(np.mean(amplitude)),) * 2


def _joined(
    pieces: Sequence[_Piece],
    sources: Sequence[str],
    every: int,
    step_s: float,
    average_s: float = 0.0,
) -> LagData:
    made = laid_out([run for runs, _ in pieces for run in runs], every)
    signals, weight, nuisance = made["signals"], made["weight"], made["nuisance"]
    sizes = [sum(run.measured.size for run in runs) for runs, _ in pieces]
    record = np.repeat(np.arange(len(pieces)), sizes)
    moving = np.ptp(nuisance, axis=0) > 1e-9
    part = _parts(record, weight, len(pieces))
    fitted = signals["phi"][made["rows"][(part == TRAIN) & (weight > 0.0)]]
    amplitude, as_is = np.mean([amplitudes for _, amplitudes in pieces], axis=0).tolist()
    clock = signals["time_s"]
    return LagData(
        **{**made, "nuisance": np.ascontiguousarray(nuisance[:, moving])},
        part=part,
        record=record,
        step_s=step_s,
        every=every,
        average_s=average_s,
        references=FrozenReferences(
            amplitude,
            as_is,
            float(np.mean(signals["Nc_frac"])) if "Nc_frac" in signals else 1.0,
            (float(fitted.min()), float(fitted.max())),
            _clock_zero_s(clock),
        ),
        middle_s=0.5 * float(clock[0] + clock[-1]),
        surge_s=_surge_s(signals["phi"], made["fine_runs"], step_s),
        psi_levels=tuple(np.quantile(made["measured"][weight > 0.0], PSI_SHARES).tolist()),
        sources=tuple(sources),
        has_reverse_loss=bool(average_s > 0.0 and moving[-2] and moving[-1]),
    )


def _clock_zero_s(time_s: FloatArray) -> float:
    """Return the zero of the clock: the first row where it began long before the records."""
    first, span = float(time_s[0]), float(np.ptp(time_s))
    return 0.0 if 0.0 <= first <= 3.0 * span else first


def _surge_s(phi: FloatArray, runs: IntArray, step_s: float) -> float:
    start, stop = max(runs, key=lambda run: run[1] - run[0])
    surge_hz = surge_frequency_hz(phi[start:stop], 1.0 / step_s)
    return 1.0 / surge_hz if surge_hz > 0.0 else float((stop - start) * step_s)


def _parts(record: IntArray, weight: FloatArray, n_records: int) -> NDArray[np.int8]:
    part = np.full(record.size, LATER, dtype=np.int8)
    for i in range(n_records):
        rows = np.flatnonzero(record == i)
        if n_records > 1 and i == n_records - 1:
            part[rows] = OTHER
            continue
        scored = np.cumsum(weight[rows])
        part[rows[scored <= TRAIN_SHARE * scored[-1]]] = TRAIN
    return part


def surge_frequency_hz(phi: FloatArray, sample_rate_hz: float) -> float:
    """Return the frequency of the strongest line of φ, at least one cycle in the record."""
    centred = (phi - phi.mean()) * np.hanning(phi.size)
    power = np.abs(np.fft.rfft(centred, 4 * phi.size)) ** 2
    frequency = np.fft.rfftfreq(4 * phi.size, 1.0 / sample_rate_hz)
    power[frequency < 2.0 * sample_rate_hz / phi.size] = 0.0
    return float(frequency[np.argmax(power)])


def amplitude_of(phi: FloatArray, sample_rate_hz: float, *, prolonged: bool = True) -> FloatArray:
    """Return the amplitude of the analytic signal of φ, low-passed well below the surge frequency.

    Both ends of the record are prolonged by linear prediction first, unless it is to be taken as it
    stands: the analytic signal and the low-pass look many cycles ahead and back, and what they
    would make of an end is wrong by tens of percent.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, hilbert, sosfiltfilt

    surge_hz = surge_frequency_hz(phi, sample_rate_hz)
    if surge_hz == 0.0:
        return np.full(phi.size, float(np.std(phi)) * np.sqrt(2.0))
    every = max(1, int(sample_rate_hz / (POINTS_PER_CYCLE * surge_hz)))
    rate_hz = sample_rate_hz / every
    coarse = _means(phi - phi.mean(), every)
    lead = round(LEAD_CYCLES * rate_hz / surge_hz) if prolonged else 0
    envelope = np.abs(hilbert(_prolonged(coarse, lead) if prolonged else coarse))
    corner = AMPLITUDE_BAND * surge_hz / (0.5 * rate_hz)
    slow = sosfiltfilt(butter(2, corner, output="sos"), envelope)[lead : lead + coarse.size]
    at = (np.arange(coarse.size) + 0.5) * every - 0.5
    rows = np.arange(phi.size, dtype=np.float64)
    return np.asarray(CubicSpline(at, slow)(np.clip(rows, at[0], at[-1])))


def _means(values: FloatArray, every: int) -> FloatArray:
    n = values.size // every
    return np.asarray(values[: n * every].reshape(n, every).mean(axis=1))


def _prolonged(values: FloatArray, lead: int) -> FloatArray:
    """Return a signal with both ends prolonged by what an autoregression predicts (Burg)."""
    from scipy.signal import lfilter, lfiltic

    order = min(MOST_PREDICTORS, values.size // 3)
    a = _burg(values, order)
    ends = []
    for known in (values, values[::-1]):
        state = lfiltic([1.0], a, known[::-1][:order])
        ends.append(lfilter([1.0], a, np.zeros(lead), zi=state)[0])
    return np.concatenate([ends[1][::-1], values, ends[0]])


def _burg(values: FloatArray, order: int) -> FloatArray:
    """Return the prediction-error filter 1, a_1 … a_p that Burg's recursion finds; it is stable."""
    forward, backward = values[1:].copy(), values[:-1].copy()
    a = np.array([1.0])
    for _ in range(order):
        power = float(forward @ forward + backward @ backward)
        if power <= 1e-24 * float(values @ values):
            break
        k = -2.0 * float(forward @ backward) / power
        a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return a


def smooth_channel(values: FloatArray) -> FloatArray:
    """Return a slow channel with its noise taken off, as far as it has any.

    The noise is found from fourth differences; the window of the local cubics grows until what is
    left of it is small beside the channel's own changes from row to row.
    """
    from scipy.signal import savgol_filter

    noise = white_part(values)
    spread = float(np.ptp(values))
    if spread == 0.0 or noise <= CLEAN_SHARE * spread:
        return values
    best = values
    for window in (7, 15, 31, 61, 101, LONGEST_WINDOW):
        if window > values.size // 4:
            break
        trial = savgol_filter(values, window, 3)
        # Once the window cuts into the signal itself, more than noise goes.
        if float(np.std(values - trial)) > MOST_REMOVED * noise:
            break
        best = trial
    return np.asarray(best)


def block_rows(data: LagData) -> int:
    """Return how many scored rows make a block: a surge cycle, and enough blocks."""
    longest = max(data.fine_runs, key=lambda run: run[1] - run[0])
    phi = data["phi"][longest[0] : longest[1] : data.every]
    surge_hz = surge_frequency_hz(phi, 1.0 / data.sample_period_s)
    share = float(np.mean(data.weight > 0.0))
    cycle = CYCLES_OF_BLOCK * share / (max(surge_hz, 1e-9) * data.sample_period_s)
    most = MOST_BLOCK_SHARE * float(np.count_nonzero(data.weight))
    return int(max(LEAST_BLOCK_ROWS, min(cycle, most)))
