"""The record of the closed loop: checked, its cycles measured, a missing plenum estimated."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.linear_problem import least_squares
from surge_core.errors import InputError
from surge_core.types import FloatArray
from surge_core.validation import positive

__all__ = ["Cycles", "half_width_samples", "hidden_plenum", "measure_cycles", "read_record"]


_FEWEST_CYCLES = 4
# A period of fewer samples leaves too few to a jump from one branch to the other.
_FEWEST_SAMPLES = 30
# The range of φ without spikes; a cycle counts once φ has been below the lower and above the
# upper edge of its middle third, which noise and ripple do not reach.
_RANGE = (0.01, 0.99)
_BAND = 1 / 3
_PHASES = 256
# Half widths are at most an eighth of a period, well below the quarter beyond which the weak form
# loses what it is to find.
_MOST_SHARE = 8
_LEAST_HALF_WIDTH = 4


@dataclass(frozen=True)
class Cycles:
    """What the surge cycles of a record or a simulation measure.

    Parameters
    ----------
    period_s : float
        Mean period in seconds.
    amplitude : tuple of float
        Half the peak-to-peak value of each channel's mean cycle.
    n_cycles : int
        Number of whole cycles.
    """

    period_s: float
    amplitude: tuple[float, ...]
    n_cycles: int


def measure_cycles(states: FloatArray, sample_period_s: float) -> Cycles:
    """Measure the cycles that the first channel shows.

    A cycle runs from one rise of φ through the middle of its range to the next, with
    a hysteresis of a third of the range. The amplitude is that of the mean cycle, averaged at
    equal phase: a peak-to-peak value of single noisy cycles is too large by several times the
    noise.

    Parameters
    ----------
    states : ndarray of shape (n_rows, n_channels)
        φ first.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    Cycles
        No cycle, and nan for its measures, without one whole.
    """
    rises = _rises(states[:, 0])
    if len(rises) < 2:
        return Cycles(np.nan, (np.nan,) * states.shape[1], 0)
    rows = np.arange(len(states))
    phase = np.arange(_PHASES) / _PHASES
    at = np.array([begin + phase * (end - begin) for begin, end in pairwise(rises)])
    mean_cycle = [np.interp(at, rows, channel).mean(axis=0) for channel in states.T]
    period_s = (rises[-1] - rises[0]) / (len(rises) - 1) * sample_period_s
    amplitude = tuple(float(np.ptp(cycle)) / 2 for cycle in mean_cycle)
    return Cycles(period_s, amplitude, len(rises) - 1)


def _rises(phi: FloatArray) -> list[float]:
    """Return where φ rises through the middle of its range, in samples and parts of them."""
    low, high = np.quantile(phi, _RANGE)
    middle, half = (low + high) / 2, (high - low) * _BAND / 2
    # Between the edges the last edge left behind counts.
    side = np.where(phi > middle + half, 1, np.where(phi < middle - half, -1, 0))
    known = np.flatnonzero(side)
    up = np.flatnonzero((side[known][:-1] < 0) & (side[known][1:] > 0))
    found = []
    for below, above in zip(known[up], known[up + 1], strict=True):
        crossed = np.flatnonzero(
            (phi[below:above] <= middle) & (phi[below + 1 : above + 1] > middle)
        )
        # Noise may cross several times within the band; the middle one is the least biased.
        row = below + int(crossed[crossed.size // 2])
        found.append(float(row + (middle - phi[row]) / (phi[row + 1] - phi[row])))
    return found


def read_record(
    phi: ArrayLike, psi_p: ArrayLike, plenum: ArrayLike | None, sample_period_s: float
) -> tuple[FloatArray, Cycles]:
    """Check the channels, put them side by side and measure their cycles.

    Parameters
    ----------
    phi, psi_p : array-like of shape (n_rows,)
        Flow coefficient and compressor pressure coefficient.
    plenum : array-like of shape (n_rows,) or None
        Plenum pressure.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    record : ndarray of shape (n_rows, 2 or 3)
        The channels.
    cycles : Cycles
        Their surge cycles.

    Raises
    ------
    InputError
        If a channel cannot be used, there are too few cycles, or too few samples in one.
    """
    positive("sample_period_s", sample_period_s)
    channels = [np.asarray(x, dtype=np.float64) for x in (phi, psi_p, plenum) if x is not None]
    alike = all(x.shape == (channels[0].size,) for x in channels)
    if not alike or not all(0 < np.ptp(x) < np.inf for x in channels):
        shapes = (f"{x.shape} values from {x.min():.3g} to {x.max():.3g}" for x in channels)
        raise InputError(
            "phi, psi_p, plenum",
            expected="one finite value of each for every sample, that changes with the cycles",
            found="; ".join(shapes),
            remedy="cut the channels to the same rows; a gap cannot be simulated across",
        )
    record = np.column_stack(channels)
    cycles = measure_cycles(record, float(sample_period_s))
    enough = cycles.n_cycles >= _FEWEST_CYCLES
    if not (enough and cycles.period_s >= _FEWEST_SAMPLES * sample_period_s):
        raise InputError(
            "phi",
            expected=f"at least {_FEWEST_CYCLES} whole surge cycles of at least {_FEWEST_SAMPLES} "
            "samples",
            found=f"{cycles.n_cycles} in {len(record)} samples, of {cycles.period_s:.3g} s",
            remedy="use a longer record, or sample faster",
        )
    return record, cycles


def half_width_samples(phi: FloatArray, period_samples: float) -> int:
    """Return the half width of the test functions: the time of half a jump of φ.

    The least lag at which φ changes by half its range, and at most an eighth of a period: about
    that for mild surge, much less for deep surge, which jumps between its branches.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,)
        Flow coefficient.
    period_samples : float
        Period of the surge cycles in samples.
    """
    most = max(round(period_samples / _MOST_SHARE), _LEAST_HALF_WIDTH)
    half = np.ptp(phi) / 2
    for lag in range(_LEAST_HALF_WIDTH, most):
        if np.max(np.abs(phi[lag:] - phi[:-lag])) >= half:
            return lag
    return most


def hidden_plenum(
    record: FloatArray, sample_period_s: float, half_width: int
) -> tuple[FloatArray, float]:
    """Estimate a plenum pressure that was not measured, from the duct.

    dφ/dt = a (ψ' - Ψ) gives Ψ = ψ' - (dφ/dt)/a. Differentiated once more and with the throttle
    drawn as a straight line, d²φ/dt² = a dψ'/dt + terms in 1, φ, ψ' and dφ/dt: in the weak form
    the coefficient of dψ'/dt is a.

    Parameters
    ----------
    record : ndarray of shape (n_rows, 2)
        φ and ψ'.
    sample_period_s : float
        Sample period in seconds.
    half_width : int
        Half width of the test functions in samples.

    Returns
    -------
    plenum : ndarray of shape (n_rows,)
        Ψ in the unit of ψ', smoothed.
    gain_per_s : float
        a.

    Raises
    ------
    InputError
        If ψ' does not drive φ as a duct would have it.
    """
    from scipy.signal import savgol_filter

    # φ is differentiated twice, which takes wider test functions.
    gain = _duct_gain(record, sample_period_s, 2 * half_width)
    if not gain > 0:
        raise InputError(
            "plenum",
            expected="φ to rise with ψ', as through a duct, when no plenum pressure is given",
            found=f"dφ/dt = {gain:.3g} (ψ' - Ψ)",
            remedy="give the plenum pressure, or check the sign and timing of φ and ψ'",
        )
    width = 2 * max(round(2 / 3 * half_width), 2) + 1
    slope = savgol_filter(record[:, 0], width, 3, deriv=1, delta=sample_period_s)
    level = savgol_filter(record[:, 1], width, 3)
    return level - slope / gain, gain


def _duct_gain(record: FloatArray, sample_period_s: float, half_width: int) -> float:
    z = np.arange(-half_width, half_width + 1) / half_width
    step = half_width * sample_period_s
    weight = (1 - z**2) ** 4
    # By parts, a derivative of the signal becomes one of w; a convolution flips the odd one.
    slope = -8 * z * (1 - z**2) ** 3 / step
    bend = (48 * z**2 * (1 - z**2) ** 2 - 8 * (1 - z**2) ** 3) / step**2
    phi, psi_p = record[:, 0], record[:, 1]
    pairs = [(psi_p, slope), (phi, weight), (psi_p, weight), (phi, slope), (phi, bend)]
    *sides, goal = (np.convolve(signal, kernel, "valid") for signal, kernel in pairs)
    return float(least_squares(np.column_stack((*sides, np.ones_like(goal))), goal)[0])
