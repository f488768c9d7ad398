"""Standard errors that hold: colour, segments, and the white limit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from lag_data import BETA, PERIOD_S, TAU_S, coloured, flow, lagged

from classic_ml import LagRegressor
from surge_core.leave_out import block_edges, correlation_length, leave_out, scatter


def jackknife(jacobian: np.ndarray, errors: np.ndarray, n_blocks: int) -> np.ndarray:
    edges = np.linspace(0, errors.size, n_blocks + 1).astype(int)
    blocks = [slice(low, high) for low, high in pairwise(edges)]
    return scatter(leave_out(jacobian, errors, blocks).moves)


def test_it_is_the_jackknife_of_a_linear_fit() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((60, 2))
    y = columns @ [1.0, -2.0] + rng.standard_normal(60)
    beta = np.linalg.lstsq(columns, y)[0]
    covariance = jackknife(-columns, y - columns @ beta, 6)
    left_out = []
    for block in range(6):
        keep = np.arange(60) // 10 != block
        left_out.append(np.linalg.lstsq(columns[keep], y[keep])[0])
    spread = np.array(left_out) - np.mean(left_out, axis=0)
    np.testing.assert_allclose(covariance, 5.0 / 6.0 * spread.T @ spread, rtol=1e-9)


def test_a_direction_of_one_block_alone_does_not_move_without_it() -> None:
    rng = np.random.default_rng(3)
    jacobian = np.column_stack([rng.standard_normal(40), np.repeat([1.0, 0.0, 0.0, 0.0], 10)])
    errors = rng.standard_normal(40)
    errors -= jacobian @ np.linalg.lstsq(jacobian, errors)[0]
    moves = leave_out(jacobian, errors, [slice(10 * k, 10 * k + 10) for k in range(4)]).moves
    assert moves[0, 1] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.abs(moves) < 10.0)


def test_correlation_is_that_of_the_definition_however_long_the_stretches() -> None:
    rng = np.random.default_rng(6)
    lengths = [9000, 40, 7000]
    slow = np.zeros(sum(lengths))
    for k in range(1, slow.size):
        slow[k] = 0.98 * slow[k - 1] + rng.standard_normal()
    acf = np.zeros(3000)
    for piece in np.split(slow, np.cumsum(lengths)[:-1]):
        for lag in range(min(3000, piece.size)):
            acf[lag] += piece[lag:] @ piece[: piece.size - lag]
    limit = 2.0 * np.sqrt(np.log10(slow.size) / slow.size)
    quiet = np.abs(acf / acf[0])[1:] < limit
    first = next(k for k in range(quiet.size) if np.all(quiet[k : k + 5]))
    assert correlation_length(slow, lengths) == 2 * first


def test_blocks_are_stretches_or_pieces_of_long_ones() -> None:
    assert [e.tolist() for e in block_edges([100] * 30, 5)] == [[]] * 30
    # Twenty times the shortest block is twenty blocks, also where the quotient is rounded.
    assert all(block_edges([n], 1)[0].size + 1 == 20 for n in range(1900, 2100))
    assert [e.size + 1 for e in block_edges([2000], 400)] == [5]
    assert sum(e.size + 1 for e in block_edges([150, 150], 1000)) >= 4


@pytest.mark.parametrize("noise", ["armax", "output-error"])
def test_stated_errors_hold_on_short_segments(noise: str) -> None:
    z = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        X, y, labels = [], [], []
        for label in range(12):
            phi = flow(200, rng)[100:]
            X.append(phi)
            y.append(lagged(phi, "zero") + coloured(400, 0.0, 0.002, rng)[300:])
            labels.append(np.full(100, label))
        m = LagRegressor(PERIOD_S, noise=noise)
        m.fit(np.concatenate(X)[:, None], np.concatenate(y), np.concatenate(labels))
        stderr = [m.time_constant_stderr_s_, *np.sqrt(np.diag(m.covariance_))]
        z.append((np.array([m.time_constant_s_, *m.coef_]) - [TAU_S, *BETA]) / stderr)
    # A root mean square of 40 z-scores scatters by 1/sqrt(80) = 11 % about one.
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < 1.45)
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) > 0.6)
