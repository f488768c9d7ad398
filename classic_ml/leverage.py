"""What leaving out one surge cycle does to a fit, linearised about the fit."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.lag.prediction import rows_late
from surge_core.errors import InputError
from surge_core.lag import FirstOrderLag
from surge_core.segments import runs_of, scored_pieces
from surge_core.types import FloatArray

__all__ = ["CycleShifts", "LinearisedFit", "cycle_shifts", "linearised_fit"]

# Fewer segments are cut, so that the others can say what is usual: with six, clean records raise
# an alarm in 5 to 20 % of the cases instead of 1 to 3 %.
FEWEST_CYCLES = 10
PIECES = 12
# Central differences lose a third of the digits of a double on each side.
STEP = 1e-5
# Half a gigabyte of dense columns.
MOST_VALUES = 60_000_000


class OneStepModel(Protocol):
    """What is asked of a fitted model."""

    time_constant_s_: float
    coef_: FloatArray

    def one_step(
        self, X: ArrayLike, y: ArrayLike, segments: ArrayLike | None = None
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the one-step predictions and which rows have one."""


@dataclass(frozen=True)
class LinearisedFit:
    """Errors of a fit and their derivatives.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        Prediction errors of the scored rows, times the root of their weights.
    jacobian : ndarray of shape (n, p)
        ∂e/∂θ, θ = (τ in seconds, β, dead time, C, drift and ripple).
    rows : ndarray of int, shape (n,)
        Row of the data that each error belongs to.
    pieces : tuple of slice
        Stretches of ``errors`` that follow each other without a gap.
    segment : ndarray of int, shape (n,)
        Number of the segment, from 0, of each error.
    aside : ndarray of shape (n,)
        What drift and ripple of the fit add to ψ' at each row.
    """

    errors: FloatArray
    jacobian: FloatArray
    rows: NDArray[np.int64]
    pieces: tuple[slice, ...]
    segment: NDArray[np.int64]
    aside: FloatArray


@dataclass(frozen=True)
class CycleShifts:
    """How far each parameter moves without each cycle.

    Parameters
    ----------
    shift : ndarray of shape (n_cycles, p)
        θ without the cycle minus θ.
    spread : ndarray of shape (n_cycles, p, p)
        Covariance of that shift for white errors of unit variance, (J'J - A_g)⁻¹ - (J'J)⁻¹.
    first_row, last_row : ndarray of int, shape (n_cycles,)
        Rows of the data that the cycle spans.
    """

    shift: FloatArray
    spread: FloatArray
    first_row: NDArray[np.int64]
    last_row: NDArray[np.int64]

    @property
    def n_cycles(self) -> int:
        """Number of cycles that were left out in turn."""
        return int(self.first_row.size)

    def studentised(self, contrasts: FloatArray) -> FloatArray:
        """Return each shift over what shifts of the other cycles make usual.

        Parameters
        ----------
        contrasts : ndarray of shape (k, p)
            Linear functions of θ, e.g. τ alone or the curve at one φ.

        Returns
        -------
        ndarray of shape (n_cycles, k)
            Student's t with ``n_cycles - 2`` degrees of freedom where all cycles are alike. The
            shift is scaled by what the cycle's share of the information predicts, so that a long
            cycle may move more than a short one; the common scale is that of the other cycles
            (externally studentised), so that coloured errors do not count against a cycle.
        """
        moved = self.shift @ contrasts.T
        variance = np.einsum("ki,gij,kj->gk", contrasts, self.spread, contrasts)
        scaled = moved / np.sqrt(np.maximum(variance, np.finfo(np.float64).tiny))
        n = self.n_cycles
        power = np.sum(scaled**2, axis=0)
        # One direction of the shifts is spent on the estimate itself: they add up to nothing.
        share = scaled**2 * n / (n - 1.0) / np.maximum(power, np.finfo(np.float64).tiny)
        left = np.maximum(1.0 - share, 1e-12)
        return np.asarray(np.sign(scaled) * np.sqrt(share * (n - 2.0) / left))


