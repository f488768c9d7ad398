"""Readings that contradict their neighbours: single wrong codes, rows cut out, columns copied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.computed import as_stored
from classic_ml.columns.workspace import blocks
from classic_ml.description import TestDescription
from classic_ml.faults.odd_kernels import jumping_rows, off_neighbours, standing_out
from classic_ml.records import Record
from surge_core.types import FloatArray

__all__ = [
    "copied_columns",
    "copies",
    "jumps",
    "spike_rows",
    "spiked_rows",
    "spikes",
    "splice_rows",
    "splices",
]

# A spike is one row or two wide, and is compared with what its channel does for 25 rows on either
# side. On 52 records of the simulated rigs, stall cells and all, no reading stands out by more than
# 3.5 times that while the probes beside it are quiet; 0.01 of the range are 41 codes of 12 bits.
# One of 700 codes does so by more than 4 times in nearly all places at plane 31, and in three of
# four among the stall cells at plane 25, where those that pass move τ by less than its error.
SPIKE_REACH, SPIKE_GAP = 23, 3
SPIKE_RATIO, SPIKE_SHARE, QUIET_RATIO, SEEN_SHARE = 4.0, 0.01, 1.5, 0.1
SPIKE_MARGIN = SPIKE_REACH + SPIKE_GAP + 3
# A step is compared with the largest of ten on either side. On the same records three quarters of
# the pressures at the discharge never step at once by more than 1.1 times that; where 25 rows of a
# cycle were cut out, they do so by more than 1.8 times in nine cases of ten.
SPLICE_REACH, SPLICE_GAP = 9, 2
SPLICE_RATIO, SPLICE_SHARE = 1.8, 0.75
SPLICE_STEP = 1.0 / 4096.0
SPLICE_MARGIN = SPLICE_REACH + SPLICE_GAP + 1
# Fewer channels at once may jump for a reason of their own.
SPLICE_CHANNELS = 4
# Columns that differ in these rows are no copies of each other.
COPY_HEAD = 1024
# More places than this are not named.
NAMED_PLACES = 3

Ranges = Mapping[str, tuple[float, float]]


def spikes(readings: FloatArray) -> NDArray[np.bool_]:
    """Mark readings, one or two in a row, far off their neighbours in one of some channels alike.

    Parameters
    ----------
    readings : ndarray of shape (n_channels, n)
        Channels that see the same, each over its range: what another shows at once is no fault of
        one. The first and the last `SPIKE_MARGIN` rows are not marked.

    Returns
    -------
    ndarray of bool, shape (n_channels, n)
        True at the wrong readings.
    """
    values = np.asarray(readings, dtype=np.float64)
    marked = np.zeros(values.shape, dtype=np.bool_)
    if values.shape[1] <= 2 * SPIKE_MARGIN:
        return marked
    off = np.empty_like(values)
    off_neighbours(values, off)
    limits = (SPIKE_RATIO, QUIET_RATIO, SEEN_SHARE)
    for channel, far in enumerate(off > SPIKE_SHARE):
        rows = np.flatnonzero(far)
        least = 0.1 * SPIKE_SHARE
        standing_out(off, channel, rows, marked[channel], SPIKE_REACH, SPIKE_GAP, least, limits)
    return marked


def splices(readings: FloatArray) -> NDArray[np.int64]:
    """Return the rows at which most channels jump at once, as where rows were cut out.

    Parameters
    ----------
    readings : ndarray of shape (n_channels, n)
        Pressures of the discharge, each over its range, whose volume does not let them jump. The
        first and the last `SPLICE_MARGIN` rows are not looked at.

    Returns
    -------
    ndarray of int
        The first row behind each jump.
    """
    values = np.asarray(readings, dtype=np.float64)
    if values.shape[0] < SPLICE_CHANNELS or values.shape[1] <= 2 * SPLICE_MARGIN + 1:
        return np.zeros(0, dtype=np.int64)
    fewest = int(np.floor((1.0 - SPLICE_SHARE) * len(values)))
    quiet = np.empty(values.shape[1] - 1, dtype=np.uint16)
    jumping_rows(values, quiet, SPLICE_REACH, SPLICE_GAP, SPLICE_STEP, fewest, SPLICE_RATIO)
    return np.flatnonzero(quiet <= fewest) + 1


def spike_rows(record: Record, ranges: Ranges) -> dict[str, NDArray[np.int64]]:
    """Return where channels of a record that see the same have spikes.

    Parameters
    ----------
    record : Record
        The record.
    ranges : mapping of str to tuple of float
        The channels, and between which readings each can lie.

    Returns
    -------
    dict of str to ndarray of int
        Rows, of those channels that have some.
    """
    found: dict[str, list[NDArray[np.int64]]] = {name: [] for name in ranges}
    for rows, around in _overlapping(record.n_samples, SPIKE_MARGIN):
        marked = spikes(_over_range(record, ranges, around))
        inside = marked[:, rows.start - around.start : rows.stop - around.start]
        for name, which in zip(ranges, inside, strict=True):
            if which.any():
                found[name].append(np.flatnonzero(which) + rows.start)
        record.workspace.release()
    return {name: np.concatenate(parts) for name, parts in found.items() if parts}


def splice_rows(record: Record, ranges: Ranges) -> NDArray[np.int64]:
    """Return the rows of a record at which most of some channels jump at once.

    Parameters
    ----------
    record, ranges
        As for :func:`spike_rows`.
    """
    found = [np.zeros(0, dtype=np.int64)]
    for rows, around in _overlapping(record.n_samples, SPLICE_MARGIN):
        at = splices(_over_range(record, ranges, around)) + around.start
        found.append(at[(at >= rows.start) & (at < rows.stop)])
        record.workspace.release()
    return np.concatenate(found)


def _over_range(record: Record, ranges: Ranges, rows: slice) -> FloatArray:
    values = np.empty((len(ranges), rows.stop - rows.start))
    for number, (name, (low, high)) in enumerate(ranges.items()):
        # First to float64, then scaled: both at once takes twice as long.
        values[number] = as_stored(record[name])[rows]
        values[number] *= 1.0 / (high - low)
    return values


def _overlapping(n_rows: int, margin: int) -> list[tuple[slice, slice]]:
    """Return blocks of rows, each beside the same with a margin on either side."""
    return [
        (rows, slice(max(0, rows.start - margin), min(n_rows, rows.stop + margin)))
        for rows in blocks(n_rows)
    ]


def copied_columns(record: Record, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of channels that hold the same moving readings in every row.

    Parameters
    ----------
    record : Record
        The record.
    names : sequence of str
        Its channels to be looked at.
    """
    alike: dict[bytes, list[str]] = {}
    for name in names:
        head = record[name][:COPY_HEAD]
        alike.setdefault(head.tobytes(), []).append(name)
    return [
        (first, name)
        for first, *others in alike.values()
        for name in others
        if _same(record, first, name)
    ]


