"""Stuck channels and dropouts, searched block by block, are those of a search in one piece."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_data import make_test

from classic_ml.calibration import pressure_from_counts
from classic_ml.columns import workspace
from classic_ml.faults.marks import BEYOND_LIMITS, CLIPPED, STUCK, fault_name
from classic_ml.faults.search import inspect_readings
from classic_ml.faults.standstill import tallies
from classic_ml.io import TestDescription
from classic_ml.records import Record

LONG_ROWS = 50
PROBE, COUPLE = "P25_A_tip_forward", "T25_A"


@cache
def description() -> TestDescription:
    made = make_test(seconds=0.5)
    limits = {PROBE: [8e4, 1.1e5], COUPLE: [200.0, 260.0]}
    return type(made)(made.columns, {**made.description, "limits": limits}, made.truth).load()[1]


def standing(values: np.ndarray, alike: list[np.ndarray]) -> np.ndarray:
    """Mark the rows of one channel that stand still or have dropped out, with all of it at hand."""
    steps = np.abs(np.diff(values))
    usual = np.median(steps[steps > 0]) if np.any(steps > 0) else np.inf
    ends = np.concatenate(([np.inf], steps, [np.inf]))
    edges = [0, *(np.flatnonzero(steps) + 1).tolist(), values.size]
    marked = np.zeros(values.size, dtype=bool)
    for start, stop in pairwise(edges):
        jump = min(ends[start], ends[stop])
        if stop - start >= 5 and np.isfinite(jump) and jump > 10.0 * usual:
            marked[start:stop] = True
        elif stop - start >= LONG_ROWS and alike:
            moved = [np.ptp(a[start:stop]) > 8.0 * least_step(a) for a in alike]
            marked[start:stop] = 2 * sum(moved) >= len(moved)
    return marked


def least_step(values: np.ndarray) -> float:
    steps = np.abs(np.diff(values))
    return float(np.min(steps[steps > 0], initial=np.inf))


def expected_marks(record: Record, test: TestDescription) -> dict[str, np.ndarray]:
    kinds = {p.name: (p.plane, p.facing) for p in test.pressures}
    kinds |= {t.name: (t.plane, "") for t in test.temperatures}
    marks = {}
    for name, kind in kinds.items():
        values = record[name]
        mark = np.zeros(values.size)
        readings = values
        if name.startswith("P"):
            mark[(values <= 0) | (values >= 4095)] += CLIPPED
            probe = next(p for p in test.pressures if p.name == name)
            readings = pressure_from_counts(probe, test.adc, values)
        if name in test.limits:
            low, high = test.limits[name]
            mark[(readings <= low) | (readings >= high)] += BEYOND_LIMITS
        alike = [record[n] for n, k in kinds.items() if k == kind and n != name]
        mark[standing(values, alike) & (mark == 0)] = STUCK
        if mark.any():
            marks[name] = mark
    return marks


def random_record(seed: int, n: int) -> Record:
    """Walks of codes and of kelvin with planted runs, steps and clipped readings."""
    rng = np.random.default_rng(seed)
    test = description()
    arrays = {}
    for name in test.channel_names:
        pressure = name.startswith("P")
        step = rng.choice([0.3, 1.0, 4.0]) * (1.0 if pressure else 0.01)
        values = (2000.0 if pressure else 250.0) + step * rng.standard_normal(n).cumsum()
        # Quiet stretches have runs of their own.
        quiet = rng.random(n) < rng.choice([0.0, 0.5, 0.97])
        quiet[0] = False
        values = values[np.maximum.accumulate(np.where(quiet, 0, np.arange(n)))]
        if pressure and rng.random() < 0.8:
            values = np.round(values)
        for _ in range(rng.integers(0, 5)):
            start, rows = rng.integers(0, n), rng.choice([1, 4, 5, 6, 49, 50, 51, 130])
            to = rng.choice([values[start], values[start] + 2.0, 0.0, 4095.0, 2048.0])
            values[start : start + rows] = to
        arrays[name] = (values, "count" if pressure else "K")
    return Record.from_arrays(arrays, sample_rate_hz=1000.0)


@given(
    seed=st.integers(0, 10_000),
    n=st.sampled_from([1, 2, 6, 97, 400, 777]),
    rows=st.sampled_from([1, 7, 97, 1000]),
)
@settings(max_examples=40, deadline=None)
def test_the_marks_are_those_of_a_search_in_one_piece(seed: int, n: int, rows: int) -> None:
    record, test = random_record(seed, n), description()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace, "BLOCK_ROWS", rows)
        # Spikes are another search, with tests of its own.
        patch.setattr("classic_ml.faults.search.spiked_rows", lambda *_: {})
        found = inspect_readings(record, test)
    expected = expected_marks(record, test)
    assert {c for c in found.channels if c.startswith("fault_")} == set(map(fault_name, expected))
    for name, mark in expected.items():
        np.testing.assert_array_equal(found[fault_name(name)], mark)


def test_the_random_records_have_faults_of_every_kind() -> None:
    kinds: set[float] = set()
    for seed in range(20):
        for mark in expected_marks(random_record(seed, 777), description()).values():
            kinds |= set(np.unique(mark))
    assert kinds == {0.0, CLIPPED, STUCK, BEYOND_LIMITS, CLIPPED + BEYOND_LIMITS}


@pytest.mark.parametrize("rows", [7, 97, workspace.BLOCK_ROWS])
def test_tallies_of_counts_and_of_fractions(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", rows)
    rng = np.random.default_rng(2)
    arrays = {
        "codes": rng.integers(0, 9, 500).astype(float),
        "wide": rng.integers(0, 60_000, 500).astype(float),
        "kelvin": 250.0 + rng.integers(0, 9, 500) / 64.0,
        "constant": np.full(500, 3.0),
        "without runs": np.arange(500) ** 1.1,
    }
    for name in ("codes", "wide", "kelvin"):
        arrays[name][100:106] = arrays[name][100]
    record = Record.from_arrays(
        {name: (values, "1") for name, values in arrays.items()}, sample_rate_hz=1000.0
    )
    for name, tally in tallies(record, tuple(arrays)).items():
        steps = np.abs(np.diff(arrays[name]))
        steps = steps[steps > 0]
        assert (tally.low, tally.high) == (arrays[name].min(), arrays[name].max())
        assert tally.least_step == np.min(steps, initial=np.inf)
        needed = steps.size and name != "without runs"
        assert tally.usual_step == (np.median(steps) if needed else np.inf)
