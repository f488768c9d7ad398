"""A series refuses everything that an estimator could not use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from classic_ml import CoefficientSeries
from classic_ml.series import jittering_period_s, uniform_period_s
from surge_core.errors import InputError

N = 300


def columns(n: int = N) -> dict[str, Any]:
    time_s = 2.0 + np.arange(n) / 1000.0
    phi = 0.1 + 0.08 * np.sin(40 * time_s)
    return {
        "time_s": time_s,
        "phi": phi,
        "psi_p": 1.2 + 3 * phi,
        "segment": np.where(np.arange(n) % 100 < 70, 1 + np.arange(n) // 100, 0),
        "psi": 3.0 - phi,
        "T25_K": np.full(n, 440.0),
        "Nc_frac": np.full(n, 0.75),
        "in_stall": np.arange(n) % 100 < 80,
    }


def put(name: str, row: int, value: float) -> Callable[[dict[str, Any]], None]:
    def change(known: dict[str, Any]) -> None:
        known[name] = known[name].astype(float)
        known[name][row] = value

    return change


def test_a_sound_series_knows_its_clock_and_segments() -> None:
    series = CoefficientSeries(**columns())
    assert series.n_samples == N
    assert series.sample_period_s == pytest.approx(1e-3, rel=1e-9)
    assert series.n_segments == 3
    assert series.scored.sum() == 210
    assert series.segment.dtype == np.int64
    assert series.in_stall is not None
    assert series.in_stall.dtype == np.bool_
    names = "time_s phi psi_p psi T25_K Nc_frac in_stall segment"
    assert list(series.columns()) == names.split()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("phi", 4, np.nan), "column phi: expected a finite number .* nan in row 5"),
        (put("psi_p", 9, np.inf), "column psi_p: .* inf in row 10"),
        (put("time_s", 50, 2.0495), "column time_s: expected a uniform step"),
        (put("phi", 7, 3.5), "column phi: expected values between -3 and 3, found 3.5 in row 8"),
        (put("psi_p", 7, -101.0), "column psi_p: expected values between -100 and 100"),
        (put("psi", 7, 2000.0), "column psi: expected values between -1000 and 1000"),
        (put("T25_K", 7, 20.0), "column T25_K: expected values between 50 and 3000 K"),
        (put("Nc_frac", 7, 75.0), "column Nc_frac: .* found 75 in row 8; check the units"),
        (put("segment", 7, 1.5), "column segment: expected whole numbers from 0 on, found 1.5"),
        (put("segment", 7, -1.0), "column segment: .* found -1"),
        (put("in_stall", 7, 0.5), "column in_stall: expected 0 or 1, found 0.5"),
        (lambda c: c.update(phi=np.full(N, 0.1)), "column phi: expected a signal that moves"),
        (lambda c: c.update(psi_p=np.full(N, 2.0)), "column psi_p: expected a signal that moves"),
        (lambda c: c.update(phi=c["phi"][:-1]), "columns of one length"),
        (lambda c: c.update(phi=c["phi"][:, None]), "one value a row, found shape"),
    ],
)
def test_what_no_estimator_can_use_is_refused(
    change: Callable[[dict[str, Any]], None], words: str
) -> None:
    known = columns()
    change(known)
    with pytest.raises(InputError, match=words) as caught:
        CoefficientSeries(**known, source="run.csv")
    assert str(caught.value).startswith("run.csv: ")


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


@pytest.mark.parametrize("seed", range(10))
def test_an_uneven_clock_has_the_rate_of_its_rows_unless_some_are_missing(seed: int) -> None:
    rng, row = np.random.default_rng(seed), np.arange(4000)
    drifting = 1e-3 * (row + row**2 / 8e6 + 0.2 * rng.standard_normal(4000))
    for clock, rate in ((drifting, 999.5), (np.round(rng.random() + row / 3000.7, 3), 3000.7)):
        assert jittering_period_s(clock) == pytest.approx(1.0 / rate, rel=3e-4)
        gone = rng.integers(100, 3900) + np.arange(4)
        assert np.isnan(jittering_period_s(np.delete(clock, gone)))
