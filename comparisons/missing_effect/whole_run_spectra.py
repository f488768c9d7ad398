"""What spectra say of whole runs: a second pattern of stall cells, and the measurement noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from classic_ml.filters import period_average
from classic_ml.record_reading import RecordReading
from surge_core.types import BoolArray, FloatArray

HIGHEST_LINE_HZ, HIGHEST_SHARE = 400.0, 0.4
# A second pattern turns at least this much as fast as the first; below lie surge's own harmonics.
# From twice as fast on a side line of the first has its partner below zero.
SLOWEST_PATTERN, FASTEST_PATTERN = 0.4, 2.0
# Harmonics of the cells beyond half the rate fold into what is looked at: of 45 records without a
# second pattern, thinned to 200 to 333 Hz, 15 read one; of 31 at 400 Hz and more none did.
LEAST_RATE = 5.0
# Harmonics of the cells are this wide; the background of a line is the median over so much.
NEAR_CELLS_HZ, BACKGROUND_HZ = 3.0, 40.0
# What of a line in stall stands before surge where it is hum (all of it) and no pattern (nothing);
# how long before the first reversal stall may begin; and turns of a line that are enough to see it.
HUM, BEFORE_SURGE_S, FEWEST_TURNS = 0.5, 0.1, 3.0
# What three standard deviations leave to chance, shared by all lines that were looked at.
CHANCE = 0.00135


@dataclass(frozen=True)
class RippleLine:
    """A line of rotating stall beside those of the first pattern.

    The amplitude is that of ψ' while in stall, the height the power over that of the spectrum
    around it; the error of the frequency follows from the length of the record and the height.
    """

    frequency_hz: float
    amplitude: float
    height: float
    frequency_stderr_hz: float


def ripple_line(reading: RecordReading) -> RippleLine | None:
    """Look for a second pattern of stall cells in the rake differences, which carry no surge.

    Surge switches the known cells on and off: that leaves side lines in pairs, as far below a
    harmonic of the cells as above it, and nearly as high, as high as the spectrum of the switching
    at that distance. How unequal the pairs of this record are is the null; a pattern of its own has
    no partner and stands above both. As no probe is like another, a difference has a part of what
    the whole flow does: where the mean has more of a line, the cells' share off, it is no pattern.
    """
    from scipy.ndimage import maximum_filter1d, median_filter
    from scipy.stats import median_abs_deviation, norm

    signals, passes = reading.signals, reading.passes
    rate_hz, cells_hz = 1.0 / passes.sample_period_s, 1.0 / passes.period_s
    if rate_hz < LEAST_RATE * cells_hz:
        return None
    stalled = np.zeros(signals.inlet_K.size, dtype=np.bool_)
    stalled[passes.row] = reading.in_stall

    def quick(values: FloatArray, periods: float = 3.0) -> FloatArray:
        return values - period_average(values, periods * passes.period_s, rate_hz)

    both = [tuple(map(quick, pair)) for p in (25, 31) for pair in signals.cell_differences(p)]
    if not both or np.count_nonzero(stalled) < 10.0 * passes.rows_of(passes.period_s):
        return None
    size = int(2 ** np.ceil(np.log2(2 * stalled.size)))
    frequency = np.fft.rfftfreq(size, passes.sample_period_s)
    step_hz = float(frequency[1])

    near = max(3, round(NEAR_CELLS_HZ / step_hz) | 1)
    harmonics = np.round(np.arange(cells_hz, 0.5 * rate_hz, cells_hz) / step_hz).astype(np.int64)
    apart = np.arange(frequency.size) - harmonics[:, None]
    switching = np.abs(np.fft.fft(stalled.astype(np.float64), size)) ** 2
    # The spectrum of a real signal is that at -f, too.
    switching = switching[apart] + switching[(apart + 2 * harmonics[:, None]) % size]

    def heights_of(*pair: FloatArray) -> tuple[FloatArray, ...]:
        power, of_mean = (np.abs(np.fft.rfft(_held(each, stalled), size)) ** 2 for each in pair)
        around = np.maximum(median_filter(power, round(BACKGROUND_HZ / step_hz) | 1), 1e-300)
        nearby = maximum_filter1d(power, near)
        shared = np.sqrt(maximum_filter1d(of_mean, near) / np.maximum(nearby, 1e-300))
        of_cells = shared <= 1.0 + shared[harmonics[0]]
        return power / around, of_cells * power / around, nearby[harmonics] @ switching / around

    height, own_height, switched = np.mean([heights_of(*each) for each in both], axis=0)
    highest, switched = maximum_filter1d(height, near), maximum_filter1d(switched, near)
    harmonic = np.maximum(np.round(frequency / cells_hz), 1.0) * cells_hz
    wanted = (
        (np.abs(frequency - harmonic) > NEAR_CELLS_HZ)
        & (frequency > SLOWEST_PATTERN * cells_hz)
        & (frequency < min(HIGHEST_LINE_HZ, HIGHEST_SHARE * rate_hz))
    )
    peaks = np.flatnonzero(wanted & (height == highest))
    if peaks.size < 2:
        return None
    # Half way between two harmonics a line may be a side line of either.
    below = np.maximum(np.floor(frequency[peaks] / cells_hz), 1.0) * cells_hz
    partners = [2.0 * own - frequency[peaks] for own in (below, below + cells_hz)]
    partner = np.max([np.interp(there, frequency, highest) for there in partners], axis=0)
    switched = switched[peaks] * np.median(height[peaks] / switched[peaks])
    unequal = np.log(height[peaks] / np.maximum(partner, switched))
    spread = median_abs_deviation(unequal, scale="normal")
    alone = unequal > np.median(unequal) + spread * norm.isf(CHANCE / peaks.size)
    # In noise the power over its median follows an exponential law.
    loud = own_height[peaks] > np.log(np.count_nonzero(wanted) / CHANCE) / np.log(2.0)
    found = peaks[alone & loud & (frequency[peaks] < FASTEST_PATTERN * cells_hz)]
    hum = [_is_hum(reading, both, stalled, hz) for hz in frequency[found].tolist()]
    found = found[~np.array(hum, dtype=np.bool_)]
    if not found.size:
        return None
    best = int(found[np.argmax(height[found])])
    line_hz, tall = float(frequency[best]), float(height[best])
    psi_p = quick(np.nan_to_num(signals.coefficients(signals.planes())[1]), 1.0)
    amplitude = _amplitude(_held(psi_p, stalled), line_hz, rate_hz) / float(np.mean(stalled))
    # The bound for a line in white noise: √6 / (2π T √(power ratio)).
    spread_hz = float(np.sqrt(6.0 / tall)) * rate_hz / (2.0 * np.pi * stalled.size)
    return RippleLine(line_hz, amplitude, tall, spread_hz)


def _is_hum(
    reading: RecordReading,
    differences: Sequence[tuple[FloatArray, ...]],
    stalled: BoolArray,
    frequency_hz: float,
) -> bool:
    """Return whether a line stands before the first reversal, too, in a rake difference."""
    signals, passes = reading.signals, reading.passes
    rate_hz = 1.0 / passes.sample_period_s
    reversal = int(np.argmax(signals.mean(signals.flow_kg_s, 25) < 0.0))
    n = max(reversal - passes.rows_of(BEFORE_SURGE_S), 0)
    if n * frequency_hz < FEWEST_TURNS * rate_hz:
        return False
    for quick, _ in differences:
        in_stall = _amplitude(_held(quick, stalled), frequency_hz, rate_hz) / np.mean(stalled)
        before = _amplitude(quick[:n], frequency_hz, rate_hz)
        # In noise the square of an amplitude follows an exponential law.
        stands = 0.25 * n * before**2 > -np.log(CHANCE) * np.var(quick[:n])
        if stands and before > HUM * in_stall:
            return True
    return False


def _amplitude(values: FloatArray, frequency_hz: float, rate_hz: float) -> float:
    """Return the amplitude of a line."""
    turn = np.exp(-2j * np.pi * frequency_hz / rate_hz * np.arange(values.size))
    return 2.0 * float(np.abs(values @ turn)) / values.size


def _held(quick: FloatArray, stalled: BoolArray) -> FloatArray:
    """Return what is in stall; reversals are spikes whose comb would hide a line: held down."""
    return np.where(stalled, np.clip(quick, *np.quantile(quick[stalled], [0.02, 0.98])), 0.0)


def averaged_noise(readings: Sequence[RecordReading]) -> float:
    """Return the measurement noise that the average of the fit leaves in ψ'.

    The spectrum between the harmonics of the cells is taken as a + b f² (white noise, and that of
    the flow's derivative) and seen through the average.
    """
    from scipy.optimize import nnls
    from scipy.signal import welch

    variances = []
    for reading in readings:
        passes = reading.passes
        rate_hz, cells_s = 1.0 / passes.sample_period_s, passes.period_s
        held = _held(passes.psi_p - passes.smooth(passes.psi_p, cells_s), reading.in_stall)
        frequency, density = welch(held, rate_hz, nperseg=min(256, held.size))
        density = density / max(float(np.mean(reading.in_stall)), 1e-9)
        wanted = frequency > 0.2 * rate_hz
        for harmonic in range(1, int(0.5 * rate_hz * cells_s) + 2):
            wanted &= np.abs(frequency - harmonic / cells_s) > 2.0 * rate_hz / 256
        if np.count_nonzero(wanted) < 8:
            wanted = frequency > 0.2 * rate_hz
        weight = 1.0 / density[wanted]
        terms = np.column_stack([np.ones(frequency.size), (frequency / rate_hz) ** 2])
        size, _ = nnls(terms[wanted] * weight[:, None], np.ones(weight.size))
        passed = np.sinc(frequency * reading.spec.average_s) ** 2
        variances.append(float(np.sum((terms @ size) * passed) * (frequency[1] - frequency[0])))
    return float(np.sqrt(np.mean(variances)))
