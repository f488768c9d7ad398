"""Choice of the terms: the smallest structure that no other refutes about its own fit.

And how often each term is chosen when blocks of the record are drawn again with replacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sindy_surge.candidate_terms import PhysicalForm
from sindy_surge.constraints import Constraints
from sindy_surge.lag_fit import StructureFit, WhiteEquations, fit_structure, white_equations
from sindy_surge.linear_problem import LinearProblem, Support, without_nuisances
from sindy_surge.preparation import Prepared
from sindy_surge.search import Search, beam_search, best_of_equation, proposals
from surge_core.types import FloatArray

# Weight of a block that a resample leaves out. It keeps a term finite that acts in that block
# alone, and decides nothing: χ² changes by one part in 1e9.
_LEAST_WEIGHT = 1e-9
# The best structures about the record itself are tried in every resample.
_TRIED = 100


def inclusion_probabilities(
    equations: WhiteEquations,
    blocks: Sequence[slice],
    max_terms: int,
    *,
    penalty_per_term: float,
    n_resamples: int,
    rng: np.random.Generator,
    required: Sequence[int] = (),
) -> FloatArray:
    """Return the share of resamples whose structure holds each usable term.

    Bootstrap over blocks of rows: as many as there are, from `segments.block_slices`, are drawn
    with replacement, and the choice is made again; nan if no equation lies in the blocks.

    In each resample the nuisances are projected out, and of the best structures about the whole
    record the one of least χ²/s² + penalty · size is taken, s² being the variance that all terms
    leave (not below 1). A term well above the detection limit is in every structure; one at the
    limit, where the gain in χ² is the penalty, in about half of them. The absent terms come in more
    often than in new records: the noise of the record at hand is part of what a resample takes for
    true.

    A resample is the regression on rows weighted by the root of how often they were drawn, each
    block compressed by QR beforehand.
    """
    stacked = np.column_stack((equations.nuisances, equations.columns, equations.target))
    ends = np.searchsorted(equations.rows, [(block.start, block.stop) for block in blocks])
    sizes = np.diff(ends, axis=1)[:, 0]
    ends, sizes = ends[sizes > 0], sizes[sizes > 0]
    n_nuisances, n_terms = equations.nuisances.shape[1], equations.columns.shape[1]
    if not sizes.size:
        return np.full(n_terms, np.nan)
    linear = equations.compressed()
    ranked = sorted(
        (chi2 / linear.variance + penalty_per_term * size, support)
        for size, found in beam_search(linear, max_terms, required=tuple(required)).items()
        for chi2, support in found
    )
    tried = [support for _, support in ranked[:_TRIED]]
    own = [np.linalg.qr(stacked[first:stop], mode="r") for first, stop in ends]
    block, rows = np.repeat(np.arange(len(own)), [len(each) for each in own]), np.concatenate(own)
    held = np.zeros(n_terms)
    for drawn in rng.multinomial(len(own), np.full(len(own), 1 / len(own)), size=n_resamples):
        weighted = rows * np.sqrt(drawn + _LEAST_WEIGHT)[block, None]
        nuisances, columns = weighted[:, :n_nuisances], weighted[:, n_nuisances:-1]
        resample = without_nuisances(nuisances, columns, weighted[:, -1], int(drawn @ sizes))
        best = min(tried, key=lambda support: resample.score(support, penalty_per_term))
        held[list(best)] += 1
    return held / n_resamples


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


@dataclass(frozen=True)
class PathRow:
    """One line of the table of structures."""

    size: int  # Number of terms
    terms: tuple[str, ...]  # Their names
    # Extended BIC about the structure's own fit, or about the fit with all terms where τ is nan.
    # The lower the better, but only within one linearisation
    score: float
    chi2: float  # Sum of the squared whitened residuals
    time_constant_s: float  # τ of the structure's own fit in seconds; nan where it had none
    consistent: bool  # Whether no other structure beats it about its own fit
    chosen: bool  # Whether it is the answer
    # Error on cycles left out, in units of ψ', where these decide; else nan
    held_out_rms: float = float("nan")


@dataclass(frozen=True)
class Selection:
    """The structure chosen, and everything looked at on the way."""

    fit: StructureFit  # The chosen structure
    path: tuple[PathRow, ...]  # Every structure proposed or tested
    # Structures that the data cannot tell from the chosen one: of the same size, χ² within 4, or
    # within 9 of a complete polynomial
    rivals: tuple[Support, ...]
    # False if every structure tested was refuted; the fit is then the best of them
    consistent: bool


def information_penalty(n_equations: int, n_terms: int) -> float:
    """Return what one more term must gain in χ²: ln N + 2 γ ln p."""
    return float(np.log(max(n_equations, 2)) + 2 * _GAMMA * np.log(max(n_terms, 2)))


def select_structure(
    prepared: Prepared, optimizer: Any, max_terms: int, constraints: Constraints
) -> Selection:
    """Choose the terms.

    A pysindy optimizer proposes supports of every size on the whitened, compressed regression
    about the fit with all terms. From the smallest upwards each is fitted by itself, and the
    whole library is then regressed about *that* fit: the structure stands if no larger one
    beats its extended BIC and none of its own size does so by more than 4 (9 for a complete
    polynomial). What refutes a structure is proposed in its place. Of the smallest size that
    stands, the least χ² wins; within those margins, the structure with fewer terms that are not
    polynomials.
    """
    search = _Search(prepared, max_terms, constraints)
    search.propose(optimizer)
    search.run()
    chosen, rivals = search.choose()
    fit = search.tried[chosen].fit
    return Selection(fit, search.table(chosen), rivals, bool(search.standing()))


@dataclass(frozen=True)
class _Tested:
    """What the regression about a structure's own fit says of it."""

    score: float
    variance: float
    stands: bool


