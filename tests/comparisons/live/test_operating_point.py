"""The operating point during a run is that of the causal reduction of the whole record."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from live_records import LiveRecord

from classic_ml.io import read_raw
from classic_ml.reduction import ReductionSettings, reduce_record
from classic_ml.segments import in_stall_by_threshold
from comparisons.live.columns import FeedColumns, feed_columns
from comparisons.live.detection import SurgeDetector
from comparisons.live.monitor import Monitor
from comparisons.live.near_stall import NearStallMatch
from comparisons.live.operating_point import CausalChain, OperatingPoints
from comparisons.live.running_estimate import NoEstimate


@pytest.fixture(scope="module")
def columns(record: LiveRecord) -> FeedColumns:
    return feed_columns(record.names, record.test)


def batches(n_rows: int, seed: int, mean: int) -> list[slice]:
    rng = np.random.default_rng(seed)
    stops = np.minimum(np.cumsum(rng.integers(1, 2 * mean, n_rows)), n_rows)
    edges = [0, *np.unique(stops).tolist()]
    return [slice(a, b) for a, b in pairwise(edges)]


def joined(parts: list[OperatingPoints]) -> OperatingPoints:
    return OperatingPoints(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(parts[0]))
    )


def chain_over(record: LiveRecord, columns: FeedColumns, cuts: list[slice]) -> OperatingPoints:
    time_s, readings = columns.time_s(record.values), columns.readings(record.values)
    match = NearStallMatch(columns)
    match.take(time_s, readings)
    chain = CausalChain(columns, match)
    return joined([chain.take(time_s[rows], readings[rows]) for rows in cuts])


def test_it_is_that_of_reduce_phase_causal(record: LiveRecord, columns: FeedColumns) -> None:
    raw, test = read_raw(record.raw, record.test_path)
    # All thermocouples of plane 25 and all pairs stay in, as in the chain.
    reduced = reduce_record(raw, test, ReductionSettings(phase="causal"))
    points = chain_over(record, columns, batches(len(record.values), 1, 12))
    n = len(points)
    assert n == len(record.values) - 1
    for name, scale in (("phi", 1.0), ("psi_p", 1.0), ("Wc25_kg_s", 50.0), ("P31_Pa", 1e6)):
        off = getattr(points, name) - reduced.record[name][:n]
        assert np.max(np.abs(off)) < 1e-9 * scale, name
    assert np.array_equal(points.time_s, record.values[:n, 0])


def test_it_does_not_depend_on_how_the_rows_were_cut(
    record: LiveRecord, columns: FeedColumns
) -> None:
    whole = chain_over(record, columns, [slice(0, len(record.values))])
    for seed, mean in ((2, 1), (3, 40)):
        cuts = batches(400, seed, mean) if mean == 1 else batches(len(record.values), seed, mean)
        points = chain_over(record, columns, cuts)
        for f in fields(points):
            kept = getattr(points, f.name)
            assert np.allclose(kept, getattr(whole, f.name)[: kept.size], rtol=1e-12, atol=1e-12)


def monitored(record: LiveRecord, columns: FeedColumns, values: np.ndarray, mean: int) -> Monitor:
    monitor = Monitor(columns, NoEstimate())
    time_s, readings = columns.time_s(values), columns.readings(values)
    told = []
    for rows in batches(len(values), 5, mean):
        told += monitor.take(time_s[rows], readings[rows])
    monitor.told = told  # type: ignore[attr-defined]
    return monitor


def test_what_is_told_does_not_depend_on_how_the_rows_were_cut(
    record: LiveRecord, columns: FeedColumns
) -> None:
    fine, coarse = (monitored(record, columns, record.values, mean) for mean in (7, 900))
    assert fine.told == coarse.told
    assert fine.trail == coarse.trail
    assert fine.n_cycles == coarse.n_cycles > 5
    assert "clipped" in " ".join(text for _, text in fine.told)


def test_before_the_near_stall_reading_has_passed_it_is_unmatched_and_says_so(
    record: LiveRecord, columns: FeedColumns
) -> None:
    monitor = Monitor(columns, NoEstimate())
    time_s, readings = columns.time_s(record.values), columns.readings(record.values)
    monitor.take(time_s[:100], readings[:100])
    assert "not yet matched" in monitor.shown
    before = monitor.point
    assert before is not None
    monitor.take(time_s[100:200], readings[100:200])
    assert "matched at near stall" in monitor.shown
    assert "not" not in monitor.shown
    assert monitor.point is not None
    # At near stall P31/P25 is the facility's, once it is matched.
    reading = record.test.near_stall
    assert monitor.point.pressure_ratio == pytest.approx(reading.P31_Pa / reading.P25_Pa, rel=5e-3)


def test_a_probe_that_sticks_is_left_out_with_its_mate(
    record: LiveRecord, columns: FeedColumns
) -> None:
    values = record.values.copy()
    name = record.test.pairs(25)[0].forward.name
    column = record.names.index(name)
    values[2000:, column] = values[2000, column]
    sound = monitored(record, columns, record.values, 20)
    stuck = monitored(record, columns, values, 20)
    assert f"stuck or dropped out: {name}" in " ".join(text for _, text in stuck.told)
    assert {name, record.test.pairs(25)[0].aft.name} <= set(stuck._faults.left_out)
    time_s, readings = columns.time_s(values), columns.readings(values)
    with_it = CausalChain(columns, sound._match).take(time_s, readings).phi[2600::5]
    phi_sound, phi_stuck = (np.array([row[1] for row in m.trail])[520:] for m in (sound, stuck))
    off = np.sqrt(np.mean((phi_stuck - phi_sound) ** 2))
    off_with_it = np.sqrt(np.mean((with_it[: phi_sound.size] - phi_sound) ** 2))
    assert off < 0.01
    assert off_with_it > 3.0 * off


def test_rows_without_an_operating_point_are_told_once_and_passed_over(
    record: LiveRecord, columns: FeedColumns
) -> None:
    values = record.values[:600].copy()
    # A plane without pressure: absolute pressures of zero or less have no flow.
    names = [p.name for p in record.test.pressures if p.plane == 25]
    values[300:400, [record.names.index(name) for name in names]] = 0.0
    monitor = monitored(record, columns, values, 10)
    told = [text for _, text in monitor.told if text.startswith("no operating point")]
    assert len(told) == 1
    flows = np.array([row[3] for row in monitor.trail])
    assert np.isnan(flows).any()
    assert np.isfinite(flows[-10:]).all()


def test_the_stall_state_is_that_of_the_reduction(record: LiveRecord, columns: FeedColumns) -> None:
    points = chain_over(record, columns, [slice(0, len(record.values))])
    test = replace(record.test, threshold_lbm_s=50.0, hysteresis_lbm_s=6.0)
    detector = SurgeDetector(test)
    state = []
    for row in range(len(points)):
        detector.take(points.part(slice(row, row + 1)))
        state.append(detector.in_stall)
    lbm = 0.45359237
    assert np.array_equal(state, in_stall_by_threshold(points.Wc25_kg_s, 50.0 * lbm, 6.0 * lbm))
    assert 0.2 < np.mean(state) < 0.95
