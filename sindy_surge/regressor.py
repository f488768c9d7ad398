"""Sparse regression of the lag model behind scikit-learn's interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.metrics import r2_score
from sklearn.utils.validation import check_is_fitted, validate_data

from sindy_surge.candidate_terms import CandidateTerms, independent_columns
from sindy_surge.constraints import LIMITS, Binding, binding_constraints
from sindy_surge.free_run import FreeModel
from sindy_surge.identification import Choices, identify
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import unit_norms
from sindy_surge.noise import NoiseLevels
from sindy_surge.segments import Segments
from sindy_surge.text import EquationParts, ModelSummary, pysindy_equations, write_equation
from surge_core.display import FittedDisplay, Sheet
from surge_core.errors import one_of, positive, require, whole_number
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag, Hold
from surge_core.segments import is_constant
from surge_core.types import FloatArray

# Equations that a lag with its simplest characteristic (1, φ) needs beside its own unknowns.
_SPARE_EQUATIONS = 8


class SparseLagRegressor(FittedDisplay, RegressorMixin, BaseEstimator):
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
        from k to k + 1 (Eq 9-11 of the paper). The wrong one reads as half a sample of dead time.
    library : pysindy feature library, scikit-learn transformer or None
        The candidate terms; None builds polynomials, hinges, the reverse-flow branch and
        exponentials over the range of the data, and moves the knot of a chosen hinge where the
        data ask for it.
    optimizer : {"SSR", "STLSQ", "FROLS", "best-subset"} or pysindy optimizer
        What proposes the structures; the best subsets of each size are always looked at too.
    max_terms : int
        Largest structure considered.
    psi_terms : bool
        Offer terms that hold ψ' beside the lag's own: ψ'², ψ'³ and products with φ and φ².
    constraints : mapping of str to str, or None
        What is known beforehand: for the name of a term "required", "forbidden", "positive" or
        "negative" (two joined by a space). The lag itself is always there, with τ > 0.
    n_bootstrap : int
        Resamples of the record for `inclusion_probability_`; 0 for none.
    random_state : int, numpy Generator or None
        Seed of the resamples.
    output_name : str
        What the equation calls ψ': "psi" when y is the work coefficient ψ.

    Attributes
    ----------
    time_constant_s_ : float
        τ in seconds; nan if the fit is static.
    time_constant_stderr_s_ : float
        Its standard error in seconds.
    terms_ : tuple of str
        Names of the selected terms.
    coef_ : ndarray of shape (n_terms,)
        β_i, in physical units.
    covariance_ : ndarray of shape (n_terms, n_terms)
        Covariance of `coef_`: sandwich with Newey-West scores, τ estimated along; where model
        error dominates, a jackknife over cycles, with what a repeated error and the choice of
        the test function add. It holds for the terms as selected.
    candidate_terms_ : tuple of str
        Every name of the library.
    fit_state_ : FitState
        What became of the fit; `fit_state_.advice` says what to do.
    path_ : tuple of PathRow
        Every structure proposed or tested, with its score.
    rivals_ : tuple of tuple of str
        Structures of the same size that the data cannot tell from the chosen one.
    inclusion_probability_ : dict of str to float
        For each term that could be chosen the share of resampled records (blocks of rows drawn
        with replacement) whose structure holds it.
    dead_time_s_ : float
        Dead time in seconds: how much later than φ ψ' was measured (negative: φ is late). It is
        tested for before any structure is read, and fitted with every structure where it shows.
    dead_time_stderr_s_ : float
        Its standard error in seconds; 0 if it was not fitted.
    binding_ : tuple of Binding
        Constraints against which the data speak: what is found without any holds the term, or
        has it with the other sign, by more than its standard error allows.
    cautions_ : tuple of str
        What a user should know before the numbers are used.
    noise_ : tuple of (float, ndarray) or None
        Standard deviations found for the noise of ψ' and of each input.
    n_features_in_ : int
        Number of inputs.
    """

    def __init__(
        self,
        sample_period_s: float = 1e-3,
        hold: Hold = "first",
        *,
        library: Any = None,
        optimizer: Any = "SSR",
        max_terms: int = 6,
        psi_terms: bool = True,
        constraints: Mapping[str, str] | None = None,
        n_bootstrap: int = 100,
        random_state: Any = 0,
        output_name: str = "psi_p",
    ) -> None:
        self.sample_period_s = sample_period_s
        self.hold = hold
        self.library = library
        self.optimizer = optimizer
        self.max_terms = max_terms
        self.psi_terms = psi_terms
        self.constraints = constraints
        self.n_bootstrap = n_bootstrap
        self.random_state = random_state
        self.output_name = output_name

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
        positive("sample_period_s", self.sample_period_s)
        one_of("hold", self.hold, ("first", "zero"))
        for name, least in (("max_terms", 1), ("n_bootstrap", 0)):
            whole_number(name, getattr(self, name), least, 1_000_000)
        X_checked, y_checked = validate_data(
            self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=2
        )
        y_checked = y_checked.astype(np.float64)
        runs = Segments.from_labels(segments, X_checked.shape[0])
        alone = ["phi"] if self.n_features_in_ == 1 else None
        plain = alone or [f"x{j}" for j in range(self.n_features_in_)]
        self._input_names = [str(name) for name in getattr(self, "feature_names_in_", plain)]
        self._candidates = CandidateTerms(
            self.library,
            X_checked,
            self._input_names,
            psi_p=y_checked if self.psi_terms else None,
            output_name=self.output_name,
        )
        self.candidate_terms_ = self._candidates.names
        values = self._candidates(X_checked)
        columns = independent_columns(values)
        equations = int(runs.later.size)
        if columns.size < 1 or equations < _SPARE_EQUATIONS + 3:
            every = np.arange(values.shape[1])
            self._fit_static(values, y_checked, FitState.TOO_FEW_ROWS, every)
        elif is_constant(X_checked) or is_constant(y_checked[:, None]):
            state = FitState.CONSTANT_SIGNAL
            self._fit_static(values[:, columns], y_checked, state, columns)
        else:
            self._fit_lag(X_checked, y_checked, runs, columns)
        return self

    def _fit_lag(
        self, X: FloatArray, y: FloatArray, runs: Segments, columns: NDArray[np.intp]
    ) -> None:
        choices = Choices(**{one.name: getattr(self, one.name) for one in fields(Choices)})
        terms, period = self._candidates, float(self.sample_period_s)
        with_state = np.arange(terms.n_without_state, len(terms.names))
        usable = np.concatenate((columns, with_state)).astype(np.intp)
        silent = NoiseLevels(1.0, np.zeros(X.shape[1]), np.empty(0))
        problem = LagProblem(X, y, runs, period, self.hold, terms, usable, silent)
        found = identify(problem, choices)
        noise, self._model = found.problem.noise, found.model
        self._candidates = found.problem.terms
        self.path_, self.rivals_ = found.path, found.rivals
        self.inclusion_probability_ = found.inclusion
        self.noise_: tuple[float, FloatArray] | None = (noise.output, noise.inputs)
        self.dead_time_s_ = found.model.lag.dead_time_s
        self.dead_time_stderr_s_ = found.dead_time_stderr_s
        self.candidate_terms_ = self._candidates.names
        self.fit_state_ = found.fit_state()
        if self.fit_state_ is FitState.LAG_UNDETERMINED:
            kept = found.model.selected[found.model.selected < self._candidates.n_without_state]
            kept = kept if kept.size else columns
            self._fit_static(self._candidates(X)[:, kept], y, self.fit_state_, kept)
            return
        form = found.form()
        self.terms_, self.coef_ = form.names, form.coefficients
        self.time_constant_s_ = form.time_constant_s
        self._physical = found.written(form)
        self.covariance_ = form.covariance[:-1, :-1]
        self.time_constant_stderr_s_ = float(np.sqrt(form.covariance[-1, -1]))
        self.binding_ = self._binding(problem, choices)
        self.cautions_ = found.cautions(self.fit_state_)
        self.cautions_ += tuple(binding.text for binding in self.binding_)

    def _binding(self, problem: LagProblem, choices: Choices) -> tuple[Binding, ...]:
        """Return the constraints that what is found without them breaks."""
        wishes = dict(self.constraints or {})
        if not any(LIMITS.keys() & set(words.split()) for words in wishes.values()):
            return ()
        choices = replace(choices, constraints=None, n_bootstrap=0)
        free = identify(problem, choices)
        # Not where the data cannot separate the two structures.
        alike = any(set(rival) == set(self.terms_) for rival in free.rivals)
        return () if alike else binding_constraints(free.form(), wishes)

    def _fit_static(
        self, values: FloatArray, y: FloatArray, state: FitState, columns: NDArray[np.intp]
    ) -> None:
        """Fit ψ' = ψ'_QS(φ) with coefficients of least norm, each on its unit-size term."""
        norms = unit_norms(values)
        solution = np.linalg.lstsq(values / norms, y, rcond=1e-10)[0]
        kept = np.flatnonzero(np.abs(solution) > 1e-10 * max(np.abs(solution).max(), 1e-300))
        selected = columns[kept]
        self.terms_ = tuple(self.candidate_terms_[i] for i in selected)
        self.coef_ = (solution / norms)[kept]
        self.covariance_ = np.full((kept.size, kept.size), np.nan)
        self.time_constant_s_ = self.time_constant_stderr_s_ = float("nan")
        self.dead_time_s_ = self.dead_time_stderr_s_ = 0.0
        self.path_, self.rivals_, self.inclusion_probability_ = (), (), {}
        self.binding_ = ()
        self.noise_ = None
        self.fit_state_ = state
        self.cautions_ = (state.advice,)
        self._model = self._physical = FreeModel(
            self._candidates,
            selected,
            self.coef_,
            FirstOrderLag(float("nan"), float(self.sample_period_s), self.hold),
            (float(y.min()), float(y.max())),
        )

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Evaluate ψ'_QS, the ψ' at rest, and its standard error.

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
        good = inputs.ndim == 2 and inputs.shape[1] == self.n_features_in_
        found = f"an array of shape {inputs.shape}"
        require(good, "phi", f"{self.n_features_in_} column(s)", found)
        curve = self._model.at_rest(inputs)
        resting = np.nan_to_num(curve)
        # With terms in ψ' a change of the forcing moves the ψ' at rest by 1/(1 - gain) of it.
        gain = self._physical.gain(inputs, resting)
        values = self._physical.values(inputs, resting) / (1.0 - gain)[:, None]
        variance = np.einsum("ij,jk,ik->i", values, self.covariance_, values)
        return curve, np.sqrt(np.maximum(variance, 0.0))

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
        if np.isnan(self.time_constant_s_):
            return self._model.at_rest(checked)
        start = self._model.at_rest(checked[runs.starts])
        # Where terms with ψ' leave no state of rest, the middle of what was seen.
        start = np.where(np.isfinite(start), start, float(np.mean(self._model.seen)))
        return self._model.run(checked, runs, start)

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

    def equation(self) -> str:
        """Write the identified equation, rounded to its uncertainty, with units.

        Returns
        -------
        str
            The equation.
        """
        check_is_fitted(self)
        return write_equation(self._parts())

    def equations(self, precision: int = 3) -> list[str]:
        """Write dψ'/dt as pysindy does.

        Parameters
        ----------
        precision : int
            Digits of each coefficient.

        Returns
        -------
        list of str
            One string: rates in 1/s, for example ``-55.556 psi_p + 19.444 1 + 66.667 phi``.

        Raises
        ------
        InputError
            For a static fit.
        """
        check_is_fitted(self)
        return pysindy_equations(self._parts(), precision)

    def as_function(self) -> Callable[..., Any]:
        """Return dψ'/dt as a function of ψ' and the inputs, for any integrator.

        Returns
        -------
        callable
            ``rate(psi_p, phi)`` in 1/s; it can be pickled.

        Raises
        ------
        InputError
            For a static fit.
        """
        check_is_fitted(self)
        self._parts().rate_or_refuse()
        return self._physical.rate

    def _parts(self) -> EquationParts:
        return EquationParts(
            self.terms_,
            tuple(self.coef_.tolist()),
            tuple(np.sqrt(np.diag(self.covariance_)).tolist()),
            float(self.time_constant_s_),
            float(self.time_constant_stderr_s_),
            dead_time_s=self.dead_time_s_,
            dead_time_stderr_s=self.dead_time_stderr_s_ or float("nan"),
            input_names=tuple(self._input_names),
            output_name=self.output_name,
        )

    def summary(self) -> ModelSummary:
        """Return all that is known of the fit: equation, state, rivals, noise, structures tried.

        Returns
        -------
        ModelSummary
            Its ``sheet()`` is what a terminal and a notebook show.
        """
        check_is_fitted(self)
        searched = bool(self.path_) and self.fit_state_ is not FitState.MODEL_ERROR_DOMINATES
        known = self.inclusion_probability_
        return ModelSummary(
            self._parts(),
            self.fit_state_,
            n_candidates=len(self.candidate_terms_),
            inclusion=[known.get(term, float("nan")) for term in self.terms_] if known else None,
            rivals=self.rivals_ if searched else None,
            noise=None if self.noise_ is None else (self.noise_[0], self.noise_[1].tolist()),
            cautions=tuple(c for c in self.cautions_ if c != self.fit_state_.advice),
        )

    def _sheet(self) -> Sheet | None:
        return self.summary().sheet() if hasattr(self, "fit_state_") else None

    def __sklearn_tags__(self) -> Any:
        """State that a free run over rows without time order fits them poorly."""
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags
