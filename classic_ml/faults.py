"""Readings that do not count: clipped codes, stuck or dropped channels, readings beyond limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.calibration import near_stall_rows, pressure_from_counts
from classic_ml.errors import InputError
from classic_ml.readers.test_description import (
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.records import Channel, Dropped, FloatArray, LedgerEntry, Record

__all__ = ["BEYOND_LIMITS", "CLIPPED", "STUCK", "choose_channels", "inspect_readings"]

# Kinds of fault in the channels `fault_NAME`, added up where they coincide.
CLIPPED = 1
STUCK = 2
BEYOND_LIMITS = 4

# A surging machine moves every probe by many counts in 50 ms (a third of a 7 Hz cycle).
STUCK_S = 0.05
# A short dropout is told from a plateau by its edges: both are jumps far beyond the usual step.
DROPOUT_ROWS = 5
DROPOUT_JUMP = 10.0
# Other channels must have moved by this many of their own steps while one stood still.
MOVED_STEPS = 8.0

# Measured on the 98.5 % record with its inlet pressures raised until the probes clip: 1.3 % of
# the rows shift ψ'_QS by 0.03, as much as the calibration's own error; 8 % shift it by 0.32.
CLIPPED_SHARE = 0.01
# "Substantial": beyond this share of the window a straight line across the gaps is no reading.
BEYOND_SHARE = 0.05


def fault_name(channel: str) -> str:
    """Return the name of the channel that marks the faulty rows of another."""
    return f"fault_{channel}"


def inspect_readings(record: Record, test: TestDescription) -> Record:
    """Mark the readings that do not count, before anything is computed from them.

    Parameters
    ----------
    record : Record
        Counts and kelvin, as read.
    test : TestDescription
        Converter and limits.

    Returns
    -------
    Record
        With a channel ``fault_NAME`` for every channel that has a fault: the sum of 1 (clipped
        at an end of the converter) and 4 (beyond its limits), or 2 (stuck, or dropped out).
    """
    rest = _still(record, test)
    marks: dict[str, NDArray[np.int64]] = {}
    for probe in test.pressures:
        codes = record[probe.name]
        mark = CLIPPED * ((codes <= 0) | (codes >= test.adc.top_code)).astype(np.int64)
        mark |= BEYOND_LIMITS * _beyond(pressure_from_counts(probe, test.adc, codes), probe, test)
        marks[probe.name] = mark
    for couple in test.temperatures:
        marks[couple.name] = BEYOND_LIMITS * _beyond(record[couple.name], couple, test)
    for name, stuck in rest.items():
        # A reading that is cut off stands still because of that.
        marks[name] |= STUCK * (stuck & (marks[name] == 0)).astype(np.int64)
    flags = [text for name, mark in marks.items() for text in _described(record, name, mark)]
    entry = LedgerEntry(
        "inspect readings",
        f"looked for clipped codes (0 and {test.adc.top_code}), stuck channels and readings beyond "
        f"their limits: {len(flags) or 'no'} findings",
        {"stuck_s": STUCK_S},
        flags=tuple(flags),
    )
    added = [Channel(fault_name(n), m.astype(np.float64), "1") for n, m in marks.items() if m.any()]
    return record.after(entry, add=added)


def _beyond(
    readings: FloatArray, channel: PressureChannel | TemperatureChannel, test: TestDescription
) -> NDArray[np.int64]:
    if channel.name not in test.limits:
        return np.zeros(readings.size, dtype=np.int64)
    low, high = test.limits[channel.name]
    # A reading at the limit is one that the acquisition has cut off there.
    return ((readings <= low) | (readings >= high)).astype(np.int64)


@dataclass(frozen=True)
class _Runs:
    """The runs of one value that are long enough to be a fault: first rows, and one past last."""

    starts: NDArray[np.int64]
    stops: NDArray[np.int64]

    def those(self, which: NDArray[np.bool_]) -> _Runs:
        return _Runs(self.starts[which], self.stops[which])

    def rows(self, n: int) -> NDArray[np.bool_]:
        """Mark the rows of the runs, which do not overlap, in a channel of n rows."""
        steps = np.zeros(n + 1, dtype=np.int64)
        np.add.at(steps, self.starts, 1)
        np.add.at(steps, self.stops, -1)
        return np.asarray(np.cumsum(steps[:-1]) > 0)


def _repeats(values: FloatArray, least_rows: int) -> _Runs:
    """Return the runs of a value that repeats itself over ``least_rows`` rows or more."""
    edges = np.flatnonzero(np.diff(values) != 0.0) + 1
    starts = np.concatenate(([0], edges)).astype(np.int64)
    stops = np.concatenate((edges, [values.size])).astype(np.int64)
    return _Runs(starts, stops).those(stops - starts >= least_rows)


def _still(record: Record, test: TestDescription) -> dict[str, NDArray[np.bool_]]:
    """Mark where a channel stands still while most of those alike move, or drops out."""
    masks: dict[str, NDArray[np.bool_]] = {}
    long = max(DROPOUT_ROWS, round(STUCK_S * record.sample_rate_hz))
    for names in _alike(test):
        # What belongs to a channel as a whole is found once, not for every run: a quiet lead-in
        # has a run of equal codes in every few rows.
        least = {name: _least_step(record[name]) for name in names}
        for name in names:
            runs = _repeats(record[name], DROPOUT_ROWS)
            stuck = _are_dropouts(record[name], runs)
            candidates = (runs.stops - runs.starts >= long) & ~stuck
            others = [(record[n], least[n]) for n in names if n != name]
            stuck[candidates] = _others_move(others, runs.those(candidates))
            masks[name] = runs.those(stuck).rows(record.n_samples)
    return masks


def _alike(test: TestDescription) -> list[list[str]]:
    """Channels that see the same: probes of one plane that face one way, its thermocouples."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for probe in test.pressures:
        groups.setdefault((probe.plane, probe.facing), []).append(probe.name)
    for couple in test.temperatures:
        groups.setdefault((couple.plane,), []).append(couple.name)
    return list(groups.values())


