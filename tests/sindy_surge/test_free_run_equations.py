"""Free runs over ready-made columns: exact recovery, what is scored, derivatives, projections."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from sindy_surge.free_run import FreeRunEquations
from sindy_surge.segments import Segments

from .conftest import PERIOD_S, TAU_S, lag

N = 1500
BETA = np.array([1.2, 3.0, 40.0])
GAMMA = np.array([4.0, -2.0])
STARTS = (0.4, 3.0)


def equations(seed: int, noise: float, hold: str = "first") -> FreeRunEquations:
    """Two runs of cycles; a second branch with coefficients of its own, and rows not scored."""
    rng = np.random.default_rng(seed)
    columns, nuisance, output = [], [], []
    for start in STARTS:
        angle = np.cumsum(2 * np.pi * rng.uniform(6, 8, N) * PERIOD_S) + rng.uniform(0, 6)
        phi = 0.12 + 0.13 * np.sin(angle) + 0.03 * np.sin(2 * angle)
        stalled = (phi < 0.2).astype(float)
        columns.append(stalled[:, None] * phi[:, None] ** np.arange(5))
        nuisance.append(np.column_stack((1 - stalled, (1 - stalled) * (phi - 0.25))))
        forcing = columns[-1][:, :3] @ BETA + nuisance[-1] @ GAMMA
        output.append(lag(forcing, PERIOD_S, hold, start))
    stacked = np.concatenate(columns)
    weight = ((stacked[:, 0] > 0) & (stacked[:, 1] > 0.02)).astype(float)
    weight[rng.choice(2 * N, 50, replace=False)] = 0.0
    measured = np.concatenate(output) + noise * rng.standard_normal(2 * N)
    # What is not scored must not matter.
    measured[weight == 0] += 100.0
    runs = Segments(np.array([0, N]), np.array([N, 2 * N]))
    return FreeRunEquations(
        stacked, np.concatenate(nuisance), measured, weight, runs, PERIOD_S, hold
    )


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_an_exact_record_is_recovered_through_rows_that_are_not_scored(hold: str) -> None:
    fit = equations(0, 0.0, hold).solve((0, 1, 2))
    np.testing.assert_allclose(fit.parameters, [*BETA, TAU_S], rtol=1e-7)
    np.testing.assert_allclose(fit.nuisance, GAMMA, rtol=1e-6)
    assert np.max(np.abs(fit.residual)) < 1e-8


def test_it_is_the_least_squares_solution_over_everything_at_once() -> None:
    eq = equations(1, 0.05)
    fit = eq.solve((0, 1, 2))
    values = np.column_stack((eq.columns[:, :3], eq.nuisance))

    def errors(theta: np.ndarray) -> np.ndarray:
        pole = np.exp(-PERIOD_S / theta[7])
        ratio = (1 - pole) * theta[7] / PERIOD_S
        states = []
        for rows, start in zip(eq.runs.slices(), theta[5:7], strict=True):
            x = [start]
            f = values[rows] @ theta[:5]
            for before, now in pairwise(f):
                x.append(pole * x[-1] + (1 - ratio) * now + (ratio - pole) * before)
            states += x
        return (eq.output - np.array(states))[eq.scored]

    own = np.concatenate((fit.parameters[:3], fit.nuisance, STARTS, fit.parameters[3:]))
    found = least_squares(
        errors, 1.001 * own, "3-point", x_scale=np.abs(own), xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    assert fit.residual @ fit.residual <= 2.0 * found.cost * (1 + 1e-12)
    alike = np.r_[0:5, 7]
    np.testing.assert_allclose(own[alike], found.x[alike], rtol=1e-5)


def test_a_run_without_a_scored_row_adds_nothing() -> None:
    eq = equations(6, 0.05)
    silent = replace(eq, weight=np.where(np.arange(2 * N) < N, eq.weight, 0.0))
    first = FreeRunEquations(
        eq.columns[:N],
        eq.nuisance[:N],
        eq.output[:N],
        eq.weight[:N],
        Segments(np.array([0]), np.array([N])),
        PERIOD_S,
        "first",
    )
    np.testing.assert_allclose(
        silent.solve((0, 1, 2)).parameters, first.solve((0, 1, 2)).parameters, rtol=1e-7
    )
