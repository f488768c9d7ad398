"""Choice and fit of the terms when the error of the model, not the noise, is what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sindy_surge.covariance import jackknife_covariance, leave_out_moves
from sindy_surge.free_run import simulate
from sindy_surge.lag_fit import LinearProblem
from sindy_surge.lag_problem import LagProblem
from sindy_surge.preparation import Prepared
from sindy_surge.selection import PathRow
from sindy_surge.sparse_paths import Support, proposals, support_chi2
from sindy_surge.weak_equations import WeakEquations, blocks_for
from sindy_surge.weak_form import MIN_HALF_WIDTH

__all__ = ["HeldOutFit", "model_error_dominates", "select_by_held_out", "with_held_out"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# Variance of what all terms leave over that of the noise which fourth differences show. An
# autoregression of first order has 3.5/(1 - a²): 16 for a = 0.9, 88 for a = 0.98, which is a noise
# that lasts 50 samples. What exceeds this is smoother than a sensor's noise: on reduced records
# of the simulated rig it was 2e4 to 1e5, for noise alone behind their 48 Hz filter 200 to 400.
_MOST_EXCESS = 100.0
# A characteristic in stall falls, turns and rises: a cubic (Moore & Greitzer 1986) is the
# most that is asked of a polynomial when the data cannot tell a term from an error.
_HIGHEST_DEGREE = 3
# About an error that comes again in every cycle, one cycle is all the data there is. A surge
# cycle of 130 ms holds four test functions of 2 τ = 32 ms (equivalent width 1.1 half widths).
_EQUATIONS_IN_CYCLE = 4.0
# With so few the extended BIC takes a term picked out of p = 20 when the mean square error
# falls to exp(-(ln 4 + 3 ln p)/4) = 0.07: about a tenth.
_SHARE_LEFT = 0.1
_MOST_SPECIAL = 24
_FEWEST_BLOCKS = 3


def model_error_dominates(prepared: Prepared, consistent: bool) -> bool:
    """Return whether what the terms leave is an error of the model rather than noise.

    Parameters
    ----------
    prepared : Prepared
        With the excess of the fit of all terms, and the colour of its rest.
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


@dataclass
class _Trials:
    """Held-out errors of the structures tried."""

    weak: WeakEquations
    blocks: list[tuple[slice, IntArray]]
    errors: dict[Support, FloatArray] = field(default_factory=dict)
    lags: dict[Support, float] = field(default_factory=dict)

    def error(self, support: Support) -> FloatArray:
        """Return the mean square error of each block's equations, fitted without that block."""
        if support not in self.errors:
            parameters, design, residual = self.weak.fit(support)
            touched = [self._reaching_into(block) for block, _ in self.blocks]
            moves = leave_out_moves(design, residual, touched)
            self.lags[support] = float(parameters[-1])
            self.errors[support] = np.array(
                [
                    float(np.mean((residual[rows] - design[rows] @ move) ** 2))
                    for move, (_, rows) in zip(moves, self.blocks, strict=True)
                ]
            )
        return self.errors[support]

    def mean(self, support: Support) -> float:
        return float(np.mean(self.error(support)))

    def _reaching_into(self, block: slice) -> IntArray:
        centres, reach = self.weak.centres, self.weak.half_width
        return np.flatnonzero((centres > block.start - reach) & (centres < block.stop - 1 + reach))


