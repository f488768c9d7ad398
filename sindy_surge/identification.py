"""From arrays to a structure with its errors: the steps of a fit in their order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sindy_surge.candidate_terms import PhysicalForm
from sindy_surge.constraints import Constraints, constraints_of
from sindy_surge.free_run import FreeModel
from sindy_surge.held_out import model_error_dominates, select_by_held_out, with_held_out
from sindy_surge.knots import MovedKnot, knot_columns, moved_knots, with_hinges
from sindy_surge.lag_fit import (
    StructureFit,
    WhiteEquations,
    information,
    refitted,
    sandwich,
    white_equations,
)
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import Support
from sindy_surge.noise import colour_of
from sindy_surge.preparation import Prepared, prepare
from sindy_surge.segments import block_slices
from sindy_surge.selection import (
    PathRow,
    Selection,
    inclusion_probabilities,
    information_penalty,
    select_structure,
)
from surge_core.fit_state import FitState, holds_lag
from surge_core.types import FloatArray

# Blocks of rows are drawn whole; none is shorter than this many rows.
_SHORTEST_BLOCK = 20
# More terms than this may stand in for one kink between two knots.
_LARGE = 4
# Below 200 equations for the 24 terms of the default library, stated errors were 4 too small.
_EQUATIONS_A_TERM = 8


@dataclass(frozen=True)
class Choices:
    """What a user decides of a search: parameters of `SparseLagRegressor`, under their names."""

    optimizer: Any
    max_terms: int
    constraints: Mapping[str, str] | None
    n_bootstrap: int
    random_state: Any


@dataclass(frozen=True)
class Identified:
    """A structure with its parameters, and what was looked at on the way."""

    problem: LagProblem  # The data with noise levels and dead time, and the library searched
    # Terms, β (those of terms with ψ' in the library's own units), τ and dead time
    model: FreeModel
    dead_time_stderr_s: float  # Standard error of the dead time in seconds; 0 if it was not fitted
    covariance: FloatArray  # (n_terms + 1, n_terms + 1): Of β and, last, τ
    state: FitState  # What became of the fit, as far as the search can tell
    path: tuple[PathRow, ...]  # Every structure proposed or tested
    rivals: tuple[tuple[str, ...], ...]  # Structures that the data cannot tell from the chosen one
    # Share of the resamples whose structure holds a term; empty without resamples
    inclusion: dict[str, float]
    knots: tuple[MovedKnot, ...]  # Hinges off the library's grid that were added to it

    def fit_state(self) -> FitState:
        """Return what became of the fit, by the τ that it gave and its error.

        About the middle of ψ': with terms in ψ' the τ of the equation as written may be anything.
        """
        tau, period_s = self.model.lag.tau_s, self.problem.sample_period_s
        error = float(np.sqrt(self.covariance[-1, -1]))
        # A held input shows the lag only through the pole e^(-h/τ), which is soon next to nothing.
        pole = float(np.exp(-period_s / tau))
        hidden = self.problem.hold == "zero" and pole < 3 * pole * period_s / tau**2 * error
        if tau < period_s / 20 or (hidden and tau < period_s):
            return FitState.LAG_BELOW_RESOLUTION
        # The error of τ then includes that of the model, and longer segments are no remedy.
        if self.state is FitState.MODEL_ERROR_DOMINATES:
            return self.state
        held = holds_lag(tau, error, self.problem.longest_lag_s)
        # Coefficients that run away have no errors.
        if not (held and np.all(np.isfinite(self.form().covariance))):
            return FitState.LAG_UNDETERMINED
        return self.state

    def form(self) -> PhysicalForm:
        """Return the structure as it is written."""
        model = self.model
        given = model.selected, model.coefficients, model.lag.tau_s, self.covariance
        return self.problem.terms.written(*given)

    def written(self, form: PhysicalForm) -> FreeModel:
        """Return the model as it is written: powers of ψ' itself, which the search centres."""
        terms = self.problem.terms.physical()
        return replace(
            self.model,
            terms=terms,
            selected=np.array([terms.names.index(name) for name in form.names], dtype=np.intp),
            coefficients=form.coefficients,
            lag=replace(self.model.lag, tau_s=form.time_constant_s),
        )

    def cautions(self, state: FitState) -> tuple[str, ...]:
        """Say what a user should know before the numbers are used."""
        problem, dead_time_s = self.problem, self.model.lag.dead_time_s
        sentences = [] if state is FitState.OK else [state.advice]
        if abs(dead_time_s) > 2 * self.dead_time_stderr_s > 0:
            late, early = ("ψ'", "φ") if dead_time_s > 0 else ("φ", "ψ'")
            sentences.append(
                f"{late} was measured {abs(dead_time_s) * 1e3:.3g} ms later than {early} "
                f"(standard error {self.dead_time_stderr_s * 1e3:.2g} ms): look for a sample of "
                "misalignment, or the wrong `hold`, which is half of one"
            )
        for knot in self.knots:
            sentences.append(
                f"a kink sits at {knot.knot:g} (standard error {knot.stderr:.2g}), between the "
                "knots of the library; a hinge was added there, and the errors allow for it"
            )
        gain, lag = problem.mean_gain(self.model), self.model.lag
        if gain != 0.0:
            sentences.append(
                "the structure holds ψ', and τ is that of the equation as written; about the mean "
                f"point of the record the lag is {lag.tau_s / (1 - gain) * 1e3:.3g} ms, "
                "which other powers of ψ' share"
            )
        if problem.noise.colour.size and state is not FitState.MODEL_ERROR_DOMINATES:
            sentences.append(
                f"the noise is coloured (autoregression of order {problem.noise.colour.size}) and "
                "was whitened for it; a missing effect can look the same"
            )
        return tuple(sentences)


