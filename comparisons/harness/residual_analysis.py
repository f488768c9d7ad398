"""Numbers behind the pictures: spectra over segments, correlations with bands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.whitening import bartlett_widening, lagged_correlation
from surge_core.types import FloatArray

__all__ = [
    "Correlation",
    "Spectrum",
    "dwelt_on",
    "error_correlation",
    "segment_spectrum",
    "stall_inception",
]

CONFIDENCE = 0.99
LONGEST_PIECE = 512
SHORTEST_PIECE = 8
# From the stall point to reversed flow a high-speed compressor takes some tens of milliseconds.
INCEPTION_S = 0.25
NEARBY_SHARE = 0.02
# The periodograms of two Hann-windowed pieces that overlap by half are correlated by (1/6)²
# (Welch, IEEE Trans. Audio Electroacoust. 15 (1967), 70).
OVERLAP_CORRELATION = 1.0 / 36.0


@dataclass(frozen=True)
class Spectrum:
    """A one-sided power spectral density.

    Parameters
    ----------
    frequency_hz : ndarray of shape (n,)
        Frequencies, without zero.
    density : ndarray of shape (n,)
        Power per hertz, in the unit of the signal squared.
    degrees_of_freedom : float
        Of the χ² law that each value follows.
    band99 : tuple of float
        Factors on a true density between which 99 % of the estimates lie.
    """

    frequency_hz: FloatArray
    density: FloatArray
    degrees_of_freedom: float
    band99: tuple[float, float]


@dataclass(frozen=True)
class Correlation:
    """A correlation over lags with the band in which 99 % of the values lie by chance.

    Parameters
    ----------
    lag_s : ndarray of shape (n,)
        Lags; positive where the errors come after the other signal.
    value : ndarray of shape (n,)
        Correlation, between -1 and 1.
    limit99 : float
        Half the width of the pointwise 99 % band.
    """

    lag_s: FloatArray
    value: FloatArray
    limit99: float


def segment_spectrum(
    values: FloatArray,
    runs: list[slice],
    sample_period_s: float,
    *,
    piece_rows: int | None = None,
) -> Spectrum:
    """Return the power spectrum of a signal that is known in segments.

    Each segment is cut into Hann-windowed pieces that overlap by half, the first-order trend is
    taken out of each piece (the paper takes it out of the record, p. 3), and the periodograms
    are averaged (Welch). No piece straddles two segments.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal.
    runs : list of slice
        Its segments.
    sample_period_s : float
        Sample period, in seconds.
    piece_rows : int, optional
        Rows of a piece; else a length that at least three quarters of the segments reach.

    Returns
    -------
    Spectrum
        From the first frequency a piece can tell to half the sample rate. A segment shorter than
        a piece counts where no segment reaches it, and not otherwise.
    """
    from scipy.signal import detrend, periodogram
    from scipy.stats import chi2

    rows = _piece_rows(runs) if piece_rows is None else piece_rows
    pieces = np.stack([values[piece] for piece in _pieces(runs, rows)])
    frequency, density = periodogram(pieces, 1.0 / sample_period_s, "hann", detrend=detrend)
    n = len(pieces)
    freedom = 2.0 * n / (1.0 + 2.0 * (1.0 - 1.0 / n) * OVERLAP_CORRELATION)
    tail = 0.5 * (1.0 - CONFIDENCE)
    band = (float(chi2.ppf(tail, freedom) / freedom), float(chi2.isf(tail, freedom) / freedom))
    return Spectrum(frequency[1:], np.mean(density, axis=0)[1:], freedom, band)


def error_correlation(
    errors: FloatArray,
    runs: list[slice],
    sample_period_s: float,
    n_lags: int = 40,
    *,
    phi: FloatArray | None = None,
) -> Correlation:
    """Return the correlation of one-step errors with themselves or with φ, within segments.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        One-step errors.
    runs : list of slice
        Their segments; no product straddles two.
    sample_period_s : float
        Sample period, in seconds.
    n_lags : int
        Largest lag, in samples.
    phi : ndarray of shape (n,), optional
        Flow coefficient, for lags of both signs; else the errors themselves, from lag 1 on.

    Returns
    -------
    Correlation
        With the band of white errors, ± 2.58/√n; with φ it is wider by Bartlett's
        √(1 + 2 Σ ρ_e ρ_φ), which allows for the memory of both.
    """
    other = errors if phi is None else phi - np.mean(phi)
    value = lagged_correlation(errors, other, runs, n_lags)
    limit = _normal_limit() / math.sqrt(max(errors.size, 1))
    lags = sample_period_s * np.arange(-n_lags, n_lags + 1, dtype=np.float64)
    if phi is None:
        return Correlation(lags[n_lags + 1 :], value[n_lags + 1 :], limit)
    return Correlation(lags, value, limit * bartlett_widening(errors, other, runs, n_lags))


def dwelt_on(grid: FloatArray, phi: FloatArray) -> NDArray[np.bool_]:
    """Tell where on a grid there are rows nearby, within 2 % of the range of φ.

    Parameters
    ----------
    grid : ndarray of shape (n,)
        Points at which a characteristic is drawn.
    phi : ndarray of shape (m,)
        Flow coefficient of the fitted rows.
    """
    known = np.sort(phi)
    after = np.clip(np.searchsorted(known, grid), 1, known.size - 1)
    nearest = np.minimum(np.abs(grid - known[after - 1]), np.abs(grid - known[after]))
    return np.asarray(nearest <= NEARBY_SHARE * float(np.ptp(phi)))


def stall_inception(
    pressure_ratio: FloatArray, in_stall: NDArray[np.bool_], sample_rate_hz: float
) -> int | None:
    """Return the row from which the machine fell into its first stall.

    Parameters
    ----------
    pressure_ratio : ndarray of shape (n,)
        P31 over P25.
    in_stall : ndarray of bool, shape (n,)
        True while the machine is in stall.
    sample_rate_hz : float
        Samples a second.

    Returns
    -------
    int or None
        The row of the highest pressure ratio in the quarter second before the first row in
        stall; None where there is no such row or the record begins in stall.
    """
    if not in_stall.any() or in_stall[0]:
        return None
    first = int(np.argmax(in_stall))
    start = max(0, first - int(INCEPTION_S * sample_rate_hz))
    return start + int(np.argmax(pressure_ratio[start : first + 1]))


def _piece_rows(runs: list[slice]) -> int:
    lengths = np.sort([run.stop - run.start for run in runs])
    reached = int(lengths[lengths.size // 4])
    return max(min(reached, LONGEST_PIECE), SHORTEST_PIECE)


def _pieces(runs: list[slice], rows: int) -> list[slice]:
    step = max(rows // 2, 1)
    pieces = [
        slice(start, start + rows)
        for run in runs
        for start in range(run.start, run.stop - rows + 1, step)
    ]
    if not pieces:
        raise ValueError(f"no segment is {rows} rows long")
    return pieces


def _normal_limit() -> float:
    from scipy.stats import norm

    return float(norm.isf(0.5 * (1.0 - CONFIDENCE)))
