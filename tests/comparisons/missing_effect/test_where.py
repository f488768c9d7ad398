"""Where a residual stands out: the right place for what was planted, and silence for noise."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from comparisons.missing_effect.where import where_of
from comparisons.missing_effect.where_rows import Residuals, Where, describe
from comparisons.missing_effect.where_spectrum import power_bound, power_z

RATE_HZ = 100.0
SURGE_HZ = (1.1, 0.9, 1.5)
FLOOR = 0.012


def surge(time_s: np.ndarray, hz: float, rng: np.random.Generator) -> np.ndarray:
    phase = 2 * np.pi * hz * time_s + rng.uniform(0.0, 6.0)
    amplitude = 0.2 * (1.0 + 0.3 * np.sin(2 * np.pi * 0.07 * time_s + rng.uniform(0.0, 6.0)))
    wander = lfilter([0.002], [1.0, -0.8], rng.standard_normal(time_s.size))
    return 0.3 + amplitude * (np.cos(phase) + 0.25 * np.cos(2 * phase + 0.5)) + wander


def three_records(rng: np.random.Generator, n: int = 2000) -> Residuals:
    times = [30.0 * k + np.arange(n) / RATE_HZ for k in range(3)]
    flows = [surge(t, hz, rng) for t, hz in zip(times, SURGE_HZ, strict=True)]
    none = np.zeros(3 * n)
    return Residuals(
        "psi_p",
        "1",
        np.concatenate(times),
        none,
        none,
        none,
        np.concatenate(flows),
        "phi",
        "1",
        tuple(slice(k * n, (k + 1) * n) for k in range(3)),
        np.repeat(np.arange(3), n),
        ("A", "B", "C"),
        1.0 / RATE_HZ,
        floor_rms=FLOOR,
        cycle_hz=1.1,
    )


def short_segments(rng: np.random.Generator) -> Residuals:
    """Return records of 12 segments of 60 rows each, as classic records of surge have."""
    whole = three_records(rng)
    starts = [2000 * k + 160 * s + 20 for k in range(3) for s in range(12)]
    rows = np.concatenate([np.arange(start, start + 60) for start in starts])
    none = np.zeros(rows.size)
    return replace(
        whole,
        measured=none,
        before=none,
        after=none,
        over=whole.over[rows],
        time_s=whole.time_s[rows],
        runs=tuple(slice(60 * k, 60 * (k + 1)) for k in range(36)),
        record=whole.record[rows],
    )


def in_stall_only(rng: np.random.Generator) -> Residuals:
    whole = three_records(rng)
    return replace(whole, measured=np.where(whole.over < np.median(whole.over), 0.0, np.nan))


def white(data: Residuals, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal(data.over.size)


def heavy_tailed(data: Residuals, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_t(3, data.over.size) / math.sqrt(3.0)


def coloured(data: Residuals, rng: np.random.Generator) -> np.ndarray:
    noise = np.zeros(data.over.size)
    for run in data.runs:
        drive = rng.standard_normal(run.stop - run.start + 100)
        noise[run] = lfilter([math.sqrt(1.0 - 0.49)], [1.0, -0.7], drive)[100:]
    return noise


def planted(kind: str, data: Residuals, rng: np.random.Generator) -> np.ndarray:
    """Return a structure of rms 1."""
    t, phi = data.time_s, data.over
    if kind == "drift":
        angles = [2 * np.pi * f * t + rng.uniform(0.0, 6.0) for f in (0.03, 0.11, 0.21)]
        shape = np.sum(np.sin(angles), axis=0)
    elif kind == "ripple":
        shape = np.sin(2 * np.pi * 27.3 * t + rng.uniform(0.0, 6.0))
    elif kind == "ripple in episodes":
        stalled = phi < np.median(phi)
        episode = np.cumsum(np.diff(stalled.astype(int), prepend=0) > 0)
        theta = rng.uniform(0.0, 6.0, episode.max() + 1)[episode]
        shape = np.where(stalled, np.sin(2 * np.pi * 27.3 * t + theta), 0.0)
    else:
        shape = np.where(np.gradient(phi) > 0.0, 1.0, -1.0)
    shape = shape - shape.mean()
    return shape / math.sqrt(float(np.mean(shape**2)))


def run(data: Residuals, residual: np.ndarray, **options: Any) -> Where:
    """Look where a residual stands out, given in units of the noise."""
    return where_of(replace(data, measured=data.measured + FLOOR * residual, **options))


# At a false alarm of 0.5 % or less, more than three in 80 happen once in a thousand test runs.
@pytest.mark.parametrize(
    ("layout", "noise", "floor", "ar"),
    [
        (three_records, heavy_tailed, 0.65 * FLOOR, ()),
        (three_records, coloured, FLOOR, (0.7,)),
        (short_segments, white, FLOOR, ()),
        (short_segments, coloured, FLOOR, (0.7,)),
        (in_stall_only, heavy_tailed, FLOOR, ()),
    ],
)
def test_noise_is_silent(layout: Any, noise: Any, floor: float, ar: tuple[float, ...]) -> None:
    said = 0
    for seed in range(80):
        rng = np.random.default_rng(seed)
        data = layout(rng)
        said += bool(run(data, noise(data, rng), floor_rms=floor, ar=np.array(ar)).standing_out)
    assert said <= 3


def test_z_is_standard_normal_under_coloured_noise() -> None:
    time: list[float] = []
    flow: list[float] = []
    ratios: list[float] = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        data = three_records(rng)
        where = run(data, coloured(data, rng), ar=np.array([0.7]))
        time += [row.z_mean for row in where.time]
        flow += [row.before[way].z for row in where.flow for way in ("falling", "rising")]
        ratios += [row.ratio for row in where.frequency]
    for z in (time, flow):
        assert np.nanstd(z) == pytest.approx(1.0, abs=0.1)
        assert abs(np.nanmean(z)) < 4.0 / math.sqrt(len(z))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


def test_colour_that_is_not_stated_stands_out() -> None:
    rng = np.random.default_rng(3)
    data = three_records(rng)
    noise = coloured(data, rng)
    assert "frequency" in run(data, noise).standing_out
    assert run(data, noise, ar=np.array([0.7])).standing_out == ()


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_drift_is_found_in_the_slowest_band_and_in_time_but_not_in_the_flow(
    strength: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = three_records(rng)
    where = run(data, white(data, rng) + strength * planted("drift", data, rng))
    assert set(where.standing_out) == {"time", "frequency"}
    top = max(where.frequency, key=lambda row: row.z)
    assert top is where.frequency[0]
    assert top.high_hz < 0.5
    assert top.z > where.bound_z


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("kind", ["ripple", "ripple in episodes"])
@pytest.mark.parametrize("seed", range(2))
def test_a_ripple_is_found_in_its_band_and_nowhere_in_the_flow(
    kind: str, strength: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = three_records(rng)
    where = run(data, white(data, rng) + strength * planted(kind, data, rng))
    assert "frequency" in where.standing_out
    assert "flow" not in where.standing_out
    top = max(where.frequency, key=lambda row: row.z)
    assert top.low_hz <= 27.3 < top.high_hz


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("layout", [three_records, short_segments, in_stall_only])
@pytest.mark.parametrize("seed", range(2))
def test_a_residual_that_parts_by_direction_is_found_in_the_flow(
    layout: Any, strength: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = layout(rng)
    where = run(data, white(data, rng) + strength * planted("direction", data, rng))
    assert "flow" in where.standing_out
    assert where.direction.z < -where.bound_z
    assert where.direction.mean == pytest.approx(-2.0 * strength * FLOOR, rel=0.3)
    for row in where.flow:
        for way, sign in (("rising", 1.0), ("falling", -1.0)):
            cell = row.before[way]
            if math.isfinite(cell.stderr):
                target = sign * strength * FLOOR
                assert abs(cell.mean - target) < 0.4 * strength * FLOOR + 5.0 * cell.stderr


def test_a_block_in_which_the_noise_grows_is_found_by_its_variance() -> None:
    rng = np.random.default_rng(6)
    data = three_records(rng)
    louder = (data.time_s >= 36.0) & (data.time_s < 38.0)
    where = run(data, white(data, rng) * np.where(louder, 1.6, 1.0))
    row = max(where.time, key=lambda r: r.z)
    assert row.record == "B"
    assert 35.0 < row.from_s < row.to_s < 39.0
    assert row.z == row.z_variance > where.bound_z
    assert row.excess == pytest.approx(FLOOR * math.sqrt(1.6**2 - 1.0), rel=0.2)


def test_a_floor_stated_too_low_is_said_and_is_no_structure() -> None:
    rng = np.random.default_rng(11)
    data = three_records(rng)
    where = run(data, 1.3 * white(data, rng))
    assert where.background == pytest.approx(1.3, rel=0.05)
    assert where.standing_out == ()
    assert f"{where.background:.2f} times the noise" in describe(where, two=False)[-1]


def test_one_wild_reading_is_no_structure() -> None:
    rng = np.random.default_rng(12)
    data = three_records(rng)
    noise = white(data, rng)
    noise[1234] = 500.0
    assert run(data, noise).standing_out == ()


def test_without_a_known_floor_the_signal_alone_is_judged() -> None:
    rng = np.random.default_rng(13)
    data = three_records(rng)
    residual = white(data, rng) + planted("direction", data, rng)
    where = run(data, residual, floor_rms=math.nan)
    assert where.standing_out == ("flow",)
    assert all(math.isnan(row.z) for row in (*where.time, *where.frequency))


@pytest.mark.parametrize("freedom", [4.0, 20.0, 300.0])
def test_z_of_a_power_has_the_tail_of_chi_squared(freedom: float) -> None:
    from scipy.stats import chi2, norm

    for z in (2.0, 4.0):
        ratio = power_bound(z, freedom, known=True)
        assert power_z(ratio, freedom, known=True) == pytest.approx(z)
        assert norm.isf(chi2.sf(freedom * ratio, freedom)) == pytest.approx(z, abs=0.2)
