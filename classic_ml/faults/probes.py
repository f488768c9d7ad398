"""Probes of one plane beside each other: one that has come off, one that is another's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.faults.findings import Finding
from classic_ml.records import Record, fault_name
from surge_core.types import BoolArray, FloatArray

__all__ = ["Agreement", "SlowPressures", "compare_probes", "disagreements", "slow_pressures"]

# Averages over a 40th of a second, and of two such, leave the surge cycle and little of the stall
# cells, which pass the rakes one after the other.
AVERAGE_HZ = 40.0
# Fewer than those of three surge cycles say nothing.
FEWEST_AVERAGES = 16
# A pressure that moves less than one per cent is no measure of another's movement.
LEAST_MOVEMENT = 0.01
# Of two probes that differ either may be wrong.
FEWEST_PROBES = 3
# Where hub and tip of two rakes are nearer crosswise than straight by this factor, one of the
# rakes is upside down: straight they are nearer by 1.4 and more on 12 records of two rigs.
CROSSWISE = 1.5
# Mean pressures of two rakes at one immersion are within 0.4 % of each other on those records once
# they are matched near stall; a zero that drifts by 1 % of P25 moves φ by 0.04.
LEVELS_APART = 0.01
# Sound probes of 13 simulated records move by 0.96 to 1.03 times what those beside them do, and
# differ from them by 9 % of it; beyond these the sensitivity is in doubt.
GAIN_DOUBTED, APART_DOUBTED = 0.08, 0.2


@dataclass(frozen=True)
class SlowPressures:
    """The pressures of a window, averaged over a 40th of a second each.

    Parameters
    ----------
    means : mapping of str to ndarray of shape (n,)
        By channel.
    sound : mapping of str to ndarray of bool, shape (n,)
        True where all readings of an average count.
    """

    means: Mapping[str, FloatArray]
    sound: Mapping[str, BoolArray]

    def smooth(self, names: Sequence[str]) -> FloatArray:
        """Return the means of each two averages in a row where all of them count.

        Parameters
        ----------
        names : sequence of str
            Channels.

        Returns
        -------
        ndarray of shape (n_channels, m)
            One row a channel.
        """
        values = np.array([self.means[name] for name in names])
        sound = np.all([self.sound[name] for name in names], axis=0)
        return np.asarray(0.5 * (values[:, 1:] + values[:, :-1])[:, sound[1:] & sound[:-1]])

    def without(self, names: Iterable[str]) -> SlowPressures:
        """Return them without some channels."""
        gone = set(names)
        return SlowPressures({n: v for n, v in self.means.items() if n not in gone}, self.sound)


@dataclass(frozen=True)
class Agreement:
    """How a probe goes with those beside it.

    Parameters
    ----------
    gain : float
        Its movement over theirs.
    apart : float
        The rms of its difference from them, its mean apart, over that of their movement.
    """

    gain: float
    apart: float


def slow_pressures(record: Record, test: TestDescription, window: slice) -> SlowPressures:
    """Average the pressures over a 40th of a second each.

    Parameters
    ----------
    record : Record
        Calibrated pressures.
    test : TestDescription
        Their names.
    window : slice
        Rows of the surge cycles, from whose beginning the averages are taken.
    """
    width = max(1, round(record.sample_rate_hz / AVERAGE_HZ))
    n = (window.stop - window.start) // width
    rows = slice(window.start, window.start + n * width)
    names = [probe.name for probe in test.pressures if probe.name in record]
    means = {name: record[name][rows].reshape(n, width).mean(axis=1) for name in names}
    sound = {name: np.ones(n, dtype=np.bool_) for name in names}
    for name in names:
        if fault_name(name) in record:
            sound[name] = ~np.any(record[fault_name(name)][rows].reshape(n, width), axis=1)
    return SlowPressures(means, sound)


def compare_probes(slow: SlowPressures, test: TestDescription) -> dict[str, Agreement]:
    """Compare each pressure with the median of those of its plane that face its way.

    Parameters
    ----------
    slow : SlowPressures
        Those that count.
    test : TestDescription
        Places of the probes.

    Returns
    -------
    dict of str to Agreement
        By channel; none where fewer than three probes, too few rows or no movement are there to
        judge by.
    """
    groups: dict[tuple[int, str], list[str]] = {}
    for probe in test.pressures:
        if probe.name in slow.means:
            groups.setdefault((probe.plane, probe.facing), []).append(probe.name)
    out: dict[str, Agreement] = {}
    for names in groups.values():
        if len(names) < FEWEST_PROBES:
            continue
        values = slow.smooth(names)
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
) -> list[Finding]:
    """Return the probes in use that do not go with those beside them.

    Parameters
    ----------
    slow : SlowPressures
        Of the channels in use, matched near stall.
    test : TestDescription
        Places of the probes.
    agreements : mapping of str to Agreement
        Of these channels, from :func:`compare_probes`.
    """
    gains = [
        Finding("gain", name, details={"gain": found.gain, "apart": found.apart})
        for name, found in agreements.items()
        if name in slow.means
        and (abs(found.gain - 1.0) > GAIN_DOUBTED or found.apart > APART_DOUBTED)
    ]
    return [*gains, *_exchanged_immersions(slow, test), *_drifted_apart(slow, test)]


def _exchanged_immersions(slow: SlowPressures, test: TestDescription) -> list[Finding]:
    """Return rakes of a plane of which the hub of one goes with the tip of the other."""
    found = []
    for plane in test.areas_m2:
        rakes: dict[str, dict[str, list[str]]] = {}
        for pair in test.pairs(plane):
            names = [pair.forward.name, pair.aft.name]
            if all(name in slow.means for name in names):
                rakes.setdefault(pair.forward.rake, {})[pair.immersion] = names
        whole = [rake for rake, pairs in rakes.items() if len(pairs) == 2]
        for i, first in enumerate(whole):
            for second in whole[i + 1 :]:
                if _crosswise(slow, rakes[first], rakes[second]):
                    details: dict[str, str | float] = {
                        "plane": plane,
                        "first": first,
                        "second": second,
                    }
                    found.append(Finding("exchanged immersions", details=details))
    return found


def _crosswise(
    slow: SlowPressures, first: Mapping[str, list[str]], second: Mapping[str, list[str]]
) -> bool:
    """Return whether hub and tip of two rakes are nearer to each other crosswise than straight."""
    values = slow.smooth([*first["hub"], *first["tip"], *second["hub"], *second["tip"]])
    hub_1, tip_1, hub_2, tip_2 = values[0::2] - values[1::2]
    straight = np.sum(np.abs(hub_1 - hub_2) + np.abs(tip_1 - tip_2))
    across = np.sum(np.abs(hub_1 - tip_2) + np.abs(tip_1 - hub_2))
    return bool(straight > CROSSWISE * across)


def _drifted_apart(slow: SlowPressures, test: TestDescription) -> list[Finding]:
    """Return probes at one immersion that agree near stall and no longer in the surge cycles."""
    groups: dict[tuple[int, str, str], dict[str, float]] = {}
    for probe in test.pressures:
        if probe.name in slow.means and slow.means[probe.name].size:
            place = (probe.plane, probe.immersion, probe.facing)
            groups.setdefault(place, {})[probe.name] = float(np.mean(slow.means[probe.name]))
    found = []
    for means in groups.values():
        low, high = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        apart = means[high] / means[low] - 1.0
        if apart > LEVELS_APART:
            found.append(Finding("drifted apart", high, details={"other": low, "apart": apart}))
    return found
