"""The frequency of the rotating-stall ripple, as the spectrum of ψ' shows it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.spectra import peak_frequency_hz
from surge_core.errors import InputError
from surge_core.segments import runs_of
from surge_core.types import FloatArray

__all__ = ["ripple_frequency_hz"]

# Surge is below 20 Hz; cells turn at some half of the rotor's speed, never below twice that.
LOWEST_HZ = 40.0
HIGHEST_SHARE = 0.4
# Zero padding, so that short segments share one fine grid.
PADDING = 4
# What is compared with a line is the spectrum this far to both sides of it.
AROUND_HZ = 20.0
FALSE_ALARM = 0.01


def ripple_frequency_hz(
    y: ArrayLike,
    segments: ArrayLike | None = None,
    *,
    sample_period_s: float,
    lowest_hz: float = LOWEST_HZ,
) -> float | None:
    """Return the frequency of the strongest line above surge in the spectrum of ψ'.

    The phase of the cells is another one in every segment, so that powers are summed, not
    amplitudes. Pass it to ``LagRegressor(ripple_hz=…)``.

    Parameters
    ----------
    y : array-like of shape (n,)
        ψ' as measured, not low-passed below the cells.
    segments : array-like of int, shape (n,), optional
        Labels, as in the fit.
    sample_period_s : float
        Sample period, in seconds.
    lowest_hz : float
        Where to begin, above surge and its harmonics.

    Returns
    -------
    float or None
        In hertz; None where no line stands out.

    Raises
    ------
    InputError
        When no segment is long enough to show such a frequency.
    """
    values = np.asarray(y, dtype=np.float64)
    runs = runs_of(segments, values.size)
    rate_hz = 1.0 / sample_period_s
    shortest = int(4.0 * rate_hz / lowest_hz)
    long_enough = [run for run in runs if run.stop - run.start >= shortest]
    if not long_enough or lowest_hz >= HIGHEST_SHARE * rate_hz:
        raise InputError(
            "segments",
            expected=f"one of at least {shortest} rows, and more than "
            f"{lowest_hz / HIGHEST_SHARE:.0f} rows a second",
            found=f"at most {max(run.stop - run.start for run in runs)} rows at {rate_hz:g} Hz",
        )
    n_fft = PADDING * max(run.stop - run.start for run in long_enough)
    power: FloatArray = np.zeros(n_fft // 2 + 1)
    for run in long_enough:
        window = np.hanning(run.stop - run.start)
        # A cycle is not a ripple: its curvature would leak across the whole band.
        curved = np.polynomial.Polynomial.fit(*_scaled(values[run]), deg=3)
        rest = values[run] - curved(_scaled(values[run])[0])
        power += np.abs(np.fft.rfft(window * rest, n_fft)) ** 2
    frequency = np.asarray(np.fft.rfftfreq(n_fft, sample_period_s), dtype=np.float64)
    band = (frequency >= lowest_hz) & (frequency <= HIGHEST_SHARE * rate_hz)
    line_hz = peak_frequency_hz(frequency, power, lowest_hz, HIGHEST_SHARE * rate_hz)
    around = band & (np.abs(frequency - line_hz) < AROUND_HZ)
    needed = _needed_prominence(len(long_enough), int(np.count_nonzero(band)) // PADDING)
    return line_hz if power[band].max() > needed * float(np.median(power[around])) else None


def _needed_prominence(n_segments: int, n_bins: int) -> float:
    """Return how far above the median the highest of so many bins of noise may stand by chance.

    The power of noise in a bin, summed over segments, is a gamma variable.
    """
    from scipy.stats import gamma

    return float(gamma.isf(FALSE_ALARM / n_bins, n_segments) / gamma.median(n_segments))


def _scaled(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.linspace(-1.0, 1.0, values.size), values
