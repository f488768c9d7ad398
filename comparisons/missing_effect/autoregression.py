"""The autoregression of errors that the Bayesian criterion chooses, reluctantly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surge_core.types import FloatArray

# An autoregression must win this much more than its parameters cost (in log-units of BIC).
RELUCTANCE = 3.0
# Highest order that is tried.
MOST_LAGS = 4
# Fewer rows than this many a lag tell no colour.
ROWS_PER_LAG = 20
# In each third of the readings so many have those before at an even step, or none is looked for.
LEAST_FOLLOWING = 0.5


def autoregression(errors: Sequence[FloatArray]) -> tuple[int, FloatArray]:
    """Return the rows from error to error, and their autoregression; empty where they are white.

    Parameters
    ----------
    errors : sequence of ndarray
        Of each run; not a number where there is none. No equation looks across a longer gap, unless
        the readings lie so unevenly that too few follow each other, as in the cooling of an oven
        that is logged when it changes: then, at 0 rows, from reading to reading.
    """
    rows = [np.flatnonzero(~np.isnan(e)) for e in errors]
    steps, counts = np.unique(np.concatenate([np.diff(r) for r in rows]), return_counts=True)
    stride = int(steps[np.argmax(counts)]) if steps.size else 1
    pieces = [
        e[piece]
        for e, there in zip(errors, rows, strict=True)
        for piece in np.split(there, np.flatnonzero(np.diff(there) != stride) + 1)
    ]
    follows = np.concatenate([np.arange(piece.size) >= MOST_LAGS for piece in pieces])
    thirds = [np.mean(part) for part in np.array_split(follows, 3) if part.size]
    if np.sum(follows) < ROWS_PER_LAG * MOST_LAGS or min(thirds) < LEAST_FOLLOWING:
        stride, pieces = 0, [e[there] for e, there in zip(errors, rows, strict=True)]
    back = range(MOST_LAGS + 1)
    rows = [
        np.column_stack([e[MOST_LAGS - k : e.size - k] for k in back])
        for e in pieces
        if e.size > MOST_LAGS
    ]
    joined = np.concatenate([np.zeros((0, MOST_LAGS + 1)), *rows])
    return stride, _chosen(joined[:, 1:], joined[:, 0])


def _chosen(lagged: FloatArray, target: FloatArray) -> FloatArray:
    """Return the coefficients of the order that the criterion chooses, of rows one, two, … back."""
    n, most_lags = lagged.shape
    if n < ROWS_PER_LAG:
        return np.zeros(0)
    best, best_score = np.zeros(0), 0.5 * n * np.log(max(float(target @ target) / n, 1e-300))
    for order in range(1, min(most_lags, n // ROWS_PER_LAG) + 1):
        a = np.linalg.lstsq(lagged[:, :order], target, rcond=None)[0]
        left = target - lagged[:, :order] @ a
        mean = max(float(left @ left) / n, 1e-300)
        score = 0.5 * n * np.log(mean) + 0.5 * order * np.log(n) + RELUCTANCE
        if score < best_score - 1e-9:
            best, best_score = np.asarray(a, dtype=np.float64), score
    return np.asarray(best)
