"""Prediction errors of the lag model, linear in all but τ and C, and their derivatives.

Minimising Σ w e² over the one-step (arx, armax) or free-run (output-error) errors e is maximum
likelihood for Gaussian e (Åström 1980, the paper's Reference 5). For a shape (log τ, ρ) the
errors are target - columns β - drift - starts, so that all of these follow by linear least
squares and a search runs over the shape alone (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from classic_ml.lag_data import Drift, LagData, Piece
from classic_ml.noise_models import MovingAverage
from surge_core.lag import FirstOrderLag
from surge_core.leave_out import LocalColumns, eliminate
from surge_core.types import FloatArray, IntArray

__all__ = ["Profile", "jacobian", "profile"]

# Below this a start, or what the recursion of C keeps of a hat, adds less than a rounding error.
FORGOTTEN = 1e-17
FORGOTTEN_HAT = 1e-13
MOST_INTERVALS = 20


@dataclass(frozen=True)
class Start:
    """What the unknown start of a piece adds to its errors, as orthonormal columns.

    Parameters
    ----------
    errors : slice
        The errors that still feel it.
    basis : ndarray of shape (m, order)
        Its columns there.
    size : float
        Norm of the one column a^k, for output error.
    """

    errors: slice
    basis: FloatArray
    size: float


@dataclass(frozen=True)
class Profile:
    """The errors at a shape, everything linear at its optimum.

    Parameters
    ----------
    shape : ndarray
        log τ, ρ.
    beta : ndarray of shape (r,)
        Coefficients of the terms.
    errors : ndarray of shape (m,)
        Weighted errors.
    columns : ndarray of shape (m, r)
        -∂e/∂β, the starts projected out.
    starts : tuple of Start
        The starts of the pieces.
    offsets : ndarray of shape (n_starts,)
        Coefficient of each start, for output error.
    local : LocalColumns, optional
        Columns of the drift, the starts projected out.
    levels : ndarray of shape (n_hats,)
        The drift at its knots.
    """

    shape: FloatArray
    beta: FloatArray
    errors: FloatArray
    columns: FloatArray
    starts: tuple[Start, ...]
    offsets: FloatArray
    local: LocalColumns | None
    levels: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.errors @ self.errors)


def profile(data: LagData, shape: FloatArray, beta: FloatArray | None = None) -> Profile:
    """Return the errors at a shape, with the best β, drift and starts.

    Parameters
    ----------
    data : LagData
        Record and model.
    shape : ndarray
        log τ, ρ.
    beta : ndarray of shape (r,), optional
        Coefficients of the terms, where they are given.
    """
    lag, whitener = data.lag(shape[0]), MovingAverage(shape[1:])
    both = _columns_and_target(data, lag, whitener)
    starts = _starts(data, lag, whitener)
    taken = _project(starts, both)
    if data.drift is None:
        local, levels = None, np.zeros(0)
        if beta is None:
            beta = _least_squares(both.T @ both)
    else:
        local, taken_local = _local_columns(data, data.drift, lag, whitener, starts)
        columns = local.columns
        reduced, back = eliminate(both.T @ both, columns.T @ both, columns.T @ columns, local.mean)
        if beta is None:
            beta = _least_squares(reduced)
        levels = back[:, -1] - back[:, :-1] @ beta
    errors = both[:, -1] - both[:, :-1] @ beta
    if local is not None:
        errors -= local.columns @ levels
    offsets = np.zeros(0)
    if data.is_output_error:
        offsets = taken[:, -1] - taken[:, :-1] @ beta
        if local is not None:
            offsets -= taken_local @ levels
    return Profile(shape, beta, errors, both[:, :-1], starts, offsets, local, levels)


def jacobian(data: LagData, at: Profile) -> FloatArray:
    """Return ∂e/∂(free shape, β), the starts projected out.

    Parameters
    ----------
    data : LagData
        Record and model.
    at : Profile
        What :func:`profile` gave.

    Returns
    -------
    ndarray of shape (m, n_shape + r)
    """
    n_shape = int(data.free.sum())
    both = np.zeros((at.errors.size, n_shape + at.beta.size), order="F")
    slopes = both[:, :n_shape]
    if data.is_output_error:
        _slopes_of_free_run(data, at, slopes)
    else:
        _slopes_of_equations(data, at, slopes)
    if data.root is not None:
        slopes *= data.root[:, None]
    _project(at.starts, slopes)
    both[:, n_shape:] = -at.columns
    return both


def _least_squares(gram: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(gram[:-1, :-1], gram[:-1, -1])[0])


def _project(starts: tuple[Start, ...], both: FloatArray) -> FloatArray:
    """Remove from each column what a start can explain of it, and return the first of each."""
    taken = np.zeros((len(starts), both.shape[1]))
    for number, start in enumerate(starts):
        share = start.basis.T @ both[start.errors]
        both[start.errors] -= start.basis @ share
        taken[number] = share[0]
    return taken


def _predicted(data: LagData) -> tuple[slice | IntArray, slice | IntArray, slice]:
    """Return the rows that are predicted, the rows before them, and the place of their errors."""
    if len(data.pieces) == 1:
        rows = data.pieces[0].rows
        return rows, slice(rows.start - 1, rows.stop - 1), slice(data.ahead, None)
    return data.rows_of_errors, data.rows_of_errors - 1, slice(None)


def _columns_and_target(data: LagData, lag: FirstOrderLag, whitener: MovingAverage) -> FloatArray:
    """Return the columns of β with the target behind them, weighted.

    Output error: the free run of each term (Eq 6). It runs on from segment to segment: what that
    adds to a segment is its start, which is projected out. Equation error: the terms as they act in
    Eq 9, and ψ'[k] - a ψ'[k-1], sent through 1/C.
    """
    rows, before, where = _predicted(data)
    both = np.zeros((data.rows_of_errors.size, data.terms.shape[1] + 1), order="F")
    own = both[where]
    if data.is_output_error:
        own[:, :-1] = lag.respond(data.terms, data.terms[0])[rows]
        own[:, -1] = data.y[rows]
    else:
        own[:, :-1] = lag.drive(data.terms)[before]
        own[:, -1] = data.y[rows] - lag.a * data.y[before]
        both[data.ahead_places] = 0.0
        both = _whitened(data, whitener, both)
    if data.root is not None:
        both *= data.root[:, None]
    return both


def _whitened(data: LagData, whitener: MovingAverage, rows: FloatArray) -> FloatArray:
    """Return C⁻¹ rows, piece by piece.

    With errors ahead of each piece all go through one filter: what it carries into a piece shows
    in these too, and is projected out with them.
    """
    if data.ahead or len(data.pieces) == 1:
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
        own = column[: stop - piece.errors.start]
        if data.root is not None:
            own = own * data.root[where, None]
        size = float(np.sqrt(own[:, 0] @ own[:, 0]))
        one = own.shape[1] == 1
        basis = own / (size or 1.0) if one else np.linalg.qr(own)[0]
        starts.append(Start(where, basis, size))
    return tuple(starts)


def _local_columns(
    data: LagData,
    drift: Drift,
    lag: FirstOrderLag,
    whitener: MovingAverage,
    starts: tuple[Start, ...],
) -> tuple[LocalColumns, FloatArray]:
    """Return the columns of the drift in the errors, and what the starts took of them."""
    rows, before, where = _predicted(data)
    hats = drift.hats
    mean = hats.T @ data.weight
    if isinstance(hats, np.ndarray):
        columns = np.zeros((data.rows_of_errors.size, drift.n_hats))
        columns[where] = hats[rows] if data.is_output_error else hats[rows] - lag.a * hats[before]
        if not data.is_output_error:
            columns[data.ahead_places] = 0.0
            columns = _whitened(data, whitener, columns)
        if data.root is not None:
            columns *= data.root[:, None]
        taken = _project(starts, columns)
        return LocalColumns(columns, mean), taken
    from scipy.sparse import coo_array, vstack

    columns = hats[rows]
    if not data.is_output_error:
        parts = [_whitened_hats(data, drift, piece, lag, whitener) for piece in data.pieces]
        columns = vstack(parts, format="csr")
    if data.root is not None:
        columns = columns.multiply(data.root[:, None]).tocsr()
    if not starts:
        return LocalColumns(columns, mean), np.zeros((0, drift.n_hats))
    order = starts[0].basis.shape[1]
    at = [np.arange(s.errors.start, s.errors.stop) for s in starts]
    places = np.concatenate([np.repeat(part, order) for part in at])
    numbers = [i * order + np.tile(np.arange(order), part.size) for i, part in enumerate(at)]
    values = np.concatenate([s.basis.ravel() for s in starts])
    basis = coo_array(
        (values, (places, np.concatenate(numbers))),
        shape=(columns.shape[0], order * len(starts)),
    ).tocsr()
    share = (basis.T @ columns).tocsr()
    return LocalColumns((columns - basis @ share).tocsr(), mean), share[::order].toarray()


def _whitened_hats(
    data: LagData, drift: Drift, piece: Piece, lag: FirstOrderLag, whitener: MovingAverage
) -> Any:
    """Return C⁻¹ (hat[k] - a hat[k-1]) of each hat that a piece can see, sparse.

    All windows are of one length: two intervals between knots, and what the recursion of C keeps
    of them.
    """
    from scipy.sparse import coo_array

    rows, begin = piece.rows, piece.run.start
    first, intervals = drift.first[piece.number], drift.intervals[piece.number]
    step, n = drift.steps[piece.number], rows.stop - rows.start
    shape = (data.ahead + n, drift.n_hats)
    if intervals == 0:
        level = whitener.whiten(np.full(n, 1.0 - lag.a))
        where = (data.ahead + np.arange(n), np.full(n, first))
        return coo_array((level, where), shape=shape).tocsr()
    decades = np.log(min(max(whitener.largest_root, 1e-3), 1.0 - 1e-9))
    tail = min(np.log(FORGOTTEN_HAT) / decades, MOST_INTERVALS / step)
    width = min(n, int(np.ceil(2.0 / step) + tail) + 3)
    knots = np.arange(intervals + 1)
    from_row = np.maximum(np.floor((knots - 1) / step).astype(np.int64) + 1, 0)
    from_row = np.maximum(from_row + begin - rows.start, 0)
    seen = ((knots + 1) / step + begin >= rows.start - 1) & (from_row < n)
    knots, from_row = knots[seen], from_row[seen]
    at = from_row[:, None] + np.arange(width)
    place = (at + rows.start - begin) * step - knots[:, None]
    hat = np.maximum(1.0 - np.abs(place), 0.0) - lag.a * np.maximum(1.0 - np.abs(place - step), 0.0)
    whitened = whitener.whiten(hat.T).T
    inside = at < n
    numbers = np.broadcast_to(first + knots[:, None], at.shape)
    where = (data.ahead + at[inside], numbers[inside])
    return coo_array((whitened[inside], where), shape=shape).tocsr()


def _slopes_of_free_run(data: LagData, at: Profile, slopes: FloatArray) -> None:
    """Fill in ∂e/∂(log τ), everything linear held."""
    if data.held_log_tau is not None:
        return
    lag = data.lag(at.shape[0])
    rows, _, _ = _predicted(data)
    quasi_steady = data.terms @ at.beta
    state = lag.respond(quasi_steady, quasi_steady[0])
    slopes[:, 0] = -lag.d_respond(quasi_steady, state)[rows]
    for start, offset in zip(at.starts, at.offsets, strict=True):
        if start.size > 0.0:
            # ∂a^k/∂log τ = k (h/τ) a^k.
            k = np.arange(start.basis.shape[0])
            slopes[start.errors, 0] -= offset / start.size * k * lag.ratio * lag.decay(k.size)


def _slopes_of_equations(data: LagData, at: Profile, slopes: FloatArray) -> None:
    """Fill in ∂e/∂(log τ, ρ), everything linear held."""
    lag, whitener = data.lag(at.shape[0]), MovingAverage(at.shape[1:])
    _, before, where = _predicted(data)
    quasi_steady = data.terms @ at.beta
    if data.held_log_tau is None:
        measured = data.y
        if data.drift is not None:
            measured = measured - data.drift.hats @ at.levels
        slopes[where, 0] = -lag.d_a * measured[before] - lag.drive(quasi_steady, 1)[before]
    if data.order:
        slopes[:, -data.order :] = _late_errors(data, at) @ -whitener.jacobian
    slopes[data.ahead_places] = 0.0
    slopes[:] = _whitened(data, whitener, slopes)


def _late_errors(data: LagData, at: Profile) -> FloatArray:
    """Return e[k-1] and e[k-2] beside each equation, of shape (m, order)."""
    errors = at.errors if data.root is None else at.errors / data.root
    late = np.zeros((errors.size, data.order))
    for back in range(1, data.order + 1):
        late[back:, back - 1] = errors[:-back]
        if not data.ahead:
            begins = np.array([piece.errors.start for piece in data.pieces])
            late[np.add.outer(begins, np.arange(back)).ravel(), back - 1] = 0.0
    return late
