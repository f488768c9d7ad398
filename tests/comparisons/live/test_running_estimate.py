"""The running estimate: that of `compare` for the rows so far, and honest about its error."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from live_records import LiveRecord, made_record

from classic_ml.io import read_raw
from classic_ml.reduction import ReductionSettings, reduce_record
from classic_ml.whole_run import fit_whole_runs
from comparisons.live import running_estimate
from comparisons.live.columns import FeedColumns, feed_columns
from comparisons.live.estimate import Estimate, estimate_of
from comparisons.live.monitor import Monitor
from comparisons.live.running_estimate import NoEstimate, RunningEstimate

TAU_S = 0.018


def estimated(record: LiveRecord, n_rows: int) -> Estimate:
    columns = feed_columns(record.names, record.test)
    readings = columns.readings(record.values[:n_rows])
    return estimate_of(columns, readings, float(record.values[0, 0]))


def test_over_all_rows_it_is_the_estimate_of_compare(record: LiveRecord) -> None:
    estimate = estimated(record, len(record.values))
    series = reduce_record(*read_raw(record.raw, record.test_path)).series
    fit = fit_whole_runs([series])
    # The same rows through the same code: no difference but rounding is expected.
    assert estimate.tau_s == pytest.approx(fit.time_constant_s_, rel=1e-6)
    assert estimate.tau_stderr_s == pytest.approx(fit.time_constant_stderr_s_, rel=1e-4)
    curve, stderr = fit.characteristic(np.array(estimate.phi))
    assert np.allclose(estimate.psi_p, curve, rtol=1e-6)
    assert np.allclose(estimate.psi_p_stderr, stderr, rtol=1e-4)


def test_the_switches_of_the_reduction_are_those_of_its_estimate(record: LiveRecord) -> None:
    columns = feed_columns(record.names, record.test)
    rows, start_s = columns.readings(record.values), float(columns.time_s(record.values)[0])
    settings = ReductionSettings(probes="tip", window_s=(1.0, 2.6))
    estimate = estimate_of(columns, rows, start_s, settings)
    fit = fit_whole_runs(
        [reduce_record(columns.record(rows, start_s), record.test, settings).series]
    )
    assert estimate.tau_s == fit.time_constant_s_
    assert estimate.tau_s != estimate_of(columns, rows, start_s).tau_s
    assert (estimate.from_s, estimate.to_s) == (1.0, 2.6)


@pytest.mark.parametrize("seed", range(4))
def test_the_truth_is_within_its_stated_error_as_cycles_come(tmp_path: Path, seed: int) -> None:
    record = made_record(tmp_path / "rig", "985", seed, seconds=4.0)
    estimates = [estimated(record, n) for n in (2200, 3000, 4000)]
    assert all(not e.why_not for e in estimates)
    assert [e.n_cycles for e in estimates] == sorted(e.n_cycles for e in estimates)
    for estimate in estimates:
        assert abs(estimate.tau_s - TAU_S) < 4.0 * estimate.tau_stderr_s
    last = estimates[-1]
    assert abs(last.tau_s - TAU_S) < 0.003
    # With half of the cycles it is that far from the end; measured: 1.6 errors at most.
    assert abs(estimates[0].tau_s - last.tau_s) < 2.5 * estimates[0].tau_stderr_s


def test_before_there_are_three_cycles_it_says_so(record: LiveRecord) -> None:
    assert "surge" in estimated(record, 250).why_not
    assert "at least 3 surge cycles" in estimated(record, 450).why_not or estimated(
        record, 450
    ).why_not.endswith("of its mean")


def test_a_blowdown_has_no_time_constant_and_says_so(tmp_path: Path) -> None:
    record = made_record(tmp_path / "rig", "blowdown", 0, seconds=4.0)
    estimate = estimated(record, len(record.values))
    assert estimate.why_not
    assert np.isnan(estimate.tau_s)


class Recorded(NoEstimate):
    """An estimator that gives what it was told to give."""

    def __init__(self, estimates: list[Estimate | None]) -> None:
        self.estimates = estimates
        self.asked = 0

    def ask(self) -> None:
        self.asked += 1

    def poll(self) -> Estimate | None:
        return self.estimates.pop(0) if self.estimates else None


def test_it_is_asked_for_behind_every_cycle_and_kept_behind_a_gap(record: LiveRecord) -> None:
    columns = feed_columns(record.names, record.test)
    good, bad = Estimate(tau_s=0.018, tau_stderr_s=0.001, n_cycles=9), Estimate("no near stall")
    estimator = Recorded([None, bad, good, bad])
    monitor = Monitor(columns, estimator)
    monitor.take(columns.time_s(record.values), columns.readings(record.values))
    assert estimator.asked == monitor.n_cycles > 5
    notes = [monitor.poll() for _ in range(4)]
    assert monitor.estimate == good
    assert [len(n) for n in notes] == [0, 0, 1, 0]
    assert "18.0 ± 1.0 ms, provisional, 9 cycles" in notes[2][0][1]


@pytest.fixture(scope="module")
def columns(record: LiveRecord) -> FeedColumns:
    return feed_columns(record.names, record.test)


def test_the_process_gives_the_same_and_ends_with_the_session(
    record: LiveRecord, columns: FeedColumns
) -> None:
    time_s, readings = columns.time_s(record.values), columns.readings(record.values)
    estimator = RunningEstimate(columns)
    try:
        estimator.begin()
        estimates = []
        for stop in (2600, len(time_s)):
            start = 0 if stop == 2600 else 2600
            for first in range(start, stop, 100):
                rows = slice(first, min(first + 100, stop))
                estimator.take(time_s[rows], readings[rows])
            estimator.ask()
            estimates.append(awaited(estimator))
        # Behind a gap there is no near-stall reading any more.
        estimator.restart()
        estimator.take(time_s[2000:], readings[2000:])
        estimator.ask()
        behind = awaited(estimator)
        process = estimator._process
        process.kill()
        gone = awaited(estimator)
    finally:
        estimator.close()
    assert estimates[0].n_cycles < estimates[1].n_cycles
    whole = estimate_of(columns, readings, float(time_s[0]))
    assert estimates[1].tau_s == pytest.approx(whole.tau_s, rel=1e-9)
    assert "near_stall" in behind.why_not
    assert "has ended" in gone.why_not
    assert estimator.poll() is None
    assert not process.is_alive()


def awaited(estimator: RunningEstimate, patience_s: float = 60.0) -> Estimate:
    until_s = time.monotonic() + patience_s
    while time.monotonic() < until_s:
        estimate = estimator.poll()
        if estimate is not None:
            return estimate
        time.sleep(0.02)
    raise AssertionError("no estimate came")


def test_the_rows_it_keeps_are_bounded(
    columns: FeedColumns, record: LiveRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running_estimate, "MOST_ROWS", 500)
    monkeypatch.setattr(RunningEstimate, "__init__", lambda self, columns: None)
    estimator = RunningEstimate(columns)
    reading = record.test.near_stall
    estimator._from_s, estimator._to_s = reading.from_s - 5e-4, reading.to_s
    estimator.restart()
    time_s, readings = columns.time_s(record.values), columns.readings(record.values)
    for first in range(0, len(time_s), 100):
        estimator.take(time_s[first : first + 100], readings[first : first + 100])
    assert sum(len(rows) for rows in estimator._pending) == 600
