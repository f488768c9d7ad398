"""How well a reconstruction matches: scores, spectra, the range in which a curve holds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surge_core.types import FloatArray

__all__ = ["FitScore", "block_errors", "paired_difference", "score_fit", "trusted_range"]

# The paper calls the curve reliable where φ has "high significant amplitude density" (Fig 24) and
# gives no level; the true in-stall φ of the simulated rig lies between these percentiles much as
# the paper's range does. On filtered data the low end holds the filter's overshoot too.
TRUSTED_PERCENTILES = (5.0, 95.0)
MINIMUM_BLOCKS = 6


@dataclass(frozen=True)
class FitScore:
    """How well a prediction matches a measurement.

    Parameters
    ----------
    rms : float
        Root mean square of measurement minus prediction.
    fit_percent : float
        100 (1 - ||y - ŷ|| / ||y - mean y||).
    r2 : float
        Share of the variance explained; negative when the mean would do better.
    n_rows : int
        Rows that were scored.
    """

    rms: float
    fit_percent: float
    r2: float
    n_rows: int

    def to_json(self) -> dict[str, float]:
        """Return rms, fit_percent and r2."""
        return {"rms": self.rms, "fit_percent": self.fit_percent, "r2": self.r2}


def score_fit(
    measured: FloatArray, predicted: FloatArray, scored: NDArray[np.bool_] | None = None
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
    rms = float(np.sqrt(np.mean(error**2)))
    return FitScore(rms, 100.0 * (1.0 - math.sqrt(ratio)), 1.0 - ratio, int(error.size))


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
    error: FloatArray, runs: list[slice], scored: NDArray[np.bool_] | None = None
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
    rows = []
    for run in runs:
        edges = np.linspace(run.start, run.stop, pieces + 1).astype(int)
        for low, high in pairwise(edges):
            squares = error[low:high][keep[low:high]] ** 2
            if squares.size:
                rows.append((float(squares.sum()), float(squares.size)))
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
    difference = _rms(blocks) - _rms(reference)
    n_blocks = blocks.shape[0]
    if n_blocks < 2:
        return difference, math.nan
    left_out = np.array(
        [
            _rms(np.delete(blocks, i, axis=0)) - _rms(np.delete(reference, i, axis=0))
            for i in range(n_blocks)
        ]
    )
    spread = left_out - left_out.mean()
    return difference, float(np.sqrt((n_blocks - 1) / n_blocks * float(spread @ spread)))


def _rms(blocks: FloatArray) -> float:
    squares, rows = blocks.sum(axis=0)
    return math.sqrt(float(squares) / float(rows))
