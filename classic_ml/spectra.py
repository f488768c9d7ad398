"""Power spectra of records with their first-order trend removed."""

from __future__ import annotations

import numpy as np
from scipy.signal import welch

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
    frequency, density = welch(values, sample_rate_hz, "hann", length, detrend="linear")
    return np.asarray(frequency, np.float64), np.asarray(density)


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
