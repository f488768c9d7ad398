"""Readings that do not count: clipped, stuck, spiked or beyond limits, and probes that came off."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.calibration import near_stall_rows, probe_pressure_Pa
from classic_ml.columns.workspace import blocks
from classic_ml.errors import InputError
from classic_ml.faults.bridging import bridged_rows
from classic_ml.faults.odd_readings import copies, jumps, spiked_rows
from classic_ml.faults.plateaus import End, ends_of_ranges
from classic_ml.faults.probe_agreement import (
    Agreement,
    compare_probes,
    drifted_apart,
    exchanged_immersions,
    slow_pressures,
)
from classic_ml.faults.standstill import DROPOUT_ROWS, Tally, still_runs, tallies
from classic_ml.readers.test_description import (
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.records import Channel, Dropped, FloatArray, LedgerEntry, Record

__all__ = [
    "BEYOND_LIMITS",
    "CLIPPED",
    "SPIKED",
    "STUCK",
    "choose_channels",
    "inspect_readings",
    "with_faults_bridged",
]

# Kinds of fault in the channels `fault_NAME`, added up where they coincide.
CLIPPED = 1
STUCK = 2
BEYOND_LIMITS = 4
SPIKED = 8

# A surging machine moves every probe by many counts in 50 ms (a third of a 7 Hz cycle).
STUCK_S = 0.05

# Measured on the 98.5 % record with its inlet pressures raised until the probes clip: 1.3 % of
# the rows shift ψ'_QS by 0.03, as much as the calibration's own error; 8 % shift it by 0.32.
CLIPPED_SHARE = 0.01
# "Substantial": beyond this share of the window a straight line across the gaps is no reading.
BEYOND_SHARE = 0.05
# Next to a reading that does not count for another reason, none is called a spike.
EDGE_ROWS = 3
# Sound probes of 13 simulated records move by 0.96 to 1.03 times what those beside them do, and
# differ from them by 9 % of it. One that moves by half or by twice as much has come off, or is
# another's; between the two its sensitivity is in doubt.
GAIN_DOUBTED, APART_DOUBTED = 0.08, 0.2
GAIN_REFUSED, APART_REFUSED = 2.0, 0.6


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
        at an end of the converter, or of the range that the channel itself shows) and 4 (beyond
        its limits), or 2 (stuck, or dropped out), or 8 (a reading or two far off those before and
        behind).
    """
    found = tallies(record, test.channel_names)
    long_rows = max(DROPOUT_ROWS, round(STUCK_S * record.sample_rate_hz))
    groups, ranges = _alike(test), _ranges(test, found)
    of_ranges, doubts = ends_of_ranges(record, test, found)
    spiked = spiked_rows(record, ranges, groups)
    still: dict[str, list[NDArray[np.int64]]] = {name: [] for name in test.channel_names}
    for name, runs in still_runs(record, groups, found, long_rows):
        still[name].append(runs)
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    marks: dict[str, _Marks] = {}
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
    flags += [*doubts, *copies(record, test), *jumps(record, test, ranges)]
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
    """Return between which readings each pressure can lie, or did where it is not in counts."""
    ranges = {
        probe.name: (0.0, float(test.adc.top_code))
        if probe.record_unit == "count"
        else (found[probe.name].low, found[probe.name].high)
        for probe in test.pressures
    }
    return {name: ends for name, ends in ranges.items() if ends[0] < ends[1]}


@dataclass(frozen=True)
class _Marks:
    """The marks of one channel, and for each kind its number of rows, the first and the last."""

    column: NDArray[np.uint8]
    counts: Mapping[int, tuple[int, int, int]]

    def channel(self, record: Record, name: str) -> Channel:
        """Return them as a channel."""
        values = record.workspace.derived(
            self.column.size, lambda rows: self.column[rows].astype(np.float64)
        )
        return Channel(fault_name(name), values, "1")

    def described(self, record: Record, name: str) -> list[str]:
        """Return one sentence a kind."""
        texts = []
        for kind, word in _WORDS.items():
            if kind in self.counts:
                n, *ends = self.counts[kind]
                first_s, last_s = (record.time_at_s(row) for row in ends)
                texts.append(f"{name}: {n} rows {word}, {first_s:.3f} to {last_s:.3f} s")
        return texts