class _Search(Search[StructureFit]):
    """The structures still to be tested, and what the tests said.

    χ² of different fits are not compared: about a fit with a wild slope it is too low. What is
    compared are structures about one fit, that of the smallest.
    """

    def __init__(self, prepared: Prepared, max_terms: int, constraints: Constraints) -> None:
        self.problem, self.rich = prepared.problem, prepared.rich
        self.max_terms, self.constraints = max_terms, constraints
        self.about = white_equations(self.problem, self.rich).compressed()
        # The same for every linearisation: as many equations and terms.
        n_terms = self.about.columns.shape[1]
        price = information_penalty(self.about.n_equations, n_terms)
        free = tuple(i for i in range(n_terms) if i not in constraints.required)
        super().__init__(self, [free], price)
        self.rough: dict[Support, float] = {}
        self.queue: list[Support] = []
        self.tested: dict[Support, _Tested] = {}

    def try_terms(self, support: Support, near: StructureFit) -> tuple[StructureFit, float]:
        """Fit some terms, whitened for noise on both channels, from τ and β of all terms."""
        tau, beta = self.rich.time_constant_s, self.about.coefficients(support)
        fit = fit_structure(self.problem, support, tau, beta, near=near)
        return fit, fit.chi2

    def regression(self, fit: StructureFit) -> LinearProblem:
        """Return the regression on all terms about a fit."""
        return white_equations(self.problem, fit).compressed()

    def standing(self) -> list[Support]:
        """Return the structures that no other refutes."""
        return [support for support, tested in self.tested.items() if tested.stands]

    def propose(self, optimizer: Any) -> None:
        """Score the optimizer's structures about the fit with all terms, and queue the best."""
        required = self.constraints.required
        proposed = proposals(self.about, optimizer, self.max_terms, required)
        if np.any(self.constraints.signs):
            # Look further down where the signs are not as asked for.
            found = {s for s in proposed if self._signed(s, self.about.coefficients(s))}
            for ranked in beam_search(self.about, self.max_terms, required=required).values():
                signed = [s for _, s in ranked if self._signed(s, self.about.coefficients(s))]
                found.update(signed[:4])
            proposed = sorted(found, key=lambda s: (len(s), s)) or proposed
        self.rough = {s: self.about.score(s, self.price) for s in proposed}
        self.queue = self._seeds(sorted(proposed, key=lambda s: self.rough[s]))

    def _seeds(self, ranked: list[Support]) -> list[Support]:
        """Take the four best proposals, two more of the best one's size and two of one less.

        A score 60 above the best is no candidate: about the fit with all terms the scores were
        found wrong by 25 at most. Of structures with ψ' terms only the two best are fitted: a fit
        of all terms of φ, wild at the ends of the range, leaves much for them to explain.
        """
        with_state = [s for s in ranked if self.problem.holds_state(s)]
        without = [s for s in ranked if not self.problem.holds_state(s)] or ranked
        size, best = len(without[0]), self.rough[without[0]]
        seeds = without[:4]
        seeds += [s for s in without if len(s) == size][:3]
        seeds += [s for s in without if len(s) == size - 1][:2]
        seeds = [s for s in dict.fromkeys(seeds) if self.rough[s] < best + 60]
        return seeds + [s for s in with_state[:2] if self.rough[s] < best]

    def run(self) -> None:
        """Test what is queued, the smallest first, until no smaller structure can stand."""
        while len(self.tested) < _MOST_FITS:
            waiting = [s for s in self.queue if s not in self.tested]
            if standing := self.standing():
                smallest = min(map(len, standing))
                waiting = [s for s in waiting if len(s) <= smallest]
            if not waiting:
                return
            self._test(min(waiting, key=lambda s: (len(s), self.rough.get(s, np.inf))))

    def _test(self, support: Support) -> None:
        """Fit a structure, compare it with others about its own fit, and queue what that asks."""
        fit = self.try_support(support, self.rich, "").fit
        linear = self.regression(fit)
        own, size = linear.score(support, self.price), len(support)
        required, (free,) = self.constraints.required, self.equations
        most = self.max_terms + 1 - len(required)
        others = sorted(
            (score, other)
            for score, other in best_of_equation(linear, free, required, self.price, most)
            if other not in ((), support) and self._signed(other, linear.coefficients(other))
        )
        margin = self.margin(support)
        beating = [
            other
            for score, other in others
            if len(other) >= size and score < own - (margin if len(other) == size else 0.0)
        ]
        admitted = self._admits(fit)
        asked: list[Support] = []
        if admitted and beating:
            # The three best structures of φ alone and the best of all.
            without = [s for s in beating if not self.problem.holds_state(s)][:4]
            asked = [s for s in (beating[0], *without) if len(s) <= self.max_terms]
        elif admitted and all(size < len(s) for s in self.standing()):
            asked = self._neighbours(own, size, others)
        self.tested[support] = _Tested(own, linear.variance, admitted and not beating)
        self.queue += [s for s in dict.fromkeys(asked) if s not in self.queue]

    def _neighbours(
        self, own: float, size: int, others: list[tuple[float, Support]]
    ) -> list[Support]:
        """Return what should be tested beside a structure that stands.

        Those are the smaller structures that score better about this fit, or little worse (about
        the fit of another they may be misjudged), and the nearest rivals of its own size.
        """
        smaller = [s for score, s in others if len(s) < size and score < own + _MISJUDGED]
        equal = [s for score, s in others if len(s) == size and score < own + 2.5 * _TIE]
        return smaller[:3] + equal[:4]

    def margin(self, support: Support) -> float:
        """Return by how much χ² another structure of the same size must be less."""
        known = sorted(
            self.problem.degrees[i] or 0 for i in support if self.problem.degrees[i] is not None
        )
        return _TIE_POLYNOMIAL if known == list(range(len(support))) else _TIE

    def _signed(self, support: Support, coefficients: FloatArray) -> bool:
        """Test signs on the coefficients that the user will read: those of the physical form."""
        if not np.any(self.constraints.signs):
            return True
        if self.problem.holds_state(support):
            form = self._physical(support, coefficients)
            known = dict(zip(form.names, form.coefficients.tolist(), strict=True))
            names = self.problem.names(support)
            coefficients = np.array([known.get(name, 0.0) for name in names])
        return self.constraints.allow(support, coefficients)

    def _admits(self, fit: StructureFit) -> bool:
        """Return whether physics allows a fit: τ > 0, a ψ' that comes to rest, signs as asked."""
        if not fit.settles or not self._signed(fit.support, fit.coefficients):
            return False
        if not self.problem.holds_state(fit.support):
            return True
        return self._physical(fit.support, fit.coefficients).time_constant_s > 0.0

    def _physical(self, support: Support, coefficients: FloatArray) -> PhysicalForm:
        """Return a structure as its user will read it, τ in units of its own."""
        return self.problem.terms.written(self.problem.columns[list(support)], coefficients)

    def choose(self) -> tuple[Support, tuple[Support, ...]]:
        """Return the best structure of the smallest size that stands, and its rivals."""
        standing = self.standing()
        if not standing:
            allowed = [s for s in self.tested if self._admits(self.tried[s].fit)]
            return min(allowed or self.tested, key=lambda s: self.tested[s].score), ()
        size = min(map(len, standing))
        level = [s for s in standing if len(s) == size]
        # In units of the variance that all terms leave, which colour raises above one.
        chi2 = {s: self.tried[s].fit.chi2 / self.tested[s].variance for s in level}
        least = min(chi2.values())
        tied = [s for s in level if chi2[s] <= least + self.margin(s)]

        def order(support: Support) -> tuple[int, float]:
            special = sum(self.problem.degrees[i] is None for i in support)
            return special, self.tried[support].fit.chi2

        chosen = min(tied, key=order)
        return chosen, tuple(s for s in tied if s != chosen)

    def table(self, chosen: Support) -> tuple[PathRow, ...]:
        """Return every structure with its score."""
        rows = []
        for support in {*self.rough, *self.tested}:
            names = tuple(self.problem.names(support))
            if support in self.tested:
                fit, tested = self.tried[support].fit, self.tested[support]
                found = tested.score, fit.chi2, fit.time_constant_s, tested.stands
            else:
                found = self.rough[support], self.about.chi2(support), float("nan"), False
            rows.append(PathRow(len(support), names, *found, support == chosen))
        return tuple(sorted(rows, key=lambda row: (row.size, row.score)))
