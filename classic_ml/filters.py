"""Low-pass, alike on every measured channel, averages over one period, and power spectra.

And the frequency above which a low-pass has emptied a signal. A noise model that whitens divides by
the spectrum of the errors: where next to nothing is left above 48 Hz of a record of 1 kHz, it
divides by nothing and fits the skirt of the filter.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import convolve1d
from scipy.signal import butter, detrend, sosfilt, sosfilt_zi, sosfiltfilt, sosfreqz, welch

from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
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


# 1600 samples at 1 kHz: bins of 0.625 Hz, which hold the paper's 81.2 and 162 Hz.
RECORD_SAMPLES = 1600


def power_spectrum(values: FloatArray, sample_rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies in Hz and the one-sided power spectral density (Fig 4).

    Periodograms of 1600 samples, Hann window, overlapping by half and each without its trend, are
    averaged; a shorter signal is one of them. The integral is the variance of the detrended signal.
    """
    length = min(RECORD_SAMPLES, values.size)
    frequency_hz, density = welch(values, sample_rate_hz, nperseg=length, detrend=detrend)
    return np.asarray(frequency_hz), np.asarray(density)


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


def low_pass(
    values: FloatArray, sample_rate_hz: float, *, order: int, cutoff_hz: float, phase: str
) -> FloatArray:
    """Filter one signal with a Butterworth low-pass; the paper's is of order 3 or 5 at 48 Hz.

    Phase ``"zero"`` runs forward and backward: no delay, and twice the attenuation in dB (−6 dB at
    the cut-off). ``"causal"`` runs once, as the paper's, and delays; it starts from the steady
    state of the first sample. ``"none"`` does nothing.
    """
    if phase == "none":
        return values
    sections = _sections(order, cutoff_hz, sample_rate_hz)
    if phase == "zero":
        return np.asarray(sosfiltfilt(sections, values))
    return np.asarray(sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0])


def period_average(values: FloatArray, period_s: float, sample_rate_hz: float) -> FloatArray:
    """Return the centred moving average over exactly one period, along the first axis.

    It has a null at 1/period and at all its harmonics, and no delay. The ends of its window get
    fractional weights; near the ends of the record it is over what there is.
    """
    width = period_s * sample_rate_hz
    side = max(0, int(np.ceil(0.5 * (width - 1.0))))
    if side == 0:
        return np.asarray(values, dtype=np.float64)
    weights = np.ones(2 * side + 1)
    weights[[0, -1]] = 0.5 * (width - (2 * side - 1))
    sums = convolve1d(np.asarray(values, dtype=np.float64), weights, axis=0, mode="constant")
    # Of the weights that meet a row of the record.
    met = convolve1d(np.ones(len(values)), weights, mode="constant")
    return np.asarray((sums.T / met).T)


def phase_delay_s(
    frequency_hz: float, sample_rate_hz: float, *, order: int, cutoff_hz: float
) -> float:
    """Return the phase delay of one causal pass at a frequency, in seconds."""
    sections = _sections(order, cutoff_hz, sample_rate_hz)
    grid = np.linspace(0.0, frequency_hz, 512)
    _, response = sosfreqz(sections, worN=grid, fs=sample_rate_hz)
    return float(-np.unwrap(np.angle(response))[-1] / (2.0 * np.pi * frequency_hz))


def filter_channels(
    record: Record, names: Iterable[str], *, order: int, cutoff_hz: float, phase: str
) -> Record:
    """Filter channels of a record, all with the same filter.

    Pressures and temperatures alike: a delay that differs between φ and ψ' reads as dynamics. The
    undershoot of the filter makes no pressure lower than the least that was read: a channel that
    it takes to zero or below is held there, and the history says so.
    """
    if phase == "none":
        return record.after(LedgerEntry("filter", "no low-pass filter", {"phase": phase}))
    rate, added = record.sample_rate_hz, []
    held: dict[str, str | int | float | bool] = {}
    for name in names:
        channel = record.channel(name)
        smooth = low_pass(channel.values, rate, order=order, cutoff_hz=cutoff_hz, phase=phase)
        least = np.min(channel.values, initial=np.inf)
        if channel.unit == "Pa" and np.min(smooth, initial=np.inf) <= 0.0 < least:
            held[f"held_{name}"] = int(np.count_nonzero(smooth < least))
            smooth = np.maximum(smooth, least)
        added.append(Channel(name, smooth, channel.unit))
    word = "forward and backward, without delay"
    if phase == "causal":
        at_hz = 0.2 * cutoff_hz
        delay_ms = 1e3 * phase_delay_s(at_hz, rate, order=order, cutoff_hz=cutoff_hz)
        word = f"causal, which delays surge frequencies by {delay_ms:.1f} ms"
    entry = LedgerEntry(
        "filter",
        f"Butterworth of order {order} at {cutoff_hz:g} Hz on {len(added)} channels, {word}",
        {"phase": phase, "order": order, "cutoff_hz": cutoff_hz, **held},
        flags=tuple(
            f"{key.removeprefix('held_')}: the filter undershoots zero pressure; in {rows} rows it "
            "is held at the least reading"
            for key, rows in held.items()
        ),
    )
    return record.after(entry, add=added)


@cache
def _sections(order: int, cutoff_hz: float, sample_rate_hz: float) -> FloatArray:
    if not 0.0 < cutoff_hz < 0.5 * sample_rate_hz:
        raise InputError(
            "cutoff_hz",
            expected=f"above 0 and below half the sample rate ({0.5 * sample_rate_hz:g} Hz)",
            found=f"{cutoff_hz:g}",
        )
    return np.asarray(butter(order, cutoff_hz, fs=sample_rate_hz, output="sos"))
