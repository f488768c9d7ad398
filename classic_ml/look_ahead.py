"""From the channels to the averages over the planes, once where the same is asked for twice.

The window of the surge cycles is found in averages of all channels; which of them can be used
depends on the window. Where that changes nothing, the averages are not computed a second time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.airflow import local_flows, plane_averages, plane_flows
from classic_ml.calibration import invert_thermocouples
from classic_ml.filtering import filter_channels
from classic_ml.readers.test_description import TestDescription
from classic_ml.records import Channel, Record
from classic_ml.reduction_settings import ReductionSettings

__all__ = ["LookAhead", "look_ahead", "probe_averages", "without"]

# Enough for any of the filters to run over.
ENTRY_ROWS = 64

# What the window is looked for with.
AHEAD = ReductionSettings(phase="zero")
FILTER = ("filter_order", "cutoff_hz", "phase")
AVERAGING = (*FILTER, "probes", "thermocouple_inversion")


@dataclass(frozen=True)
class LookAhead:
    """A record with every channel in it, from which the window is found.

    Parameters
    ----------
    before : Record
        As it came.
    filtered : Record
        Its channels filtered.
    averaged : Record
        With the averages over the planes.
    """

    before: Record
    filtered: Record
    averaged: Record

    def has(self, record: Record, name: str) -> bool:
        """Tell whether a channel is still the one that was looked at."""
        return name in record and record.channel(name) is self.before.channel(name)


def look_ahead(record: Record, test: TestDescription, *, keep_probes: bool) -> LookAhead:
    """Filter and average every channel; parameters as those of :func:`probe_averages`."""
    filtered = _filtered(record, test.channel_names, AHEAD)
    inverted = invert_thermocouples(filtered, test, invert=AHEAD.thermocouple_inversion)
    return LookAhead(record, filtered, _over_planes(inverted, test, AHEAD, keep_probes))


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
        taken over.

    Returns
    -------
    Record
        With the averages of :func:`classic_ml.airflow.plane_averages`.
    """
    names = tuple(name for name in test.channel_names if name in record)
    if ahead is None or not _alike(settings, FILTER):
        filtered = _filtered(record, names, settings)
    else:
        filtered = _filtered_anew(record, names, settings, ahead)
        if _alike(settings, AVERAGING) and _same_averages(record, test, ahead):
            return _taken_over(filtered, test, ahead)
    inverted = invert_thermocouples(filtered, test, invert=settings.thermocouple_inversion)
    return _over_planes(inverted, test, settings, keep_probes)


def without(record: Record, names: Iterable[str]) -> Record:
    """Return the record without channels that nobody asks for any more."""
    gone = set(names)
    return replace(record, channels={n: c for n, c in record.channels.items() if n not in gone})


def _alike(settings: ReductionSettings, names: tuple[str, ...]) -> bool:
    return all(getattr(settings, name) == getattr(AHEAD, name) for name in names)


def _filtered(record: Record, names: tuple[str, ...], settings: ReductionSettings) -> Record:
    return filter_channels(
        record,
        names,
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )


def _filtered_anew(
    record: Record, names: tuple[str, ...], settings: ReductionSettings, ahead: LookAhead
) -> Record:
    """Filter the channels that were not filtered so before."""
    changed = tuple(name for name in names if not ahead.has(record, name))
    fresh = _filtered(record, changed, settings) if changed else record
    done = {name: ahead.filtered.channel(name) for name in names if name not in changed}
    # The ledger is that of all channels, filtered at once.
    few = {name: Channel(name, np.zeros(ENTRY_ROWS), record.channel(name).unit) for name in names}
    entry = _filtered(Record(few, record.sample_rate_hz), names, settings).history[-1]
    channels = {**fresh.channels, **done}
    return replace(record, channels=channels, history=(*record.history, entry))


def _over_planes(
    record: Record, test: TestDescription, settings: ReductionSettings, keep_probes: bool
) -> Record:
    if keep_probes:
        return plane_averages(local_flows(record, test), test, settings.probes)
    return without(plane_flows(record, test, settings.probes), test.channel_names)


def _bare_planes(record: Record, test: TestDescription) -> list[int]:
    """Return the planes without a thermocouple that counts."""
    return [p for p in test.areas_m2 if not any(c.name in record for c in test.thermocouples(p))]


def _same_averages(record: Record, test: TestDescription, ahead: LookAhead) -> bool:
    """Tell whether the averages are those seen ahead, but for temperatures of bare planes."""
    lost = {c.name for p in _bare_planes(record, test) for c in test.thermocouples(p)}
    return all(ahead.has(record, name) for name in test.channel_names if name not in lost)


def _taken_over(filtered: Record, test: TestDescription, ahead: LookAhead) -> Record:
    """Return the averages seen ahead, in a record with the history of this one."""
    steps = ahead.averaged.history[len(ahead.filtered.history) :]
    averaged = replace(ahead.averaged, history=(*filtered.history, *steps))
    bare = _bare_planes(filtered, test)
    gone = [c for p in bare for c in (f"T{p}_K", f"W{p}_kg_s")]
    return without(averaged, [*gone, *(n for n in test.channel_names if n not in filtered)])
