"""Separable prediction-error fits of the lag model, one pass over the record a step.

Minimising Σ w e² over the one-step (arx, armax) or free-run (output-error) errors e is maximum
likelihood for Gaussian e (Åström 1980, the paper's Reference 5). The characteristic's β, the
drift, the ripple and the start of each run enter linearly, so that the search runs over log τ, the
dead time and the parameters of C alone (variable projection, Golub and Pereyra 1973). A pass gives
the errors, all derivatives and their inner products; the errors themselves are always made anew
from the record, so that rounding in the inner products slows the search but does not move its end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from classic_ml.lag.cells import Cells
from classic_ml.lag.prediction import LagProblem, Pass, Point
from surge_core.fit_state import FitState
from surge_core.types import FloatArray, IntArray

__all__ = ["Bench", "Fit", "pseudo_inverse", "scan", "search"]

MAXIMUM_ITERATIONS = 200
# With C near the unit circle the last steps shrink slowly: a hundredth of a standard error short of
# the minimum is still at it.
COARSE_DECREMENT = 1e-4
# A step of 1e-4 standard errors changes nothing that is ever printed; of 1e-7 no test.
NEWTON_DECREMENT = 1e-8
FINE_DECREMENT = 1e-14
LONG_RECORD = 200_000
# Of a scaled eigenvalue: less is a copy of other columns within the rounding of inner products.
NO_DIRECTION = 1e-13
# Linear parameters so far off that the derivatives have to be taken anew (share of the cost).
STALE = 1e-3
# Of the cost: smaller differences between two passes are rounding.
BLIND = 1e-11


@dataclass(frozen=True)
class Fit:
    """A pass with its linear parameters at their optimum.

    Parameters
    ----------
    at : Pass
        The pass.
    cost : float
        Sum of squares, everything linear optimised.
    linear : ndarray of shape (n_terms,)
        Step of β that is still to be made.
    gradient, curvature : ndarray
        Downhill slope and curvature of half the cost in the shape parameters.
    following : ndarray of shape (n_terms, n_shape)
        How β gives way to a step of the shape.
    """

    at: Pass
    cost: float
    linear: FloatArray
    gradient: FloatArray
    curvature: FloatArray
    following: FloatArray

    @property
    def n_errors(self) -> int:
        """Number of scored errors."""
        return self.at.cells.n_errors

    @property
    def movable(self) -> NDArray[np.bool_]:
        """Which shape parameters may move: not those pressed against a bound."""
        problem, point = self.at.problem, self.at.point
        free = np.ones(self.gradient.size, dtype=np.bool_)
        if problem.fit_dead:
            at, slope = int(not problem.fixed_tau), self.gradient[int(not problem.fixed_tau)]
            outward = (point.dead <= 0.0 and slope < 0.0) or (
                point.dead >= problem.longest_dead and slope > 0.0
            )
            free[at] = not outward
        return free

    @property
    def decrement(self) -> float:
        """What a Newton step would take from the cost."""
        free = self.movable
        if not np.any(free):
            return 0.0
        slope = self.gradient[free]
        return float(slope @ np.linalg.lstsq(self.curvature[np.ix_(free, free)], slope)[0])

    @property
    def shape(self) -> FloatArray:
        """Return log τ, dead time and ρ in one array."""
        point = self.at.point
        return np.concatenate([[point.log_tau, point.dead], point.free])


@dataclass(frozen=True)
class Bench:
    """A problem cut into cells, with room for its errors.

    Parameters
    ----------
    problem : LagProblem
        Record and model.
    cells : Cells
        How the record is cut.
    mean : ndarray
        Weighted sums of the hats of the drift.
    errors : ndarray of shape (n_errors,)
        Taken up anew by every pass.
    """

    problem: LagProblem
    cells: Cells
    mean: FloatArray
    errors: FloatArray

    @classmethod
    def of(cls, problem: LagProblem, edges: list[IntArray] | None = None) -> Bench:
        """Set up a problem, its pieces cut at the edges of the jackknife's blocks."""
        cells = problem.cells(edges)
        return cls(problem, cells, problem.mean_of_hats(), np.zeros(cells.n_errors))

    def origin(self, shape: FloatArray, beta: FloatArray | None = None) -> Point:
        """Return the point of a shape [log τ, dead time, ρ] with all but β at zero."""
        point = self.problem.point(float(shape[0]), float(shape[1]), shape[2:], self.cells)
        return point if beta is None else replace(point, beta=beta)

    def fit_at(self, point: Point, *, fresh: bool = True) -> Fit:
        """Pass over the record; again where the linear parameters had been far off."""
        fit = _profiled(self.problem.evaluate(point, self.cells, self.mean, self.errors))
        if fresh and fit.at.raw_cost - fit.cost > STALE * fit.cost:
            fit = self.at_optimum(fit)
        return fit

    def at_optimum(self, fit: Fit) -> Fit:
        """Pass over the record with the linear parameters where the last pass put them.

        Parameters
        ----------
        fit : Fit
            A pass over the same problem, maybe cut otherwise.
        """
        point = _after(fit, np.zeros(self.problem.n_shape), fit.shape)
        return _profiled(self.problem.evaluate(point, self.cells, self.mean, self.errors))


