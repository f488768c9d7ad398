"""Sparse regression of the lag model behind scikit-learn's interface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_is_fitted, validate_data

from sindy_surge.equations import format_equation
from sindy_surge.errors import InputError
from sindy_surge.free_run import Hold, Segments, hold_coefficients, simulate
from sindy_surge.states import FitState

__all__ = ["SparseLagRegressor"]

FloatArray = NDArray[np.float64]

# Equations that a lag with its simplest characteristic (1, φ) needs beside its own unknowns.
_SPARE_EQUATIONS = 8


class SparseLagRegressor(RegressorMixin, BaseEstimator):
    """Find the terms of ψ'_QS(φ) and the lag τ dψ'/dt + ψ' = Σ β_i s_i(φ) in a record.

    A pysindy library supplies the candidate terms, a pysindy optimizer the path through them,
    on equations whitened for noise in both φ and ψ'. The smallest structure that no other
    refutes about its own fit is kept. Where the error of the model exceeds the noise by far, as
    on records that went through a low-pass filter, that likelihood means nothing: then the
    degree of a polynomial is chosen by cycles left out, and fitted in the weak form.

    Parameters
    ----------
    sample_period_s : float
        Sample period h in seconds.
    hold : {"first", "zero"}
        "first": φ is sampled from a continuous signal, the terms are joined by straight lines,
        and the fit allows for the bend of a smooth signal between samples. "zero": s_i[k] acts
        from k to k + 1 (Eq 9-11 of the paper). The wrong one biases τ by 2-3 %.
    library : pysindy feature library, scikit-learn transformer or None
        The candidate terms; None builds polynomials, hinges, the reverse-flow branch and
        exponentials over the range of the data.
    optimizer : {"SSR", "STLSQ", "FROLS"} or pysindy optimizer
        What proposes the structures.
    max_terms : int
        Largest structure considered.
    degree : int
        Highest degree of the default library's polynomials.
    knots : array-like of float or None
        Knots of the default library's hinges; None takes round numbers within the data.

    Attributes
    ----------
    time_constant_s_ : float
        τ in seconds; nan if the fit is static.
    time_constant_stderr_s_ : float
        Its standard error in seconds.
    terms_ : tuple of str
        Names of the selected terms.
    coef_ : ndarray of shape (n_terms,)
        β_i of ψ'_QS, in physical units.
    covariance_ : ndarray of shape (n_terms, n_terms)
        Covariance of `coef_`: sandwich with Newey-West scores, τ estimated along; where model
        error dominates, a jackknife over cycles, with what a repeated error and the choice of
        the test function add. It holds for the terms as selected.
    joint_covariance_ : ndarray of shape (n_terms + 1, n_terms + 1)
        The same with τ as the last row and column.
    candidate_terms_ : tuple of str
        Every name of the library.
    fit_state_ : FitState
        What became of the fit; `fit_state_.advice` says what to do.
    path_ : tuple of PathRow
        Every structure proposed or tested, with its score.
    rivals_ : tuple of tuple of str
        Structures of the same size that the data cannot tell from the chosen one.
    weak_form_ : WeakLag or None
        The two weak estimates of τ, whose gap measures the noise.
    noise_ : tuple of (float, ndarray) or None
        Standard deviations found for the noise of ψ' and of each input.
    initial_states_ : ndarray of shape (n_segments,)
        ψ' at the start of each segment of the training data.
    feature_range_ : ndarray of shape (2, n_features_in_)
        Least and greatest value of each input: where the characteristic is more than a guess.
    n_features_in_ : int
        Number of inputs.

    See Also
    --------
    sindy_surge.selection.select_structure : How the terms are chosen.
    sindy_surge.held_out.select_by_held_out : How, where model error dominates.
    """

    def __init__(
        self,
        sample_period_s: float = 1e-3,
        hold: Hold = "first",
        *,
        library: Any = None,
        optimizer: Any = "SSR",
        max_terms: int = 6,
        degree: int = 5,
        knots: Sequence[float] | None = None,
    ) -> None:
        self.sample_period_s = sample_period_s
        self.hold = hold
        self.library = library
        self.optimizer = optimizer
        self.max_terms = max_terms
        self.degree = degree
        self.knots = knots

    def fit(
        self, X: ArrayLike, y: ArrayLike, segments: ArrayLike | None = None
    ) -> SparseLagRegressor:
        """Select the terms and estimate τ and the coefficients.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_features)
            Inputs at the samples; one column is φ.
        y : array-like of shape (n_rows,)
            ψ' at the samples.
        segments : array-like of shape (n_rows,) or None
            Integer label of each row. Every contiguous run of one label is a segment with its
            own initial state; no equation straddles two.

        Returns
        -------
        SparseLagRegressor
            This estimator.

        Raises
        ------
        ValueError
            For malformed or non-finite data (from scikit-learn).
        InputError
            For parameters, labels or a library that cannot be used.
        """
        self._check_parameters()
        X_checked, y_checked = validate_data(
            self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2
        )
        y_checked = y_checked.astype(np.float64)
        runs = Segments.from_labels(segments, X_checked.shape[0])
        from sindy_surge.library import CandidateTerms, independent_columns

        self._input_names = self._names_of_inputs()
        self._candidates = CandidateTerms(
            self.library, X_checked, self._input_names, degree=self.degree, knots=self.knots
        )
        self.candidate_terms_ = self._candidates.names
        self.feature_range_ = np.stack((X_checked.min(axis=0), X_checked.max(axis=0)))
        values = self._candidates(X_checked)
        columns = independent_columns(values)
        equations = int(runs.later.size)
        if columns.size < 1 or equations < _SPARE_EQUATIONS + 3:
            self._fit_static(values, y_checked, runs, FitState.TOO_FEW_ROWS)
        elif _constant(X_checked) or _constant(y_checked[:, None]):
            self._fit_static(values[:, columns], y_checked, runs, FitState.CONSTANT_SIGNAL, columns)
        else:
            self._fit_lag(X_checked, y_checked, runs, columns)
        return self

    def _check_parameters(self) -> None:
        period: Any = self.sample_period_s
        if not (isinstance(period, (int, float, np.number)) and np.isfinite(period) and period > 0):
            raise InputError(
                "sample_period_s", expected="a positive time in seconds", found=repr(period)
            )
        if self.hold not in ("first", "zero"):
            raise InputError("hold", expected='"first" or "zero"', found=repr(self.hold))
        if self.knots is not None and not np.all(np.isfinite(np.asarray(self.knots, dtype=float))):
            raise InputError("knots", expected="finite values of φ", found=repr(self.knots))
        for name in ("max_terms", "degree"):
            value: Any = getattr(self, name)
            if not (isinstance(value, (int, np.integer)) and value >= 1):
                raise InputError(name, expected="a whole number of at least 1", found=repr(value))

    def _names_of_inputs(self) -> list[str]:
        if hasattr(self, "feature_names_in_"):
            return [str(name) for name in self.feature_names_in_]
        if self.n_features_in_ == 1:
            return ["phi"]
        return [f"x{j}" for j in range(self.n_features_in_)]

    def _fit_lag(
        self, X: FloatArray, y: FloatArray, runs: Segments, columns: NDArray[np.intp]
    ) -> None:
        from sindy_surge.covariance import sandwich
        from sindy_surge.held_out import (
            model_error_dominates,
            select_by_held_out,
            with_held_out,
        )
        from sindy_surge.lag_problem import LagProblem
        from sindy_surge.library import polynomial_degree
        from sindy_surge.preparation import prepare
        from sindy_surge.selection import select_structure
        from sindy_surge.whitening import NoiseLevels

        silent = NoiseLevels(1.0, np.zeros(X.shape[1]), np.empty(0))
        prepared = prepare(
            LagProblem(
                X,
                y,
                runs,
                float(self.sample_period_s),
                self.hold,
                self._candidates,
                columns,
                silent,
            )
        )
        usable = prepared.problem.columns
        names = [self.candidate_terms_[i] for i in usable]
        self.weak_form_ = prepared.weak
        self.noise_: tuple[float, FloatArray] | None = (
            prepared.problem.noise.output,
            prepared.problem.noise.inputs,
        )
        chosen = select_structure(prepared, self.optimizer, int(self.max_terms), names)
        dominated = model_error_dominates(prepared, chosen.consistent)
        robust = None
        if dominated:
            degrees = [polynomial_degree(name, self._input_names) for name in names]
            robust = select_by_held_out(
                prepared.problem, self.optimizer, int(self.max_terms), degrees
            )
        self.path_ = chosen.path if robust is None else with_held_out(chosen.path, robust, names)
        self.rivals_ = (
            tuple(tuple(names[i] for i in rival) for rival in chosen.rivals)
            if robust is None
            else ()
        )
        fit = chosen.fit if robust is None else robust
        self._selected = usable[list(fit.support)]
        self.terms_ = tuple(self.candidate_terms_[i] for i in self._selected)
        self.coef_ = fit.coefficients
        self.time_constant_s_ = fit.time_constant_s
        self.joint_covariance_ = (
            sandwich(prepared.problem, chosen.fit) if robust is None else robust.covariance
        )
        self.covariance_ = self.joint_covariance_[:-1, :-1]
        self.time_constant_stderr_s_ = float(np.sqrt(self.joint_covariance_[-1, -1]))
        self.initial_states_ = fit.initial
        if robust is not None:
            state = FitState.MODEL_ERROR_DOMINATES
        elif dominated or not chosen.consistent:
            state = FitState.NO_CONSISTENT_STRUCTURE
        else:
            state = FitState.OK if chosen.fit.converged else FitState.NOT_CONVERGED
        self.fit_state_ = self._state(state, prepared.problem.longest_lag_s)

    def _state(self, otherwise: FitState, longest_s: float) -> FitState:
        tau, error = self.time_constant_s_, self.time_constant_stderr_s_
        # A held input shows the lag only through the pole e^(-h/τ), which is soon next to nothing.
        pole_error = np.exp(-self.sample_period_s / tau) * self.sample_period_s / tau**2 * error
        hidden = self.hold == "zero" and np.exp(-self.sample_period_s / tau) < 3 * pole_error
        if tau < self.sample_period_s / 20 or (hidden and tau < self.sample_period_s):
            return FitState.LAG_BELOW_RESOLUTION
        # The error of τ then includes that of the model, and longer segments are no remedy.
        if otherwise is FitState.MODEL_ERROR_DOMINATES:
            return otherwise
        if not error < tau or tau > 0.99 * longest_s:
            return FitState.LAG_UNDETERMINED
        return otherwise

    def _fit_static(
        self,
        values: FloatArray,
        y: FloatArray,
        runs: Segments,
        state: FitState,
        columns: NDArray[np.intp] | None = None,
    ) -> None:
        """Fit ψ' = ψ'_QS(φ) with coefficients of least norm, each on its unit-size term."""
        norms = np.linalg.norm(values, axis=0)
        norms[norms == 0] = 1.0
        solution = np.linalg.lstsq(values / norms, y, rcond=1e-10)[0]
        kept = np.flatnonzero(np.abs(solution) > 1e-10 * max(np.abs(solution).max(), 1e-300))
        self._selected = kept if columns is None else columns[kept]
        self.terms_ = tuple(self.candidate_terms_[i] for i in self._selected)
        self.coef_ = (solution / norms)[kept]
        size = kept.size
        self.joint_covariance_ = np.full((size + 1, size + 1), np.nan)
        self.covariance_ = np.full((size, size), np.nan)
        self.time_constant_s_ = self.time_constant_stderr_s_ = float("nan")
        self.path_, self.rivals_ = (), ()
        self.weak_form_ = self.noise_ = None
        self.initial_states_ = y[runs.starts]
        self.fit_state_ = state

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Evaluate ψ'_QS and its standard error.

        Parameters
        ----------
        phi : array-like of shape (n,) or (n, n_features)
            Inputs; a flat array is φ alone.

        Returns
        -------
        psi_p_qs : ndarray of shape (n,)
            Quasi-steady pressure coefficient.
        stderr : ndarray of shape (n,)
            Its standard error from `covariance_`; nan for a static fit.

        Raises
        ------
        InputError
            If the inputs are not one column for each feature.
        """
        check_is_fitted(self)
        inputs = np.asarray(phi, dtype=np.float64)
        if inputs.ndim < 2:
            inputs = inputs.reshape(-1, 1)
        if inputs.ndim != 2 or inputs.shape[1] != self.n_features_in_:
            raise InputError(
                "phi",
                expected=f"{self.n_features_in_} column(s)",
                found=f"an array of shape {inputs.shape}",
            )
        if inputs.shape[0] == 0:
            return np.empty(0), np.empty(0)
        values = self._candidates(inputs)[:, self._selected]
        variance = np.einsum("ij,jk,ik->i", values, self.covariance_, values)
        return values @ self.coef_, np.sqrt(np.maximum(variance, 0.0))

    def predict(self, X: ArrayLike, segments: ArrayLike | None = None) -> FloatArray:
        """Run the lag freely over the inputs, each segment from equilibrium at its first row.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_features)
            Inputs at the samples, in the order of time.
        segments : array-like of shape (n_rows,) or None
            Integer label of each row, as in `fit`.

        Returns
        -------
        ndarray of shape (n_rows,)
            ψ' of the free run; no measured ψ' enters.
        """
        check_is_fitted(self)
        checked = validate_data(self, X, dtype=np.float64, reset=False)
        runs = Segments.from_labels(segments, checked.shape[0])
        forcing, _ = self.characteristic(checked)
        if np.isnan(self.time_constant_s_):
            return forcing
        lag = hold_coefficients(self.time_constant_s_, float(self.sample_period_s), self.hold)
        return simulate(forcing, runs, lag, forcing[runs.starts])

    def score(
        self,
        X: ArrayLike,
        y: ArrayLike,
        sample_weight: ArrayLike | None = None,
        segments: ArrayLike | None = None,
    ) -> float:
        """Return R² of the free run.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_features)
            Inputs at the samples.
        y : array-like of shape (n_rows,)
            Measured ψ'.
        sample_weight : array-like of shape (n_rows,) or None
            Weight of each row in R².
        segments : array-like of shape (n_rows,) or None
            Integer label of each row, as in `fit`.

        Returns
        -------
        float
            Coefficient of determination.
        """
        return float(r2_score(y, self.predict(X, segments=segments), sample_weight=sample_weight))

    def equation(self, style: Literal["text", "latex", "python"] = "text") -> str:
        """Write the identified equation, rounded to its uncertainty, with units.

        Parameters
        ----------
        style : {"text", "latex", "python"}
            "python" gives the source of a function that returns ψ'_QS.

        Returns
        -------
        str
            The equation.
        """
        check_is_fitted(self)
        if style not in ("text", "latex", "python"):
            raise InputError("style", expected='"text", "latex" or "python"', found=repr(style))
        return format_equation(
            self.terms_,
            self.coef_.tolist(),
            np.sqrt(np.diag(self.covariance_)).tolist(),
            self.time_constant_s_,
            self.time_constant_stderr_s_,
            style,
        )

    def __sklearn_tags__(self) -> Any:
        """State that a free run over rows without time order fits them poorly."""
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags


def _constant(values: FloatArray) -> bool:
    spread = np.ptp(values, axis=0)
    return bool(np.all(spread <= 1e-12 * np.maximum(np.abs(values).max(axis=0), 1e-300)))
