"""Standard errors that hold when the residuals are coloured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sindy_surge.lag_fit import StructureFit
from sindy_surge.lag_problem import LagProblem
from surge_core.types import FloatArray, IndexArray

__all__ = ["jackknife_covariance", "leave_out_moves", "sandwich"]


# Scores further apart than two time constants are taken for independent.
_LAG_IN_TAU = 2.0
_MOST_LAGS_SHARE = 0.05


def sandwich(problem: LagProblem, fit: StructureFit, known: FloatArray | None = None) -> FloatArray:
    """Return the covariance of the fit from the scatter of the scores, not of the residuals.

    H⁻¹ S H⁻¹ with H the information, `known` or that of the whitened equations, and S the
    Newey-West sum of the scores up to two time constants (Bartlett weights; Newey & West 1987),
    each segment on its own. Where the residual is white S is that of the whitened equations up
    to scatter, and is then not taken below it; the inverse information alone is four times too
    small on coloured residuals. It holds for the terms as chosen: the uncertainty of the choice
    itself is not in it.

    Parameters
    ----------
    problem : LagProblem
        Supplies the sample period.
    fit : StructureFit
        The fit.
    known : ndarray of shape (n_sensitivities, n_sensitivities) or None
        Information H in the order of the columns of `fit.sensitivity`, e.g. from
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
    seen = norms > 1e-10 * norms.max()
    keep = np.flatnonzero(seen)
    scaled = columns[:, keep] / norms[keep]
    white = scaled.T @ scaled + np.diag(fit.prior[keep] / norms[keep] ** 2)
    information = white
    if known is not None:
        information = known[np.ix_(keep, keep)] / np.outer(norms[keep], norms[keep])
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


def leave_out_moves(
    columns: FloatArray, residual: FloatArray, blocks: Sequence[IndexArray]
) -> FloatArray:
    """Return how the parameters of a least-squares fit move when one block is left out.

    -B (I - A_g B)⁻¹ J_g'e_g with B = (J'J)⁻¹ and A_g = J_g'J_g: exact for a linear
    regression, to first order otherwise.

    Parameters
    ----------
    columns : ndarray of shape (n_rows, n_parameters)
        Derivatives J of the fitted values.
    residual : ndarray of shape (n_rows,)
        What the fit leaves, e.
    blocks : sequence of ndarray of int
        Rows of each block.

    Returns
    -------
    ndarray of shape (n_blocks, n_parameters)
        The moves.
    """
    norms = np.linalg.norm(columns, axis=0)
    norms[norms == 0] = 1.0
    scaled = columns / norms
    bread = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    identity = np.eye(norms.size)
    moves = np.empty((len(blocks), norms.size))
    for number, rows in enumerate(blocks):
        part = scaled[rows]
        # lstsq, not solve: a block that alone determines a parameter makes this singular.
        system = identity - part.T @ part @ bread
        moves[number] = -bread @ np.linalg.lstsq(system, part.T @ residual[rows])[0]
    moves /= norms
    return moves


def jackknife_covariance(moves: FloatArray) -> FloatArray:
    """Return the covariance (G - 1)/G Σ (Δ_g - mean Δ)(Δ_g - mean Δ)' of leave-one-out moves.

    It allows for colour within a block, for errors that grow with the signal, and for blocks
    that carry much of the information (CR3 of Bell & McCaffrey 2002); on a dozen segments a
    Newey-West sum over strongly coloured errors is far too small.

    Parameters
    ----------
    moves : ndarray of shape (n_blocks, n_parameters)
        From `leave_out_moves`.

    Returns
    -------
    ndarray of shape (n_parameters, n_parameters)
        Covariance of the parameters.
    """
    spread = moves - moves.mean(axis=0)
    result: FloatArray = (len(moves) - 1) / len(moves) * spread.T @ spread
    return result