def linearised_fit(
    model: OneStepModel,
    X: ArrayLike,
    y: ArrayLike,
    segments: ArrayLike | None = None,
    sample_weight: ArrayLike | None = None,
) -> LinearisedFit:
    """Return the errors of a fitted model on the rows it was fitted to, and their derivatives.

    Parameters
    ----------
    model : fitted estimator
        With ``one_step``, ``time_constant_s_`` and ``coef_``.
    X : array-like of shape (n, n_features)
        Inputs.
    y : array-like of shape (n,)
        ψ' as measured.
    segments : array-like of int, shape (n,), optional
        Labels as in the fit.
    sample_weight : array-like of shape (n,), optional
        Weights as in the fit.

    Returns
    -------
    LinearisedFit
    """
    inputs, target = np.asarray(X, dtype=np.float64), np.asarray(y, dtype=np.float64)
    n = target.size
    weight = np.ones(n) if sample_weight is None else np.array(sample_weight, dtype=np.float64)
    runs = [slice(0, n)] if getattr(model, "link_segments", False) else runs_of(segments, n)
    late = _rows_late(model)
    for run in runs if late else []:
        # These rows answer to inputs from before their segment.
        weight[run.start : min(run.start + late, run.stop)] = 0.0
    free = _is_free_run(model)
    pieces = runs if free else [piece for run in runs for piece in scored_pieces(weight, run)]
    labels = np.zeros(n, dtype=np.int64)
    for number, piece in enumerate(pieces, start=1):
        labels[piece] = number
    inside = np.flatnonzero(labels)
    aside = _output_columns(model, weight, runs)[inside]
    inputs, target, labels = inputs[inside], target[inside], labels[inside]
    weight_in = weight[inside]
    probe = _Probe(model, inputs, target, labels)
    if aside.shape[1]:
        probe = probe.without(aside, weight_in)
    errors, known = probe.errors()
    held = getattr(model, "time_constant_s", None) is not None
    columns = [np.zeros_like(errors) if held else probe.slope("time_constant_s_", None)]
    columns += [probe.slope("coef_", i) for i in range(np.size(model.coef_))]
    if getattr(model, "dead_time_s", 0.0) == "fit":
        columns.append(probe.slope("dead_time_s_", None))
    moving = np.asarray(getattr(model, "moving_average_", np.zeros(0)))
    columns += [probe.slope("moving_average_", i) for i in range(moving.size)]
    columns += [-probe.added_to_output(column) for column in aside.T]
    both = np.column_stack([errors, *columns]) * np.sqrt(weight_in)[:, None]
    local = runs_of(labels, labels.size)
    if free:
        both = _without_starts(both, model, np.sqrt(weight_in), local)
    keep = known & (weight_in > 0.0)
    at = np.flatnonzero(keep)
    segment_of_row = np.zeros(n, dtype=np.int64)
    for number, run in enumerate(runs):
        segment_of_row[run] = number
    rows = inside[at]
    return LinearisedFit(
        both[at, 0],
        both[at, 1:],
        rows,
        tuple(_stretches(rows, labels[at])),
        segment_of_row[rows],
        (target - probe.y)[at],
    )


def cycle_shifts(fit: LinearisedFit) -> CycleShifts:
    """Leave out one cycle at a time.

    Parameters
    ----------
    fit : LinearisedFit
        Each segment is a cycle; fewer than ten are cut into a dozen pieces.

    Returns
    -------
    CycleShifts

    Notes
    -----
    θ₍₋g₎ - θ = (J'J - A_g)⁻¹ J_g'e_g with A_g = J_g'J_g, exact for a linear problem (Cook and
    Weisberg 1982, section 3.5). It costs one pass over the rows whatever the number of cycles.
    """
    scale = np.sqrt(np.einsum("ij,ij->j", fit.jacobian, fit.jacobian))
    scale[scale == 0.0] = 1.0
    columns = fit.jacobian / scale
    whole = columns.T @ columns
    bread = np.linalg.pinv(whole, hermitian=True)
    shifts, spreads, first, last = [], [], [], []
    for cycle in _cycles(fit):
        rows = columns[cycle]
        without = np.linalg.pinv(whole - rows.T @ rows, hermitian=True)
        shifts.append(without @ (rows.T @ fit.errors[cycle]) / scale)
        spreads.append((without - bread) / np.outer(scale, scale))
        first.append(int(fit.rows[cycle.start]))
        last.append(int(fit.rows[cycle.stop - 1]))
    return CycleShifts(np.asarray(shifts), np.asarray(spreads), np.array(first), np.array(last))


