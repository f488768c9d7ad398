"""Correlations within segments, and errors whitened by an autoregression."""

from __future__ import annotations

import math

import numpy as np

from surge_core.types import FloatArray

ORDERS = (0, 1, 2, 3, 5, 8, 12, 18, 27)
# Enough to find an autoregression to a per cent; all rows are filtered with it.
ROWS_FOR_ORDER = 50_000


def lagged_correlation(
    first: FloatArray, second: FloatArray, runs: list[slice], n_lags: int
) -> FloatArray:
    """Return the correlation of two signals, level and all, over lags -n_lags … n_lags.

    A lag is positive where the first signal comes later. Products are summed over what a segment
    has, straddle none, and are divided by the power of the whole.
    """
    from scipy.signal import correlate

    norm = math.sqrt(float(first @ first) * float(second @ second))
    total = np.zeros(2 * n_lags + 1)
    for run in runs:
        one, two = first[run], second[run]
        if one.size == 0:
            continue
        full = correlate(one, two, mode="full", method="auto")
        reach = min(n_lags, one.size - 1)
        middle = one.size - 1
        total[n_lags - reach : n_lags + reach + 1] += full[middle - reach : middle + reach + 1]
    return total / norm if norm > 0.0 else total


def bartlett_widening(
    first: FloatArray, second: FloatArray, runs: list[slice], n_lags: int
) -> float:
    """Return by how much the memory of two level signals widens the band of their correlation.

    √(1 + 2 Σ ρ₁(k) ρ₂(k)) over n_lags, at least 1 (Bartlett 1946).
    """
    memories = [lagged_correlation(s, s, runs, n_lags)[n_lags + 1 :] for s in (first, second)]
    return math.sqrt(max(1.0 + 2.0 * float(memories[0] @ memories[1]), 1.0))


def autoregressive_innovations(errors: FloatArray, runs: list[slice]) -> FloatArray:
    """Return what an autoregression cannot predict of a signal that is known in segments.

    Its order, up to 27, is the one that BIC prefers below a quarter of the typical segment, so that
    most rows remain; the first of each segment, which have too few before them, are left out.
    """
    lengths = [run.stop - run.start for run in runs]
    longest = int(np.median(lengths)) // 4 if lengths else 0
    top = max(order for order in ORDERS if order <= longest)
    table = _lag_table(errors, runs, top, ROWS_FOR_ORDER)
    # One triangle holds the fits of all orders: their columns are nested, on the same rows.
    triangle: FloatArray = np.asarray(np.linalg.qr(table, mode="r"))
    aside, n = triangle[:, -1], table.shape[0]
    powers = np.array([float(aside[order:] @ aside[order:]) for order in range(top + 1)])
    if n <= top or powers[0] == 0.0:
        return _filtered(errors, runs, np.zeros(0))
    tried = [order for order in ORDERS if order <= top]
    tiny = np.finfo(np.float64).eps * powers[0]
    scores = [n * math.log(max(powers[p], tiny)) + p * math.log(n) for p in tried]
    order = tried[int(np.argmin(scores))]
    coef = np.linalg.lstsq(triangle[:order, :order], aside[:order])[0] if order else np.zeros(0)
    return _filtered(errors, runs, np.asarray(coef, dtype=np.float64))


def _lag_table(errors: FloatArray, runs: list[slice], order: int, most_rows: int) -> FloatArray:
    """Return the rows before each row, the nearest first, and the row itself as the last column."""
    tables = [np.zeros((0, order + 1))]
    left = most_rows
    for run in runs:
        values = errors[run][: max(left, 0)]
        if values.size <= order:
            continue
        left -= values.size
        windows = np.lib.stride_tricks.sliding_window_view(values, order + 1)
        tables.append(
            np.column_stack([windows[:, -2::-1] if order else windows[:, :0], windows[:, -1]])
        )
    return np.concatenate(tables)


def _filtered(errors: FloatArray, runs: list[slice], coef: FloatArray) -> FloatArray:
    weights = np.concatenate([[1.0], -coef])
    parts = [
        np.convolve(errors[run], weights, mode="valid")
        for run in runs
        if run.stop - run.start > coef.size
    ]
    return np.concatenate(parts) if parts else np.zeros(0)
