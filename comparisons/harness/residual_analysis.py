"""Numbers behind the pictures: where φ dwells, where stall begins."""

from __future__ import annotations

import numpy as np

from surge_core.types import BoolArray, FloatArray

__all__ = ["dwelt_on", "stall_inception"]

# From the stall point to reversed flow a high-speed compressor takes some tens of milliseconds.
INCEPTION_S = 0.25
NEARBY_SHARE = 0.02


def dwelt_on(grid: FloatArray, phi: FloatArray) -> BoolArray:
    """Return where on a grid there are rows nearby, within 2 % of the range of φ.

    Parameters
    ----------
    grid : ndarray of shape (n,)
        Points at which a characteristic is drawn.
    phi : ndarray of shape (m,)
        Flow coefficient of the fitted rows.
    """
    known = np.sort(phi)
    after = np.clip(np.searchsorted(known, grid), 1, known.size - 1)
    nearest = np.minimum(np.abs(grid - known[after - 1]), np.abs(grid - known[after]))
    return np.asarray(nearest <= NEARBY_SHARE * float(np.ptp(phi)))


def stall_inception(
    pressure_ratio: FloatArray, in_stall: BoolArray, sample_rate_hz: float
) -> int | None:
    """Return the row from which the machine fell into its first stall.

    Parameters
    ----------
    pressure_ratio : ndarray of shape (n,)
        P31 over P25.
    in_stall : ndarray of bool, shape (n,)
        True while the machine is in stall.
    sample_rate_hz : float
        Samples a second.

    Returns
    -------
    int or None
        The row of the highest pressure ratio in the quarter second before the first row in
        stall; None where there is no such row or the record begins in stall.
    """
    if not in_stall.any() or in_stall[0]:
        return None
    first = int(np.argmax(in_stall))
    start = max(0, first - int(INCEPTION_S * sample_rate_hz))
    return start + int(np.argmax(pressure_ratio[start : first + 1]))
