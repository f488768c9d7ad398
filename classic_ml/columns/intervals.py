"""Intervals of rows in which something holds, found and marked block by block."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks
from surge_core.types import BoolArray, IntArray

__all__ = ["intervals_where", "label_intervals", "labelled", "long_ones"]


def intervals_where(
    window: slice, holds: Callable[[slice], BoolArray], *, workspace: Workspace = IN_MEMORY
) -> IntArray:
    """Return the intervals of rows in which a condition holds.

    Parameters
    ----------
    window : slice
        Rows that are looked at; an interval ends where they do.
    holds : callable
        ``holds(rows)`` returns True for each row of the slice where it does.
    workspace : Workspace
        Where the rows lie.

    Returns
    -------
    ndarray of int, shape (m, 2)
        First row of each interval, and the row behind its last.
    """
    edges: list[IntArray] = []
    before = False
    for rows in blocks(window.stop, window.start):
        state = holds(rows)
        inner = np.flatnonzero(state[1:] != state[:-1]) + 1
        first = inner[:0] if state[0] == before else np.zeros(1, dtype=np.int64)
        edges += [first + rows.start, inner + rows.start]
        before = bool(state[-1])
        workspace.release()
    if before:
        edges.append(np.array([window.stop]))
    return np.concatenate([*edges, np.zeros(0, dtype=np.int64)]).astype(np.int64).reshape(-1, 2)


def labelled(intervals: IntArray, rows: slice) -> IntArray:
    """Return the number of the interval that each row is in, from 1 on, 0 outside of all.

    Parameters
    ----------
    intervals : ndarray of int, shape (m, 2)
        In order and apart, from :func:`intervals_where`.
    rows : slice
        The rows.
    """
    first = int(np.searchsorted(intervals[:, 1], rows.start, side="right"))
    last = int(np.searchsorted(intervals[:, 0], rows.stop))
    edges = np.clip(intervals[first:last].ravel(), rows.start, rows.stop)
    # Outside, in the first, outside, in the second, …
    numbers = np.zeros(edges.size + 1, dtype=np.int64)
    numbers[1::2] = np.arange(first, last) + 1
    return np.repeat(numbers, np.diff(edges, prepend=rows.start, append=rows.stop))


def label_intervals(state: BoolArray, least_rows: int) -> tuple[IntArray, list[int]]:
    """Give numbers to the intervals of True.

    Parameters
    ----------
    state : ndarray of bool, shape (n,)
        True inside an interval.
    least_rows : int
        Shorter intervals are left out.

    Returns
    -------
    labels : ndarray of int, shape (n,)
        1, 2, … in the intervals, 0 elsewhere.
    left_out : list of int
        Rows of each interval that was too short.
    """
    whole = slice(0, state.size)
    kept, left_out = long_ones(intervals_where(whole, lambda rows: state[rows]), least_rows)
    return labelled(kept, whole), left_out


def long_ones(intervals: IntArray, least_rows: int) -> tuple[IntArray, list[int]]:
    """Return the intervals of so many rows or more, and the rows of each of the others."""
    lengths = intervals[:, 1] - intervals[:, 0]
    return intervals[lengths >= least_rows], lengths[lengths < least_rows].tolist()
