"""Probes of one plane beside each other: one that has come off, one that is another's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from classic_ml.columns.computed import as_stored
from classic_ml.columns.growing import GrowingColumns
from classic_ml.columns.order_statistics import mean
from classic_ml.description import TestDescription
from classic_ml.faults.marks import fault_name
from classic_ml.records import Channel, Record
from surge_core.types import FloatArray

__all__ = [
    "Agreement",
    "compare_probes",
    "drifted_apart",
    "exchanged_immersions",
    "slow_pressures",
]

# Averages over a 40th of a second, and of two such, leave the surge cycle and little of the stall
# cells, which pass the rakes one after the other.
AVERAGE_HZ = 40.0
# So many of them are compared at once.
PIECE = 2048
# So many readings of each channel are averaged at once: 10 MB of 20 channels.
READINGS = 51_200
# Fewer than those of three surge cycles tell nothing.
FEWEST_AVERAGES = 16
# A pressure that moves less than one per cent is no measure of another's movement.
LEAST_MOVEMENT = 0.01
# Of two probes that differ nobody knows which one is wrong.
FEWEST_PROBES = 3
# Where hub and tip of two rakes are nearer crosswise than straight by this factor, one of the
# rakes is upside down: straight they are nearer by 1.4 and more on 12 records of two rigs.
CROSSWISE = 1.5
# Mean pressures of two rakes at one immersion are within 0.4 % of each other on those records once
# they are matched near stall; a zero that drifts by 1 % of P25 moves φ by 0.04.
LEVELS_APART = 0.01


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


def slow_pressures(record: Record, test: TestDescription, window: slice) -> Record:
    """Average the pressures over a 40th of a second each.

    Parameters
    ----------
    record : Record
        Calibrated pressures.
    test : TestDescription
        Their names.
    window : slice
        Rows of the surge cycles, from whose beginning the averages are taken.

    Returns
    -------
    Record
        The pressures that are in the record, and for each that has faults ``fault_NAME``: 1 where
        one of the readings does not count.
    """
    width = max(1, round(record.sample_rate_hz / AVERAGE_HZ))
    pressures = [probe.name for probe in test.pressures if probe.name in record]
    faults = [fault_name(name) for name in pressures if fault_name(name) in record]
    n_rows = (window.stop - window.start) // width
    columns = GrowingColumns(record.workspace, len(pressures) + len(faults), n_rows)
    some, ones = max(1, READINGS // width), np.ones(width)
    for first in range(0, n_rows, some):
        n = min(some, n_rows - first)
        start = window.start + first * width
        part = slice(start, start + n * width)
        # A product with ones adds rows so short faster than a sum over them.
        means = [record[name][part].reshape(n, width) @ ones / width for name in pressures]
        marks = [as_stored(record[fault])[part] for fault in faults]
        none = np.zeros(n, dtype=np.bool_)
        marked = [np.any(m.reshape(n, width), axis=1) if m.any() else none for m in marks]
        columns.append_columns(tuple(chain(means, marked)))
        record.workspace.release()
    values = zip((*pressures, *faults), columns.finished(), strict=True)
    return replace(
        record,
        channels={name: Channel(name, column, "Pa") for name, column in values},
        sample_rate_hz=record.sample_rate_hz / width,
    )


def compare_probes(
    slow: Record, test: TestDescription, without: Iterable[str] = ()
) -> dict[str, Agreement]:
    """Compare each pressure with the median of those of its plane that face its way.

    Parameters
    ----------
    slow : Record
        From :func:`slow_pressures`.
    test : TestDescription
        Places of the probes.
    without : iterable of str
        Channels that do not count.

    Returns
    -------
    dict of str to Agreement
        By channel; none where fewer than three probes, too few rows or no movement are there to
        judge by.
    """
    out: dict[str, Agreement] = {}
    left_out = set(without)
    groups: dict[tuple[int, str], list[str]] = {}
    for probe in test.pressures:
        if probe.name in slow and probe.name not in left_out:
            groups.setdefault((probe.plane, probe.facing), []).append(probe.name)
    for names in groups.values():
        if len(names) >= FEWEST_PROBES:
            out |= _agreements(slow, names)
    return out


def _agreements(slow: Record, names: Sequence[str]) -> dict[str, Agreement]:
    sums = np.zeros((5, len(names)))
    origins: FloatArray | None = None
    n = 0
    for values in _averages(slow, names):
        if not values.shape[1]:
            continue
        if origins is None:
            # Products of large numbers would lose the small movements.
            origins = values[:, :1]
        own = values - origins
        others = medians_of_others(own)
        products = (own, others, own * own, others * others, own * others)
        sums += np.array([product.sum(axis=1) for product in products])
        n += own.shape[1]
    if n < FEWEST_AVERAGES or origins is None:
        return {}
    mean_own, mean_others, own_2, others_2, cross = sums / n
    var_own, var_others = own_2 - mean_own**2, others_2 - mean_others**2
    covariance = cross - mean_own * mean_others
    moves = var_others > (LEAST_MOVEMENT * (mean_others + origins[:, 0])) ** 2
    apart_2 = np.maximum(var_own + var_others - 2.0 * covariance, 0.0)
    return {
        name: Agreement(
            float(covariance[i] / var_others[i]), float(np.sqrt(apart_2[i] / var_others[i]))
        )
        for i, name in enumerate(names)
        if moves[i]
    }


def medians_of_others(values: FloatArray) -> FloatArray:
    """Return for each channel the median of the others, row by row.

    Parameters
    ----------
    values : ndarray of shape (n_channels, n)
        The channels, two or more.
    """
    in_order = np.sort(values, axis=0)
    # Without one of them those above it come one place down.
    lower, upper = (len(values) - 2) // 2, (len(values) - 1) // 2
    low: FloatArray = np.where(values <= in_order[lower], in_order[lower + 1], in_order[lower])
    if lower == upper:
        return low
    high = np.where(values <= in_order[upper], in_order[upper + 1], in_order[upper])
    return np.asarray(0.5 * (low + high))


def exchanged_immersions(
    slow: Record, test: TestDescription, without: Iterable[str] = ()
) -> list[tuple[int, str, str]]:
    """Return rakes of a plane of which the hub of one goes with the tip of the other.

    Parameters
    ----------
    slow, test, without
        As for :func:`compare_probes`.

    Returns
    -------
    list of (int, str, str)
        Plane and two rakes; which of them is upside down they alone do not tell.
    """
    out = []
    left_out = set(without)
    for plane in test.areas_m2:
        rakes: dict[str, dict[str, tuple[str, str]]] = {}
        for pair in test.pairs(plane):
            names = (pair.forward.name, pair.aft.name)
            if all(name in slow and name not in left_out for name in names):
                rakes.setdefault(pair.forward.rake, {})[pair.immersion] = names
        whole = [rake for rake, pairs in rakes.items() if len(pairs) == 2]
        for i, first in enumerate(whole):
            for second in whole[i + 1 :]:
                if _crosswise(slow, rakes[first], rakes[second]):
                    out.append((plane, first, second))
    return out


def drifted_apart(
    slow: Record, test: TestDescription, without: Iterable[str] = ()
) -> list[tuple[str, str, float]]:
    """Return probes at one immersion that agree near stall and no longer in the surge cycles.

    Parameters
    ----------
    slow, test, without
        As for :func:`compare_probes`, of pressures matched near stall.

    Returns
    -------
    list of (str, str, float)
        The lower and the higher one, and the difference of their means over the lower one's.
    """
    left_out = set(without)
    groups: dict[tuple[int, str, str], dict[str, float]] = {}
    for probe in test.pressures:
        if slow.n_samples and probe.name in slow and probe.name not in left_out:
            place = (probe.plane, probe.immersion, probe.facing)
            level = mean(slow[probe.name], workspace=slow.workspace)
            groups.setdefault(place, {})[probe.name] = level
    out = []
    for means in groups.values():
        low, high = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        apart = means[high] / means[low] - 1.0
        if apart > LEVELS_APART:
            out.append((low, high, apart))
    return out


def _crosswise(
    slow: Record, first: Mapping[str, tuple[str, str]], second: Mapping[str, tuple[str, str]]
) -> bool:
    """Tell whether hub and tip of two rakes are nearer to each other crosswise than straight."""
    names = [name for rake in (first, second) for place in ("hub", "tip") for name in rake[place]]
    straight = across = 0.0
    for values in _averages(slow, names):
        hub_1, tip_1, hub_2, tip_2 = values[0::2] - values[1::2]
        straight += float(np.sum(np.abs(hub_1 - hub_2) + np.abs(tip_1 - tip_2)))
        across += float(np.sum(np.abs(hub_1 - tip_2) + np.abs(tip_1 - hub_2)))
    return straight > CROSSWISE * across


def _averages(slow: Record, names: Sequence[str]) -> Iterator[FloatArray]:
    """Yield the means of each two averages in a row, where all readings of both count."""
    faults = [fault_name(name) for name in names if fault_name(name) in slow]
    # A piece begins with the last average of the one before.
    for first in range(0, slow.n_samples - 1, PIECE - 1):
        part = slice(first, min(first + PIECE, slow.n_samples))
        values = np.array([slow[name][part] for name in names])
        means = 0.5 * (values[:, 1:] + values[:, :-1])
        faulty = np.zeros(values.shape[1], dtype=np.bool_)
        for fault in faults:
            faulty |= slow[fault][part] != 0.0
        yield means[:, ~(faulty[1:] | faulty[:-1])] if faulty.any() else means
        slow.workspace.release()
