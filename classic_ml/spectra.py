"""Power spectra of records with their first-order trend removed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from classic_ml.columns.workspace import IN_MEMORY, Workspace
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["detrend", "peak_frequency_hz", "power_spectrum"]

# 1600 samples at 1 kHz: bins of 0.625 Hz, which hold the paper's 81.2 and 162 Hz.
RECORD_SAMPLES = 1600
# 64 records of 1600 samples and their transforms stay in the caches.
RECORDS_AT_ONCE = 64


def detrend(values: FloatArray) -> FloatArray:
    """Return the signal without its least-squares straight line."""
    from scipy.signal import detrend as scipy_detrend

    return np.asarray(scipy_detrend(np.asarray(values, dtype=np.float64), type="linear"))


def power_spectrum(
    values: FloatArray,
    sample_rate_hz: float,
    *,
    record_samples: int = RECORD_SAMPLES,
    overlap: float = 0.5,
    workspace: Workspace = IN_MEMORY,
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
    workspace : Workspace
        Where the signal lies: the records are taken a few at a time, in order.

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
    if signal.ndim != 1 or signal.size < 8:
        raise _no_signal(f"shape {signal.shape}")
    length = min(record_samples, signal.size)
    step = length - int(overlap * length)
    shape = np.hanning(length + 1)[:-1]
    total, n_records = np.zeros(length // 2 + 1), 0
    for records in _records(signal, length, step, workspace):
        for power in _periodograms(records, shape):
            total += power
        n_records += len(records)
    density = total / (n_records * sample_rate_hz * np.sum(shape**2))
    # All but zero and half the sample rate stand for two frequencies.
    density[1 : (length + 1) // 2] *= 2.0
    frequency_hz = np.fft.rfftfreq(length, 1.0 / sample_rate_hz)
    return np.asarray(frequency_hz, dtype=np.float64), density


def _no_signal(found: str) -> InputError:
    return InputError(
        "power spectrum", expected="at least 8 finite samples of one signal", found=found
    )


def _records(
    signal: FloatArray, length: int, step: int, workspace: Workspace
) -> Iterator[FloatArray]:
    """Yield the overlapping records, some at a time, always cut from the first row on."""
    n_records = 1 + (signal.size - length) // step
    for first in range(0, n_records, RECORDS_AT_ONCE):
        last = min(first + RECORDS_AT_ONCE, n_records)
        # The samples behind the last record belong to none, but must be numbers all the same.
        stop = signal.size if last == n_records else (last - 1) * step + length
        piece = signal[first * step : stop]
        if not np.isfinite(piece).all():
            raise _no_signal("a value that is not finite")
        yield np.lib.stride_tricks.sliding_window_view(piece, length)[::step][: last - first]
        workspace.release()


def _periodograms(records: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the squared transform of each record, its own straight line removed, windowed.

    The line of each record takes that of the whole signal with it.
    """
    length = shape.size
    place = np.arange(length) - 0.5 * (length - 1)
    level = records - np.mean(records, axis=1, keepdims=True)
    slope = np.einsum("ij,j->i", level, place) / np.sum(place**2)
    level -= slope[:, None] * place
    level *= shape
    # Not that of scipy, which does the same and takes a twentieth of a second to load.
    transform = np.fft.rfft(level, axis=1)
    return np.asarray(transform.real**2 + transform.imag**2)


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
