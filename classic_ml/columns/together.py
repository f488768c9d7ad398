"""Columns of which any rows are computed with each other, and the last blocks kept."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np

from classic_ml.columns import workspace as places
from classic_ml.columns.computed import computed
from surge_core.types import FloatArray

__all__ = ["computed_together"]

Evaluate = Callable[[slice], Mapping[str, FloatArray]]

# Whoever goes through the columns once, a row beyond each block included, has each block computed
# once: the one that is looked at and both of its neighbours are at hand.
KEPT_BLOCKS = 3


def computed_together(
    n_rows: int, names: Collection[str], evaluate: Evaluate
) -> dict[str, FloatArray]:
    """Return columns that take no room and are computed with each other, block by block.

    Parameters
    ----------
    n_rows : int
        Their length.
    names : collection of str
        What they are called.
    evaluate : callable
        ``evaluate(rows)`` returns the rows of one block, of all columns.

    Returns
    -------
    dict of str to ndarray of shape (n_rows,)
        In truth columns of :func:`classic_ml.columns.computed.computed`.
    """
    last_blocks = _LastBlocks(n_rows, evaluate)

    def column(name: str) -> FloatArray:
        return computed(n_rows, lambda rows: last_blocks.rows_of(name, rows))

    return {name: column(name) for name in names}


class _LastBlocks:
    """The blocks that were asked for last."""

    def __init__(self, n_rows: int, evaluate: Evaluate) -> None:
        self._n_rows, self._evaluate = n_rows, evaluate
        # By their first rows, the one asked for last behind the others.
        self._blocks: dict[int, Mapping[str, FloatArray]] = {}

    def rows_of(self, name: str, rows: slice) -> FloatArray:
        size = places.BLOCK_ROWS
        parts = []
        for first in range(rows.start - rows.start % size, rows.stop, size):
            values = self._block(first)[name]
            parts.append(values[max(0, rows.start - first) : rows.stop - first])
        return parts[0] if len(parts) == 1 else np.concatenate(parts or [np.empty(0)])

    def _block(self, first: int) -> Mapping[str, FloatArray]:
        found = self._blocks.pop(first, None)
        if found is None:
            while len(self._blocks) >= KEPT_BLOCKS:
                del self._blocks[next(iter(self._blocks))]
            rows = slice(first, min(first + places.BLOCK_ROWS, self._n_rows))
            found = self._evaluate(rows)
        self._blocks[first] = found
        return found
