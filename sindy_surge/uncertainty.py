"""Standard errors that hold when the residuals are coloured, and errors on what is left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sindy_surge.lag_equations import free_run
from sindy_surge.lag_fit import StructureFit, moved_point
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import leave_out_moves
from surge_core.types import FloatArray

__all__ = ["held_out_rms", "sandwich"]


# Scores further apart than two time constants are taken for independent.
_LAG_IN_TAU = 2.0
_MOST_LAGS_SHARE = 0.05
_FOLDS = 5


def sandwich(problem: LagProblem, fit: StructureFit, known: FloatArray | None = None) -> FloatArray:
    """Return the covariance of the fit from the scatter of the scores, not of the residuals.

    H⁻¹ S H⁻¹ with H the information and S the Newey-West sum of the scores up to two time
    constants, each segment on its own. Where the residual is white S is that of the whitened
    equations up to scatter, and is then not taken below it; the inverse information alone is four
    times too small on coloured residuals. It holds for the terms as chosen: the uncertainty of
    the choice itself is not in it.

    Parameters
    ----------
    known : ndarray of shape (n_sensitivities, n_sensitivities) or None
        Information H in the order of the columns of `fit.sensitivity`, from
        `lag_fit.information`; None takes that of the whitened equations.

    Returns
    -------
    ndarray of shape (n_parameters, n_parameters)
        Covariance of the coefficients, of what stands between them and τ in `fit.sensitivity` but
        the bend (moved knots, the dead time), and of τ in the last row and column; nan for
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


def held_out_rms(problem: LagProblem, fit: StructureFit, blocks: Sequence[slice]) -> float:
    """Return the rms error of the free run over blocks, each by a fit that has not seen it.

    Block i is in fold i mod 5. The parameters without a fold follow from the whitened
    sensitivities by one step (exact for a linear regression), with the prior kept and τ within
    its bounds. Each block then runs freely from measured φ; of its ψ' only the initial state
    is taken, by least squares. The noise of φ passes through the characteristic and the lag and
    is in the error of every structure.

    Parameters
    ----------
    blocks : sequence of slice
        Rows of the record, none across two segments, from `segments.cycle_blocks`; fewer than two
        give nan.
    """
    usable = problem.usable
    edges = [np.searchsorted(usable.rows, (block.start, block.stop)) for block in blocks]
    held = [np.arange(low, high) for low, high in edges]
    freedom = sum(max(rows.size - 1, 0) for rows in held)
    if len(blocks) < 2 or not freedom:
        return float("nan")
    n_folds = min(_FOLDS, len(blocks))
    fold_of_row = np.full(problem.output.size, -1)
    for number, block in enumerate(blocks):
        fold_of_row[block] = number % n_folds
    home = fold_of_row[fit.rows]
    # The prior is information that no fold takes away.
    columns = np.vstack((fit.sensitivity, np.diag(np.sqrt(fit.prior))))
    errors = np.concatenate((fit.residual, np.sqrt(fit.prior) * fit.prior_pull))
    folds = [np.flatnonzero(home == k) for k in range(n_folds)]
    moves = leave_out_moves(columns, errors, folds)
    # At the measured inputs: a prediction has no others.
    silent = np.zeros_like(problem.inputs)
    total = 0.0
    for fold, move in enumerate(moves):
        point = moved_point(problem, fit.point, move)
        there = replace(point, input_noise=silent, blur=np.zeros(silent.shape[1]))
        rest = problem.output[usable.rows] - free_run(problem, fit.support, there)
        pole = problem.lag(point.time_constant_s).a
        for rows in held[fold::n_folds]:
            if rows.size > 1:
                decay = pole ** np.arange(rows.size, dtype=np.float64)
                own = rest[rows]
                own = own - decay * float(decay @ own) / float(decay @ decay)
                total += float(own @ own)
    return float(np.sqrt(total / freedom))
