"""A clock is uniform, or refused with the row at fault."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from classic_ml.clock import uniform_period_s
from surge_core.errors import InputError

CLOCK = np.arange(500) * 1e-3


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
