"""Experiments that have not been run, derived from records that have."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.loading import Run, laid_out
from surge_core.types import FloatArray

# Mean and swing of three throttle settings, as shares of the range and of the swing recorded.
SETTINGS = ((0.0, 1.0), (-0.12, 0.7), (0.12, 0.4))
# Share of a setting over which the throttle moves to the next.
RAMP_SHARE = 0.15
CHANNELS = ("T25_K", "Nc_frac")
STATES = ("in_stall", "stalled")


@dataclass(frozen=True)
class Change:
    """What is done otherwise in an experiment.

    φ passes at so many times its speed for so many times the length, its swing about its mean is
    scaled, and it is lowered by a share of its range; or each record passes through three throttle
    settings.
    """

    name: str
    says: str
    speed: float = 1.0
    length: float = 1.0
    swing: float = 1.0
    lower: float = 0.0
    settings: bool = False


AS_RECORDED = Change("as_recorded", "the records as they are")
CHANGES = (
    Change("longer_2", "records twice as long", length=2.0),
    Change("longer_4", "records four times as long", length=4.0),
    Change("slower_2", "the same cycles at half the pace", speed=0.5, length=2.0),
    Change("slower_4", "the same cycles at a quarter of the pace", speed=0.25, length=4.0),
    Change("faster_2", "cycles at twice the pace", speed=2.0),
    Change("deeper_reversal", "mean flow lower by a quarter of its range", lower=0.25),
    Change("larger_swing", "a swing half as large again", swing=1.5),
    Change(
        "faster_larger",
        "cycles at twice the pace and a swing half as large again",
        speed=2.0,
        swing=1.5,
    ),
    Change("throttle_settings", "three throttle settings in each record", settings=True),
)


def changed(data: LagData, change: Change) -> LagData:
    """Return rows as an experiment would leave them that differs by a change, ψ' unknown (zero).

    φ passes through the recorded values at another pace; where a record ends it goes back the way
    it came. Temperature and speed keep their slow trend with the clock, and their swing with φ. All
    scored rows are to be fitted.
    """
    scored = data.scored()
    phi = data.sampled(data["phi"])[scored]
    mean, span = float(phi.mean()), float(np.ptp(phi))
    runs = [_changed_run(data, i, change, mean, span) for i in range(len(data.runs))]
    made = laid_out(runs, data.every)
    out = replace(
        data,
        **made,
        part=np.full(made["weight"].size, TRAIN, dtype=np.int8),
        record=np.repeat(data.record[data.runs[:, 0]], np.diff(made["runs"])[:, 0]),
    )
    return _with_own_references(_clocked(out, data))


def _changed_run(data: LagData, index: int, change: Change, mean: float, span: float) -> Run:
    """Return one run of the experiment, its clock starting where it was."""
    first, stop = (int(edge) for edge in data.fine_runs[index])
    n_samples = int(np.diff(data.runs[index])[0])
    n_new = max(round((n_samples - 1) * change.length), 1) + 1
    size = stop - first
    passed = change.speed * np.arange((n_new - 1) * data.every + 1)
    turned = np.mod(passed, 2 * (size - 1))
    at = np.minimum(turned, 2 * (size - 1) - turned)
    swing, lower = _throttle(change, passed.size)
    signals: dict[str, FloatArray] = {}
    for name, values in data.signals.items():
        own = values[first:stop]
        if name.startswith("phi"):
            signals[name] = mean + swing * (_between(own, at) - mean) - lower * span
        elif name.startswith("amplitude"):
            signals[name] = swing * _between(own, at)
        elif name in CHANNELS:
            signals[name] = _channel(own, at)
        elif name in STATES:
            signals[name] = own[np.rint(at).astype(np.int64)]
    signals["time_s"] = data["time_s"][first] + data.step_s * np.arange(passed.size)
    slow = signals.get("phi_smooth", signals["phi"])
    signals["dphi_s"] = np.gradient(slow, data.step_s)
    if "T25_K" in signals:
        signals["dT25_K_s"] = np.gradient(signals["T25_K"], data.step_s)
    nearest = np.rint(at).astype(np.int64)
    samples = np.rint(at[:: data.every] / data.every).astype(np.int64)
    weight = data.weight[data.runs[index][0] + samples]
    return Run(signals, data.nuisance[first:stop][nearest], np.zeros(weight.size), weight)


def _throttle(change: Change, size: int) -> tuple[FloatArray, FloatArray]:
    """Return the swing and by how much φ is lowered, at every row of a run."""
    if not change.settings:
        return np.full(size, change.swing), np.full(size, change.lower)
    place = np.linspace(0.0, len(SETTINGS), size)
    centres = np.arange(len(SETTINGS)) + 0.5
    held = 0.5 - RAMP_SHARE
    edges = np.column_stack([centres - held, centres + held]).ravel()
    shift, swing = (np.repeat([s[i] for s in SETTINGS], 2) for i in range(2))
    return np.interp(place, edges, swing), -np.interp(place, edges, shift)


def _between(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a signal between its rows, by cubics."""
    from scipy.interpolate import CubicSpline

    if np.array_equal(at, np.arange(values.size)):
        return values
    return np.asarray(CubicSpline(np.arange(values.size), values)(at))


def _channel(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a channel whose trend goes on with the clock while its swing follows φ."""
    rows = np.arange(values.size, dtype=np.float64)
    trend = np.polynomial.Polynomial.fit(rows, values, 1)
    left = values - trend(rows)
    return np.asarray(trend(np.arange(at.size, dtype=np.float64)) + _between(left, at))


def _clocked(out: LagData, data: LagData) -> LagData:
    """Let each run begin as much later as those before it have become longer."""
    durations = [np.diff(d.fine_runs, axis=1)[:, 0] * d.step_s for d in (out, data)]
    later = np.cumsum(durations[0] - durations[1])
    shift = np.concatenate([[0.0], later[:-1]])
    lengths = np.diff(out.fine_runs, axis=1)[:, 0]
    return out.with_signal("time_s", out["time_s"] + np.repeat(shift, lengths))


def _with_own_references(data: LagData) -> LagData:
    """Measure effects from what the experiment itself would show."""
    scored = data.scored()
    phi = data.sampled(data["phi"])[scored]

    def mean(name: str, known: float) -> float:
        return float(np.mean(data.sampled(data[name])[scored])) if name in data else known

    return replace(
        data,
        mean_amplitude=mean("amplitude", data.mean_amplitude),
        mean_amplitude_as_is=mean("amplitude_as_is", data.mean_amplitude_as_is),
        mean_speed=mean("Nc_frac", data.mean_speed),
        phi_range=(float(phi.min()), float(phi.max())),
    )
