"""Choice of the terms: the smallest structure that no other refutes about its own fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sindy_surge.constraints import Constraints
from sindy_surge.lag_fit import (
    StructureFit,
    fit_structure,
    linearise,
)
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import LinearProblem, Support
from sindy_surge.preparation import Prepared
from sindy_surge.sparse_paths import beam_search, proposals
from sindy_surge.state_terms import PhysicalForm, physical_form
from surge_core.types import FloatArray

__all__ = ["PathRow", "Selection", "information_penalty", "select_structure"]


# Extended BIC (Chen & Chen 2008): k (ln N + 2 γ ln p). 1.5 was needed once in 240 records.
_GAMMA = 1.5
# Differences in χ² below this do not decide between structures of one size.
_TIE = 4.0
# A complete polynomial gives way to terms of another kind only beyond three standard errors: there
# is one of each size, and thousands of the others, among which some always fit better by luck.
_TIE_POLYNOMIAL = 9.0
_MOST_FITS = 24
# A smaller structure is fitted by itself if it is no worse than this about a larger one's fit.
_MISJUDGED = 12.0
# Supports of each size that are compared with a structure about its fit.
_COMPARED = 5


@dataclass(frozen=True)
class PathRow:
    """One line of the table of structures.

    Parameters
    ----------
    size : int
        Number of terms.
    terms : tuple of str
        Their names.
    score : float
        Extended BIC about the structure's own fit, or about the fit with all terms when
        `refitted` is false. The lower the better, but only within one linearisation.
    chi2 : float
        Sum of the squared whitened residuals.
    time_constant_s : float
        τ of the fit in seconds; nan when not refitted.
    refitted : bool
        Whether the structure had a fit of its own.
    consistent : bool
        Whether no other structure beats it about its own fit.
    chosen : bool
        Whether it is the answer.
    held_out_rms : float
        Error of the free run on cycles left out, in units of ψ'; of the weak equations where
        model error dominates; nan for structures that were not fitted by themselves.
    """

    size: int
    terms: tuple[str, ...]
    score: float
    chi2: float
    time_constant_s: float
    refitted: bool
    consistent: bool
    chosen: bool
    held_out_rms: float = float("nan")


@dataclass(frozen=True)
class Selection:
    """The structure chosen, and everything looked at on the way.

    Parameters
    ----------
    fit : StructureFit
        The chosen structure.
    path : tuple of PathRow
        Every structure proposed or tested.
    rivals : tuple of tuple of int
        Structures that the data cannot tell from the chosen one: of the same size, χ² within 4,
        or within 9 of a complete polynomial.
    consistent : bool
        False if every structure tested was refuted; the fit is then the best of them.
    fits : dict
        The fit of every structure that had one, by support.
    """

    fit: StructureFit
    path: tuple[PathRow, ...]
    rivals: tuple[Support, ...]
    consistent: bool
    fits: Mapping[Support, StructureFit]


def information_penalty(n_equations: int, n_terms: int) -> float:
    """Return what one more term must gain in χ²: ln N + 2 γ ln p."""
    return float(np.log(max(n_equations, 2)) + 2 * _GAMMA * np.log(max(n_terms, 2)))


@dataclass
class _Search:
    """The structures still to be tested, and what the tests said."""

    problem: LagProblem
    rich: StructureFit
    max_terms: int
    constraints: Constraints
    degrees: Sequence[int | None]
    queue: list[Support]
    fits: dict[Support, StructureFit] = field(default_factory=dict)
    scores: dict[Support, float] = field(default_factory=dict)
    variances: dict[Support, float] = field(default_factory=dict)
    consistent: list[Support] = field(default_factory=list)

    def fit(self, support: Support, about: LinearProblem) -> StructureFit:
        if support not in self.fits:
            beta = about.coefficients(support)
            start = self.rich
            self.fits[support] = fit_structure(
                self.problem, support, start.time_constant_s, beta, near=start
            )
        return self.fits[support]

    def margin(self, support: Support) -> float:
        """Return by how much χ² another structure of the same size must be less."""
        known = sorted(self.degrees[i] or 0 for i in support if self.degrees[i] is not None)
        return _TIE_POLYNOMIAL if known == list(range(len(support))) else _TIE

    def signs_allowed(self, support: Support, coefficients: FloatArray) -> bool:
        """Return whether no sign is against what is asked for."""
        return _signs_allowed(self.problem, self.constraints, support, coefficients)

    def admits(self, fit: StructureFit) -> bool:
        """Return whether physics allows a fit: τ > 0, a ψ' that comes to rest, signs as asked."""
        if not fit.settles or not self.signs_allowed(fit.support, fit.coefficients):
            return False
        if not self.problem.holds_state(fit.support):
            return True
        return _physical(self.problem, fit.support, fit.coefficients).time_constant_s > 0.0

    def test(self, support: Support, fit: StructureFit) -> list[Support]:
        """Return the structures that beat this one about its own fit, the best first."""
        linear = linearise(self.problem, fit)
        penalty = information_penalty(linear.n_equations, linear.columns.shape[1])
        variance, size = linear.variance, len(support)
        own = linear.chi2(support) / variance + penalty * size
        self.scores[support], self.variances[support] = own, variance
        beaten: list[tuple[float, Support]] = []
        required = self.constraints.required
        for other_size, ranked in beam_search(
            linear, self.max_terms + 1, required=required
        ).items():
            if other_size < size:
                continue
            margin = self.margin(support) if other_size == size else 0.0
            for chi2, other in ranked[:_COMPARED]:
                score = chi2 / variance + penalty * other_size
                better = score < own - margin and other != support
                if better and self.signs_allowed(other, linear.coefficients(other)):
                    beaten.append((score, other))
        return [other for _, other in sorted(beaten)]


