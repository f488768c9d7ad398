"""The search for readings that do not count: clipped, stuck, spiked or beyond their limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.calibration import probe_pressure_Pa
from classic_ml.columns.computed import as_stored
from classic_ml.columns.workspace import blocks
from classic_ml.description import (
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.faults.converter_range import CodeRange
from classic_ml.faults.marks import (
    BEYOND_LIMITS,
    CLIPPED,
    SPIKED,
    STUCK,
    Marks,
)
from classic_ml.faults.odd_readings import copies, jumps, spiked_rows
from classic_ml.faults.plateaus import End, ends_of_ranges
from classic_ml.faults.recording import how_recorded
from classic_ml.faults.standstill import DROPOUT_ROWS, Tally, still_runs, tallies
from classic_ml.records import LedgerEntry, Record
from surge_core.types import FloatArray

__all__ = ["inspect_readings"]

# A surging machine moves every probe by many counts in 50 ms (a third of a 7 Hz cycle).
STUCK_S = 0.05

# On 24 simulated records and an independent one readings of four thermocouples stand out as spikes
# do, by 1.0 to 1.7 % of their range, where 1 % is enough for a pressure: their range counts thrice.
COUPLE_RANGES = 3.0
# Next to a reading that does not count for another reason, none is called a spike.
EDGE_ROWS = 3


def inspect_readings(record: Record, test: TestDescription, *, whole: bool = False) -> Record:
    """Mark the readings that do not count, before anything is computed from them.

    Parameters
    ----------
    record : Record
        Counts and kelvin, as read.
    test : TestDescription
        Converter and limits.
    whole : bool
        It is all of a record, no piece as it comes in: look at how it was recorded, too.

    Returns
    -------
    Record
        With a channel ``fault_NAME`` for every channel that has a fault: the sum of 1 (clipped
        at an end of the converter, or of the range that the channel itself shows) and 4 (beyond
        its limits), or 2 (stuck, or dropped out), or 8 (a reading or two far off those before and
        behind).

    Raises
    ------
    InputError
        When some pressures of a whole record were recorded at a lower rate than others.
    """
    found = tallies(record, test.channel_names)
    codes = how_recorded(record, test, found) if whole else CodeRange(test, {}, ())
    test = codes.test
    long_rows = max(DROPOUT_ROWS, round(STUCK_S * record.sample_rate_hz))
    groups, ranges = _alike(test), _ranges(test, found)
    of_ranges, doubts = ends_of_ranges(record, test, found)
    of_ranges |= codes.ends
    spiked = spiked_rows(record, ranges, groups)
    still: dict[str, list[NDArray[np.int64]]] = {name: [] for name in test.channel_names}
    for name, runs in still_runs(record, groups, found, long_rows):
        still[name].append(runs)
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    marks: dict[str, Marks] = {}
    for channel in channels:
        name = channel.name
        cut_off = partial(_cut_off, channel, test, of_ranges.get(name, ()))
        # Most channels have no such readings, which their least and largest one tell.
        ends = cut_off([found[name].low, found[name].high])
        if still[name] or name in spiked or any(np.any(which) for _, which in ends):
            runs = np.concatenate([_NO_RUNS, *still[name]])
            alone = _alone(record[name], spiked.get(name, _NO_ROWS), cut_off, runs)
            mark = _marked(record, name, cut_off, runs, alone)
            if mark.counts:
                marks[name] = mark
    flags = [text for name, mark in marks.items() for text in mark.described(record, name)]
    flags += [*codes.flags, *doubts, *copies(record, test), *jumps(record, test, ranges)]
    clipped = "clipped readings, "
    if test.converter is not None:
        clipped = f"clipped codes (0 and {test.adc.top_code}), "
    entry = LedgerEntry(
        "inspect readings",
        f"looked for {clipped}stuck channels, spikes, jumps and readings beyond their limits: "
        f"{len(flags) or 'no'} findings",
        {"stuck_s": STUCK_S},
        flags=tuple(flags),
    )
    added = [mark.channel(record, name) for name, mark in marks.items()]
    return record.after(entry, add=added)


_NO_RUNS = np.empty((0, 2), dtype=np.int64)
_NO_ROWS = np.empty(0, dtype=np.int64)


def _ranges(test: TestDescription, found: Mapping[str, Tally]) -> dict[str, tuple[float, float]]:
    """Return between which readings each channel can lie, or did where it is not in counts."""
    ranges = {name: (found[name].low, found[name].high) for name in test.channel_names}
    for couple in test.temperatures:
        low, high = ranges[couple.name]
        ranges[couple.name] = low, low + COUPLE_RANGES * (high - low)
    for probe in test.pressures:
        if probe.record_unit == "count":
            ranges[probe.name] = 0.0, float(test.adc.top_code)
    return {name: ends for name, ends in ranges.items() if ends[0] < ends[1]}


def _marked(
    record: Record,
    name: str,
    cut_off: Callable[[ArrayLike], Iterable[tuple[int, NDArray[np.bool_]]]],
    runs: NDArray[np.int64],
    spiked: NDArray[np.int64],
) -> Marks:
    """Mark the readings that are cut off, those in runs that stand still, and the spikes."""
    column = record.workspace.zeros(record.n_samples, np.uint8)
    counts: dict[int, tuple[int, int, int]] = {}
    for rows in blocks(record.n_samples):
        kinds = [*cut_off(as_stored(record[name])[rows])]
        stuck = _inside(runs, rows)
        for _, which in kinds:
            # A reading that is cut off stands still because of that.
            stuck &= ~which
        marks = np.zeros(stuck.size, dtype=np.uint8)
        for kind, which in (*kinds, (STUCK, stuck), (SPIKED, _among(spiked, rows))):
            found = int(np.count_nonzero(which))
            if found:
                marks += which * np.uint8(kind)
                last = rows.stop - 1 - int(np.argmax(which[::-1]))
                n, first, _ = counts.get(kind, (0, rows.start + int(np.argmax(which)), last))
                counts[kind] = (n + found, first, last)
        if marks.any():
            record.workspace.put(column, rows, marks)
        record.workspace.release()
    column.setflags(write=False)
    return Marks(column, counts)


def _alone(
    values: FloatArray,
    rows: NDArray[np.int64],
    cut_off: Callable[[ArrayLike], Iterable[tuple[int, NDArray[np.bool_]]]],
    runs: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the spikes that are not the edge of another fault, from which a reading comes back."""
    alone = []
    for row in rows.tolist():
        around = slice(max(row - EDGE_ROWS, 0), min(row + EDGE_ROWS + 1, values.size))
        if not any(np.any(which) for _, which in cut_off(values[around])) and not np.any(
            _inside(runs, around)
        ):
            alone.append(row)
    return np.array(alone, dtype=np.int64)


