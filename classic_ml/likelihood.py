"""Prediction errors of the lag model, linear in all but τ and C, and their derivatives.

Minimising Σ w e² over the one-step (arx, armax) or free-run (output-error) errors e is maximum
likelihood for Gaussian e (Åström 1980, the paper's Reference 5). For a shape (log τ, ρ) the
errors are target - columns β - drift - starts, so that all of these follow by linear least
squares and a search runs over the shape alone (variable projection, Golub and Pereyra 1973). A fit
is linearised there, and that says what it would be without one cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from classic_ml.lag_data import LagData, MovingAverage, Terms
from surge_core.lag import FirstOrderLag
from surge_core.leave_out import leave_out
from surge_core.segments import runs_of
from surge_core.types import FloatArray, IntArray

# Fewer segments are cut, so that the others can say what is usual: with six, clean records raise
# an alarm in 5 to 20 % of the cases instead of 1 to 3 %.
FEWEST_CYCLES = 10
PIECES = 12


@dataclass(frozen=True)
class LinearisedFit:
    """The errors of a fit and their derivatives."""

    errors: FloatArray  # (n,): Of the scored rows, times the root of their weights
    # (n, p): ∂e/∂θ, θ = (τ in seconds, coefficients of nearly orthogonal terms, drift, C)
    jacobian: FloatArray
    back: FloatArray  # (q, r): What turns those coefficients into β
    rows: IntArray  # (n,): Row of the data that each error belongs to
    pieces: tuple[slice, ...]  # Stretches of errors that follow each other without a gap
    segment: IntArray  # (n,): Number of the segment, from 0, of each error


def linearised(data: LagData, terms: Terms, shape: FloatArray, beta: FloatArray) -> LinearisedFit:
    """Linearise about given parameters; starts and drift are the best for these."""
    at = profile(data, shape, beta)
    both, n_shape = at.jacobian, at.n_shape
    # ∂e/∂τ from ∂e/∂log τ; a held τ does not move.
    fitted = int(data.held_log_tau is None)
    tau = both[:, :1] / np.exp(shape[0]) if fitted else np.zeros((both.shape[0], 1))
    keep = data.scored
    rows = data.rows_of_errors[keep]
    lengths = [run.stop - run.start for run in data.runs]
    segment = np.repeat(np.arange(len(lengths)), lengths)[rows]
    # Rows that follow each other within a segment have one such label.
    pieces = runs_of(rows - np.arange(rows.size) + 2 * segment * data.y.size, rows.size)
    return LinearisedFit(
        at.errors[keep],
        np.column_stack([tau, both[:, n_shape:], both[:, fitted:n_shape]])[keep],
        terms.back,
        rows,
        tuple(pieces),
        segment,
    )


@dataclass(frozen=True)
class CycleShifts:
    """How far each parameter of a linearised fit moves without each cycle.

    ``shift`` of shape (n_cycles, p) is θ without the cycle minus θ, ``spread`` its covariance for
    white errors of unit variance, (J'J - A_g)⁻¹ - (J'J)⁻¹; ``edges`` are the first and the last row
    of each cycle.
    """

    shift: FloatArray
    spread: FloatArray
    edges: IntArray

    def studentised(self, contrasts: FloatArray) -> FloatArray:
        """Return each shift over what shifts of the other cycles make usual.

        ``contrasts`` of shape (k, p) are linear functions of θ, e.g. τ alone or the curve at one φ.
        The result, of shape (n_cycles, k), is Student's t with ``n_cycles - 2`` degrees of freedom
        where all cycles are alike. The shift is scaled by what the cycle's share of the information
        predicts, so that a long cycle may move more than a short one; the common scale is that of
        the other cycles (externally studentised), so that coloured errors do not count against one.
        """
        moved = self.shift @ contrasts.T
        variance = np.einsum("ki,gij,kj->gk", contrasts, self.spread, contrasts)
        scaled = moved / np.sqrt(np.maximum(variance, np.finfo(np.float64).tiny))
        n = len(scaled)
        power = np.sum(scaled**2, axis=0)
        # One direction of the shifts is spent on the estimate itself: they add up to nothing.
        share = scaled**2 * n / (n - 1.0) / np.maximum(power, np.finfo(np.float64).tiny)
        left = np.maximum(1.0 - share, 1e-12)
        return np.asarray(np.sign(scaled) * np.sqrt(share * (n - 2.0) / left))


def cycle_shifts(fit: LinearisedFit) -> CycleShifts:
    """Leave out one cycle at a time: a segment each, but fewer than ten are cut into a dozen."""
    cycles = runs_of(fit.segment, fit.segment.size)
    if len(cycles) < FEWEST_CYCLES:
        parts = [max(1, round(PIECES * (c.stop - c.start) / fit.errors.size)) for c in cycles]
        cuts = [
            np.linspace(cycle.start, cycle.stop, n + 1).astype(int)
            for cycle, n in zip(cycles, parts, strict=True)
        ]
        cycles = [slice(*ends) for edges in cuts for ends in pairwise(edges) if ends[1] > ends[0]]
    moves, inverse = leave_out(fit.jacobian, fit.errors, cycles)
    _, whole = leave_out(fit.jacobian, fit.errors, [slice(0, 0)])
    edges = fit.rows[[[cycle.start, cycle.stop - 1] for cycle in cycles]]
    return CycleShifts(moves, inverse - whole, edges)


# Below this a start adds less than a rounding error.
FORGOTTEN = 1e-17


@dataclass(frozen=True)
class Start:
    """What the unknown start of a piece adds to those errors that still feel it.

    The columns of ``basis`` are orthonormal; ``size`` is the norm of the one column a^k of output
    error.
    """

    errors: slice
    basis: FloatArray
    size: float


@dataclass(frozen=True)
class Profile:
    """The weighted errors at a shape (log τ, ρ), everything linear at its optimum.

    ``beta`` and ``levels`` are the coefficients of terms and drift, ``columns`` are
    -∂e/∂(beta, levels) with the starts projected out, ``offsets`` the coefficients of the starts
    for output error. Near it the cost is a parabola in the free shape parameters, everything linear
    following (Gauss-Newton).
    """

    data: LagData
    shape: FloatArray
    beta: FloatArray
    levels: FloatArray
    errors: FloatArray
    columns: FloatArray
    starts: tuple[Start, ...]
    offsets: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.errors @ self.errors)

    @property
    def n_shape(self) -> int:
        """Number of free shape parameters."""
        return int(self.data.free.sum())

    @cached_property
    def jacobian(self) -> FloatArray:
        """∂e/∂(free shape, β, drift), the starts projected out."""
        both = np.zeros((self.errors.size, self.n_shape + self.columns.shape[1]), order="F")
        slopes = both[:, : self.n_shape]
        if self.data.is_output_error:
            _slopes_of_free_run(self, slopes)
        else:
            _slopes_of_equations(self, slopes)
        slopes *= self.data.root[:, None]
        _project(self.starts, slopes)
        both[:, self.n_shape :] = -self.columns
        return both

    @cached_property
    def normal(self) -> FloatArray:
        """Inner products of the columns of shape and β, the drift at its optimum."""
        gram = self.jacobian.T @ self.jacobian
        return _eliminated(gram, self.n_shape + self.beta.size) if self.levels.size else gram

    @cached_property
    def curvature(self) -> FloatArray:
        """Half the curvature of the cost."""
        return _eliminated(self.normal, self.n_shape)

    @cached_property
    def slope(self) -> FloatArray:
        """Half the downhill slope of the cost."""
        return np.asarray(-self.jacobian[:, : self.n_shape].T @ self.errors)

    @cached_property
    def decrement(self) -> float:
        """What a full step to the minimum would take from the cost."""
        if not self.slope.size:
            return 0.0
        return float(self.slope @ np.linalg.lstsq(self.curvature, self.slope)[0])

    def step(self, damping: float) -> FloatArray:
        """Return a damped step to the minimum."""
        diagonal = np.diag(self.curvature)
        # A parameter that moves nothing gets a pivot that leaves it where it is.
        pivots = damping * diagonal + 1e-30 * np.max(diagonal, initial=0.0) + 1e-300
        move = np.linalg.solve(self.curvature + np.diag(pivots), self.slope)
        # log τ and ρ are of order one: longer moves leave the region where the slope holds.
        longest = max(float(np.max(np.abs(move), initial=0.0)), 1e-300)
        return np.asarray(move * min(1.0, 1.5 / longest))


def _eliminated(gram: FloatArray, kept: int) -> FloatArray:
    """Return inner products of the first columns, all others at their optimum."""
    cross = gram[:kept, kept:]
    return np.asarray(gram[:kept, :kept] - cross @ np.linalg.lstsq(gram[kept:, kept:], cross.T)[0])


def profile(data: LagData, shape: FloatArray, beta: FloatArray | None = None) -> Profile:
    """Return the errors at a shape, with the best drift and starts, and the best β if not given."""
    lag, whitener = data.lag(shape[0]), MovingAverage(shape[1:])
    both = _columns_and_target(data, lag, whitener)
    starts = _starts(data, lag, whitener)
    taken = _project(starts, both)
    gram = both.T @ both
    r = data.terms.shape[1]
    linear: FloatArray
    if beta is None:
        linear = np.asarray(np.linalg.lstsq(gram[:-1, :-1], gram[:-1, -1])[0], np.float64)
    else:
        right = gram[r:-1, -1] - gram[r:-1, :r] @ beta
        linear = np.concatenate([beta, np.linalg.lstsq(gram[r:-1, r:-1], right)[0]])
    errors = both[:, -1] - both[:, :-1] @ linear
    offsets = np.zeros(0)
    if data.is_output_error:
        offsets = taken[:, -1] - taken[:, :-1] @ linear
    return Profile(data, shape, linear[:r], linear[r:], errors, both[:, :-1], starts, offsets)


def _project(starts: tuple[Start, ...], both: FloatArray) -> FloatArray:
    """Remove from each column what a start can explain of it, and return the first of each."""
    taken = np.zeros((len(starts), both.shape[1]))
    for number, start in enumerate(starts):
        share = start.basis.T @ both[start.errors]
        both[start.errors] -= start.basis @ share
        taken[number] = share[0]
    return taken


def _columns_and_target(data: LagData, lag: FirstOrderLag, whitener: MovingAverage) -> FloatArray:
    """Return the columns of β and of the drift with the target behind them, weighted.

    Output error: the free run of each term (Eq 6). It runs on from segment to segment: what that
    adds to a segment is its start, which is projected out. Equation error: the terms as they act in
    Eq 9, and ψ'[k] - a ψ'[k-1], sent through 1/C. The drift adds to ψ' itself.
    """
    rows, before = data.rows_of_errors, data.rows_of_errors - 1
    r, d = data.terms.shape[1], data.drift.shape[1]
    both = np.zeros((rows.size, r + d + 1), order="F")
    if data.is_output_error:
        both[:, :r] = lag.respond(data.terms, data.terms[0])[rows]
        both[:, r:-1] = data.drift[rows]
        both[:, -1] = data.y[rows]
    else:
        both[:, :r] = lag.drive(data.terms)[before]
        both[:, r:-1] = data.drift[rows] - lag.a * data.drift[before]
        both[:, -1] = data.y[rows] - lag.a * data.y[before]
        both[data.ahead_places] = 0.0
        both = _whitened(data, whitener, both)
    both *= data.root[:, None]
    return both


def _whitened(data: LagData, whitener: MovingAverage, rows: FloatArray) -> FloatArray:
    """Return C⁻¹ rows, piece by piece.

    With errors ahead of each piece all go through one filter: what it carries into a piece shows
    in these too, and is projected out with them.
    """
    if data.ahead:
        return whitener.whiten(rows)
    return np.concatenate([whitener.whiten(rows[piece.errors]) for piece in data.pieces])


def _starts(data: LagData, lag: FirstOrderLag, whitener: MovingAverage) -> tuple[Start, ...]:
    longest = max((piece.rows.stop - piece.rows.start for piece in data.pieces), default=0)
    if data.is_output_error:
        felt = min(int(-np.log(FORGOTTEN) / lag.ratio) + 2, longest)
        column = lag.decay(felt)[:, None]
    elif data.ahead:
        decades = min(np.log(max(whitener.largest_root, 1e-3)), -1e-9)
        felt = min(int(np.log(FORGOTTEN) / decades) + 2 * data.order + 2, longest)
        # The errors before a stretch are unknown but not free: innovations like all others, they
        # stand as rows of their own ahead of its equations (unconditional least squares, Box and
        # Jenkins 1976). Taken as zero, the classical recursion, they bias τ on short segments.
        before = whitener.whiten(whitener.reach(felt))
        column = np.concatenate([-np.eye(data.order), before])
    else:
        return ()
    starts = []
    for piece in data.pieces:
        stop = min(piece.errors.stop, piece.errors.start + column.shape[0])
        where = slice(piece.errors.start, stop)
        own = column[: stop - piece.errors.start] * data.root[where, None]
        size = float(np.sqrt(own[:, 0] @ own[:, 0]))
        one = own.shape[1] == 1
        basis = own / (size or 1.0) if one else np.linalg.qr(own)[0]
        starts.append(Start(where, basis, size))
    return tuple(starts)


def _slopes_of_free_run(at: Profile, slopes: FloatArray) -> None:
    """Fill in ∂e/∂(log τ), everything linear held."""
    data = at.data
    if data.held_log_tau is not None:
        return
    lag = data.lag(at.shape[0])
    quasi_steady = data.terms @ at.beta
    state = lag.respond(quasi_steady, quasi_steady[0])
    slopes[:, 0] = -lag.d_respond(quasi_steady, state)[data.rows_of_errors]
    for start, offset in zip(at.starts, at.offsets, strict=True):
        if start.size > 0.0:
            # ∂a^k/∂log τ = k (h/τ) a^k.
            k = np.arange(start.basis.shape[0])
            slopes[start.errors, 0] -= offset / start.size * k * lag.ratio * lag.decay(k.size)


def _slopes_of_equations(at: Profile, slopes: FloatArray) -> None:
    """Fill in ∂e/∂(log τ, ρ), everything linear held."""
    data = at.data
    lag, whitener = data.lag(at.shape[0]), MovingAverage(at.shape[1:])
    before, quasi_steady = data.rows_of_errors - 1, data.terms @ at.beta
    if data.held_log_tau is None:
        measured = data.y - data.drift @ at.levels
        slopes[:, 0] = -lag.d_a * measured[before] - lag.drive(quasi_steady, 1)[before]
    if data.order:
        slopes[:, -data.order :] = _late_errors(at) @ -whitener.jacobian
    slopes[data.ahead_places] = 0.0
    slopes[:] = _whitened(data, whitener, slopes)


def _late_errors(at: Profile) -> FloatArray:
    """Return e[k-1] and e[k-2] beside each equation, of shape (m, order)."""
    data = at.data
    errors = at.errors / data.root
    late = np.zeros((errors.size, data.order))
    for back in range(1, data.order + 1):
        late[back:, back - 1] = errors[:-back]
        if not data.ahead:
            begins = np.array([piece.errors.start for piece in data.pieces])
            late[np.add.outer(begins, np.arange(back)).ravel(), back - 1] = 0.0
    return late
