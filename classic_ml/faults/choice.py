"""Which channels can be used in the window of the surge cycles, and what is bridged in them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.columns.workspace import blocks
from classic_ml.description import (
    TestDescription,
)
from classic_ml.faults.bridging import bridged_rows
from classic_ml.faults.marks import (
    BEYOND_LIMITS,
    CLIPPED,
    KIND_WORDS,
    SPIKED,
    STUCK,
    fault_counts,
    fault_name,
    has_fault,
    kinds_of_fault,
)
from classic_ml.faults.probe_agreement import (
    Agreement,
    compare_probes,
    drifted_apart,
    exchanged_immersions,
    slow_pressures,
)
from classic_ml.records import Channel, Dropped, LedgerEntry, Record
from surge_core.errors import InputError

__all__ = ["BEYOND_SHARE", "CLIPPED_SHARE", "choose_channels", "with_faults_bridged"]

# Measured on the 98.5 % record with its inlet pressures raised until the probes clip: 1.3 % of
# the rows shift ψ'_QS by 0.03, as much as the calibration's own error; 8 % shift it by 0.32.
CLIPPED_SHARE = 0.01
# "Substantial": beyond this share of the window a straight line across the gaps is no reading.
BEYOND_SHARE = 0.05
# Sound probes of 13 simulated records move by 0.96 to 1.03 times what those beside them do, and
# differ from them by 9 % of it. One that moves by half or by twice as much has come off, or is
# another's; between the two its sensitivity is in doubt.
GAIN_DOUBTED, APART_DOUBTED = 0.08, 0.2
GAIN_REFUSED, APART_REFUSED = 2.0, 0.6
ALL_KINDS = sum(KIND_WORDS)


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
    bridged += [_bridged(record, name, SPIKED) for name in kept if has_fault(record, name, SPIKED)]
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
    if _lacks_shift(test, name):
        why = f"not in {test.source} [near_stall_shifts], so that it cannot be matched"
        return _Verdict(name, record.n_samples, why)
    if fault_name(name) not in record:
        return None
    looked_at = [(window, "in the window")]
    if not test.near_stall_shifts:
        rows = near_stall_rows(record, test)
        looked_at.append((rows, "at near stall, so that it cannot be matched"))
    for rows, where in looked_at:
        n = rows.stop - rows.start
        counts = fault_counts(record, name, rows)
        allowed = {
            CLIPPED: CLIPPED_SHARE * n,
            STUCK: 0.0,
            BEYOND_LIMITS: BEYOND_SHARE * n,
            SPIKED: CLIPPED_SHARE * n,
        }
        for kind, word in KIND_WORDS.items():
            if counts[kind] > allowed[kind]:
                return _Verdict(name, counts[kind], f"{word} in {counts[kind]} of {n} rows {where}")
    return None


def _lacks_shift(test: TestDescription, name: str) -> bool:
    """Tell whether the shifts are stated, and not that of a channel; aft probes have none."""
    aft = {probe.name for probe in test.pressures if probe.facing == "aft"}
    return bool(test.near_stall_shifts) and name not in {*test.near_stall_shifts, *aft}


def _stands_still(record: Record, name: str, rows: slice) -> bool:
    """Tell whether a channel has one and the same reading in all rows, with those alike or not."""
    first = record[name][rows.start]
    for block in blocks(rows.stop, rows.start):
        if not np.all(record[name][block] == first):
            return False
        record.workspace.release()
    return True


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
        remedy="are its unit (psia or psig?) and reference_Pa right? else correct its [limits], or "
        "choose another window"
        if KIND_WORDS[BEYOND_LIMITS] in verdict.why
        else "choose a window without the fault, or mend the range of the transducer",
    )


def _bridged(record: Record, name: str, kinds: int = ALL_KINDS) -> Channel:
    """Return a channel with straight lines across its faults of some kinds, of all without."""
    channel, place, n_rows = record.channel(name), record.workspace, record.n_samples
    rows_of = bridged_rows(
        place,
        n_rows,
        channel.values.__getitem__,
        lambda rows: kinds_of_fault(record, name, rows) & np.uint8(kinds) == 0,
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
    inside = fault_counts(record, name, window)[0]
    if inside:
        return f"{name}: {inside} faulty rows in the window, few enough to keep it"
    return f"{name}: faulty rows outside the window only"
