"""Which order: noise model, C, whole-sample input lag and degree, set side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone

from classic_ml.checks import whiteness
from classic_ml.lag_data import MAXIMUM_ORDER, NOISE_KINDS, NoiseKind
from classic_ml.lag_regressor import LagRegressor
from surge_core.errors import InputError, whole_number
from surge_core.fit_state import FitState
from surge_core.paired import block_errors, block_rms, paired_difference
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray, IntArray

# As many rows train as in a comparison, and the later ones test.
TRAIN_SHARE = 2.0 / 3.0
FEWEST_ROWS = 30
ORDERS_OF_C = tuple(range(1, MAXIMUM_ORDER + 1))


@dataclass(frozen=True)
class OrderRow:
    """One model of a selection.

    Parameters
    ----------
    noise : {"arx", "armax", "output-error"}
        Noise model.
    noise_order : int
        Degree of C.
    input_lag : int
        Whole samples by which φ acts late.
    degree : int
        Degree of the characteristic.
    n_parameters : int
        Free numbers: τ, β, C and the variance of the error.
    aicc, bic : float
        Information criteria, less those of the best row.
    held_out_rms : float
        Free-run error on the later cycles, by a fit to the earlier ones.
    paired_error : float
        Standard error of that rms minus the recommended row's, on the same cycles.
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error, in seconds, from all rows.
    white : bool
        Whether the one-step errors pass the test of whiteness: without that, the information
        criteria of this row mean nothing.
    state : str
        How the fit ended.
    """

    noise: NoiseKind
    noise_order: int
    input_lag: int
    degree: int
    n_parameters: int
    aicc: float
    bic: float
    held_out_rms: float
    paired_error: float
    time_constant_s: float
    time_constant_stderr_s: float
    white: bool
    state: str

    @property
    def name(self) -> str:
        """The model in a few words, e.g. ``"armax C1, lag 0, degree 2"``."""
        kind = f"armax C{self.noise_order}" if self.noise == "armax" else self.noise
        return f"{kind}, lag {self.input_lag}, degree {self.degree}"


@dataclass(frozen=True)
class OrderTable:
    """Models side by side, best BIC first.

    Parameters
    ----------
    rows : tuple of OrderRow
        All that were fitted.
    recommended : OrderRow
        The one to take.
    reason : str
        Why.
    ties : tuple of OrderRow
        The recommended row and those that do no worse or better than it on the later cycles by
        more than one paired standard error.
    """

    rows: tuple[OrderRow, ...]
    recommended: OrderRow
    reason: str
    ties: tuple[OrderRow, ...]


# A model, and its errors by block on the later cycles.
_Fitted = tuple[OrderRow, FloatArray]


def select_order(
    X: ArrayLike,
    y: ArrayLike,
    segments: ArrayLike | None = None,
    *,
    sample_period_s: float,
    noise: Sequence[NoiseKind] = NOISE_KINDS,
    input_lags: Sequence[int] = (0, 1, 2),
    degrees: Sequence[int] = (1, 2, 3),
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> OrderTable:
    """Fit every combination of orders to the same rows and recommend one.

    Parameters
    ----------
    X : array-like of shape (n, 1)
        φ; rows in time order.
    y : array-like of shape (n,)
        ψ'.
    segments : array-like of int, shape (n,), optional
        Labels; no equation straddles two segments.
    sample_period_s : float
        Sample period, in seconds.
    noise : sequence of {"arx", "armax", "output-error"}
        Noise models; armax with C of degree 1 and 2.
    input_lags : sequence of int
        Whole samples by which φ acts late. All models are fitted to the rows that the longest
        of them leaves.
    degrees : sequence of int
        Degrees of the characteristic.
    progress : callable
        Wraps the iteration over the models, to show how far it is.

    Raises
    ------
    InputError
        When nothing is to be compared, or the rows are too few.

    Notes
    -----
    With N errors, n of them free of the start of their segment, and p parameters,
    BIC = n log(Σe²/n) + p log n and AICc = n log(Σe²/n) + 2p + 2p(p+1)/(n-p-1) (Schwarz 1978,
    Hurvich and Tsai 1989). Both rest on white errors. The row of least BIC is recommended where
    its errors pass the test of whiteness; where no noise model makes them white, the simplest
    model that is within one paired standard error of the best on the later cycles.
    """
    inputs, target = np.asarray(X, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if not (noise and input_lags and degrees):
        raise InputError("select_order", expected="at least one of each order", found="none")
    for lag in input_lags:
        whole_number("input_lags", lag, 0, 1000)
    at, labels = _usable(runs_of(segments, target.size), max(input_lags))
    if at.size < FEWEST_ROWS:
        raise InputError(
            "select_order",
            expected=f"at least {FEWEST_ROWS} rows after the longest input lag",
            found=str(at.size),
        )
    kinds = [(kind, c) for kind in noise for c in (ORDERS_OF_C if kind == "armax" else (0,))]
    orders = list(product(dict.fromkeys(kinds), input_lags, degrees))
    train = _earlier(labels)
    fitted = []
    for (kind, c), lag, degree in progress(orders):
        model = LagRegressor(
            sample_period_s,
            noise=kind,
            noise_order=c,
            degree=degree,
            hold="first",
            # The errors before a segment are then not counted as errors of its rows: the sums of
            # squares of all models are over the same equations.
            exact_start=False,
        )
        fitted.append(_fit(model, lag, inputs[at - lag], target[at], labels, train))
    return _table(fitted)


def _usable(runs: list[slice], longest_lag: int) -> tuple[IntArray, IntArray]:
    """Return the rows that every model can use, and the number of their segment.

    A segment of which fewer than three are left holds one equation or none.
    """
    kept = [np.arange(run.start + longest_lag, run.stop) for run in runs]
    kept = [rows for rows in kept if rows.size > 2]
    labels = np.repeat(np.arange(len(kept)), [rows.size for rows in kept])
    return np.concatenate([*kept, np.zeros(0, dtype=np.int64)]).astype(np.int64), labels


def _earlier(labels: IntArray) -> BoolArray:
    """Tell which rows train: whole cycles, or the first part of the one segment."""
    ends = np.cumsum(np.bincount(labels))
    if ends.size == 1:
        return np.arange(labels.size) < TRAIN_SHARE * labels.size
    n_train = int(np.clip(np.searchsorted(ends, TRAIN_SHARE * ends[-1]), 1, ends.size - 1))
    return labels < n_train


def _fit(
    model: LagRegressor, lag: int, X: FloatArray, y: FloatArray, labels: IntArray, train: BoolArray
) -> _Fitted:
    trained, test = clone(model).fit(X[train], y[train], labels[train]), ~train
    free_run = trained.predict(X[test], labels[test], start=y[test])
    blocks = block_errors(y[test] - free_run, runs_of(labels[test], free_run.size))
    model.fit(X, y, labels)
    predicted, known = model.one_step(X, y, labels)
    errors = np.where(known, y - predicted, 0.0)
    n, p = y.size - int(labels[-1] + 1), 2 + model.coef_.size + model.noise_order
    power = float(errors @ errors) / max(n, 1)
    likelihood = n * math.log(max(power, np.finfo(np.float64).tiny))
    penalty = 2.0 * p + 2.0 * p * (p + 1) / (n - p - 1) if n > p + 1 else math.inf
    row = OrderRow(
        model.noise,
        model.noise_order,
        lag,
        model.degree,
        p,
        likelihood + penalty,
        likelihood + p * math.log(n),
        block_rms(blocks)[0],
        math.nan,
        float(model.time_constant_s_),
        float(model.time_constant_stderr_s_),
        whiteness(errors, runs_of(labels, y.size)).passed,
        model.fit_state_.code,
    )
    return row, blocks


def _table(fitted: list[_Fitted]) -> OrderTable:
    fitted = sorted(fitted, key=lambda one: one[0].bic)
    chosen, reason = _recommend(fitted)
    least_aicc, least_bic = min(row.aicc for row, _ in fitted), fitted[0][0].bic
    rows: list[OrderRow] = []
    ties: list[OrderRow] = []
    for own, blocks in fitted:
        difference, paired = paired_difference(blocks, chosen[1])
        aicc, bic = own.aicc - least_aicc, own.bic - least_bic
        rows.append(replace(own, aicc=aicc, bic=bic, paired_error=paired))
        if own is chosen[0]:
            ties.insert(0, rows[-1])
        elif abs(difference) <= paired:
            ties.append(rows[-1])
    return OrderTable(tuple(rows), ties[0], reason, tuple(ties))


def _recommend(fitted: list[_Fitted]) -> tuple[_Fitted, str]:
    """Return the model to take, of those in the order of their BIC, and why."""
    ended_well = [one for one in fitted if one[0].state == FitState.CONVERGED]
    if not ended_well:
        return fitted[0], "no fit ended well: least BIC of fits that should not be used"
    if ended_well[0][0].white:
        reason = "least BIC, and its one-step errors are white, so that BIC holds"
        return ended_well[0], reason
    leader = min(ended_well, key=lambda one: one[0].held_out_rms)
    near = []
    for one in ended_well:
        difference, paired = paired_difference(one[1], leader[1])
        if difference <= max(paired, 0.0):
            near.append(one)
    return min(near, key=lambda one: (one[0].n_parameters, one[0].held_out_rms)), (
        "simplest within one paired standard error of the best on the later cycles; the one-step "
        "errors of the row of least BIC are not white, so that BIC does not hold"
    )
