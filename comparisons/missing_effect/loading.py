"""From coefficient series to the rows and fine signals that a diagnosis works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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
from comparisons.missing_effect.excitation import amplitude_of, smooth_channel, surge_frequency_hz
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData
from surge_core.errors import InputError
from surge_core.types import FloatArray, IntArray

# Simulated at the sample step alone, the integration error of surge with harmonics reads as a
# delay (research: distance 4 to 25 standard errors); at four steps to a sample none is left.
FINE_STEPS = 4
TRAIN_SHARE = 0.6
PSI_SHARES = (0.25, 0.75, 0.92)
# A step of P31 by which its part in ψ' is found.
STEP_PA = 100.0
# Rows ahead of a segment that are simulated, so that a late φ is known at its first row.
LEAD_ROWS = 10
# An averaged signal changes little from row to row: four rows to the average lose nothing and
# leave errors whose colour an autoregression can describe.
ROWS_OF_AVERAGE = 4.0


def is_whole(record: CoefficientSeries) -> bool:
    """Return whether a record is taken as a free run from raw counts."""
    return record.psi_p_unfiltered is not None and has_rakes(record)


def load_data(records: Sequence[CoefficientSeries]) -> LagData:
    """Return the rows of one or several records, split into fitted, later and another record.

    The last record, where there are two or more, is never fitted; of the others the last 40 % of
    the scored rows are held out. Records that carry the signals of their probe pairs are taken as
    free runs, as in `compare`.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate.

    Raises
    ------
    InputError
        When they do not go together or hold too few rows.
    """
    check_rates(records)
    ordered = sorted(records, key=lambda record: float(record.time_s[0]))
    whole = all(map(is_whole, ordered))
    if whole:
        data = whole_data(ordered, readings_of(ordered))
    else:
        data = _joined([_segments(record) for record in ordered], [r.source for r in ordered])
    least = 4 * MINIMUM_SEGMENT_ROWS
    for part, what in ((TRAIN, "to fit"), (LATER, "to hold out")):
        if whole and part == LATER:
            # Whole runs leave out cycles, not the last of them.
            continue
        found = int(np.count_nonzero(data.scored(part)))
        if found < least:
            raise InputError(
                ", ".join(data.sources),
                expected=f"at least {least} rows {what}",
                found=f"{found}",
                remedy="take a longer record or wider segments",
            )
    return data


def readings_of(records: Sequence[CoefficientSeries]) -> list[RecordReading]:
    """Read records from raw counts, all with the longest average that one of them asks for."""
    readings = [reading_of(record) for record in records]
    longest = max(readings, key=lambda one: one.spec.average_s).spec
    return [
        replace(one, spec=replace(one.spec, average_s=longest.average_s, guard_s=longest.guard_s))
        for one in readings
    ]


def reading_of(record: CoefficientSeries, degree: int = 2) -> RecordReading:
    """Read a record from raw counts; its stated window, if there is one, holds."""
    signals = rake_signals_of(record)
    assert signals is not None
    stalled = None if record.stalled is None else np.asarray(record.stalled, dtype=np.bool_)
    return RecordReading.of(signals, window_of(record), degree, stalled)


def whole_data(records: Sequence[CoefficientSeries], readings: Sequence[RecordReading]) -> LagData:
    """Return the rows of free runs: all that flow forward, of both branches, are scored."""
    pieces = [_whole_run(*both) for both in zip(records, readings, strict=True)]
    widths = [piece.nuisance[0].shape[1] - 2 for piece in pieces]
    first = np.concatenate([[0], np.cumsum(widths)])
    # The unstalled branch is each record's own, the loss in reversed flow that of the machine.
    for piece, start, width in zip(pieces, first, widths, strict=False):
        own = [np.zeros((run.shape[0], first[-1] + 2)) for run in piece.nuisance]
        for out, run in zip(own, piece.nuisance, strict=True):
            out[:, start : start + width], out[:, -2:] = run[:, :-2], run[:, -2:]
        piece.nuisance = own
    return _joined(pieces, [record.source for record in records])


class _Piece:
    """The runs of one record before they are joined."""

    def __init__(self, every: int, step_s: float, average_s: float = 0.0) -> None:
        self.every, self.step_s, self.average_s = every, step_s, average_s
        self.signals: dict[str, list[FloatArray]] = {}
        self.nuisance: list[FloatArray] = []
        self.measured: list[FloatArray] = []
        self.weight: list[FloatArray] = []
        self.amplitude = self.amplitude_as_is = 0.0


def _segments(record: CoefficientSeries) -> _Piece:
    piece = _Piece(FINE_STEPS, record.sample_period_s / FINE_STEPS)
    spans = []
    for label in np.unique(record.segment[record.segment > 0]):
        rows = np.flatnonzero(record.segment == label)
        spans += np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    # In the order of the clock, whatever the intervals are called: what is held out is later.
    spans = sorted((r for r in spans if r.size >= MINIMUM_SEGMENT_ROWS), key=lambda r: int(r[0]))
    if spans:
        known, piece.amplitude, piece.amplitude_as_is = _record_signals(record)
    for run in spans:
        lead = min(LEAD_ROWS, int(run[0]))
        first, last = int(run[0]) - lead, int(run[-1])
        at = np.arange((last - first) * FINE_STEPS + 1) / FINE_STEPS + first
        for name, evaluate in known.items():
            piece.signals.setdefault(name, []).append(evaluate(at))
        piece.measured.append(record.psi_p[first : last + 1])
        piece.weight.append((np.arange(first, last + 1) >= run[0]).astype(np.float64))
        piece.nuisance.append(np.zeros((at.size, 0)))
    if not piece.measured:
        raise InputError(
            record.source,
            expected=f"a segment of at least {MINIMUM_SEGMENT_ROWS} rows",
            found="none",
            remedy="mark the rows to be fitted in the column 'segment'",
        )
    return piece


def _record_signals(record: CoefficientSeries):  # type: ignore[no-untyped-def]
    """Return each known signal as a function of the row number, and the mean amplitude of φ."""
    from scipy.interpolate import CubicSpline

    rows = np.arange(record.n_samples, dtype=np.float64)
    period_s = record.sample_period_s
    phi = CubicSpline(rows, record.phi)
    amplitude = amplitude_of(record.phi, record.sample_rate_hz)
    as_is = amplitude_of(record.phi, record.sample_rate_hz, prolonged=False)
    smooth = CubicSpline(rows, smooth_channel(record.phi))
    slope = smooth.derivative()
    known = {
        "time_s": lambda at: np.interp(at, rows, record.time_s),
        "phi": phi,
        "phi_smooth": smooth,
        "dphi_s": lambda at: slope(at) / period_s,
        "amplitude": lambda at: np.interp(at, rows, amplitude),
        "amplitude_as_is": lambda at: np.interp(at, rows, as_is),
    }
    if record.T25_K is not None:
        channel = CubicSpline(rows, smooth_channel(record.T25_K))
        rate = channel.derivative()
        known["T25_K"] = channel
        known["dT25_K_s"] = lambda at: rate(at) / period_s
    if record.Nc_frac is not None:
        speed = CubicSpline(rows, smooth_channel(record.Nc_frac))
        known["Nc_frac"] = speed
    if record.in_stall is not None:
        state = record.in_stall.astype(np.float64)
        known["in_stall"] = lambda at: np.interp(at, rows, state)
    used = record.segment > 0
    return known, float(np.mean(amplitude[used])), float(np.mean(as_is[used]))


def _whole_run(record: CoefficientSeries, reading: RecordReading) -> _Piece:
    """Take the free runs through a record; the fine grid is its own rows."""
    passes, spec, signals = reading.passes, reading.spec, reading.signals
    rate_hz, period_s = 1.0 / passes.sample_period_s, passes.period_s
    every = max(1, round(spec.average_s * rate_hz / ROWS_OF_AVERAGE))
    piece = _Piece(every, passes.sample_period_s, spec.average_s)
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
        for name, values in own.items():
            piece.signals.setdefault(name, []).append(values)
        piece.nuisance.append(nuisance[kept])
        piece.measured.append(psi_p[kept][::every])
        piece.weight.append(weight[kept][::every])
    piece.amplitude = piece.amplitude_as_is = float(np.mean(amplitude))
    return piece


def _joined(pieces: Sequence[_Piece], sources: Sequence[str]) -> LagData:
    first = pieces[0]
    names = [n for n in first.signals if all(n in piece.signals for piece in pieces)]
    measured = [run for piece in pieces for run in piece.measured]
    fine = [run for piece in pieces for run in piece.signals["phi"]]
    weight = np.concatenate([run for piece in pieces for run in piece.weight])
    record = np.concatenate(
        [np.full(run.size, i) for i, piece in enumerate(pieces) for run in piece.measured]
    )
    runs, fine_runs = _bounds(measured), _bounds(fine)
    rows = np.concatenate(
        [
            start + np.arange(run.size) * first.every
            for (start, _), run in zip(fine_runs, measured, strict=True)
        ]
    )
    nuisance = np.concatenate([run for piece in pieces for run in piece.nuisance])
    moving = np.ptp(nuisance, axis=0) > 1e-9
    signals = {name: np.concatenate([r for p in pieces for r in p.signals[name]]) for name in names}
    part = _parts(record, weight, len(pieces))
    fitted = signals["phi"][rows[(part == TRAIN) & (weight > 0.0)]]
    return LagData(
        signals,
        np.ascontiguousarray(nuisance[:, moving]),
        np.concatenate(measured),
        weight,
        part,
        record,
        rows,
        runs,
        fine_runs,
        first.step_s,
        first.every,
        first.average_s,
        float(np.mean([piece.amplitude for piece in pieces])),
        float(np.mean([piece.amplitude_as_is for piece in pieces])),
        float(np.mean(signals["Nc_frac"])) if "Nc_frac" in signals else 1.0,
        (float(fitted.min()), float(fitted.max())),
        _clock_zero_s(signals["time_s"]),
        0.5 * float(signals["time_s"][0] + signals["time_s"][-1]),
        _surge_s(signals["phi"], fine_runs, first.step_s),
        _levels(np.concatenate(measured)[weight > 0.0]),
        tuple(sources),
        bool(first.average_s > 0.0 and moving[-2] and moving[-1]),
    )


def _clock_zero_s(time_s: FloatArray) -> float:
    """Return the zero of the clock: the first row where it began long before the records."""
    first, span = float(time_s[0]), float(np.ptp(time_s))
    return 0.0 if 0.0 <= first <= 3.0 * span else first


def _surge_s(phi: FloatArray, runs: IntArray, step_s: float) -> float:
    start, stop = max(runs, key=lambda run: run[1] - run[0])
    surge_hz = surge_frequency_hz(phi[start:stop], 1.0 / step_s)
    return 1.0 / surge_hz if surge_hz > 0.0 else float((stop - start) * step_s)


def _levels(measured: FloatArray) -> tuple[float, float, float]:
    low, high, highest = np.quantile(measured, PSI_SHARES)
    return float(low), float(high), float(highest)


def _bounds(runs: Sequence[FloatArray]) -> IntArray:
    ends = np.cumsum([run.size for run in runs])
    return np.column_stack([np.concatenate([[0], ends[:-1]]), ends]).astype(np.int64)


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