def _marked(
    record: Record,
    name: str,
    cut_off: Callable[[ArrayLike], Iterable[tuple[int, NDArray[np.bool_]]]],
    runs: NDArray[np.int64],
    spiked: NDArray[np.int64],
) -> _Marks:
    """Mark the readings that are cut off, those in runs that stand still, and the spikes."""
    column = record.workspace.zeros(record.n_samples, np.uint8)
    counts: dict[int, tuple[int, int, int]] = {}
    for rows in blocks(record.n_samples):
        kinds = [*cut_off(record[name][rows])]
        stuck = _inside(runs, rows)
        for _, which in kinds:
            # A reading that is cut off stands still because of that.
            stuck &= ~which
        marks = np.zeros(stuck.size, dtype=np.uint8)
        for kind, which in (*kinds, (STUCK, stuck), (SPIKED, _among(spiked, rows))):
            places = np.flatnonzero(which)
            if places.size:
                marks[places] += np.uint8(kind)
                last = rows.start + int(places[-1])
                n, first, _ = counts.get(kind, (0, rows.start + int(places[0]), last))
                counts[kind] = (n + places.size, first, last)
        if marks.any():
            record.workspace.put(column, rows, marks)
        record.workspace.release()
    column.setflags(write=False)
    return _Marks(column, counts)


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
    values = np.asarray(readings, dtype=np.float64)
    if channel.record_unit == "count":
        yield CLIPPED, (values <= 0) | (values >= test.adc.top_code)
    for end in ends:
        yield CLIPPED, end.beyond(values)
    if channel.name in test.limits:
        low, high = test.limits[channel.name]
        if isinstance(channel, PressureChannel):
            values = probe_pressure_Pa(channel, test, values)
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


_WORDS = {
    CLIPPED: "clipped",
    STUCK: "stuck or dropped out",
    BEYOND_LIMITS: "beyond its limits",
    SPIKED: "spiked",
}


@dataclass(frozen=True)
class _Verdict:
    channel: str
    rows: int
    why: str


def choose_channels(record: Record, test: TestDescription, window: slice) -> Record:
    """Leave out the channels that cannot be used in the window, a pressure with its mate.

    Parameters
    ----------
    record : Record
        Calibrated and matched, with the marks of :func:`inspect_readings`.
    test : TestDescription
        Places of the channels.
    window : slice
        Rows of the quasi-steady cycles.

    Returns
    -------
    Record
        Without the channels that were left out. Of those that stay, thermocouples are bridged by
        straight lines where their readings do not count, pressures where they have spikes.

    Raises
    ------
    InputError
        When an immersion of a plane, or the thermocouples of plane 25, would be left out whole.
    """
    verdicts = {name: _judge(record, test, name, window) for name in test.channel_names}
    bad = {name: verdict for name, verdict in verdicts.items() if verdict is not None}
    slow = slow_pressures(record, test, window)
    agreements = compare_probes(slow, test, bad)
    bad |= _come_off(agreements, window)
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
    kept = [p.name for p in test.pressures if p.name not in gone]
    bridged += [_bridged(record, name, SPIKED) for name in kept if _has(record, name, SPIKED)]
    flags = [_kept_flag(record, name, window) for name in test.channel_names if name not in gone]
    flags += [*_doubts(agreements, gone), *_between_rakes(slow, test, gone)]
    entry = LedgerEntry(
        "choose channels",
        f"{len(test.channel_names) - len(gone)} of {len(test.channel_names)} channels are used",
        {"clipped_share": CLIPPED_SHARE, "beyond_limits_share": BEYOND_SHARE},
        tuple(dropped),
        tuple(flag for flag in flags if flag),
    )
    return record.after(entry, add=bridged, drop=gone)


def _judge(record: Record, test: TestDescription, name: str, window: slice) -> _Verdict | None:
    n_rows = window.stop - window.start
    if n_rows and _stands_still(record, name, window):
        return _Verdict(name, n_rows, f"the same in all {n_rows} rows in the window")
    if fault_name(name) not in record:
        return None
    for rows, where in (
        (window, "in the window"),
        (near_stall_rows(record, test), "at near stall, so that it cannot be matched"),
    ):
        n = rows.stop - rows.start
        counts = _counts(record, name, rows)
        allowed = {
            CLIPPED: CLIPPED_SHARE * n,
            STUCK: 0.0,
            BEYOND_LIMITS: BEYOND_SHARE * n,
            SPIKED: CLIPPED_SHARE * n,
        }
        for kind, word in _WORDS.items():
            if counts[kind] > allowed[kind]:
                return _Verdict(name, counts[kind], f"{word} in {counts[kind]} of {n} rows {where}")
    return None


