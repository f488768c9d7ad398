"""The search shared by all models, on a likelihood that is a plain regression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from pysindy import STLSQ

from sindy_surge.linear_problem import LinearProblem, Support, without_nuisances
from sindy_surge.search import Search, best_of_equation, chosen_support

N_TERMS, PRICE = 8, 15.0
EQUATIONS = (tuple(range(N_TERMS)), tuple(range(N_TERMS, 2 * N_TERMS)))
TRUTH = (1, 4, 10)


@dataclass(frozen=True)
class Regression:
    """Two equations with correlated terms; a fit is its coefficients."""

    columns: np.ndarray
    target: np.ndarray

    def try_terms(self, support: Support, near: np.ndarray) -> tuple[np.ndarray, float]:
        own = self.columns[:, list(support)]
        beta = np.linalg.lstsq(own, self.target)[0]
        return beta, float(np.sum((self.target - own @ beta) ** 2))

    def regression(self, fit: np.ndarray) -> LinearProblem:
        return without_nuisances(np.zeros((self.target.size, 0)), self.columns, self.target)


@pytest.fixture
def problem() -> Regression:
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((400, 2 * N_TERMS)) + 2.0 * rng.standard_normal((400, 1))
    target = columns[:, list(TRUTH)] @ [1.0, -0.8, 0.6] + rng.standard_normal(400)
    return Regression(columns, target)


@pytest.mark.parametrize("start", [(), (0,), (0, 2, 3, 5, 9, 11), tuple(range(16))])
def test_climb_ends_at_the_truth_from_anywhere(problem: Regression, start: Support) -> None:
    search = Search(problem, EQUATIONS, PRICE)
    best = search.climb(search.try_support(start, np.zeros(0), "start"))
    assert best.support == TRUTH
    assert all(other.score >= best.score for other in search.tried.values())
    # One needless term costs its price but for a χ² of one degree of freedom.
    assert all(PRICE / 3 < rival.score - best.score < 20.0 for rival in search.rivals(best, 20.0))
    inclusion = search.inclusion(2 * N_TERMS)
    assert inclusion[list(TRUTH)].min() > 0.99
    assert np.delete(inclusion, TRUTH).max() < 0.2


def test_scores_of_one_equation_are_those_of_whole_supports(problem: Regression) -> None:
    linear = problem.regression(np.zeros(0))
    ranked = best_of_equation(linear, EQUATIONS[0], (10, 12), PRICE)
    assert ranked[0][1] == (10, 12)
    for score, support in ranked:
        assert {10, 12} <= set(support)
        chi2 = problem.try_terms(support, np.zeros(0))[1]
        assert score == pytest.approx(chi2 / linear.variance + PRICE * len(support))
    assert min(ranked)[1] == (1, 4, 10, 12)


def test_beside_gives_coefficients_in_the_units_of_the_whole(problem: Regression) -> None:
    rest = problem.regression(np.zeros(0)).beside((1, 10), (4, 5))
    whole = problem.try_terms((1, 4, 5, 10), np.zeros(0))[0]
    np.testing.assert_allclose(rest.coefficients((0, 1)), whole[[1, 2]])


def test_an_optimizer_sees_physical_units(problem: Regression) -> None:
    linear = problem.regression(np.zeros(0))
    assert chosen_support(linear, STLSQ(threshold=0.4, alpha=0.0)) == TRUTH
    assert chosen_support(linear, STLSQ(threshold=5.0)) == ()