class _Probe:
    """A copy of a fitted model whose numbers may be moved."""

    def __init__(
        self, model: OneStepModel, X: FloatArray, y: FloatArray, labels: NDArray[np.int64]
    ) -> None:
        self.model, self.X, self.y, self.labels = model, X, y, labels
        self.prediction, self.known = model.one_step(X, y, labels)

    def errors(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        return self.y - self.prediction, self.known

    def without(self, columns: FloatArray, weight: FloatArray) -> _Probe:
        """Take from ψ' what drift and ripple add to it: the fit chose them by least squares."""
        scored = self.known & (weight > 0.0)
        root = np.sqrt(weight[scored])
        effects = np.column_stack([self.added_to_output(column)[scored] for column in columns.T])
        errors = self.errors()[0][scored]
        coef = np.linalg.lstsq(effects * root[:, None], errors * root)[0]
        return _Probe(self.model, self.X, self.y - columns @ coef, self.labels)

    def slope(self, attribute: str, index: int | None) -> FloatArray:
        """Return ∂e/∂(one number of the fit) by a central difference."""
        value = np.atleast_1d(np.asarray(getattr(self.model, attribute), dtype=np.float64))
        at = 0 if index is None else index
        step = STEP * (abs(float(value[at])) or 1.0)
        sides = []
        for sign in (1.0, -1.0):
            moved = value.copy()
            moved[at] += sign * step
            model: Any = copy.copy(self.model)
            setattr(model, attribute, float(moved[0]) if index is None else moved)
            sides.append(model.one_step(self.X, self.y, self.labels)[0])
        return np.asarray((sides[1] - sides[0]) / (2.0 * step))

    def added_to_output(self, column: FloatArray) -> FloatArray:
        """Return what a signal that adds to ψ' without the lag adds to the errors."""
        # The prediction is affine in y, so that the difference is exact whatever the step.
        step = float(np.std(self.y)) or 1.0
        moved, _ = self.model.one_step(self.X, self.y + step * column, self.labels)
        return np.asarray(column - (moved - self.prediction) / step)


def _is_free_run(model: OneStepModel) -> bool:
    return getattr(model, "noise", "output-error") == "output-error"


def _rows_late(model: Any) -> int:
    fitted = getattr(model, "_n_late", None)
    if fitted is not None:
        return int(fitted)
    dead = getattr(model, "dead_time_s_", 0.0)
    return rows_late(dead / float(model.sample_period_s)) if dead > 0.0 else 0


def _output_columns(model: Any, weight: FloatArray, runs: list[slice]) -> FloatArray:
    """Return what may add to ψ' without the lag: hats of a drift, waves of a ripple."""
    period_s = float(getattr(model, "sample_period_s", 1.0))
    lengths = [run.stop - run.start for run in runs]
    intervals: list[int] = []
    if getattr(model, "drift", None) == "spline":
        intervals = [round((n - 1) * period_s / float(model.knot_spacing_s)) for n in lengths]
    ripple_hz = np.atleast_1d(np.asarray(getattr(model, "ripple_hz", None) or [], np.float64))
    n_hats = sum(n + 1 for n in intervals)
    n_columns = n_hats + 2 * ripple_hz.size * len(runs)
    if n_columns * weight.size > MOST_VALUES:
        raise InputError(
            "residual checks",
            expected=f"at most {MOST_VALUES // weight.size} knots and waves on {weight.size} rows",
            found=str(n_columns),
            remedy="check a part of the record",
        )
    columns = np.zeros((weight.size, n_columns))
    at = 0
    for run, length, count in zip(runs, lengths, intervals, strict=False):
        place = np.linspace(0.0, count, length)
        distance = np.abs(place[:, None] - np.arange(count + 1))
        columns[run, at : at + count + 1] = np.maximum(0.0, 1.0 - distance)
        at += count + 1
    for run, length in zip(runs, lengths, strict=True):
        phase = 2.0 * np.pi * np.outer(np.arange(length) * period_s, ripple_hz)
        columns[run, at : at + 2 * ripple_hz.size] = np.hstack([np.sin(phase), np.cos(phase)])
        at += 2 * ripple_hz.size
    if n_hats == 0:
        return columns
    # The constant belongs to the characteristic: hats of zero mean, the last one left out.
    columns[:, :n_hats] -= weight @ columns[:, :n_hats] / max(float(weight.sum()), 1e-300)
    return np.delete(columns, n_hats - 1, axis=1)


def _without_starts(
    columns: FloatArray, model: Any, root_weight: FloatArray, runs: list[slice]
) -> FloatArray:
    """Remove the start of each free run, which the fit chose by least squares."""
    if not np.isfinite(model.time_constant_s_):
        return columns
    lag = FirstOrderLag(float(model.time_constant_s_), float(model.sample_period_s), "zero")
    out = columns.copy()
    for run in runs:
        decay = lag.decay(run.stop - run.start) * root_weight[run]
        power = float(decay @ decay)
        if power > 0.0:
            out[run] -= np.outer(decay, decay @ columns[run] / power)
    return out


def _stretches(rows: NDArray[np.int64], labels: NDArray[np.int64]) -> list[slice]:
    cuts = np.flatnonzero((np.diff(rows) != 1) | (np.diff(labels) != 0)) + 1
    return [slice(int(a), int(b)) for a, b in pairwise([0, *cuts.tolist(), rows.size]) if b > a]


def _cycles(fit: LinearisedFit) -> list[slice]:
    """Return the errors of each cycle."""
    segments = runs_of(fit.segment, fit.segment.size)
    if len(segments) >= FEWEST_CYCLES:
        return segments
    total = fit.errors.size
    cycles = []
    for run in segments:
        parts = max(1, round(PIECES * (run.stop - run.start) / total))
        edges = np.linspace(run.start, run.stop, parts + 1).astype(int).tolist()
        cycles += [slice(low, high) for low, high in pairwise(edges) if high > low]
    return cycles
