"""How well a reconstruction matches, and the range in which a curve holds."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import KDTree

from comparisons.results import FitScore
from surge_core.types import BoolArray, FloatArray

# The paper calls the curve reliable where φ has "high significant amplitude density" (Fig 24) and
# gives no level; the true in-stall φ of the simulated rig lies between these percentiles much as
# the paper's range does. On filtered data the low end holds the filter's overshoot too.
TRUSTED_PERCENTILES = (5.0, 95.0)
NEARBY_SHARE = 0.02


def rms(values: FloatArray) -> float:
    """Return the root mean square of values, of shape (n,)."""
    return float(np.sqrt(np.mean(values**2)))


def score_fit(
    measured: FloatArray, predicted: FloatArray, scored: BoolArray | None = None
) -> FitScore:
    """Score a prediction on the rows that count.

    Parameters
    ----------
    measured, predicted : ndarray of shape (n,)
        The two signals.
    scored : ndarray of bool, shape (n,), optional
        Rows that count; all without it.
    """
    keep = np.ones(measured.size, dtype=np.bool_) if scored is None else scored
    if not keep.any():
        return FitScore(math.nan, math.nan, math.nan, 0)
    error = (measured - predicted)[keep]
    spread = measured[keep] - np.mean(measured[keep])
    power = float(spread @ spread)
    ratio = float(error @ error) / power if power > 0.0 else math.inf
    return FitScore(rms(error), 100.0 * (1.0 - math.sqrt(ratio)), 1.0 - ratio, int(error.size))


def trusted_range(phi: FloatArray) -> tuple[float, float]:
    """Return the range in which φ dwells: beyond it a curve fitted to these rows is a guess.

    Parameters
    ----------
    phi : ndarray of shape (n,)
        Flow coefficient of the fitted rows.
    """
    low, high = np.percentile(phi, TRUSTED_PERCENTILES)
    return float(low), float(high)


def dwelt_on(grid: FloatArray, phi: FloatArray) -> BoolArray:
    """Return where on a grid there are rows nearby, within 2 % of the range of their φ."""
    nearest, _ = KDTree(phi[:, None]).query(grid[:, None])
    return np.asarray(nearest <= NEARBY_SHARE * float(np.ptp(phi)))