def _signs_allowed(
    problem: LagProblem, constraints: Constraints, support: Support, coefficients: FloatArray
) -> bool:
    """Test signs on the coefficients that the user will read: those of the physical form."""
    if not np.any(constraints.signs):
        return True
    if problem.holds_state(support):
        form = _physical(problem, support, coefficients)
        known = dict(zip(form.names, form.coefficients.tolist(), strict=True))
        names = [problem.terms.names[i] for i in problem.columns[list(support)]]
        coefficients = np.array([known.get(name, 0.0) for name in names])
    return constraints.allow(support, coefficients)


def _physical(problem: LagProblem, support: Support, coefficients: FloatArray) -> PhysicalForm:
    """Return a structure as its user will read it, τ in units of its own."""
    names = [problem.terms.names[i] for i in problem.columns[list(support)]]
    none = np.zeros((len(names) + 1, len(names) + 1))
    terms = problem.terms
    return physical_form(names, coefficients, 1.0, none, terms.states, terms.input_names)


def select_structure(
    prepared: Prepared,
    optimizer: Any,
    max_terms: int,
    names: Sequence[str],
    degrees: Sequence[int | None],
    constraints: Constraints,
) -> Selection:
    """Choose the terms.

    A pysindy optimizer proposes supports of every size on the whitened, compressed regression
    about the fit with all terms. From the smallest upwards each is fitted by itself, and the
    whole library is then regressed about *that* fit: the structure stands if no larger one
    beats its extended BIC and none of its own size does so by more than 4 (9 for a complete
    polynomial). What refutes a
    structure is proposed in its place. Of the smallest size that stands, the least χ² wins;
    within those margins, the structure with fewer terms that are not polynomials.

    Parameters
    ----------
    degrees : sequence of int or None
        Their degrees; None for those that are no polynomials of the inputs. For the tie rule.
    """
    problem, rich = prepared.problem, prepared.rich
    about = linearise(problem, rich)
    penalty = information_penalty(about.n_equations, about.columns.shape[1])
    proposed = _allowed(
        problem,
        about,
        proposals(about, optimizer, max_terms, constraints.required),
        max_terms,
        constraints,
    )
    rough = {s: about.score(s, penalty) for s in proposed}
    seeds = _seeds(problem, proposed, rough)
    search = _Search(problem, rich, max_terms, constraints, degrees, seeds)
    _run(search, about, rough)
    chosen, rivals = _choose(search)
    path = _table(search, rough, about, chosen, names)
    return Selection(search.fits[chosen], path, rivals, bool(search.consistent), search.fits)


def _allowed(
    problem: LagProblem,
    about: LinearProblem,
    proposed: list[Support],
    max_terms: int,
    constraints: Constraints,
) -> list[Support]:
    """Keep the proposals whose signs are as asked for, and look further down where they are not."""
    if not np.any(constraints.signs):
        return proposed

    def good(support: Support) -> bool:
        return _signs_allowed(problem, constraints, support, about.coefficients(support))

    found = {s for s in proposed if good(s)}
    for ranked in beam_search(about, max_terms, required=constraints.required).values():
        found.update([s for _, s in ranked if good(s)][:4])
    return sorted(found, key=lambda s: (len(s), s)) or proposed


