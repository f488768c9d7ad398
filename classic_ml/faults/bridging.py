"""Straight lines across rows that do not count, block by block."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.intervals import intervals_where
from classic_ml.columns.workspace import Workspace, blocks
from classic_ml.records import FloatArray

__all__ = ["bridged_rows"]

IntArray = NDArray[np.int64]


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
        inside = np.clip(gaps[first:last], rows.start, rows.stop)
        lengths = inside[:, 1] - inside[:, 0]
        gap = np.repeat(np.arange(first, last), lengths)
        begun = np.repeat(np.cumsum(lengths) - lengths, lengths)
        row = np.arange(gap.size) - begun + inside[gap - first, 0]
        from_row = gaps[gap, 0] - 1
        slope = (ends[gap, 1] - ends[gap, 0]) / (gaps[gap, 1] - from_row)
        bridged[row - rows.start] = slope * (row - from_row) + ends[gap, 0]
        return bridged

    return rows_of


def _ends(
    gaps: IntArray,
    n_rows: int,
    values: Callable[[slice], FloatArray],
    workspace: Workspace,
) -> FloatArray:
    """Return the values before and behind each gap, the same twice where there is but one."""
    ends = np.empty(gaps.shape)
    for rows in blocks(n_rows):
        places = [(gaps[:, 0] - 1, 0), (gaps[:, 1], 1)]
        inside = [(p, side, (p >= rows.start) & (p < rows.stop)) for p, side in places]
        if any(which.any() for _, _, which in inside):
            part = values(rows)
            for place, side, which in inside:
                ends[which, side] = part[place[which] - rows.start]
            workspace.release()
    if gaps.size and gaps[0, 0] == 0:
        ends[0, 0] = ends[0, 1]
    if gaps.size and gaps[-1, 1] == n_rows:
        ends[-1, 1] = ends[-1, 0]
    return ends
