"""Where a residual stands out: the right place for what was planted, and silence for noise."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from comparisons.missing_effect.where import ResidualRuns, Where, localise
from comparisons.missing_effect.where_noise import SlowPart, floor_noise, power_bound, power_z
from surge_core.errors import InputError

RATE_HZ = 100.0
SURGE_HZ = (1.1, 0.9, 1.5)
FLOOR = 0.012


def surge(time_s: np.ndarray, hz: float, rng: np.random.Generator) -> np.ndarray:
    phase = 2 * np.pi * hz * time_s + rng.uniform(0.0, 6.0)
    amplitude = 0.2 * (1.0 + 0.3 * np.sin(2 * np.pi * 0.07 * time_s + rng.uniform(0.0, 6.0)))
    wander = lfilter([0.002], [1.0, -0.8], rng.standard_normal(time_s.size))
    return 0.3 + amplitude * (np.cos(phase) + 0.25 * np.cos(2 * phase + 0.5)) + wander


def three_records(rng: np.random.Generator, n: int = 2000) -> ResidualRuns:
    times = [30.0 * k + np.arange(n) / RATE_HZ for k in range(3)]
    flows = [surge(t, hz, rng) for t, hz in zip(times, SURGE_HZ, strict=True)]
    return ResidualRuns(
        np.zeros(3 * n),
        np.concatenate(flows),
        np.concatenate(times),
        tuple(slice(k * n, (k + 1) * n) for k in range(3)),
        np.repeat(np.arange(3), n),
        np.ones(3 * n, dtype=bool),
        RATE_HZ,
        ("A", "B", "C"),
    )


def short_segments(rng: np.random.Generator) -> ResidualRuns:
    """Return records of 12 segments of 60 rows each, as classic records of surge have."""
    whole = three_records(rng)
    starts = [2000 * k + 160 * s + 20 for k in range(3) for s in range(12)]
    rows = np.concatenate([np.arange(start, start + 60) for start in starts])
    return replace(
        whole,
        residual=whole.residual[rows],
        phi=whole.phi[rows],
        time_s=whole.time_s[rows],
        runs=tuple(slice(60 * k, 60 * (k + 1)) for k in range(36)),
        record=whole.record[rows],
        scored=whole.scored[rows],
    )


def in_stall_only(rng: np.random.Generator) -> ResidualRuns:
    whole = three_records(rng)
    return replace(whole, scored=whole.phi < np.median(whole.phi))


def white(data: ResidualRuns, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal(data.phi.size)


def heavy_tailed(data: ResidualRuns, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_t(3, data.phi.size) / math.sqrt(3.0)


def coloured(data: ResidualRuns, rng: np.random.Generator) -> np.ndarray:
    noise = np.zeros(data.phi.size)
    for run in data.runs:
        drive = rng.standard_normal(run.stop - run.start + 100)
        noise[run] = lfilter([math.sqrt(1.0 - 0.49)], [1.0, -0.7], drive)[100:]
    return noise


def planted(kind: str, data: ResidualRuns, rng: np.random.Generator) -> np.ndarray:
    """Return a structure of rms 1."""
    t, phi = data.time_s, data.phi
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


def run(data: ResidualRuns, residual: np.ndarray, **options: Any) -> Where:
    return localise(replace(data, residual=FLOOR * residual), FLOOR, **options)


def strongest_band(where: Where) -> tuple[float, float]:
    row = max(where.frequency, key=lambda r: r.z)
    return row.low_hz, row.high_hz


# At a false alarm of 0.5 % or less, more than three in 80 happen once in a thousand test runs.
@pytest.mark.parametrize(
    ("layout", "noise", "floor", "whitening"),
    [
        (three_records, heavy_tailed, 0.65, None),
        (three_records, coloured, 1.0, np.array([0.7])),
        (short_segments, white, 1.0, None),
        (short_segments, coloured, 1.0, np.array([0.7])),
        (in_stall_only, heavy_tailed, 1.0, None),
    ],
)
def test_noise_is_silent(layout: Any, noise: Any, floor: float, whitening: Any) -> None:
    said = 0
    for seed in range(80):
        rng = np.random.default_rng(seed)
        data = layout(rng)
        where = localise(replace(data, residual=noise(data, rng)), floor, whitening=whitening)
        said += bool(where.standing_out)

    assert said <= 3


def test_z_is_standard_normal_under_coloured_noise() -> None:
    found: dict[str, list[float]] = {"time": [], "flow": [], "phase": [], "regime": []}
    bands: list[float] = []
    ratios: list[float] = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        data = three_records(rng)
        where = run(data, coloured(data, rng), whitening=np.array([0.7]))
        found["time"] += [row.z_mean for row in where.time]
        found["flow"] += [row.z for row in where.flow]
        found["phase"] += [row.z for row in where.phase]
        found["regime"] += [row.z_mean for row in where.regime]
        bands += [row.z for row in where.frequency]
        ratios += [row.ratio for row in where.frequency]
    for name, z in found.items():
        assert np.std(z) == pytest.approx(1.0, abs=4.0 / math.sqrt(len(z))), name
        assert abs(np.mean(z)) < 4.0 / math.sqrt(len(z)), name
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)
    assert np.std(bands) < 1.1


def test_colour_that_is_not_told_stands_out_and_counts_rows_less_when_told() -> None:
    rng = np.random.default_rng(3)
    data = three_records(rng)
    noise = coloured(data, rng)
    assert "frequency" in run(data, noise).standing_out
    told = run(data, noise, whitening=np.array([0.7]))
    assert told.effective_share == pytest.approx(0.3 / 1.7, rel=1e-3)

    # A cell is visited for some rows at a time: less is lost than in one long mean (2.38).
    pairs = zip(run(data, noise).flow, told.flow, strict=True)
    assert 1.5 < np.median([b.stderr / a.stderr for a, b in pairs]) < math.sqrt(1.7 / 0.3)


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_drift_is_found_in_the_slowest_band_and_in_time_but_not_in_the_flow(
    strength: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = three_records(rng)
    where = run(data, white(data, rng) + strength * planted("drift", data, rng))
    assert {"time", "frequency"} <= set(where.standing_out)
    assert not {"flow", "phase"} & set(where.standing_out)
    assert strongest_band(where)[0] == 0.0
    assert strongest_band(where)[1] < 0.5
    assert where.max_band_ratio == where.frequency[0].ratio > where.frequency[0].ratio_bound


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("kind", ["ripple", "ripple in episodes"])
@pytest.mark.parametrize("seed", range(2))
def test_a_ripple_is_found_as_a_line_and_nowhere_in_the_flow(
    kind: str, strength: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = three_records(rng)
    where = run(data, white(data, rng) + strength * planted(kind, data, rng))
    assert "frequency" in where.standing_out
    assert not {"flow", "phase"} & set(where.standing_out)
    (line,) = [line for line in where.lines if line.source == "residual"]
    reach = 0.05 if kind == "ripple" else 1.5
    assert line.frequency_hz == pytest.approx(27.3, abs=reach)
    (band,) = [row for row in where.frequency if "stall cells" in row.lines]
    assert band.low_hz <= line.frequency_hz < band.high_hz


@pytest.mark.parametrize("strength", [0.3, 1.0])
@pytest.mark.parametrize("layout", [three_records, short_segments, in_stall_only])
@pytest.mark.parametrize("seed", range(2))
def test_a_residual_that_parts_by_direction_is_found_in_the_flow(
    layout: Any, strength: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = layout(rng)
    where = run(data, white(data, rng) + strength * planted("direction", data, rng))
    falling, rising = where.direction_means
    assert falling < 0.0 < rising
    assert where.standing_out[0] == "flow"
    assert abs(where.direction_z) == where.max_flow_z > where.bound_z

    for row in where.flow:
        target = strength * FLOOR * (1.0 if row.direction == "rising" else -1.0)
        assert abs(row.mean - target) < 0.3 * strength * FLOOR + 4.0 * row.stderr


def test_one_strong_cell_is_named_with_its_edges() -> None:
    rng = np.random.default_rng(5)
    data = three_records(rng)
    edges = np.quantile(data.phi, [0.625, 0.75])
    inside = (data.phi > edges[0]) & (data.phi < edges[1]) & (np.gradient(data.phi) < 0.0)
    where = run(data, white(data, rng) + 1.0 * inside)
    row = max(where.flow, key=lambda r: abs(r.z))
    assert (row.phi_from, row.phi_to) == pytest.approx(tuple(edges))
    assert row.direction == "falling"


def test_a_block_in_which_the_noise_grows_is_found_by_its_variance() -> None:
    rng = np.random.default_rng(6)
    data = three_records(rng)
    louder = (data.time_s >= 36.0) & (data.time_s < 38.0)
    where = run(data, white(data, rng) * np.where(louder, 1.6, 1.0), block_s=2.0)
    row = max(where.time, key=lambda r: r.z)
    assert (row.record, row.from_s, row.to_s) == ("B", 36.0, 38.0)
    assert row.z == row.z_variance > where.bound_z
    assert row.excess == pytest.approx(FLOOR * math.sqrt(1.6**2 - 1.0), rel=0.2)


def test_a_phase_is_counted_from_where_the_flow_rises_through_its_mean() -> None:
    data = three_records(np.random.default_rng(8))
    level = np.cos(2 * np.pi * data.time_s)  # rises through its mean at 0.75 s
    data = replace(data, phi=0.3 + 0.1 * level)
    late = (data.time_s - 0.75) % 1.0
    pulse = (late >= 0.25) & (late < 1.0 / 3.0)
    where = run(data, np.random.default_rng(9).standard_normal(6000) + pulse)
    row = max(where.phase, key=lambda r: abs(r.z))
    assert (row.from_cycle, row.to_cycle) == pytest.approx((0.25, 1.0 / 3.0))


def test_mild_oscillations_between_deep_cycles_are_no_cycles_of_their_own() -> None:
    """As in a surge record: recovery, blowdown, and half as long a wave in stall behind it."""
    data = three_records(np.random.default_rng(8))
    turn = data.time_s % 1.0
    deep = np.exp(-(((turn - 0.35) / 0.08) ** 2))
    mild = 0.4 * np.exp(-(((turn - 0.85) / 0.08) ** 2))
    # Before the first deep cycle it oscillates in stall alone.
    waiting = data.time_s < data.time_s[0] + 4.0
    phi = 0.3 * np.where(waiting, mild + 0.4 * deep, deep + mild)
    data = replace(data, phi=phi + 1e-3 * np.random.default_rng(1).standard_normal(phi.size))
    late = (data.time_s - 0.27) % 1.0
    pulse = (late >= 0.25) & (late < 1.0 / 3.0) & ~waiting
    where = run(data, np.random.default_rng(9).standard_normal(6000) + pulse)
    assert [row.surge_hz for row in where.regime] == pytest.approx([1.0] * 3, rel=0.02)
    row = max(where.phase, key=lambda r: abs(r.z))
    assert (row.from_cycle, row.to_cycle) == pytest.approx((0.25, 1.0 / 3.0))


def test_jumps_in_each_cycle_are_not_taken_for_a_line() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        data = three_records(rng)
        where = run(data, white(data, rng) + 3.0 * planted("direction", data, rng))
        assert not [line for line in where.lines if line.source == "residual"]
        assert "surge" in max(where.frequency, key=lambda r: r.z).lines


def test_a_floor_stated_too_low_is_told_as_such_and_is_no_structure() -> None:
    rng = np.random.default_rng(11)
    data = three_records(rng)
    where = run(data, 1.3 * white(data, rng))
    assert where.background == pytest.approx(1.3, rel=0.05)
    assert where.standing_out == ()

    assert all(row.ratio == pytest.approx(1.69, rel=0.3) for row in where.frequency)


def test_one_wild_reading_is_no_structure() -> None:
    rng = np.random.default_rng(12)
    data = three_records(rng)
    noise = white(data, rng)
    noise[1234] = 500.0
    assert run(data, noise).standing_out == ()


def test_variance_of_a_sum_is_that_of_the_covariance_matrix() -> None:
    rng = np.random.default_rng(17)
    runs = (slice(0, 40), slice(45, 60), slice(60, 130))
    noise = floor_noise(0.3, np.array([1.2, -0.5]), runs, 130)
    impulse = lfilter([1.0], [1.0, -1.2, 0.5], np.eye(1, 4000)[0])
    lags = np.array([impulse[: 4000 - k] @ impulse[k:] for k in range(130)])
    covariance = np.zeros((130, 130))
    for part in runs:
        covariance[part, part] = 0.09 * toeplitz(lags[: part.stop - part.start] / lags[0])
    for _ in range(5):
        weights = rng.standard_normal(130)
        weights[40:45] = 0.0
        assert noise.sum_variance(weights) == pytest.approx(
            weights @ covariance @ weights, rel=1e-3
        )


def test_the_slow_part_is_out_of_a_straight_line_and_its_adjoint_holds() -> None:
    rng = np.random.default_rng(19)
    rows = np.flatnonzero(rng.random(400) < 0.8)
    time_s = rows / RATE_HZ
    block = np.minimum(rows // 50, 7)
    slow = SlowPart.over(rows, block, time_s, np.repeat([0, 1], 4))
    line = np.zeros(400)
    line[rows] = np.where(block < 4, 3.0 + 2.0 * time_s, -1.0 * time_s)
    np.testing.assert_allclose(slow.without(line), 0.0, atol=1e-12)
    e, w = rng.standard_normal((2, 400))
    assert slow.weights(w) @ e == pytest.approx(w[rows] @ slow.without(e)[rows])


@pytest.mark.parametrize("freedom", [4.0, 20.0, 300.0])
def test_z_of_a_power_has_the_tail_of_chi_squared(freedom: float) -> None:
    from scipy.stats import chi2, norm

    for z in (2.0, 4.0):
        ratio = power_bound(z, freedom)
        assert power_z(ratio, freedom) == pytest.approx(z)
        assert norm.isf(chi2.sf(freedom * ratio, freedom)) == pytest.approx(z, abs=0.2)


@pytest.mark.parametrize(
    ("change", "options", "where"),
    [
        ({"scored": np.zeros(6000, dtype=bool)}, {}, "scored"),
        ({}, {"floor_rms": 0.0}, "floor_rms"),
        ({}, {"block_s": 25.0}, "block_s"),
        ({"residual": np.where(np.arange(6000) == 5, np.nan, 0.0)}, {}, "residual"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence(
    change: dict[str, Any], options: dict[str, Any], where: str
) -> None:
    data = replace(three_records(np.random.default_rng(0)), **change)
    with pytest.raises(InputError) as caught:
        localise(data, **{"floor_rms": FLOOR, **options})
    assert caught.value.where == where
    assert "expected" in caught.value.sentence()
