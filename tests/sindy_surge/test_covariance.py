from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from sindy_surge.leave_out import leave_out_moves
from sindy_surge.segments import Segments, block_slices
from surge_core.leave_out import scatter

TRUE = np.array([1.0, -2.0, 0.5])


def _segments(n: int, length: int) -> Segments:
    return Segments.from_labels(np.repeat(np.arange(n), length), n * length)


def _regression(seed: int, n: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Slow regressors and errors that hang together over 50 rows, afresh in every segment."""
    rng = np.random.default_rng(seed)
    slow = lfilter([1.0], [1.0, -0.97], rng.standard_normal((n, 2, length)), axis=2)
    columns = np.column_stack((np.ones(n * length), *slow.swapaxes(0, 1).reshape(2, -1)))
    errors = lfilter([1.0], [1.0, -0.98], rng.standard_normal((n, length)), axis=1)
    return columns, columns @ TRUE + errors.ravel()


def test_moves_are_those_of_refits() -> None:
    columns, target = _regression(0, 6, 40)
    whole = np.linalg.lstsq(columns, target)[0]
    rows = [np.arange(40 * g, 40 * g + 40) for g in range(6)]
    moves = leave_out_moves(columns, target - columns @ whole, rows)
    for move, left_out in zip(moves, rows, strict=True):
        kept = np.setdiff1d(np.arange(240), left_out)
        again = np.linalg.lstsq(columns[kept], target[kept])[0]
        np.testing.assert_allclose(whole + move, again, rtol=1e-9)


def test_jackknife_errors_are_honest_on_a_dozen_segments() -> None:
    scores, naive = [], []
    segments = _segments(12, 120)
    blocks = [np.arange(b.start, b.stop) for b in block_slices(segments, 30)]
    assert len(blocks) == 12
    for seed in range(40):
        columns, target = _regression(seed, 12, 120)
        found = np.linalg.lstsq(columns, target)[0]
        residual = target - columns @ found
        covariance = scatter(leave_out_moves(columns, residual, blocks))
        scores.append((found - TRUE) / np.sqrt(np.diag(covariance)))
        white = np.linalg.inv(columns.T @ columns) * np.mean(residual**2)
        naive.append((found - TRUE) / np.sqrt(np.diag(white)))
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.35
    assert np.sqrt(np.mean(np.square(naive))) > 3


def test_a_block_that_alone_determines_a_parameter_does_not_break_it() -> None:
    columns = np.column_stack((np.ones(40), np.r_[np.zeros(30), np.ones(10)]))
    blocks = [np.arange(k, k + 10) for k in range(0, 40, 10)]
    residual = np.random.default_rng(0).standard_normal(40)
    assert np.all(np.isfinite(leave_out_moves(columns, residual, blocks)))