def _inside(runs: NDArray[np.int64], rows: slice) -> NDArray[np.bool_]:
    """Tell which rows of a slice are in one of the runs, which are in order and apart."""
    n = rows.stop - rows.start
    first = np.searchsorted(runs[:, 1], rows.start, side="right")
    last = np.searchsorted(runs[:, 0], rows.stop, side="left")
    inside = np.zeros(n, dtype=np.bool_)
    for start, stop in np.clip(runs[first:last] - rows.start, 0, n).tolist():
        inside[start:stop] = True
    return inside


def _among(places: NDArray[np.int64], rows: slice) -> NDArray[np.bool_]:
    """Tell which rows of a slice are among some, which are in order."""
    inside = np.zeros(rows.stop - rows.start, dtype=np.bool_)
    first, last = np.searchsorted(places, (rows.start, rows.stop))
    inside[places[first:last] - rows.start] = True
    return inside


def _cut_off(
    channel: PressureChannel | TemperatureChannel,
    test: TestDescription,
    ends: Iterable[End],
    readings: ArrayLike,
) -> Iterator[tuple[int, NDArray[np.bool_]]]:
    """Yield the kinds of fault that readings show by themselves, and which readings do."""
    values = np.asarray(readings)
    if channel.record_unit == "count":
        yield CLIPPED, (values <= 0) | (values >= test.adc.top_code)
    for end in ends:
        yield CLIPPED, end.beyond(values)
    if channel.name in test.limits:
        low, high = test.limits[channel.name]
        if isinstance(channel, PressureChannel):
            values = probe_pressure_Pa(channel, test, values.astype(np.float64))
        # A reading at the limit is one that the acquisition has cut off there.
        yield BEYOND_LIMITS, (values <= low) | (values >= high)


def _alike(test: TestDescription) -> list[list[str]]:
    """Channels that see the same: probes of one plane that face one way, its thermocouples."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for probe in test.pressures:
        groups.setdefault((probe.plane, probe.facing), []).append(probe.name)
    for couple in test.temperatures:
        groups.setdefault((couple.plane,), []).append(couple.name)
    return list(groups.values())
