from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from sindy_surge.noise import NoiseLevels, Whitener, colour_of, difference_noise, smoothed
from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("dead_samples", [0.0, 1.0, 0.4, -1.7])
@pytest.mark.parametrize("linear", [True, False])
def test_whitening_matches_the_dense_covariance(
    hold: str, dead_samples: float, linear: bool
) -> None:
    rng = np.random.default_rng(0)
    n, edge = 46, 3
    lag = FirstOrderLag(0.006, 1e-3, hold, dead_samples * 1e-3)  # type: ignore[arg-type]
    slopes = rng.standard_normal((1, n))
    noise = NoiseLevels(0.3, np.array([0.2]), np.empty(0))
    # Three runs of usable rows, away from the ends by more than the dead time reaches.
    rows = np.concatenate((np.arange(edge, 17), [20], np.arange(23, n - edge)))
    runs = Segments.from_labels(np.repeat([0, 1, 2], [17 - edge, 1, n - edge - 23]), rows.size)
    later = runs.later
    ahead = np.ones(later.size) if linear else rng.uniform(0.8, 1.2, later.size)
    behind = np.full(later.size, lag.a) if linear else rng.uniform(0.6, 0.9, later.size)
    # A e = A v - B D n, written out as matrices over one run after the other.
    a_matrix = np.zeros((later.size, n))
    b_matrix = np.zeros((later.size, n))
    for number, k in enumerate(later):
        a_matrix[number, rows[k]], a_matrix[number, rows[k] - 1] = ahead[number], -behind[number]
        for i, tap in enumerate(lag.taps[0]):
            source = rows[k] - lag.whole_samples - i
            b_matrix[number, source] += tap * slopes[0, source]
    covariance = 0.3**2 * a_matrix @ a_matrix.T + 0.2**2 * b_matrix @ b_matrix.T
    # The lone row between two runs has no equation; nothing links the runs.
    apart = np.abs(np.subtract.outer(rows[later], rows[later])) > 5
    covariance[apart] = 0.0
    whitener = Whitener(lag, slopes, noise, runs, rows, ahead, behind)
    white = whitener(np.eye(later.size))
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(later.size), atol=1e-10)
    assert whitener.log_determinant() == pytest.approx(np.linalg.slogdet(covariance)[1])
    vector = rng.standard_normal(later.size)
    np.testing.assert_allclose(
        whitener.precision(vector), np.linalg.solve(covariance, vector), rtol=1e-8
    )


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_fourth_differences_find_the_noise(surge: Callable[..., Any], noise: float) -> None:
    record = surge("quadratic", noise, 5)
    whole = Segments.from_labels(None, record.phi.size)
    for noisy, clean in ((record.phi, record.clean_phi), (record.psi_p, record.clean_psi_p)):
        found = difference_noise(noisy, whole)
        # Sampling error of the median: about 2/sqrt(n) = 3 %.
        assert found == pytest.approx(noise * clean.std(), rel=0.12)
        assert np.std(smoothed(noisy, found) - clean) < 0.7 * np.std(noisy - clean)


def test_autoregression_finds_order_and_coefficients() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal(6000)
    runs = Segments.from_labels(np.repeat(range(12), 500), 6000)
    assert colour_of(white, runs).size == 0
    coloured = lfilter([1.0], [1.0, -1.1, 0.5], white.reshape(12, 500)).ravel()
    found = colour_of(coloured, runs)
    assert found.size == 2
    # Standard error of either: sqrt((1 - 0.5^2)/6000) = 0.011.
    np.testing.assert_allclose(found, [1.1, -0.5], atol=0.045)


def test_coloured_rows_do_not_reach_across_segments() -> None:
    runs = Segments.from_labels(np.repeat([0, 1], [20, 30]), 50)
    lag = FirstOrderLag(0.006, 1e-3, "first")
    noise = NoiseLevels(1.0, np.zeros(1), np.array([0.5, 0.2]))
    whitener = Whitener(lag, np.ones((1, 50)), noise, runs, np.arange(50), 1.0, lag.a)
    column = np.zeros(48)
    column[:19] = 1.0
    assert whitener.groups.lengths.tolist() == [17, 27]
    assert np.all(whitener(column)[17:] == 0)


def test_a_doubt_without_measure_leaves_every_equation_some_weight() -> None:
    runs = Segments.from_labels(np.zeros(50, dtype=np.int64), 50)
    lag = FirstOrderLag(0.006, 1e-3, "first")
    noise = NoiseLevels(1.0, np.zeros(1), np.empty(0))
    doubt = np.zeros(49)
    doubt[20:25] = 1e200
    slopes, rows = np.ones((1, 50)), np.arange(50)
    whitener = Whitener(lag, slopes, noise, runs, rows, 1.0, lag.a, doubt)
    column = np.zeros(49)
    column[22] = 1.0
    assert 1e-5 < np.linalg.norm(whitener(column)) < 1e-3
