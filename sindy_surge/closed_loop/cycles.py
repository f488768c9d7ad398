"""Period and amplitude of surge cycles, measured alike on a record and on a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surge_core.types import FloatArray

__all__ = ["Cycles", "measure_cycles"]


# The range of φ without spikes; a cycle counts once φ has been below the lower and above the
# upper edge of its middle third, which noise and ripple do not reach.
_RANGE = (0.01, 0.99)
_BAND = 1 / 3
_PHASES = 256


@dataclass(frozen=True)
class Cycles:
    """What the surge cycles of a record or a simulation measure.

    Parameters
    ----------
    period_s : float
        Mean period in seconds.
    period_scatter_s : float
        Standard deviation of the single periods in seconds; 0 for a single cycle.
    amplitude : tuple of float
        Half the peak-to-peak value of each channel's mean cycle.
    n_cycles : int
        Number of whole cycles.
    first_row, last_row : float
        Where the first begins and the last ends, in samples.
    """

    period_s: float
    period_scatter_s: float
    amplitude: tuple[float, ...]
    n_cycles: int
    first_row: float
    last_row: float


def measure_cycles(states: FloatArray, sample_period_s: float) -> Cycles | None:
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
    Cycles or None
        None without one whole cycle.
    """
    rises = _rises(states[:, 0])
    if rises.size < 2:
        return None
    rows = np.arange(len(states))
    phase = np.arange(_PHASES) / _PHASES
    mean = np.zeros((_PHASES, states.shape[1]))
    for begin, end in pairwise(rises):
        at = begin + phase * (end - begin)
        mean += np.column_stack([np.interp(at, rows, channel) for channel in states.T])
    mean /= rises.size - 1
    periods = np.diff(rises) * sample_period_s
    return Cycles(
        float(periods.mean()),
        float(periods.std(ddof=1)) if periods.size > 1 else 0.0,
        tuple((np.ptp(mean, axis=0) / 2).tolist()),
        int(periods.size),
        float(rises[0]),
        float(rises[-1]),
    )


def _rises(phi: FloatArray) -> FloatArray:
    """Return where φ rises through the middle of its range, in samples and parts of them."""
    low, high = np.quantile(phi, _RANGE)
    middle, half = (low + high) / 2, (high - low) * _BAND / 2
    if not half > 0:
        return np.empty(0)
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
        found.append(row + (middle - phi[row]) / (phi[row + 1] - phi[row]))
    return np.array(found)
