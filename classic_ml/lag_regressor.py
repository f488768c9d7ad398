"""LagRegressor: the paper's lag model, fitted by maximum likelihood."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import r2_score
from sklearn.preprocessing import PolynomialFeatures
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from classic_ml.characteristics import (
    feature_names,
    lag_sheet,
    polynomial_names,
    term_names,
)
from classic_ml.lag_data import (
    MAXIMUM_ORDER,
    NOISE_KINDS,
    LagData,
    MovingAverage,
    NoiseKind,
    Terms,
    nearly_orthogonal,
)
from classic_ml.lag_fit import LagFit, fit_lag
from classic_ml.likelihood import LinearisedFit, linearised
from surge_core.display import Field, FittedDisplay, Sheet
from surge_core.errors import one_of, positive, require, whole_number
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag, Hold
from surge_core.leave_out import scatter
from surge_core.rounding import significant
from surge_core.segments import is_constant, runs_of
from surge_core.types import BoolArray, FloatArray


class LagRegressor(FittedDisplay, RegressorMixin, BaseEstimator):
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
    time_constant_s : float, optional
        Hold τ at this value, in seconds, and fit all else (for trial fits).

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
        Levels of the drift at its knots above that at the last. Its mean over the scored rows is
        zero: ``coef_`` and the curve hold at the mean level of the record.
    fit_state_ : FitState
        How the fit ended, with advice.
    residual_std_ : float
        Standard deviation of the scored prediction errors; weights only set their shares.
    n_blocks_ : int
        Blocks (segments, or pieces of a long one) over which the jackknife behind the standard
        errors ran.
    n_scored_ : int
        Equations (or rows, for output error) that were scored.
    residual_lag_ : int
        Rows over which the errors hang together.

    Notes
    -----
    ψ'[k+1] - a ψ'[k] = Σ b_i s_i[k], a = exp(-h/τ), b_i = (1 - a) β_i (paper, Eq 9-11); with
    first-order hold both s[k] and s[k+1] enter. Each segment starts from a state of its own, and no
    equation straddles two.
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
        time_constant_s: float | None = None,
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
        self.time_constant_s = time_constant_s

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

        Raises
        ------
        InputError
            When a parameter is out of its range or the labels do not match the rows.
        ValueError
            For malformed arrays, as scikit-learn's estimators raise.
        """
        self._check_parameters()
        X, y, weight = self._validated(X, y, sample_weight, reset=True)
        runs = self._runs(segments, y.size)
        terms = self._fit_basis(X)
        combined = nearly_orthogonal(terms)
        data = self._data(y, combined, weight, runs)
        if data.scored.size <= data.n_parameters(terms.shape[1]):
            self._store_static(y, terms, data, FitState.TOO_FEW_ROWS)
        elif self.time_constant_s is None and is_constant(y[data.weight > 0.0, None]):
            self._store_static(y, terms, data, FitState.CONSTANT_SIGNAL)
        else:
            self._store(fit_lag(data, combined), data, combined)
        return self

    def predict(
        self, X: ArrayLike, segments: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> FloatArray:
        """Return the free run of ψ' (the reconstruction of the paper's Fig 27).

        Parameters
        ----------
        X : array-like of shape (n, n_features)
            Inputs; rows in time order.
        segments : array-like of int, shape (n,), optional
            Labels as in :meth:`fit`.
        start : array-like of shape (n,), optional
            Only the value at the first row of each segment is used: ψ' there. Without it a
            segment starts at rest, on its characteristic.

        Returns
        -------
        ndarray of shape (n,)
        """
        check_is_fitted(self)
        inputs = np.asarray(validate_data(self, X, dtype=np.float64, reset=False))
        quasi_steady = self.terms_at(inputs) @ self.coef_
        if np.isnan(self.time_constant_s_):
            return quasi_steady
        begin = quasi_steady if start is None else np.asarray(start, dtype=np.float64)
        lag, runs = self._lag(), runs_of(segments, quasi_steady.size)
        known = begin.shape == quasi_steady.shape and np.isfinite(begin[[r.start for r in runs]])
        words = "one ψ' a row, finite where a segment begins"
        require(bool(np.all(known)), "start", words, f"an array of shape {begin.shape}")
        free_run = np.empty_like(quasi_steady)
        for run in runs:
            free_run[run] = lag.respond(quasi_steady[run], begin[run.start])
        return free_run

    def one_step(
        self, X: ArrayLike, y: ArrayLike, segments: ArrayLike | None = None
    ) -> tuple[FloatArray, BoolArray]:
        """Return the one-step predictions of y and which rows have one.

        Parameters
        ----------
        X, y, segments
            As in :meth:`fit`.

        Returns
        -------
        prediction : ndarray of shape (n,)
            For output error the free run from each segment's least-squares start; the drift of
            the fitted record is not part of it.
        known : ndarray of bool, shape (n,)
            False at the first row of each segment of an equation-error model.
        """
        check_is_fitted(self)
        X, y, _ = self._validated(X, y, None, reset=False)
        terms = self.terms_at(X)
        known = np.ones(y.size, dtype=np.bool_)
        if np.isnan(self.time_constant_s_):
            return terms @ self.coef_, known
        lag, whitener = self._lag(), MovingAverage.from_coefficients(self.moving_average_)
        prediction = np.empty_like(y)
        for run in runs_of(segments, y.size):
            quasi_steady = terms[run] @ self.coef_
            if self.noise == "output-error":
                free_run = lag.respond(quasi_steady, quasi_steady[0])
                decay = lag.decay(free_run.size)
                start = decay @ (y[run] - free_run) / (decay @ decay)
                prediction[run] = free_run + start * decay
                continue
            errors = y[run][1:] - lag.a * y[run][:-1] - lag.drive(quasi_steady)
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
        terms = self.terms_at(points)
        # Raw powers of φ all but cancel: t' covariance_ t keeps no digit where the curve has many.
        moves = (terms @ self._curve_back) @ self._curve_moves.T
        share = (len(self._curve_moves) - 1) / len(self._curve_moves)
        return terms @ self.coef_, np.sqrt(share) * np.linalg.norm(moves, axis=1)

    def terms_at(self, X: FloatArray) -> FloatArray:
        """Return the terms s_i, of shape (n, n_terms), at inputs of shape (n, n_features)."""
        if self._is_polynomial:
            return np.vander(X[:, 0], self.degree + 1, increasing=True)
        terms = self.basis_.transform(X)
        return np.asarray(terms.toarray() if hasattr(terms, "toarray") else terms, np.float64)

    def score(
        self,
        X: ArrayLike,
        y: ArrayLike,
        segments: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> float:
        """Return R² of the free run; arguments as in :meth:`fit`."""
        return float(r2_score(y, self.predict(X, segments), sample_weight=sample_weight))

    def equation(self) -> str:
        """Return the fitted model as one line with units."""
        check_is_fitted(self)
        named = zip(self.terms_, self.coef_.tolist(), strict=True)
        parts = [f"{value:+.4g}" + ("" if name == "1" else f" {name}") for name, value in named]
        right = " ".join(parts).removeprefix("+")
        if np.isnan(self.time_constant_s_):
            return f"y = {right}"
        return f"({self.time_constant_s_:.4g} s) dy/dt + y = {right}"

    def linearised(
        self,
        X: ArrayLike,
        y: ArrayLike,
        segments: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> LinearisedFit:
        """Return the errors on rows like those of the fit, and their derivatives.

        Parameters
        ----------
        X, y, segments, sample_weight
            As in :meth:`fit`.

        Returns
        -------
        LinearisedFit
            At the τ, β and C of a fit with a lag; start and drift of each segment are the best for
            these. The recursion of C starts from zero.
        """
        check_is_fitted(self)
        X, y, weight = self._validated(X, y, sample_weight, reset=False)
        runs = self._runs(segments, y.size)
        terms = nearly_orthogonal(self.terms_at(X))
        beta = np.asarray(np.linalg.lstsq(terms.back, self.coef_)[0], dtype=np.float64)
        data = self._data(y, terms, weight, runs)
        free = MovingAverage.from_coefficients(self.moving_average_).free
        shape = np.concatenate([[np.log(self.time_constant_s_)], free])
        return linearised(replace(data, exact_start=False), terms, shape, beta)

    def _sheet(self) -> Sheet | None:
        if not hasattr(self, "fit_state_"):
            return None
        return lag_sheet(
            self,
            f"{self.fit_state_.code}: {self.fit_state_.advice}",
            Field("noise", f"{self.noise}, hold “{self.hold}”"),
            Field("residual (std)", significant(self.residual_std_, 3)),
            Field("scored", f"{self.n_scored_} rows; errors from {self.n_blocks_} blocks"),
        )

    def __sklearn_tags__(self) -> Any:
        """Declare what scikit-learn's checks should know."""
        tags = super().__sklearn_tags__()
        # With zero-order hold ψ' answers to the row before: rows in random order leave nothing.
        tags.regressor_tags.poor_score = True
        return tags

    def _check_parameters(self) -> None:
        one_of("noise", self.noise, NOISE_KINDS)
        one_of("drift", self.drift, (None, "spline"))
        one_of("hold", self.hold, ("zero", "first"))
        positive("sample_period_s", self.sample_period_s)
        positive("knot_spacing_s", self.knot_spacing_s)
        whole_number("degree", self.degree, 0, 20)
        whole_number("noise_order", self.noise_order, 0, MAXIMUM_ORDER)
        if self.time_constant_s is not None:
            positive("time_constant_s", self.time_constant_s)

    def _validated(
        self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None, *, reset: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        X, y = validate_data(
            self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2, reset=reset
        )
        weight = _check_sample_weight(sample_weight, X, dtype=np.float64, ensure_non_negative=True)
        return np.asarray(X), np.asarray(y, dtype=np.float64), np.asarray(weight)

    def _fit_basis(self, X: FloatArray) -> FloatArray:
        names = feature_names(X.shape[1], getattr(self, "feature_names_in_", None))
        if self._is_polynomial:
            self.terms_ = polynomial_names(names[0], self.degree)
            return self.terms_at(X)
        plain = PolynomialFeatures(self.degree)
        self.basis_ = (plain if self.basis is None else clone(self.basis)).fit(X)
        terms = self.terms_at(X)
        table = terms.ndim == 2 and terms.shape[0] == X.shape[0]
        found = "NaN or infinite values" if table else f"{terms.shape}"
        good = table and bool(np.all(np.isfinite(terms)))
        require(good, "basis", "a finite table with one row a sample", found)
        self.terms_ = term_names(self.basis_, names, terms.shape[1])
        return terms

    @property
    def _is_polynomial(self) -> bool:
        """Whether the terms are powers of one input, for which no transformer is needed."""
        return self.basis is None and self.n_features_in_ == 1

    def _lag(self) -> FirstOrderLag:
        return FirstOrderLag(self.time_constant_s_, float(self.sample_period_s), self.hold)

    def _runs(self, segments: ArrayLike | None, n_rows: int) -> list[slice]:
        runs = runs_of(segments, n_rows)
        return [slice(0, n_rows)] if self.link_segments else runs

    def _data(self, y: FloatArray, terms: Terms, weight: FloatArray, runs: list[slice]) -> LagData:
        """Set up the fit, by the parameters that were checked."""
        return LagData(
            y,
            terms.columns,
            weight,
            tuple(runs),
            float(self.sample_period_s),
            self.hold,
            self.noise,
            self.noise_order if self.noise == "armax" else 0,
            bool(self.exact_start),
            None if self.time_constant_s is None else float(np.log(self.time_constant_s)),
            None if self.drift is None else float(self.knot_spacing_s),
        )

    def _store(self, fit: LagFit, data: LagData, terms: Terms) -> None:
        at, n_errors = fit.at, data.scored.size
        tau_s = float(np.exp(at.shape[0]))
        n_terms = terms.back.shape[0]
        # The search runs over log τ: dτ = τ d(log τ), the delta method of Eq 10.
        to_user = np.array([tau_s, *np.ones(n_terms)])
        held = self.time_constant_s
        self.time_constant_s_ = tau_s if held is None else float(held)
        self.parameter_covariance_ = scatter(fit.moves) * np.outer(to_user, to_user)
        self.time_constant_stderr_s_ = float(np.sqrt(self.parameter_covariance_[0, 0]))
        self.coef_ = terms.back @ at.beta
        self.covariance_ = self.parameter_covariance_[1:, 1:]
        self._curve_back, self._curve_moves = terms.back, fit.curve_moves
        self.drift_coef_ = at.levels
        self.moving_average_ = MovingAverage(at.shape[1:]).coefficients
        self.fit_state_ = fit.state
        scored = data.weight[data.weight > 0.0]
        freedom = max(n_errors - data.n_parameters(n_terms), 1)
        self.residual_std_ = float(np.sqrt(at.cost / freedom / scored.mean()))
        self.residual_lag_ = fit.n_lags
        self.n_blocks_ = len(fit.moves)
        self.n_scored_ = n_errors

    def _store_static(
        self, y: FloatArray, terms: FloatArray, data: LagData, state: FitState
    ) -> None:
        """Where no lag can be had: the weighted static curve of least norm, and a code."""
        root = np.sqrt(data.weight)
        n_terms = terms.shape[1]
        coef = np.asarray(np.linalg.lstsq(terms * root[:, None], y * root)[0])
        error = (y - terms @ coef) * root
        self.time_constant_s_ = self.time_constant_stderr_s_ = float("nan")
        self.coef_ = np.asarray(coef, dtype=np.float64)
        self.parameter_covariance_ = np.full((n_terms + 1, n_terms + 1), np.nan)
        self.covariance_ = self.parameter_covariance_[1:, 1:]
        self._curve_back, self._curve_moves = np.zeros((n_terms, 1)), np.full((1, 1), np.nan)
        self.drift_coef_ = np.zeros(data.drift.shape[1])
        self.moving_average_ = np.zeros(data.order)
        self.fit_state_ = state
        self.residual_std_ = float(np.sqrt(np.mean(error**2)))
        self.residual_lag_ = 1
        self.n_blocks_ = 0
        self.n_scored_ = int(np.count_nonzero(data.weight))
