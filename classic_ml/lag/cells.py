"""How a record is cut up for one pass: pieces, cells between knots, blocks, local unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surge_core.types import FloatArray, IntArray

__all__ = ["Cells", "Knots", "cut_into_cells"]


@dataclass(frozen=True)
class Knots:
    """Where the knots of the drift stand.

    Parameters
    ----------
    first : tuple of int
        Number of the first hat of each run.
    intervals : tuple of int
        Number of intervals of each run.
    steps : tuple of float
        Knots passed from row to row in each run.
    """

    first: tuple[int, ...]
    intervals: tuple[int, ...]
    steps: tuple[float, ...]

    @property
    def n_hats(self) -> int:
        """Number of all hats; a run without an interval still has two, one of them empty."""
        return self.first[-1] + max(self.intervals[-1], 1) + 1 if self.first else 0

    @property
    def n_levels(self) -> int:
        """Number of hats that carry something."""
        return sum(n + 1 for n in self.intervals)


@dataclass(frozen=True)
class Cells:
    """The cells of a pass, in time order.

    Parameters
    ----------
    rows : ndarray of shape (n_cells, 6)
        First row, row behind the last, first row of the run, whether a piece begins, left hat
        (or -1), number of the run.
    knots : ndarray of shape (n_cells, 2)
        Place of the first row between the left hat (0) and the next (1), and step a row.
    slots : ndarray of shape (n_cells,)
        Where the cell's errors go.
    block : ndarray of shape (n_cells,)
        Which jackknife block it belongs to.
    ahead : int
        Errors before each piece that are scored themselves.
    piece_lengths : ndarray of shape (n_pieces,)
        Scored errors of each piece, those ahead included.
    piece_slots : ndarray of shape (n_pieces,)
        Where the errors of each piece begin.
    """

    rows: IntArray
    knots: FloatArray
    slots: IntArray
    block: IntArray
    ahead: int
    piece_lengths: IntArray
    piece_slots: IntArray

    @property
    def n_errors(self) -> int:
        """Number of scored errors."""
        return int(self.piece_lengths.sum())

    @property
    def n_blocks(self) -> int:
        """Number of jackknife blocks."""
        return int(self.block[-1]) + 1 if self.block.size else 0


def cut_into_cells(
    pieces: IntArray,
    counts: IntArray,
    knots: Knots | None,
    edges: list[IntArray] | None,
    scored: IntArray | None,
    ahead: int,
) -> Cells:
    """Cut pieces at the knots and at the edges of the blocks.

    Parameters
    ----------
    pieces : ndarray of shape (n_pieces, 4)
        First row, row behind the last, first row of the run, number of the run.
    counts : ndarray of shape (n_pieces,)
        Scored rows of each piece, without those ahead.
    knots : Knots, optional
        The drift's knots.
    edges : list of ndarray, optional
        Inner edges of the blocks of each piece, counted in its errors; None is one block a piece.
    scored : ndarray of int, optional
        The scored rows, where not all are.
    ahead : int
        Errors ahead of each piece.
    """
    lengths = counts + ahead
    piece_slots = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
    if edges is None and knots is None:
        rows = np.column_stack(
            [pieces[:, :3], np.ones(len(pieces), int), np.full(len(pieces), -1), pieces[:, 3]]
        ).astype(np.int64)
        blocks = np.arange(len(pieces), dtype=np.int64)
        return Cells(
            rows,
            np.zeros((len(rows), 2)),
            piece_slots + ahead,
            blocks,
            ahead,
            lengths,
            piece_slots,
        )
    table: list[tuple[int, ...]] = []
    places: list[tuple[float, float]] = []
    blocks_of: list[int] = []
    n_blocks = 0
    for number, (start, stop, origin, run) in enumerate(pieces.tolist()):
        inner = _rows_of_edges(
            edges[number] if edges is not None else np.zeros(0, np.int64),
            start,
            scored,
            ahead,
        )
        at_knots = _rows_of_knots(start, stop, origin, run, knots)
        cuts = sorted({start, stop, *(r for r in (*inner, *at_knots) if start < r < stop)})
        for low, high in pairwise(cuts):
            left, place, step = _place(low, origin, run, knots)
            table.append((low, high, origin, int(low == start), left, run))
            places.append((place, step))
            blocks_of.append(n_blocks + int(np.searchsorted(inner, low, side="right")))
        n_blocks = blocks_of[-1] + 1
    rows = np.asarray(table, dtype=np.int64).reshape(-1, 6)
    piece_of = np.cumsum(rows[:, 3]) - 1
    before = rows[:, 0] - pieces[piece_of, 0]
    if scored is not None:
        at = np.searchsorted(scored, rows[:, 0])
        before = at - np.searchsorted(scored, pieces[piece_of, 0])
    return Cells(
        rows,
        np.asarray(places, dtype=np.float64).reshape(-1, 2),
        (piece_slots[piece_of] + ahead + before).astype(np.int64),
        _renumbered(np.asarray(blocks_of, dtype=np.int64)),
        ahead,
        lengths,
        piece_slots,
    )


def _renumbered(blocks: IntArray) -> IntArray:
    """Leave out numbers of blocks that hold no row."""
    return np.asarray(np.cumsum(np.concatenate([[0], np.diff(blocks) > 0])), dtype=np.int64)


def _rows_of_edges(inner: IntArray, start: int, scored: IntArray | None, ahead: int) -> list[int]:
    counts = np.maximum(inner - ahead, 0)
    if scored is None:
        return [int(row) for row in start + counts]
    return [int(row) for row in scored[int(np.searchsorted(scored, start)) + counts]]


def _rows_of_knots(start: int, stop: int, origin: int, run: int, knots: Knots | None) -> list[int]:
    if knots is None or knots.intervals[run] < 2:
        return []
    step = knots.steps[run]
    inner = np.arange(1, knots.intervals[run])
    at = origin + np.ceil(inner / step - 1e-9).astype(int)
    return [int(row) for row in at[(at > start) & (at < stop)]]


def _place(row: int, origin: int, run: int, knots: Knots | None) -> tuple[int, float, float]:
    if knots is None:
        return -1, 0.0, 0.0
    step = knots.steps[run]
    position = (row - origin) * step
    interval = int(np.clip(np.floor(position + 1e-9 * step), 0, max(knots.intervals[run] - 1, 0)))
    return knots.first[run] + interval, position - interval, step
