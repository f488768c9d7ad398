"""Which channels can be used in the window of the surge cycles, and what is bridged in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.description import CountChannel, TestDescription
from classic_ml.faults.likes import compare_likes
from classic_ml.faults.search import BEYOND_LIMITS, CLIPPED, MARK_WORDS, SPIKED, STUCK
from classic_ml.intervals import bridged
from classic_ml.records import Channel, Dropped, LedgerEntry, Record, fault_name
from surge_core.errors import InputError

# Measured on the 98.5 % record with its inlet pressures raised until the probes clip: 1.3 % of
# the rows shift ψ'_QS by 0.03, as much as the calibration's own error; 8 % shift it by 0.32.
# Kept, its clipped rows bridged and not scored, the last pair of an immersion gave a τ on one of
# seven records on which it clipped in 1.3 to 7 % of the rows; on six none was stated.
CLIPPED_SHARE = 0.01
# "Substantial": beyond this share of the window a straight line across the gaps is no reading.
BEYOND_SHARE = 0.05
ALLOWED_SHARE = {
    CLIPPED: CLIPPED_SHARE,
    STUCK: 0.0,
    BEYOND_LIMITS: BEYOND_SHARE,
    SPIKED: CLIPPED_SHARE,
}
ALL_KINDS = sum(MARK_WORDS)


def choose_channels(record: Record, test: TestDescription, window: slice) -> Record:
    """Leave out the channels that cannot be used in the window, a pressure with its mate.

    The record is calibrated and matched, with the marks of :func:`inspect_readings`. Of the
    channels that stay, thermocouples are bridged by straight lines where their readings do not
    count, pressures where they have spikes. A record is refused when an immersion of a plane, or
    the thermocouples of plane 25, would be left out whole.
    """
    bad = _marked_out(record, test, window)
    unlike, doubts = compare_likes(record, test, window, bad)
    bad |= unlike
    dropped, gone = _drop_pairs(record, test, bad)
    for plane in test.areas_m2:
        couples = test.thermocouples(plane)
        out = [c.name for c in couples if c.name in bad]
        if plane == 25 and len(out) == len(couples):
            raise _refusal(record, test, bad[out[0]], "the last thermocouple of plane 25")
        dropped += [bad[name] for name in out]
        gone += out
        if couples and len(out) == len(couples):
            dropped.append(Dropped("W31 and ψ", record.n_samples, "no thermocouple left there"))
    kept = record.without([*gone, *map(fault_name, gone)])
    entry = LedgerEntry(
        "choose channels",
        f"{len(test.channel_names) - len(gone)} of {len(test.channel_names)} channels are used",
        {"clipped_share": CLIPPED_SHARE, "beyond_limits_share": BEYOND_SHARE},
        tuple(dropped),
        tuple(doubt for doubt in doubts if not any(name in doubt for name in gone)),
    )
    kept = with_faults_bridged(kept.after(entry), [c.name for c in test.temperatures])
    return with_faults_bridged(kept, [p.name for p in test.pressures], SPIKED)


def with_faults_bridged(record: Record, names: Iterable[str], kinds: int = ALL_KINDS) -> Record:
    """Return a record with straight lines across readings that do not count, of some kinds."""
    channels = dict(record.channels)
    for name in names:
        sound = record.marks(name) & kinds == 0
        if name in record and not sound.all():
            values = bridged(record[name], sound)
            channels[name] = Channel(name, values, record.channel(name).unit)
    return replace(record, channels=channels)


def _marked_out(record: Record, test: TestDescription, window: slice) -> dict[str, Dropped]:
    """Return the channels of which too many readings do not count, or that cannot be matched."""
    looked_at = {"in the window": window}
    if not test.near_stall_shifts:
        rows = near_stall_rows(record, test)
        looked_at["at near stall, so that it cannot be matched"] = rows
    aft = {probe.name for probe in test.pressures if probe.facing == "aft"}
    n_rows = window.stop - window.start
    out: dict[str, Dropped] = {}
    for name in test.channel_names:
        readings, marks = record[name][window], record.marks(name)
        for where, rows in looked_at.items():
            n = rows.stop - rows.start
            for kind, word in MARK_WORDS.items():
                count = int(np.count_nonzero(marks[rows] & kind))
                if count > ALLOWED_SHARE[kind] * n:
                    why = f"{word} in {count} of {n} rows {where}"
                    out.setdefault(name, Dropped(name, count, why))
        if test.near_stall_shifts and name not in {*test.near_stall_shifts, *aft}:
            why = f"not in {test.source} [near_stall_shifts], so that it cannot be matched"
            out[name] = Dropped(name, record.n_samples, why)
        if n_rows and np.all(readings == readings[0]):
            out[name] = Dropped(name, n_rows, f"the same in all {n_rows} rows in the window")
    return out


def _drop_pairs(
    record: Record, test: TestDescription, bad: Mapping[str, Dropped]
) -> tuple[list[Dropped], list[str]]:
    dropped: list[Dropped] = []
    gone: list[str] = []
    for plane in test.areas_m2:
        pairs = test.pairs(plane)
        verdicts = {p.name: bad.get(p.forward.name) or bad.get(p.aft.name) for p in pairs}
        for pair in pairs:
            verdict = verdicts[pair.name]
            if verdict is None:
                continue
            beside = (p for p in pairs if p.immersion == pair.immersion)
            if all(verdicts[p.name] is not None for p in beside):
                last = f"the last {pair.immersion} pair of plane {plane}"
                raise _refusal(record, test, verdict, last)
            gone += [pair.forward.name, pair.aft.name]
            why = f"{verdict.what} is {verdict.why}"
            dropped.append(Dropped(f"pair {pair.name}", verdict.count, why))
    return dropped, gone


def _refusal(record: Record, test: TestDescription, verdict: Dropped, last: str) -> InputError:
    channel = next(each for each in test.channels if each.name == verdict.what)
    scale = "unit (psia or psig?), reference_Pa" if channel.kind == "pressure" else "unit"
    if isinstance(channel, CountChannel):
        scale = "zero and calibrate readings"
    # What is cut off, stuck or spiked is so on any scale.
    fault = tuple(word for kind, word in MARK_WORDS.items() if kind != BEYOND_LIMITS)
    asked = "" if verdict.why.startswith(fault) else f"are its {scale} and [limits] right? else "
    return InputError(
        f"{record.source}: channel {verdict.what}",
        expected=f"readings that count, since {last} goes with it",
        found=f"it {verdict.why}",
        remedy=f"{asked}choose a window with less of it ({CLIPPED_SHARE:.0%} of the rows may be "
        "clipped), or widen the range of the transducer",
    )