def select_by_held_out(
    problem: LagProblem, optimizer: Any, max_terms: int, degrees: Sequence[int | None]
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
    problem : LagProblem
        The data.
    optimizer : {"SSR", "STLSQ", "FROLS"} or pysindy optimizer
        What proposes the other structures, on the weak equations.
    max_terms : int
        Largest structure considered.
    degrees : sequence of int or None
        Total degree of each usable term; None for a term that is no polynomial.

    Returns
    -------
    HeldOutFit or None
        None if the segments are too short for the weak form, or the structure chosen gives no lag.
    """
    weak = WeakEquations.of(problem)
    if weak is None:
        return None
    trials = _Trials(weak, blocks_for(problem, weak))
    if len(trials.blocks) < _FEWEST_BLOCKS or weak.signal.size < 2 * max_terms + 2:
        return None
    linear = weak.linear()
    proposed = proposals(linear, optimizer, max_terms)
    ladder = _ladder(degrees, max_terms) or _best_of_each_size(linear, proposed)
    chosen = _climb(trials, ladder)
    chosen = _special(trials, linear, proposed, chosen, ladder)
    if not problem.shortest_lag_s < trials.lags[chosen] < problem.longest_lag_s:
        return None
    return _finished(problem, trials, chosen)


def _ladder(degrees: Sequence[int | None], max_terms: int) -> list[Support]:
    """Return the complete polynomials from degree 1 upwards."""
    known = [degree for degree in degrees if degree is not None]
    if not {0, 1} <= set(known):
        return []
    rungs = [
        tuple(i for i, degree in enumerate(degrees) if degree is not None and degree <= top)
        for top in range(1, min(max(known), _HIGHEST_DEGREE) + 1)
    ]
    return [rung for rung in dict.fromkeys(rungs) if len(rung) <= max_terms]


def _best_of_each_size(linear: LinearProblem, proposed: list[Support]) -> list[Support]:
    best: dict[int, Support] = {}
    for support in sorted(proposed, key=lambda s: support_chi2(linear, s)):
        best.setdefault(len(support), support)
    return [best[size] for size in sorted(best)]


def _climb(trials: _Trials, ladder: list[Support]) -> Support:
    chosen = ladder[0]
    for rung in ladder[1:]:
        gain = trials.error(chosen) - trials.error(rung)
        if gain.mean() <= gain.std(ddof=1) / np.sqrt(gain.size):
            break
        chosen = rung
    trials.error(chosen)
    return chosen


def _special(
    trials: _Trials,
    linear: LinearProblem,
    proposed: list[Support],
    chosen: Support,
    ladder: list[Support],
) -> Support:
    """Take a structure off the ladder, and no larger, if it leaves a tenth of the error."""
    largest = max(len(rung) for rung in ladder)
    others = [s for s in proposed if s not in ladder and len(s) <= largest]
    others = sorted(others, key=lambda s: support_chi2(linear, s))[:_MOST_SPECIAL]
    limit = _SHARE_LEFT * trials.mean(chosen)
    good = [s for s in others if trials.mean(s) < limit]
    return min(good, key=lambda s: (len(s), trials.mean(s))) if good else chosen


def with_held_out(
    path: Sequence[PathRow], fit: HeldOutFit, names: Sequence[str]
) -> tuple[PathRow, ...]:
    """Add the structures tried on rows left out to the table of structures.

    Parameters
    ----------
    path : sequence of PathRow
        The table so far; nothing in it stays chosen.
    fit : HeldOutFit
        The structures tried, and the one chosen.
    names : sequence of str
        Names of the usable terms.

    Returns
    -------
    tuple of PathRow
        By size, and within a size by held-out error.
    """
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


def _finished(problem: LagProblem, trials: _Trials, support: Support) -> HeldOutFit:
    weak = trials.weak
    parameters, design, residual = weak.fit(support)
    homes = [rows for _, rows in trials.blocks]
    covariance = jackknife_covariance(leave_out_moves(design, residual, homes))
    covariance += _repeated(design, residual) + _spread(problem, weak, support)
    tau = float(parameters[-1])
    lag = problem.hold_at(tau)
    values = problem.terms(problem.inputs)[:, problem.columns[list(support)]]
    forcing = values @ parameters[:-1]
    rest = problem.output - simulate(forcing, problem.segments, lag)
    decay = lag.pole ** problem.segments.offsets().astype(float)
    starts = problem.segments.starts
    initial = np.add.reduceat(decay * rest, starts) / np.add.reduceat(decay**2, starts)
    tried = {s: (trials.mean(s) ** 0.5, trials.lags[s]) for s in trials.errors}
    return HeldOutFit(support, tau, parameters[:-1], covariance, initial, tried)


def _repeated(design: FloatArray, residual: FloatArray) -> FloatArray:
    """Return the covariance that errors have which every cycle repeats.

    Cycles that repeat an error agree about it, and their scatter says nothing of its size. The
    information is that of one cycle, however many there are.
    """
    norms = np.linalg.norm(design, axis=0)
    norms[norms == 0] = 1.0
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
