"""From the channels to the averages over the planes, once where the same is asked for twice.

The window of the surge cycles is found in averages of all channels, faults bridged; which of them
can be used depends on the window. The averages that are kept are those that were looked at, but
for the blocks in which a fault was bridged.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.calibration import invert_thermocouples
from classic_ml.columns.workspace import blocks
from classic_ml.faults.marks import fault_name, kinds_of_fault
from classic_ml.filters import LocalFilter, channel_filter, filter_channels, filter_entry
from classic_ml.planes import (
    EvaluatedFlows,
    PlaneFlows,
    local_flows,
    plane_averages,
    plane_flows,
)
from classic_ml.probe_plane import averaged_plane
from classic_ml.readers.test_description import TestDescription
from classic_ml.records import LedgerEntry, Record
from classic_ml.reduction_settings import ReductionSettings
from surge_core.types import FloatArray

__all__ = ["LookAhead", "look_ahead", "probe_averages", "without"]

# What the window is looked for with.
AHEAD = ReductionSettings(phase="zero")
AVERAGING = ("filter_order", "cutoff_hz", "phase", "probes", "thermocouple_inversion")
# The averages that every reduction goes through more than once.
READ_BY_ALL = ("P25_Pa", "T25_K", "Wc25_kg_s", "P31_Pa")
# One block of so many is looked at to tell whether a thermocouple is worth a column.
BLOCKS_BETWEEN = 16


@dataclass(frozen=True)
class LookAhead:
    """The averages from which the window is found.

    Parameters
    ----------
    before : Record
        With every channel in it, faults bridged.
    flows : EvaluatedFlows
        The averages over the planes, which are used up by :func:`probe_averages`.
    """

    before: Record
    flows: EvaluatedFlows

    @property
    def averaged(self) -> Record:
        """The record with the averages."""
        return self.flows.record


def look_ahead(record: Record, test: TestDescription, settings: ReductionSettings) -> LookAhead:
    """Filter and average every channel of a record.

    Parameters
    ----------
    record : Record
        Matched pressures and temperatures, faults bridged.
    test : TestDescription
        Places of the probes.
    settings : ReductionSettings
        What the averages will be asked for by.
    """
    flows, _ = _filtered_flows(record, test, AHEAD)
    return LookAhead(record, flows.evaluated(stored=_stored(record, test, settings)))


def probe_averages(
    record: Record,
    test: TestDescription,
    settings: ReductionSettings,
    *,
    keep_probes: bool,
    ahead: LookAhead | None = None,
) -> Record:
    """Filter, undo the thermocouple lag, and average flows and pressures over each plane.

    Parameters
    ----------
    record : Record
        Matched pressures and temperatures, but for those channels that cannot be used.
    test : TestDescription
        Places of the probes.
    settings : ReductionSettings
        The switches.
    keep_probes : bool
        Keep the readings and flows of the single probes.
    ahead : LookAhead, optional
        What was computed of the same record before channels were left out; what is the same is
        taken over, and its columns are written to.

    Returns
    -------
    Record
        With the averages of :func:`classic_ml.planes.plane_averages`.
    """
    if keep_probes or settings.phase == "none" or settings.thermocouple_inversion:
        return _by_way_of_probes(record, test, settings, keep_probes)
    flows, run = _filtered_flows(record, test, settings)
    alike = all(getattr(settings, name) == getattr(AHEAD, name) for name in AVERAGING)
    if ahead is not None and alike and _same_channels(record, test, ahead):
        changed = _changed(record, ahead.before, _in_use(record, test), run)
        evaluated = flows.evaluated_anew(ahead.flows, changed)
    else:
        evaluated = flows.evaluated(stored=_stored(record, test, settings))
    filtered, inverted = _entries(record, test, settings)
    # The readings of the probes are not kept, filtered or not.
    history = (*record.history, filtered, inverted, *evaluated.entries)
    return replace(without(evaluated.record, test.channel_names), history=history)


def without(record: Record, names: Iterable[str]) -> Record:
    """Return the record without channels that nobody asks for any more."""
    gone = set(names)
    return replace(record, channels={n: c for n, c in record.channels.items() if n not in gone})


def _stored(record: Record, test: TestDescription, settings: ReductionSettings) -> tuple[str, ...]:
    """Return which averages are worth a column on disk: no number depends on it."""
    shift = ("Wc25_hub_kg_s", "Wc25_tip_kg_s") if settings.stall_rule == "hub-tip" else ()
    exit_K = [couple.name for couple in test.thermocouples(31) if couple.name in record]
    work = ("T31_K", "Wc31_kg_s") if any(_mostly_sound(record, name) for name in exit_K) else ()
    return (*READ_BY_ALL, *shift, *work)


def _mostly_sound(record: Record, name: str) -> bool:
    """Tell whether most readings of a channel seem to count."""
    if fault_name(name) not in record:
        return True
    some = list(blocks(record.n_samples))[::BLOCKS_BETWEEN]
    bad = sum(int(np.count_nonzero(kinds_of_fault(record, name, rows))) for rows in some)
    return bool(2 * bad < sum(rows.stop - rows.start for rows in some))


def _in_use(record: Record, test: TestDescription) -> tuple[str, ...]:
    return tuple(name for name in test.channel_names if name in record)


def _by_way_of_probes(
    record: Record, test: TestDescription, settings: ReductionSettings, keep_probes: bool
) -> Record:
    for plane in test.areas_m2:
        # Refused before anything is computed, as where the averages are made in one go.
        averaged_plane(record, test, plane, settings.probes)
    filtered = filter_channels(
        record,
        _in_use(record, test),
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )
    inverted = invert_thermocouples(filtered, test, invert=settings.thermocouple_inversion)
    if keep_probes:
        return plane_averages(local_flows(inverted, test), test, settings.probes)
    return without(plane_flows(inverted, test, settings.probes), test.channel_names)


def _filtered_flows(
    record: Record, test: TestDescription, settings: ReductionSettings
) -> tuple[PlaneFlows, LocalFilter]:
    """Return the averages of the filtered channels, and the filter, block by block."""
    names = _in_use(record, test)
    run = channel_filter(
        record,
        names,
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )

    def readings(rows: slice) -> dict[str, FloatArray]:
        return dict(zip(names, run(rows), strict=True))

    return PlaneFlows(record, test, settings.probes, readings), run


def _entries(
    record: Record, test: TestDescription, settings: ReductionSettings
) -> tuple[LedgerEntry, LedgerEntry]:
    filtered = filter_entry(
        len(_in_use(record, test)),
        record.sample_rate_hz,
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )
    inverted = invert_thermocouples(record, test, invert=settings.thermocouple_inversion)
    return filtered, inverted.history[-1]


def _same_channels(record: Record, test: TestDescription, ahead: LookAhead) -> bool:
    """Tell whether the channels are those seen ahead, but for temperatures of bare planes."""
    bare = [p for p in test.areas_m2 if not any(c.name in record for c in test.thermocouples(p))]
    lost = {c.name for p in bare for c in test.thermocouples(p)}
    return all((n in record) == (n in ahead.before) for n in test.channel_names if n not in lost)


def _changed(
    record: Record, before: Record, names: Iterable[str], run: LocalFilter
) -> Iterator[slice]:
    """Yield the blocks of which the filtered channels are not those of another record."""
    others = [name for name in names if record.channel(name) is not before.channel(name)]
    spans = [_differing(record, before, others, rows) for rows in blocks(record.n_samples)]
    first, last = np.array([span for span in spans if span] or [(0, -1)]).T
    for rows in blocks(record.n_samples):
        needed = run.needed(rows)
        if np.any((last >= needed.start) & (first < needed.stop)):
            yield rows


def _differing(
    record: Record, before: Record, names: Iterable[str], rows: slice
) -> tuple[int, int] | None:
    """Return the first and the last row of a block in which a channel is another one."""
    differs = np.zeros(rows.stop - rows.start, dtype=np.bool_)
    for name in names:
        # Lines are drawn across what does not count, in one of them or in both.
        if fault_name(name) in record:
            differs |= kinds_of_fault(record, name, rows) != 0
        else:
            differs |= record[name][rows] != before[name][rows]
    record.workspace.release()
    places = np.flatnonzero(differs)
    if not places.size:
        return None
    return rows.start + int(places[0]), rows.start + int(places[-1])
