"""Standard errors that hold when the residuals are coloured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sindy_surge.lag_fit import StructureFit
from sindy_surge.lag_problem import LagProblem
from surge_core.types import FloatArray

# Scores further apart than two time constants are taken for independent.
_LAG_IN_TAU = 2.0
_MOST_LAGS_SHARE = 0.05


def sandwich(problem: LagProblem, fit: StructureFit, known: FloatArray | None = None) -> FloatArray:
    """Return the covariance of the fit from the scatter of the scores, not of the residuals.

    H⁻¹ S H⁻¹ with H the information and S the Newey-West sum of the scores up to two time
    constants, each segment on its own. Where the residual is white S is that of the whitened
    equations up to scatter, and is then not taken below it; the inverse information alone is four
    times too small on coloured residuals. It holds for the terms as chosen: the uncertainty of the
    choice itself is not in it.

    H is ``known`` from `lag_fit.information`, in the order of the columns of `fit.sensitivity`, or
    that of the whitened equations. The covariance is that of the coefficients, of what stands
    between them and τ there but the bend (moved knots, the dead time), and last of τ; nan for
    parameters on which no equation depends.
    """
    columns, residual = fit.sensitivity, fit.residual
    n = residual.size
    norms = np.sqrt(np.sum(columns**2, axis=0) + fit.prior)
    keep = np.flatnonzero(norms > 1e-10 * norms.max())
    scaled = columns[:, keep] / norms[keep]
    # Information from the prior has no scatter of its own in this record.
    prior = np.diag(fit.prior[keep] / norms[keep] ** 2)
    white = scaled.T @ scaled + prior
    information = white
    if known is not None:
        information = known[np.ix_(keep, keep)] / np.outer(norms[keep], norms[keep])
    reach = int(_LAG_IN_TAU * fit.time_constant_s / problem.sample_period_s)
    reach = min(max(reach, 1), max(int(_MOST_LAGS_SHARE * n), 1))
    middle = _newey_west(scaled * residual[:, None], fit.groups.slices(), reach) + prior
    bread = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    inner = bread @ middle @ bread * n / max(n - keep.size, 1)
    # Where the residual is white the sandwich is the inverse information with some scatter; it
    # counts where it says more.
    plain = bread @ white @ bread * float(residual @ residual) / max(n - keep.size, 1)
    wider = np.sqrt(np.maximum(np.diag(inner) / np.maximum(np.diag(plain), 1e-300), 1.0))
    inner = plain * np.outer(wider, wider)
    full = np.full((norms.size, norms.size), np.nan)
    full[np.ix_(keep, keep)] = inner / np.outer(norms[keep], norms[keep])
    bend = len(fit.support) if problem.hold == "first" else norms.size
    wanted = [i for i in range(norms.size) if i != bend]
    return full[np.ix_(wanted, wanted)]


def _newey_west(scores: FloatArray, runs: Sequence[slice], reach: int) -> FloatArray:
    """Return Σ_l (1 - l/(reach + 1)) Σ_k s[k+l] s[k]' within each run (Newey & West 1987)."""
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        weight = 1 - lag / (reach + 1)
        for rows in runs:
            if rows.stop - rows.start > lag:
                later = scores[rows.start + lag : rows.stop]
                cross = later.T @ scores[rows.start : rows.stop - lag]
                middle += weight * (cross + cross.T)
    return middle
