"""Stretches of rows: the segments of a series, and the scored stretches within one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray


def runs_of(segments: ArrayLike | None, n_rows: int) -> list[slice]:
    """Return the rows of each segment: stretches of equal label, in order; without labels, one.

    Rows of one label that do not follow each other are different segments.
    """
    if segments is None:
        return [slice(0, n_rows)]
    labels = np.asarray(segments)
    if labels.shape != (n_rows,):
        raise InputError(
            "segments", expected=f"one label for each of {n_rows} rows", found=f"{labels.shape}"
        )
    number = np.issubdtype(labels.dtype, np.number) or labels.dtype == np.bool_
    if not (number and np.all(np.isfinite(labels)) and np.all(labels == np.round(labels))):
        found, remedy = f"values of type {labels.dtype}", "number the intervals 1, 2, …"
        raise InputError("segments", expected="integer labels", found=found, remedy=remedy)
    cuts = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    bounds = [0, *cuts.tolist(), n_rows]
    return [slice(low, high) for low, high in pairwise(bounds)]


def is_constant(values: FloatArray) -> bool:
    """Return whether no column (n_rows, n_columns) changes but for rounding."""
    spread = np.ptp(values, axis=0)
    return bool(np.all(spread <= 1e-12 * np.maximum(np.abs(values).max(axis=0), 1e-300)))


def intervals_where(state: BoolArray) -> IntArray:
    """Return the first row of each interval of True, and the row behind its last."""
    padded = np.concatenate([[False], state, [False]])
    return np.flatnonzero(padded[1:] != padded[:-1]).reshape(-1, 2)


def scored_pieces(weight: FloatArray, run: slice) -> list[slice]:
    """Return the stretches of a run whose rows all have weight (at least two rows each)."""
    bounds = intervals_where(weight[run] > 0.0) + run.start
    return [slice(low, high) for low, high in bounds.tolist() if high - low > 1]