def _same(record: Record, first: str, second: str) -> bool:
    """Tell whether two channels are the same in every row, and move."""
    one, other, moves = record[first], record[second], False
    for rows in blocks(record.n_samples):
        values = one[rows]
        if not np.array_equal(values, other[rows]):
            return False
        moves = moves or bool(np.any(values != one[0]))
        record.workspace.release()
    return moves


def copies(record: Record, test: TestDescription) -> list[str]:
    """Return a flag for each pressure that is another one's to the last digit.

    Parameters
    ----------
    record : Record
        As read.
    test : TestDescription
        Its channels.
    """
    return [
        f"{second} holds the readings of {first} in every row: was a column copied, or one channel "
        "recorded twice? one of both pairs is wrong"
        for first, second in copied_columns(record, [probe.name for probe in test.pressures])
    ]


def spiked_rows(
    record: Record, ranges: Ranges, groups: Sequence[Sequence[str]]
) -> dict[str, NDArray[np.int64]]:
    """Return the rows in which one pressure alone is far off the rows before and behind.

    Parameters
    ----------
    record, ranges
        As for :func:`spike_rows`.
    groups : sequence of sequence of str
        Channels that see the same.
    """
    spiked: dict[str, NDArray[np.int64]] = {}
    for names in groups:
        alike = {name: ranges[name] for name in names if name in ranges}
        # Without another beside it a channel may show a shock that is real.
        if len(alike) > 1:
            spiked |= spike_rows(record, alike)
    return spiked


def jumps(record: Record, test: TestDescription, ranges: Ranges) -> list[str]:
    """Return a flag where the pressures of the discharge jump all at once.

    Parameters
    ----------
    record, ranges
        As for :func:`spike_rows`.
    test : TestDescription
        Places of the channels.
    """
    plane = max(test.areas_m2)
    names = [p.name for p in test.pressures if p.plane == plane and p.name in ranges]
    rows = splice_rows(record, {name: ranges[name] for name in names})
    if not rows.size:
        return []
    places = ", ".join(f"{record.time_at_s(int(row)):.3f}" for row in rows[:NAMED_PLACES])
    more = f" and {rows.size - NAMED_PLACES} times more" if rows.size > NAMED_PLACES else ""
    return [
        f"the pressures of plane {plane} jump all at once at {places} s{more}: are rows missing "
        "there, or there twice, and the clock was made anew?"
    ]
