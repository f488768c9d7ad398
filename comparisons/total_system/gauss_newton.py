"""Least squares for common parameters and nuisance states of many segments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from surge_core.types import FloatArray

__all__ = ["Solution", "solve"]

# Residuals of each segment, flat; None where the model did not stay finite.
Residuals = Callable[[FloatArray, FloatArray], "list[FloatArray] | None"]

# Of the scaled parameters: small against what they are to be known to, large against rounding.
_DIFFERENCE = 1e-4
_FIRST_DAMPING = 1e-3
_SMALLEST_DAMPING, _LARGEST_DAMPING = 1e-9, 1e8
# A curvature below this share of the largest is none.
_SINGULAR = 1e-12


@dataclass(frozen=True)
class Solution:
    """Where the search ended.

    Parameters
    ----------
    common : ndarray of shape (p,)
        Common parameters.
    nodes : ndarray of shape (n_segments, k)
        Nuisance states of each segment.
    residuals : tuple of ndarray
        Of each segment, flat.
    covariance : ndarray of shape (p, p)
        Of the common parameters, from the scatter of the segments' gradients; holds for coloured
        residuals and a model that is not quite right.
    cost_trace : tuple of float
        Half the sum of squares after each accepted step, the start first.
    converged : bool
        Whether the last step no longer lowered the cost.
    singular : bool
        Whether some combination of parameters leaves the residuals alone.
    """

    common: FloatArray
    nodes: FloatArray
    residuals: tuple[FloatArray, ...]
    covariance: FloatArray
    cost_trace: tuple[float, ...]
    converged: bool
    singular: bool


def solve(
    residuals: Residuals,
    common: FloatArray,
    nodes: FloatArray,
    *,
    max_iterations: int,
    tolerance: float = 1e-6,
    n_blocks: int = 1,
    progress: Callable[[], object] = lambda: None,
) -> Solution | None:
    """Minimise the sum of squares by damped Gauss-Newton steps.

    The nuisance states of a segment touch its residuals only: one run with a state of every
    segment moved gives that column of all segments, and each segment's states are eliminated
    from the normal equations (Schur complement), so that the cost grows with p + k, not with the
    number of segments.

    Parameters
    ----------
    residuals : callable
        ``residuals(common, nodes)``; None where the model does not stay finite.
    common : ndarray of shape (p,)
        Start, in units of their scales.
    nodes : ndarray of shape (n_segments, k)
        Start, in units of their scales; k may be 0.
    max_iterations : int
        Accepted steps at most.
    tolerance : float
        The search ends with a step that lowers the cost by less than this share.
    n_blocks : int
        Pieces into which one segment alone is cut for the covariance.
    progress : callable
        Called after each step.

    Returns
    -------
    Solution or None
        None when the model is not finite at the start.
    """
    now = residuals(common, nodes)
    if now is None:
        return None
    trace = [_cost(now)]
    damping, converged = _FIRST_DAMPING, False
    columns = _jacobian(residuals, common, nodes, now)
    for _ in range(max_iterations):
        better = _lower(residuals, common, nodes, now, columns, damping)
        if better is None:
            # No step of any length goes down: this is a minimum to the accuracy of the model.
            converged = True
            break
        common, nodes, now, damping = better
        trace.append(_cost(now))
        damping = max(damping / 10.0, _SMALLEST_DAMPING)
        columns = _jacobian(residuals, common, nodes, now)
        progress()
        if trace[-2] - trace[-1] <= tolerance * trace[-1]:
            converged = True
            break
    covariance, singular = _covariance(columns, now, common.size, n_blocks)
    return Solution(common, nodes, tuple(now), covariance, tuple(trace), converged, singular)


def _lower(
    residuals: Residuals,
    common: FloatArray,
    nodes: FloatArray,
    now: list[FloatArray],
    columns: list[FloatArray],
    damping: float,
) -> tuple[FloatArray, FloatArray, list[FloatArray], float] | None:
    """Return the least damped step that lowers the cost, with its damping; None without one."""
    while damping < _LARGEST_DAMPING:
        step, node_steps = _step(columns, now, common.size, damping)
        trial = residuals(common + step, nodes + node_steps)
        if trial is not None and _cost(trial) < _cost(now):
            return common + step, nodes + node_steps, trial, damping
        damping *= 10.0
    return None


def _cost(residuals: Sequence[FloatArray]) -> float:
    return 0.5 * float(sum(r @ r for r in residuals))


def _jacobian(
    residuals: Residuals, common: FloatArray, nodes: FloatArray, now: list[FloatArray]
) -> list[FloatArray]:
    """Return the derivatives of each segment's residuals: common parameters, then its states."""
    columns: list[list[FloatArray]] = [[] for _ in now]
    for i in range(common.size + nodes.shape[1]):
        for size in (_DIFFERENCE, -_DIFFERENCE):
            moved, moved_nodes = common.copy(), nodes.copy()
            if i < common.size:
                moved[i] += size
            else:
                moved_nodes[:, i - common.size] += size
            there = residuals(moved, moved_nodes)
            if there is not None:
                break
        for column, after, before in zip(columns, there or now, now, strict=True):
            column.append((after - before) / size)
    return [np.column_stack(column) for column in columns]


