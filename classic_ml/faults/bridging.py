"""Straight lines across rows that do not count, block by block."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.intervals import intervals_where
from classic_ml.columns.workspace import Workspace, blocks
from surge_core.types import FloatArray, IntArray

__all__ = ["bridged_rows"]


def bridged_rows(
    workspace: Workspace,
    n_rows: int,
    values: Callable[[slice], FloatArray],
    known: Callable[[slice], NDArray[np.bool_]],
) -> Callable[[slice], FloatArray]:
    """Return a signal with straight lines across the rows that are not known.

    Parameters
    ----------
    workspace : Workspace
        Where the signal lies.
    n_rows : int
        Rows of the record.
    values : callable
        ``values(rows)`` returns the values of the rows of a slice.
    known : callable
        ``known(rows)`` returns True for those that count.

    Returns
    -------
    callable
        Of a slice of rows, as ``np.interp`` has it: constant before the first and behind the last
        known row. Where no row is known, the values as they are.
    """
    gaps = intervals_where(slice(0, n_rows), lambda rows: ~known(rows), workspace=workspace)
    if len(gaps) == 1 and gaps[0, 0] == 0 and gaps[0, 1] == n_rows:
        return values
    ends = _ends(gaps, n_rows, values, workspace)

    def rows_of(rows: slice) -> FloatArray:
        first = int(np.searchsorted(gaps[:, 1], rows.start, side="right"))
        last = int(np.searchsorted(gaps[:, 0], rows.stop))
        if first == last:
            return values(rows)
        bridged = np.array(values(rows))
        _draw(gaps[first:last], ends[first:last], rows.start, bridged)
        return bridged

    return rows_of


@as_written
def _draw(gaps: IntArray, ends: FloatArray, first: int, out: FloatArray) -> None:
    """Draw a straight line across each gap, as far as it is in a block that begins with a row."""
    for gap in range(gaps.shape[0]):
        from_row, stop = gaps[gap, 0] - 1, gaps[gap, 1]
        slope = (ends[gap, 1] - ends[gap, 0]) / (stop - from_row)
        for row in range(max(from_row + 1, first), min(stop, first + out.size)):
            out[row - first] = slope * (row - from_row) + ends[gap, 0]


def _ends(
    gaps: IntArray,
    n_rows: int,
    values: Callable[[slice], FloatArray],
    workspace: Workspace,
) -> FloatArray:
    """Return the values before and behind each gap, the same twice where there is but one."""
    ends = np.empty(gaps.shape)
    beside = gaps - [1, 0]
    for rows in blocks(n_rows):
        inside = [slice(*np.searchsorted(p, (rows.start, rows.stop))) for p in beside.T]
        if any(which.start < which.stop for which in inside):
            part = values(rows)
            for side, which in enumerate(inside):
                ends[which, side] = part[beside[which, side] - rows.start]
            workspace.release()
    if gaps.size and gaps[0, 0] == 0:
        ends[0, 0] = ends[0, 1]
    if gaps.size and gaps[-1, 1] == n_rows:
        ends[-1, 1] = ends[-1, 0]
    return ends
