"""The operating point during a run is that of the causal reduction of the whole record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_records import LiveRecord

from classic_ml.io import read_raw
from classic_ml.reduction import ReductionSettings, near_stall_shifts, reduce_record
from classic_ml.segments import in_stall_by_threshold
from classic_ml.whole_run import fit_whole_runs
from comparisons.live.detection import SurgeDetector
from comparisons.live.estimate import estimate_of
from comparisons.live.monitor import Monitor
from comparisons.live.operating_point import OperatingPoints, points_of


@pytest.fixture(scope="module")
def points(record: LiveRecord) -> OperatingPoints:
    raw, test = read_raw(record.raw, record.test_path)
    stated = replace(test, near_stall_shifts=near_stall_shifts(raw, test))
    return points_of(raw, stated, 0)


def monitored(record: LiveRecord, folder: Path, step: int, stop: int | None = None) -> Monitor:
    monitor = Monitor(record.test, ReductionSettings(), folder, estimates=False)
    monitor.head = record.header
    lines = [line.strip() for line in record.lines[:stop]]
    monitor.said = []  # type: ignore[attr-defined]
    for start in range(0, len(lines), step):
        notes = monitor.take(lines[start : start + step]) + monitor.update()
        monitor.said += [text for _, text in notes]  # type: ignore[attr-defined]
    return monitor


def test_it_is_that_of_reduce_phase_causal(record: LiveRecord, points: OperatingPoints) -> None:
    raw, test = read_raw(record.raw, record.test_path)
    reduced = reduce_record(raw, test, ReductionSettings(phase="causal")).record
    n = points.time_s.size
    assert n == len(record.lines) - 1
    for name, scale in (("phi", 1.0), ("psi_p", 1.0), ("Wc25_kg_s", 50.0), ("P31_Pa", 1e6)):
        assert np.max(np.abs(getattr(points, name) - reduced[name][:n])) < 1e-9 * scale, name


def test_it_does_not_depend_on_how_the_rows_came(
    record: LiveRecord, points: OperatingPoints, tmp_path: Path
) -> None:
    fine, coarse = (monitored(record, tmp_path, step) for step in (41, 900))
    # Clocks are the same; a period may stand between two roundings.
    begun = [[text.split(",")[0] for text in m.said] for m in (fine, coarse)]  # type: ignore[attr-defined]
    assert begun[0] == begun[1]
    # In the coarse one the rows before the near-stall reading had passed are matched already.
    for one, other in zip(fine.trail, coarse.trail, strict=True):
        assert one[0] < 0.2 or one == pytest.approx(other, rel=1e-9, abs=1e-9)
    assert fine.n_cycles == coarse.n_cycles > 5
    trail = np.array(fine.trail)
    # Once it is matched, each thinned row is that of the whole record.
    for row in trail[trail[:, 0] > 1.0]:
        i = round((row[0] - points.time_s[0]) * 1000.0)
        whole = (points.phi[i], points.psi_p[i], points.Wc25_kg_s[i], points.pressure_ratio[i])
        np.testing.assert_allclose(row[1:], whole, rtol=1e-9, atol=1e-9)


def test_before_the_near_stall_reading_has_passed_it_is_unmatched_and_says_so(
    record: LiveRecord, tmp_path: Path
) -> None:
    monitor = monitored(record, tmp_path, 100, stop=100)
    assert "not yet matched" in monitor.shown
    monitor = monitored(record, tmp_path, 100, stop=200)
    assert "; matched at near stall" in monitor.shown
    # At near stall P31/P25 is the facility's, once it is matched.
    reading, point = record.test.near_stall, monitor.point
    assert point is not None
    assert point.pressure_ratio == pytest.approx(reading.P31_Pa / reading.P25_Pa, rel=5e-3)


def test_rows_without_an_operating_point_are_reported_once(
    record: LiveRecord, tmp_path: Path
) -> None:
    # Readings of 0 at plane 31 are absolute pressures below zero, which have no flow.
    dead = [i for i, name in enumerate(record.names) if name.startswith("P31")]
    lines = list(record.lines)
    for row in range(300, 400):
        cells = lines[row].split(b",")
        for i in dead:
            cells[i] = b"0"
        lines[row] = b",".join(cells)
    spoiled = LiveRecord(record.folder)
    spoiled.__dict__["lines"] = lines
    monitor = monitored(spoiled, tmp_path, 50)
    said = [text for text in monitor.said if "no operating point" in text]  # type: ignore[attr-defined]
    assert len(said) == 1
    assert monitor.point is not None
    assert np.isfinite(monitor.point.phi)


def test_the_stall_state_is_that_of_the_reduction(
    record: LiveRecord, points: OperatingPoints
) -> None:
    test = replace(record.test, threshold_lbm_s=50.0, hysteresis_lbm_s=6.0)
    detector = SurgeDetector(test)
    state = []
    for row in zip(*vars(points).values(), strict=True):
        detector.take(OperatingPoints(*(np.array([value]) for value in row)))
        state.append(detector.in_stall)
    lbm = 0.45359237
    assert np.array_equal(state, in_stall_by_threshold(points.Wc25_kg_s, 50.0 * lbm, 6.0 * lbm))
    assert 0.2 < np.mean(state) < 0.95


def test_the_estimate_is_that_of_reduce_and_compare(record: LiveRecord, tmp_path: Path) -> None:
    raw, test = read_raw(record.raw, record.test_path)
    fit = fit_whole_runs([reduce_record(raw, test).series])
    stated = replace(test, near_stall_shifts=near_stall_shifts(raw, test))
    found = estimate_of(lambda: raw, stated, ReductionSettings())
    assert found.why_not == ""
    assert found.tau_s == pytest.approx(fit.time_constant_s_, rel=1e-9)
    assert found.tau_stderr_s == pytest.approx(fit.time_constant_stderr_s_, rel=1e-6)
    assert found.tau_s == pytest.approx(0.018, abs=0.002)
    phi = [row[0] for row in found.curve]
    np.testing.assert_allclose([row[1] for row in found.curve], fit.characteristic(phi)[0])
    early = estimate_of(lambda: read_raw(tmp_path / "none.csv", test)[0], test, ReductionSettings())
    assert "none.csv" in early.why_not


def test_a_monitor_estimates_behind_the_cycles(record: LiveRecord, tmp_path: Path) -> None:
    monitor = Monitor(record.test, ReductionSettings(), tmp_path)
    monitor.head = record.header
    monitor.take([line.strip() for line in record.lines])
    monitor.update()
    # Asks for an estimate; its end is waited for.
    assert monitor.poll() == []
    ((kind, said),) = monitor.close()
    assert (kind, said[:21]) == ("estimate", "first estimate of τ: ")
    assert monitor.estimate is not None
    assert monitor.estimate.tau_s == pytest.approx(0.018, abs=0.002)
