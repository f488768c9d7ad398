"""Intervals of rows in which something holds, and straight lines across them."""

from __future__ import annotations

import numpy as np

from surge_core.types import BoolArray, FloatArray, IntArray


def intervals_where(state: BoolArray) -> IntArray:
    """Return the intervals of True.

    Parameters
    ----------
    state : ndarray of bool, shape (n,)
        True inside an interval.

    Returns
    -------
    ndarray of int, shape (m, 2)
        First row of each interval, and the row behind its last.
    """
    change = np.flatnonzero(state[1:] != state[:-1]) + 1
    head = [0] if state.size and state[0] else []
    tail = [state.size] if state.size and state[-1] else []
    return np.concatenate([head, change, tail]).astype(np.int64).reshape(-1, 2)


def equal_runs(values: FloatArray, least_rows: int) -> IntArray:
    """Return the runs of so many equal values or more, as :func:`intervals_where` does."""
    runs = intervals_where(values[1:] == values[:-1])
    runs[:, 1] += 1
    return np.asarray(runs[runs[:, 1] - runs[:, 0] >= least_rows])


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
    intervals = intervals_where(state)
    lengths = intervals[:, 1] - intervals[:, 0]
    kept = intervals[lengths >= least_rows]
    labels = np.zeros(state.size, dtype=np.int64)
    for number, (start, stop) in enumerate(kept.tolist(), 1):
        labels[start:stop] = number
    return labels, lengths[lengths < least_rows].tolist()


def bridged(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return a signal with straight lines across the rows that are not known.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal.
    known : ndarray of bool, shape (n,)
        True where it counts.

    Returns
    -------
    ndarray of shape (n,)
        Constant before the first and behind the last known row; the signal as it is where no row
        is known, or all are.
    """
    if known.all() or not known.any():
        return values
    out = np.array(values)
    out[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), values[known])
    return out
