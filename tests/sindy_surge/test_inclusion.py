from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from sindy_surge.candidate_terms import CandidateTerms, independent_columns
from sindy_surge.inclusion import inclusion_probabilities
from sindy_surge.lag_fit import WhiteEquations, fit_structure, white_equations
from sindy_surge.lag_problem import LagProblem
from sindy_surge.noise import NoiseLevels
from sindy_surge.segments import Segments, cycle_blocks
from sindy_surge.selection import information_penalty

from .conftest import PERIOD_S, TAU_S, TERMS

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


def _powers(n: int, seed: int) -> np.ndarray:
    """Powers and exponentials over a narrow range away from zero: condition 1e10."""
    x = 3.0 + 0.6 * np.random.default_rng(seed).random(n)
    columns = np.column_stack([x**k for k in range(5)] + [np.exp(-x), np.maximum(x - 3.3, 0)])
    assert 1e8 < np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) < 1e12
    return columns


def _best(
    equations: WhiteEquations, most: int, required: tuple[int, ...] = ()
) -> tuple[tuple[int, ...], float]:
    """Best structure by trying all of them, on all rows and without any compression."""

    def chi2(members: tuple[int, ...]) -> float:
        design = np.column_stack((equations.nuisances, equations.columns[:, list(members)]))
        design = design / np.linalg.norm(design, axis=0)
        solution = np.linalg.lstsq(design, equations.target, rcond=1e-14)[0]
        return float(np.sum((equations.target - design @ solution) ** 2))

    n, q = equations.columns.shape
    variance = max(chi2(tuple(range(q))) / (n - q - 1), 1.0)
    scores = {
        members: chi2(members) / variance + PENALTY * size
        for size in range(1, most + 1)
        for members in combinations(range(q), size)
        if set(required) <= set(members)
    }
    best = sorted(scores, key=lambda members: scores[members])
    return best[0], scores[best[1]] - scores[best[0]]


@pytest.mark.parametrize("curve", ["quadratic", "hinge"])
def test_true_terms_are_in_and_absent_ones_are_not(surge: Callable[..., Any], curve: str) -> None:
    for seed in range(2):
        record = surge(curve, 0.02, seed)
        inputs = record.phi[:, None]
        terms = CandidateTerms(None, inputs, ["phi"])
        usable = independent_columns(terms(inputs))
        noise = NoiseLevels(
            0.02 * record.clean_psi_p.std(), np.array([0.02 * record.clean_phi.std()]), np.empty(0)
        )
        whole = Segments.from_labels(None, inputs.size)
        problem = LagProblem(inputs, record.psi_p, whole, PERIOD_S, "first", terms, usable, noise)
        names = [terms.names[i] for i in usable]
        truth = tuple(sorted(names.index(name) for name in TERMS[curve]))
        equations = white_equations(problem, fit_structure(problem, truth, TAU_S))
        penalty = information_penalty(equations.target.size, usable.size)
        blocks = cycle_blocks(inputs[:, 0], whole, 36)
        found = _resampled(equations, blocks, penalty_per_term=penalty)
        assert found.shape == usable.shape
        assert found[list(truth)].min() >= 0.9
        assert np.delete(found, truth).max() <= 0.1


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


def test_bootstrap_agrees_with_refits_of_repeated_rows() -> None:
    columns, noise = _random(3, 600, 6)
    target = columns @ [0.0, 0.4, 0.18, 0.0, -0.5, 0.0] + noise
    equations = _equations(columns, target)
    blocks = _even_blocks(600, 12)
    rng = np.random.default_rng(5)
    counts = np.zeros(6)
    for _ in range(150):
        drawn = [np.arange(blocks[i].start, blocks[i].stop) for i in rng.integers(0, 12, 12)]
        rows = np.concatenate(drawn)
        again = _equations(columns[rows], target[rows], equations.nuisances[rows])
        counts[list(_best(again, 4)[0])] += 1
    found = _resampled(equations, blocks, n_resamples=600)
    honest = counts / 150
    assert 0.1 < honest[2] < 0.9
    scatter = np.sqrt(np.maximum(found * (1 - found), 0.002) * (1 / 150 + 1 / 600))
    assert np.all(np.abs(found - honest) < 4 * scatter)


@pytest.mark.parametrize("required", [(), (5,), (0, 6)])
def test_nearly_dependent_columns_lose_no_digits(required: tuple[int, ...]) -> None:
    decided = 0
    for seed in range(6):
        columns = _powers(400, seed)
        target = 1e4 * columns[:, [1, 6]] @ [1.0, -0.7]
        target += np.random.default_rng(seed + 100).standard_normal(400)
        # Twelve cycles that are all alike: whatever is drawn, the answer is the record's own.
        equations = _equations(np.tile(columns, (12, 1)), np.tile(target, 12))
        equations = replace(equations, nuisances=np.tile(equations.nuisances[:400], (12, 1)))
        best, margin = _best(equations, 5, required)
        if margin < 0.01:
            continue
        decided += 1
        found = _resampled(equations, _even_blocks(4800, 12), required=required, n_resamples=20)
        assert tuple(np.flatnonzero(found)) == best
        assert set(found.tolist()) <= {0.0, 1.0}
    assert decided >= 4


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
