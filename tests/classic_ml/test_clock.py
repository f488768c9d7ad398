"""A clock is uniform, or refused with the row at fault."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from classic_ml.columns.clock import CLOCK_TOLERANCE, NEAR_MEDIAN, uniform_period_s
from hypothesis import example, given, settings
from hypothesis import strategies as st

from classic_ml.columns import workspace
from surge_core.errors import InputError

CLOCK = np.arange(500) * 1e-3


def test_the_period_of_a_rounded_clock_is_its_mean_step() -> None:
    rate = 1234.5
    clock = np.round(5.0 + np.arange(2000) / rate, 4)
    assert uniform_period_s(clock, "x") == pytest.approx(1 / rate, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: np.delete(t, 100), "a step of 0.002 s after 0.099 s"),
        (lambda t: np.insert(t, 100, t[99]), "repeats at row 101"),
        (lambda t: np.concatenate((t[:100], t[50:])), "runs back at row 101"),
        (lambda t: np.where(np.arange(500) < 250, t, t + 0.6e-3), "a step of 0.0016 s"),
        (lambda t: t * (1 + 0.2 * t), "uniform step"),
        (lambda t: t + 0.2e-3 * (np.arange(500) % 2), "a uniform step"),
        (lambda t: t + 0.2e-3 * (np.arange(500) == 250), "a step of 0.0012 s after 0.249 s"),
    ],
)
def test_a_clock_that_is_not_uniform_is_refused(
    change: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    with pytest.raises(InputError, match=words) as refusal:
        uniform_period_s(change(CLOCK), "run.csv: column time_s")
    assert str(refusal.value).startswith("run.csv: column time_s: expected ")


@pytest.mark.parametrize("rate", [1234.5, 1400.0, 733.0])
@pytest.mark.parametrize("start_s", [0.0, 5.00003])
def test_a_clock_printed_to_a_tenth_of_a_millisecond_is_uniform(
    rate: float, start_s: float
) -> None:
    clock = np.round(start_s + np.arange(3000) / rate, 4)
    assert np.ptp(np.diff(clock)) > 0.9e-4
    assert uniform_period_s(clock, "x") == pytest.approx(1 / rate, rel=1e-4)


def is_uniform(clock: np.ndarray) -> bool:
    """Tell by the median step, as the rule is meant, with the whole clock at hand."""
    steps = np.diff(clock)
    period = np.median(steps)
    if np.any(steps <= 0.0):
        return False
    near = steps[np.abs(steps - period) < NEAR_MEDIAN * period]
    period = np.mean(near if near.size else steps)
    line = clock[0] + np.arange(clock.size) * (clock[-1] - clock[0]) / steps.size
    off = np.maximum(np.abs(steps - period), np.abs(clock - line)[1:])
    return bool(np.all(off <= CLOCK_TOLERANCE * period))


@given(
    seed=st.integers(0, 10**6),
    jitter=st.floats(0.0, 0.12),
    drift=st.floats(-0.002, 0.002),
    gaps=st.integers(0, 2),
    block=st.integers(1, 300),
)
@example(seed=212, jitter=0.0, drift=0.0, gaps=2, block=1)
@settings(max_examples=300, deadline=None)
def test_a_clock_is_judged_in_blocks_as_in_one_piece(
    seed: int, jitter: float, drift: float, gaps: int, block: int
) -> None:
    rng = np.random.default_rng(seed)
    row = np.arange(rng.integers(2, 250), dtype=float)
    clock = 1e-3 * (row + jitter * rng.uniform(-1.0, 1.0, row.size) + drift * row**2)
    for _ in range(gaps * (rng.random() < 0.3)):
        clock[rng.integers(1, row.size) :] += 1e-3 * rng.uniform(-1.5, 1.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace, "BLOCK_ROWS", block)
        try:
            period = uniform_period_s(clock, "x")
        except InputError as error:
            assert not is_uniform(clock)
            refused = str(error)
        else:
            assert is_uniform(clock)
            assert period == (clock[-1] - clock[0]) / (clock.size - 1)
            return
        patch.undo()
        with pytest.raises(InputError) as whole:
            uniform_period_s(clock, "x")
        assert str(whole.value) == refused


def test_a_clock_of_two_kinds_of_steps_in_turn_is_refused_in_words() -> None:
    clock = np.cumsum([0.0, 1.0, 3.0, 1.0, 3.0, 1.0, 3.0])
    with pytest.raises(InputError, match=r"a uniform step \(here 2 s\), found a step of 1 s"):
        uniform_period_s(clock, "x")
