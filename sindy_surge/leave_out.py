"""Least-squares fits without some of their rows, and the scatter that this and the scores show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surge_core.leave_out import leave_out
from surge_core.types import FloatArray, IndexArray

__all__ = ["leave_out_moves", "newey_west", "unit_norms"]


def unit_norms(columns: FloatArray) -> FloatArray:
    """Return the norms of columns, 1 for columns of zeros."""
    norms: FloatArray = np.linalg.norm(columns, axis=0)
    norms[norms == 0] = 1.0
    return norms


def newey_west(scores: FloatArray, runs: Sequence[slice], reach: int) -> FloatArray:
    """Return the sum of the products of scores up to some lag, Bartlett weights.

    Newey & West (1987); each run of rows on its own.

    Parameters
    ----------
    scores : ndarray of shape (n_rows, n_parameters)
        Derivatives times residuals.
    runs : sequence of slice
        Rows that follow each other.
    reach : int
        The largest lag in rows.
    """
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        weight = 1 - lag / (reach + 1)
        for rows in runs:
            if rows.stop - rows.start > lag:
                cross = (
                    scores[rows.start + lag : rows.stop].T @ scores[rows.start : rows.stop - lag]
                )
                middle += weight * (cross + cross.T)
    return middle


def leave_out_moves(
    columns: FloatArray, residual: FloatArray, blocks: Sequence[IndexArray]
) -> FloatArray:
    """Return how the parameters of a least-squares fit move when one block is left out.

    Parameters
    ----------
    columns : ndarray of shape (n_rows, n_parameters)
        Derivatives of the fitted values.
    residual : ndarray of shape (n_rows,)
        What the fit leaves.
    blocks : sequence of ndarray of int
        Rows of each block.

    Returns
    -------
    ndarray of shape (n_blocks, n_parameters)
        The moves.
    """
    return leave_out(-columns, residual, blocks).moves
