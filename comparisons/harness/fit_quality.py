"""How well a reconstruction matches: scores, spectra, the range in which a curve holds."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from comparisons.results import FitScore
from surge_core.types import BoolArray, FloatArray

__all__ = ["block_errors", "block_rms", "paired_difference", "rms", "score_fit", "trusted_range"]

# The paper calls the curve reliable where φ has "high significant amplitude density" (Fig 24) and
# gives no level; the true in-stall φ of the simulated rig lies between these percentiles much as
# the paper's range does. On filtered data the low end holds the filter's overshoot too.
TRUSTED_PERCENTILES = (5.0, 95.0)
MINIMUM_BLOCKS = 6


def rms(values: FloatArray) -> float:
    """Return the root mean square of values, of shape (n,)."""
    return float(np.sqrt(np.mean(values**2)))


def score_fit(
    measured: FloatArray, predicted: FloatArray, scored: BoolArray | None = None
) -> FitScore:
    """Score a prediction on the rows that count.

    Parameters
    ----------
    measured, predicted : ndarray of shape (n,)
        The two signals.
    scored : ndarray of bool, shape (n,), optional
        Rows that count; all without it.
    """
    keep = np.ones(measured.size, dtype=np.bool_) if scored is None else scored
    error = (measured - predicted)[keep]
    spread = measured[keep] - np.mean(measured[keep])
    power = float(spread @ spread)
    ratio = float(error @ error) / power if power > 0.0 else math.inf
    return FitScore(rms(error), 100.0 * (1.0 - math.sqrt(ratio)), 1.0 - ratio, int(error.size))


def trusted_range(phi: FloatArray) -> tuple[float, float]:
    """Return the range in which φ dwells: beyond it a curve fitted to these rows is a guess.

    Parameters
    ----------
    phi : ndarray of shape (n,)
        Flow coefficient of the fitted rows.
    """
    low, high = np.percentile(phi, TRUSTED_PERCENTILES)
    return float(low), float(high)


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
    n = left_out.size
    if n < 2:
        return math.nan
    spread = left_out - left_out.mean()
    return float(np.sqrt((n - 1) / n * float(spread @ spread)))