def pseudo_inverse(matrix: FloatArray) -> FloatArray:
    """Invert a normal matrix after scaling it, leaving out what is rounding.

    Parameters
    ----------
    matrix : ndarray of shape (p, p)
        Symmetric, positive semi-definite.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    kept = values > NO_DIRECTION
    half = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray((half @ half.T) / np.outer(scale, scale))


def _profiled(at: Pass) -> Fit:
    """Optimise everything linear, and say where the cost falls in the shape parameters."""
    gram, n_shape = at.reduced, at.problem.n_shape
    cross, corner = gram[:n_shape, n_shape:-1], gram[n_shape:-1, -1]
    inverse = pseudo_inverse(gram[n_shape:-1, n_shape:-1])
    linear = inverse @ corner
    return Fit(
        at,
        max(float(gram[-1, -1] - corner @ linear), 0.0),
        linear,
        gram[:n_shape, -1] - cross @ linear,
        gram[:n_shape, :n_shape] - cross @ inverse @ cross.T,
        inverse @ cross.T,
    )


def _after(fit: Fit, step: FloatArray, shape: FloatArray) -> Point:
    """Return the point after a step of the shape, the linear parameters following it."""
    return fit.at.moved(np.concatenate([step, fit.linear - fit.following @ step]), shape)


def scan(bench: Bench, log_taus: FloatArray, tail: FloatArray) -> tuple[float, float]:
    """Return the log τ of least cost on a grid, and that cost, the rest held at ``tail``.

    Parameters
    ----------
    bench : Bench
        The problem.
    log_taus : ndarray of shape (n,)
        Trial values.
    tail : ndarray
        Dead time in samples, and ρ.
    """
    costs = []
    for value in log_taus:
        point = bench.origin(np.concatenate([[value], tail]))
        costs.append(bench.fit_at(point, fresh=False).cost)
    best = int(np.argmin(costs))
    return float(log_taus[best]), costs[best]


def search(bench: Bench, starts: list[Point]) -> tuple[Fit, FitState]:
    """Refine from each start and return the best fit, and how it ended.

    Parameters
    ----------
    bench : Bench
        The problem.
    starts : list of Point
        Points to start from; all are refined.
    """
    ends = [_refine(bench, start) for start in starts]
    return min(ends, key=lambda end: end[0].cost)


def _refine(bench: Bench, start: Point) -> tuple[Fit, FitState]:
    problem = bench.problem
    low, high = problem.log_tau_bounds
    if not problem.fixed_tau:
        start = replace(start, log_tau=float(np.clip(start.log_tau, low, high)))
    fit = bench.fit_at(start)
    tolerance = NEWTON_DECREMENT if fit.n_errors > LONG_RECORD else FINE_DECREMENT
    damping, state = 1e-3, FitState.NOT_CONVERGED
    for _ in range(MAXIMUM_ITERATIONS):
        if fit.decrement <= tolerance * fit.cost / fit.n_errors:
            state = FitState.CONVERGED
            break
        trial, damping = _step(bench, fit, damping)
        if trial is None:
            # No downhill step is left within rounding: that is the minimum.
            state = FitState.CONVERGED
            break
        fit = trial
    if fit.decrement <= COARSE_DECREMENT * fit.cost / fit.n_errors:
        state = FitState.CONVERGED
    if not problem.fixed_tau:
        if fit.at.point.log_tau <= low + 1e-9:
            state = FitState.AT_LOWER_BOUND
        elif fit.at.point.log_tau >= high - 1e-9:
            state = FitState.AT_UPPER_BOUND
    return fit, state


def _step(bench: Bench, fit: Fit, damping: float) -> tuple[Fit | None, float]:
    """Take a damped Gauss-Newton step that lowers the cost, or None when there is none."""
    problem = bench.problem
    # So near the end the cost itself has no digits left to compare.
    blind = fit.decrement <= BLIND * fit.cost
    free = fit.movable
    while damping < 1e8:
        damped = fit.curvature + damping * np.diag(np.diag(fit.curvature) + 1e-300)
        move = np.zeros(free.size)
        move[free] = np.linalg.lstsq(damped[np.ix_(free, free)], fit.gradient[free])[0]
        # log τ and ρ are of order one: longer moves leave the region where the slope holds.
        move *= min(1.0, 1.5 / max(float(np.max(np.abs(move))), 1e-300))
        shape, move = _bounded(problem, fit.shape, move)
        trial = bench.fit_at(_after(fit, move, shape))
        if trial.cost < fit.cost or (blind and trial.cost <= fit.cost * (1.0 + BLIND)):
            return trial, max(damping / 10.0, 1e-12)
        damping = max(damping * 10.0, 1e-6)
    return None, damping


def _bounded(
    problem: LagProblem, shape: FloatArray, move: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the shape after a move, and the move that the bounds left of it."""
    free = np.ones(shape.size, dtype=np.bool_)
    free[0], free[1] = not problem.fixed_tau, problem.fit_dead
    after = shape.copy()
    after[free] += move
    if not problem.fixed_tau:
        after[0] = np.clip(after[0], *problem.log_tau_bounds)
    if problem.fit_dead:
        after[1] = np.clip(after[1], 0.0, problem.longest_dead)
    return after, (after - shape)[free]
