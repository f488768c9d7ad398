"""Diebold and Mariano's test: its level where nothing differs, its power where something does."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from surge_core.paired import diebold_mariano

RECORDS, LEVEL = 400, 0.05
# Three standard deviations of a share of so many records.
BINOMIAL = 3.0 * np.sqrt(LEVEL * (1.0 - LEVEL) / RECORDS)


def coloured(rng: np.random.Generator, n: int, pole: float) -> np.ndarray:
    """Return errors of variance 1 that hang together over 1/(1 - pole) rows."""
    noise = rng.standard_normal(n + 400)
    return lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], noise)[400:]


def cycles(rng: np.random.Generator, shape: np.ndarray, n: int) -> np.ndarray:
    """Return errors that repeat in every cycle, some cycles larger than others, and noise."""
    size = 1.0 + 0.15 * rng.standard_normal(n)
    return (size[:, None] * shape).ravel() + 0.4 * coloured(rng, n * shape.size, 0.9)


def rejected(one: list[np.ndarray], other: list[np.ndarray], n_segments: int = 1) -> float:
    edges = np.linspace(0, one[0].size, n_segments + 1).astype(int)
    runs = [slice(low, high) for low, high in pairwise(edges)]
    found = [diebold_mariano(a**2 - b**2, runs) for a, b in zip(one, other, strict=True)]
    return float(np.mean(np.array(found) < LEVEL))


@pytest.mark.parametrize(("pole", "n"), [(0.0, 300), (0.9, 2500), (0.97, 2000)])
def test_five_percent_of_alike_predictions_are_called_different(pole: float, n: int) -> None:
    rng = np.random.default_rng(8)
    one, other = ([coloured(rng, n, pole) for _ in range(RECORDS)] for _ in range(2))
    assert abs(rejected(one, other) - LEVEL) < BINOMIAL


def test_errors_that_repeat_in_every_cycle_are_called_different_as_rarely() -> None:
    rng, wave = np.random.default_rng(9), 2.0 * np.pi * np.arange(120) / 120
    one, other = ([cycles(rng, np.sin(k * wave), 20) for _ in range(RECORDS)] for k in (1, 2))
    assert abs(rejected(one, other, 20) - LEVEL) < BINOMIAL


def test_a_known_difference_is_found() -> None:
    rng = np.random.default_rng(10)
    one = [coloured(rng, 2500, 0.9) for _ in range(100)]
    far = [1.15 * coloured(rng, 2500, 0.9) for _ in range(100)]
    near = [1.15 * e + 0.02 * rng.standard_normal(e.size) for e in one]
    # e² hangs together as 0.81^k, so that 2500 rows are 262 independent ones: a difference of
    # 0.32 lies 2.2 standard errors from zero, which with the six degrees of freedom of twelve
    # blocks 4 in 10 records show.
    assert 0.25 < rejected(far, one) < 0.65
    # What makes a row hard is hard for both.
    assert rejected(near, one) == 1.0
    assert np.isnan(diebold_mariano(np.zeros(100), [slice(0, 100)]))
