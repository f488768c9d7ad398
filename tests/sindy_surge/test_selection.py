from __future__ import annotations

from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from pysindy.optimizers import SSR, STLSQ
from scipy.stats import norm

from sindy_surge import InputError
from sindy_surge.lag_fit import WhiteEquations
from sindy_surge.linear_problem import LinearProblem
from sindy_surge.search import beam_search, proposed_supports
from sindy_surge.selection import inclusion_probabilities, information_penalty


def _problem(seed: int = 0, noise: float = 0.1) -> LinearProblem:
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((30, 9)) + rng.standard_normal((30, 1))
    columns /= np.linalg.norm(columns, axis=0)
    target = columns @ np.array([0, 3.0, 0, 0, -2.0, 0, 0, 1.5, 0])
    return LinearProblem(columns, target + noise * rng.standard_normal(30), np.ones(9), 2.0, 500)


def test_beam_search_equals_exhaustive_search() -> None:
    problem = _problem()
    ranked = beam_search(problem, 4)
    for size in (1, 2, 3, 4):
        exhaustive = {s: problem.chi2(s) for s in combinations(range(9), size)}
        best = min(exhaustive, key=lambda s: exhaustive[s])
        assert ranked[size][0][1] == best
        for chi2, support in ranked[size][:20]:
            assert chi2 == pytest.approx(exhaustive[support], rel=1e-9)


@pytest.mark.parametrize(
    "optimizer", ["SSR", "STLSQ", SSR(alpha=0.0, max_iter=9), STLSQ(threshold=0.7, alpha=0.0)]
)
def test_every_optimizer_meets_the_truth(optimizer: object) -> None:
    assert (1, 4, 7) in proposed_supports(_problem(), optimizer, 6)


@pytest.mark.parametrize("optimizer", ["LASSO", 3])
def test_unknown_optimizer_is_refused(optimizer: object) -> None:
    with pytest.raises(InputError, match="optimizer"):
        proposed_supports(_problem(), optimizer, 6)


def test_dependent_columns_do_not_break_the_search() -> None:
    problem = _problem()
    columns = np.column_stack((problem.columns, problem.columns[:, 1]))
    doubled = LinearProblem(columns, problem.target, np.ones(10), 2.0, 500)
    ranked = beam_search(doubled, 4)
    assert all(not {1, 9} <= set(support) for size in ranked for _, support in ranked[size])
    assert ranked[3][0][0] == pytest.approx(problem.chi2((1, 4, 7)))


PENALTY = 17.0
N_BLOCKS = 30


def _equations(
    columns: np.ndarray, target: np.ndarray, nuisances: np.ndarray | None = None
) -> WhiteEquations:
    n = target.size
    if nuisances is None:
        nuisances = np.sin(np.arange(n) / 7.0)[:, None]
    rows = np.arange(n)
    return WhiteEquations(nuisances, columns, target, rows)


def _even_blocks(n: int, n_blocks: int = N_BLOCKS) -> list[slice]:
    edges = np.linspace(0, n, n_blocks + 1).astype(int)
    return [slice(a, b) for a, b in pairwise(edges.tolist())]


def _resampled(equations: WhiteEquations, blocks: list[slice], **changes: Any) -> np.ndarray:
    settings: dict[str, Any] = {
        "penalty_per_term": PENALTY,
        "n_resamples": 100,
        "rng": np.random.default_rng(11),
    }
    return inclusion_probabilities(equations, blocks, 5, **{**settings, **changes})


def _random(seed: int, n: int = 1500, q: int = 8) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((n, q)) + 0.5 * rng.standard_normal((n, 1))
    return columns, rng.standard_normal(n)


def test_probability_at_the_detection_limit_is_that_of_the_normal_law() -> None:
    # A term whose estimate lies z standard errors from zero is drawn with z + N(0, 1) and is
    # taken above the square root of the penalty.
    limit = np.sqrt(PENALTY)
    expected, found = [], []
    for seed in range(24):
        columns, noise = _random(seed, q=5)
        nuisances = np.ones((noise.size, 1))
        design = np.column_stack((nuisances, columns))
        error = np.sqrt(np.linalg.inv(design.T @ design)[2, 2])
        wanted = limit + np.linspace(-2, 2, 24)[seed]
        target = columns[:, [0, 3]] @ [3.0, -2.0] + noise
        own = np.linalg.lstsq(design, target)[0][2]
        target += columns[:, 1] * (wanted * error - own)
        found.append(
            _resampled(
                _equations(columns, target, nuisances), _even_blocks(noise.size), n_resamples=200
            )[1]
        )
        expected.append(norm.cdf(wanted - limit))
    # Thirty blocks know the variance of the score to a quarter, hence single cases within 0.25.
    assert np.max(np.abs(np.subtract(found, expected))) < 0.25
    assert abs(np.mean(found) - np.mean(expected)) < 0.05
    assert found[0] < 0.15
    assert found[-1] > 0.85


def test_many_hinges_do_not_hide_a_cubic() -> None:
    # A search that adds term by term starts with hinges here and never meets the cubic.
    rng = np.random.default_rng(2)
    phi = 0.235 + 0.27 * np.sin(np.arange(3000) / 25.0) + 0.01 * rng.standard_normal(3000)
    hinges = [np.maximum(phi - knot, 0) for knot in np.arange(0, 0.46, 0.025)]
    columns = np.column_stack([phi**k for k in range(6)] + hinges)
    target = 1000 * columns[:, :4] @ [0.30, 0.5, 3.0, -7.0] + rng.standard_normal(3000)
    equations = _equations(columns, target)
    found = _resampled(
        equations, _even_blocks(3000), penalty_per_term=information_penalty(3000, 25)
    )
    assert found[:4].min() > 0.9
    assert found[4:].max() < 0.1


def test_required_terms_are_in_every_structure() -> None:
    columns, noise = _random(8)
    equations = _equations(columns, 2 * columns[:, 0] + noise)
    found = _resampled(equations, _even_blocks(noise.size), required=(3, 6))
    assert found[[0, 3, 6]].tolist() == [1.0, 1.0, 1.0]