def identify(problem: LagProblem, choices: Choices) -> Identified:
    """Search the structure of a record and estimate its parameters."""
    search = _searched(problem, choices)
    if search.prepared.problem.fits_dead_time:
        on_time = _on_time(choices, search)
        search = _simpler(search, _searched(problem, on_time, may_be_late=False))
    if search.may_lack_a_knot:
        search = _with_knots(search, choices)
    robust = None
    if model_error_dominates(search.prepared, search.found.consistent):
        robust = _by_held_out(search, choices)
    return robust or _by_likelihood(search, choices)


@dataclass(frozen=True)
class _Searched:
    """One search over one library."""

    whole: LagProblem
    prepared: Prepared
    found: Selection
    constraints: Constraints
    knots: tuple[MovedKnot, ...] = ()

    @property
    def may_lack_a_knot(self) -> bool:
        """A hinge in the structure, a large one, or none that stands."""
        support, names = self.found.fit.support, self.prepared.problem.every_name
        if not any("relu(" in name for name in names):
            # A library without hinges is not meant to have kinks.
            return False
        kinked = any("relu(" in names[i] for i in support)
        return kinked or len(support) > _LARGE or not self.found.consistent


def _searched(
    problem: LagProblem,
    choices: Choices,
    knots: tuple[MovedKnot, ...] = (),
    *,
    may_be_late: bool = True,
) -> _Searched:
    library = problem.terms.names
    columns, constraints = constraints_of(choices.constraints, library, problem.columns)
    prepared = prepare(replace(problem, columns=columns), constraints.required, may_be_late)
    _, constraints = constraints_of(choices.constraints, library, prepared.problem.columns)
    found = select_structure(prepared, choices.optimizer, choices.max_terms, constraints)
    return _Searched(problem, prepared, found, constraints, knots)


def _on_time(choices: Choices, late: _Searched) -> Choices:
    """Ask for structures without a dead time that could be simpler than one with it."""
    most = len(late.found.fit.support) + 1 if late.found.consistent else choices.max_terms
    return replace(
        choices,
        max_terms=min(max(most, len(late.constraints.required)), choices.max_terms),
        # The best subsets hold whatever an optimizer would propose of so few terms.
        optimizer="best-subset" if isinstance(choices.optimizer, str) else choices.optimizer,
    )


def _simpler(late: _Searched, on_time: _Searched) -> _Searched:
    """Choose between a dead time and none: terms with ψ' can stand in for it, and it for them.

    What stands comes first, then the least Bayesian information criterion, in which the dead time
    and the colour of the noise count like terms: a delay leaves colour behind that would else
    cost nothing.
    """
    n = min(s.found.fit.residual.size for s in (late, on_time))
    penalty = information_penalty(n, late.prepared.problem.columns.size)

    def rank(search: _Searched) -> tuple[bool, float]:
        fit, prepared = search.found.fit, search.prepared
        stands = search.found.consistent and not model_error_dominates(prepared, True)
        noise = prepared.problem.noise
        size = len(fit.support) + prepared.problem.fits_dead_time + noise.colour.size
        # χ² is in units of each search's own noise of ψ'.
        spread = float(np.log(fit.chi2 / fit.residual.size * noise.output**2))
        return not stands, n * spread + penalty * size

    return min(late, on_time, key=rank)


def _with_knots(search: _Searched, choices: Choices) -> _Searched:
    """Search again with hinges off the grid, and keep what comes out if it stands."""
    problem, fit = search.prepared.problem, search.found.fit
    knots = moved_knots(problem, fit, search.constraints.required)
    if not knots:
        return search
    wide, _ = with_hinges(search.whole, [moved.knot for moved in knots])
    late = problem.fits_dead_time
    again = _searched(wide, choices, knots, may_be_late=late)
    stands = again.found.consistent and not model_error_dominates(again.prepared, True)
    first = again.prepared.problem.n_without_state - len(knots)
    uses = any(i >= first for i in again.found.fit.support)
    return again if stands and uses else search