def _stands_still(record: Record, name: str, rows: slice) -> bool:
    """Tell whether a channel has one and the same reading in all rows, with those alike or not."""
    first = record[name][rows.start]
    return all(bool(np.all(record[name][b] == first)) for b in blocks(rows.stop, rows.start))


def _come_off(agreements: Mapping[str, Agreement], window: slice) -> dict[str, _Verdict]:
    """Return the probes that do not take part in what those beside them show."""
    n_rows = window.stop - window.start
    return {
        name: _Verdict(
            name,
            n_rows,
            f"moving {found.gain:.2f} times as much as the probes beside it in the window, and "
            f"{found.apart:.0%} apart from them",
        )
        for name, found in agreements.items()
        if not 1.0 / GAIN_REFUSED < found.gain < GAIN_REFUSED or found.apart > APART_REFUSED
    }


def _doubts(agreements: Mapping[str, Agreement], gone: Iterable[str]) -> list[str]:
    """Return a flag for each probe that stays and does not quite go with those beside it."""
    return [
        f"{name} moves {found.gain:.2f} times as much as the probes beside it, {found.apart:.0%} "
        "apart from them: check its zero and calibrate readings"
        for name, found in agreements.items()
        if name not in gone
        and (abs(found.gain - 1.0) > GAIN_DOUBTED or found.apart > APART_DOUBTED)
    ]


def _between_rakes(slow: Record, test: TestDescription, gone: Iterable[str]) -> list[str]:
    """Return a flag for each two rakes that do not show the same."""
    exchanged = [
        f"plane {plane}: the hub of rake {first} goes with the tip of rake {second}, and the "
        "reverse: are hub and tip exchanged on one of them?"
        for plane, first, second in exchanged_immersions(slow, test, gone)
    ]
    return exchanged + [
        f"{high} is {apart:.1%} above {low} in the window, though both were matched near stall: "
        "has the zero of one drifted, or is its sensitivity wrong?"
        for low, high, apart in drifted_apart(slow, test, gone)
    ]


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


def _counts(record: Record, name: str, rows: slice) -> dict[int, int]:
    """Return in how many rows of a slice a channel has a fault of each kind, and of any (0)."""
    by_marks = np.zeros(1 << len(_WORDS), dtype=np.int64)
    for block in blocks(rows.stop, rows.start):
        marks = record[fault_name(name)][block]
        if marks.any():
            by_marks += np.bincount(marks.astype(np.int64), minlength=by_marks.size)
        record.workspace.release()
    counts = {kind: int(by_marks[which].sum()) for kind, which in _WITH_KIND.items()}
    return {**counts, 0: int(by_marks[1:].sum())}


# Which sums of kinds have a kind in them.
_WITH_KIND = {kind: np.flatnonzero(np.arange(1 << len(_WORDS)) & kind) for kind in _WORDS}


def _has(record: Record, name: str, kind: int) -> bool:
    """Tell whether a channel has a fault of a kind anywhere."""
    if fault_name(name) not in record:
        return False
    fault = record[fault_name(name)]
    return any(
        bool(np.any(fault[rows].astype(np.int64) & kind)) for rows in blocks(record.n_samples)
    )


def _bridged(record: Record, name: str, kinds: int = -1) -> Channel:
    """Return a channel with straight lines across its faults of some kinds, of all without."""
    channel, place, n_rows = record.channel(name), record.workspace, record.n_samples
    fault = record[fault_name(name)]
    rows_of = bridged_rows(
        place,
        n_rows,
        channel.values.__getitem__,
        lambda rows: fault[rows].astype(np.int64) & kinds == 0,
    )
    return Channel(name, place.derived(n_rows, rows_of), channel.unit)


def with_faults_bridged(record: Record, test: TestDescription) -> Record:
    """Return a record with straight lines across all readings that do not count.

    Only what a window is looked for with: a dropout must not end it.

    Parameters
    ----------
    record : Record
        With the marks of :func:`inspect_readings`.
    test : TestDescription
        Its channels.
    """
    names = [name for name in test.channel_names if fault_name(name) in record]
    channels = {name: _bridged(record, name) for name in names}
    return replace(record, channels={**record.channels, **channels})


def _kept_flag(record: Record, name: str, window: slice) -> str:
    if fault_name(name) not in record:
        return ""
    inside = _counts(record, name, window)[0]
    if inside:
        return f"{name}: {inside} faulty rows in the window, few enough to keep it"
    return f"{name}: faulty rows outside the window only"
