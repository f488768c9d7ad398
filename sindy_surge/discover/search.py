"""Which terms: supports proposed on the information matrix, and judged by their likelihood.

A support's score is half its squared error in units of the noise plus k (½ ln N + ln p): the
extended BIC (Chen & Chen 2008) for k of p candidates an equation on N rows. Proposals come from
pysindy optimizers and from backward elimination; then terms are added, dropped and exchanged.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from sindy_surge.discover.collocation import Collocation, Fit, Linear
from surge_core.errors import InputError
from surge_core.types import FloatArray, IndexArray

Support = tuple[int, ...]

# Neighbours that the regression about the fit promises most of, fitted in each round.
_FITTED_A_ROUND = 6
# Terms of one equation that others may stand for, and how many: √ψ is nearly 1, ψ, ψ² and ψ³
# together, and no exchange of one for one leads from these to the root.
_MOST_LEFT_OUT = _MOST_ADDED = 3
# Share of a term that the others must leave, for it to count as another.
_ALIAS = 1e-10
_FOLLOWED = 4
# Supports of the elimination that are fitted.
_ELIMINATED = 3
_MOST_ROUNDS = 25
# Beyond this the regression is too far from what a fit will find.
_WORSE = 30.0
# Two supports closer than this are rivals (BIC difference of 10: Kass & Raftery 1995).
_RIVAL = 5.0


@dataclass(frozen=True)
class Tried:
    """One support with what it scored.

    Parameters
    ----------
    support : tuple of int
        Columns of Ξ, flattened by state.
    score : float
        Half the squared error plus the price of the terms.
    fit : Fit
        Its coefficients and states.
    by : str
        What proposed it.
    """

    support: Support
    score: float
    fit: Fit
    by: str


@dataclass
class Search:
    """Supports tried on one problem.

    Parameters
    ----------
    problem : Collocation
        What is fitted.
    free : ndarray of int
        Columns of Ξ that may be chosen.
    log_rows, log_terms : float
        ln N and ln p of the score.
    """

    problem: Collocation
    free: IndexArray
    log_rows: float
    log_terms: float
    tried: dict[Support, Tried] = field(default_factory=dict)

    @property
    def price(self) -> float:
        """What a term costs."""
        return 0.5 * self.log_rows + self.log_terms

    def try_support(self, support: Iterable[int], near: Fit, by: str) -> Tried:
        """Fit a support from a fit nearby, once."""
        key = tuple(sorted(support))
        if key not in self.tried:
            fit = self.problem.fit(np.array(key, dtype=np.intp), near.xi, near.x)
            score = 0.5 * fit.chi2 + len(key) * self.price if fit.converged else np.inf
            self.tried[key] = Tried(key, score, fit, by)
        return self.tried[key]

    def climb(self, best: Tried) -> Tried:
        """Add, drop and exchange terms as long as the score falls."""
        for _ in range(_MOST_ROUNDS):
            linear = self.problem.linear(best.fit, self.free)
            better = self._first_better(best, linear)
            if better is None:
                return best
            best = better
        return best

    def _first_better(self, best: Tried, linear: Linear) -> Tried | None:
        """Return a support of lower score: one term apart where there is one, else farther."""
        for find in (self._near, self._eliminated, self._far):
            for support, by in find(best.support, linear):
                trial = self.try_support(support, best.fit, by)
                if trial.score < best.score:
                    return trial
        return None

    def _eliminated(self, support: Support, linear: Linear) -> list[tuple[Support, str]]:
        """Return the best supports on the way down from the whole library, untried ones."""
        promising = self.promising(linear)
        return [(key, "elimination") for key in promising if key not in self.tried]

    def _near(self, support: Support, linear: Linear) -> list[tuple[Support, str]]:
        return self._neighbours(support, linear, 1, 1)

    def _far(self, support: Support, linear: Linear) -> list[tuple[Support, str]]:
        return self._neighbours(support, linear, _MOST_LEFT_OUT, _MOST_ADDED)

    def promising(self, linear: Linear) -> list[Support]:
        """Return the supports of least score, by the regression, that elimination passes."""

        def score(support: Support) -> float:
            places = np.searchsorted(self.free, support)
            return 0.5 * _squares(linear, places) + len(support) * self.price

        return sorted(_eliminated(linear, self.free), key=score)[:_ELIMINATED]

    def _neighbours(
        self, support: Support, linear: Linear, most_left_out: int, most_added: int
    ) -> list[tuple[Support, str]]:
        """Return the untried supports that the regression promises most of.

        They lie some terms of one equation away.
        """
        own = np.searchsorted(self.free, support)
        others = np.setdiff1d(np.arange(self.free.size), own)
        base = _squares(linear, own)
        promises: list[tuple[float, Support, str]] = []

        def promise(places: IndexArray, squares: float, by: str) -> None:
            key = tuple(sorted(int(self.free[i]) for i in places))
            if key not in self.tried and len(set(key)) == len(key):
                gain = 0.5 * (squares - base) + (len(key) - len(support)) * self.price
                promises.append((gain, key, by))

        equation = self.free // self.problem.known.shape[0]
        for state in np.unique(equation):
            mine = np.flatnonzero(equation[own] == state)
            candidates = others[equation[others] == state]
            for n_left_out in range(min(most_left_out, mine.size) + 1):
                for places in combinations(mine.tolist(), n_left_out):
                    left = np.delete(own, places)
                    if n_left_out == 1:
                        promise(left, _squares(linear, left), "drop")
                    by = "exchange" if n_left_out else "add"
                    for n_added in range(1, most_added + 1):
                        for added, squares in _with_more(linear, left, candidates, n_added):
                            promise(np.append(left, added), squares, by)
        promises.sort(key=lambda each: each[0])
        promises = list({key: (gain, key, by) for gain, key, by in promises[::-1]}.values())[::-1]
        return [(key, by) for gain, key, by in promises[:_FITTED_A_ROUND] if gain < _WORSE]

    def rivals(self, best: Tried) -> list[Tried]:
        """Return the other supports that scored almost as well, best first."""
        close = [t for t in self.tried.values() if t.score - best.score < _RIVAL and t is not best]
        return sorted(close, key=lambda t: t.score)

    def inclusion(self, size: int) -> FloatArray:
        """Return the weight of the supports that hold each column of Ξ, exp(-score) each."""
        scores = np.array([t.score for t in self.tried.values()])
        if not np.isfinite(scores).any():
            return np.zeros(size)
        weights = np.exp(-(scores - scores.min()))
        result = np.zeros(size)
        for weight, support in zip(weights / weights.sum(), self.tried, strict=True):
            result[list(support)] += weight
        return result


def _eliminated(linear: Linear, free: IndexArray) -> list[Support]:
    """Drop the term that costs least, one by one; return what is left each time."""
    own = np.arange(free.size)
    path = [tuple(int(i) for i in free)]
    while own.size > 1:
        H = linear.information[np.ix_(own, own)]
        inverse = _inverted(H)
        xi = inverse @ linear.score[own]
        cost = xi**2 / np.maximum(np.diag(inverse), 1e-300)
        own = np.delete(own, int(np.argmin(cost)))
        path.append(tuple(int(free[i]) for i in own))
    return path


def proposed_by(optimizer: Any, linear: Linear, free: IndexArray, n_terms: int) -> Support:
    """Let a pysindy optimizer choose terms, equation by equation.

    The regression about the full fit is A ξ = b with Aᵀ A = H. For one equation all others are
    left free: what the data say of its terms is the inverse of its block of H⁻¹.

    Raises
    ------
    InputError
        If the optimizer cannot be fitted.
    """
    import warnings

    from sklearn.base import clone

    covariance = _inverted(linear.information)
    xi = covariance @ linear.score
    chosen: list[int] = []
    for state in np.unique(free // n_terms):
        rows = np.flatnonzero(free // n_terms == state)
        values, basis = np.linalg.eigh(_inverted(covariance[np.ix_(rows, rows)]))
        A = np.sqrt(np.maximum(values, 0.0))[:, None] * basis.T
        fitted = clone(optimizer)
        with warnings.catch_warnings():
            # What an optimizer has to say of its own threshold is in what it chooses.
            warnings.simplefilter("ignore")
            try:
                fitted.fit(A, (A @ xi[rows])[:, None])
            except (AttributeError, TypeError, ValueError) as error:
                raise InputError(
                    "optimizer", expected="a pysindy optimizer", found=str(error)
                ) from error
        chosen += free[rows[np.flatnonzero(np.ravel(fitted.coef_))]].tolist()
    return tuple(sorted(chosen))


def _squares(linear: Linear, places: IndexArray) -> float:
    if not places.size:
        return linear.squares
    H, g = linear.information[np.ix_(places, places)], linear.score[places]
    return linear.squares - float(g @ _inverted(H) @ g)


def _with_more(
    linear: Linear, own: IndexArray, others: IndexArray, number: int
) -> list[tuple[IndexArray, float]]:
    """Return the best few sets of so many others beside the own terms, with the squared error."""
    if others.size < number:
        return []
    H, g = linear.information, linear.score
    inverse = _inverted(H[np.ix_(own, own)])
    cross = H[np.ix_(own, others)]
    # What the others hold that the own terms do not.
    rest = g[others] - cross.T @ (inverse @ g[own])
    room = H[np.ix_(others, others)] - cross.T @ inverse @ cross
    size = np.sqrt(np.diag(H)[others])
    rest, room = rest / size, room / np.outer(size, size) + _ALIAS * np.eye(others.size)
    sets = np.array(list(combinations(range(others.size), number)))
    blocks = room[sets[:, :, None], sets[:, None, :]]
    gains = np.sum(rest[sets] * np.linalg.solve(blocks, rest[sets][..., None])[..., 0], axis=1)
    best = np.argsort(-gains)[:_FOLLOWED]
    base = _squares(linear, own)
    return [(others[sets[i]], base - float(gains[i])) for i in best]


def _inverted(H: FloatArray) -> FloatArray:
    if not H.size:
        return H
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    scaled = H / np.outer(size, size)
    inverse = np.linalg.pinv(scaled, rcond=1e-13, hermitian=True)
    return np.asarray(inverse / np.outer(size, size))
