"""Clipped, stuck, dropped and out-of-range readings are found, named, and left out or refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from raw_data import RawTest, make_test

from classic_ml.calibration import calibrate, near_stall_match
from classic_ml.faults.choice import choose_channels
from classic_ml.faults.search import BEYOND_LIMITS, CLIPPED, STUCK, inspect_readings
from classic_ml.io import TestDescription
from classic_ml.records import Record
from surge_core.errors import InputError

Change = Callable[[np.ndarray], np.ndarray]
PROBE = "P25_A_tip_forward"


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=1.5, cells_lbm_s=8.0, noise_counts=1.5)


def spoiled(made: RawTest, name: str, change: Change) -> tuple[Record, TestDescription]:
    columns = {**made.columns, name: change(made.columns[name].copy())}
    return dataclasses.replace(made, columns=columns).load()


def chosen(record: Record, test: TestDescription) -> Record:
    record = inspect_readings(record, test)
    shifts, _ = near_stall_match(calibrate(record, test), test)
    record = calibrate(record, test, shifts)
    return choose_channels(record, test, record.rows_between(0.7, 1.4))


def between(start: int, stop: int, value: float | None = None) -> Change:
    def change(values: np.ndarray) -> np.ndarray:
        values[start:stop] = values[start] if value is None else value
        return values

    return change


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 0.5, 4.0])
def test_no_false_alarm_at_any_noise(seed: int, noise: float) -> None:
    record, test = make_test(seed=seed, seconds=1.0, noise_counts=noise, cells_lbm_s=4.0).load()
    assert inspect_readings(record, test).history[-1].flags == ()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (between(900, 930, 4095.0), CLIPPED, "30 rows clipped, 0.900 to 0.929 s"),
        (between(900, 930, 0.0), CLIPPED, "30 rows clipped"),
        (between(900, 990), STUCK, "stuck or dropped out, 0.900 to 0.989 s"),
        (between(900, 904, 2048.0), STUCK, "4 rows stuck or dropped out"),
        (between(800, 1501), STUCK, "stuck or dropped out, 0.800 to 1.500 s"),
    ],
    ids=["high", "low", "stuck", "zero drop", "dead from then on"],
)
def test_a_bad_probe_is_named_and_left_out_with_its_mate(
    made: RawTest, change: Change, kind: int, words: str
) -> None:
    record, test = spoiled(made, PROBE, change)
    out = inspect_readings(record, test)
    assert set(np.unique(out[f"fault_{PROBE}"])) == {0.0, float(kind)}
    assert [flag for flag in out.history[-1].flags if PROBE in flag and words in flag]
    kept = chosen(record, test)
    assert PROBE not in kept
    assert "P25_A_tip_aft" not in kept
    assert "P25_B_tip_forward" in kept
    (dropped,) = kept.history[-1].dropped
    assert dropped.what == "pair 25_A_tip"
    assert PROBE in dropped.why


@pytest.mark.parametrize("rows", [(400, 430), (900, 904)], ids=["outside", "few"])
def test_with_few_faults_a_probe_is_kept(made: RawTest, rows: tuple[int, int]) -> None:
    kept = chosen(*spoiled(made, PROBE, between(*rows, 4095.0)))
    assert PROBE in kept
    assert kept.history[-1].dropped == ()


def limited(made: RawTest, low: float, high: float, *names: str) -> tuple[Record, TestDescription]:
    description = {**made.description, "limits": {name: [low, high] for name in names}}
    return dataclasses.replace(made, description=description).load()


def test_an_exit_temperature_beyond_its_limits_takes_the_work_coefficient_with_it(
    made: RawTest,
) -> None:
    record, test = limited(made, 200.0, 620.0, "T31_A", "T31_B")
    out = inspect_readings(record, test)
    assert np.max(out["fault_T31_A"]) == BEYOND_LIMITS
    kept = chosen(record, test)
    assert "T31_A" not in kept
    assert [d.what for d in kept.history[-1].dropped] == ["T31_A", "T31_B", "W31 and ψ"]
    assert "beyond its limits" in kept.history[-1].dropped[0].why


def test_an_exit_temperature_that_cannot_be_matched_does_not_count(made: RawTest) -> None:
    record, test = limited(made, 200.0, 680.0, "T31_A")
    kept = chosen(record, test)
    assert "T31_A" not in kept
    assert "T31_B" in kept
    assert "at near stall, so that it cannot be matched" in kept.history[-1].dropped[0].why


def test_limits_of_a_pressure_are_in_pascal(made: RawTest) -> None:
    record, test = limited(made, 1e4, 1.1e5, PROBE)
    assert PROBE not in chosen(record, test)
    record, test = limited(made, 1e4, 3e5, PROBE)
    assert PROBE in chosen(record, test)


def test_without_any_inlet_temperature_the_record_is_refused(made: RawTest) -> None:
    record, test = limited(made, 100.0, 300.0, "T25_A", "T25_B")
    with pytest.raises(InputError, match=r"channel T25_A: .* last thermocouple of plane 25"):
        chosen(record, test)


def test_a_short_gap_of_a_thermocouple_is_bridged(made: RawTest) -> None:
    record, test = spoiled(made, "T25_A", between(900, 906, 900.0))
    test = dataclasses.replace(test, limits={"T25_A": (200.0, 620.0)})
    kept = chosen(record, test)
    inside = kept["T25_A"][900:906]
    ends = kept["T25_A"][899], kept["T25_A"][906]
    assert min(ends) <= inside.min() <= inside.max() <= max(ends)


def test_faults_that_touch_one_another_and_the_ends_are_all_marked(made: RawTest) -> None:
    def change(values: np.ndarray) -> np.ndarray:
        values[900:960], values[960:1020] = 2000.0, 2010.0
        values[1440:] = values[1440]
        return values

    record, test = spoiled(made, PROBE, change)
    mark = inspect_readings(record, test)[f"fault_{PROBE}"]
    assert np.all(mark[900:1020] == STUCK)
    assert np.all(mark[1440:] == STUCK)
    assert np.count_nonzero(mark) == 120 + 61
