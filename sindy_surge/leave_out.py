"""Least-squares fits without some of their rows, and the scatter that this and the scores show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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

    -B (I - A_g B)⁻¹ J_g'e_g with B = (J'J)⁻¹ and A_g = J_g'J_g: exact for a linear
    regression, to first order otherwise.

    Parameters
    ----------
    columns : ndarray of shape (n_rows, n_parameters)
        Derivatives J of the fitted values.
    residual : ndarray of shape (n_rows,)
        What the fit leaves, e; rows of ``columns`` behind it are a prior, which no block holds.
    blocks : sequence of ndarray of int
        Rows of each block.

    Returns
    -------
    ndarray of shape (n_blocks, n_parameters)
        The moves.
    """
    norms = unit_norms(columns)
    scaled = columns / norms
    bread = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    identity = np.eye(norms.size)
    moves = np.empty((len(blocks), norms.size))
    for number, rows in enumerate(blocks):
        part = scaled[rows]
        # lstsq, not solve: a block that alone determines a parameter makes this singular.
        system = identity - part.T @ part @ bread
        moves[number] = -bread @ np.linalg.lstsq(system, part.T @ residual[rows])[0]
    moves /= norms
    return moves
