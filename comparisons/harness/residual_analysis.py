"""Numbers behind the pictures: spectra over segments, correlations with bands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from classic_ml.whitening import bartlett_widening, lagged_correlation
from surge_core.types import BoolArray, FloatArray

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
    band99 : tuple of float
        Factors on a true density between which 99 % of the estimates lie.
    """

    frequency_hz: FloatArray
    density: FloatArray
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


def segment_spectrum(values: FloatArray, runs: list[slice], sample_period_s: float) -> Spectrum:
    """Return the power spectrum of a signal that is known in segments.

    Each segment is cut into Hann-windowed pieces that overlap by half, the first-order trend is
    taken out of each piece (the paper takes it out of the record, p. 3), and the periodograms
    are averaged (Welch). No piece straddles two segments.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal.
    runs : list of slice
        Its segments; shorter ones than a piece, which three quarters of them reach, do not count.
    sample_period_s : float
        Sample period, in seconds.

    Returns
    -------
    Spectrum
        From the first frequency that a piece resolves to half the sample rate.
    """
    from scipy.signal import detrend, periodogram
    from scipy.stats import chi2

    lengths = np.sort([run.stop - run.start for run in runs])
    rows = min(int(lengths[lengths.size // 4]), LONGEST_PIECE)
    pieces = np.concatenate(
        [
            np.lib.stride_tricks.sliding_window_view(values[run], rows)[:: rows // 2]
            for run in runs
            if run.stop - run.start >= rows
        ]
    )
    frequency, density = periodogram(pieces, 1.0 / sample_period_s, "hann", detrend=detrend)
    n = len(pieces)
    freedom = 2.0 * n / (1.0 + 2.0 * (1.0 - 1.0 / n) * OVERLAP_CORRELATION)
    tail = 0.5 * (1.0 - CONFIDENCE)
    band = (float(chi2.ppf(tail, freedom) / freedom), float(chi2.isf(tail, freedom) / freedom))
    return Spectrum(frequency[1:], np.mean(density, axis=0)[1:], band)


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
    from scipy.stats import norm

    other = errors if phi is None else phi - np.mean(phi)
    value = lagged_correlation(errors, other, runs, n_lags)
    limit = float(norm.isf(0.5 * (1.0 - CONFIDENCE))) / math.sqrt(max(errors.size, 1))
    lags = sample_period_s * np.arange(-n_lags, n_lags + 1, dtype=np.float64)
    if phi is None:
        return Correlation(lags[n_lags + 1 :], value[n_lags + 1 :], limit)
    return Correlation(lags, value, limit * bartlett_widening(errors, other, runs, n_lags))


def dwelt_on(grid: FloatArray, phi: FloatArray) -> BoolArray:
    """Return where on a grid there are rows nearby, within 2 % of the range of φ.

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
    pressure_ratio: FloatArray, in_stall: BoolArray, sample_rate_hz: float
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
