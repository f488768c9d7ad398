"""Standard errors that hold for coloured residuals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.signal import fftconvolve

from classic_ml.records import FloatArray

__all__ = ["block_jackknife", "correlation_length"]

# A long record is cut into twenty: enough to estimate a variance to a sixth, few enough that a
# block is long against the memory of its errors.
BLOCKS = 20
FEWEST_BLOCKS = 4


def correlation_length(innovations: FloatArray, piece_lengths: list[int]) -> int:
    """Return the number of lags over which errors still hang together.

    Parameters
    ----------
    innovations : ndarray of shape (n,)
        Errors of all stretches, one after the other.
    piece_lengths : list of int
        Rows of each stretch.

    Returns
    -------
    int
        Twice the lag after which five autocorrelations in a row are insignificant (Politis
        2003), at least 1, at most the longest stretch.
    """
    longest = max(piece_lengths)
    acf = _autocorrelation(innovations, piece_lengths, min(longest - 1, 4000))
    limit = 2.0 * np.sqrt(np.log10(max(innovations.size, 10)) / innovations.size)
    quiet = np.abs(acf[1:]) < limit
    last = quiet.size
    for lag in range(max(quiet.size - 4, 0)):
        if np.all(quiet[lag : lag + 5]):
            last = lag
            break
    return int(np.clip(2 * last, 1, longest))


def block_jackknife(
    jacobian: FloatArray, innovations: FloatArray, piece_lengths: list[int], n_lags: int
) -> tuple[FloatArray, int]:
    """Return the covariance by leaving out one block at a time, linearised about the fit.

    Parameters
    ----------
    jacobian : ndarray of shape (n, p)
        ∂e/∂θ.
    innovations : ndarray of shape (n,)
        The errors e at the optimum.
    piece_lengths : list of int
        Rows of each stretch. A short stretch (one surge cycle) is a block; a long one is cut.
    n_lags : int
        Rows over which errors hang together; no block is cut shorter.

    Returns
    -------
    covariance : ndarray of shape (p, p)
    n_blocks : int

    Notes
    -----
    Leaving out block g moves θ by B (I - A_g B)⁻¹ J_g'e_g with B = (J'J)⁻¹ and A_g = J_g'J_g, and
    the covariance is (G-1)/G times the scatter of these moves: the sandwich CR3 of Bell and
    McCaffrey (2002). It allows for colour, for errors that grow with the signal, and for blocks
    that carry much of the information; on a dozen short segments a Newey-West sum states errors
    that are far too small.
    """
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale[scale == 0.0] = 1.0
    columns = jacobian / scale
    bread = np.linalg.pinv(columns.T @ columns, hermitian=True)
    identity = np.eye(columns.shape[1])
    moves = []
    for block in _blocks(piece_lengths, n_lags):
        rows = columns[block]
        score = rows.T @ innovations[block]
        # lstsq, not solve: a block that alone determines a parameter makes this singular.
        moves.append(bread @ np.linalg.lstsq(identity - rows.T @ rows @ bread, score)[0])
    spread = np.asarray(moves) - np.mean(moves, axis=0)
    share = (len(moves) - 1) / len(moves)
    return np.asarray(share * spread.T @ spread / np.outer(scale, scale)), len(moves)


def _blocks(piece_lengths: list[int], n_lags: int) -> list[slice]:
    total = sum(piece_lengths)
    shortest = min(max(total / BLOCKS, n_lags), total / FEWEST_BLOCKS)
    blocks = []
    at = 0
    for length in piece_lengths:
        parts = max(1, int(length // max(shortest, 1.0)))
        if len(piece_lengths) < FEWEST_BLOCKS:
            parts = max(parts, int(np.ceil(FEWEST_BLOCKS / len(piece_lengths))))
        edges = np.linspace(at, at + length, parts + 1).astype(int)
        blocks += [slice(low, high) for low, high in pairwise(edges.tolist()) if high > low]
        at += length
    return blocks


def _autocorrelation(values: FloatArray, piece_lengths: list[int], n_lags: int) -> FloatArray:
    acf = np.zeros(n_lags + 1)
    at = 0
    for length in piece_lengths:
        piece = values[at : at + length]
        lags = min(n_lags, length - 1)
        acf[: lags + 1] += fftconvolve(piece, piece[::-1])[length - 1 : length + lags]
        at += length
    return acf / acf[0] if acf[0] > 0.0 else acf
