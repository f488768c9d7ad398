"""Standard errors that hold when the residuals are coloured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sindy_surge.lag_fit import StructureFit
from sindy_surge.lag_problem import LagProblem

__all__ = ["sandwich"]

FloatArray = NDArray[np.float64]

# Scores further apart than two time constants are taken for independent.
_LAG_IN_TAU = 2.0
_MOST_LAGS_SHARE = 0.05


def sandwich(problem: LagProblem, fit: StructureFit) -> FloatArray:
    """Return the covariance of (β, τ) from the scatter of the scores, not of the residuals.

    H⁻¹ S H⁻¹ with H the information of the whitened equations and S the Newey-West sum of the
    scores up to two time constants (Bartlett weights; Newey & West 1987), each segment on its
    own. If the residual is white it equals H⁻¹ up to scatter; the inverse information alone
    is four times too small on coloured residuals. It holds for the terms as chosen: the
    uncertainty of the choice itself is not in it.

    Parameters
    ----------
    problem : LagProblem
        Supplies the sample period.
    fit : StructureFit
        The fit.

    Returns
    -------
    ndarray of shape (n_support + 1, n_support + 1)
        Covariance of the coefficients in physical units, and of τ in the last row and column.
    """
    columns, residual = fit.sensitivity, fit.residual
    n = residual.size
    norms = np.sqrt(np.sum(columns**2, axis=0) + fit.prior)
    seen = norms > 1e-10 * norms.max()
    keep = np.flatnonzero(seen)
    scaled = columns[:, keep] / norms[keep]
    information = scaled.T @ scaled + np.diag(fit.prior[keep] / norms[keep] ** 2)
    scores = scaled * residual[:, None]
    reach = int(_LAG_IN_TAU * fit.time_constant_s / problem.sample_period_s)
    reach = min(max(reach, 1), max(int(_MOST_LAGS_SHARE * n), 1))
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        weight = 1 - lag / (reach + 1)
        for rows in fit.groups.slices():
            if rows.stop - rows.start > lag:
                cross = (
                    scores[rows.start + lag : rows.stop].T @ scores[rows.start : rows.stop - lag]
                )
                middle += weight * (cross + cross.T)
    # Information from the prior has no scatter of its own in this record.
    middle += np.diag(fit.prior[keep] / norms[keep] ** 2)
    bread = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    inner = bread @ middle @ bread * n / max(n - keep.size, 1)
    full = np.full((norms.size, norms.size), np.nan)
    full[np.ix_(keep, keep)] = inner / np.outer(norms[keep], norms[keep])
    size = len(fit.support)
    wanted = [*range(size), norms.size - 1]
    return full[np.ix_(wanted, wanted)]
