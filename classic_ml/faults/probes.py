"""Probes of one plane beside each other: one that has come off, one that is another's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.faults.findings import alike
from classic_ml.records import Record
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
    """Return the probes in use, matched near stall, that do not go with those beside them."""
    gains = [
        f"{name} moves {found.gain:.2f} times as much as the probes beside it, {found.apart:.0%} "
        "apart from them: check its zero and calibrate readings"
        for name, found in agreements.items()
        if name in slow and (abs(found.gain - 1.0) > GAIN_DOUBTED or found.apart > APART_DOUBTED)
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
