"""Sparse regression on free runs: the terms chosen by cycles left out, τ and β with their errors.

For columns that are ready-made, e.g. averaged after the terms were formed, and runs that are
scored only where the model holds. What such runs leave is coloured by the average and has an
error of the model in it, so that no likelihood tells the terms: cycles left out do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.free_run_equations import FreeRunEquations, FreeRunFit
from sindy_surge.held_out import HeldOutFit, with_held_out
from sindy_surge.leave_out import leave_out_moves
from sindy_surge.linear_problem import Support, least_squares
from sindy_surge.selection import PathRow
from sindy_surge.sparse_paths import proposals
from sindy_surge.trials import (
    Block,
    Trials,
    best_of_each_size,
    climb,
    pays,
    polynomial_ladder,
    special_structures,
)
from surge_core.fit_state import FitState
from surge_core.leave_out import scatter
from surge_core.types import FloatArray, IndexArray

__all__ = ["SparseRun", "select_on_free_run"]


# On 169 records of the simulated rig, whose truth is a parabola, the best of some 18 structures off
# the ladder left 0.77 to 0.99 of the ladder's held-out error: by luck, and by learning what comes
# again in every cycle. With a kink in the true curve 7 of 22 left less than 0.7; the others could
# not be separated from a polynomial.
_SHARE_LEFT = 0.7
# A cycle that alone reaches part of the range of φ cannot be foretold by the others: its error
# would decide the mean of twenty.
_MOST_LEVERAGE = 0.5
# The ladder is entered at the parabola: a straight line does not turn, as a characteristic in stall
# does, and where noise hid the difference it moved τ by up to 6 ms.
_START = 1
# The first terms of a library are its simplest: enough to find the basin of τ.
_SIMPLEST = 3
# Scored rows for each parameter; below it nothing is fitted.
_ROWS_A_PARAMETER = 2


@dataclass(frozen=True)
class SparseRun:
    """Terms, τ and β found on free runs.

    Parameters
    ----------
    support : tuple of int
        Columns of the terms that were chosen.
    terms : tuple of str
        Their names.
    time_constant_s : float
        τ in seconds; NaN where too few rows are scored.
    coefficients : ndarray of shape (n_terms,)
        β in physical units.
    covariance : ndarray of shape (n_terms + 1, n_terms + 1)
        Of β and, last, τ: a jackknife over cycles, what all cycles share and, off the ladder,
        what structures differ by that the data cannot separate from the chosen one.
    initial : ndarray of shape (n_runs,)
        State at the first row of each run.
    residual_rms : float
        Rms of what is left on the scored rows.
    n_blocks : int
        Cycles behind the jackknife.
    path : tuple of PathRow
        Every structure tried, with its error on cycles left out.
    state : FitState
        What became of the fit.
    """

    support: Support
    terms: tuple[str, ...]
    time_constant_s: float
    coefficients: FloatArray
    covariance: FloatArray
    initial: FloatArray
    residual_rms: float
    n_blocks: int
    path: tuple[PathRow, ...]
    state: FitState

    @property
    def time_constant_stderr_s(self) -> float:
        """Standard error of τ in seconds."""
        return float(np.sqrt(self.covariance[-1, -1]))


def select_on_free_run(
    equations: FreeRunEquations,
    names: Sequence[str],
    degrees: Sequence[int | None],
    cycles: IndexArray,
    *,
    optimizer: Any = "SSR",
    max_terms: int = 6,
    common_tau_share: float = 0.0,
    common_curve_share: float = 0.0,
) -> SparseRun:
    """Choose terms by cycles left out, and fit them on free runs.

    Complete polynomials are climbed as long as the error on cycles left out falls by more than
    one standard error of the paired differences, from the parabola upwards; a structure off the
    ladder is taken only if it leaves less than 0.7 of that error.

    Parameters
    ----------
    equations : FreeRunEquations
        The candidate terms, what is in every structure, ψ' and which rows are scored.
    names : sequence of str
        Names of the candidate terms.
    degrees : sequence of int or None
        Total degree of each; None for a term that is no polynomial.
    cycles : ndarray of int of shape (n_rows,)
        Number of the cycle of each row: what is left out together.
    optimizer : {"SSR", "STLSQ", "FROLS"} or pysindy optimizer
        What proposes the structures off the ladder.
    max_terms : int
        Largest structure considered.
    common_tau_share, common_curve_share : float
        Standard errors that all cycles share, as shares of τ and of the mean of abs(ψ') over the
        scored rows: no jackknife over cycles sees them.

    Returns
    -------
    SparseRun
        The terms with τ, β and their covariance.
    """
    columns, starts = equations.columns, equations.runs.starts
    most = min(max_terms, columns.shape[1])
    needed = _ROWS_A_PARAMETER * (most + equations.nuisance.shape[1] + starts.size + 1)
    if equations.scored.size < needed:
        return _nothing(starts.size)
    # τ of the simplest terms says what can be separated, and how long errors hang together.
    pilot_s = float(equations.fit(tuple(range(min(_SIMPLEST, most))))[0][-1])
    usable = independent_columns(equations.simulated(pilot_s))
    if not usable.size:
        return _nothing(starts.size)
    equations = replace(equations, columns=columns[:, usable])
    blocks = equations.blocks(cycles, pilot_s)
    trials = Trials(equations, [Block(rows, rows) for rows in blocks], _MOST_LEVERAGE)
    chosen, rivals = _chosen(equations, trials, [degrees[i] for i in usable], optimizer, most)
    fit = equations.solve(chosen)
    covariance = _scatter(fit, blocks) + _spread(equations, fit, chosen, rivals)
    covariance += _shared(equations, fit, chosen, common_tau_share, common_curve_share)
    kept = [names[i] for i in usable]
    tau, beta = float(fit.parameters[-1]), fit.parameters[:-1]
    found = HeldOutFit(chosen, tau, beta, covariance, fit.initial, trials.tried())
    return SparseRun(
        tuple(int(usable[i]) for i in chosen),
        tuple(kept[i] for i in chosen),
        tau,
        beta,
        covariance,
        fit.initial,
        float(np.sqrt(np.mean(fit.residual**2))),
        len(blocks),
        with_held_out((), found, kept),
        _state(equations, tau, float(np.sqrt(covariance[-1, -1]))),
    )


def _nothing(n_runs: int) -> SparseRun:
    return SparseRun(
        (),
        (),
        float("nan"),
        np.zeros(0),
        np.full((1, 1), np.nan),
        np.zeros(n_runs),
        float("nan"),
        0,
        (),
        FitState.TOO_FEW_ROWS,
    )


def _chosen(
    equations: FreeRunEquations,
    trials: Trials,
    degrees: Sequence[int | None],
    optimizer: Any,
    max_terms: int,
) -> tuple[Support, list[Support]]:
    """Return the structure, and those off the ladder that the data cannot separate from it."""
    ladder, start = polynomial_ladder(degrees, max_terms), _START
    if not ladder:
        about = tuple(range(min(_SIMPLEST, len(degrees))))
        linear = equations.linear(about)
        ladder, start = best_of_each_size(linear, proposals(linear, optimizer, max_terms)), 0
    rung = climb(trials, ladder, min(start, len(ladder) - 1))
    linear = equations.linear(rung)
    proposed = proposals(linear, optimizer, max_terms)
    special = special_structures(trials, linear, proposed, rung, ladder, _SHARE_LEFT)
    if not special:
        return rung, []
    best = min(special, key=lambda s: special[s])
    return best, [s for s in special if s != best and not pays(trials, s, best)]


def _scatter(fit: FreeRunFit, blocks: Sequence[IndexArray]) -> FloatArray:
    """Return the jackknife over cycles, in which the nuisances are estimated again as well."""
    moves = leave_out_moves(fit.joint, fit.residual, blocks)
    n = fit.parameters.size - 1
    return scatter(np.delete(moves, np.s_[n : n + fit.nuisance.size], axis=1))


def _spread(
    equations: FreeRunEquations, fit: FreeRunFit, chosen: Support, rivals: Sequence[Support]
) -> FloatArray:
    """Return what the choice among structures adds that the data cannot separate.

    The mean square of what the curve and τ of each differ by; the curves as far as the terms
    that were chosen can follow.
    """
    values = equations.columns[equations.scored]
    curve = values[:, list(chosen)] @ fit.parameters[:-1]
    result = np.zeros((fit.parameters.size, fit.parameters.size))
    for rival in rivals:
        other = equations.solve(rival).parameters
        apart = least_squares(values[:, list(chosen)], values[:, list(rival)] @ other[:-1] - curve)
        shift = np.append(apart, other[-1] - fit.parameters[-1])
        result += np.outer(shift, shift) / len(rivals)
    return result


def _shared(
    equations: FreeRunEquations,
    fit: FreeRunFit,
    chosen: Support,
    tau_share: float,
    curve_share: float,
) -> FloatArray:
    """Return the covariance of errors that all cycles share: of τ, and of the curve's level."""
    values = equations.columns[equations.scored][:, list(chosen)]
    # The level moves along whatever the terms make of a constant.
    level = least_squares(values, np.ones(len(values)))
    level = level * curve_share * float(np.mean(np.abs(equations.output[equations.scored])))
    result = np.zeros((len(chosen) + 1, len(chosen) + 1))
    result[:-1, :-1] = np.outer(level, level)
    result[-1, -1] = (tau_share * float(fit.parameters[-1])) ** 2
    return result


def _state(equations: FreeRunEquations, tau: float, stderr: float) -> FitState:
    if tau < equations.sample_period_s / 2:
        return FitState.LAG_BELOW_RESOLUTION
    if not stderr < tau or tau > 0.99 * equations.longest_lag_s:
        return FitState.LAG_UNDETERMINED
    return FitState.OK
