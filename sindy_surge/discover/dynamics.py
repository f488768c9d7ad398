"""An estimator that discovers the equations of a measured system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator

from sindy_surge.discover.collocation import Collocation, Fit
from sindy_surge.discover.equations import Rival, Term
from sindy_surge.discover.features import Features
from sindy_surge.discover.smoothing import smoothed
from sindy_surge.discover.trajectories import Trajectories
from sindy_surge.linear_problem import LinearProblem, Support
from sindy_surge.noise import difference_noise
from sindy_surge.search import Search, Tried, best_of_equation, chosen_support
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.types import FloatArray, IndexArray
from surge_core.validation import one_of

# Rows of the segments on which the full library is fitted: short first, where a library of wrong
# terms still follows the data. Supports are compared on the last of them, and then on longer ones.
_FULL_ROWS = (30, 60)
_LONGER_ROWS = (300, None)
# A coefficient is at first believed to make no term larger than so many times the derivative.
_LARGEST_TERM = 10.0
# Ridge of the first regression, as a share of each term's own size: enough to keep it finite.
_START_RIDGE = 1e-4
# Noise assumed at least, as a share of a state's spread: that of a 12-bit converter whose range is
# five standard deviations.
_LEAST_NOISE = 3.5e-4
# How freely a hidden state moves in one step, in units of its spread.
_HIDDEN_FREEDOM = 10.0
# Two supports whose scores, in χ², are closer than this are rivals (Kass & Raftery 1995).
_RIVAL = 10.0
# Rows of the best runs that `score` restarts.
_SCORED_ROWS = 300
# Of white noise the correlation of neighbours scatters by 1/√N.
_WHITE_SIGMAS = 5.0
# What is left over the noise that differences show, before a run of it counts.
_EXCESS = 1.2


@dataclass
class _Level(Search[Fit]):
    """Supports tried on segments of one length."""

    likelihood: Collocation


class SparseDynamics(BaseEstimator):
    """Discover dx/dt = Θ(x, u) Ξ from noisy trajectories.

    All states are taken as measured with white noise of unknown size. States and coefficients are
    estimated together (errors in variables); the terms are those of the best extended BIC.

    Parameters
    ----------
    library : pysindy feature library, optional
        Candidate terms of states and inputs; polynomials up to degree 3 by default.
    optimizer : pysindy optimizer, optional
        Proposes supports, on the whitened regression; STLSQ by default.
    differentiation : pysindy differentiation, optional
        Gives the derivatives that the search starts from; a smoothed finite difference by default.
    search : {"full", "optimizer"}
        "optimizer" takes what the optimizer proposes and fits it; "full" goes on from there.
    hidden : sequence of str
        States that x does not hold. Each must stand, linearly, in an equation of `known`.
    known : mapping of str to mapping of str to float, optional
        Equations that are given: state to coefficients by term.
    random_state : int, optional
        Accepted as pysindy users expect it; nothing here is random.

    Attributes
    ----------
    terms_ : tuple of tuple of str
        Names of the terms of each equation.
    equation_terms_ : tuple of tuple of Term
        The same with coefficients and standard errors.
    covariance_ : ndarray of shape (n_chosen, n_chosen)
        Of the coefficients, equation by equation.
    rivals_ : tuple of Rival
        Models within 5 of the score.
    inclusion_probability_ : ndarray of shape (n_states, n_terms)
        Weight of the supports tried that hold each term.
    path_ : tuple of tuple
        (what proposed it, terms of each equation, score) of each support compared: on whole
        trajectories first, best first, then on shorter segments.
    noise_ : ndarray of shape (n_states,)
        Standard deviation of each state's noise.
    state_ : FitState
        How it ended, with advice.
    """

    def __init__(
        self,
        library: Any = None,
        optimizer: Any = None,
        differentiation: Any = None,
        search: str = "full",
        hidden: Sequence[str] = (),
        known: Mapping[str, Mapping[str, float]] | None = None,
        random_state: int | None = None,
    ) -> None:
        self.library = library
        self.optimizer = optimizer
        self.differentiation = differentiation
        self.search = search
        self.hidden = hidden
        self.known = known
        self.random_state = random_state

    def fit(
        self,
        x: Any,
        t: Any,
        u: Any = None,
        feature_names: Sequence[str] | None = None,
    ) -> Self:
        """Discover the equations.

        Parameters
        ----------
        x : array-like of shape (n_rows, n_states), or list of such
            One or several trajectories.
        t : float, array-like of shape (n_rows,), or list of such
            Sample period, or times.
        u : array-like of shape (n_rows, n_inputs), or list of such, optional
            Inputs.
        feature_names : sequence of str, optional
            Names of the states and, behind them, of the inputs; x0, x1, … and u0, u1, … by
            default.

        Raises
        ------
        InputError
            If the data cannot be used.
        """
        one_of("search", self.search, ("full", "optimizer"))
        data = Trajectories.of(x, t, u)
        _moving(data.y, feature_names)
        problem, rates = self._problem(data, feature_names)
        searches, best = self._searched(problem, rates)
        self._keep(problem, searches, best)
        return self

    # -- What was found ---------------------------------------------------------------------------

    def coefficients(self) -> FloatArray:
        """Return Ξ of shape (n_states, n_terms)."""
        return np.asarray(self.coef_)

    def get_feature_names(self) -> list[str]:
        """Return the names of the candidate terms."""
        return list(self.candidate_terms_)

    @property
    def feature_names(self) -> list[str]:
        """Names of the states."""
        return list(self.state_names_)

    def equations(self, precision: int = 3) -> list[str]:
        """Return the right-hand sides, as pysindy writes them.

        Parameters
        ----------
        precision : int
            Digits behind the point.
        """
        return [
            " + ".join(f"{t.coefficient:.{precision}f} {t.name}" for t in terms) or "0"
            for terms in self.equation_terms_
        ]

    def print(self, lhs: Sequence[str] | None = None, precision: int = 3) -> None:
        """Print the equations, as pysindy does.

        Parameters
        ----------
        lhs : sequence of str, optional
            Left-hand sides; (x)' by default.
        precision : int
            Digits behind the point.
        """
        import sys

        left = lhs or [f"({name})'" for name in self.state_names_]
        for one, other in zip(left, self.equations(precision), strict=True):
            sys.stdout.write(f"{one} = {other}\n")

    def simulate(self, x0: Any, t: Any, u: Any = None) -> FloatArray:
        """Run the equations from a start.

        Parameters
        ----------
        x0 : array-like of shape (n_states,)
            Start.
        t : array-like of shape (n_rows,)
            Times at which the states are returned.
        u : array-like of shape (n_rows, n_inputs) or callable, optional
            Inputs at these times, or a function of time.

        Returns
        -------
        ndarray of shape (n_rows, n_states)
            NaN from where the run leaves all bounds.
        """
        from scipy.integrate import solve_ivp
        from scipy.interpolate import CubicSpline

        times = np.asarray(t, dtype=np.float64)
        features, xi = self._features, self.coef_.T
        inputs: Any = u
        if u is not None and not callable(u):
            given = np.asarray(u, dtype=np.float64).reshape(times.size, -1)
            inputs = CubicSpline(times, given)

        def rate(time: float, state: FloatArray) -> FloatArray:
            z = np.zeros((1, 0)) if u is None else np.reshape(inputs(time), (1, -1))
            return np.asarray((features.values(state[None, :], z) @ xi)[0])

        def lost(time: float, state: FloatArray) -> float:
            return float(1e3 - np.max(np.abs(state) / self._bound))

        lost.terminal = True  # type: ignore[attr-defined]
        result = np.full((times.size, xi.shape[1]), np.nan)
        with np.errstate(all="ignore"):
            run = solve_ivp(
                rate,
                (times[0], times[-1]),
                np.asarray(x0, dtype=np.float64),
                t_eval=times,
                events=lost,
                rtol=1e-7,
                atol=1e-9 * float(self._bound.min()),
            )
        result[: run.y.shape[1]] = run.y.T
        return result

    def score(self, x: Any, t: Any, u: Any = None) -> float:
        """Return R² of runs that restart every 300 rows from their best starts.

        Parameters
        ----------
        x, t, u
            As in `fit`.
        """
        data = Trajectories.of(x, t, u)
        problem = Collocation(
            self._with_hidden(data, self._known),
            self._features,
            self._noise_all,
            self.coef_.T,
            self._hidden,
            _SCORED_ROWS,
        )
        empty = np.zeros_like(self.coef_.T)
        fit = problem.fit(np.zeros(0, dtype=np.intp), empty, _smooth(problem.data))
        measured = ~self._hidden
        y = problem.data.y[:, measured]
        rest = np.sum((y - fit.x[:, measured]) ** 2, axis=0) if np.isfinite(fit.chi2) else np.inf
        return float(np.mean(1.0 - rest / np.sum((y - y.mean(axis=0)) ** 2, axis=0)))

    # -- How it is found --------------------------------------------------------------------------

    def _problem(
        self, data: Trajectories, names: Sequence[str] | None
    ) -> tuple[Collocation, FloatArray]:
        """Return what is fitted, and the derivatives that the search starts from."""
        from pysindy import PolynomialLibrary

        n_states, n_inputs = data.y.shape[1], data.u.shape[1]
        default = [f"x{i}" for i in range(n_states)] + [f"u{i}" for i in range(n_inputs)]
        named = list(default if names is None else names)
        named += default[len(named) :] if len(named) == n_states else []
        _check_names((*named, *self.hidden), n_states + n_inputs + len(self.hidden))
        states, self.input_names_ = named[:n_states], tuple(named[n_states:])
        self.state_names_ = (*states, *self.hidden)
        known = {name: dict(given) for name, given in (self.known or {}).items()}
        self._check_known(known)
        noise = np.maximum(_difference_noise(data), _LEAST_NOISE * np.std(data.y, axis=0))
        data = self._with_hidden(data, known)
        hidden = np.arange(data.y.shape[1]) >= len(states)
        spread = np.std(data.y, axis=0)
        noise = np.append(noise, _HIDDEN_FREEDOM * spread[hidden])
        library = self.library if self.library is not None else PolynomialLibrary(degree=3)
        every = (*self.state_names_, *self.input_names_)
        features = Features.of(library, every, data.y, data.u)
        given = np.zeros((len(features.names), data.y.shape[1]))
        for state, terms in known.items():
            for name, value in terms.items():
                given[features.index(name), self.state_names_.index(state)] = value
        self._known, self._hidden = known, hidden
        return Collocation(data, features, noise, given, hidden), self._rates(data)

    def _check_known(self, known: dict[str, dict[str, float]]) -> None:
        for state in known:
            if state not in self.state_names_:
                raise InputError(
                    "known", expected="states of x or `hidden`", found=state, remedy="name one"
                )
        for name in self.hidden:
            if not any(name in terms for s, terms in known.items() if s not in self.hidden):
                raise InputError(
                    "hidden",
                    expected=f"a known equation of a measured state with the term {name}",
                    found="none",
                    remedy="give the equation that ties the hidden state to what is measured",
                )
            for terms in (t for s, t in known.items() if name in t and s not in self.hidden):
                plain = {"1", *self.state_names_, *self.input_names_}
                if not set(terms) <= plain or terms[name] == 0.0:
                    raise InputError(
                        "known",
                        expected=f"a sum of states, inputs and 1, with a share of {name}, in the "
                        f"equation that gives {name}",
                        found=", ".join(f"{n}={value:g}" for n, value in terms.items()),
                    )

    def _with_hidden(self, data: Trajectories, known: Mapping[str, Any]) -> Trajectories:
        """Add the hidden states, as the known equations give them from smoothed derivatives."""
        if not self.hidden:
            return data
        smooth, rates = _smooth(data), self._rates(data)
        columns = dict(zip(self.state_names_, smooth.T, strict=False))
        columns |= dict(zip(self.input_names_, data.u.T, strict=True))
        for name in self.hidden:
            state = next(s for s, terms in known.items() if name in terms and s not in self.hidden)
            terms = known[state]
            rest = rates[:, self.state_names_.index(state)].copy()
            for other, value in terms.items():
                if other != name:
                    rest -= value * (1.0 if other == "1" else columns[other])
            columns[name] = rest / terms[name]
        added = np.column_stack([columns[name] for name in self.hidden])
        return Trajectories(np.column_stack((data.y, added)), data.u, data.time_s, data.runs)

    def _rates(self, data: Trajectories) -> FloatArray:
        """Return dx/dt of shape (n_rows, n_states), by the user's differentiation or a smooth."""
        from pysindy import FiniteDifference

        how = self.differentiation if self.differentiation is not None else FiniteDifference()
        y = data.y if self.differentiation is not None else _smooth(data)
        parts = [np.asarray(how(y[p], data.time_s[p])) for p in data.runs.slices()]
        return np.concatenate(parts)

    def _searched(self, problem: Collocation, rates: FloatArray) -> tuple[list[_Level], Tried[Fit]]:
        """Return the supports tried at each length of segments, the last first, and the best."""
        n_terms, n_states = problem.known.shape
        taken = [self.state_names_.index(name) for name in self._known]
        equations = [
            tuple(range(state * n_terms, (state + 1) * n_terms))
            for state in range(n_states)
            if state not in taken
        ]
        full, problem = self._full(problem, rates, np.concatenate(equations))
        self.noise_ = problem.noise[~problem.hidden]
        # Extended BIC (Chen & Chen 2008): so much for each of p candidates an equation on N rows.
        price = float(np.log(len(problem.data.y)) + 2.0 * np.log(n_terms))
        short = _Level(problem.cut(_FULL_ROWS[-1]), equations, price)
        linear = short.likelihood.regression(full)
        by = type(self.optimizer).__name__ if self.optimizer is not None else "STLSQ"
        chosen, promising = self._proposals(linear, equations, price)
        if self.search == "optimizer":
            whole = _Level(problem.cut(None), equations, price)
            return [whole], whole.try_support(chosen, full, by)
        tries = [short.try_support(chosen, full, by)]
        tries.append(short.try_support(promising, full, "regression"))
        best = min(tries, key=lambda t: t.score)
        levels = [short]
        if not np.isfinite(best.score):
            return levels, best
        best = short.climb(best)
        for rows in _LONGER_ROWS:
            if rows is not None and rows >= problem.data.runs.lengths.max():
                continue
            level = _Level(problem.cut(rows), equations, price)
            start = level.try_support(best.support, best.fit, best.by)
            if not np.isfinite(start.score):
                break
            best = level.climb(start)
            levels.insert(0, level)
        return levels, best

    def _proposals(
        self, linear: LinearProblem, equations: Sequence[Support], price: float
    ) -> tuple[list[int], list[int]]:
        """Return what the optimizer chooses, and the best by the regression, each by equation.

        For one equation all terms of the others are left free.
        """
        from pysindy import STLSQ

        optimizer = self.optimizer if self.optimizer is not None else STLSQ()
        chosen, promising = [], []
        for own in equations:
            others = [i for each in equations if each is not own for i in each]
            rest = linear.beside(others, own)
            chosen += [own[i] for i in chosen_support(rest, optimizer)]
            ranked = best_of_equation(rest, tuple(range(len(own))), (), price)
            promising += [own[i] for i in min(ranked)[1]]
        return chosen, promising

    def _full(
        self, problem: Collocation, rates: FloatArray, free: IndexArray
    ) -> tuple[Fit, Collocation]:
        """Fit the whole library on short segments, and with it the noise."""
        x = _smooth(problem.data)
        x[:, problem.hidden] = problem.data.y[:, problem.hidden]
        theta = problem.features.values(x, problem.data.u)
        n_terms, n_states = problem.known.shape
        size = np.sqrt(np.mean(theta**2, axis=0))
        prior = _LARGEST_TERM * np.sqrt(np.mean(rates**2, axis=0))[None, :] / size[:, None]
        ridge = (prior.T.ravel()[free]) ** -2.0
        scaled = theta / size
        small = _START_RIDGE * len(scaled) * np.eye(n_terms)
        target = scaled.T @ (rates - theta @ problem.known)
        xi = np.linalg.solve(scaled.T @ scaled + small, target) / size[:, None]
        fit = Fit(xi, x, np.inf, np.eye(free.size), False)
        for rows in _FULL_ROWS:
            fit = problem.cut(rows).fit(free, fit.xi, fit.x, ridge)
        own = problem.cut(_FULL_ROWS[-1])
        n_rows = len(problem.data.y)
        starts = 1 + int(np.count_nonzero(~own.joined))
        spent = starts + free.size / n_states
        left = problem.data.y - fit.x
        found = np.sqrt(np.sum(left**2, axis=0) / max(n_rows - spent, 1.0))
        floor = _LEAST_NOISE * np.std(problem.data.y, axis=0)
        noise = np.where(problem.hidden, problem.noise, np.maximum(found, floor))
        if np.isfinite(fit.chi2):
            problem = Collocation(
                problem.data, problem.features, noise, problem.known, problem.hidden
            )
            fit = problem.cut(_FULL_ROWS[-1]).fit(free, fit.xi, fit.x, ridge)
        return fit, problem

    def _keep(self, problem: Collocation, searches: list[_Level], best: Tried[Fit]) -> None:
        search, nothing = searches[0], np.zeros(0, dtype=np.intp)
        if not np.isfinite(best.score):
            empty = search.likelihood.fit(nothing, np.zeros_like(problem.known), problem.data.y)
            best = Tried((), np.inf, empty, best.by)
        features, n_terms = problem.features, problem.known.shape[0]
        self._features, self._noise_all = features, search.likelihood.noise
        self.search_, self.best_ = search, best
        self.given_states_ = tuple(self.state_names_.index(name) for name in self._known)
        self._bound = np.max(np.abs(problem.data.y), axis=0)
        self.candidate_terms_ = features.names
        self.coef_ = (best.fit.xi + problem.known).T
        self.covariance_ = best.fit.covariance
        self.equation_terms_ = self._terms_of(best, problem.known)
        self.terms_ = tuple(tuple(t.name for t in terms) for terms in self.equation_terms_)
        self.x_ = best.fit.x
        self.rivals_ = tuple(
            Rival(self._terms_of(t, problem.known), 0.5 * (t.score - best.score))
            for t in search.rivals(best, _RIVAL)
        )
        self.inclusion_probability_ = search.inclusion(self.coef_.size).reshape(-1, n_terms)
        self.path_ = tuple(
            (t.by, self._names_of(t.support), 0.5 * float(t.score))
            for each in searches
            for t in sorted(each.tried.values(), key=lambda t: t.score)
        )
        self.state_ = self._state(problem, best, search.likelihood)

    def _names_of(self, support: tuple[int, ...]) -> tuple[tuple[str, ...], ...]:
        n = len(self.candidate_terms_)
        return tuple(
            tuple(self.candidate_terms_[i % n] for i in support if i // n == state)
            for state in range(len(self.state_names_))
        )

    def _terms_of(self, tried: Tried[Fit], known: FloatArray) -> tuple[tuple[Term, ...], ...]:
        n = len(self.candidate_terms_)
        errors = dict(zip(tried.support, np.sqrt(np.diag(tried.fit.covariance)), strict=True))
        xi = tried.fit.xi + known
        return tuple(
            tuple(
                Term(name, float(xi[i, state]), float(errors.get(state * n + i, 0.0)))
                for i, name in enumerate(self.candidate_terms_)
                if state * n + i in errors or known[i, state] != 0.0
            )
            for state in range(len(self.state_names_))
        )

    def _state(self, problem: Collocation, best: Tried[Fit], compared_on: Collocation) -> FitState:
        if not np.isfinite(best.score) or not best.support:
            return FitState.NO_EQUATIONS
        left = (problem.data.y - best.fit.x)[:, ~problem.hidden]
        together = problem.data.within()[:, None] * left[1:] * left[:-1]
        coloured = np.sum(together, axis=0) / np.maximum(np.sum(left**2, axis=0), 1e-300)
        floor = _LEAST_NOISE * np.std(problem.data.y, axis=0)
        seen = np.maximum(_difference_noise(problem.data), floor)[~problem.hidden]
        above = np.sqrt(np.mean(left**2, axis=0)) > _EXCESS * seen
        white = _WHITE_SIGMAS / np.sqrt(len(left))
        if np.any((coloured > white) & above):
            return FitState.UNEXPLAINED
        if compared_on.rows is not None:
            return FitState.SHORT_RUNS_ONLY
        return FitState.OK if self.search == "full" else FitState.PROPOSED


def _moving(y: FloatArray, names: Sequence[str] | None) -> None:
    still = np.flatnonzero(np.ptp(y, axis=0) <= 1e-12 * np.abs(y).max(axis=0))
    if still.size:
        name = names[still[0]] if names is not None else f"x{still[0]}"
        raise InputError(
            str(name),
            expected="a state that moves",
            found="a constant",
            remedy="leave the state out",
        )


def _difference_noise(data: Trajectories) -> FloatArray:
    """Return the noise that sixth differences show, which a sampled smooth signal hardly has."""
    return np.array([difference_noise(y, data.runs, 6) for y in data.y.T])


def _smooth(data: Trajectories) -> FloatArray:
    result = np.empty_like(data.y)
    for j, noise in enumerate(_difference_noise(data)):
        for rows in data.runs.slices():
            result[rows, j] = smoothed(data.y[rows, j], float(noise))
    return result


def _check_names(names: Sequence[str], wanted: int) -> None:
    if len(names) != wanted or len(set(names)) != wanted:
        raise InputError(
            "feature_names, hidden",
            expected=f"{wanted} different names of states and inputs",
            found=", ".join(names) or "none",
        )
