"""The cycles of smooth signals, and a plenum pressure that was not measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sindy_surge.discover.loop_balance import Balance, covariance_of_cycles
from sindy_surge.linear_problem import least_squares
from surge_core.errors import InputError
from surge_core.types import FloatArray

# The range of φ without spikes; a cycle counts once φ has been below the lower and above the
# upper edge of its middle third, which noise and ripple do not reach.
_RANGE = (0.01, 0.99)
_BAND = 1 / 3
# Regressions that follow one another as the throttle's flow settles: two leave 1e-5 of a.
_TIMES = 3
# ψ' and Ψ.
_DUCT = np.array([(0, 1, 0, 0, 0), (0, 0, 1, 0, 0)], dtype=np.int64)


@dataclass(frozen=True)
class Cycles:
    """What the surge cycles of a record or a simulation measure.

    Parameters
    ----------
    period_s : float
        Mean period in seconds.
    lowest, highest : tuple of float
        Extremes of each channel: the mean over the cycles.
    n_cycles : int
        Number of whole cycles.
    """

    period_s: float
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    n_cycles: int


def measure_cycles(states: FloatArray, sample_period_s: float) -> Cycles:
    """Measure the cycles that the first channel, φ, of smooth states (n_rows, n_channels) shows.

    A cycle runs from one rise of φ through the middle of its range to the next, with a hysteresis
    of a third of the range. Without a whole one there is none, and its measures are nan.
    """
    nothing = (np.nan,) * states.shape[1]
    if not np.all(np.isfinite(states)) or np.any(np.ptp(states, axis=0) == 0):
        return Cycles(np.nan, nothing, nothing, 0)
    rises = _rises(states[:, 0])
    if len(rises) < 2:
        return Cycles(np.nan, nothing, nothing, 0)
    cuts = [states[round(begin) : round(end) + 1] for begin, end in pairwise(rises)]
    lowest = np.mean([cut.min(axis=0) for cut in cuts], axis=0)
    highest = np.mean([cut.max(axis=0) for cut in cuts], axis=0)
    period_s = (rises[-1] - rises[0]) / len(cuts) * sample_period_s
    return Cycles(period_s, tuple(lowest.tolist()), tuple(highest.tolist()), len(cuts))


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
        row = below + int(crossed[crossed.size // 2])
        found.append(float(row + (middle - phi[row]) / (phi[row + 1] - phi[row])))
    return found


def hidden_plenum(
    measured: Sequence[FloatArray],
    smooth: Sequence[FloatArray],
    sample_period_s: float,
    period_samples: int,
) -> tuple[FloatArray, Balance]:
    """Estimate a plenum pressure that was not measured, in the unit of ψ', and the duct.

    dφ/dt = a (ψ' - Ψ) gives Ψ = ψ' - (dφ/dt)/a. Differentiated once more, with what a throttle lets
    through, d²φ/dt² = a dψ'/dt + terms in 1, φ and √Ψ: in the weak form the coefficient of dψ'/dt
    is a. The throttle's line is straight at first. φ and ψ' are given as measured, which the weak
    form averages without bias (smoothed ones left a 0.2 to 0.6 % low), and smoothed, for Ψ; refused
    where ψ' does not drive φ as a duct would have it.
    """
    phi, psi_p = measured
    half_width = max(period_samples // 12, 6)
    z = np.arange(-half_width, half_width + 1) / half_width
    step = half_width * sample_period_s
    weight = (1 - z**2) ** 4
    # By parts, a derivative of the signal becomes one of w; a convolution flips the odd one.
    slope = -8 * z * (1 - z**2) ** 3 / step
    bend = (48 * z**2 * (1 - z**2) ** 2 - 8 * (1 - z**2) ** 3) / step**2
    pairs = [(psi_p, slope), (phi, weight), (psi_p, weight), (phi, slope), (phi, bend)]
    *sides, goal = (np.convolve(signal, kernel, "valid") for signal, kernel in pairs)
    rate = np.gradient(smooth[0], sample_period_s)
    for _ in range(_TIMES):
        terms = np.column_stack((*sides, np.ones_like(goal)))
        found = least_squares(terms, goal)
        gain = float(found[0])
        plenum = smooth[1] - rate / gain
        root = np.copysign(np.sqrt(np.abs(plenum)), plenum)
        sides = [*sides[:2], np.convolve(root, weight, "valid")]
    if not gain > 0:
        raise InputError(
            "plenum",
            expected="φ to rise with ψ', as through a duct, when no plenum pressure is given",
            found=f"dφ/dt = {gain:.3g} (ψ' - Ψ)",
            remedy="give the plenum pressure, or check the sign and timing of φ and ψ'",
        )
    starts = range(0, goal.size, period_samples)
    cycles = [slice(start, start + period_samples) for start in starts]
    spread = covariance_of_cycles(-terms, goal - terms @ found, cycles)[0, 0]
    # By definition of Ψ: a regression would find in it what smoothing did to φ.
    both = np.array([1.0, -1.0])
    duct = Balance(gain * both, spread * np.outer(both, both), _DUCT)
    return np.asarray(plenum), duct
