"""One search for the terms of a model, whatever its likelihood.

A likelihood fits the terms that are asked for, and gives the regression on all terms about a fit.
On that regression supports of every size are compared at once; those that promise most are fitted.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from sindy_surge.linear_problem import LinearProblem, Support
from surge_core.errors import InputError
from surge_core.types import FloatArray

Fit = TypeVar("Fit")

OPTIMIZERS = ("SSR", "STLSQ", "FROLS", "best-subset")

# Dropping the term whose loss hurts least needs one regression for each term left: 0.2 s with
# 20 terms, several seconds with 60.
_MOST_TERMS_FOR_RESIDUAL_CRITERION = 30
_STLSQ_THRESHOLDS = 40
# Supports of each size that are looked at, and how many near and far ones are fitted after each
# step of a climb.
_LOOKED_AT = 5
_FITTED_A_ROUND = 6
_MOST_ROUNDS = 25
# Beyond this the regression is too far from what a fit will find, in χ².
_WORSE = 60.0
# Sizes without a lower score that end a beam search.
_SIZES_BEYOND = 3
_WIDTH = 200


class Likelihood(Protocol[Fit]):
    """What a search asks of a model and its data."""

    def try_terms(self, support: Support, near: Fit) -> tuple[Fit, float]:
        """Fit some terms from a fit nearby; return the fit and its χ², infinite without one."""

    def regression(self, fit: Fit) -> LinearProblem:
        """Return the regression on all terms about a fit."""


@dataclass(frozen=True)
class Tried(Generic[Fit]):
    """One support with what it scored."""

    support: Support  # Columns of the regression
    score: float  # χ² plus the price of the terms
    fit: Fit  # What its likelihood makes of it
    by: str  # What proposed it


@dataclass
class Search(Generic[Fit]):
    """Supports tried with one likelihood."""

    likelihood: Likelihood[Fit]  # Fits supports
    equations: Sequence[Support]  # The columns that each equation may hold
    price: float  # What a term costs, in χ²
    tried: dict[Support, Tried[Fit]] = field(default_factory=dict)

    def try_support(self, support: Iterable[int], near: Fit, by: str) -> Tried[Fit]:
        """Fit a support from a fit nearby, once."""
        key = tuple(sorted(support))
        if key not in self.tried:
            fit, chi2 = self.likelihood.try_terms(key, near)
            self.tried[key] = Tried(key, chi2 + len(key) * self.price, fit, by)
        return self.tried[key]

    def climb(self, best: Tried[Fit]) -> Tried[Fit]:
        """Add, drop and exchange terms of one equation as long as the score falls."""
        for _ in range(_MOST_ROUNDS):
            for support in self._promising(best):
                more, fewer = set(support) - set(best.support), set(best.support) - set(support)
                by = "exchange" if more and fewer else "add" if more else "drop"
                trial = self.try_support(support, best.fit, by)
                if trial.score < best.score:
                    best = trial
                    break
            else:
                break
        return best

    def _promising(self, best: Tried[Fit]) -> Iterator[Support]:
        """Yield untried supports, apart in one equation, that the regression speaks for.

        Those come first that are one term away; then the best of all.
        """
        linear = self.likelihood.regression(best.fit)
        limit = linear.score(best.support, self.price) + _WORSE
        near: dict[Support, float] = {}
        far: dict[Support, float] = {}
        for equation in self.equations:
            close, wide = self._ranked(linear, best, equation, _LOOKED_AT)
            near, far = near | close, far | wide
        for found in (near, far):
            untried = [s for s in found if found[s] < limit and s not in self.tried]
            yield from sorted(untried, key=lambda s: found[s])[:_FITTED_A_ROUND]

    def _ranked(
        self, linear: LinearProblem, best: Tried[Fit], equation: Support, looked_at: int
    ) -> tuple[dict[Support, float], dict[Support, float]]:
        """Return the scores of supports apart in one equation: one term away, and the best."""
        near: dict[Support, float] = {}
        others = tuple(i for i in equation if i not in best.support)
        for left_out in (None, *(i for i in best.support if i in equation)):
            kept = tuple(i for i in best.support if i != left_out)
            ranked = best_of_equation(linear, others, kept, self.price, 1, looked_at)
            near |= {support: score for score, support in ranked}
        kept = tuple(i for i in best.support if i not in equation)
        ranked = best_of_equation(linear, equation, kept, self.price, looked_at=looked_at)
        return near, {support: score for score, support in ranked}

    def complete(self, best: Tried[Fit], margin: float) -> Tried[Fit]:
        """Fit all that the regression puts within a margin, up to the first that is better.

        On few rows so many models score alike that a climb fits a part of them only, and never
        those that are apart in two equations.
        """
        linear = self.likelihood.regression(best.fit)
        base = linear.score(best.support, self.price)
        behind: dict[Support, float] = {(): 0.0}
        for equation in self.equations:
            near, far = self._ranked(linear, best, equation, _WIDTH)
            behind = {
                (*others, *(i for i in support if i in equation)): sum_
                for others, one in behind.items()
                for support, score in (near | far).items()
                if (sum_ := one + score - base) < margin
            }
            behind = dict(sorted(behind.items(), key=lambda each: each[1])[:_WIDTH])
        for support in behind:
            trial = self.try_support(support, best.fit, "rival")
            if trial.score < best.score:
                return trial
        return best

    def rivals(self, best: Tried[Fit], margin: float) -> list[Tried[Fit]]:
        """Return the other supports that scored almost as well, best first."""
        close = [t for t in self.tried.values() if t.score - best.score < margin and t is not best]
        return sorted(close, key=lambda t: t.score)

    def inclusion(self, size: int) -> FloatArray:
        """Return the weight of the supports that hold each column, exp(-score/2) each."""
        scores = np.array([t.score for t in self.tried.values()])
        result = np.zeros(size)
        if np.isfinite(scores).any():
            weights = np.exp(-0.5 * (scores - scores.min()))
            for weight, support in zip(weights / weights.sum(), self.tried, strict=True):
                result[list(support)] += weight
        return result


def best_of_equation(
    linear: LinearProblem,
    equation: Support,
    kept: Support,
    price: float,
    most: int | None = None,
    looked_at: int = _LOOKED_AT,
) -> list[tuple[float, Support]]:
    """Return the scores of the best supports of each size of one equation, beside terms kept.

    A term costs ``price``, in χ²; the equation has ``most`` terms, ``looked_at`` of each size.
    """
    rest, variance = linear.beside(kept, equation), linear.variance
    found = [(rest.chi2(()) / variance + price * len(kept), kept)]
    least, last = found[0][0], 0
    for size, ranked in islice(_beams(rest, _WIDTH), most):
        scores = [chi2 / variance + price * (size + len(kept)) for chi2, _ in ranked[:looked_at]]
        if scores[0] < least:
            least, last = scores[0], size
        elif size >= last + _SIZES_BEYOND:
            break
        supports = (tuple(sorted((*kept, *(equation[i] for i in own)))) for _, own in ranked)
        found += zip(scores, supports, strict=False)
    return found


def proposed_supports(linear: LinearProblem, optimizer: Any, max_terms: int) -> list[Support]:
    """Run a pysindy optimizer on the compressed problem and collect the supports on its path.

    The columns have unit norm and the ridge is switched off for the optimizers called by name: it
    would swamp columns this small, and a raw threshold would never prune.
    """
    found: set[Support] = set()
    for candidate in _optimizers(optimizer, linear):
        for coefficients in _history(candidate, linear):
            support = tuple(int(i) for i in np.flatnonzero(coefficients))
            if 0 < len(support) <= max_terms:
                found.add(support)
    return sorted(found, key=lambda s: (len(s), s))


def chosen_support(linear: LinearProblem, optimizer: Any) -> Support:
    """Return the terms that a pysindy optimizer ends with, its threshold in physical units."""
    plain = replace(linear, columns=linear.columns * linear.norms)
    met = [each for one in _optimizers(optimizer, plain) for each in _history(one, plain)]
    return tuple(int(i) for i in np.flatnonzero(met[-1])) if met else ()


def proposals(
    linear: LinearProblem, optimizer: Any, max_terms: int, required: Support = ()
) -> list[Support]:
    """Return the optimizer's path and, beside it, the best supports of every size.

    A path that drops or adds one term at a time never returns from a wrong turn: one
    exponential that stands in for a parabola keeps backward elimination off the truth.
    """
    free = [i for i in range(linear.columns.shape[1]) if i not in required]
    rest = linear.beside(required, free) if required else linear
    room = max_terms - len(required)
    found: set[Support] = {required} if required else set()
    if room > 0 and free:
        for support in proposed_supports(rest, optimizer, room):
            found.add(tuple(sorted((*required, *(free[i] for i in support)))))
    for ranked in beam_search(linear, max_terms, required=required).values():
        found.update(support for _, support in ranked[:4])
    return sorted(found, key=lambda s: (len(s), s))


def _optimizers(optimizer: Any, linear: LinearProblem) -> list[Any]:
    from pysindy.optimizers import FROLS, SSR, STLSQ

    if hasattr(optimizer, "fit") and not isinstance(optimizer, type):
        # A copy: pysindy's optimizers carry state from one fit to the next.
        return [copy.deepcopy(optimizer)]
    n_terms = linear.columns.shape[1]
    exact = {"solver": "svd"}
    if optimizer == "best-subset":
        return []
    if optimizer == "SSR":
        few = n_terms <= _MOST_TERMS_FOR_RESIDUAL_CRITERION
        criteria = "model_residual" if few else "coefficient_value"
        return [SSR(alpha=0.0, criteria=criteria, max_iter=n_terms, ridge_kw=exact)]
    if optimizer == "FROLS":
        return [FROLS(alpha=0.0, max_iter=n_terms, ridge_kw=exact)]
    if optimizer == "STLSQ":
        # Relative thresholds, from far below the noise to the whole signal.
        size = float(np.linalg.norm(linear.target)) or 1.0
        levels = size * np.geomspace(1e-5, 1.0, _STLSQ_THRESHOLDS)
        return [STLSQ(threshold=v, alpha=0.0, max_iter=2 * n_terms, ridge_kw=exact) for v in levels]
    raise InputError(
        "optimizer",
        expected=f"one of {', '.join(OPTIMIZERS)} or a pysindy optimizer",
        found=repr(optimizer),
        remedy=f"pass {optimizer.__name__}(...)" if isinstance(optimizer, type) else "",
    )


def _history(optimizer: Any, linear: LinearProblem) -> list[FloatArray]:
    """Fit and return every coefficient vector met on the way."""
    from sklearn import config_context

    # Hundreds of regressions on some twenty rows: checking the arrays would take most of the time.
    quick = config_context(assume_finite=True, skip_parameter_validation=True)
    with warnings.catch_warnings(), quick:
        # STLSQ warns whenever a threshold removes every term, which ends a sweep as it should.
        warnings.simplefilter("ignore")
        try:
            optimizer.fit(linear.columns, linear.target)
        except ValueError:
            # FROLS stops so on columns that rounding makes dependent; what it found still counts.
            if not getattr(optimizer, "history_", None):
                return []
    met = [
        *getattr(optimizer, "history_", ()),
        *getattr(optimizer, "coef_list", ()),
        getattr(optimizer, "coef_", np.zeros(0)),
    ]
    return [np.ravel(np.asarray(one)) for one in met]


def beam_search(
    linear: LinearProblem, max_terms: int, width: int = _WIDTH, required: Support = ()
) -> dict[int, list[tuple[float, Support]]]:
    """Find the best supports of every size by adding terms to the best of one size less.

    With about 20 terms it is exhaustive up to three.
    """
    if not required:
        return dict(islice(_beams(linear, width), max_terms))
    free = [i for i in range(linear.columns.shape[1]) if i not in required]
    rest = linear.beside(required, free)
    result = {len(required): [(rest.chi2(()), required)]}
    for size, ranked in beam_search(rest, max_terms - len(required), width).items():
        result[size + len(required)] = [
            (chi2, tuple(sorted((*required, *(free[i] for i in support)))))
            for chi2, support in ranked
        ]
    return result


def _beams(linear: LinearProblem, width: int) -> Iterator[tuple[int, list[tuple[float, Support]]]]:
    """Yield each size with its best supports and their χ², best first."""
    columns, target = linear.columns, linear.target
    n_terms = columns.shape[1]
    beam: list[Support] = [()]
    bases = np.zeros((1, columns.shape[0], 0))
    rests = target[None, :]
    for size in range(1, n_terms + 1):
        # One Gram-Schmidt step for every support and every term at once.
        new = columns[None] - bases @ (np.swapaxes(bases, 1, 2) @ columns[None])
        lengths = np.sum(new**2, axis=1)
        usable = lengths > 1e-16
        gains = np.where(usable, np.einsum("bmp,bm->bp", new, rests) ** 2, 0.0)
        gains /= np.where(usable, lengths, 1.0)
        scores = np.sum(rests**2, axis=1)[:, None] - gains
        for number, support in enumerate(beam):
            scores[number, list(support)] = np.inf
        scores[~usable] = np.inf
        best: dict[Support, tuple[float, int, int]] = {}
        for flat in np.argsort(scores, axis=None):
            number, term = divmod(int(flat), n_terms)
            if not np.isfinite(scores[number, term]) or len(best) >= width:
                break
            support = tuple(sorted((*beam[number], term)))
            best.setdefault(support, (float(scores[number, term]), number, term))
        if not best:
            return
        yield size, [(max(each[0], 0.0) + linear.outside, s) for s, each in best.items()]
        parents = np.array([entry[1] for entry in best.values()])
        added = np.array([entry[2] for entry in best.values()])
        fresh = new[parents, :, added] / np.sqrt(lengths[parents, added])[:, None]
        # A second projection keeps the basis orthogonal for nearly dependent terms.
        old = bases[parents]
        fresh -= np.einsum("bmk,bk->bm", old, np.einsum("bmk,bm->bk", old, fresh))
        fresh /= np.linalg.norm(fresh, axis=1)[:, None]
        bases = np.concatenate((old, fresh[:, :, None]), axis=2)
        rests = rests[parents]
        rests = rests - fresh * np.sum(fresh * rests, axis=1)[:, None]
        beam = list(best)
