"""Noise of measured states, and states smoothed as far as it asks for."""

from __future__ import annotations

import numpy as np

from sindy_surge.discover.trajectories import Trajectories
from surge_core.types import FloatArray


def difference_noise(data: Trajectories) -> FloatArray:
    """Return the noise that sixth differences show, which a sampled smooth signal hardly has."""
    squares = [np.diff(data.y[p], 6, axis=0) ** 2 for p in data.pieces()]
    return np.asarray(np.sqrt(np.concatenate(squares).mean(axis=0) / 924.0))


def smoothed(data: Trajectories) -> FloatArray:
    """Return the states, smoothed as far as their noise asks for.

    Cubics over a window whose residual is what the sixth differences show of the noise; the
    longest such window of 5 to 101 rows.
    """
    from scipy.signal import savgol_filter

    noise = difference_noise(data)
    result = data.y.copy()
    for j, each in enumerate(data.y.T):
        for window in (101, 71, 51, 35, 25, 17, 11, 7, 5):
            if window >= min(p.stop - p.start for p in data.pieces()):
                continue
            parts = [savgol_filter(each[p], window, 3) for p in data.pieces()]
            smooth = np.concatenate(parts)
            if np.std(each - smooth) <= 1.1 * noise[j]:
                break
        result[:, j] = smooth
    return result
