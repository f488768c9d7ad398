"""Where a simulated run and its measurement part: over time, over frequency, over a signal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.systems.results import CheckRun, FoundEffect
from comparisons.missing_effect.systems.roles import measured_as
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.model import Model

__all__ = ["BandRow", "SignalRow", "SystemWhere", "TimeRow", "where_of", "worst_output"]

TIME_BLOCKS = 40
SIGNAL_BINS = 20
BANDS = 24
# A bin with fewer rows has no mean to speak of; it is joined to its neighbour.
FEWEST_IN_BIN, FEWEST_SHARE = 8, 0.002
# Welch's segments: an eighth of the run, as long as that is enough to tell a few periods.
SEGMENT_SHARE, SHORTEST_SEGMENT = 8, 256
SIGNAL_KEYS = ("signal", "input", "sensor", "state")


@dataclass(frozen=True)
class TimeRow:
    """A block of a run.

    Parameters
    ----------
    from_s, to_s : float
        Clock at its ends, in seconds.
    n : int
        Rows.
    before_rms, after_rms : float
        Of the residual, in the unit of the output.
    """

    from_s: float
    to_s: float
    n: int
    before_rms: float
    after_rms: float


@dataclass(frozen=True)
class BandRow:
    """A band of frequencies.

    Parameters
    ----------
    low_hz, high_hz : float
        Edges.
    before_psd, after_psd, measured_psd : float
        Mean power density of the residuals and of the measured output, each less its mean, in
        the squared unit of the output a hertz.
    """

    low_hz: float
    high_hz: float
    before_psd: float
    after_psd: float
    measured_psd: float


@dataclass(frozen=True)
class SignalRow:
    """A range of a signal.

    Parameters
    ----------
    low, high, at : float
        Its ends, and the mean of the signal between them.
    n : int
        Rows.
    before_mean, after_mean : float
        Of the residual, in the unit of the output.
    before_stderr, after_stderr : float
        From the sums of forty blocks of time, since errors of neighbouring rows go together; NaN
        where the signal was there in one block alone.
    before_rising, before_falling, after_rising, after_falling : float
        The same means while the signal rises and while it falls; NaN where it does not.
    """

    low: float
    high: float
    at: float
    n: int
    before_mean: float
    before_stderr: float
    after_mean: float
    after_stderr: float
    before_rising: float
    before_falling: float
    after_rising: float
    after_falling: float


@dataclass(frozen=True)
class SystemWhere:
    """Where the residual of one output in one run stands out, before and after.

    Parameters
    ----------
    record, output, signal : str
        Names of the run, of the output, and of what the third panel is laid over.
    simulated : bool
        Whether that signal is the output itself, simulated. Residuals are part of a measured
        output: laid over that, noise alone gives a slope.
    time : tuple of TimeRow
        About forty blocks.
    frequency : tuple of BandRow
        Bands of a Welch spectrum, spaced logarithmically.
    flow : tuple of SignalRow
        About twenty ranges of the signal, on both sides of zero.
    """

    record: str
    output: str
    signal: str
    simulated: bool
    time: tuple[TimeRow, ...]
    frequency: tuple[BandRow, ...]
    flow: tuple[SignalRow, ...]

    def to_json(self) -> dict[str, list[dict[str, Any]]]:
        """Return the rows of each panel as plain dictionaries; None for what is not known.

        Returns
        -------
        dict
            ``{"time": [...], "frequency": [...], "flow": [...]}``; each row tells its record and
            its output, and those of ``flow`` the signal.
        """
        own = {"record": self.record, "output": self.output}
        over = {"signal": self.signal, "simulated": self.simulated}
        return {
            "time": [own | _plain(asdict(row)) for row in self.time],
            "frequency": [own | _plain(asdict(row)) for row in self.frequency],
            "flow": [own | over | _plain(asdict(row)) for row in self.flow],
        }


def where_of(
    check: CheckRun,
    effects: Sequence[FoundEffect] = (),
    *,
    output: str | None = None,
    model: Model | None = None,
) -> SystemWhere:
    """Return where the residuals of a run stand out.

    Parameters
    ----------
    check : CheckRun
        A run, simulated without and with what was added.
    effects : sequence of FoundEffect
        What was added: the signal of the first one whose signal is measured is looked at.
    output : str, optional
        Name of the output; without it the one that the model before misses most, against its own
        swing.
    model : Model, optional
        Tells which states are measured under another name.

    Returns
    -------
    SystemWhere

    Raises
    ------
    InputError
        When the run has no such output.
    """
    chosen = worst_output(check) if output is None else output
    if chosen not in check.outputs:
        raise InputError(
            f"{check.experiment.name}: output",
            expected=f"one of {', '.join(check.outputs)}",
            found=repr(chosen),
        )
    column = check.outputs.index(chosen)
    scored = slice(check.settle, None)
    measured = check.measured[scored, column]
    before = measured - check.before[scored, column]
    after = measured - check.after[scored, column]
    there = np.isfinite(measured)
    signal, values = _signal(check, effects, chosen, model)
    own = signal == chosen
    if own:
        values = _simulated(check, column)
    bridged = [_bridged(v, there) for v in (before, after, measured)]
    period_s = check.experiment.sample_period_s
    first_s = check.experiment.first_s + check.settle * period_s
    return SystemWhere(
        check.experiment.name,
        chosen,
        signal,
        own,
        _over_time(before, after, first_s, period_s),
        _over_frequency(bridged, period_s),
        _over_signal(before[there], after[there], values[scored][there]),
    )


def worst_output(check: CheckRun) -> str:
    """Return the output that the model before misses most, against its own swing.

    Parameters
    ----------
    check : CheckRun
        A run.
    """
    swing = np.nanstd(check.measured[check.settle :], axis=0)
    share = check.before_rms / np.where(swing > 0.0, swing, 1.0)
    return check.outputs[int(np.argmax(np.where(np.isfinite(share), share, np.inf)))]


def _signal(
    check: CheckRun, effects: Sequence[FoundEffect], output: str, model: Model | None
) -> tuple[str, FloatArray]:
    """Return the signal of an effect as far as it is measured; the output where none is."""
    channels = check.experiment.channels
    also = {}
    if model is not None:
        also = {model.state_names[i]: name for i, name in measured_as(model).items()}
    for effect in effects:
        for key in SIGNAL_KEYS:
            if key not in effect.place:
                continue
            name = effect.place[key]
            # A state may share its name with an output that is something else.
            channel = also.get(name, "" if _is_state(name, model) else name)
            if channel in channels:
                return channel, channels[channel]
            break
    return output, channels[output]


def _is_state(name: str, model: Model | None) -> bool:
    return model is not None and name in model.states


def _simulated(check: CheckRun, column: int) -> FloatArray:
    for run in (check.after, check.before):
        if np.all(np.isfinite(run[:, column])):
            return np.asarray(run[:, column])
    return np.asarray(check.measured[:, column])


def _over_time(
    before: FloatArray, after: FloatArray, first_s: float, period_s: float
) -> tuple[TimeRow, ...]:
    rows = []
    for block in _blocks(before.size):
        start, stop = int(block[0]), int(block[-1]) + 1
        rows.append(
            TimeRow(
                first_s + start * period_s,
                first_s + stop * period_s,
                stop - start,
                _rms(before[start:stop]),
                _rms(after[start:stop]),
            )
        )
    return tuple(rows)


def _blocks(n: int) -> list[NDArray[np.int64]]:
    return [b for b in np.array_split(np.arange(n), min(TIME_BLOCKS, n)) if b.size]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.any(np.isfinite(values)) else np.nan


def _bridged(values: FloatArray, there: BoolArray) -> FloatArray:
    """Return values with straight lines over the rows without a reading."""
    rows = np.arange(values.size, dtype=np.float64)
    return np.interp(rows, rows[there], values[there])


def _over_frequency(curves: Sequence[FloatArray], period_s: float) -> tuple[BandRow, ...]:
    from scipy.signal import welch

    n = curves[0].size
    segment = min(n, max(SHORTEST_SEGMENT, n // SEGMENT_SHARE))
    power = []
    for values in curves:
        # The mean of the whole is taken off, not that of each segment: slow drift must show.
        frequency, own = welch(
            values - np.mean(values), 1.0 / period_s, "hann", nperseg=segment, detrend=False
        )
        power.append(own)
    return tuple(
        BandRow(float(low), float(high), *(float(np.mean(own[inside])) for own in power))
        for low, high, inside in _bands(frequency)
    )


def _bands(frequency: FloatArray) -> list[tuple[float, float, NDArray[np.bool_]]]:
    """Return bands between edges that fall halfway between bins, wider by a factor each."""
    step = float(frequency[1])
    wanted = np.geomspace(1.5 * step, float(frequency[-1]), BANDS)
    edges = np.unique((np.floor(wanted / step) + 0.5) * step)
    edges = np.concatenate([[0.0], edges[edges < frequency[-1]], [frequency[-1]]])
    found = []
    for low, high in pairwise(edges.tolist()):
        inside = (frequency >= low) & (frequency <= high)
        if np.any(inside):
            found.append((low, high, inside))
    return found


def _over_signal(
    before: FloatArray, after: FloatArray, signal: FloatArray
) -> tuple[SignalRow, ...]:
    block = np.concatenate([np.full(b.size, i) for i, b in enumerate(_blocks(signal.size))])
    slope = np.gradient(signal)
    rows = []
    for low, high, inside in _bins(signal):
        rising, falling = inside & (slope > 0.0), inside & (slope < 0.0)
        rows.append(
            SignalRow(
                low,
                high,
                float(np.mean(signal[inside])),
                int(np.count_nonzero(inside)),
                *_mean(before[inside], block[inside]),
                *_mean(after[inside], block[inside]),
                *(_mean_of(values[way]) for values in (before, after) for way in (rising, falling)),
            )
        )
    return tuple(rows)


def _bins(signal: FloatArray) -> list[tuple[float, float, NDArray[np.bool_]]]:
    """Return ranges of one width over the signal's own, joined where there are few rows."""
    low, high = float(signal.min()), float(signal.max())
    if not high > low:
        return [(low, high, np.ones(signal.size, dtype=bool))]
    edges = np.linspace(low, high, SIGNAL_BINS + 1)
    count = np.histogram(signal, edges)[0]
    fewest = max(FEWEST_IN_BIN, FEWEST_SHARE * signal.size)
    kept, held = [low], 0
    for edge, n in zip(edges[1:], count, strict=True):
        held += int(n)
        if held >= fewest:
            kept.append(float(edge))
            held = 0
    # What is left at the upper end goes to the last range.
    kept = [*kept[:-1], high] if len(kept) > 1 else [low, high]
    which = np.clip(np.searchsorted(kept, signal, side="right") - 1, 0, len(kept) - 2)
    return [(kept[i], kept[i + 1], which == i) for i in range(len(kept) - 1)]


def _mean(values: FloatArray, block: NDArray[np.int64]) -> tuple[float, float]:
    """Return a mean and its standard error from the sums of its blocks."""
    mean = float(np.mean(values))
    own = np.unique(block)
    if own.size < 2:
        return mean, math.nan
    sums = np.array([np.sum(values[block == b] - mean) for b in own])
    variance = float(sums @ sums) * own.size / (own.size - 1)
    return mean, math.sqrt(variance) / values.size


def _mean_of(values: FloatArray) -> float:
    return float(np.mean(values)) if values.size >= FEWEST_IN_BIN // 2 else math.nan


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    unknown = {k for k, v in row.items() if isinstance(v, float) and not math.isfinite(v)}
    return {k: None if k in unknown else v for k, v in row.items()}
