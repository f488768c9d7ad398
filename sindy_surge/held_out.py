"""Choice and fit of the terms when the error of the model, not the noise, is what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sindy_surge.constraints import Constraints
from sindy_surge.free_run import simulate
from sindy_surge.lag_problem import LagProblem
from sindy_surge.leave_out import leave_out_moves, unit_norms
from sindy_surge.linear_problem import Support
from sindy_surge.preparation import Prepared
from sindy_surge.segments import block_slices
from sindy_surge.selection import PathRow
from sindy_surge.sparse_paths import proposals
from sindy_surge.trials import (
    FEWEST_BLOCKS,
    Block,
    Trials,
    best_of_each_size,
    climb,
    polynomial_ladder,
    special_structures,
)
from sindy_surge.weak import MIN_HALF_WIDTH, WeakEquations
from surge_core.leave_out import scatter
from surge_core.types import FloatArray

__all__ = ["HeldOutFit", "model_error_dominates", "select_by_held_out", "with_held_out"]


# Variance of what all terms leave over that of the noise which fourth differences show. An
# autoregression of first order has 3.5/(1 - a²): 16 for a = 0.9, 88 for a = 0.98, which is a noise
# that lasts 50 samples. What exceeds this is smoother than a sensor's noise: on reduced records
# of the simulated rig it was 2e4 to 1e5, for noise alone behind their 48 Hz filter 200 to 400.
_MOST_EXCESS = 100.0
# About an error that comes again in every cycle, one cycle is all the data there is. A surge
# cycle of 130 ms holds four test functions of 2 τ = 32 ms (equivalent width 1.1 half widths).
_EQUATIONS_IN_CYCLE = 4.0
# With so few the extended BIC takes a term picked out of p = 20 when the mean square error
# falls to exp(-(ln 4 + 3 ln p)/4) = 0.07: about a tenth.
_SHARE_LEFT = 0.1
# A straight line alone is no ladder: such a library means to be piecewise linear.
_FEWEST_RUNGS = 2


def model_error_dominates(prepared: Prepared, consistent: bool) -> bool:
    """Return whether what the terms leave is an error of the model rather than noise.

    Parameters
    ----------
    consistent : bool
        Whether a structure stands against all others.

    Returns
    -------
    bool
        True if even all terms leave more than 100 times the variance of the noise, or if no
        structure stands and all terms leave a coloured rest. With a white rest it is the number
        of terms allowed that no structure fits in.
    """
    coloured = prepared.problem.noise.colour.size > 0
    return prepared.excess > _MOST_EXCESS or (not consistent and coloured)


@dataclass(frozen=True)
class HeldOutFit:
    """The structure chosen by cycles left out, fitted in the weak form.

    Parameters
    ----------
    support : tuple of int
        Positions of the terms within the usable columns.
    time_constant_s : float
        τ in seconds.
    coefficients : ndarray of shape (n_support,)
        β in physical units.
    covariance : ndarray of shape (n_support + 1, n_support + 1)
        Of β and, last, τ.
    initial : ndarray of shape (n_segments,)
        ψ' at the start of each segment.
    tried : dict
        Each structure tried, with the rms of its weak equations on blocks left out and its τ.
    """

    support: Support
    time_constant_s: float
    coefficients: FloatArray
    covariance: FloatArray
    initial: FloatArray
    tried: dict[Support, tuple[float, float]]


def select_by_held_out(
    problem: LagProblem,
    optimizer: Any,
    max_terms: int,
    degrees: Sequence[int | None],
    constraints: Constraints | None = None,
) -> HeldOutFit | None:
    """Choose the degree of a polynomial by cycles left out and fit it in the weak form.

    Where the model is wrong, its error comes again in every cycle. Cycles left out then do not
    tell a term from that error: by any one-standard-error rule over the whole library, four to
    six terms were chosen on records of the simulated rig, and the curve was off by 0.5 to 2.
    So polynomials are taken complete, all powers up to a degree (a complete polynomial
    stays one when φ is shifted by an offset of its probes). The degree is raised as long as
    that lowers the error on cycles left out by more than one standard error of the paired
    differences, and another structure, no larger than a cubic, is taken only if it leaves a tenth
    of the error.

    The weak form with a half width of two time constants passes over the ends of the
    segments and the fast part of the error, both of which a free run or a one-step fit
    takes for dynamics.

    Parameters
    ----------
    degrees : sequence of int or None
        Total degree of each usable term; None for a term that is no polynomial.
    constraints : Constraints or None
        What is known of the terms beforehand.

    Returns
    -------
    HeldOutFit or None
        None if the segments are too short for the weak form, or the structure chosen gives no lag.
    """
    weak = WeakEquations.of(problem)
    if weak is None:
        return None
    trials = Trials(weak, _blocks(problem, weak))
    if len(trials.blocks) < FEWEST_BLOCKS or weak.signal.size < 2 * max_terms + 2:
        return None
    linear = weak.linear()
    # Terms with ψ' have no part in the weak form.
    n_terms = linear.columns.shape[1]
    required = tuple(i for i in constraints.required if i < n_terms) if constraints else ()

    def admitted(support: Support) -> bool:
        held = set(required) <= set(support)
        return held and (not constraints or constraints.allow(support, weak.fit(support)[0][:-1]))

    proposed = [s for s in proposals(linear, optimizer, max_terms, required) if admitted(s)]
    ladder = [s for s in polynomial_ladder(degrees, max_terms) if admitted(s)]
    if len(ladder) < _FEWEST_RUNGS:
        ladder = best_of_each_size(linear, proposed)
    if not ladder:
        return None
    chosen = climb(trials, ladder)
    special = special_structures(trials, linear, proposed, chosen, ladder, _SHARE_LEFT)
    # The smallest: an error that every cycle repeats rewards each further term.
    chosen = min(special, key=lambda s: (len(s), special[s]), default=chosen)
    if not problem.shortest_lag_s < trials.lags[chosen] < problem.longest_lag_s:
        return None
    return _finished(problem, weak, trials, chosen)


def _blocks(problem: LagProblem, weak: WeakEquations) -> list[Block]:
    """Return the blocks to leave out, each scored on the equations centred in it."""
    centres, reach = weak.centres, weak.half_width
    blocks = []
    for rows in block_slices(problem.segments, 2 * reach + 1):
        own = np.flatnonzero((centres >= rows.start) & (centres < rows.stop))
        touched = (centres > rows.start - reach) & (centres < rows.stop - 1 + reach)
        if own.size:
            blocks.append(Block(np.flatnonzero(touched), own))
    return blocks


def with_held_out(
    path: Sequence[PathRow], fit: HeldOutFit, names: Sequence[str]
) -> tuple[PathRow, ...]:
    """Add the structures tried on rows left out to the table of structures."""
    rows = {row.terms: replace(row, chosen=False, consistent=False) for row in path}
    for support, (rms, tau) in fit.tried.items():
        terms = tuple(names[i] for i in support)
        none = PathRow(len(support), terms, np.nan, np.nan, np.nan, False, False, False)
        rows[terms] = replace(
            rows.get(terms, none),
            time_constant_s=tau,
            refitted=True,
            chosen=support == fit.support,
            held_out_rms=rms,
        )

    def order(row: PathRow) -> tuple[int, float]:
        return row.size, row.held_out_rms if np.isfinite(row.held_out_rms) else np.inf

    return tuple(sorted(rows.values(), key=order))


def _finished(
    problem: LagProblem, weak: WeakEquations, trials: Trials, support: Support
) -> HeldOutFit:
    parameters, design, residual = weak.fit(support)
    homes = [block.own for block in trials.blocks]
    covariance = scatter(leave_out_moves(design, residual, homes))
    covariance += _repeated(design, residual) + _spread(problem, weak, support)
    tau = float(parameters[-1])
    lag = problem.hold_at(tau)
    wanted = problem.columns[list(support)].tolist()
    values = problem.late(problem.terms(problem.inputs, wanted=wanted))
    forcing = values @ parameters[:-1]
    rest = problem.output - simulate(forcing, problem.segments, lag)
    decay = lag.a ** problem.segments.offsets().astype(float)
    starts = problem.segments.starts
    initial = np.add.reduceat(decay * rest, starts) / np.add.reduceat(decay**2, starts)
    return HeldOutFit(support, tau, parameters[:-1], covariance, initial, trials.tried())


def _repeated(design: FloatArray, residual: FloatArray) -> FloatArray:
    """Return the covariance that errors have which every cycle repeats.

    Cycles that repeat an error agree about it, and their scatter says nothing of its size. The
    information is that of one cycle, however many there are.
    """
    norms = unit_norms(design)
    scaled = design / norms
    bread = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    total = float(residual @ residual) / _EQUATIONS_IN_CYCLE
    return np.asarray(total * bread / np.outer(norms, norms))


def _spread(problem: LagProblem, weak: WeakEquations, support: Support) -> FloatArray:
    """Return what the choice of the weak form adds: the other direction, a narrower function.

    A true model gives one answer for every test function and either direction of the
    regression; the mean square of the two shifts is what a wrong one adds.
    """
    parameters = weak.fit(support)[0]
    others = [weak.fit_forward(support)]
    narrow = round(weak.half_width / np.sqrt(2.0))
    if narrow >= MIN_HALF_WIDTH:
        narrower = WeakEquations.of(problem, narrow)
        others.append(None if narrower is None else narrower.fit(support)[0])
    shifts = [other - parameters for other in others if other is not None]
    result = np.zeros((parameters.size, parameters.size))
    for shift in shifts:
        result += np.outer(shift, shift) / len(shifts)
    return result
