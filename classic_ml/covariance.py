"""Standard errors that hold for coloured residuals."""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from classic_ml.records import FloatArray

__all__ = ["bartlett_lag", "sandwich"]


def bartlett_lag(innovations: FloatArray, piece_lengths: list[int]) -> int:
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


def sandwich(
    jacobian: FloatArray, innovations: FloatArray, piece_lengths: list[int], n_lags: int
) -> FloatArray:
    """Return the heteroscedasticity- and autocorrelation-consistent covariance.

    Parameters
    ----------
    jacobian : ndarray of shape (n, p)
        ∂e/∂θ.
    innovations : ndarray of shape (n,)
        The errors e at the optimum.
    piece_lengths : list of int
        Rows of each stretch; scores of different stretches count as independent.
    n_lags : int
        Width of the Bartlett window, in rows.

    Returns
    -------
    ndarray of shape (p, p)

    Notes
    -----
    B Ω B with B = (J'J)⁻¹ and Ω the Bartlett-weighted sum of score products (Newey and West
    1987). The window sum is taken as overlapping batch sums, which is the same sum in O(n p²)
    whatever the width.
    """
    n_rows, n_parameters = jacobian.shape
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale[scale == 0.0] = 1.0
    bread = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale), hermitian=True)
    scores = (jacobian / scale) * innovations[:, None]
    meat = np.zeros((n_parameters, n_parameters))
    at = 0
    for length in piece_lengths:
        width = min(n_lags, length)
        total = np.zeros((length + 2 * width, n_parameters))
        np.cumsum(scores[at : at + length], axis=0, out=total[width : width + length])
        total[width + length :] = total[width + length - 1]
        batch = total[width:] - total[:-width]
        meat += batch.T @ batch / width
        at += length
    freedom = n_rows / max(n_rows - n_parameters, 1)
    return np.asarray(freedom * bread @ meat @ bread / np.outer(scale, scale))


def _autocorrelation(values: FloatArray, piece_lengths: list[int], n_lags: int) -> FloatArray:
    acf = np.zeros(n_lags + 1)
    at = 0
    for length in piece_lengths:
        piece = values[at : at + length]
        lags = min(n_lags, length - 1)
        acf[: lags + 1] += fftconvolve(piece, piece[::-1])[length - 1 : length + lags]
        at += length
    return acf / acf[0] if acf[0] > 0.0 else acf
