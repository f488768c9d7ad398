"""Errors in blocks, and the difference of two of them with its paired error."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from surge_core.leave_out import scatter
from surge_core.types import BoolArray, FloatArray

__all__ = ["block_errors", "block_rms", "paired_difference"]

MINIMUM_BLOCKS = 6


def block_errors(
    error: FloatArray, runs: list[slice], scored: BoolArray | None = None
) -> FloatArray:
    """Return the sum of squares and row count of each block, of shape (n_blocks, 2).

    Parameters
    ----------
    error : ndarray of shape (n,)
        Measurement minus prediction.
    runs : list of slice
        Segments; each is a block, and where there are fewer than six they are cut into as many
        pieces as make six.
    scored : ndarray of bool, shape (n,), optional
        Rows that count.
    """
    keep = np.ones(error.size, dtype=np.bool_) if scored is None else scored
    pieces = max(1, math.ceil(MINIMUM_BLOCKS / max(len(runs), 1)))
    edges = [np.linspace(run.start, run.stop, pieces + 1).astype(int) for run in runs]
    blocks = [slice(*ends) for own in edges for ends in pairwise(own)]
    rows = [(np.sum(error[b][keep[b]] ** 2), np.sum(keep[b])) for b in blocks if keep[b].any()]
    return np.asarray(rows, dtype=np.float64).reshape(-1, 2)


def paired_difference(blocks: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return the difference of two rms errors on the same blocks, and its paired error.

    Parameters
    ----------
    blocks, reference : ndarray of shape (n_blocks, 2)
        What :func:`block_errors` gave for the same rows.

    Returns
    -------
    difference, paired_error : float
        rms minus rms of the reference, and the jackknife standard error of that difference over
        the blocks: the blocks are shared, so what makes one hard is hard for both.
    """
    errors = np.sqrt(_means(blocks)) - np.sqrt(_means(reference))
    return float(errors[0]), _jackknife(errors[1:])


def block_rms(blocks: FloatArray) -> tuple[float, float]:
    """Return the rms error over blocks and its jackknife standard error.

    Parameters
    ----------
    blocks : ndarray of shape (n_blocks, 2)
        What :func:`block_errors` gave.
    """
    if not blocks.size:
        return math.nan, math.nan
    errors = np.sqrt(_means(blocks))
    return float(errors[0]), _jackknife(errors[1:])


def _means(blocks: FloatArray) -> FloatArray:
    """Return the mean square over all blocks, then with each block left out in turn."""
    squares, rows = blocks.T
    if squares.size < 2:
        return np.array([squares.sum() / rows.sum()])
    kept = 1.0 - np.vstack([np.zeros(squares.size), np.eye(squares.size)])
    return np.asarray((kept @ squares) / (kept @ rows))


def _jackknife(left_out: FloatArray) -> float:
    return math.sqrt(scatter(left_out[:, None])[0, 0]) if left_out.size > 1 else math.nan
