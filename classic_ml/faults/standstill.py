"""Channels that stand still while those alike move, and dropouts: runs of equal readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.computed import as_stored
from classic_ml.columns.order_statistics import median
from classic_ml.columns.workspace import Workspace, blocks
from classic_ml.faults.standstill_kernels import (
    count_moved,
    find_runs,
    tally_codes,
    tally_steps,
)
from classic_ml.records import Record
from surge_core.types import FloatArray, IntArray

__all__ = ["DROPOUT_ROWS", "Tally", "still_runs", "tallies"]


# A short dropout is told from a plateau by its edges: both are jumps far beyond the usual step.
DROPOUT_ROWS = 5
DROPOUT_JUMP = 10.0
# Other channels must have moved by this many of their own steps while one stood still.
MOVED_STEPS = 8.0
# Runs that are not longer are looked into all at once.
FEW_ROWS = 4096
# Codes step by whole numbers, nearly always below this; other steps are sorted out at leisure.
WHOLE_STEPS = 4096


@dataclass(frozen=True)
class Tally:
    """What belongs to a channel as a whole.

    Parameters
    ----------
    low, high : float
        Its least and largest reading.
    least_step : float
        Least change from row to row, of those that are one; infinite without any.
    usual_step : float
        Their median; infinite without any, or where no run of equal readings needs it.
    still_rows : int
        Rows whose reading is that of the row before.
    """

    low: float
    high: float
    least_step: float
    usual_step: float
    still_rows: int


def tallies(record: Record, names: Sequence[str]) -> dict[str, Tally]:
    """Go once through channels of a record.

    Parameters
    ----------
    record : Record
        The record.
    names : sequence of str
        Its channels to be looked at.

    Returns
    -------
    dict of str to Tally
        By channel.
    """
    counted = {name: _Counted(as_stored(record[name])) for name in names}
    for rows in blocks(record.n_samples):
        for steps in counted.values():
            steps.take_up(rows)
        record.workspace.release()
    return {name: steps.tally(record, name) for name, steps in counted.items()}


class _Counted:
    """The steps of one channel by size, block by block."""

    def __init__(self, values: NDArray[Any]) -> None:
        self._values = values
        self._codes = values.dtype == np.uint16
        self._ends = np.array([np.inf, -np.inf, np.inf])
        self._counts = np.zeros((2, 1 << 16 if self._codes else WHOLE_STEPS), dtype=np.int64)
        self._fractions = False

    def take_up(self, rows: slice) -> None:
        """Take the next rows into account."""
        values = self._values[max(0, rows.start - 1) : rows.stop]
        if self._codes:
            self._ends[0] = min(self._ends[0], values.min())
            self._ends[1] = max(self._ends[1], values.max())
            tally_codes(values, self._counts)
            return
        if rows.start == 0:
            # Nothing steps into the first row, which counts for the ends.
            self._ends[:2] = values[0]
        self._fractions |= tally_steps(values, self._counts[0], self._ends) > 0

    def tally(self, record: Record, name: str) -> Tally:
        """Return what was found."""
        low, high, least = self._ends.tolist()
        counts = self._counts.sum(axis=0)
        sizes = np.flatnonzero(counts[1:]) + 1
        whole = float(sizes[0]) if sizes.size else np.inf
        if self._fractions:
            usual = _usual_step(record, name)
        else:
            usual = _median_of_counts(counts[1:]) + 1.0 if sizes.size else np.inf
        return Tally(low, high, min(least, whole), usual, int(counts[0]))


def _usual_step(record: Record, name: str) -> float:
    """Return the median of the steps from row to row that are one, where a run needs it."""
    search = _Search(record[name])
    for rows in blocks(record.n_samples):
        if len(search.ended_in(rows)[0]):
            return median(partial(_steps, record[name]), workspace=record.workspace)
        record.workspace.release()
    return np.inf


def _median_of_counts(counts: IntArray) -> float:
    """Return the median of whole numbers from 0 on that occur so many times each."""
    upto = np.cumsum(counts)
    n = int(upto[-1])
    middle = np.searchsorted(upto, [(n - 1) // 2, n // 2], side="right")
    return 0.5 * float(middle[0] + middle[1])


def _steps(values: FloatArray) -> Iterator[FloatArray]:
    """Yield the changes from row to row that are one."""
    for rows in blocks(values.size):
        steps = np.abs(np.diff(values[max(0, rows.start - 1) : rows.stop]))
        yield steps[steps > 0.0]


def still_runs(
    record: Record, alike: Sequence[Sequence[str]], found: dict[str, Tally], long_rows: int
) -> Iterator[tuple[str, IntArray]]:
    """Yield the runs of rows in which a channel is stuck, or has dropped out.

    Parameters
    ----------
    record : Record
        The record.
    alike : sequence of sequences of str
        Groups of channels that see the same.
    found : dict of str to Tally
        Of all these channels.
    long_rows : int
        Shortest run that is a fault while at least half of the others move.

    Yields
    ------
    str
        The channel.
    ndarray of int, shape (m, 2)
        First row of each of its runs that ended in one block, and the row behind the last.
    """
    searches = {name: _Search(record[name]) for names in alike for name in names}
    for rows in blocks(record.n_samples):
        for names in alike:
            for name in names:
                runs, jumps = searches[name].ended_in(rows)
                if not runs.size:
                    continue
                stuck = np.isfinite(jumps) & (jumps > DROPOUT_JUMP * found[name].usual_step)
                long = ~stuck & (runs[:, 1] - runs[:, 0] >= long_rows)
                others = [(record[n], found[n].least_step) for n in names if n != name]
                stuck[long] = _others_move(others, runs[long], record.workspace)
                if stuck.any():
                    yield name, runs[stuck]
        record.workspace.release()


class _Search:
    """The search for runs in one channel, block by block."""

    def __init__(self, values: FloatArray) -> None:
        self._values = as_stored(values)
        self._carried = np.array([DROPOUT_ROWS - 1, -1])
        self._jump = np.full(1, np.inf)

    def ended_in(self, rows: slice) -> tuple[IntArray, FloatArray]:
        """Return the runs that end in a block, the next one, and the lesser jump at their ends."""
        most = (rows.stop - rows.start) // DROPOUT_ROWS + 2
        runs, jumps = np.empty((most, 2), dtype=np.int64), np.empty(most)
        first = max(0, rows.start - DROPOUT_ROWS)
        values, n_rows = self._values[first : rows.stop], self._values.size
        n = find_runs(values, first, n_rows, DROPOUT_ROWS, self._carried, self._jump, runs, jumps)
        return runs[:n], jumps[:n]


def _others_move(
    others: Sequence[tuple[FloatArray, float]], runs: IntArray, workspace: Workspace
) -> NDArray[np.bool_]:
    """Tell during which runs at least half of the other channels moved by many of their steps."""
    moved = np.zeros(len(runs), dtype=np.int64)
    # Alone of its kind, a channel that stands still has nothing to be compared with.
    if not others or not moved.size:
        return np.zeros(moved.size, dtype=np.bool_)
    few = runs[:, 1] - runs[:, 0] <= FEW_ROWS
    short = runs[few]
    for values, step in others:
        more_than = MOVED_STEPS * step
        if short.size:
            # All of them ended in one block.
            first, stop = int(short[0, 0]), int(short[-1, 1])
            of_few = np.zeros(len(short), dtype=np.int64)
            count_moved(values[first:stop], first, short, more_than, of_few)
            moved[few] += of_few
        for run in np.flatnonzero(~few):
            moved[run] += _moves(values, runs[run], more_than, workspace)
    return np.asarray(2 * moved >= len(others))


def _moves(values: FloatArray, run: IntArray, more_than: float, workspace: Workspace) -> bool:
    low, high = np.inf, -np.inf
    for rows in blocks(int(run[1]), int(run[0])):
        low, high = min(low, values[rows].min()), max(high, values[rows].max())
        workspace.release()
        if high - low > more_than:
            return True
    return False
