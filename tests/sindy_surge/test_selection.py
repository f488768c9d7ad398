from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from pysindy.optimizers import SSR, STLSQ

from sindy_surge import InputError
from sindy_surge.linear_problem import LinearProblem
from sindy_surge.sparse_paths import beam_search, proposed_supports


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
    "optimizer",
    [
        "SSR",
        "STLSQ",
        SSR(alpha=0.0, max_iter=9),
        STLSQ(threshold=0.7, alpha=0.0),
    ],
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
