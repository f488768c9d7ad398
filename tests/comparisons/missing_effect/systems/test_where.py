"""Where a run and its simulation part: what is planted in a residual shows where it is."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import system_models as make
from made_systems import made_diagnosis

from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.results import residuals_of
from comparisons.missing_effect.where import where_of
from comparisons.missing_effect.where_rows import Residuals
from surge_core.files import to_strict_json
from surge_core.types import FloatArray

PERIOD_S = 0.01
N = 8000
CLEAN = 2.0 * np.sin(2.0 * np.pi * 0.37 * PERIOD_S * np.arange(N)) + np.sin(
    2.0 * np.pi * 0.83 * PERIOD_S * np.arange(N) + 1.0
)


def parted(planted: FloatArray, noise: FloatArray, *, settle: int = 0) -> CheckRun:
    """Return a run in which the model before lacks what is planted, and noise is left after."""
    measured = CLEAN + planted + noise
    return CheckRun(
        "run",
        "check",
        PERIOD_S,
        100.0 + PERIOD_S * np.arange(N),
        {"y": "1"},
        measured[:, None],
        CLEAN[:, None],
        (CLEAN + planted)[:, None],
        settle,
        {"y": measured, "u": np.roll(CLEAN, 30)},
    )


def made_effect(signal: str):  # type: ignore[no-untyped-def]
    return replace(made_diagnosis().missing[0], place={"equation": "dv/dt", "signal": signal})


def residuals(check: CheckRun, *signals: str) -> Residuals:
    """What is looked at where effects on these signals were added."""
    added = [made_effect(signal) for signal in signals]
    return residuals_of(check, 0, added, make.circuit())


def white(seed: int, size: float = 0.02) -> FloatArray:
    return size * np.random.default_rng(seed).standard_normal(N)


@pytest.mark.parametrize("frequency_hz", [0.9, 7.3, 31.0])
def test_a_sine_shows_in_its_band_with_its_power(frequency_hz: float) -> None:
    sine = 0.3 * np.sin(2.0 * np.pi * frequency_hz * PERIOD_S * np.arange(N))
    where = where_of(residuals(parted(sine, white(1))))
    power = [(row.high_hz - row.low_hz) * row.before_psd for row in where.frequency]
    top = where.frequency[int(np.argmax(power))]
    assert top.low_hz - 0.1 < frequency_hz < top.high_hz + 0.1
    assert sum(power) == pytest.approx(0.5 * 0.3**2 + 0.02**2, rel=0.05)
    left = np.array([row.after_psd for row in where.frequency])
    assert left.max() < 4.0 * np.median(left)
    measured = np.array([row.measured_psd for row in where.frequency])
    assert where.frequency[int(np.argmax(measured))].high_hz < 1.2


def test_a_quadratic_shows_over_the_signal_and_is_gone_after() -> None:
    beyond = rows = 0
    for seed in range(10):
        # The system has it; the model after has it as well.
        check = parted(0.1 * CLEAN**2, white(seed))
        check = replace(check, signals={**check.signals, "y": CLEAN})
        where = where_of(residuals(check))
        assert where.of.simulated
        over_u = where_of(residuals(check, "u"))
        assert over_u.of.signal == "u"
        assert not over_u.of.simulated
        for row in where.flow:
            beyond += abs(row.after["any"].mean) > 3.0 * row.after["any"].stderr
            rows += 1
        # y = x + 0.1 x² for the planted x of each range.
        at = np.array([row.at for row in where.flow])
        x = (np.sqrt(1.0 + 0.4 * at) - 1.0) / 0.2
        mean = np.array([row.before["any"].mean for row in where.flow])
        assert mean == pytest.approx(0.1 * x**2, abs=0.015)
    assert beyond < 0.04 * rows


def test_noise_alone_gives_no_slope_over_the_own_output() -> None:
    z = []
    for seed in range(20):
        check = parted(np.zeros(N), white(seed, 1.0))
        where = where_of(residuals(check))
        z += [row.before["any"].mean / row.before["any"].stderr for row in where.flow]
        residual = (check.measured - check.before)[:, 0]
        assert np.corrcoef(residual, check.measured[:, 0])[0, 1] > 0.4
    assert np.mean(np.abs(z) > 2.0) < 0.12
    assert abs(np.mean(z)) < 4.0 / math.sqrt(len(z))


def test_the_standard_error_knows_that_neighbours_go_together() -> None:
    from scipy.signal import lfilter

    z, naive = [], []
    for seed in range(20):
        slow = lfilter([1.0], [1.0, -0.9], white(seed))
        where = where_of(residuals(parted(np.zeros(N), slow)))
        z += [row.after["any"].mean / row.after["any"].stderr for row in where.flow]
        cells = [row.after["any"] for row in where.flow]
        naive += [cell.mean / (np.std(slow) / math.sqrt(cell.n)) for cell in cells]
    assert 0.8 < np.std(z) < 1.5
    assert np.std(naive) > 1.5 * np.std(z)


def test_a_friction_parts_the_two_ways() -> None:
    friction = 0.2 * np.sign(np.gradient(CLEAN))
    where = where_of(residuals(parted(friction, white(5)), "none"))
    inner = where.flow[4:-4]
    for way, size in (("rising", 0.2), ("falling", -0.2)):
        found = [row.before[way].mean for row in inner]
        assert found == pytest.approx([size] * len(inner), abs=0.03)
    assert max(abs(row.after["rising"].mean) for row in inner) < 0.01


def test_a_burst_shows_in_its_blocks_alone() -> None:
    burst = np.zeros(N)
    burst[3000:3400] = 0.5
    where = where_of(residuals(parted(burst, white(8), settle=40)))
    loud = [row for row in where.time if row.before_rms > 0.1]
    assert loud[0].from_s < 130.0 < loud[0].to_s
    assert loud[-1].from_s < 134.0 < loud[-1].to_s
    assert max(row.after_rms for row in where.time) < 0.03
    assert len(where.time) == 40
    assert where.time[0].from_s == pytest.approx(100.4)
    assert where.time[-1].to_s == pytest.approx(180.0)


def test_rows_without_a_reading_are_left_out() -> None:
    """Every third row is read, and an outage fills a block of time."""
    quadratic = parted(0.1 * CLEAN**2, white(11))
    measured = quadratic.measured.copy()
    measured[np.arange(N) % 3 != 0] = np.nan
    measured[2000:2400] = np.nan
    where = where_of(residuals(replace(quadratic, measured=measured)))
    assert sum(math.isnan(row.before_rms) for row in where.time) == 2
    assert sum(row.after["any"].n for row in where.flow) == np.count_nonzero(np.isfinite(measured))
    assert all(math.isfinite(row.before_psd) for row in where.frequency)
    assert max(abs(row.after["any"].mean) / row.after["any"].stderr for row in where.flow) < 4.5
    written = json.loads(to_strict_json(where.to_json()))
    assert sum(row["before_rms"] is None for row in written["time"]) == 2
