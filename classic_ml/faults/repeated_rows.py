"""Rows that are in a record twice, though its clock is even: it was made anew behind them.

Two ways, both told by readings that are alike to the last digit in every channel at once:

- a row is followed by itself, once or some times, where the pressures before and behind move;
- some rows are those of a while ago, one after the other: a block that was written twice, or a
  record that was put together from copies of one cycle.

A block is looked for among the last :data:`WINDOW` rows, which is a minute at 1 kHz and takes one
and a half megabytes, whatever the length of the record.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.computed import as_stored
from classic_ml.columns.workspace import blocks
from classic_ml.description import TestDescription
from classic_ml.records import Record
from surge_core.types import IntArray

__all__ = ["WINDOW", "RepeatedRows", "repeated_rows", "rows_repeated"]

RowHashes = NDArray[np.uint64]

# How far back a block is looked for, in rows: a power of two.
WINDOW = 1 << 16
# Rows in which most pressures move are never alike by chance, in twenty channels and with noise.
# Without any they may be, in a signal that repeats itself exactly; not in temperatures too.
FEWEST_ROWS = 2
# Before and behind rows that stand still the pressures have moved for so many rows.
BUSY_ROWS = 4
# More places than this are not named.
NAMED_PLACES = 3
# Odd, and without a pattern: 2^64 over the golden ratio.
FACTOR = np.uint64(0x9E3779B97F4A7C15)
FOLD = np.uint64(29)
# The table of rows by their hashes has twice as many places as there are rows to be found.
TABLE_BITS = WINDOW.bit_length()
TO_TABLE = np.uint64(64 - TABLE_BITS)


@dataclass(frozen=True)
class RepeatedRows:
    """Rows that are there more than once.

    Parameters
    ----------
    still : ndarray of int, shape (m, 2)
        First row of each run that repeats the row before it, and the row behind its last.
    again : ndarray of int, shape (m, 3)
        First row of each block that is there again, the row behind its last, and how many rows
        before it was there first.
    """

    still: IntArray
    again: IntArray


class _Search:
    """The search for both, row by row."""

    def __init__(self, n_pressures: int) -> None:
        self._busy = max(1, (n_pressures + 1) // 2)
        self._ring = np.zeros(WINDOW, dtype=np.uint64)
        self._table = np.full(1 << TABLE_BITS, -1, dtype=np.int64)
        # Row; of blocks: lag, first row, moving rows; of rows that stand still: busy rows before,
        # first row of a run and the row behind it, or -1.
        self._carried = np.array([0, 0, 0, 0, 0, -1, -1])
        self._still: list[IntArray] = []
        self._again: list[IntArray] = []

    def follow(self, hashes: RowHashes, moved: IntArray) -> None:
        """Go on with further rows: their hashes, and how many pressures moved in each."""
        still = np.empty((hashes.size // BUSY_ROWS + 2, 2), dtype=np.int64)
        again = np.empty((hashes.size // FEWEST_ROWS + 2, 3), dtype=np.int64)
        found = _follow(
            hashes, moved, self._busy, self._ring, self._table, self._carried, still, again
        )
        self._still.append(still[: found[0]].copy())
        self._again.append(again[: found[1]].copy())

    def ended(self) -> RepeatedRows:
        """Return what was found, with the block that the record ends in."""
        row, lag, start, moving = self._carried[:4].tolist()
        if lag > 0 and moving >= FEWEST_ROWS:
            self._again.append(np.array([[start, row, lag]], dtype=np.int64))
        none = np.empty((0, 2), dtype=np.int64), np.empty((0, 3), dtype=np.int64)
        return RepeatedRows(
            np.concatenate([none[0], *self._still]), np.concatenate([none[1], *self._again])
        )


def rows_repeated(record: Record, test: TestDescription) -> RepeatedRows:
    """Find the rows of a record that are in it more than once.

    Parameters
    ----------
    record : Record
        As read.
    test : TestDescription
        Its channels.
    """
    pressures = {probe.name for probe in test.pressures}
    channels = {name: as_stored(record[name]) for name in test.channel_names}
    search = _Search(len(pressures))
    for rows in blocks(record.n_samples):
        hashes = np.zeros(rows.stop - rows.start, dtype=np.uint64)
        moved = np.zeros(hashes.size, dtype=np.int64)
        if rows.start == 0:
            # Nobody knows that the first row stands still.
            moved[0] = len(pressures)
        first = max(0, rows.start - 1)
        for name, values in channels.items():
            part = np.ascontiguousarray(values[first : rows.stop])
            own = part[rows.start - first :]
            if own.dtype == np.float64:
                _mix_numbers(own, own.view(np.uint64), hashes)
            else:
                _mix(own, hashes)
            if name in pressures:
                _count_moved(part, moved[first + 1 - rows.start :])
        search.follow(hashes, moved)
        record.workspace.release()
    return search.ended()


def repeated_rows(record: Record, test: TestDescription) -> list[str]:
    """Return a flag where rows of a record are there more than once.

    Parameters
    ----------
    record : Record
        As read.
    test : TestDescription
        Its channels.
    """
    found = rows_repeated(record, test)
    flags = []
    if len(found.still):
        n_rows = int(np.sum(found.still[:, 1] - found.still[:, 0]))
        places = [f"{record.time_at_s(int(row)):.3f}" for row in found.still[:NAMED_PLACES, 0]]
        flags.append(
            f"{_rows(n_rows)} the readings of the row before in all pressures, at "
            f"{_listed(places, len(found.still))}: written twice under a clock that was made anew? "
            "all that follows is late by as much: leave them out"
        )
    if len(found.again):
        n_rows = int(np.sum(found.again[:, 1] - found.again[:, 0]))
        places = [
            f"{record.time_at_s(start):.3f} to {record.time_at_s(stop - 1):.3f} s those of "
            f"{lag * record.sample_period_s:.4g} s before"
            for start, stop, lag in found.again[:NAMED_PLACES].tolist()
        ]
        flags.append(
            f"{_rows(n_rows)} earlier ones to the last digit in all {len(test.channel_names)} "
            f"channels, {_listed(places, len(found.again))}: written twice under a clock that was "
            "made anew, or copies of one piece put together? leave them out"
        )
    return flags


def _rows(n: int) -> str:
    return f"{n} rows repeat" if n > 1 else "1 row repeats"


def _listed(places: list[str], n: int) -> str:
    more = f" and at {n - NAMED_PLACES} more places" if n > NAMED_PLACES else ""
    unit = "" if places[0].endswith("before") else " s"
    return ", ".join(places) + unit + more


@as_written
def _mix(bits: NDArray[Any], hashes: RowHashes) -> None:
    """Mix the readings of a channel, or their bits, into the hashes of their rows."""
    for row in range(bits.size):
        # The upper bits, which alone differ in small whole numbers, go down to the lower ones.
        mixed = (hashes[row] ^ np.uint64(bits[row])) * FACTOR
        hashes[row] = mixed ^ (mixed >> FOLD)


@as_written
def _mix_numbers(values: NDArray[Any], bits: NDArray[Any], hashes: RowHashes) -> None:
    """Mix readings and their bits into the hashes: a code of 16 bits as :func:`_mix` has it."""
    for row in range(values.size):
        code = np.uint64(values[row]) if 0.0 <= values[row] <= 65535.0 else np.uint64(0)
        key = code if np.float64(code) == values[row] else bits[row]
        mixed = (hashes[row] ^ key) * FACTOR
        hashes[row] = mixed ^ (mixed >> FOLD)


@as_written
def _count_moved(values: NDArray[Any], moved: IntArray) -> None:
    """Add 1 for each reading, but for the first, that is another one than that before."""
    before, after = values, values[1:]
    for row in range(moved.size):
        moved[row] += 1 if after[row] != before[row] else 0


@as_written
def _follow(
    hashes: RowHashes,
    moved: IntArray,
    busy: int,
    ring: RowHashes,
    table: IntArray,
    carried: IntArray,
    still: IntArray,
    again: IntArray,
) -> tuple[int, int]:
    """Find rows that repeat the one before, and blocks that repeat others.

    Parameters
    ----------
    hashes : ndarray of uint64, shape (n,)
        Hashes of the rows.
    moved : ndarray of int64, shape (n,)
        How many pressures are not as in the row before.
    busy : int
        So many and more move in a row that is busy.
    ring : ndarray of uint64, shape (WINDOW,)
        The hashes of the last rows.
    table : ndarray of int64
        By the upper bits of a hash, the last row that had them.
    carried : ndarray of int64, shape (7,)
        As :class:`_Search` has it.
    still : ndarray of int64, shape (m, 2)
        Takes the rows that repeat the one before.
    again : ndarray of int64, shape (m, 3)
        Takes the blocks.

    Returns
    -------
    int, int
        How many of each there are.
    """
    n_still, n_again = 0, 0
    first, lag, start, moving, calm, run, behind = carried
    last = WINDOW - 1
    for k in range(hashes.size):
        row, found = first + k, hashes[k]
        moves = moved[k] >= busy
        # A run that stands still counts when the rows behind it are busy again.
        if moves:
            calm += 1
            if behind >= 0 and calm == BUSY_ROWS:
                still[n_still, 0], still[n_still, 1] = run, behind
                n_still += 1
                behind = -1
        elif moved[k] == 0 and (calm >= BUSY_ROWS or (calm == 0 and behind == row)):
            run = row if calm >= BUSY_ROWS else run
            behind, calm = row + 1, 0
        else:
            behind, calm = -1, 0
        if lag > 0 and ring[(row - lag) & last] == found:
            moving += moves
        else:
            if lag > 0 and moving >= FEWEST_ROWS:
                again[n_again, 0], again[n_again, 1], again[n_again, 2] = start, row, lag
                n_again += 1
            lag = 0
            earlier = table[found >> TO_TABLE]
            if moves and earlier >= 0 and row - earlier < WINDOW and ring[earlier & last] == found:
                lag, start, moving = row - earlier, row, 1
        ring[row & last] = found
        table[found >> TO_TABLE] = row
    carried[0], carried[1], carried[2], carried[3] = first + hashes.size, lag, start, moving
    carried[4], carried[5], carried[6] = calm, run, behind
    return n_still, n_again