def _least_step(values: FloatArray) -> float:
    steps = np.abs(np.diff(values))
    return float(np.min(steps[steps > 0.0], initial=np.inf))


def _are_dropouts(values: FloatArray, runs: _Runs) -> NDArray[np.bool_]:
    """Tell which runs begin and end with a jump; an end of the record needs none."""
    steps = np.abs(np.diff(values))
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    ends = np.concatenate(([np.inf], steps, [np.inf]))
    jumps = np.minimum(ends[runs.starts], ends[runs.stops])
    return np.asarray(np.isfinite(jumps) & (jumps > DROPOUT_JUMP * usual))


def _others_move(others: list[tuple[FloatArray, float]], runs: _Runs) -> NDArray[np.bool_]:
    """Tell during which runs at least half of the other channels moved by many of their steps."""
    moved = np.zeros(runs.starts.size, dtype=np.int64)
    # Alone of its kind, a channel that stands still has nothing to be compared with.
    if not others or not moved.size:
        return np.zeros(moved.size, dtype=np.bool_)
    edges = np.column_stack((runs.starts, runs.stops)).ravel()
    for values, step in others:
        # One row more, since reduceat takes no edge past the last; every second piece is a run.
        padded = np.append(values, values[-1])
        high = np.maximum.reduceat(padded, edges)[::2]
        low = np.minimum.reduceat(padded, edges)[::2]
        moved += high - low > MOVED_STEPS * step
    return np.asarray(2 * moved >= len(others))


_WORDS = {CLIPPED: "clipped", STUCK: "stuck or dropped out", BEYOND_LIMITS: "beyond its limits"}


def _described(record: Record, name: str, mark: NDArray[np.int64]) -> list[str]:
    texts = []
    for kind, word in _WORDS.items():
        rows = np.flatnonzero(mark & kind)
        if rows.size:
            first, last = record.time_s[rows[0]], record.time_s[rows[-1]]
            texts.append(f"{name}: {rows.size} rows {word}, {first:.3f} to {last:.3f} s")
    return texts


@dataclass(frozen=True)
class _Verdict:
    channel: str
    rows: int
    why: str


