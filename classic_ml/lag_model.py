"""LagRegressor: the paper's lag model, fitted by maximum likelihood."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import r2_score
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from classic_ml.characteristics import feature_names, polynomial_basis, term_names
from classic_ml.covariance import block_jackknife, correlation_length
from classic_ml.drift import spline_columns
from classic_ml.errors import InputError
from classic_ml.first_order_lag import FirstOrderLag, Hold
from classic_ml.fit_state import FitState
from classic_ml.likelihood import (
    EquationError,
    LagData,
    Outcome,
    OutputError,
    PredictionModel,
    rank_deficient,
    scan,
    search,
)
from classic_ml.noise_models import MAXIMUM_ORDER, NOISE_KINDS, MovingAverage, NoiseKind
from classic_ml.records import FloatArray
from classic_ml.runs import runs_of
from classic_ml.validation import one_of, positive, whole_number

__all__ = ["LagRegressor"]

SCAN_POINTS = 28
SCAN_ROWS = 20_000
IntArray = NDArray[np.int64]


class LagRegressor(RegressorMixin, BaseEstimator):
    """First-order lag on a quasi-steady characteristic, τ dψ'/dt + ψ' = Σ β_i s_i(φ).

    Parameters
    ----------
    sample_period_s : float
        Time between two rows, in seconds.
    noise : {"arx", "armax", "output-error"}
        What the error is taken to be: white in the equation (Eq 9), a moving average in the
        equation, or on the output alone.
    drift : {None, "spline"}
        ``"spline"`` adds a slow piecewise-linear drift to the output, with which the level of
        ψ' may wander without being read as a long time constant. Each segment has a drift of
        its own; one shorter than the knots has a level of its own.
    degree : int
        Degree of the polynomial ψ'_QS(φ), where no ``basis`` is given.
    hold : {"zero", "first"}
        ``"zero"`` is Eq 9-11 to the letter: s[k] acts from k to k+1. ``"first"`` joins the
        samples of s by straight lines; it is right for a continuous φ.
    basis : scikit-learn transformer, optional
        Makes the terms s_i from X in place of the polynomial, e.g. :class:`PiecewiseLinear` for
        the inputs of Fig 22. It brings its own constant or does without.
    noise_order : int
        Degree of C, 0 to 2, for ``noise="armax"``.
    knot_spacing_s : float
        Distance of the drift's knots, in seconds.
    link_segments : bool
        Join the segments into one series as the paper did, equations straddling the joins. It
        multiplies the error of the curve by ten and serves to reproduce the paper.
    exact_start : bool
        Give the errors before each segment of an armax model their share in the likelihood.
        False starts the recursion of C from zero, as the classical programs do; that biases τ
        by a per cent or two on segments of some sixty rows with white output noise.

    Attributes
    ----------
    time_constant_s_, time_constant_stderr_s_ : float
        τ and its standard error, in seconds; nan where no lag could be identified.
    terms_ : list of str
        Names of the terms.
    coef_ : ndarray of shape (n_terms,)
        β, the coefficients of the quasi-steady characteristic.
    covariance_ : ndarray of shape (n_terms, n_terms)
        Covariance of ``coef_``, valid for coloured residuals.
    parameter_covariance_ : ndarray of shape (n_terms + 1, n_terms + 1)
        Covariance of (τ in seconds, β).
    moving_average_ : ndarray of shape (order,)
        Coefficients of C.
    drift_coef_ : ndarray
        Coefficients of the drift.
    fit_state_ : FitState
        How the fit ended, with advice.
    residual_std_ : float
        Standard deviation of the scored prediction errors; weights only set their shares.
    n_blocks_ : int
        Blocks (segments, or pieces of a long one) over which the jackknife behind the standard
        errors ran.
    n_scored_ : int
        Equations (or rows, for output error) that were scored.

    Notes
    -----
    ψ'[k+1] - a ψ'[k] = Σ b_i s_i[k], a = exp(-h/τ), b_i = (1 - a) β_i (paper, Eq 9-11); with
    first-order hold both s[k] and s[k+1] enter. Each segment starts from a state of its own. In
    several segments no equation straddles two. A row of weight 0 is simulated through but not
    scored.
    """

    def __init__(
        self,
        sample_period_s: float = 1e-3,
        noise: NoiseKind = "armax",
        drift: Literal["spline"] | None = None,
        degree: int = 2,
        hold: Hold = "zero",
        basis: Any = None,
        noise_order: int = 1,
        knot_spacing_s: float = 1.0,
        link_segments: bool = False,
        exact_start: bool = True,
    ) -> None:
        self.sample_period_s = sample_period_s
        self.noise = noise
        self.drift = drift
        self.degree = degree
        self.hold = hold
        self.basis = basis
        self.noise_order = noise_order
        self.knot_spacing_s = knot_spacing_s
        self.link_segments = link_segments
        self.exact_start = exact_start

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        segments: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> Self:
        """Fit τ and the characteristic.

        Parameters
        ----------
        X : array-like of shape (n, n_features)
            Inputs, φ in the one column of the usual case; rows in time order.
        y : array-like of shape (n,)
            ψ' (or ψ).
        segments : array-like of int, shape (n,), optional
            Label of each row; rows of one label that follow each other are a segment.
        sample_weight : array-like of shape (n,), optional
            Weight of each squared error; a row of weight 0 is simulated through but not scored.

        Returns
        -------
        LagRegressor
            The fitted estimator.

        Raises
        ------
        InputError
            When a parameter is out of its range or the labels do not match the rows.
        ValueError
            For malformed arrays, as scikit-learn's estimators raise.
        """
        self._check_parameters()
        X, y = self._validated(X, y, reset=True)
        weight = _check_sample_weight(sample_weight, X, dtype=np.float64, ensure_non_negative=True)
        runs = runs_of(segments, y.size)
        runs = [slice(0, y.size)] if self.link_segments else runs
        terms = self._fit_basis(X)
        data = LagData(
            y,
            terms,
            self._drift_columns(weight, runs),
            weight,
            tuple(runs),
            float(self.sample_period_s),
            self.hold,
        )
        model = self._model(data)
        n_free = data.n_linear + 1 + (self._order if self.noise == "armax" else 0)
        if sum(model.piece_lengths()) <= n_free:
            self._store_static(data)
        else:
            self._store(search(model, self._starts(model, data)), data)
        return self

    def predict(self, X: ArrayLike, segments: ArrayLike | None = None) -> FloatArray:
        """Return the free run of ψ', each segment from rest on its characteristic.

        Parameters
        ----------
        X : array-like of shape (n, n_features)
            Inputs; rows in time order.
        segments : array-like of int, shape (n,), optional
            Labels as in :meth:`fit`.

        Returns
        -------
        ndarray of shape (n,)
        """
        return self.simulate(X, segments)

    def simulate(
        self, X: ArrayLike, segments: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> FloatArray:
        """Return the free run of ψ' from given starts (the reconstruction of the paper's Fig 27).

        Parameters
        ----------
        X : array-like of shape (n, n_features)
            Inputs; rows in time order.
        segments : array-like of int, shape (n,), optional
            Labels as in :meth:`fit`.
        start : array-like of shape (n,), optional
            Only the value at the first row of each segment is used: ψ' there. Without it a
            segment starts on its characteristic.

        Returns
        -------
        ndarray of shape (n,)
        """
        check_is_fitted(self)
        inputs = np.asarray(validate_data(self, X, dtype=np.float64, reset=False))
        quasi_steady = self._terms_of(inputs) @ self.coef_
        if np.isnan(self.time_constant_s_):
            return quasi_steady
        begin = quasi_steady if start is None else np.asarray(start, dtype=np.float64)
        lag = FirstOrderLag(self.time_constant_s_, float(self.sample_period_s), self.hold)
        free_run = np.empty_like(quasi_steady)
        for run in runs_of(segments, quasi_steady.size):
            free_run[run] = lag.respond(quasi_steady[run], begin[run.start])
        return free_run

    def one_step(
        self, X: ArrayLike, y: ArrayLike, segments: ArrayLike | None = None
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the one-step predictions of y and which rows have one.

        Parameters
        ----------
        X : array-like of shape (n, n_features)
            Inputs; rows in time order.
        y : array-like of shape (n,)
            ψ' as measured.
        segments : array-like of int, shape (n,), optional
            Labels as in :meth:`fit`.

        Returns
        -------
        prediction : ndarray of shape (n,)
            For output error the free run from each segment's least-squares start; the drift of
            the fitted record is not part of it.
        known : ndarray of bool, shape (n,)
            False at the first row of each segment of an equation-error model.
        """
        check_is_fitted(self)
        X, y = self._validated(X, y, reset=False)
        terms = self._terms_of(X)
        known = np.ones(y.size, dtype=np.bool_)
        if np.isnan(self.time_constant_s_):
            return terms @ self.coef_, known
        runs = tuple(runs_of(segments, y.size))
        data = LagData(
            y,
            terms,
            np.zeros((y.size, 0)),
            np.ones(y.size),
            runs,
            float(self.sample_period_s),
            self.hold,
        )
        shape = np.array([np.log(self.time_constant_s_)])
        prediction = np.empty_like(y)
        if self.noise == "output-error":
            lag = data.lag(shape[0])
            starts = OutputError(data).starts(shape, self.coef_)
            for run, start in zip(runs, starts, strict=True):
                prediction[run] = lag.respond(terms[run] @ self.coef_, start)
            return prediction, known
        lag, whitener = data.lag(shape[0]), self._moving_average()
        for run in runs:
            errors = y[run][1:] - lag.a * y[run][:-1] - lag.drive(terms[run] @ self.coef_)
            prediction[run.start] = y[run.start]
            prediction[run.start + 1 : run.stop] = y[run][1:] - whitener.whiten(errors)
            known[run.start] = False
        return prediction, known

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the quasi-steady characteristic and its standard error.

        Parameters
        ----------
        phi : array-like of shape (n,) or (n, n_features)
            Inputs at which it is wanted.

        Returns
        -------
        value, stderr : ndarray of shape (n,)
        """
        check_is_fitted(self)
        points = np.asarray(phi, dtype=np.float64)
        points = points.reshape(-1, self.n_features_in_) if points.ndim < 2 else points
        terms = self._terms_of(points)
        variance: FloatArray = np.einsum("ij,jk,ik->i", terms, self.covariance_, terms)
        return terms @ self.coef_, np.sqrt(np.maximum(variance, 0.0))

    def score(
        self,
        X: ArrayLike,
        y: ArrayLike,
        segments: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> float:
        """Return R² of the free run.

        Parameters
        ----------
        X : array-like of shape (n, n_features)
            Inputs; rows in time order.
        y : array-like of shape (n,)
            ψ' as measured.
        segments : array-like of int, shape (n,), optional
            Labels as in :meth:`fit`.
        sample_weight : array-like of shape (n,), optional
            Weight of each row.
        """
        return float(r2_score(y, self.predict(X, segments), sample_weight=sample_weight))

    def equation(self) -> str:
        """Return the fitted model as one line with units."""
        check_is_fitted(self)
        parts = [f"{value:+.4g}" + _factor(name) for name, value in self._named()]
        right = " ".join(parts).removeprefix("+")
        if np.isnan(self.time_constant_s_):
            return f"y = {right}"
        return f"({self.time_constant_s_:.4g} s) dy/dt + y = {right}"

    def _named(self) -> list[tuple[str, float]]:
        return list(zip(self.terms_, self.coef_.tolist(), strict=True))

    def __sklearn_tags__(self) -> Any:
        """Declare what scikit-learn's checks should know."""
        tags = super().__sklearn_tags__()
        # With zero-order hold ψ' answers to the row before: rows in random order leave nothing.
        tags.regressor_tags.poor_score = True
        return tags

    @property
    def _order(self) -> int:
        return self.noise_order if self.noise == "armax" else 0

    def _check_parameters(self) -> None:
        one_of("noise", self.noise, NOISE_KINDS)
        one_of("drift", self.drift, (None, "spline"))
        one_of("hold", self.hold, ("zero", "first"))
        positive("sample_period_s", self.sample_period_s)
        positive("knot_spacing_s", self.knot_spacing_s)
        whole_number("degree", self.degree, 0, 20)
        whole_number("noise_order", self.noise_order, 0, MAXIMUM_ORDER)

    def _validated(
        self, X: ArrayLike, y: ArrayLike, *, reset: bool
    ) -> tuple[FloatArray, FloatArray]:
        checked = validate_data(
            self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2, reset=reset
        )
        return np.asarray(checked[0]), np.asarray(checked[1], dtype=np.float64)

    def _fit_basis(self, X: FloatArray) -> FloatArray:
        self.basis_ = polynomial_basis(self.degree) if self.basis is None else clone(self.basis)
        terms = np.asarray(self.basis_.fit_transform(X), dtype=np.float64)
        if terms.ndim != 2 or terms.shape[0] != X.shape[0] or not np.all(np.isfinite(terms)):
            raise InputError(
                "basis", expected="a finite table with one row a sample", found=f"{terms.shape}"
            )
        names = feature_names(X.shape[1], getattr(self, "feature_names_in_", None))
        self.terms_ = term_names(self.basis_, names, terms.shape[1])
        return terms

    def _terms_of(self, X: FloatArray) -> FloatArray:
        return np.asarray(self.basis_.transform(X), dtype=np.float64)

    def _drift_columns(self, weight: FloatArray, runs: list[slice]) -> FloatArray:
        if self.drift is None:
            return np.zeros((weight.size, 0))
        return spline_columns(weight, runs, self.sample_period_s, self.knot_spacing_s)

    def _model(self, data: LagData) -> PredictionModel:
        if self.noise == "output-error":
            return OutputError(data)
        return EquationError(data, self._order, bool(self.exact_start))

    def _moving_average(self) -> MovingAverage:
        return MovingAverage.from_coefficients(self.moving_average_)

    def _starts(self, model: PredictionModel, data: LagData) -> list[FloatArray]:
        """Scan log τ on the head of the record; armax starts from arx and from output error."""
        head = data.head(SCAN_ROWS)
        if sum(self._model(head).piece_lengths()) <= data.n_linear + 3:
            head = data
        low, high = head.log_tau_bounds
        grid = np.linspace(low + np.log(10.0), high, SCAN_POINTS)
        nothing = np.zeros(0)
        if self.noise == "output-error":
            return [np.array([scan(OutputError(head), grid, nothing)])]
        arx = scan(EquationError(head, 0), grid, nothing)
        starts = [np.concatenate([[arx], np.zeros(self._order)])]
        if self._order > 0:
            free = scan(OutputError(head), grid, nothing)
            # Output error is armax with C = A: the other end of the family.
            c = np.zeros(self._order)
            c[0] = -data.lag(free).a
            starts.append(np.concatenate([[free], MovingAverage.from_coefficients(c).free]))
        if head.y.size < data.y.size:
            # On a long record the choice among the starts is made on its head.
            return [search(self._model(head), starts).shape]
        return starts

    def _store(self, outcome: Outcome, data: LagData) -> None:
        n_terms, weight = data.terms.shape[1], data.weight
        n_rows, n_parameters = outcome.jacobian.shape
        n_lags = correlation_length(outcome.innovations, outcome.piece_lengths)
        covariance, self.n_blocks_ = block_jackknife(
            outcome.jacobian, outcome.innovations, outcome.piece_lengths, n_lags
        )
        n_shape = outcome.shape.size
        keep = [0, *range(n_shape, n_shape + n_terms)]
        covariance = covariance[np.ix_(keep, keep)]
        self.time_constant_s_ = float(np.exp(outcome.shape[0]))
        # The search runs over log τ: dτ = τ d(log τ), the delta method of Eq 10.
        to_tau = np.ones(n_terms + 1)
        to_tau[0] = self.time_constant_s_
        self.parameter_covariance_ = covariance * np.outer(to_tau, to_tau)
        self.time_constant_stderr_s_ = float(np.sqrt(self.parameter_covariance_[0, 0]))
        self.coef_ = outcome.coef[:n_terms]
        self.covariance_ = self.parameter_covariance_[1:, 1:]
        self.drift_coef_ = outcome.coef[n_terms:]
        self.moving_average_ = MovingAverage(outcome.shape[1:]).coefficients
        deficient = rank_deficient(outcome, n_shape, n_terms)
        self.fit_state_ = FitState.RANK_DEFICIENT if deficient else outcome.state
        mean_weight = float(weight.sum() / max(np.count_nonzero(weight), 1))
        freedom = max(n_rows - n_parameters, 1)
        self.residual_std_ = float(np.sqrt(outcome.cost / freedom / mean_weight))
        self.residual_lag_ = n_lags
        self.n_scored_ = n_rows

    def _store_static(self, data: LagData) -> None:
        """Without enough rows for a lag: the weighted static curve of least norm, and a code."""
        root = np.sqrt(data.weight)
        n_terms = data.terms.shape[1]
        coef = np.asarray(np.linalg.lstsq(data.terms * root[:, None], data.y * root)[0])
        error = (data.y - data.terms @ coef) * root
        self.time_constant_s_ = self.time_constant_stderr_s_ = float("nan")
        self.coef_ = np.asarray(coef, dtype=np.float64)
        self.covariance_ = np.full((n_terms, n_terms), np.nan)
        self.parameter_covariance_ = np.full((n_terms + 1, n_terms + 1), np.nan)
        self.drift_coef_ = np.zeros(data.drift.shape[1])
        self.moving_average_ = np.zeros(self._order)
        self.fit_state_ = FitState.TOO_FEW_ROWS
        self.residual_std_ = float(np.sqrt(np.mean(error**2)))
        self.residual_lag_ = 1
        self.n_blocks_ = 0
        self.n_scored_ = int(np.count_nonzero(data.weight))


def _factor(name: str) -> str:
    return "" if name == "1" else f" {name}"
