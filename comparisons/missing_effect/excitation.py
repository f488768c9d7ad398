"""What φ did: the amplitude of its surge and its frequency, and channels freed of their noise."""

from __future__ import annotations

import numpy as np

from comparisons.missing_effect.lag_data import LagData
from surge_core.types import FloatArray

# A block of errors holds at least one surge cycle, or it is not independent of the next.
CYCLES_OF_BLOCK = 1.0
LEAST_BLOCK_ROWS = 15
MOST_BLOCK_SHARE = 1.0 / 12.0
# Share of the surge frequency below which its amplitude is taken to change.
AMPLITUDE_BAND = 0.25
# Resolution of the amplitude, and how much of it is predicted at each end.
POINTS_PER_CYCLE = 48.0
LEAD_CYCLES = 8.0
MOST_PREDICTORS = 160
# A channel whose sample-to-sample noise is below this share of its range is left as it is.
CLEAN_SHARE = 2e-4
LONGEST_WINDOW = 201
# What a window takes off may exceed the noise by this factor, or it took signal too.
MOST_REMOVED = 1.04


def surge_frequency_hz(phi: FloatArray, sample_rate_hz: float) -> float:
    """Return the frequency of the strongest line of φ, at least one cycle in the record."""
    centred = (phi - phi.mean()) * np.hanning(phi.size)
    power = np.abs(np.fft.rfft(centred, 4 * phi.size)) ** 2
    frequency = np.fft.rfftfreq(4 * phi.size, 1.0 / sample_rate_hz)
    power[frequency < 2.0 * sample_rate_hz / phi.size] = 0.0
    return float(frequency[np.argmax(power)])


def amplitude_of(phi: FloatArray, sample_rate_hz: float, *, prolonged: bool = True) -> FloatArray:
    """Return the amplitude of the analytic signal of φ, low-passed well below the surge frequency.

    Both ends of the record are prolonged by linear prediction first, unless it is to be taken as it
    stands: the analytic signal and the low-pass look many cycles ahead and back, and what they
    would make of an end is wrong by tens of percent.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, hilbert, sosfiltfilt

    surge_hz = surge_frequency_hz(phi, sample_rate_hz)
    if surge_hz == 0.0:
        return np.full(phi.size, float(np.std(phi)) * np.sqrt(2.0))
    every = max(1, int(sample_rate_hz / (POINTS_PER_CYCLE * surge_hz)))
    rate_hz = sample_rate_hz / every
    coarse = _means(phi - phi.mean(), every)
    lead = round(LEAD_CYCLES * rate_hz / surge_hz) if prolonged else 0
    envelope = np.abs(hilbert(_prolonged(coarse, lead) if prolonged else coarse))
    corner = AMPLITUDE_BAND * surge_hz / (0.5 * rate_hz)
    slow = sosfiltfilt(butter(2, corner, output="sos"), envelope)[lead : lead + coarse.size]
    at = (np.arange(coarse.size) + 0.5) * every - 0.5
    rows = np.arange(phi.size, dtype=np.float64)
    return np.asarray(CubicSpline(at, slow)(np.clip(rows, at[0], at[-1])))


def _means(values: FloatArray, every: int) -> FloatArray:
    n = values.size // every
    return np.asarray(values[: n * every].reshape(n, every).mean(axis=1))


def _prolonged(values: FloatArray, lead: int) -> FloatArray:
    """Return a signal with both ends prolonged by what an autoregression predicts (Burg)."""
    from scipy.signal import lfilter, lfiltic

    order = min(MOST_PREDICTORS, values.size // 3)
    a = _burg(values, order)
    ends = []
    for known in (values, values[::-1]):
        state = lfiltic([1.0], a, known[::-1][:order])
        ends.append(lfilter([1.0], a, np.zeros(lead), zi=state)[0])
    return np.concatenate([ends[1][::-1], values, ends[0]])


def _burg(values: FloatArray, order: int) -> FloatArray:
    """Return the prediction-error filter 1, a_1 … a_p that Burg's recursion finds; it is stable."""
    forward, backward = values[1:].copy(), values[:-1].copy()
    a = np.array([1.0])
    for _ in range(order):
        power = float(forward @ forward + backward @ backward)
        if power <= 1e-24 * float(values @ values):
            break
        k = -2.0 * float(forward @ backward) / power
        a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return a


def smooth_channel(values: FloatArray) -> FloatArray:
    """Return a slow channel with its noise taken off, as far as it has any.

    The noise is found from fourth differences; the window of the local cubics grows until what is
    left of it is small beside the channel's own changes from row to row.
    """
    from scipy.signal import savgol_filter

    # Var of the fourth difference of white noise is 70 times that of the noise.
    noise = 1.4826 * float(np.median(np.abs(np.diff(values, 4)))) / np.sqrt(70.0)
    spread = float(np.ptp(values))
    if spread == 0.0 or noise <= CLEAN_SHARE * spread:
        return values
    best = values
    for window in (7, 15, 31, 61, 101, LONGEST_WINDOW):
        if window > values.size // 4:
            break
        trial = savgol_filter(values, window, 3)
        # Once the window cuts into the signal itself, more than noise goes.
        if float(np.std(values - trial)) > MOST_REMOVED * noise:
            break
        best = trial
    return np.asarray(best)


def block_rows(data: LagData) -> int:
    """Return how many scored rows make a block: a surge cycle, and enough blocks."""
    longest = max(data.fine_runs, key=lambda run: run[1] - run[0])
    phi = data["phi"][longest[0] : longest[1] : data.every]
    surge_hz = surge_frequency_hz(phi, 1.0 / data.sample_period_s)
    share = float(np.mean(data.weight > 0.0))
    cycle = CYCLES_OF_BLOCK * share / (max(surge_hz, 1e-9) * data.sample_period_s)
    most = MOST_BLOCK_SHARE * float(np.count_nonzero(data.weight))
    return int(max(LEAST_BLOCK_ROWS, min(cycle, most)))
