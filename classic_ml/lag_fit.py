"""From a record to τ, the characteristic and their covariance: scan, search, blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from classic_ml.lag_data import LagData, MovingAverage, Terms
from classic_ml.likelihood import Profile, profile
from surge_core.fit_state import FitState
from surge_core.leave_out import (
    BLOCKS,
    block_edges,
    correlation_length,
    leave_out,
    slow_correlation_length,
)
from surge_core.types import FloatArray

# From a fifth of a sample to the longest segment. A first-order lag looks much the same over a
# factor of three in τ to either side.
SCAN_POINTS = 6
MAXIMUM_ITERATIONS = 200
# With C near the unit circle the last steps shrink slowly: a hundredth of a standard error short of
# the minimum is still at it.
COARSE_DECREMENT = 1e-4
# A step of 1e-6 standard errors changes no test.
NEWTON_DECREMENT = 1e-12
# Of the cost: smaller differences between two passes are rounding.
BLIND = 1e-11
# Normalised eigenvalue of the terms' own normal equations: below it they cannot be separated.
RANK_LIMIT = 1e-13


@dataclass(frozen=True)
class LagFit:
    """Where a fit ended, and what it is without each block.

    ``moves``, a row a block, is by how much log τ and β of the user's terms move without it;
    ``curve_moves`` are those of the coefficients of nearly orthogonal terms, their mean taken out:
    in powers of φ the moves of β all but cancel in those of the curve. ``n_lags`` is over how many
    errors they hang together.
    """

    at: Profile
    moves: FloatArray
    curve_moves: FloatArray
    n_lags: int
    state: FitState


def fit_lag(data: LagData, terms: Terms) -> LagFit:
    """Fit a lag model to a record; ``terms`` says how those of the data come from the user's."""
    at, state = _search(data)
    scored = at.errors[data.scored]
    n_lags = correlation_length(scored, data.piece_lengths)
    shortest = n_lags
    if n_lags > scored.size / BLOCKS:
        shortest = min(n_lags, slow_correlation_length(scored, data.piece_lengths))
    found, s = without_blocks(at, _blocks(data, shortest)), at.n_shape
    moves = np.zeros((len(found), 1))
    moves[:, data.free[:1]] = found[:, : s - data.order]
    curve_moves = found[:, s : s + at.beta.size]
    if terms.deficient or _is_deficient(at.normal[s:, s:]):
        state = FitState.RANK_DEFICIENT
    both = np.column_stack([moves, curve_moves @ terms.back.T])
    return LagFit(at, both, curve_moves - curve_moves.mean(axis=0), n_lags, state)


def without_blocks(at: Profile, blocks: list[slice]) -> FloatArray:
    """Return by how much shape, β and drift move without each block of errors, linearised."""
    data = at.data
    moves, _ = leave_out(at.jacobian, at.errors, blocks)
    r, d = at.beta.size, at.levels.size
    constant = np.linalg.lstsq(data.terms, np.ones(data.y.size))[0]
    if d == 0 or not np.allclose(data.terms @ constant, 1.0):
        return moves
    # The drift of the other rows has zero mean over them: what it has there is the constant's.
    for move, block in zip(moves, blocks, strict=True):
        weight = data.weight.copy()
        weight[data.rows_of_errors[block]] = 0.0
        mean = weight @ data.drift / weight.sum()
        move[-r - d : -d] += constant * (mean @ (at.levels + move[-d:]))
    return moves


def _blocks(data: LagData, n_lags: int) -> list[slice]:
    """Return the blocks of the jackknife as slices of the errors."""
    blocks = []
    lengths = data.piece_lengths
    at = np.concatenate([[0], np.cumsum(lengths)])
    for number, inner in enumerate(block_edges(lengths, n_lags)):
        edges = at[number] + np.concatenate([[0], inner, [lengths[number]]])
        places = np.append(data.scored, data.scored[-1] + 1)[edges]
        blocks += [slice(int(a), int(b)) for a, b in pairwise(places)]
    return blocks


def _is_deficient(gram: FloatArray) -> bool:
    scale = np.sqrt(np.diag(gram))
    if np.any(scale == 0.0):
        return True
    values = np.linalg.eigvalsh(gram / np.outer(scale, scale))
    return bool(values.size and values[0] <= RANK_LIMIT * values[-1])


def _search(data: LagData) -> tuple[Profile, FitState]:
    """Refine from each start and return the best fit, and how it ended."""
    ends = [_refine(profile(data, start)) for start in _starts(data)]
    return min(ends, key=lambda end: end[0].cost)


def _refine(at: Profile) -> tuple[Profile, FitState]:
    data = at.data
    n_errors = max(data.scored.size, 1)
    damping, state = 1e-6, FitState.NOT_CONVERGED
    for _ in range(MAXIMUM_ITERATIONS):
        if at.decrement <= NEWTON_DECREMENT * at.cost / n_errors:
            state = FitState.CONVERGED
            break
        trial, damping = _step(at, damping)
        if trial is None:
            # No downhill step is left within rounding: that is the minimum.
            state = FitState.CONVERGED
            break
        at = trial
    if at.decrement <= COARSE_DECREMENT * at.cost / n_errors:
        state = FitState.CONVERGED
    if data.held_log_tau is None:
        low, high = data.log_tau_bounds
        if at.shape[0] <= low + 1e-9:
            state = FitState.AT_LOWER_BOUND
        elif at.shape[0] >= high - 1e-9:
            state = FitState.AT_UPPER_BOUND
    return at, state


def _step(at: Profile, damping: float) -> tuple[Profile | None, float]:
    """Take a damped Gauss-Newton step that lowers the cost, or None when there is none."""
    data = at.data
    # So near the end the cost itself has no digits left to compare.
    blind = at.decrement <= BLIND * at.cost
    while damping < 1e8:
        shape = at.shape.copy()
        shape[data.free] += at.step(damping)
        if data.held_log_tau is None:
            shape[0] = np.clip(shape[0], *data.log_tau_bounds)
        trial = profile(data, shape)
        if trial.cost < at.cost or (blind and trial.cost <= at.cost * (1.0 + BLIND)):
            return trial, max(damping / 10.0, 1e-12)
        damping = max(damping * 10.0, 1e-6)
    return None, damping


def _starts(data: LagData) -> list[FloatArray]:
    """Return the shapes from which to search: armax starts from arx and from output error."""
    if data.is_output_error or data.order == 0:
        return [np.array([_scanned(data), *np.zeros(data.order)])]
    plain = _scanned(replace(data, noise="arx", order=0))
    free_run = _scanned(replace(data, noise="output-error", order=0))
    # Output error is armax with C = A: the other end of the family.
    c = np.zeros(data.order)
    c[0] = -data.lag(free_run).a
    free = MovingAverage.from_coefficients(c).free
    return [np.array([plain, *np.zeros(data.order)]), np.array([free_run, *free])]


def _scanned(data: LagData) -> float:
    """Return the best log τ of a few, or the one that is held."""
    if data.held_log_tau is not None:
        return data.held_log_tau
    low, high = data.log_tau_bounds
    grid = np.linspace(low + np.log(10.0), high - np.log(20.0), SCAN_POINTS)
    costs = [profile(data, np.array([value, *np.zeros(data.order)])).cost for value in grid]
    return float(grid[int(np.argmin(costs))])
