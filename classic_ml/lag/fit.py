"""From a record to τ, the characteristic and their covariance: scan, head, whole record, blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from classic_ml.lag.conditioning import Conditioned
from classic_ml.lag.covariance import (
    BLOCKS,
    block_edges,
    correlation_length,
    scatter,
    slow_correlation_length,
)
from classic_ml.lag.leave_out import leave_out_moves
from classic_ml.lag.prediction import LagProblem, Point
from classic_ml.likelihood import Bench, Fit, pseudo_inverse, scan, search
from classic_ml.noise_models import MovingAverage
from surge_core.fit_state import FitState
from surge_core.types import FloatArray, IntArray

__all__ = ["LagFit", "fit_lag"]

SCAN_POINTS = 28
SCAN_ROWS = 20_000
# On a long record the search is brought to its end on this share of it before the first full pass.
HEAD_SHARE = 0.05
BEST_DEAD_TIMES = 3
LONG_RECORD = 200_000
# Normalised eigenvalue of the terms' own normal equations: below it they cannot be told apart.
RANK_LIMIT = 1e-13


@dataclass(frozen=True)
class LagFit:
    """What a fit found, in the units of the user.

    Parameters
    ----------
    log_tau, dead : float
        Logarithm of τ in seconds; dead time in samples.
    coef : ndarray of shape (q,)
        β of the terms as the user knows them.
    moving_average : ndarray of shape (order,)
        Coefficients of C.
    drift : ndarray
        Coefficients of the centred hats, the last one left out.
    ripple : ndarray of shape (n_runs, 2 n_frequencies)
        Sine and cosine amplitudes.
    moves : ndarray of shape (n_blocks, 2 + q)
        By how much each block moves log τ, dead time and β.
    back : ndarray of shape (q, r)
        What turns coefficients of nearly orthogonal terms into β.
    curve_moves : ndarray of shape (n_blocks, r)
        Moves of those coefficients, their mean taken out. In powers of φ the moves of β all but
        cancel in those of the curve; these do not.
    cost : float
        Sum of squared weighted errors.
    n_errors, n_lags : int
        Scored errors, and lags over which they hang together.
    state : FitState
        How it ended.
    """

    log_tau: float
    dead: float
    coef: FloatArray
    moving_average: FloatArray
    drift: FloatArray
    ripple: FloatArray
    moves: FloatArray
    back: FloatArray
    curve_moves: FloatArray
    cost: float
    n_errors: int
    n_lags: int
    state: FitState

    @property
    def covariance(self) -> FloatArray:
        """Covariance of log τ, dead time in samples and β."""
        return scatter(self.moves)


def fit_lag(problem: LagProblem, conditioned: Conditioned, start: LagFit | None = None) -> LagFit:
    """Fit a lag model to a record.

    Parameters
    ----------
    problem : LagProblem
        Record and model, its terms those of ``conditioned``.
    conditioned : Conditioned
        How the problem's terms come from the user's.
    start : LagFit, optional
        An earlier fit to start from, in place of a scan.
    """
    bench = Bench.of(problem)
    edges = block_edges(bench.cells.piece_lengths, 1)
    starts = _starts(bench) if start is None else [_again(bench, start)]
    if bench.cells.n_errors > LONG_RECORD:
        bench = Bench.of(problem, edges)
    fit, state = search(bench, [_fitted_to(bench, start) for start in starts])
    fit, n_lags = _with_blocks(bench, fit, edges)
    return _finished(fit, conditioned, state, n_lags)


def _again(bench: Bench, fit: LagFit) -> Point:
    free = MovingAverage.from_coefficients(fit.moving_average).free
    return bench.origin(np.concatenate([[fit.log_tau, fit.dead], free]))


def _fitted_to(bench: Bench, point: Point) -> Point:
    """Take shape and β from a point of another part of the record."""
    shape = np.concatenate([[point.log_tau, point.dead], point.free])
    return bench.origin(shape, point.beta)


def _starts(bench: Bench) -> list[Point]:
    """Scan log τ on the head of the record; armax starts from arx and from output error."""
    problem = bench.problem
    n_free = problem.n_shape + problem.terms.shape[0] + 3
    head = problem.head(SCAN_ROWS)
    on_head = Bench.of(head)
    n_rows = sum(run.stop - run.start for run in problem.runs)
    if n_rows <= SCAN_ROWS or on_head.cells.n_errors <= n_free + _n_local(head):
        head, on_head = problem, bench
    starts = [on_head.origin(shape) for shape in _shapes(head)]
    if on_head is bench:
        return starts
    # On a long record the choice among the starts is made on its head.
    fit, _ = search(on_head, starts)
    if n_rows > LONG_RECORD:
        further = Bench.of(problem.head(int(HEAD_SHARE * n_rows)))
        fit, _ = search(further, [_fitted_to(further, fit.at.point)])
    return [fit.at.point]


def _n_local(problem: LagProblem) -> int:
    levels = 0 if problem.knots is None else problem.knots.n_levels
    return levels + 2 * problem.omega.size * len(problem.runs)


def _shapes(problem: LagProblem) -> list[FloatArray]:
    """Return the shapes [log τ, dead time, ρ] from which to search."""
    if problem.is_output_error or problem.order == 0:
        return [np.concatenate([pair, np.zeros(problem.order)]) for pair in _pairs(problem)]
    plain, free_run = replace(problem, noise="arx", order=0), _free_run(problem)
    shapes = [np.concatenate([pair, np.zeros(problem.order)]) for pair in _pairs(plain)]
    for pair in _pairs(free_run):
        # Output error is armax with C = A: the other end of the family.
        c = np.zeros(problem.order)
        c[0] = -problem.lag(pair[0], 0.0).a
        shapes.append(np.concatenate([pair, MovingAverage.from_coefficients(c).free]))
    return shapes


def _free_run(problem: LagProblem) -> LagProblem:
    return replace(problem, noise="output-error", order=0)


def _pairs(problem: LagProblem) -> list[FloatArray]:
    """Scan log τ, and the dead time where it is fitted; several dead times may be worth a try."""
    low, high = problem.log_tau_bounds
    bench = Bench.of(problem)
    if not problem.fit_dead:
        if problem.held_log_tau is not None:
            return [np.array([problem.held_log_tau, problem.dead])]
        grid = np.linspace(low + np.log(10.0), high, SCAN_POINTS)
        return [np.array([scan(bench, grid, np.array([problem.dead]))[0], problem.dead])]
    held = problem.held_log_tau
    coarse = np.linspace(low + np.log(10.0), high, SCAN_POINTS // 2)
    trials = coarse if held is None else np.array([held])
    found = []
    for dead in _dead_times(problem.longest_dead):
        log_tau, cost = scan(bench, trials, np.array([dead]))
        found.append((cost, log_tau, dead))
    found.sort()
    return [np.array([log_tau, dead]) for _, log_tau, dead in found[:BEST_DEAD_TIMES]]


def _dead_times(longest: float) -> list[float]:
    """Return trial dead times in samples, each half as long again as the one before."""
    times, step = [0.5], 1.0
    while times[-1] + step < longest:
        times.append(times[-1] + step)
        step = max(1.0, 0.5 * times[-1])
    return times


def _with_blocks(bench: Bench, fit: Fit, edges: list[IntArray]) -> tuple[Fit, int]:
    """Pass once more where the blocks have to be others, or the last pass was not at the end."""
    cells = bench.cells
    last = bench.fit_at(fit.at.point, fresh=False) if _is_stale(bench, fit) else fit
    n_lags = correlation_length(last.at.errors, cells.piece_lengths)
    shortest = n_lags
    if n_lags > cells.n_errors / BLOCKS:
        shortest = min(n_lags, slow_correlation_length(last.at.errors, cells.piece_lengths))
    wanted = block_edges(cells.piece_lengths, shortest)
    same = all(np.array_equal(a, b) for a, b in zip(edges, wanted, strict=True))
    if same and cells.n_errors > LONG_RECORD:
        return last, n_lags
    cut = Bench.of(bench.problem, wanted)
    final = cut.at_optimum(last)
    return final, correlation_length(final.at.errors, cells.piece_lengths)


def _is_stale(bench: Bench, fit: Fit) -> bool:
    """Tell whether a later pass has overwritten the errors of this one."""
    return abs(float(bench.errors @ bench.errors) - fit.at.raw_cost) > 0.0


def _finished(fit: Fit, conditioned: Conditioned, state: FitState, n_lags: int) -> LagFit:
    at, problem = fit.at, fit.at.problem
    n_shape, q = problem.n_shape, problem.terms.shape[0]
    bread = pseudo_inverse(at.reduced[:-1, :-1])
    point = at.moved(np.concatenate([np.zeros(n_shape), fit.linear]), fit.shape)
    hats = point.hats
    moves, level_moves = leave_out_moves(
        at.cells,
        problem.columns,
        at.grams,
        at.solved,
        bread,
        at.start_weight,
        at.point.starts,
        problem.constrained,
        problem.weight,
        hats,
        at.mean,
    )
    level, back, curve_moves = 0.0, conditioned.back, moves[:, n_shape:]
    coef = back @ point.beta
    weight = float(at.mean.sum())
    if conditioned.constant is not None and weight > 0.0:
        level = float(at.mean @ hats) / weight
        coef = coef + level * conditioned.constant
        back = np.column_stack([back, conditioned.constant])
        curve_moves = np.column_stack([curve_moves, level_moves])
    shape_moves = np.zeros((moves.shape[0], 2))
    shape_moves[:, 0] = 0.0 if problem.fixed_tau else moves[:, 0]
    if problem.fit_dead:
        shape_moves[:, 1] = moves[:, int(not problem.fixed_tau)]
    own = at.reduced[n_shape:-1, n_shape:-1]
    if conditioned.deficient or (q > 0 and _is_deficient(own)):
        state = FitState.RANK_DEFICIENT
    return LagFit(
        point.log_tau,
        point.dead,
        coef,
        MovingAverage(point.free).coefficients,
        _centred(problem, hats - level),
        point.ripple,
        np.column_stack([shape_moves, curve_moves @ back.T]),
        back,
        curve_moves - curve_moves.mean(axis=0),
        fit.cost,
        at.cells.n_errors,
        n_lags,
        state,
    )


def _is_deficient(gram: FloatArray) -> bool:
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    if np.any(scale == 0.0):
        return True
    values = np.linalg.eigvalsh(gram / np.outer(scale, scale))
    return bool(values[0] <= RANK_LIMIT * values[-1])


def _centred(problem: LagProblem, hats: FloatArray) -> FloatArray:
    """Return the coefficients of the centred hats, the last one left out."""
    if problem.knots is None:
        return np.zeros(0)
    full = [
        hats[first : first + intervals + 1]
        for first, intervals in zip(problem.knots.first, problem.knots.intervals, strict=True)
    ]
    values = np.concatenate(full)
    return np.asarray((values - values[-1])[:-1])
