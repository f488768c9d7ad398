"""An estimator that discovers the equations of a measured system."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from sindy_surge.discover.collocation import Collocation, Fit
from sindy_surge.discover.columns import apart, as_fitted, check_names, idle, idle_words, moving
from sindy_surge.discover.ending import ASKED, CLEAN, ended
from sindy_surge.discover.equations import Rival, Term
from sindy_surge.discover.late import Late, read_late
from sindy_surge.discover.levels import (
    RIVAL,
    Level,
    search_by_levels,
    with_noisy_inputs,
)
from sindy_surge.discover.trajectories import (
    Features,
    Trajectories,
    listed,
    output_times,
    times_of,
)
from sindy_surge.search import Tried
from surge_core.errors import one_of, require
from surge_core.fit_state import FitState
from surge_core.types import FloatArray

# How freely a hidden state moves in one step, in units of its spread.
_HIDDEN_FREEDOM = 10.0
# Rows of the best runs that `score` restarts.
_SCORED_ROWS = 300


class SparseDynamics(BaseEstimator):
    """Discover dx/dt = Θ(x, u) Ξ from noisy trajectories.

    All states are taken as measured with white noise of unknown size. States and coefficients are
    estimated together (errors in variables); the terms are those of the best extended BIC. An input
    runs smoothly through its rows, but for jumps, or is held from each to the next where that is
    clearly likelier. One whose own rows show white noise is estimated as the states are, unless the
    record is clearly likelier with it exact (not with ``search="optimizer"``).

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
    input_noise_ : ndarray of shape (n_inputs,)
        Noise of each input as its own rows show it; 0 where it is taken as exact.
    beyond_ : tuple of str
        Terms beyond the library that would pay their price, beside those stated or for them.
    late_ : Late or None
        Which readings come late, by how much and how, where that is found.
    held_inputs_ : tuple of str
        Inputs that are held from each row to the next.
    idle_ : tuple of str
        Measured states that are not distinguished from a constant: each has the equation d/dt = 0,
        and terms that hold it are left out of the library beside those that do not.
    state_ : FitState
        How it ended, with advice.
    """

    state_: FitState

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
        self, x: Any, t: Any, u: Any = None, feature_names: Sequence[str] | None = None
    ) -> Self:
        """Discover the equations.

        Parameters
        ----------
        x : array-like of shape (n_rows, n_states), or list of such
            One or several trajectories.
        t : float, array-like of shape (n_rows,), or list of such
            Sample period, or times; or one of these for each trajectory.
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
        from pysindy import STLSQ

        one_of("search", self.search, ("full", "optimizer"))
        for name, wrong, expected in (
            ("hidden", str, "a list of names, such as ['q']"),
            ("differentiation", str | type, "one of pysindy, such as SmoothedFiniteDifference()"),
        ):
            value = getattr(self, name)
            require(not isinstance(value, wrong), name, expected, f"{value!r}")
        data = Trajectories.of(x, t, u, feature_names)
        problem, rates = self._problem(data, feature_names)
        given = [self.state_names_.index(name) for name in (*self._known, *self.idle_)]
        optimizer = self.optimizer if self.optimizer is not None else STLSQ()
        full = self.search == "full"
        levels, best = search_by_levels(problem, rates, given, optimizer, full=full)
        if full:
            levels, best = with_noisy_inputs(problem, rates, given, optimizer, (levels, best))
        self._keep(levels, best)
        before = self.state_
        if not full or before not in ASKED:
            return self
        if (moved := read_late(levels[0], best, rates, given, optimizer)) is not None:
            level, fewer, late = moved
            self._keep([level, *levels], fewer, late)
            # With the readings moved something else is missing as well; or no term is needless,
            # where one beyond the library explains as much.
            more = before not in CLEAN and self.state_ is not FitState.READ_LATE
            as_many = len(fewer.support) >= len(best.support)
            if more or (before is FitState.LIBRARY_TOO_SMALL and as_many):
                self._keep(levels, best)
        return self

    # -- What was found ---------------------------------------------------------------------------

    def __repr__(self, N_CHAR_MAX: int = 700) -> str:
        try:
            return str(super().__repr__(N_CHAR_MAX))
        except AttributeError:
            # pysindy's CustomLibrary cannot print itself.
            return f"{type(self).__name__}()"

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
        check_is_fitted(self)
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

        right = self.equations(precision)
        left = lhs or [f"({name})'" for name in self.state_names_]
        for one, other in zip(left, right, strict=True):
            sys.stdout.write(f"{one} = {other}\n")
        for words in idle_words(self.idle_):
            sys.stdout.write(f"{words}\n")
        if self.late_ is not None:
            sys.stdout.write(f"{self.late_.words(self.state_names_)}\n")
        if self.state_ is not FitState.OK:
            sys.stdout.write(f"{self.state_}: {self.state_.advice}\n")

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

        check_is_fitted(self)
        times, start = output_times(t), np.ravel(x0)
        features, xi = self._features, self.coef_.T
        as_fitted("x0", start.size, self.state_names_)
        good = start.dtype.kind in "fiu" and bool(np.isfinite(start).all())
        require(good, "x0", "finite numbers", f"{x0}")
        inputs, held = self._inputs(times, u), bool(self.held_inputs_)

        def rate(time: float, state: FloatArray) -> FloatArray:
            z = np.reshape(inputs(time), (1, -1))
            return np.asarray((features.values(state[None, :], z) @ xi)[0])

        def lost(time: float, state: FloatArray) -> float:
            return float(1e3 - np.max(np.abs(state) / self._bound))

        lost.terminal = True  # type: ignore[attr-defined]
        result = np.full((times.size, xi.shape[1]), np.nan)
        with np.errstate(all="ignore"):
            run = solve_ivp(
                rate,
                (times[0], times[-1]),
                start.astype(np.float64),
                t_eval=times,
                method="LSODA",  # Far outside its data a model may be stiff.
                # A held input must not be stepped over.
                max_step=np.min(abs(np.diff(times)), initial=np.inf) if held else np.inf,
                events=lost,
                rtol=1e-7,
                atol=1e-9 * float(self._bound.min()),
            )
        found = np.reshape(run.y, (xi.shape[1], -1))
        result[: found.shape[1]] = found.T
        result[0] = start
        return result

    def _inputs(self, times: FloatArray, u: Any) -> Callable[[float], FloatArray]:
        """Return the inputs as a function of time, between the rows as they were found."""
        from scipy.interpolate import CubicSpline

        n = len(self.input_names_)
        if callable(u):
            as_fitted("u", np.size(u(times[0])), self.input_names_)
            called: Callable[[float], FloatArray] = u
            return called
        given = listed("u", np.atleast_1d(u))[0] if u is not None else np.zeros((times.size, 0))
        as_fitted("u", given.shape[1], self.input_names_)
        if n:
            # A clock that rises, as in `fit`.
            times_of(times, len(given))
        smooth = CubicSpline(times, given) if n else None
        held = np.array([name in self.held_inputs_ for name in self.input_names_], dtype=np.bool_)

        def value(time: float) -> FloatArray:
            row = max(int(np.searchsorted(times, time, side="right")) - 1, 0)
            return given[row] if smooth is None else np.where(held, given[row], smooth(time))

        return value

    def score(self, x: Any, t: Any, u: Any = None) -> float:
        """Return R² of runs that restart every 300 rows from their best starts.

        Parameters
        ----------
        x, t, u
            As in `fit`.
        """
        check_is_fitted(self)
        data = Trajectories.of(x, t, u)
        as_fitted("x", data.y.shape[1], [n for n in self.state_names_ if n not in self.hidden])
        as_fitted("u", data.u.shape[1], self.input_names_)
        data = replace(data, held=self.search_.likelihood.data.held)
        moving(data.y, self.state_names_)
        if self.late_ is not None:
            data = self.late_.undone(data, data.smooth())
        problem = Collocation(
            self._with_hidden(data, self._known),
            self._features,
            self._noise_all,
            self.coef_.T,
            self._hidden,
            np.zeros(data.u.shape[1]),
            _SCORED_ROWS,
            self.search_.likelihood.parts,
        )
        fit = problem.fit(np.zeros(0, dtype=np.intp), _no_terms(problem, problem.data.smooth()))
        measured = ~self._hidden & ~np.isin(self.state_names_, self.idle_)
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
        check_names((*named, *self.hidden), n_states + n_inputs + len(self.hidden))
        states, self.input_names_ = named[:n_states], tuple(named[n_states:])
        self.state_names_ = (*states, *self.hidden)
        apart(np.column_stack((data.y, data.u)), named[: data.y.shape[1] + data.u.shape[1]])
        known = self._checked_known()
        # Not one that a given equation moves or holds.
        tied = " ".join(term for terms in known.values() for term in terms).replace("^", " ")
        free = [name not in (*known, *tied.split()) for name in states]
        still = idle(data.y, data.u, data.runs.starts) & free
        still &= not still[free].all()
        self.idle_ = tuple(np.array(states)[still].tolist())
        noise = data.noise
        data = self._with_hidden(data, known)
        hidden = np.arange(data.y.shape[1]) >= len(states)
        spread = np.std(data.y, axis=0)
        noise = np.append(noise, _HIDDEN_FREEDOM * spread[hidden])
        library = self.library if self.library is not None else PolynomialLibrary(degree=3)
        every = (*self.state_names_, *self.input_names_)
        features = Features.of(library, every, data.y, data.u, np.flatnonzero(still))
        given = np.zeros((len(features.names), data.y.shape[1]))
        for state, terms in known.items():
            for name, value in terms.items():
                given[features.index(name), self.state_names_.index(state)] = value
        self._known, self._hidden = known, hidden
        exact = np.zeros(n_inputs)
        return Collocation(data, features, noise, given, hidden, exact), self._rates(data)

    def _checked_known(self) -> dict[str, dict[str, float]]:
        try:
            equations = dict(self.known or {})
            known = {s: {n: float(v) for n, v in dict(e).items()} for s, e in equations.items()}
            finite = all(np.isfinite(list(given.values())).all() for given in known.values())
        except (TypeError, ValueError):
            finite = False
        coefficients = "finite coefficients by state and term, as {'x': {'y': 1.0}}"
        require(finite, "known", coefficients, f"{self.known!r}")
        for state in known:
            require(state in self.state_names_, "known", "states of x or `hidden`", state)
        some = len(known) < len(self.state_names_)
        require(some, "known", "a state whose equation is to be found", "the equations of all")
        plain = {"1", *self.state_names_, *self.input_names_}
        for name in self.hidden:
            ties = self._ties(name, known)
            with_it = f"a known equation of a measured state with the term {name}"
            require(bool(ties), "hidden", with_it, "none")
            expected = f"a sum of states, inputs and 1, with a share of {name}, where it is known"
            for terms in ties.values():
                found = ", ".join(f"{n}={value:g}" for n, value in terms.items())
                require(set(terms) <= plain and terms[name] != 0.0, "known", expected, found)
        return known

    def _ties(self, name: str, known: Mapping[str, Any]) -> dict[str, Any]:
        """Return the known equations of measured states that hold a hidden one."""
        return {s: terms for s, terms in known.items() if name in terms and s not in self.hidden}

    def _with_hidden(self, data: Trajectories, known: Mapping[str, Any]) -> Trajectories:
        """Add the hidden states, as the known equations give them from smoothed derivatives."""
        if not self.hidden:
            return data
        smooth, rates = data.smooth(), self._rates(data)
        columns = dict(zip(self.state_names_, smooth.T, strict=False))
        columns |= dict(zip(self.input_names_, data.u.T, strict=True))
        for name in self.hidden:
            state, terms = next(iter(self._ties(name, known).items()))
            rest = rates[:, self.state_names_.index(state)].copy()
            for other, value in terms.items():
                if other != name:
                    rest -= value * (1.0 if other == "1" else columns[other])
            columns[name] = rest / terms[name]
        added = np.column_stack([columns[name] for name in self.hidden])
        return replace(data, y=np.column_stack((data.y, added)))

    def _rates(self, data: Trajectories) -> FloatArray:
        """Return dx/dt of shape (n_rows, n_states), by the user's differentiation or a smooth."""
        from pysindy import FiniteDifference

        how = self.differentiation if self.differentiation is not None else FiniteDifference()
        y = data.y if self.differentiation is not None else data.smooth()
        parts = [np.asarray(how(y[p], data.time_s[p])) for p in data.runs.slices()]
        return np.concatenate(parts)

    def _keep(self, searches: list[Level], best: Tried[Fit], late: Late | None = None) -> None:
        search, nothing = searches[0], np.zeros(0, dtype=np.intp)
        problem = search.likelihood
        if not np.isfinite(best.score):
            empty = problem.fit(nothing, _no_terms(problem, problem.data.y))
            best = Tried((), np.inf, empty, best.by)
        features, n_terms = problem.features, problem.known.shape[0]
        self._features, self._noise_all = features, problem.noise
        self.noise_ = problem.noise[~problem.hidden]
        self.input_noise_ = problem.input_noise
        self.search_, self.best_ = search, best
        named = zip(self.input_names_, problem.data.held, strict=True)
        self.held_inputs_ = tuple(name for name, held in named if held)
        self.late_ = late
        self._bound = np.max(np.abs(problem.data.y), axis=0)
        self.candidate_terms_ = features.names
        self.coef_ = (best.fit.xi + problem.known).T
        self.covariance_ = best.fit.covariance
        self.equation_terms_ = self._terms_of(best, problem.known)
        self.terms_ = tuple(tuple(t.name for t in terms) for terms in self.equation_terms_)
        self.x_ = best.fit.x
        self.rivals_ = tuple(
            Rival(self._terms_of(t, problem.known), 0.5 * (t.score - best.score))
            for t in search.rivals(best, RIVAL)
        )
        self.inclusion_probability_ = search.inclusion(self.coef_.size).reshape(-1, n_terms)
        self.path_ = tuple(
            (t.by, self._names_of(t.support), 0.5 * float(t.score))
            for each in searches
            for t in sorted(each.tried.values(), key=lambda t: t.score)
        )
        columns = (*self.state_names_, *self.input_names_)
        self.beyond_: tuple[str, ...] = ()
        if self.search == "optimizer" and best.support and np.isfinite(best.fit.chi2):
            self.state_ = FitState.PROPOSED
        else:
            late_read = late is not None
            self.state_, self.beyond_ = ended(search, best, self.rivals_, columns, late=late_read)

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


def _no_terms(problem: Collocation, x: FloatArray) -> Fit:
    return Fit(np.zeros_like(problem.known), x, problem.data.u, np.inf, np.zeros((0, 0)), False)