def _seeds(
    problem: LagProblem, proposed: list[Support], rough: dict[Support, float]
) -> list[Support]:
    """Take the four best proposals, two more of the best one's size and two of one less.

    A score 60 above the best is no candidate: about the fit with all terms the scores were
    found wrong by 25 at most. Of structures with ψ' terms only the two best are fitted: a fit
    of all terms of φ, wild at the ends of the range, leaves much for them to explain.
    """
    ranked = sorted(proposed, key=lambda s: rough[s])
    with_state = [s for s in ranked if problem.holds_state(s)]
    without = [s for s in ranked if not problem.holds_state(s)] or ranked
    size, best = len(without[0]), rough[without[0]]
    seeds = without[:4]
    seeds += [s for s in without if len(s) == size][:3]
    seeds += [s for s in without if len(s) == size - 1][:2]
    seeds = [s for s in dict.fromkeys(seeds) if rough[s] < best + 60]
    return seeds + [s for s in with_state[:2] if rough[s] < best]


def _run(search: _Search, about: LinearProblem, rough: dict[Support, float]) -> None:
    tested: set[Support] = set()
    while len(tested) < _MOST_FITS:
        waiting = [s for s in search.queue if s not in tested]
        if search.consistent:
            smallest = min(len(s) for s in search.consistent)
            waiting = [s for s in waiting if len(s) <= smallest]
        if not waiting:
            return
        support = min(waiting, key=lambda s: (len(s), rough.get(s, np.inf)))
        tested.add(support)
        fit = search.fit(support, about)
        beating = search.test(support, fit)
        if not search.admits(fit):
            continue
        if not beating:
            if all(len(support) < len(s) for s in search.consistent):
                search.queue += _neighbours(search, support, fit)
            search.consistent.append(support)
            continue
        for other in _next(search, beating):
            if len(other) <= search.max_terms and other not in search.queue:
                search.queue.append(other)


def _next(search: _Search, beating: list[Support]) -> list[Support]:
    """Take the three best structures of φ alone and the best of all."""
    without = [s for s in beating if not search.problem.holds_state(s)][:4]
    return list(dict.fromkeys((*beating[:1], *without)))


def _neighbours(search: _Search, support: Support, fit: StructureFit) -> list[Support]:
    """Return what should be tested beside a structure that stands.

    Those are the smaller structures that score better about this fit, or little worse (about the
    fit of another they may be misjudged), and the nearest rivals of its own size.
    """
    linear = linearise(search.problem, fit)
    penalty = information_penalty(linear.n_equations, linear.columns.shape[1])
    own = linear.score(support, penalty)
    smaller: list[tuple[float, Support]] = []
    equal: list[tuple[float, Support]] = []
    required = search.constraints.required
    for size, ranked in beam_search(linear, len(support), required=required).items():
        for chi2, other in ranked[:_COMPARED]:
            if not search.signs_allowed(other, linear.coefficients(other)):
                continue
            score = chi2 / linear.variance + penalty * size
            if size < len(support) and score < own + _MISJUDGED:
                smaller.append((score, other))
            elif size == len(support) and other != support and score < own + 2.5 * _TIE:
                equal.append((score, other))
    found = [other for _, other in sorted(smaller)[:3] + sorted(equal)[:4]]
    return [other for other in found if other not in search.queue]


def _choose(search: _Search) -> tuple[Support, tuple[Support, ...]]:
    if not search.consistent:
        allowed = [s for s, f in search.fits.items() if search.admits(f)]
        best = min(allowed or search.fits, key=lambda s: search.scores[s])
        return best, ()
    size = min(len(s) for s in search.consistent)
    level = [s for s in search.consistent if len(s) == size]
    # In units of the variance that all terms leave, which colour raises above one.
    chi2 = {s: search.fits[s].chi2 / search.variances[s] for s in level}
    least = min(chi2.values())
    tied = [s for s in level if chi2[s] < least + search.margin(s)]

    def order(support: Support) -> tuple[int, float]:
        special = sum(search.degrees[i] is None for i in support)
        return special, search.fits[support].chi2

    chosen = min(tied, key=order)
    return chosen, tuple(s for s in tied if s != chosen)


def _table(
    search: _Search,
    rough: dict[Support, float],
    about: LinearProblem,
    chosen: Support,
    names: Sequence[str],
) -> tuple[PathRow, ...]:
    rows = []
    for support in {*rough, *search.fits}:
        fit = search.fits.get(support)
        rows.append(
            PathRow(
                len(support),
                tuple(names[i] for i in support),
                search.scores[support] if fit else rough[support],
                fit.chi2 if fit else about.chi2(support),
                fit.time_constant_s if fit else float("nan"),
                fit is not None,
                support in search.consistent,
                support == chosen,
            )
        )
    return tuple(sorted(rows, key=lambda row: (row.size, row.score)))
