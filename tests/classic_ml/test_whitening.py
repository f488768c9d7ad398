"""Innovations of an autoregression, and correlations that know of segments."""

from __future__ import annotations

import numpy as np
import pytest

from classic_ml.checks import bartlett_widening, lagged_correlation
from surge_core.autoregression import autoregression


def coloured(n: int, a: float, rng: np.random.Generator) -> np.ndarray:
    out = np.zeros(n)
    noise = rng.standard_normal(n)
    for k in range(1, n):
        out[k] = a * out[k - 1] + noise[k]
    return out


def test_innovations_of_an_autoregression_are_white_and_of_its_noise() -> None:
    rng = np.random.default_rng(0)
    signal = np.concatenate([coloured(200, 0.95, rng) for _ in range(30)])
    white = np.concatenate(autoregression(np.split(signal, 30), 27)[1])
    assert np.std(white) == pytest.approx(1.0, abs=0.03)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 3.0 / np.sqrt(white.size)
    assert white.size >= 5900


def test_white_noise_is_left_as_it_is_and_too_short_pieces_give_nothing_to_find() -> None:
    noise = np.random.default_rng(1).standard_normal(1000)
    np.testing.assert_array_equal(autoregression([noise], 27)[1][0], noise)
    for pieces in (np.split(noise[:999], 333), [np.zeros(50)], []):
        coefficients, left = autoregression(pieces, 0)
        assert coefficients.size == 0
        np.testing.assert_array_equal(left, pieces)


def test_no_product_straddles_two_segments_and_the_sign_of_the_lag_is_the_first_signals() -> None:
    spike = np.zeros(200)
    spike[99] = spike[100] = 1.0
    whole = lagged_correlation(spike, spike, [slice(0, 200)], 3)
    apart = lagged_correlation(spike, spike, [slice(0, 100), slice(100, 200)], 3)
    assert whole[4] == pytest.approx(0.5)
    assert apart[4] == 0.0
    late = np.roll(spike, 2)
    assert np.argmax(lagged_correlation(late, spike, [slice(0, 200)], 3)) == 5


def test_bartletts_widening_is_the_true_one_for_two_autoregressions() -> None:
    rng = np.random.default_rng(2)
    one, two = coloured(200_000, 0.8, rng), coloured(200_000, 0.9, rng)
    # 1 + 2 Σ (0.8 · 0.9)^k over k ≥ 1.
    wanted = np.sqrt((1 + 0.72) / (1 - 0.72))
    assert bartlett_widening(one, two, [slice(0, 200_000)], 60) == pytest.approx(wanted, rel=0.05)
