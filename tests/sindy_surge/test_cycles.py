from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from sindy_surge.segments import Segments, cycle_blocks, surge_period_s

from .conftest import PERIOD_S

SHORTEST = 40
# One period of a relaxation wave: a slow fall, a drop into reversed flow, a slow rise, a jump.
_CORNERS = ([0.0, 0.4, 0.45, 0.95, 1.0], [0.51, 0.37, -0.04, 0.10, 0.51])

SHAPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "relaxation": lambda cycles: np.interp(cycles % 1, *_CORNERS),
    "sine": lambda cycles: 0.2 + 0.25 * np.sin(2 * np.pi * cycles),
    "brief reversal": lambda cycles: np.where(cycles % 1 < 0.15, -0.05, 0.4),
}


def _whole(n: int) -> Segments:
    return Segments.from_labels(None, n)


def _wave(shape: str, period: float, n: int, seed: int = 0, noise: float = 0.0) -> np.ndarray:
    """Waves of a known period in samples, with white noise and rotating stall of 62 Hz."""
    rng = np.random.default_rng(seed)
    rows = np.arange(n)
    phi = SHAPES[shape](rows / period + rng.uniform())
    ripple = noise * phi.std() * np.sqrt(2) * np.sin(2 * np.pi * 62 * PERIOD_S * rows)
    return phi + noise * phi.std() * rng.standard_normal(n) + ripple


def _rows(blocks: list[slice]) -> np.ndarray:
    return np.concatenate([np.arange(block.start, block.stop) for block in blocks])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
def test_period_is_that_of_the_wave(shape: str, noise: float) -> None:
    for seed in range(4):
        phi = _wave(shape, 163.7, 4000, seed, noise)
        found = surge_period_s(phi, _whole(4000), PERIOD_S)
        assert found == pytest.approx(0.1637, rel=0.02)


def test_in_stall_segments_hold_no_cycle(surge: Callable[..., Any]) -> None:
    # With 20 % noise a few segments flutter about the band.
    for seed, noise in product(range(6), (0.1, 0.2)):
        record = surge("quadratic", noise, seed)
        phi, inside = record.phi, record.clean_phi < 0.27
        labels = np.cumsum(np.diff(inside, prepend=False))[inside]
        segments = Segments.from_labels(labels, labels.size)
        assert segments.starts.size > 10
        assert surge_period_s(phi[inside], segments, PERIOD_S) is None
        blocks = cycle_blocks(phi[inside], segments, SHORTEST)
        assert [b.start for b in blocks] == segments.starts.tolist()


def test_random_excitation_is_no_surge() -> None:
    found = []
    for seed in range(60):
        white = np.random.default_rng(seed).standard_normal(4000)
        steps = np.repeat(np.sign(white[:200]), 20)
        for phi in (white, lfilter([1.0], [1.0, -0.9], white), steps):
            found.append(surge_period_s(phi, _whole(4000), PERIOD_S))
    assert np.mean([period is None for period in found]) > 0.97


def test_blocks_are_whole_cycles() -> None:
    for shape in SHAPES:
        phi = _wave(shape, 160, 4000, 2, 0.05)
        blocks = cycle_blocks(phi, _whole(4000), SHORTEST)
        inner = np.array([b.stop - b.start for b in blocks[1:-1]])
        assert inner.size >= 22
        # Noise moves a crossing of the sine, whose slope is least, by a few samples.
        assert np.all(np.abs(inner - 160) <= 16)
        assert abs(inner.mean() - 160) < 2


@pytest.mark.parametrize("lengths", [[4000], [3000, 90, 1200, 20, 700], [90] * 30, [2000, 1]])
@pytest.mark.parametrize("shortest", [1, 40, 300])
def test_blocks_cover_every_row_once_and_cross_no_border(lengths: list[int], shortest: int) -> None:
    n = sum(lengths)
    segments = Segments.from_labels(np.repeat(np.arange(len(lengths)), lengths), n)
    for phi in (_wave("relaxation", 150, n, 3, 0.05), np.random.default_rng(0).random(n)):
        blocks = cycle_blocks(phi, segments, shortest)
        np.testing.assert_array_equal(_rows(blocks), np.arange(n))
        assert set(segments.starts.tolist()) <= {b.start for b in blocks}
        parts = [b for b in blocks if b.start not in segments.starts]
        assert all(b.stop - b.start >= shortest for b in parts)
