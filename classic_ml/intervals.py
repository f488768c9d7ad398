"""Intervals of rows in which something holds, and straight lines across them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label

from surge_core.types import BoolArray, FloatArray, IntArray


def label_intervals(state: BoolArray, least_rows: int) -> tuple[IntArray, list[int]]:
    """Give the intervals of True numbers from 1 on, and 0 to all else and to those too short.

    Returned are the labels and the rows of each interval that was too short.
    """
    labels = label(state)[0]
    lengths = np.bincount(labels)[1:]
    kept = lengths >= least_rows
    numbers = np.concatenate([[0], np.cumsum(kept) * kept])
    return numbers[labels], lengths[~kept].tolist()


def bridged(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return a signal with straight lines across the rows that are not known.

    It is constant before the first and behind the last known row; where no row is known, or all
    are, it is returned as it is.
    """
    there, gone = np.flatnonzero(known), np.flatnonzero(~known)
    if not (there.size and gone.size):
        return values
    out = np.array(values)
    out[gone] = np.interp(gone, there, values[there])
    return out
