"""Power spectra of records with their first-order trend removed."""

from __future__ import annotations

import numpy as np
import scipy.signal
from scipy.signal import welch

from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["detrend", "peak_frequency_hz", "power_spectrum"]

# 1600 samples at 1 kHz: bins of 0.625 Hz, which hold the paper's 81.2 and 162 Hz.
RECORD_SAMPLES = 1600


def detrend(values: FloatArray) -> FloatArray:
    """Return the signal without its least-squares straight line."""
    return np.asarray(scipy.signal.detrend(np.asarray(values, dtype=np.float64), type="linear"))


def power_spectrum(
    values: FloatArray,
    sample_rate_hz: float,
    *,
    record_samples: int = RECORD_SAMPLES,
    overlap: float = 0.5,
) -> tuple[FloatArray, FloatArray]:
    """Return the one-sided power spectral density, first-order trend removed (Fig 4).

    Parameters
    ----------
    values : ndarray of shape (n,)
        Uniformly sampled signal.
    sample_rate_hz : float
        Samples a second.
    record_samples : int
        Samples in each averaged periodogram (Hann window, its own trend removed too); bins are
        ``sample_rate_hz / record_samples`` wide. A shorter signal is one record.
    overlap : float
        Share of a record that the next one repeats.

    Returns
    -------
    frequency_hz : ndarray of shape (m,)
        Frequencies from zero to half the sample rate.
    density : ndarray of shape (m,)
        Power per hertz; its integral is the variance of the detrended signal.

    Raises
    ------
    InputError
        When the signal has fewer than 8 samples or a value is not finite.
    """
    signal = np.asarray(values, dtype=np.float64)
    if signal.ndim != 1 or signal.size < 8 or not np.isfinite(signal).all():
        raise InputError(
            "power spectrum",
            expected="at least 8 finite samples of one signal",
            found=f"shape {signal.shape}"
            if signal.ndim != 1 or signal.size < 8
            else "a value that is not finite",
        )
    length = min(record_samples, signal.size)
    frequency_hz, density = welch(
        signal,
        sample_rate_hz,
        window="hann",
        nperseg=length,
        noverlap=int(overlap * length),
        detrend=scipy.signal.detrend,
    )
    return np.asarray(frequency_hz), np.asarray(density)


def peak_frequency_hz(
    frequency_hz: FloatArray, density: FloatArray, low_hz: float, high_hz: float
) -> float:
    """Return the frequency of the highest peak in a band, between bins by a parabola.

    Parameters
    ----------
    frequency_hz, density : ndarray of shape (m,)
        From :func:`power_spectrum`.
    low_hz, high_hz : float
        Band to look in.

    Returns
    -------
    float
        Frequency of the vertex of the parabola through the logarithms of the highest bin and
        its neighbours.
    """
    inside = np.flatnonzero((frequency_hz >= low_hz) & (frequency_hz <= high_hz))
    if inside.size == 0:
        raise InputError(
            "band", expected=f"bins between {low_hz:g} and {high_hz:g} Hz", found="none"
        )
    top = int(inside[np.argmax(density[inside])])
    if top in (0, density.size - 1) or np.min(density[top - 1 : top + 2]) <= 0.0:
        return float(frequency_hz[top])
    left, centre, right = np.log(density[top - 1 : top + 2])
    curvature = left - 2.0 * centre + right
    shift = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
    width = frequency_hz[1] - frequency_hz[0]
    return float(frequency_hz[top] + np.clip(shift, -0.5, 0.5) * width)
