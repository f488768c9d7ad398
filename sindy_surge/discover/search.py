"""Which terms: supports proposed on the information matrix, and judged by their likelihood.

A support's score is half its squared error in units of the noise plus k (½ ln N + ln p): the
extended BIC (Chen & Chen 2008) for k of p candidates an equation on N rows. Proposals come from
pysindy optimizers and from backward elimination; then terms are added, dropped and exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sindy_surge.discover.collocation import Collocation, Fit, Linear
from surge_core.types import FloatArray, IndexArray

__all__ = ["Search", "Tried", "eliminated", "proposed_by"]

Support = tuple[int, ...]

# Neighbours that the regression about the fit promises most of, fitted in each round.
_FITTED_A_ROUND = 4
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

    def climb(self, best: Tried, heard: Callable[[], None] = lambda: None) -> Tried:
        """Add, drop and exchange terms as long as the score falls."""
        for _ in range(_MOST_ROUNDS):
            heard()
            linear = self.problem.linear(best.fit, self.free)
            found = best
            for support, by in self._neighbours(best.support, linear):
                trial = self.try_support(support, best.fit, by)
                if trial.score < found.score:
                    found = trial
                    break
            if found is best:
                return best
            best = found
        return best

    def _neighbours(self, support: Support, linear: Linear) -> list[tuple[Support, str]]:
        """Return the untried neighbours that the regression promises most of."""
        own = np.searchsorted(self.free, support)
        others = np.setdiff1d(np.arange(self.free.size), own)
        base = _squares(linear, own)
        promises: list[tuple[float, Support, str]] = []

        def promise(places: IndexArray, squares: float, by: str) -> None:
            key = tuple(sorted(int(self.free[i]) for i in places))
            if key not in self.tried:
                gain = 0.5 * (squares - base) + (len(key) - len(support)) * self.price
                promises.append((gain, key, by))

        for i in range(own.size):
            left = np.delete(own, i)
            promise(left, _squares(linear, left), "drop")
            for j, squares in zip(others, _with_one_more(linear, left, others), strict=True):
                promise(np.append(left, j), squares, "exchange")
        for j, squares in zip(others, _with_one_more(linear, own, others), strict=True):
            promise(np.append(own, j), squares, "add")
        promises.sort(key=lambda each: each[0])
        return [(key, by) for gain, key, by in promises[:_FITTED_A_ROUND] if gain < _WORSE]

    def rivals(self, best: Tried) -> list[Tried]:
        """Return the other supports that scored almost as well, best first."""
        close = [t for t in self.tried.values() if t.score - best.score < _RIVAL and t is not best]
        return sorted(close, key=lambda t: t.score)

    def inclusion(self, size: int) -> FloatArray:
        """Return the weight of the supports that hold each column of Ξ, exp(-score) each."""
        scores = np.array([t.score for t in self.tried.values()])
        weights = np.exp(-(scores - scores.min()))
        result = np.zeros(size)
        for weight, support in zip(weights / weights.sum(), self.tried, strict=True):
            result[list(support)] += weight
        return result


def eliminated(linear: Linear, free: IndexArray) -> list[Support]:
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


def proposed_by(
    optimizer: Any, linear: Linear, free: IndexArray, n_terms: int
) -> list[Support]:
    """Let a pysindy optimizer choose terms, equation by equation.

    The regression about the full fit is A ξ = b with Aᵀ A = H. For one equation all others are
    left free: what the data say of its terms is the inverse of its block of H⁻¹.
    """
    covariance = _inverted(linear.information)
    xi = covariance @ linear.score
    choices: list[list[IndexArray]] = []
    for state in np.unique(free // n_terms):
        rows = np.flatnonzero(free // n_terms == state)
        values, basis = np.linalg.eigh(_inverted(covariance[np.ix_(rows, rows)]))
        A = np.sqrt(np.maximum(values, 0.0))[:, None] * basis.T
        choices.append([free[rows[kept]] for kept in _kept(optimizer, A, A @ xi[rows])])
    # An optimizer with a path gives one choice of each length for every equation.
    longest = max(map(len, choices))
    filled = [each + [each[-1]] * (longest - len(each)) for each in choices]
    return [tuple(sorted(int(i) for part in one for i in part)) for one in zip(*filled, strict=True)]


def _kept(optimizer: Any, A: FloatArray, b: FloatArray) -> list[IndexArray]:
    import warnings

    from sklearn.base import clone

    chosen = clone(optimizer)
    with warnings.catch_warnings():
        # What an optimizer has to say of its own threshold is in what it chooses.
        warnings.simplefilter("ignore")
        try:
            chosen.fit(A, b[:, None])
        except (ValueError, np.linalg.LinAlgError):
            return [np.zeros(0, dtype=np.intp)]
    return [np.flatnonzero(np.ravel(chosen.coef_) != 0.0)]


def _squares(linear: Linear, places: IndexArray) -> float:
    if not places.size:
        return linear.squares
    H, g = linear.information[np.ix_(places, places)], linear.score[places]
    return linear.squares - float(g @ _inverted(H) @ g)


def _with_one_more(linear: Linear, own: IndexArray, others: IndexArray) -> FloatArray:
    """Return the squared error with each of the others beside the own terms."""
    H, g = linear.information, linear.score
    inverse = _inverted(H[np.ix_(own, own)])
    cross = H[np.ix_(own, others)]
    rest = g[others] - cross.T @ (inverse @ g[own])
    room = np.diag(H)[others] - np.einsum("ij,ij->j", cross, inverse @ cross)
    free = room > 1e-10 * np.diag(H)[others]
    gain = np.where(free, rest**2 / np.where(free, room, 1.0), 0.0)
    return _squares(linear, own) - gain


def _inverted(H: FloatArray) -> FloatArray:
    if not H.size:
        return H
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    scaled = H / np.outer(size, size)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-13, hermitian=True)) / np.outer(size, size)
