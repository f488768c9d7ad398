"""Two predictions of one signal: the difference of their errors, and whether it is luck."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from surge_core.leave_out import correlation_length, scatter
from surge_core.types import BoolArray, FloatArray

MINIMUM_BLOCKS = 6
MINIMUM_LOSS_BLOCKS, FEWEST_LOSSES = 12, 16


def diebold_mariano(losses: FloatArray, runs: list[slice]) -> float:
    """Test whether two predictions are equally accurate on average: the two-sided p-value.

    ``losses`` are those of one less those of the other, row by row in the order of time; each
    segment is a block, and where there are fewer than twelve they are cut. NaN for fewer than 16
    rows and for losses that do not differ.

    Notes
    -----
    Diebold and Mariano (Journal of Business & Economic Statistics 13, 1995) on sums over blocks,
    with the correction of Harvey, Leybourne and Newbold (International Journal of Forecasting 13,
    1997) for the lags over which these hang together: what repeats in every surge cycle hangs
    together for ever from row to row. The variance is that of B slow cosines (Lazarus, Lewis,
    Stock and Watson, Journal of Business & Economic Statistics 36, 2018) whose half waves are
    longer than two such lags, and has B degrees of freedom.
    """
    from scipy.fft import dct
    from scipy.stats import t

    if losses.size < FEWEST_LOSSES or not np.ptp(losses):
        return math.nan
    mean = float(np.mean(losses))
    sums = np.array([np.sum(losses[b] - mean) for b in _blocks(runs, MINIMUM_LOSS_BLOCKS)])
    n = sums.size
    lags = min(correlation_length(sums, [n]), n // 4)
    waves = max(n // (2 * lags), 3)
    variance = float(np.mean(dct(sums, norm="ortho")[1 : waves + 1] ** 2))
    corrected = (n + 1 - 2 * lags + lags * (lags - 1) / n) / n
    statistic = mean * losses.size * math.sqrt(corrected / (n * variance))
    return float(2.0 * t.sf(abs(statistic), waves))


def block_errors(
    error: FloatArray, runs: list[slice], scored: BoolArray | None = None
) -> FloatArray:
    """Return the sum of squares and the number of rows that count of each block.

    Each segment is a block; where there are fewer than six they are cut into as many pieces as make
    six. The result is of shape (n_blocks, 2).
    """
    keep = np.ones(error.size, dtype=np.bool_) if scored is None else scored
    blocks = _blocks(runs, MINIMUM_BLOCKS)
    rows = [(np.sum(error[b][keep[b]] ** 2), np.sum(keep[b])) for b in blocks if keep[b].any()]
    return np.asarray(rows, dtype=np.float64).reshape(-1, 2)


def _blocks(runs: list[slice], fewest: int) -> list[slice]:
    pieces = max(1, math.ceil(fewest / max(len(runs), 1)))
    edges = [np.linspace(run.start, run.stop, pieces + 1).astype(int) for run in runs]
    return [slice(*ends) for own in edges for ends in pairwise(own)]


def paired_difference(blocks: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return the difference of two rms errors, of :func:`block_errors`, and its paired error.

    That is the jackknife standard error over the blocks: they are shared, so what makes one hard is
    hard for both.
    """
    errors = np.sqrt(_means(blocks)) - np.sqrt(_means(reference))
    return float(errors[0]), _jackknife(errors[1:])


def compared(
    errors: FloatArray, least: FloatArray, runs: list[slice]
) -> tuple[float, float, float]:
    """Return by how much the rms of errors exceeds the least, the paired error and the p-value.

    Of the same errors the difference is 0.
    """
    if errors is least or not errors.size:
        return 0.0, 0.0, math.nan
    paired = paired_difference(block_errors(errors, runs), block_errors(least, runs))
    return *paired, diebold_mariano(errors**2 - least**2, runs)


def block_rms(blocks: FloatArray) -> tuple[float, float]:
    """Return the rms error over what :func:`block_errors` gave, and its jackknife error."""
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
