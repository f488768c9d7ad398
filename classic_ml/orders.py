"""Which order: noise model, C, whole-sample input lag and degree, set side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.checks import whiteness
from classic_ml.lag_regressor import LagRegressor
from classic_ml.noise_models import MAXIMUM_ORDER, NOISE_KINDS, NoiseKind
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.lag import Hold
from surge_core.segments import runs_of
from surge_core.types import FloatArray
from surge_core.validation import one_of, whole_number

__all__ = ["OrderRow", "OrderTable", "select_order"]

# As many rows train as in a comparison, and the later ones test.
TRAIN_SHARE = 2.0 / 3.0
FEWEST_BLOCKS = 6
FEWEST_ROWS = 30


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
        Free-run error on the later cycles, by a fit to the earlier ones; nan where none were
        held out.
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


@dataclass(frozen=True)
class _Candidate:
    noise: NoiseKind
    noise_order: int
    input_lag: int
    degree: int


@dataclass(frozen=True)
class _Fitted:
    candidate: _Candidate
    model: LagRegressor
    n_parameters: int
    log_power: float
    white: bool
    blocks: FloatArray


def select_order(
    X: ArrayLike,
    y: ArrayLike,
    segments: ArrayLike | None = None,
    *,
    sample_period_s: float,
    noise: Sequence[NoiseKind] = NOISE_KINDS,
    noise_orders: Sequence[int] = (0, 1, 2),
    input_lags: Sequence[int] = (0, 1, 2),
    degrees: Sequence[int] = (1, 2, 3),
    hold: Hold = "first",
    sample_weight: ArrayLike | None = None,
    hold_out: bool = True,
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
        Noise models.
    noise_orders : sequence of int
        Degrees of C for armax, 0 to 2; 0 is arx and is fitted once.
    input_lags : sequence of int
        Whole samples by which φ acts late. All models are fitted to the rows that the longest
        of them leaves.
    degrees : sequence of int
        Degrees of the characteristic.
    hold : {"zero", "first"}
        How φ acts between samples.
    sample_weight : array-like of shape (n,), optional
        Weights; a row of weight 0 is simulated through but not scored.
    hold_out : bool
        Score each model on the last third of the cycles too, by a fit to the others.
    progress : callable
        Wraps the iteration over the models, to show how far it is.

    Returns
    -------
    OrderTable

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
    candidates = _candidates(noise, noise_orders, input_lags, degrees)
    runs = runs_of(segments, target.size)
    weight = (
        np.ones(target.size) if sample_weight is None else np.asarray(sample_weight, np.float64)
    )
    data = _Rows(inputs, target, weight, runs, max(input_lags))
    if data.y.size < FEWEST_ROWS:
        raise InputError(
            "select_order",
            expected=f"at least {FEWEST_ROWS} rows after the longest input lag",
            found=str(data.y.size),
        )
    train = data.earlier() if hold_out else None
    fitted = [_fit(c, data, train, sample_period_s, hold) for c in progress(candidates)]
    return _table(fitted, data.n_free)


class _Rows:
    """The rows that every candidate can use: those behind the longest input lag of a segment."""

    def __init__(
        self,
        X: FloatArray,
        y: FloatArray,
        weight: FloatArray,
        runs: list[slice],
        longest_lag: int,
    ) -> None:
        kept = [
            np.arange(run.start + longest_lag, run.stop)
            for run in runs
            # Fewer rows than this hold one equation or none.
            if run.stop - run.start - longest_lag > 2
        ]
        self.at = np.concatenate([*kept, np.zeros(0, dtype=np.int64)]).astype(np.int64)
        self.labels = np.repeat(np.arange(len(kept)), [rows.size for rows in kept])
        self._X = X
        self.y, self.weight = y[self.at], weight[self.at]

    def X(self, lag: int) -> FloatArray:
        """Return the inputs that act at each row."""
        return self._X[self.at - lag]

    @property
    def n_free(self) -> int:
        """Scored rows, less one for the start of each segment."""
        scored = self.weight > 0.0
        return int(scored.sum()) - np.unique(self.labels[scored]).size

    def earlier(self) -> NDArray[np.bool_]:
        """Tell which rows train: whole cycles, or the first part of the one segment."""
        runs = runs_of(self.labels, self.labels.size)
        if len(runs) == 1:
            return np.arange(self.y.size) < TRAIN_SHARE * self.y.size
        ends = np.array([run.stop for run in runs])
        n_train = int(np.clip(np.searchsorted(ends, TRAIN_SHARE * ends[-1]), 1, len(runs) - 1))
        return self.labels < n_train


def _candidates(
    noise: Sequence[NoiseKind],
    noise_orders: Sequence[int],
    input_lags: Sequence[int],
    degrees: Sequence[int],
) -> list[_Candidate]:
    if not (noise and noise_orders and input_lags and degrees):
        raise InputError("select_order", expected="at least one of each order", found="none")
    for kind in noise:
        one_of("noise", kind, NOISE_KINDS)
    for order in noise_orders:
        whole_number("noise_orders", order, 0, MAXIMUM_ORDER)
    for lag in input_lags:
        whole_number("input_lags", lag, 0, 1000)
    for degree in degrees:
        whole_number("degrees", degree, 0, 20)
    kinds: list[tuple[NoiseKind, int]] = []
    for kind in noise:
        orders = noise_orders if kind == "armax" else (0,)
        kinds += [("arx", 0) if (kind, c) == ("armax", 0) else (kind, c) for c in orders]
    return [
        _Candidate(kind, c, lag, degree)
        for (kind, c), lag, degree in product(dict.fromkeys(kinds), input_lags, degrees)
    ]


def _fit(
    candidate: _Candidate,
    data: _Rows,
    train: NDArray[np.bool_] | None,
    sample_period_s: float,
    hold: Hold,
) -> _Fitted:
    X = data.X(candidate.input_lag)
    model = _model(candidate, sample_period_s, hold).fit(X, data.y, data.labels, data.weight)
    predicted, known = model.one_step(X, data.y, data.labels)
    scored = known & (data.weight > 0.0)
    errors = (data.y - predicted) * np.sqrt(data.weight)
    runs = runs_of(data.labels, data.y.size)
    power = float(errors[scored] @ errors[scored])
    white = whiteness(np.where(scored, errors, 0.0), runs).passed
    n_parameters = 2 + model.coef_.size + candidate.noise_order
    log_power = math.log(max(power / max(data.n_free, 1), np.finfo(np.float64).tiny))
    blocks = np.zeros((0, 2)) if train is None else _held_out(candidate, model, data, train, X)
    return _Fitted(candidate, model, n_parameters, log_power, white, blocks)


def _model(candidate: _Candidate, sample_period_s: float, hold: Hold) -> LagRegressor:
    return LagRegressor(
        sample_period_s,
        noise=candidate.noise,
        noise_order=max(candidate.noise_order, 1),
        degree=candidate.degree,
        hold=hold,
        # The errors before a segment are then not counted as errors of its rows: the sums of
        # squares of all candidates are over the same equations.
        exact_start=False,
    )


def _held_out(
    candidate: _Candidate,
    model: LagRegressor,
    data: _Rows,
    train: NDArray[np.bool_],
    X: FloatArray,
) -> FloatArray:
    """Return the sum of squares and rows of each held-out block of cycles."""
    trained = _model(candidate, model.sample_period_s, model.hold).fit(
        X[train], data.y[train], data.labels[train], data.weight[train]
    )
    test = ~train
    labels = data.labels[test]
    free_run = trained.simulate(X[test], labels, start=data.y[test])
    squares = (data.y[test] - free_run) ** 2 * (data.weight[test] > 0.0)
    counted = (data.weight[test] > 0.0).astype(np.float64)
    runs = runs_of(labels, labels.size)
    parts = max(1, math.ceil(FEWEST_BLOCKS / len(runs)))
    blocks = []
    for run in runs:
        for low, high in pairwise(np.linspace(run.start, run.stop, parts + 1).astype(int)):
            if counted[low:high].any():
                blocks.append((float(squares[low:high].sum()), float(counted[low:high].sum())))
    return np.asarray(blocks, dtype=np.float64).reshape(-1, 2)


def _table(fitted: list[_Fitted], n: int) -> OrderTable:
    bic = [n * f.log_power + f.n_parameters * math.log(n) for f in fitted]
    aicc = [n * f.log_power + _aicc_penalty(f.n_parameters, n) for f in fitted]
    order = np.argsort(bic, kind="stable").tolist()
    chosen, reason = _recommend(fitted, order)
    rows = {}
    for i in order:
        f = fitted[i]
        _, paired = _difference(f.blocks, fitted[chosen].blocks)
        rows[i] = OrderRow(
            f.candidate.noise,
            f.candidate.noise_order,
            f.candidate.input_lag,
            f.candidate.degree,
            f.n_parameters,
            aicc[i] - min(aicc),
            bic[i] - min(bic),
            _rms(f.blocks),
            paired,
            float(f.model.time_constant_s_),
            float(f.model.time_constant_stderr_s_),
            f.white,
            f.model.fit_state_.code,
        )
    ties = [
        row
        for i, row in rows.items()
        if i == chosen
        or abs(_difference(fitted[i].blocks, fitted[chosen].blocks)[0]) <= row.paired_error
    ]
    ties.sort(key=lambda row: row is not rows[chosen])
    return OrderTable(tuple(rows.values()), rows[chosen], reason, tuple(ties))


def _aicc_penalty(p: int, n: int) -> float:
    return 2.0 * p + 2.0 * p * (p + 1) / (n - p - 1) if n > p + 1 else math.inf


def _recommend(fitted: list[_Fitted], order: list[int]) -> tuple[int, str]:
    """Return the index of the row to take and why, ``order`` being that of the BIC."""
    ended_well = [i for i in order if fitted[i].model.fit_state_ is FitState.CONVERGED]
    if not ended_well:
        return order[0], "no fit ended well: least BIC of fits that should not be used"
    best = ended_well[0]
    if fitted[best].white:
        return best, "least BIC, and its one-step errors are white, so that BIC holds"
    scored = [i for i in ended_well if math.isfinite(_rms(fitted[i].blocks))]
    if not scored:
        return best, "least BIC; its one-step errors are not white, so that BIC is a rough guide"
    leader = min(scored, key=lambda i: _rms(fitted[i].blocks))
    near = [i for i in scored if _within(fitted[i].blocks, fitted[leader].blocks)]
    simplest = min(near, key=lambda i: (fitted[i].n_parameters, _rms(fitted[i].blocks)))
    return simplest, (
        "simplest within one paired standard error of the best on the later cycles; the one-step "
        "errors of the row of least BIC are not white, so that BIC does not hold"
    )


def _within(blocks: FloatArray, reference: FloatArray) -> bool:
    difference, paired = _difference(blocks, reference)
    return difference <= 0.0 or difference <= paired


def _rms(blocks: FloatArray) -> float:
    return math.sqrt(float(blocks[:, 0].sum() / blocks[:, 1].sum())) if blocks.size else math.nan


def _difference(blocks: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return the difference of two rms values and its jackknife error over shared blocks."""
    n = blocks.shape[0]
    if n < 2 or blocks is reference:
        return (0.0, 0.0) if blocks is reference and n else (math.nan, math.nan)
    left_out = np.array(_without_each(blocks)) - np.array(_without_each(reference))
    spread = left_out - left_out.mean()
    error = math.sqrt((n - 1) / n * float(spread @ spread))
    return _rms(blocks) - _rms(reference), error


def _without_each(blocks: FloatArray) -> Iterable[float]:
    squares, rows = blocks.sum(axis=0)
    return [math.sqrt(max(squares - s, 0.0) / (rows - r)) for s, r in blocks]
