"""The search for readings that do not count: clipped, stuck, spiked or beyond their limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from classic_ml.calibration import total_reading
from classic_ml.description import (
    AnyChannel,
    CountChannel,
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.faults.held import check_held
from classic_ml.faults.plateaus import range_ends
from classic_ml.faults.spikes import spike_rows
from classic_ml.intervals import equal_runs
from classic_ml.records import Channel, LedgerEntry, Record, fault_name
from surge_core.types import FloatArray, IntArray

# Kinds of mark in the channels `fault_NAME`, added up where they coincide.
CLIPPED = 1
STUCK = 2
BEYOND_LIMITS = 4
SPIKED = 8
MARK_WORDS = {
    CLIPPED: "clipped",
    STUCK: "stuck or dropped out",
    BEYOND_LIMITS: "beyond its limits",
    SPIKED: "spiked",
}


def alike(channels: Iterable[PressureChannel | TemperatureChannel], *keys: str) -> list[list[str]]:
    """Return the names of the channels that are alike in some of their places, in groups."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for channel in channels:
        place = tuple(getattr(channel, key) for key in keys)
        groups.setdefault(place, []).append(channel.name)
    return list(groups.values())


# A surging machine moves every probe by many counts in 50 ms (a third of a 7 Hz cycle).
STUCK_S = 0.05
# A short dropout differs from a plateau by its edges: both are jumps far beyond the usual step.
DROPOUT_ROWS = 5
DROPOUT_JUMP = 10.0
# At so many places of a record its usual step is seen.
USUAL_ROWS = 10_000
# Other channels must have moved by this many of their own steps while one stood still.
MOVED_STEPS = 8.0
# On 24 simulated records and an independent one readings of four thermocouples stand out as spikes
# do, by 1.0 to 1.7 % of their range, where 1 % is enough for a pressure: their range counts thrice.
COUPLE_RANGES = 3.0
# Next to a reading that does not count for another reason, none is called a spike.
BESIDE = np.arange(-3, 4)

Marks = NDArray[np.uint8]


def inspect_readings(record: Record, test: TestDescription) -> Record:
    """Mark the readings that do not count, before anything is computed from them.

    Returned is the record with a channel ``fault_NAME`` for every channel that has a fault: the sum
    of 1 (clipped at an end of the converter, or of the range that the channel itself shows), 4
    (beyond its limits), 2 (stuck, or dropped out) and 8 (a reading or two far off those before and
    behind). Pressures of which some were recorded at a lower rate than others are refused.
    """
    marks: dict[str, Marks] = {}
    for channel in test.channels:
        marks[channel.name] = _cut_off(record[channel.name], channel, test)
    for names in [*alike(test.pressures, "plane", "facing"), *alike(test.temperatures, "plane")]:
        for name in names:
            for start, stop in _still_runs(record, name, names).tolist():
                # A reading that is cut off stands still because of that.
                mark = marks[name][start:stop]
                mark[mark == 0] = STUCK
        for name, rows in _spikes(record, test, names).items():
            around = np.clip(rows[:, None] + BESIDE, 0, record.n_samples - 1)
            marks[name][rows[~np.any(marks[name][around], axis=1)]] = SPIKED
    marks = {name: mark for name, mark in marks.items() if mark.any()}
    findings = [found for name, mark in marks.items() for found in _marked(record, name, mark)]
    check_held(record, test)
    ends = "readings" if test.converter is None else f"codes (0 and {test.adc.top_code})"
    entry = LedgerEntry(
        "inspect readings",
        f"looked for clipped {ends}, stuck channels, spikes and readings beyond their limits: "
        f"{len(findings) or 'no'} findings",
        {"stuck_s": STUCK_S},
        flags=tuple(findings),
    )
    return record.after(
        entry, add=[Channel.adopt(fault_name(name), mark, "1") for name, mark in marks.items()]
    )


def _marked(record: Record, name: str, mark: Marks) -> list[str]:
    found = []
    for kind, word in MARK_WORDS.items():
        rows = np.flatnonzero(mark & kind)
        if rows.size:
            first_s, last_s = record.time_at_s(int(rows[0])), record.time_at_s(int(rows[-1]))
            found.append(f"{name}: {rows.size} rows {word}, {first_s:.3f} to {last_s:.3f} s")
    return found


def _cut_off(values: FloatArray, channel: AnyChannel, test: TestDescription) -> Marks:
    """Mark readings at the ends of a range and beyond the limits, which are believed."""
    cut_off = np.zeros(values.size, dtype=np.bool_)
    if isinstance(channel, CountChannel):
        cut_off |= (values <= 0) | (values >= test.adc.top_code)
    if channel.name not in test.limits:
        for end in range_ends(values):
            cut_off |= values == end
    mark = np.where(cut_off, CLIPPED, 0).astype(np.uint8)
    if channel.name in test.limits:
        low, high = test.limits[channel.name]
        physical = values
        if isinstance(channel, PressureChannel):
            physical = total_reading(channel, test, values)
        # A reading at the limit is one that the acquisition has cut off there.
        mark[(physical <= low) | (physical >= high)] += BEYOND_LIMITS
    return mark


def _still_runs(record: Record, name: str, alike: Sequence[str]) -> IntArray:
    """Return the runs of rows in which one of some channels alike is stuck, or has dropped out."""
    values = record[name]
    runs = equal_runs(values, DROPOUT_ROWS)
    if not runs.size:
        return runs
    steps = np.abs(np.diff(values))
    some = steps[:: 1 + steps.size // USUAL_ROWS]
    moving = some[some > 0.0]
    jumps = np.concatenate([[np.inf], steps, [np.inf]])
    lesser = np.minimum(jumps[runs[:, 0]], jumps[runs[:, 1]])
    usual = float(np.median(moving)) if moving.size else np.inf
    stuck = np.isfinite(lesser) & (lesser > DROPOUT_JUMP * usual)
    long = runs[:, 1] - runs[:, 0] >= max(DROPOUT_ROWS, round(STUCK_S * record.sample_rate_hz))
    candidates = np.flatnonzero(long & ~stuck)
    others = [record[n] for n in alike if n != name] if candidates.size else []
    # The least change from row to row that is one is the resolution of a channel.
    sizes = [np.abs(np.diff(other)) for other in others]
    moves = [MOVED_STEPS * np.min(size[size > 0.0], initial=np.inf) for size in sizes]
    for run in candidates:
        rows = slice(*runs[run].tolist())
        moved = sum(np.ptp(v[rows]) > least for v, least in zip(others, moves, strict=True))
        # Alone of its kind, a channel that stands still has nothing to be compared with.
        stuck[run] = bool(others) and 2 * moved >= len(others)
    return np.asarray(runs[stuck])


def _spikes(record: Record, test: TestDescription, names: Sequence[str]) -> dict[str, IntArray]:
    ranges = {name: float(np.ptp(record[name])) for name in names}
    for probe in test.pressures:
        if probe.name in ranges and isinstance(probe, CountChannel):
            ranges[probe.name] = float(test.adc.top_code)
    for couple in test.temperatures:
        if couple.name in ranges:
            ranges[couple.name] *= COUPLE_RANGES
    moving = {name: record[name] for name in names if ranges[name] > 0.0}
    # Without another beside it a channel may show a shock that is real.
    return spike_rows(moving, ranges) if len(moving) > 1 else {}
