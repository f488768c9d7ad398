"""The search for readings that do not count: clipped, stuck, spiked or beyond their limits.

A spike is one or two rows far off those before and behind, in one channel alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from classic_ml.calibration import total_reading
from classic_ml.description import (
    AnyChannel,
    CountChannel,
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.faults.plateaus import check_held, range_ends
from classic_ml.records import Channel, LedgerEntry, Record, counted, fault_name
from surge_core.segments import intervals_where
from surge_core.types import BoolArray, FloatArray, IntArray

# A spike is one row or two wide, and is compared with what its channel does for 25 rows on either
# side. On 52 records of the simulated rigs, stall cells and all, no reading stands out by more than
# 3.5 times that while the probes beside it are quiet; 0.01 of the range are 41 codes of 12 bits.
# One of 700 codes does so by more than 4 times in nearly all places at plane 31, and in three of
# four among the stall cells at plane 25, where those that pass move τ by less than its error.
REACH, GAP = 23, 3
RATIO, SHARE, QUIET_RATIO, SEEN_SHARE = 4.0, 0.01, 1.5, 0.1
LEAST = 0.1 * SHARE
# Rows at either end of a record that are not looked at.
MARGIN = REACH + GAP + 3
# From a row to the middle of the rows that it is compared with.
MIDDLE = GAP + REACH // 2
NEAR = np.arange(-2, 3)


def spike_rows(
    channels: Mapping[str, FloatArray], ranges: Mapping[str, float]
) -> dict[str, IntArray]:
    """Return the rows, by channel, where one of some channels alike is far off its neighbours.

    The two or more channels see the same: what another shows at once is no fault of one. ``ranges``
    is the width of the range of each.
    """
    off = {name: _off_neighbours(values) / ranges[name] for name, values in channels.items()}

    @cache
    def largest(name: str) -> FloatArray:
        return np.asarray(maximum_filter1d(off[name], REACH))

    def standing_out(name: str, rows: IntArray, ratio: float) -> BoolArray:
        beside = np.maximum(largest(name)[rows - MIDDLE], largest(name)[rows + MIDDLE])
        return np.asarray(off[name][rows] > ratio * np.maximum(LEAST, beside))

    found = {}
    for name, own in off.items():
        rows = np.flatnonzero(own[MARGIN : own.size - MARGIN] > SHARE) + MARGIN
        if not rows.size:
            continue
        rows = rows[standing_out(name, rows, RATIO)]
        near = rows[:, None] + NEAR
        # On a steep slope the rows beside a spike stand out a little too.
        alone = np.all(own[rows, None] > 0.5 * own[near], axis=1)
        for other in off.keys() - {name}:
            shown = off[other][near] > SEEN_SHARE * own[rows, None]
            alone &= ~np.any(shown & standing_out(other, near, QUIET_RATIO), axis=1)
        if alone.any():
            found[name] = rows[alone]
    return found


def _off_neighbours(values: FloatArray) -> FloatArray:
    """Return how far each reading is off the median of itself and two on either side."""
    off = np.abs(values - median_filter(values, 5))
    off[:2] = off[-2:] = 0.0
    return off


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
DROPOUT_ROWS = 3
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
        entry, add=[Channel(fault_name(name), mark, "1") for name, mark in marks.items()]
    )


def _marked(record: Record, name: str, mark: Marks) -> list[str]:
    found = []
    for kind, word in MARK_WORDS.items():
        rows = np.flatnonzero(mark & kind)
        if rows.size:
            first_s, last_s = record.time_at_s(int(rows[0])), record.time_at_s(int(rows[-1]))
            n_rows = counted(rows.size, "row")
            found.append(f"{name}: {n_rows} {word}, {first_s:.3f} to {last_s:.3f} s")
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
    runs: IntArray = intervals_where(values[1:] == values[:-1]) + np.array([0, 1])
    runs = runs[runs[:, 1] - runs[:, 0] >= DROPOUT_ROWS]
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