def choose_channels(record: Record, test: TestDescription, window: NDArray[np.bool_]) -> Record:
    """Leave out the channels that cannot be used in the window, a pressure with its mate.

    Parameters
    ----------
    record : Record
        Calibrated and matched, with the marks of :func:`inspect_readings`.
    test : TestDescription
        Places of the channels.
    window : ndarray of bool, shape (n_samples,)
        Rows of the quasi-steady cycles.

    Returns
    -------
    Record
        Without the channels that were left out; thermocouples that stay are bridged by straight
        lines where their readings do not count.

    Raises
    ------
    InputError
        When an immersion of a plane, or the thermocouples of plane 25, would be left out whole.
    """
    verdicts = {name: _judge(record, test, name, window) for name in test.channel_names}
    bad = {name: verdict for name, verdict in verdicts.items() if verdict is not None}
    dropped, gone = _drop_pairs(record, test, bad)
    for plane in test.areas_m2:
        couples = test.thermocouples(plane)
        out = [c.name for c in couples if c.name in bad]
        if plane == 25 and len(out) == len(couples):
            raise _refusal(record, bad[out[0]], "the last thermocouple of plane 25")
        dropped += [Dropped(name, bad[name].rows, bad[name].why) for name in out]
        gone += out
        if couples and len(out) == len(couples):
            dropped.append(Dropped("W31 and ψ", record.n_samples, "no thermocouple left there"))
    kept = [c.name for c in test.temperatures if c.name not in gone]
    bridged = [_bridged(record, name) for name in kept if fault_name(name) in record]
    flags = [_kept_flag(record, name, window) for name in test.channel_names if name not in gone]
    entry = LedgerEntry(
        "choose channels",
        f"{len(test.channel_names) - len(gone)} of {len(test.channel_names)} channels are used",
        {"clipped_share": CLIPPED_SHARE, "beyond_limits_share": BEYOND_SHARE},
        tuple(dropped),
        tuple(flag for flag in flags if flag),
    )
    return record.after(entry, add=bridged, drop=gone)


def _judge(
    record: Record, test: TestDescription, name: str, window: NDArray[np.bool_]
) -> _Verdict | None:
    if fault_name(name) not in record:
        return None
    mark = record[fault_name(name)].astype(np.int64)
    for rows, where in (
        (window, "in the window"),
        (near_stall_rows(record, test), "at near stall, so that it cannot be matched"),
    ):
        n = int(np.count_nonzero(rows))
        counts = {kind: int(np.count_nonzero(mark[rows] & kind)) for kind in _WORDS}
        allowed = {CLIPPED: CLIPPED_SHARE * n, STUCK: 0.0, BEYOND_LIMITS: BEYOND_SHARE * n}
        for kind, word in _WORDS.items():
            if counts[kind] > allowed[kind]:
                return _Verdict(name, counts[kind], f"{word} in {counts[kind]} of {n} rows {where}")
    return None


def _drop_pairs(
    record: Record, test: TestDescription, bad: dict[str, _Verdict]
) -> tuple[list[Dropped], list[str]]:
    dropped: list[Dropped] = []
    gone: list[str] = []
    for plane in test.areas_m2:
        left: dict[str, int] = {}
        last: dict[str, _Verdict] = {}
        for pair in test.pairs(plane):
            verdict = bad.get(pair.forward.name) or bad.get(pair.aft.name)
            left[pair.immersion] = left.get(pair.immersion, 0) + (verdict is None)
            if verdict is not None:
                last.setdefault(pair.immersion, verdict)
                gone += [pair.forward.name, pair.aft.name]
                why = f"{verdict.channel} is {verdict.why}"
                dropped.append(Dropped(f"pair {pair.name}", verdict.rows, why))
        for immersion, count in left.items():
            if count == 0:
                raise _refusal(
                    record, last[immersion], f"the last {immersion} pair of plane {plane}"
                )
    return dropped, gone


def _refusal(record: Record, verdict: _Verdict, last: str) -> InputError:
    return InputError(
        f"{record.source}: channel {verdict.channel}",
        expected=f"readings that count, since {last} goes with it",
        found=f"it {verdict.why}",
        remedy="choose a window without the fault, or mend the range of the transducer",
    )


def _bridged(record: Record, name: str) -> Channel:
    channel = record.channel(name)
    bad = record[fault_name(name)] > 0.0
    if bad.all():
        return channel
    rows = np.arange(bad.size)
    values = np.interp(rows, rows[~bad], channel.values[~bad])
    return Channel(name, values, channel.unit)


def _kept_flag(record: Record, name: str, window: NDArray[np.bool_]) -> str:
    if fault_name(name) not in record:
        return ""
    inside = int(np.count_nonzero(record[fault_name(name)][window]))
    if inside:
        return f"{name}: {inside} faulty rows in the window, few enough to keep it"
    return f"{name}: faulty rows outside the window only"
