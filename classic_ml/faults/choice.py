"""Which channels can be used in the window of the surge cycles, and what is bridged in them.

Probes of one plane are set beside each other: one that has come off, one that is another's.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.description import CountChannel, TestDescription
from classic_ml.faults.search import BEYOND_LIMITS, CLIPPED, MARK_WORDS, SPIKED, STUCK, alike
from classic_ml.intervals import bridged
from classic_ml.records import Channel, Dropped, LedgerEntry, Record, fault_name
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Averages over a 40th of a second, and of two such, leave the surge cycle and little of the stall
# cells, which pass the rakes one after the other.
AVERAGE_HZ = 40.0
# Fewer than those of three surge cycles say nothing.
FEWEST_AVERAGES = 16
# A pressure that moves less than one per cent is no measure of another's movement.
LEAST_MOVEMENT = 0.01
# Of two probes that differ either may be wrong.
FEWEST_PROBES = 3
# Mean pressures of two rakes at one immersion are within 0.4 % of each other on those records once
# they are matched near stall; a zero that drifts by 1 % of P25 moves φ by 0.04.
LEVELS_APART = 0.01
# Sound probes of 13 simulated records move by 0.96 to 1.03 times what those beside them do, and
# differ from them by 9 % of it; beyond these the sensitivity is in doubt.
GAIN_DOUBTED, APART_DOUBTED = 0.08, 0.2

SlowPressures = Mapping[str, FloatArray]


class Agreement(NamedTuple):
    """How a probe goes with those beside it.

    ``gain`` is its movement over theirs, ``apart`` the rms of its difference from them, its mean
    apart, over that of their movement.
    """

    gain: float
    apart: float


def slow_pressures(record: Record, test: TestDescription, window: slice) -> dict[str, FloatArray]:
    """Average each pressure over a 40th of a second, from the beginning of the window on.

    By channel of shape (n,); NaN where a reading of an average does not count.
    """
    width = max(1, round(record.sample_rate_hz / AVERAGE_HZ))
    n = (window.stop - window.start) // width
    rows = slice(window.start, window.start + n * width)
    means = {}
    for name in (probe.name for probe in test.pressures if probe.name in record):
        means[name] = record[name][rows].reshape(n, width).mean(axis=1)
        means[name][np.any(record.marks(name)[rows].reshape(n, width), axis=1)] = np.nan
    return means


def compare_probes(slow: SlowPressures, test: TestDescription) -> dict[str, Agreement]:
    """Compare each pressure with the median of those of its plane that face its way.

    None is compared where fewer than three probes, too few rows or no movement are there to judge
    by.
    """
    out: dict[str, Agreement] = {}
    for group in alike(test.pressures, "plane", "facing"):
        names = [name for name in group if name in slow]
        if len(names) < FEWEST_PROBES:
            continue
        values = _smooth(slow, names)
        if values.shape[1] < FEWEST_AVERAGES:
            continue
        for i, name in enumerate(names):
            others = np.median(np.delete(values, i, axis=0), axis=0)
            moves = np.std(others)
            if moves > LEAST_MOVEMENT * np.mean(others):
                own, beside = values[i] - np.mean(values[i]), others - np.mean(others)
                gain = float(np.mean(own * beside) / moves**2)
                out[name] = Agreement(gain, float(np.std(own - beside) / moves))
    return out


def disagreements(
    slow: SlowPressures, test: TestDescription, agreements: Mapping[str, Agreement]
) -> list[str]:
    """Return the probes in use, matched near stall, that do not go with those beside them.

    One that moves as another rake does at the same immersion shows the gas there, and no fault.
    """
    places = alike(test.pressures, "plane", "immersion", "facing")
    beside = {name: set(group) - {name} for group in places for name in group}
    gains = [
        f"{name} moves {found.gain:.2f} times as much as the probes beside it, {found.apart:.0%} "
        "apart from them: check its zero and calibrate readings"
        for name, found in agreements.items()
        if name in slow and (abs(found.gain - 1.0) > GAIN_DOUBTED or found.apart > APART_DOUBTED)
        if all(
            abs(agreements[other].gain - found.gain) > 0.5 * GAIN_DOUBTED
            for other in beside[name] & agreements.keys()
        )
    ]
    return [*gains, *_drifted_apart(slow, test)]


def _smooth(slow: SlowPressures, names: Sequence[str]) -> FloatArray:
    """Return the means of each two averages in a row where all of them count, a channel a row."""
    values = np.array([slow[name] for name in names])
    means = 0.5 * (values[:, 1:] + values[:, :-1])
    return np.asarray(means[:, np.isfinite(means).all(axis=0)])


def _drifted_apart(slow: SlowPressures, test: TestDescription) -> list[str]:
    """Return probes at one immersion that agree near stall and no longer in the surge cycles."""
    found = []
    for names in alike(test.pressures, "plane", "immersion", "facing"):
        sound = {n: slow[n][np.isfinite(slow[n])] for n in names if n in slow}
        means = {name: float(np.mean(values)) for name, values in sound.items() if values.size}
        if not means:
            continue
        low, high = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        apart = means[high] / means[low] - 1.0
        if apart > LEVELS_APART:
            found.append(
                f"{high} is {apart:.1%} above {low} in the window, though both were matched near "
                "stall: has the zero of one drifted, or is its sensitivity wrong?"
            )
    return found


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
# A probe that moves by half or by twice as much as those beside it has come off, or is another's.
GAIN_REFUSED, APART_REFUSED = 2.0, 0.6
ALL_KINDS = sum(MARK_WORDS)


def choose_channels(record: Record, test: TestDescription, window: slice) -> Record:
    """Leave out the channels that cannot be used in the window, a pressure with its mate.

    The record is calibrated and matched, with the marks of :func:`inspect_readings`. Of the
    channels that stay, thermocouples are bridged by straight lines where their readings do not
    count, pressures where they have spikes. A record is refused when an immersion of a plane, or
    the thermocouples of plane 25, would be left out whole.
    """
    bad = _marked_out(record, test, window)
    slow = slow_pressures(record, test, window)
    slow = {name: means for name, means in slow.items() if name not in bad}
    agreements = compare_probes(slow, test)
    bad |= _come_off(agreements, window)
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
    used = {name: means for name, means in slow.items() if name not in gone}
    entry = LedgerEntry(
        "choose channels",
        f"{len(test.channel_names) - len(gone)} of {len(test.channel_names)} channels are used",
        {"clipped_share": CLIPPED_SHARE, "beyond_limits_share": BEYOND_SHARE},
        tuple(dropped),
        tuple(disagreements(used, test, agreements)),
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


def _come_off(agreements: Mapping[str, Agreement], window: slice) -> dict[str, Dropped]:
    """Return the probes that do not take part in what those beside them show."""
    return {
        name: Dropped(
            name,
            window.stop - window.start,
            f"moving {found.gain:.2f} times as much as the probes beside it in the window, and "
            f"{found.apart:.0%} apart from them",
        )
        for name, found in agreements.items()
        if not 1.0 / GAIN_REFUSED < found.gain < GAIN_REFUSED or found.apart > APART_REFUSED
    }


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
