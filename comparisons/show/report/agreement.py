"""How far the curves of a comparison agree where φ dwells, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from comparisons.harness.residual_analysis import dwelt_on
from comparisons.results import Comparison
from surge_core.rounding import significant

__all__ = ["CurveGap", "dwelling", "dwelling_words", "widest_gap"]

BAND = 2.0
GRID_POINTS = 241


@dataclass(frozen=True)
class CurveGap:
    """Where two estimators' curves lie furthest apart.

    Parameters
    ----------
    phi : float
        Flow coefficient at which they do.
    labels : tuple of str
        What people call the two estimators.
    apart : float
        Distance of the curves.
    bands : tuple of float
        Two standard errors of each curve there; NaN where it has none.
    parted : bool
        Whether the bands leave a gap, at this φ.
    """

    phi: float
    labels: tuple[str, str]
    apart: float
    bands: tuple[float, float]
    parted: bool


def dwelling(fit: Comparison) -> str:
    """Return the words for the range of φ that holds nine rows in ten.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    low, high = fit.valid_phi
    return f"φ dwells between {low:.3f} and {high:.3f} (5th to 95th percentile)"


def widest_gap(fit: Comparison) -> CurveGap | None:
    """Return where two curves lie furthest apart where φ dwells, parted bands first.

    Two curves part where the bands of two standard errors around them do not touch. A curve
    without a standard error has no band that could excuse it.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.

    Returns
    -------
    CurveGap or None
        The widest gap of two curves that part; where none do, the two that lie furthest apart;
        None with fewer than two curves.
    """
    grid = np.linspace(*fit.valid_phi, GRID_POINTS)
    grid = grid[dwelt_on(grid, fit.rows.phi)]
    curves = {}
    for result in fit.results:
        phi, value, stderr = np.asarray(result.model.table).T
        curves[result.label] = (
            np.interp(grid, phi, value),
            BAND * np.interp(grid, phi, stderr),
        )
    gaps = []
    for first, second in combinations(curves, 2):
        (a, band_a), (b, band_b) = curves[first], curves[second]
        apart = np.where(np.isfinite(a - b), np.abs(a - b), 0.0)
        parted = apart > np.nan_to_num(band_a) + np.nan_to_num(band_b)
        at = int(np.argmax(np.where(parted, apart, 0.0) if parted.any() else apart))
        gaps.append(
            CurveGap(
                float(grid[at]),
                (first, second),
                float(apart[at]),
                (float(band_a[at]), float(band_b[at])),
                bool(parted[at]),
            )
        )
    return max(gaps, key=lambda gap: (gap.parted, gap.apart), default=None)


def dwelling_words(fit: Comparison) -> str:
    """Say what the curves are worth where φ dwells, and beyond.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    gap = widest_gap(fit)
    passed = all(check.passed for result in fit.results for check in result.checks)
    general = (
        "Outside it the curves are extrapolated; inside it a curve is as good as its checks and "
        "as the agreement of the estimators."
    )
    if gap is None:
        return f"{general} There is but one curve, so that nothing is known of any agreement."
    if gap.parted:
        bands = " and ".join(f"± {significant(band, 2)}" for band in gap.bands)
        return (
            f"{general} Inside it the curves of the estimators differ by up to "
            f"{significant(gap.apart, 2)} ({gap.labels[0]} against {gap.labels[1]} at φ = "
            f"{gap.phi:.3f}, where their bands of two standard errors are {bands}): not all of "
            "them can be right."
        )
    agree = (
        f"{general} Inside it the curves agree within their bands of two standard errors; the "
        f"largest difference is {significant(gap.apart, 2)}"
    )
    if passed:
        return f"{agree}. As all residual checks passed too, they can be trusted there."
    return f"{agree}. Residual checks failed, so that all of them may still be off alike."
