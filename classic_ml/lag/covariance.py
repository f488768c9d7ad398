"""Blocks and standard errors that hold for coloured residuals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from classic_ml.lag.compiled import compiled
from surge_core.types import FloatArray, IntArray

__all__ = ["block_edges", "correlation_length", "scatter", "slow_correlation_length"]


# A long record is cut into twenty: enough to estimate a variance to a sixth, few enough that a
# block is long against the memory of its errors.
BLOCKS = 20
FEWEST_BLOCKS = 4
BINS_A_BLOCK = 10
MOST_LAGS = 4000
# White errors are seen to be white within the first few lags, without a transform.
FEW_LAGS = 24


def correlation_length(innovations: FloatArray, piece_lengths: IntArray | list[int]) -> int:
    """Return the number of lags over which errors still hang together.

    Parameters
    ----------
    innovations : ndarray of shape (n,)
        Errors of all stretches, one after the other.
    piece_lengths : array-like of int
        Rows of each stretch.

    Returns
    -------
    int
        Twice the lag after which five autocorrelations in a row are insignificant (Politis
        2003), at least 1, at most the longest stretch.
    """
    lengths = np.asarray(piece_lengths, dtype=np.int64)
    longest = int(lengths.max())
    n_lags = min(longest - 1, MOST_LAGS)
    limit = 2.0 * np.sqrt(np.log10(max(innovations.size, 10)) / innovations.size)
    few = min(FEW_LAGS, n_lags)
    last = _first_quiet(_few_lags(innovations, lengths, few), limit)
    if last is None and n_lags > few:
        last = _first_quiet(_many_lags(innovations, lengths, n_lags), limit)
    return int(np.clip(2 * (n_lags if last is None else last), 1, longest))


def slow_correlation_length(innovations: FloatArray, piece_lengths: IntArray | list[int]) -> int:
    """Return the number of rows over which averages of the errors hang together.

    A block has to be long against what does not average out within it. A ripple hangs together
    over the whole record and yet averages out in a few of its periods; judged by it, four blocks
    would be left, and an error known to no better than 40 %.

    Parameters
    ----------
    innovations, piece_lengths
        As in :func:`correlation_length`.
    """
    lengths = np.asarray(piece_lengths, dtype=np.int64)
    n_bin = max(innovations.size // (BLOCKS * BINS_A_BLOCK), 1)
    # Overlapping bins with tapered ends: a plain sum would fold a ripple back as a slow wave.
    taper = np.hanning(2 * n_bin + 1)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    bins, counts = [], []
    for low, high in pairwise(starts.tolist()):
        n = (high - low) // n_bin - 1
        if n < 1:
            continue
        counts.append(n)
        for k in range(n):
            part = innovations[low + k * n_bin : low + (k + 2) * n_bin]
            bins.append(float(part @ taper[: part.size]))
    if not bins or max(counts) < 8:
        return int(lengths.max())
    return n_bin * (1 + correlation_length(np.asarray(bins), counts))


def _first_quiet(products: FloatArray, limit: float) -> int | None:
    acf = products / products[0] if products[0] > 0.0 else products
    quiet = np.abs(acf[1:]) < limit
    run = np.convolve(quiet, np.ones(5), mode="valid") if quiet.size >= 5 else np.zeros(0)
    found = np.flatnonzero(run > 4.5)
    return int(found[0]) if found.size else None


@compiled
def _few_lags(values: FloatArray, lengths: IntArray, n_lags: int) -> FloatArray:
    """Sum e[k] e[k+lag] directly."""
    sums = np.zeros(n_lags + 1)
    at = 0
    for length in lengths:
        for low in range(at, at + length, 1024):
            for lag in range(min(n_lags, length - 1) + 1):
                n = min(1024, at + length - lag - low)
                if n > 0:
                    one, other = values[low : low + n], values[low + lag : low + lag + n]
                    total = 0.0
                    for k in range(n):
                        total += one[k] * other[k]
                    sums[lag] += total
        at += length
    return sums


def _many_lags(values: FloatArray, lengths: IntArray, n_lags: int) -> FloatArray:
    """Sum e[k] e[k+lag] by transforms of a few thousand rows at a time."""
    size = next_fast_len(4 * n_lags + 64, real=True)
    step = size - n_lags
    spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
    at = 0
    for length in lengths.tolist():
        for low in range(at, at + length, step):
            stop = at + length
            one = rfft(values[low : min(low + step, stop)], size)
            spectrum += np.conj(one) * rfft(values[low : min(low + size, stop)], size)
        at += length
    return np.asarray(irfft(spectrum, size)[: n_lags + 1])


def block_edges(piece_lengths: IntArray | list[int], n_lags: int) -> list[IntArray]:
    """Return where each stretch is cut into blocks, counted from its own first error.

    Parameters
    ----------
    piece_lengths : array-like of int
        Rows of each stretch. A short stretch (one surge cycle) is a block; a long one is cut.
    n_lags : int
        Rows over which errors hang together; no block is cut shorter.
    """
    lengths = np.asarray(piece_lengths, dtype=np.int64)
    total = int(lengths.sum())
    shortest = max(min(max(total / BLOCKS, n_lags), total / FEWEST_BLOCKS), 1.0)
    parts = np.maximum(1, (lengths // shortest).astype(np.int64))
    if lengths.size < FEWEST_BLOCKS:
        parts = np.maximum(parts, -(-FEWEST_BLOCKS // lengths.size))
    return [
        np.linspace(0, length, n + 1).astype(np.int64)[1:-1] if n > 1 else np.zeros(0, np.int64)
        for length, n in zip(lengths.tolist(), parts.tolist(), strict=True)
    ]


def scatter(moves: FloatArray) -> FloatArray:
    """Return the jackknife's covariance from what leaving out each block does.

    Parameters
    ----------
    moves : ndarray of shape (n_blocks, p)

    Returns
    -------
    ndarray of shape (p, p)
        (G-1)/G times the scatter of the moves: the sandwich CR3 of Bell and McCaffrey (2002). It
        allows for colour, for errors that grow with the signal, and for blocks that carry much of
        the information; on a dozen short segments a Newey-West sum states errors that are far too
        small.
    """
    spread = moves - moves.mean(axis=0)
    return np.asarray((len(moves) - 1) / len(moves) * spread.T @ spread)
