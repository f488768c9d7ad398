"""The errors of a lag model on a record, evaluated in one pass for a point of all parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from classic_ml.lag.cells import Cells, Knots, cut_into_cells
from classic_ml.lag.kernels import equation_error_pass, output_error_pass, sum_hats
from classic_ml.lag.local_columns import Columns, Eliminated, eliminate
from classic_ml.noise_models import MovingAverage, NoiseKind
from surge_core.lag import FirstOrderLag, Hold
from surge_core.segments import scored_pieces
from surge_core.types import FloatArray, IntArray

__all__ = ["LagProblem", "Pass", "Point", "rows_late"]


@dataclass(frozen=True)
class Point:
    """A value of every parameter.

    Parameters
    ----------
    log_tau : float
        Logarithm of the time constant in seconds.
    dead : float
        Dead time, in samples.
    free : ndarray of shape (order,)
        Parameters ρ of C.
    beta : ndarray of shape (n_terms,)
        Coefficients of the terms as they stand in the problem.
    starts, hats, ripple : ndarray
        Starts of the pieces, values of the drift at its knots, ripple of each run.
    """

    log_tau: float
    dead: float
    free: FloatArray
    beta: FloatArray
    starts: FloatArray
    hats: FloatArray
    ripple: FloatArray


def rows_late(dead: float) -> int:
    """Return how many rows of a run answer to inputs from before it.

    Parameters
    ----------
    dead : float
        Dead time, in samples.
    """
    return int(np.ceil(dead)) + 1 if dead > 0.0 else 0


@dataclass(frozen=True)
class LagProblem:
    """A record and the model that is to predict it.

    Parameters
    ----------
    y : ndarray of shape (n,)
        ψ' as measured.
    terms : ndarray of shape (q, n)
        The terms of the characteristic, a row each.
    weight : ndarray of shape (n,)
        Non-negative; rows of weight 0 are simulated through, not scored.
    root : ndarray of shape (n,) or (0,)
        Square roots of the weights, empty where all are one.
    runs : tuple of slice
        Rows of each segment; no equation straddles two.
    sample_period_s : float
        Sample period, in seconds.
    hold : {"zero", "first"}
        How φ acts between samples.
    noise : {"arx", "armax", "output-error"}
        What the error is taken to be.
    order : int
        Degree of C.
    exact_start : bool
        Give the errors before each stretch their share in the likelihood.
    held_log_tau : float, optional
        log τ, where it is not to be fitted.
    dead : float
        Dead time in samples, held or to start from.
    fit_dead : bool
        Fit the dead time.
    knots : Knots, optional
        Knots of the drift.
    constrained : bool
        The drift has zero mean because no term can take up its constant; else the constant is
        left out of the terms, and the drift carries it.
    omega : ndarray of shape (n_frequencies,)
        Angular frequencies of the ripple, in radians a sample.
    longest_dead : float
        Longest dead time that is tried, in samples.
    """

    y: FloatArray
    terms: FloatArray
    weight: FloatArray
    root: FloatArray
    runs: tuple[slice, ...]
    sample_period_s: float
    hold: Hold
    noise: NoiseKind
    order: int = 0
    exact_start: bool = True
    held_log_tau: float | None = None
    dead: float = 0.0
    fit_dead: bool = False
    knots: Knots | None = None
    constrained: bool = False
    omega: FloatArray = field(default_factory=lambda: np.zeros(0))
    longest_dead: float = 0.0

    @property
    def n_late(self) -> int:
        """Rows at the head of each run that are not scored, since they answer to older inputs."""
        return rows_late(self.longest_dead)

    @property
    def is_output_error(self) -> bool:
        """Whether the free run is fitted."""
        return self.noise == "output-error"

    @property
    def fixed_tau(self) -> bool:
        """Whether τ is held."""
        return self.held_log_tau is not None

    @property
    def ahead(self) -> int:
        """Scored errors before each stretch."""
        return 0 if self.is_output_error or not self.exact_start else self.order

    @property
    def n_shape(self) -> int:
        """Number of parameters that enter non-linearly."""
        return int(not self.fixed_tau) + int(self.fit_dead) + self.order

    @property
    def n_errors(self) -> int:
        """Number of scored errors."""
        _, counts = self.pieces()
        return int(counts.sum()) + self.ahead * int(counts.size)

    def n_parameters(self, n_terms: int) -> int:
        """Return the number of fitted parameters, the start of each scored piece among them.

        Parameters
        ----------
        n_terms : int
            Terms of the characteristic, as the user counts them.
        """
        levels = 0 if self.knots is None else self.knots.n_levels
        ripple = 2 * self.omega.size * len(self.runs)
        starts = self.columns.n_starts * self.pieces()[1].size
        return self.n_shape + n_terms + max(levels - 1, 0) + ripple + starts

    @cached_property
    def columns(self) -> Columns:
        """What the columns of a pass are, after a held τ is left out."""
        n_states = 1 if self.is_output_error else 0
        if not self.is_output_error and (self.ahead > 0 or self.knots is not None):
            n_states = self.order
        n_hats = 0 if self.knots is None else (2 if self.is_output_error else 3)
        return Columns(
            self.n_shape + self.terms.shape[0],
            n_hats,
            n_states,
            1 if self.is_output_error else self.ahead,
            2 * self.omega.size,
            1.0 if self.is_output_error else -1.0,
            0 if self.knots is None else self.knots.n_hats,
            len(self.runs),
        )

    @property
    def log_tau_bounds(self) -> tuple[float, float]:
        """Range of log τ that is searched."""
        longest = max(run.stop - run.start for run in self.runs)
        low = 0.02 * self.sample_period_s
        return float(np.log(low)), float(np.log(20.0 * longest * self.sample_period_s))

    def pieces(self) -> tuple[IntArray, IntArray]:
        """Return the stretches that are predicted as one, and how many rows of each are scored.

        For output error a stretch is a run; an equation looks one row back, so that a row of
        weight 0 ends a stretch and the next begins one row behind it.
        """
        table: list[tuple[int, int, int, int]] = []
        counts: list[int] = []
        plain = self.root.size == 0
        for number, run in enumerate(self.runs):
            if self.is_output_error:
                scored = run.stop - run.start if plain else int(np.count_nonzero(self.weight[run]))
                if scored > 0:
                    table.append((run.start, run.stop, run.start, number))
                    counts.append(scored)
                continue
            stretches = (
                [run] * (run.stop - run.start > 1) if plain else scored_pieces(self.weight, run)
            )
            for piece in stretches:
                table.append((piece.start + 1, piece.stop, run.start, number))
                counts.append(piece.stop - piece.start - 1)
        return (
            np.asarray(table, dtype=np.int64).reshape(-1, 4),
            np.asarray(counts, dtype=np.int64),
        )

    def cells(self, edges: list[IntArray] | None = None) -> Cells:
        """Cut the record into the cells of a pass."""
        scored = None
        if self.is_output_error and self.root.size > 0 and not np.all(self.root > 0.0):
            scored = np.flatnonzero(self.root > 0.0)
        pieces, counts = self.pieces()
        return cut_into_cells(pieces, counts, self.knots, edges, scored, self.ahead)

    def head(self, n_rows: int) -> LagProblem:
        """Return the problem on the first runs, up to about ``n_rows`` rows."""
        runs: list[slice] = []
        left = n_rows
        for run in self.runs:
            if left <= 0:
                break
            runs.append(slice(run.start, min(run.stop, run.start + left)))
            left -= run.stop - run.start
        return replace(self, runs=tuple(runs))

    def lag(self, log_tau: float, dead: float) -> FirstOrderLag:
        """Return the lag of a trial time constant."""
        period = self.sample_period_s
        return FirstOrderLag(float(np.exp(log_tau)), period, self.hold, dead * period)

    def start_weight(self, cells: Cells) -> FloatArray:
        """Return the weight of the errors ahead of each piece: that of its first row."""
        firsts = cells.rows[cells.rows[:, 3] == 1, 0]
        return self.weight[firsts] if self.root.size else np.ones(firsts.size)

    def mean_of_hats(self) -> FloatArray:
        """Return the weighted sum of each hat of the drift."""
        if self.knots is None:
            return np.zeros(0)
        sums = np.zeros(self.knots.n_hats)
        for number, run in enumerate(self.runs):
            weight = self.weight[run] if self.root.size else np.zeros(0)
            first, intervals = self.knots.first[number], self.knots.intervals[number]
            part = sums[first : first + max(intervals, 1) + 1]
            sum_hats(run.stop - run.start, self.knots.steps[number], intervals, weight, part)
        return sums

    def point(self, log_tau: float, dead: float, free: FloatArray, cells: Cells) -> Point:
        """Return a point with everything linear at zero."""
        columns = self.columns
        return Point(
            log_tau,
            dead,
            free,
            np.zeros(self.terms.shape[0]),
            np.zeros(cells.piece_lengths.size * columns.n_starts),
            np.zeros(columns.all_hats),
            np.zeros((columns.n_runs, columns.n_waves)),
        )

    def evaluate(self, point: Point, cells: Cells, mean: FloatArray, errors: FloatArray) -> Pass:
        """Pass over the record once.

        Parameters
        ----------
        point : Point
            Where.
        cells : Cells
            How the record is cut.
        mean : ndarray
            What :meth:`mean_of_hats` gave.
        errors : ndarray of shape (n_errors,)
            Takes the weighted errors.
        """
        lag, columns = self.lag(point.log_tau, point.dead), self.columns
        n_shape = 1 + int(self.fit_dead) + self.order
        n_local = columns.n_hats + columns.n_states
        p = 1 + n_shape + self.terms.shape[0] + n_local + columns.n_waves
        grams = np.zeros((cells.rows.shape[0], p, p))
        ends = np.zeros((cells.rows.shape[0], columns.n_states, n_local))
        arguments = (
            self.y,
            self.terms,
            self.root,
            cells.rows,
            cells.knots,
            lag.whole_samples,
            lag.taps,
            lag.a,
            lag.d_a,
            int(self.fit_dead),
            point.beta,
            point.starts,
            point.hats,
            self.omega,
            point.ripple,
            cells.slots,
            errors,
            grams,
            ends,
        )
        start_weight = self.start_weight(cells)
        if self.is_output_error:
            output_error_pass(*arguments)
        else:
            whitener = MovingAverage(point.free)
            c, d_c = whitener.coefficients, np.ascontiguousarray(whitener.jacobian)
            equation_error_pass(*arguments, c, d_c, columns.n_states)
            for o in range(cells.ahead):
                # From the oldest error to the newest, as time goes.
                slots = cells.piece_slots + cells.ahead - 1 - o
                errors[slots] = point.starts[o :: self.order] * np.sqrt(start_weight)
        if self.fixed_tau:
            grams = np.ascontiguousarray(np.delete(np.delete(grams, 1, 1), 1, 2))
        solved = eliminate(cells, columns, grams, ends, start_weight, point.starts, mean)
        raw_cost = float(errors @ errors)
        return Pass(self, point, cells, grams, solved, errors, raw_cost, start_weight, mean)


@dataclass(frozen=True)
class Pass:
    """What one pass gave.

    Parameters
    ----------
    problem, point, cells
        What was evaluated where.
    grams : ndarray of shape (n_cells, p, p)
        Inner products of each cell.
    solved : Eliminated
        The normal equations without the local unknowns.
    errors : ndarray of shape (n_errors,)
        Weighted errors at the point, until the next pass overwrites them.
    raw_cost : float
        Sum of their squares.
    start_weight, mean : ndarray
        Weights of the errors ahead, weighted sums of the hats.
    """

    problem: LagProblem
    point: Point
    cells: Cells
    grams: FloatArray
    solved: Eliminated
    errors: FloatArray
    raw_cost: float
    start_weight: FloatArray
    mean: FloatArray

    @property
    def reduced(self) -> FloatArray:
        """Gram matrix of [shape, β, e], the local unknowns optimised away."""
        whole = self.solved.reduced
        if self.problem.constrained and whole[-1, -1] < 0.0:
            # Zero mean of the drift: what the constant took away is given back.
            whole = whole - np.outer(whole[:, -1], whole[-1]) / whole[-1, -1]
        return np.asarray(whole[:-1, :-1])

    def moved(self, move: FloatArray, shape: FloatArray) -> Point:
        """Return the point after a step of β, the local unknowns following.

        Parameters
        ----------
        move : ndarray of shape (n_shape + n_terms,)
            Step of all global parameters, by which the local ones are led.
        shape : ndarray of shape (3, …) as [log τ, dead, ρ]
            The shape of the new point.
        """
        problem, point, solved = self.problem, self.point, self.solved
        columns, g = problem.columns, move.size
        band = solved.local[:, g] - solved.local[:, :g] @ move
        wave = solved.wave[:, :, g] - solved.wave[:, :, :g] @ move
        hats = _picked(band, solved.hat_number)
        if problem.constrained and solved.reduced[-1, -1] < 0.0:
            excess = float(self.mean @ hats) / -float(solved.reduced[-1, -1])
            band = band - solved.local[:, -1] * excess
            wave = wave - solved.wave[:, :, -1] * excess
            hats = _picked(band, solved.hat_number)
        return Point(
            float(shape[0]),
            float(shape[1]),
            shape[2:],
            point.beta + move[g - point.beta.size :],
            point.starts + _picked(band, solved.start_number),
            point.hats + hats,
            point.ripple + wave if columns.n_waves else point.ripple,
        )


def _picked(values: FloatArray, numbers: IntArray) -> FloatArray:
    if numbers.size == 0:
        return np.zeros(0)
    return np.where(numbers >= 0, values[np.maximum(numbers, 0)], 0.0)
