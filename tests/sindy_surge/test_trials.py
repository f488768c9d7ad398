"""Structures tried on blocks left out: exact errors, what cannot be foretold, ladders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from sindy_surge.held_out import (
    Trials,
    best_of_each_size,
    climb,
    polynomial_ladder,
    special_structures,
)
from sindy_surge.linear_problem import LinearProblem, without_nuisances

N, N_BLOCKS = 400, 20
BLOCKS = [(rows, rows) for rows in np.split(np.arange(N), N_BLOCKS)]


@dataclass(frozen=True)
class Regression:
    """A plain regression; its last parameter stands where τ does."""

    columns: np.ndarray
    last: np.ndarray
    target: np.ndarray

    def design(self, support: tuple[int, ...]) -> np.ndarray:
        return np.column_stack((self.columns[:, list(support)], self.last))

    def fit(self, support: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        design = self.design(support)
        found = np.linalg.lstsq(design, self.target)[0]
        return found, design, self.target - design @ found

    @property
    def linear(self) -> LinearProblem:
        return without_nuisances(self.last[:, None], self.columns, self.target)


def regression(seed: int, beta: tuple[float, ...], noise: float = 0.1) -> Regression:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, N)
    columns = np.column_stack((*(x**k for k in range(len(beta))), np.abs(x)))
    last = rng.standard_normal(N)
    target = columns[:, : len(beta)] @ beta + last + noise * rng.standard_normal(N)
    return Regression(columns, last, target)


def test_errors_are_those_of_fits_without_the_block() -> None:
    data = regression(0, (1.0, 2.0, 0.5))
    errors = Trials(data, BLOCKS).error((0, 1, 2))
    design = data.design((0, 1, 2))
    for (block, _), error in zip(BLOCKS, errors, strict=True):
        rest = np.setdiff1d(np.arange(N), block)
        found = np.linalg.lstsq(design[rest], data.target[rest])[0]
        left = data.target[block] - design[block] @ found
        assert error == pytest.approx(np.mean(left**2), rel=1e-8)


def test_a_block_that_alone_determines_a_parameter_is_not_scored() -> None:
    data = regression(1, (1.0, 2.0, 0.5))
    alone = data.columns.copy()
    alone[:, 3] = 0.0
    alone[BLOCKS[7][1], 3] = np.linspace(-1, 1, 20)
    data = Regression(alone, data.last, data.target)
    trials = Trials(data, BLOCKS, most_leverage=0.5)
    assert np.flatnonzero(np.isnan(trials.error((0, 1, 3)))).tolist() == [7]
    assert np.all(np.isfinite(trials.error((0, 1, 2))))
    assert [e.size for e in trials.pair((0, 1, 3), (0, 1, 2))] == [19, 19]
    assert np.isfinite(trials.mean((0, 1, 3)))
    # Where it is scored, such a column is neither here nor there.
    one, other = trials.pair((0, 1, 2, 3), (0, 1, 2))
    np.testing.assert_allclose(one, other, rtol=0.2)
    assert np.all(np.isfinite(Trials(data, BLOCKS).error((0, 1, 3))))


def test_the_ladder_is_climbed_to_the_truth_and_past_a_rung_that_does_not_pay() -> None:
    degrees = (0, 1, 2, 3, None)
    ladder = polynomial_ladder(degrees, 6)
    assert ladder == [(0, 1), (0, 1, 2), (0, 1, 2, 3)]
    found = [climb(Trials(regression(s, (1, 2, 3, 0)), BLOCKS), ladder) for s in range(20)]
    # By one standard error a needless rung is taken in less than one case of six.
    assert found.count((0, 1, 2)) >= 14
    assert (0, 1) not in found
    odd = [climb(Trials(regression(s, (1, 2, 0, 3)), BLOCKS), ladder) for s in range(10)]
    assert odd == [(0, 1, 2, 3)] * 10


def test_a_ladder_needs_a_straight_line_and_has_no_rung_above_a_cubic() -> None:
    assert polynomial_ladder((0, None, 2), 6) == []
    assert polynomial_ladder((0, 1, 2, 3, 4, 5), 6)[-1] == (0, 1, 2, 3)
    assert polynomial_ladder((0, 1, 2, 3), 3)[-1] == (0, 1, 2)


def test_a_structure_off_the_ladder_has_to_leave_little() -> None:
    ladder = polynomial_ladder((0, 1, 2, 3, None), 6)
    rng = np.random.default_rng(3)
    for kinked, share in ((True, 0.5), (False, 0.9)):
        data = regression(4, (1.0, 0.5, 0.0 if kinked else 2.0, 0.0), 0.0)
        if kinked:
            data = Regression(data.columns, data.last, data.target + 2.0 * data.columns[:, 4])
        noisy = data.target + 0.05 * rng.standard_normal(N)
        trials = Trials(Regression(data.columns, data.last, noisy), BLOCKS)
        rung = climb(trials, ladder)
        linear = Regression(data.columns, data.last, noisy).linear
        proposed = [(0, 4), (0, 1, 4), (1, 2, 4), (0, 1, 2, 4), (0, 1, 2, 3, 4)]
        special = special_structures(trials, linear, proposed, rung, ladder, share)
        assert ((0, 1, 4) in special) is kinked
        # None larger than the ladder's top, and the shares are what they are called.
        assert all(len(s) <= 4 for s in special)
        for support, left in special.items():
            assert left == pytest.approx(trials.mean(support) / trials.mean(rung))
        best = best_of_each_size(linear, proposed)
        assert best == [(0, 4), (0, 1, 4), (0, 1, 2, 4), (0, 1, 2, 3, 4)]
