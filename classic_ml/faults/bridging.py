"""Straight lines across rows that do not count, block by block."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.workspace import ColumnWriter, Workspace, blocks, evaluated
from classic_ml.records import FloatArray

__all__ = ["bridged"]


def bridged(
    workspace: Workspace,
    n_rows: int,
    values: Callable[[slice], FloatArray],
    known: Callable[[slice], NDArray[np.bool_]],
) -> FloatArray:
    """Return a column with straight lines across the rows that are not known.

    Parameters
    ----------
    workspace : Workspace
        Where the column lies.
    n_rows : int
        Rows of the record.
    values : callable
        ``values(rows)`` returns the values of the rows of a slice.
    known : callable
        ``known(rows)`` returns True for those that count.

    Returns
    -------
    ndarray of shape (n_rows,)
        As ``np.interp`` has it: constant before the first and behind the last known row. Where no
        row is known, the values as they are.
    """
    column: ColumnWriter | None = None
    last_row, last_value = -1, 0.0
    for rows in blocks(n_rows):
        inside = np.flatnonzero(known(rows))
        if inside.size:
            column = workspace.writer(n_rows) if column is None else column
            part = values(rows)
            first_row, first_value = rows.start + int(inside[0]), float(part[inside[0]])
            # What is not known before is told by its ends, of which only now there are two.
            for gap in blocks(first_row, last_row + 1):
                column.append(_line(gap, last_row, last_value, first_row, first_value))
            last_row, last_value = rows.start + int(inside[-1]), float(part[inside[-1]])
            between = slice(inside[0], inside[-1] + 1)
            places = np.arange(between.start, between.stop, dtype=np.float64)
            column.append(np.interp(places, places[inside - inside[0]], part[inside]))
        workspace.release()
    if column is None:
        return evaluated(workspace, n_rows, values)
    for gap in blocks(n_rows, last_row + 1):
        column.append(np.full(gap.stop - gap.start, last_value))
    return np.asarray(column.finished())


def _line(
    rows: slice, from_row: int, from_value: float, to_row: int, to_value: float
) -> FloatArray:
    """Return a straight line in some rows, written as in ``np.interp``; constant from row -1."""
    if from_row < 0:
        return np.full(rows.stop - rows.start, to_value)
    slope = (to_value - from_value) / (to_row - from_row)
    return np.asarray(slope * (np.arange(rows.start, rows.stop) - from_row) + from_value)
