"""The autoregression of errors that the Bayesian criterion chooses, reluctantly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surge_core.types import FloatArray

# An autoregression must win this much more than its parameters cost (in log-units of BIC).
RELUCTANCE = 3.0
# Fewer rows than this many a lag tell no colour.
ROWS_PER_LAG = 20


def autoregression(pieces: Sequence[FloatArray], most_lags: int) -> FloatArray:
    """Return the autoregression of errors in several pieces; empty where they are white.

    Parameters
    ----------
    pieces : sequence of ndarray
        Errors; no equation straddles two pieces.
    most_lags : int
        Highest order that is tried.
    """
    lagged, target = [], []
    for e in pieces:
        if e.size <= most_lags:
            continue
        at = np.arange(most_lags, e.size)
        lagged.append(np.column_stack([e[at - back] for back in range(1, most_lags + 1)]))
        target.append(e[at])
    if not lagged:
        return np.zeros(0)
    return _chosen(np.concatenate(lagged), np.concatenate(target))


def _chosen(lagged: FloatArray, target: FloatArray) -> FloatArray:
    """Return the coefficients of the order that the criterion chooses, of rows one, two, … back."""
    n, most_lags = lagged.shape
    if n < ROWS_PER_LAG * most_lags:
        return np.zeros(0)
    best, best_score = np.zeros(0), 0.5 * n * np.log(max(float(target @ target) / n, 1e-300))
    for order in range(1, most_lags + 1):
        a = np.linalg.lstsq(lagged[:, :order], target, rcond=None)[0]
        left = target - lagged[:, :order] @ a
        mean = max(float(left @ left) / n, 1e-300)
        score = 0.5 * n * np.log(mean) + 0.5 * order * np.log(n) + RELUCTANCE
        if score < best_score - 1e-9:
            best, best_score = np.asarray(a, dtype=np.float64), score
    return np.asarray(best)
