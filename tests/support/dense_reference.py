"""The lag model fitted with whole matrices: slow, plain, and the measure of the streaming fit.

Every column is kept over the whole record and solved by QR, the drift and the starts included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve
from sklearn.preprocessing import PolynomialFeatures

from classic_ml.noise_models import MovingAverage
from classic_ml.records import FloatArray
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag, Hold
from surge_core.segments import runs_of, scored_pieces

MAXIMUM_ITERATIONS = 60
NEWTON_DECREMENT = 1e-16
LOWER_PERIODS = 0.02
UPPER_RECORDS = 20.0


@dataclass(frozen=True)
class LagData:
    """What one fit sees.

    Parameters
    ----------
    y : ndarray of shape (n,)
        ψ' as measured.
    terms : ndarray of shape (n, q)
        The s_i(φ) at each sample.
    drift : ndarray of shape (n, d)
        Columns that add to the output without the lag.
    weight : ndarray of shape (n,)
        Non-negative; rows of weight 0 are simulated through, not scored.
    runs : tuple of slice
        Rows of each segment; no equation straddles two.
    sample_period_s : float
        Sample period, in seconds.
    hold : {"zero", "first"}
        How φ acts between samples.
    """

    y: FloatArray
    terms: FloatArray
    drift: FloatArray
    weight: FloatArray
    runs: tuple[slice, ...]
    sample_period_s: float
    hold: Hold

    def lag(self, log_tau: float) -> FirstOrderLag:
        """Return the lag of a trial time constant."""
        return FirstOrderLag(float(np.exp(log_tau)), self.sample_period_s, self.hold)

    @property
    def n_linear(self) -> int:
        """Number of linear parameters: the β_i and the drift."""
        return int(self.terms.shape[1] + self.drift.shape[1])

    @property
    def log_tau_bounds(self) -> tuple[float, float]:
        """Range of log τ that is searched."""
        longest = max(run.stop - run.start for run in self.runs)
        low = LOWER_PERIODS * self.sample_period_s
        return float(np.log(low)), float(np.log(UPPER_RECORDS * longest * self.sample_period_s))

    def head(self, n_rows: int) -> LagData:
        """Return the first runs, up to about ``n_rows`` rows, for a cheap scan."""
        runs: list[slice] = []
        left = n_rows
        for run in self.runs:
            if left <= 0:
                break
            runs.append(slice(run.start, min(run.stop, run.start + left)))
            left -= run.stop - run.start
        end = runs[-1].stop
        return LagData(
            self.y[:end],
            self.terms[:end],
            self.drift[:end],
            self.weight[:end],
            tuple(runs),
            self.sample_period_s,
            self.hold,
        )


class PredictionModel(Protocol):
    """A way of predicting ψ', linear in β for given shape parameters (log τ and C)."""

    @property
    def data(self) -> LagData:
        """What is fitted."""

    def linear(self, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return target (n,) and columns (n, p) of the weighted linear problem."""

    def sensitivities(
        self, shape: FloatArray, coef: FloatArray, innovations: FloatArray
    ) -> FloatArray:
        """Return ∂e/∂shape (n, n_shape) of e = target - columns @ coef."""

    def piece_lengths(self) -> list[int]:
        """Return the number of scored rows of each stretch, in order."""

    def rows_of_errors(self) -> NDArray[np.int64]:
        """Return the row of each error, -1 where it has none."""


@dataclass(frozen=True)
class OutputError:
    """e = ψ' - free run; each run has a start of its own, projected out of every column."""

    data: LagData

    def linear(self, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return target and columns of the weighted linear problem."""
        lag = self.data.lag(shape[0])
        blocks = []
        for run in self._scored_runs():
            terms = self.data.terms[run]
            responses = lag.respond(terms, terms[0])
            both = np.column_stack([self.data.y[run], responses, self.data.drift[run]])
            blocks.append(self._project(run, lag, both))
        stacked = np.concatenate(blocks)
        return stacked[:, 0], stacked[:, 1:]

    def sensitivities(
        self, shape: FloatArray, coef: FloatArray, innovations: FloatArray
    ) -> FloatArray:
        """Return ∂e/∂(log τ)."""
        lag = self.data.lag(shape[0])
        starts = self.starts(shape, coef)
        beta = coef[: self.data.terms.shape[1]]
        blocks = []
        for run, start in zip(self._scored_runs(), starts, strict=True):
            quasi_steady = self.data.terms[run] @ beta
            state = lag.respond(quasi_steady, start)
            slope = -lag.d_respond(quasi_steady, state)[:, None]
            blocks.append(self._project(run, lag, slope))
        return np.concatenate(blocks)

    def starts(self, shape: FloatArray, coef: FloatArray) -> list[float]:
        """Return the least-squares start of each scored run."""
        lag = self.data.lag(shape[0])
        n_terms = self.data.terms.shape[1]
        starts = []
        for run in self._scored_runs():
            quasi_steady = self.data.terms[run] @ coef[:n_terms]
            error = self.data.y[run] - lag.respond(quasi_steady, quasi_steady[0])
            error -= self.data.drift[run] @ coef[n_terms:]
            decay = lag.decay(error.size) * np.sqrt(self.data.weight[run])
            power = float(decay @ decay)
            error = error * np.sqrt(self.data.weight[run])
            starts.append(float(quasi_steady[0] + (decay @ error / power if power > 0 else 0.0)))
        return starts

    def rows_of_errors(self) -> NDArray[np.int64]:
        """Return the row of each error."""
        rows = np.concatenate([np.arange(run.start, run.stop) for run in self._scored_runs()])
        return np.asarray(rows[self.data.weight[rows] > 0.0], dtype=np.int64)

    def piece_lengths(self) -> list[int]:
        """Return the number of scored rows of each run."""
        return [int(np.count_nonzero(self.data.weight[run])) for run in self._scored_runs()]

    def _scored_runs(self) -> list[slice]:
        return [run for run in self.data.runs if np.any(self.data.weight[run] > 0.0)]

    def _project(self, run: slice, lag: FirstOrderLag, columns: FloatArray) -> FloatArray:
        """Weight the columns, leave out unscored rows, and remove the run's start."""
        weight = self.data.weight[run]
        scored = weight > 0.0
        root = np.sqrt(weight[scored])
        rows = columns[scored] * root[:, None]
        decay = lag.decay(weight.size)[scored] * root
        power = float(decay @ decay)
        if power > 0.0:
            rows = rows - np.outer(decay, decay @ rows / power)
        return rows


@dataclass(frozen=True)
class EquationError:
    """C(q) e = ψ'[k] - a ψ'[k-1] - Σ β_i u_i[k] (paper, Eq 9): arx for order 0, else armax.

    An equation looks one sample back, so that a row of weight 0 costs the equation at it and the
    one after it, and the recursion of C starts afresh behind it. The errors just before a stretch
    are unknown but not free: they are innovations like all others, and stand as ``order`` rows of
    their own before its equations (unconditional least squares, Box and Jenkins 1976). Taken as
    zero (``exact_start=False``, the classical recursion) they bias τ on short segments.
    """

    data: LagData
    order: int
    exact_start: bool = True

    def linear(self, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return target and columns of the weighted linear problem."""
        lag, whitener = self.data.lag(shape[0]), MovingAverage(shape[1:])
        blocks = []
        for piece in self._pieces():
            rows = np.column_stack(
                [
                    self._differenced(self.data.y[piece], lag),
                    lag.drive(self.data.terms[piece]),
                    self._differenced(self.data.drift[piece], lag),
                ]
            )
            blocks.append(self._project(whitener.whiten(rows), whitener, piece))
        stacked = np.concatenate(blocks)
        return stacked[:, 0], stacked[:, 1:]

    def sensitivities(
        self, shape: FloatArray, coef: FloatArray, innovations: FloatArray
    ) -> FloatArray:
        """Return ∂e/∂(log τ, ρ)."""
        lag, whitener = self.data.lag(shape[0]), MovingAverage(shape[1:])
        n_terms = self.data.terms.shape[1]
        blocks = []
        at = 0
        for piece in self._pieces():
            root = self._root_weight(piece)
            undrifted = self.data.y[piece] - self.data.drift[piece] @ coef[n_terms:]
            slope = -lag.d_a * undrifted[:-1]
            slope -= lag.d_drive(self.data.terms[piece] @ coef[:n_terms])
            errors = innovations[at : at + root.size] / root
            at += root.size
            if not self.exact_start:
                errors = np.concatenate([np.zeros(self.order), errors])
            block = np.column_stack([whitener.whiten(slope), whitener.sensitivities(errors)])
            blocks.append(self._project(block, whitener, piece))
        return np.concatenate(blocks)

    def rows_of_errors(self) -> NDArray[np.int64]:
        """Return the row of each error, -1 for the errors before a stretch."""
        ahead = np.full(self._ahead, -1)
        stretches = [np.arange(piece.start + 1, piece.stop) for piece in self._pieces()]
        return np.concatenate([part for rows in stretches for part in (ahead, rows)])

    def piece_lengths(self) -> list[int]:
        """Return the number of equations of each stretch, with the errors before it."""
        return [piece.stop - piece.start - 1 + self._ahead for piece in self._pieces()]

    @property
    def _ahead(self) -> int:
        return self.order if self.exact_start else 0

    def _pieces(self) -> list[slice]:
        return [p for run in self.data.runs for p in scored_pieces(self.data.weight, run)]

    def _project(self, rows: FloatArray, whitener: MovingAverage, piece: slice) -> FloatArray:
        """Put the errors before the stretch ahead of it, weight, and optimise them away."""
        root = self._root_weight(piece)[:, None]
        if self._ahead == 0:
            return rows * root
        ahead = np.zeros((self.order, rows.shape[1]))
        weighted = np.concatenate([ahead, rows]) * root
        before = whitener.whiten(whitener.reach(rows.shape[0]))
        basis, _ = np.linalg.qr(np.concatenate([-np.eye(self.order), before]) * root)
        return np.asarray(weighted - basis @ (basis.T @ weighted))

    def _root_weight(self, piece: slice) -> FloatArray:
        weight = self.data.weight[piece]
        full = np.concatenate([np.full(self._ahead, weight[1]), weight[1:]])
        return np.asarray(np.sqrt(full))

    @staticmethod
    def _differenced(rows: FloatArray, lag: FirstOrderLag) -> FloatArray:
        return np.asarray(rows[1:] - lag.a * rows[:-1])


@dataclass(frozen=True)
class Outcome:
    """Where a search ended.

    Parameters
    ----------
    shape : ndarray
        log τ, then the parameters of C.
    coef : ndarray
        β, then the drift.
    cost : float
        Sum of squared weighted errors.
    state : FitState
        How it ended.
    innovations : ndarray of shape (n,)
        The weighted errors e of the scored rows.
    jacobian : ndarray of shape (n, n_shape + n_linear)
        ∂e/∂(shape, coef).
    piece_lengths : list of int
        Rows of each stretch, in the order of ``innovations``.
    """

    shape: FloatArray
    coef: FloatArray
    cost: float
    state: FitState
    innovations: FloatArray
    jacobian: FloatArray
    piece_lengths: list[int]


def search(model: PredictionModel, starts: list[FloatArray]) -> Outcome:
    """Refine from each start and return the best outcome.

    Parameters
    ----------
    model : PredictionModel
        The errors to be minimised.
    starts : list of ndarray
        Shape parameters to start from; all are refined.
    """
    outcomes = [_refine(model, start) for start in starts]
    return min(outcomes, key=lambda outcome: outcome.cost)


@dataclass(frozen=True)
class _Point:
    shape: FloatArray
    coef: FloatArray
    innovations: FloatArray
    columns: FloatArray
    cost: float


def _triangle(columns: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(columns, mode="r"), dtype=np.float64)


def _rank_limit(n_rows: int) -> float:
    return float(max(n_rows, 1000) * np.finfo(np.float64).eps)


def rank_deficient(outcome: Outcome, n_shape: int, n_terms: int) -> bool:
    """Tell whether the terms of the characteristic cannot be told apart on these rows.

    Parameters
    ----------
    outcome : Outcome
        A finished search.
    n_shape, n_terms : int
        Number of shape parameters, and of terms behind them in the Jacobian.
    """
    columns = outcome.jacobian[:, n_shape : n_shape + n_terms]
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if np.any(scale == 0.0):
        return True
    singular = np.linalg.svd(_triangle(columns / scale), compute_uv=False)
    return bool(singular[-1] <= _rank_limit(columns.shape[0]) * singular[0])


def _solve(model: PredictionModel, shape: FloatArray) -> _Point:
    target, columns = model.linear(shape)
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    scale[scale == 0.0] = 1.0
    # The triangle of a QR holds all that the small problem needs, whatever the record's length.
    triangle = _triangle(np.column_stack([columns / scale, target]))
    # Below n eps a column is a copy of others within rounding; least norm shares it out.
    coef = np.linalg.lstsq(triangle[:, :-1], triangle[:, -1], rcond=_rank_limit(target.size))[0]
    coef = coef / scale
    innovations = target - columns @ coef
    return _Point(shape, coef, innovations, columns, float(innovations @ innovations))


def scan(model: PredictionModel, log_taus: FloatArray, tail: FloatArray) -> float:
    """Return the log τ of least cost on a grid, the other shape parameters held at ``tail``."""
    costs = [_solve(model, np.concatenate([[value], tail])).cost for value in log_taus]
    return float(log_taus[int(np.argmin(costs))])


def _refine(model: PredictionModel, start: FloatArray) -> Outcome:
    low, high = model.data.log_tau_bounds
    point = _solve(model, _bounded(start, low, high))
    damping = 1e-3
    state = FitState.NOT_CONVERGED
    for _ in range(MAXIMUM_ITERATIONS):
        slopes = model.sensitivities(point.shape, point.coef, point.innovations)
        gradient, curvature = _projected(slopes, point)
        if _decrement(gradient, curvature) <= NEWTON_DECREMENT * point.cost / slopes.shape[0]:
            state = FitState.CONVERGED
            break
        trial, damping = _step(model, point, gradient, curvature, damping, (low, high))
        if trial is None:
            # No downhill step is left within rounding: that is the minimum.
            state = FitState.CONVERGED
            break
        point = trial
    if point.shape[0] <= low + 1e-9:
        state = FitState.AT_LOWER_BOUND
    elif point.shape[0] >= high - 1e-9:
        state = FitState.AT_UPPER_BOUND
    slopes = model.sensitivities(point.shape, point.coef, point.innovations)
    return Outcome(
        point.shape,
        point.coef,
        point.cost,
        state,
        point.innovations,
        np.column_stack([slopes, -point.columns]),
        model.piece_lengths(),
    )


def _bounded(shape: FloatArray, low: float, high: float) -> FloatArray:
    return np.concatenate([[np.clip(shape[0], low, high)], shape[1:]])


def _projected(slopes: FloatArray, point: _Point) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return gradient and curvature in the shape parameters, the linear ones optimised away."""
    scale = np.sqrt(np.einsum("ij,ij->j", point.columns, point.columns))
    scale[scale == 0.0] = 1.0
    stacked = np.column_stack([point.columns / scale, slopes])
    triangle = _triangle(stacked)
    corner = triangle[point.columns.shape[1] :, point.columns.shape[1] :]
    return slopes.T @ point.innovations, corner.T @ corner


def _decrement(gradient: FloatArray, curvature: FloatArray) -> float:
    return float(gradient @ np.linalg.lstsq(curvature, gradient)[0])


def _step(
    model: PredictionModel,
    point: _Point,
    gradient: FloatArray,
    curvature: FloatArray,
    damping: float,
    bounds: tuple[float, float],
) -> tuple[_Point | None, float]:
    """Take a damped Gauss-Newton step that lowers the cost, or None when there is none."""
    while damping < 1e8:
        damped = curvature + damping * np.diag(np.diag(curvature) + 1e-300)
        move = -np.linalg.lstsq(damped, gradient)[0]
        # log τ and ρ are of order one: longer moves leave the region where the slope holds.
        move *= min(1.0, 1.5 / max(float(np.max(np.abs(move))), 1e-300))
        trial = _solve(model, _bounded(point.shape + move, *bounds))
        if trial.cost < point.cost:
            return trial, max(damping / 10.0, 1e-12)
        damping = max(damping * 10.0, 1e-6)
    return None, damping


def spline_columns(
    weight: FloatArray, runs: list[slice], sample_period_s: float, knot_spacing_s: float
) -> FloatArray:
    """Return the columns of a continuous piecewise-linear drift of zero mean.

    Parameters
    ----------
    weight : ndarray of shape (n_rows,)
        Weights of the rows; the mean is taken over those.
    runs : list of slice
        The segments. The time between two of them is not known, so each drifts on its own: as
        a spline where it is longer than the knots are apart, else as one level.
    sample_period_s : float
        Sample period, in seconds.
    knot_spacing_s : float
        Distance of the knots, in seconds; 0.25 to 2 s serve equally well where the lag is tens
        of milliseconds.

    Returns
    -------
    ndarray of shape (n_rows, n_columns)
        Hat functions at the knots, less their mean, the last one left out: the constant belongs
        to the characteristic, of which a drift could not be told apart.

    """
    lengths = [run.stop - run.start for run in runs]
    intervals = [round((n - 1) * sample_period_s / knot_spacing_s) for n in lengths]
    n_columns = sum(n + 1 for n in intervals) - 1
    columns = np.zeros((weight.size, n_columns + 1))
    at = 0
    for run, length, n_intervals in zip(runs, lengths, intervals, strict=True):
        position = np.linspace(0.0, n_intervals, length)
        distance = np.abs(position[:, None] - np.arange(n_intervals + 1))
        columns[run, at : at + n_intervals + 1] = np.maximum(0.0, 1.0 - distance)
        at += n_intervals + 1
    total = float(weight.sum())
    centred = columns - (weight @ columns / total if total > 0.0 else 0.0)
    return np.asarray(centred[:, :-1])


# A long record is cut into twenty: enough to estimate a variance to a sixth, few enough that a
# block is long against the memory of its errors.
BLOCKS = 20
FEWEST_BLOCKS = 4


def correlation_length(innovations: FloatArray, piece_lengths: list[int]) -> int:
    """Return the number of lags over which errors still hang together.

    Parameters
    ----------
    innovations : ndarray of shape (n,)
        Errors of all stretches, one after the other.
    piece_lengths : list of int
        Rows of each stretch.

    Returns
    -------
    int
        Twice the lag after which five autocorrelations in a row are insignificant (Politis
        2003), at least 1, at most the longest stretch.
    """
    longest = max(piece_lengths)
    acf = _autocorrelation(innovations, piece_lengths, min(longest - 1, 4000))
    limit = 2.0 * np.sqrt(np.log10(max(innovations.size, 10)) / innovations.size)
    quiet = np.abs(acf[1:]) < limit
    last = quiet.size
    for lag in range(max(quiet.size - 4, 0)):
        if np.all(quiet[lag : lag + 5]):
            last = lag
            break
    return int(np.clip(2 * last, 1, longest))


def block_jackknife(
    jacobian: FloatArray,
    innovations: FloatArray,
    piece_lengths: list[int],
    n_lags: int,
    restated: Callable[[slice, FloatArray], FloatArray] | None = None,
) -> tuple[FloatArray, int]:
    """Return the covariance by leaving out one block at a time, linearised about the fit.

    Parameters
    ----------
    jacobian : ndarray of shape (n, p)
        ∂e/∂θ.
    innovations : ndarray of shape (n,)
        The errors e at the optimum.
    piece_lengths : list of int
        Rows of each stretch. A short stretch (one surge cycle) is a block; a long one is cut.
    n_lags : int
        Rows over which errors hang together; no block is cut shorter.
    restated : callable, optional
        Turns a block and its move of θ into the move of what is wanted.

    Returns
    -------
    covariance : ndarray of shape (p, p)
    n_blocks : int

    Notes
    -----
    Leaving out block g moves θ by B (I - A_g B)⁻¹ J_g'e_g with B = (J'J)⁻¹ and A_g = J_g'J_g, and
    the covariance is (G-1)/G times the scatter of these moves: the sandwich CR3 of Bell and
    McCaffrey (2002). It allows for colour, for errors that grow with the signal, and for blocks
    that carry much of the information; on a dozen short segments a Newey-West sum states errors
    that are far too small.
    """
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale[scale == 0.0] = 1.0
    columns = jacobian / scale
    bread = np.linalg.pinv(columns.T @ columns, hermitian=True)
    identity = np.eye(columns.shape[1])
    moves = []
    for block in _blocks(piece_lengths, n_lags):
        rows = columns[block]
        score = rows.T @ innovations[block]
        # lstsq, not solve: a block that alone determines a parameter makes this singular.
        move = bread @ np.linalg.lstsq(identity - rows.T @ rows @ bread, score)[0] / scale
        moves.append(move if restated is None else restated(block, move))
    spread = np.asarray(moves) - np.mean(moves, axis=0)
    share = (len(moves) - 1) / len(moves)
    return np.asarray(share * spread.T @ spread), len(moves)


def _blocks(piece_lengths: list[int], n_lags: int) -> list[slice]:
    total = sum(piece_lengths)
    shortest = min(max(total / BLOCKS, n_lags), total / FEWEST_BLOCKS)
    blocks = []
    at = 0
    for length in piece_lengths:
        parts = max(1, int(length // max(shortest, 1.0)))
        if len(piece_lengths) < FEWEST_BLOCKS:
            parts = max(parts, int(np.ceil(FEWEST_BLOCKS / len(piece_lengths))))
        edges = np.linspace(at, at + length, parts + 1).astype(int)
        blocks += [slice(low, high) for low, high in pairwise(edges.tolist()) if high > low]
        at += length
    return blocks


def _autocorrelation(values: FloatArray, piece_lengths: list[int], n_lags: int) -> FloatArray:
    acf = np.zeros(n_lags + 1)
    at = 0
    for length in piece_lengths:
        piece = values[at : at + length]
        lags = min(n_lags, length - 1)
        acf[: lags + 1] += fftconvolve(piece, piece[::-1])[length - 1 : length + lags]
        at += length
    return acf / acf[0] if acf[0] > 0.0 else acf


@dataclass(frozen=True)
class DenseFit:
    """What the reference found."""

    time_constant_s: float
    coef: FloatArray
    moving_average: FloatArray
    drift_coef: FloatArray
    cost: float
    parameter_covariance: FloatArray
    n_lags: int
    n_blocks: int
    residual_std: float
    state: FitState


def dense_fit(
    phi: FloatArray,
    y: FloatArray,
    *,
    sample_period_s: float,
    noise: str,
    hold: Hold,
    order: int = 1,
    drift: bool = False,
    knot_spacing_s: float = 1.0,
    segments: NDArray[np.int64] | None = None,
    weight: FloatArray | None = None,
    exact_start: bool = True,
    degree: int = 2,
) -> DenseFit:
    """Fit with whole matrices, by the equations of LagRegressor."""
    weight = np.ones(y.size) if weight is None else weight
    runs = runs_of(segments, y.size)
    terms = PolynomialFeatures(degree).fit_transform(phi[:, None])
    n_terms = terms.shape[1]
    columns = np.zeros((y.size, 0))
    if drift:
        columns = spline_columns(weight, runs, sample_period_s, knot_spacing_s)
    data = LagData(y, terms, columns, weight, tuple(runs), sample_period_s, hold)
    order = order if noise == "armax" else 0
    model: PredictionModel = EquationError(data, order, exact_start)
    if noise == "output-error":
        model = OutputError(data)
    low, high = data.log_tau_bounds
    grid = np.linspace(low + np.log(10.0), high, 28)
    if noise == "output-error":
        starts = [np.array([scan(model, grid, np.zeros(0))])]
    else:
        arx = scan(EquationError(data, 0), grid, np.zeros(0))
        starts = [np.concatenate([[arx], np.zeros(order)])]
    if order > 0:
        free = scan(OutputError(data), grid, np.zeros(0))
        c = np.zeros(order)
        c[0] = -data.lag(free).a
        starts.append(np.concatenate([[free], MovingAverage.from_coefficients(c).free]))
    outcome = search(model, starts)
    n_rows, n_parameters = outcome.jacobian.shape
    n_lags = correlation_length(outcome.innovations, outcome.piece_lengths)
    n_shape, row_of = outcome.shape.size, model.rows_of_errors()
    first = n_shape + n_terms

    def without_extrapolated_drift(block: slice, move: FloatArray) -> FloatArray:
        # The drift of the other rows has zero mean over them; the constant takes up the rest.
        rows = row_of[block][row_of[block] >= 0]
        inside = weight[rows] @ columns[rows] @ (outcome.coef[n_terms:] + move[first:])
        moved = move.copy()
        moved[n_shape] -= inside / (weight.sum() - weight[rows].sum())
        return moved

    covariance, n_blocks = block_jackknife(
        outcome.jacobian,
        outcome.innovations,
        outcome.piece_lengths,
        n_lags,
        without_extrapolated_drift if drift else None,
    )
    if noise == "output-error":
        n_parameters += len(outcome.piece_lengths)
    elif exact_start:
        n_parameters += order * len(outcome.piece_lengths)
    keep = [0, *range(n_shape, n_shape + n_terms)]
    to_tau = np.ones(n_terms + 1)
    to_tau[0] = np.exp(outcome.shape[0])
    mean_weight = float(weight.sum() / max(np.count_nonzero(weight), 1))
    return DenseFit(
        float(to_tau[0]),
        outcome.coef[:n_terms],
        MovingAverage(outcome.shape[1:]).coefficients,
        outcome.coef[n_terms:],
        outcome.cost,
        covariance[np.ix_(keep, keep)] * np.outer(to_tau, to_tau),
        n_lags,
        n_blocks,
        float(np.sqrt(outcome.cost / (n_rows - n_parameters) / mean_weight)),
        outcome.state,
    )
