"""The frequency above which a low-pass has emptied a signal.

A noise model that whitens divides by the spectrum of the errors. Where a low-pass has left next
to nothing above 48 Hz of a record of 1 kHz, it divides by nothing and fits the skirt of the
filter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import detrend, welch

from surge_core.segments import runs_of
from surge_core.types import FloatArray

LONGEST_PIECE = 2048
SHORTEST_PIECE = 32
# Half the width, as a share of the frequency, of the running median that takes out lines such as
# the stall cells'.
MEDIAN_SHARE = 0.15
FEWEST_BINS = 2
# A Butterworth filter of order 3, the paper's lowest, falls by the sixth power of frequency; white
# noise does not fall, and a lag on white noise falls by the second.
STEEPNESS = 5.0
ALLOWANCE = 3.0
# In log f: a quarter of an octave and a bit, twice the width of the median.
BEFORE_CORNER = 0.3


def emptied_above_hz(
    values: ArrayLike, segments: ArrayLike | None = None, *, sample_period_s: float
) -> float | None:
    """Return the corner in Hz above which a low-pass has emptied a signal, None where none has.

    From that frequency on the spectrum falls at least as fast as its fifth power all the way to
    half the sample rate; it is the highest that has a flatter stretch before it, below an eighth of
    the sample rate. A signal without any noise is empty by itself and looks like a filtered one.
    """
    signal = np.asarray(values, dtype=np.float64)
    frequency, density = _spectrum(signal, runs_of(segments, signal.size), float(sample_period_s))
    if not frequency.size:
        return None
    tiny = np.finfo(np.float64).tiny
    log_f, log_s = np.log(frequency), np.log(np.maximum(_without_lines(frequency, density), tiny))
    # Whitened by f⁵, a skirt falls, and everything after its corner lies below it.
    level = log_s + STEEPNESS * log_f
    highest_after = np.maximum.accumulate(level[::-1])[::-1]
    limit = 0.25 * frequency[-1]
    falls = (highest_after <= level + np.log(ALLOWANCE)) & (frequency <= limit)
    if not falls.any():
        return None
    # A signal of low frequency has a skirt of its own: the corner is where the noise between the
    # two ends.
    below = np.interp(log_f - BEFORE_CORNER, log_f, log_s)
    flat = falls & (log_s - below > -0.5 * STEEPNESS * BEFORE_CORNER)
    return float(frequency[np.flatnonzero(flat)[-1] if flat.any() else np.argmax(falls)])


def _spectrum(
    signal: FloatArray, runs: list[slice], sample_period_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the spectrum averaged over the segments; empty where they are too short."""
    lengths = np.sort([run.stop - run.start for run in runs])
    # Three quarters of the segments reach this length; the others do not count.
    rows = min(int(lengths[lengths.size // 4]), LONGEST_PIECE)
    if rows < SHORTEST_PIECE:
        return np.empty(0), np.empty(0)
    # A few pieces at least, so that the estimate does not scatter by more than a factor of two.
    while lengths[lengths >= rows].sum() < 4 * rows and rows >= 2 * SHORTEST_PIECE:
        rows //= 2
    long = [signal[run] for run in runs if run.stop - run.start >= rows]
    # Its side lobes lie at -92 dB: Hann's would fill an emptied band with leakage.
    spectra = [
        welch(part, 1.0 / sample_period_s, "blackmanharris", rows, detrend=detrend) for part in long
    ]
    pieces = [1 + 2 * (part.size - rows) // rows for part in long]
    density = np.average([density for _, density in spectra], axis=0, weights=pieces)
    # The first bins hold what detrending left, the last has half the power.
    return np.asarray(spectra[0][0][1:-1]), np.asarray(density[1:-1])


def _without_lines(frequency: FloatArray, density: FloatArray) -> FloatArray:
    """Return the running median over a share of each frequency."""
    width = frequency[0]
    smooth = np.empty_like(density)
    for i, f in enumerate(frequency):
        side = max(int(MEDIAN_SHARE * f / width), FEWEST_BINS)
        smooth[i] = np.median(density[max(i - side, 0) : i + side + 1])
    return smooth
