"""Low-pass, alike on every measured channel, averages over one period, and power spectra."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt, sosfreqz, welch

from classic_ml.records import Channel, LedgerEntry, Record
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
    return welch(values, sample_rate_hz, nperseg=length, detrend="linear")


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
    """Return the centred moving average over exactly one period.

    It has a null at 1/period and at all its harmonics, and no delay. The ends of its window get
    fractional weights; near the ends of the record it is over what there is.
    """
    width = period_s * sample_rate_hz
    side = max(0, int(np.ceil(0.5 * (width - 1.0))))
    if side == 0:
        return np.asarray(values, dtype=np.float64)
    weights = np.ones(2 * side + 1)
    weights[[0, -1]] = 0.5 * (width - (2 * side - 1))
    n = values.size
    sums = np.convolve(values, weights)[side : side + n]
    # Which of the weights meet a row of the record.
    upto = np.concatenate([[0.0], np.cumsum(weights)])
    row = np.arange(n)
    first, stop = np.maximum(side - row, 0), np.minimum(side + n - row, weights.size)
    return np.asarray(sums / (upto[stop] - upto[first]))


def phase_delay_s(
    frequency_hz: float, sample_rate_hz: float, *, order: int, cutoff_hz: float
) -> float:
    """Return the phase delay of one causal pass at a frequency, in seconds."""
    sections = _sections(order, cutoff_hz, sample_rate_hz)
    grid = np.linspace(0.0, frequency_hz, 512)
    _, response = sosfreqz(sections, worN=grid, fs=sample_rate_hz)
    return float(-np.unwrap(np.angle(response))[-1] / (2.0 * np.pi * frequency_hz))


def filter_channels(
    record: Record,
    names: Iterable[str],
    *,
    order: int,
    cutoff_hz: float,
    phase: str,
    done: dict[str, tuple[FloatArray, FloatArray]] | None = None,
) -> Record:
    """Filter channels of a record, all with the same filter.

    Pressures and temperatures alike: a delay that differs between φ and ψ' reads as dynamics. The
    undershoot of the filter makes no pressure lower than the least that was read: a channel that
    it takes to zero or below is held there, and the history says so. ``done`` holds what was
    filtered alike before, and what came out; what is filtered now is added to it.
    """
    if phase == "none":
        return record.after(LedgerEntry("filter", "no low-pass filter", {"phase": phase}))
    rate, added, done = record.sample_rate_hz, [], {} if done is None else done
    held: dict[str, str | int | float | bool] = {}
    for name in names:
        channel = record.channel(name)
        before, smooth = done.get(name, (None, channel.values))
        if before is not channel.values:
            smooth = low_pass(channel.values, rate, order=order, cutoff_hz=cutoff_hz, phase=phase)
            done[name] = channel.values, smooth
        least = np.min(channel.values, initial=np.inf)
        if channel.unit == "Pa" and np.min(smooth, initial=np.inf) <= 0.0 < least:
            held[f"held_{name}"] = int(np.count_nonzero(smooth < least))
            smooth = np.maximum(smooth, least)
        added.append(Channel.adopt(name, smooth, channel.unit))
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
