"""Standard errors by leaving out one block at a time, linearised about a least-squares fit.

Errors that hang together, grow with the signal or sit in few blocks make textbook errors several
times too small; the scatter of the fits without each block allows for all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from surge_core.types import FloatArray, IndexArray, IntArray

# A long record is cut into twenty: enough to estimate a variance to a sixth, few enough that a
# block is long against the memory of its errors.
BLOCKS = 20
FEWEST_BLOCKS = 4
BINS_A_BLOCK = 10
MOST_LAGS = 4000
# Of a scaled eigenvalue: less is a copy of other columns within the rounding of inner products.
NO_DIRECTION = 1e-13


def leave_out(
    jacobian: FloatArray, errors: FloatArray, blocks: Sequence[slice | IndexArray]
) -> tuple[FloatArray, FloatArray]:
    """Refit without each block of rows, linearised about the whole fit by ∂e/∂θ and the errors e.

    Returned are the parameters without each block less those of the whole fit, (n_blocks, p), and
    the inverse of the normal matrix of the other blocks.

    Without block g, θ moves by -(J'J - A_g)⁻¹ (J'e - J_g'e_g), A_g = J_g'J_g: exact for a linear
    fit (Cook and Weisberg 1982, section 3.5), at the cost of one pass over the rows whatever the
    number of blocks. A direction that one block alone determines does not move without it.
    """
    both = np.column_stack([jacobian, errors])
    whole = both.T @ both
    rest = whole - np.stack([both[block].T @ both[block] for block in blocks])
    scale = np.sqrt(np.diag(whole)[:-1])
    scale[scale < 1e-150] = 1.0  # Its square is nothing.
    rest[:, :-1] /= scale[:, None]
    rest[:, :, :-1] /= scale
    # Scaled by the whole: a direction that only the block sees is rounding in the rest.
    values, vectors = np.linalg.eigh(rest[:, :-1, :-1])
    kept = values > NO_DIRECTION
    half = vectors * np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)[..., None, :]
    inverse = half @ np.swapaxes(half, -1, -2)
    moves = -np.einsum("gij,gj->gi", inverse, rest[:, :-1, -1]) / scale
    return moves, inverse / np.outer(scale, scale)


def scatter(moves: FloatArray) -> FloatArray:
    """Return the jackknife's covariance from the moves without each block, of shape (n_blocks, p).

    (G-1)/G times their scatter: the sandwich CR3 of Bell and McCaffrey (2002). It allows for
    colour, for errors that grow with the signal, and for blocks that carry much of the information;
    on a dozen short segments a Newey-West sum states errors that are far too small.
    """
    spread = moves - moves.mean(axis=0)
    return np.asarray((len(moves) - 1) / len(moves) * spread.T @ spread)


def block_edges(piece_lengths: ArrayLike, n_lags: int) -> list[IntArray]:
    """Return where each stretch is cut into blocks, counted from its own first error.

    A short stretch (one surge cycle) is a block; a long one is cut, but no shorter than the
    ``n_lags`` rows over which errors hang together.
    """
    lengths = np.asarray(piece_lengths, dtype=np.int64)
    total = int(lengths.sum())
    shortest = max(min(max(total / BLOCKS, n_lags), total / FEWEST_BLOCKS), 1.0)
    # A record of twenty times the shortest block has twenty, however the quotient is rounded.
    parts = np.maximum(1, (lengths / shortest + 1e-9).astype(np.int64))
    if lengths.size < FEWEST_BLOCKS:
        parts = np.maximum(parts, -(-FEWEST_BLOCKS // lengths.size))
    return [
        np.unique(np.linspace(0, length, n + 1).astype(np.int64))[1:-1]
        for length, n in zip(lengths.tolist(), parts.tolist(), strict=True)
    ]


def correlation_length(errors: FloatArray, piece_lengths: ArrayLike) -> int:
    """Return the number of lags over which errors of stretches, one after the other, hang together.

    Twice the lag after which five autocorrelations in a row are insignificant (Politis 2003), at
    least 1, at most the longest stretch.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    pieces = np.split(errors, np.cumsum(np.asarray(piece_lengths, dtype=np.int64))[:-1])
    longest = max(piece.size for piece in pieces)
    n_lags = min(longest - 1, MOST_LAGS)
    limit = 2.0 * np.sqrt(np.log10(max(errors.size, 10)) / errors.size)
    products = np.zeros(n_lags + 1)
    for piece in pieces:
        size = next_fast_len(piece.size + n_lags, real=True)
        products += irfft(np.abs(rfft(piece, size)) ** 2, size)[: n_lags + 1]
    quiet = np.abs(products[1:]) <= limit * products[0]
    run = np.convolve(quiet, np.ones(5), mode="valid") if quiet.size >= 5 else np.zeros(0)
    found = np.flatnonzero(run > 4.5)
    return int(np.clip(2 * (found[0] if found.size else n_lags), 1, longest))


def slow_correlation_length(errors: FloatArray, piece_lengths: ArrayLike) -> int:
    """Return the number of rows over which averages of the errors hang together.

    A block has to be long against what does not average out within it. A ripple hangs together
    over the whole record and yet averages out in a few of its periods; judged by it, four blocks
    would be left, and an error known to no better than 40 %.
    """
    lengths = np.asarray(piece_lengths, dtype=np.int64)
    n_bin = max(errors.size // (BLOCKS * BINS_A_BLOCK), 1)
    # Overlapping bins with tapered ends: a plain sum would fold a ripple back as a slow wave.
    taper = np.hanning(2 * n_bin + 1)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    firsts = [range(low, high - 2 * n_bin + 1, n_bin) for low, high in pairwise(starts.tolist())]
    counts = [len(own) for own in firsts if own]
    if max(counts, default=0) < 8:
        return int(lengths.max())
    bins = [errors[k : k + 2 * n_bin] @ taper[:-1] for own in firsts for k in own]
    return n_bin * (1 + correlation_length(np.asarray(bins), counts))
