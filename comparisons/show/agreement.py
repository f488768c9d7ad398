"""How far the curves of a comparison agree where φ dwells, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from comparisons.harness.fit_quality import dwelt_on
from comparisons.results import Comparison
from surge_core.rounding import significant

__all__ = ["CurveGap", "dwelling_words", "widest_gap"]

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
        band = BAND * np.interp(grid, phi, stderr)
        curves[result.label] = (np.interp(grid, phi, value), band)
    gaps = []
    for labels in combinations(curves, 2):
        (a, band_a), (b, band_b) = (curves[label] for label in labels)
        apart = np.where(np.isfinite(a - b), np.abs(a - b), 0.0)
        parted = apart > np.nan_to_num(band_a) + np.nan_to_num(band_b)
        at = int(np.argmax(np.where(parted, apart, 0.0) if parted.any() else apart))
        bands = float(band_a[at]), float(band_b[at])
        gaps.append(CurveGap(float(grid[at]), labels, float(apart[at]), bands, bool(parted[at])))
    return max(gaps, key=lambda gap: (gap.parted, gap.apart), default=None)


def dwelling_words(fit: Comparison) -> str:
    """Say what the curves are worth where φ dwells, and beyond.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    gap = widest_gap(fit)
    general = (
        "Outside it the curves are extrapolated; inside it a curve is as good as its checks and "
        "as the agreement of the estimators."
    )
    if gap is None:
        return f"{general} There is but one curve, so that nothing is known of any agreement."
    apart = significant(gap.apart, 2)
    if gap.parted:
        bands = " and ".join(f"± {significant(band, 2)}" for band in gap.bands)
        return (
            f"{general} Inside it the curves of the estimators differ by up to {apart} "
            f"({gap.labels[0]} against {gap.labels[1]} at φ = {gap.phi:.3f}, where their bands of "
            f"two standard errors are {bands}): not all of them can be right."
        )
    passed = all(check.passed for result in fit.results for check in result.checks)
    return (
        f"{general} Inside it the curves agree within their bands of two standard errors; the "
        f"largest difference is {apart}. "
        + (
            "As all residual checks passed too, they can be trusted there."
            if passed
            else "Residual checks failed, so that all of them may still be off alike."
        )
    )