def _by_likelihood(search: _Searched, choices: Choices) -> Identified:
    prepared, found = search.prepared, search.found
    names = prepared.problem.every_name
    problem, fit = _colour_again(prepared.problem, found.fit)
    inclusion: dict[str, float] = {}
    equations = white_equations(problem, fit)
    if choices.n_bootstrap:
        shares = inclusion_probabilities(
            equations,
            block_slices(problem.segments, _SHORTEST_BLOCK),
            choices.max_terms,
            penalty_per_term=information_penalty(equations.target.size, len(names)),
            n_resamples=choices.n_bootstrap,
            rng=np.random.default_rng(choices.random_state),
            required=search.constraints.required,
        )
        inclusion = dict(zip(names, shares.tolist(), strict=True))
    covariance = _covariance(problem, fit, search.knots)
    dead_time_stderr = float(np.sqrt(covariance[-2, -2])) if problem.fits_dead_time else 0.0
    wanted = [*range(len(fit.support)), -1]
    covariance = covariance[np.ix_(wanted, wanted)]
    if model_error_dominates(prepared, found.consistent) or not found.consistent:
        state = FitState.NO_CONSISTENT_STRUCTURE
    elif not _explains(equations, fit.support):
        state = FitState.UNRELATED
    elif not fit.converged:
        state = FitState.NOT_CONVERGED
    elif problem.usable.later.size < _EQUATIONS_A_TERM * len(names):
        state = FitState.FEW_EQUATIONS
    else:
        state = FitState.OK
    return Identified(
        problem,
        problem.model(fit.support, fit.coefficients, fit.time_constant_s, fit.dead_time_s),
        dead_time_stderr,
        covariance,
        state,
        found.path,
        tuple(tuple(names[i] for i in rival) for rival in found.rivals),
        inclusion,
        search.knots,
    )


def _explains(equations: WhiteEquations, support: Support) -> bool:
    """Return whether a structure is worth its terms against none at all."""
    linear = equations.compressed()
    gain = linear.chi2(()) - linear.chi2(support)
    penalty = information_penalty(linear.n_equations, linear.columns.shape[1])
    return gain / linear.variance > penalty * len(support)


def _colour_again(problem: LagProblem, fit: StructureFit) -> tuple[LagProblem, StructureFit]:
    """Look for colour about the structure found, if it holds ψ'.

    The colour was that of the fit without such terms, which leaves some of them as colour.
    """
    if not (problem.holds_state(fit.support) and problem.noise.colour.size):
        return problem, fit
    problem = problem.with_colour(np.empty(0))
    fit = refitted(problem, fit)
    colour = colour_of(fit.residual, fit.groups)
    if colour.size:
        problem = problem.with_colour(colour)
        fit = refitted(problem, fit)
    return problem, fit


def _covariance(problem: LagProblem, fit: StructureFit, knots: tuple[MovedKnot, ...]) -> FloatArray:
    """Return the covariance of β, the moved knots and the dead time, and τ last."""
    known = information(problem, fit)
    extra = knot_columns(problem, fit, knots)
    # The knots count among the parameters, so that the errors of the others allow for them; they
    # stand before the dead time and τ, which come last.
    first = len(fit.support) + (problem.hold == "first")
    at = [first] * extra.shape[1]
    wide = replace(
        fit,
        sensitivity=np.insert(fit.sensitivity, at, extra, axis=1),
        prior=np.insert(fit.prior, at, 0.0),
    )
    whole = wide.sensitivity.T @ wide.sensitivity + np.diag(wide.prior)
    old = np.delete(np.arange(wide.prior.size), np.s_[first : first + len(at)])
    whole[np.ix_(old, old)] = known
    return sandwich(problem, wide, whole)


def _by_held_out(search: _Searched, choices: Choices) -> Identified | None:
    # A dead time is tested against noise, of which there is next to none: an error of the model
    # passed for it.
    problem = search.prepared.problem.with_dead_time(0.0, False)
    found = select_by_held_out(problem, choices.optimizer, choices.max_terms, search.constraints)
    if found is None:
        return None
    support, parameters, covariance, trials = found
    return Identified(
        problem,
        problem.model(support, parameters[:-1], float(parameters[-1]), problem.dead_time_s),
        0.0,
        covariance,
        FitState.MODEL_ERROR_DOMINATES,
        with_held_out(search.found.path, trials, support, problem.every_name),
        (),
        {},
        (),
    )