def _step(
    columns: list[FloatArray], now: list[FloatArray], p: int, damping: float
) -> tuple[FloatArray, FloatArray]:
    """Return the damped step of the common parameters and of each segment's states."""
    matrix, right = np.zeros((p, p)), np.zeros(p)
    kept = []
    for jacobian, residual in zip(columns, now, strict=True):
        common, own = jacobian[:, :p], jacobian[:, p:]
        curve = own.T @ own
        curve += damping * np.diag(np.diag(curve) + 1e-12)
        cross, own_right = own.T @ common, own.T @ residual
        solved = _solve(curve, np.column_stack([cross, own_right]))
        kept.append(solved)
        matrix += common.T @ common - cross.T @ solved[:, :p]
        right += common.T @ residual - cross.T @ solved[:, p]
    matrix += damping * np.diag(np.diag(matrix) + 1e-12)
    step = -_solve(matrix, right[:, None])[:, 0]
    node_steps = np.array([-(s[:, p] + s[:, :p] @ step) for s in kept])
    return step, node_steps


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    if matrix.size == 0:
        return np.zeros((0, right.shape[1]))
    # Least norm where two states of a short segment cannot be told apart.
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def _covariance(
    columns: list[FloatArray], now: list[FloatArray], p: int, n_blocks: int
) -> tuple[FloatArray, bool]:
    """Return H⁻¹ (Σ g gᵀ) H⁻¹ over segments, or over the blocks of a single one."""
    matrix = np.zeros((p, p))
    gradients = []
    for jacobian, residual in zip(columns, now, strict=True):
        common, own = jacobian[:, :p], jacobian[:, p:]
        # What the segment's own states can take up says nothing of the common parameters.
        projected = common - own @ np.linalg.lstsq(own, common, rcond=None)[0]
        matrix += projected.T @ projected
        weighted = projected * residual[:, None]
        if len(now) == 1:
            gradients += [block.sum(axis=0) for block in np.array_split(weighted, n_blocks)]
        else:
            gradients.append(weighted.sum(axis=0))
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    normed = matrix / np.outer(scale, scale)
    values = np.linalg.eigvalsh(normed)
    if values[0] <= _SINGULAR * values[-1] or len(gradients) <= p:
        return np.full((p, p), np.nan), bool(values[0] <= _SINGULAR * values[-1])
    inverse = np.linalg.inv(normed) / np.outer(scale, scale)
    g = np.array(gradients)
    # Small-sample factor n/(n − p) of cluster-robust covariances.
    middle = g.T @ g * len(gradients) / (len(gradients) - p)
    return inverse @ middle @ inverse, False
