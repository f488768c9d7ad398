"""Channels of a slower logger, held on the clock of a faster one: found, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from clean_records import CLEAN, clean_record, with_channels

from classic_ml.faults.held import check_held, held_rows
from classic_ml.records import FloatArray, Record
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError

QUICK = ("985/1", "75-stall/1", "made/1/1")


def hold(rows: float, first: int = 0) -> Callable[[FloatArray], FloatArray]:
    """Keep every so many-th value, the first one from a row on, until the next one comes."""

    def held(values: FloatArray) -> FloatArray:
        number = np.floor((np.arange(values.size) - first) / rows + 1e-9)
        return values[np.maximum(np.ceil(number * rows + first - 1e-9), 0).astype(int)]

    return held


def found_in(record: Record, names: Sequence[str]) -> dict[str, float]:
    return {name: held_rows(record[name]) for name in names}


@pytest.mark.parametrize("name", CLEAN)
def test_no_clean_record_is_held(name: str) -> None:
    record, test = clean_record(name)
    found = found_in(record, test.channel_names)
    assert set(found.values()) == {1.0}
    assert check_held(record, test) == []


@pytest.mark.parametrize("rows", [2, 3, 4, 10])
@pytest.mark.parametrize("name", QUICK)
def test_whole_factors_are_read_off_in_every_channel(name: str, rows: int) -> None:
    record, test = clean_record(name)
    held = with_channels(record, hold(rows, first=1), "")
    assert found_in(held, test.channel_names) == dict.fromkeys(test.channel_names, rows)


@pytest.mark.parametrize("rows", [1.5, 2.5])
@pytest.mark.parametrize("name", ["985/1", "90/1", "made/2/5"])
def test_rates_that_do_not_divide_are_found_as_averages(name: str, rows: float) -> None:
    record, test = clean_record(name)
    held = with_channels(record, hold(rows), "P")
    found = found_in(held, [p.name for p in test.pressures])
    assert np.median(list(found.values())) == pytest.approx(rows, rel=0.05)
    assert min(found.values()) > 1.0


@pytest.mark.parametrize("rows", [2, 3])
@pytest.mark.parametrize("plane", ["P25", "P31", "P25_A_tip_aft"])
@pytest.mark.parametrize("name", ["985/1", "90/1", "blowdown/1", "75-stall/1", "made/1/1"])
def test_pressures_held_for_different_times_are_refused(name: str, plane: str, rows: int) -> None:
    record, test = clean_record(name)
    with pytest.raises(InputError) as refused:
        reduce_record(with_channels(record, hold(rows), plane), test)
    assert f"channel {plane}" in str(refused.value)
    assert f"each value {rows} times" in str(refused.value)
    assert "late" in str(refused.value)


def test_pressures_held_alike_and_thermocouples_are_flagged() -> None:
    record, test = clean_record("985/1")
    pressures = with_channels(record, hold(2), "P")
    (flag,) = (found.sentence for found in check_held(pressures, test))
    assert flag.startswith("channel P25_A_tip_forward: each value is there 2 times")
    assert "500 samples a second" in flag
    couples = with_channels(record, hold(4), "T25")
    (flag,) = (found.sentence for found in check_held(couples, test))
    assert flag.startswith("channel T25_A: each value is there 4 times")


def test_a_hold_that_is_short_in_seconds_is_flagged_alone() -> None:
    record, test = clean_record("985/1")
    held = with_channels(record, hold(2), "P31")
    quick = replace(held, sample_rate_hz=1e4)
    (found,) = check_held(quick, test)
    assert "each value is there 2 times" in found.sentence


def test_a_coarse_slow_channel_repeats_its_values_and_is_not_held() -> None:
    rng = np.random.default_rng(4)
    slow = np.cumsum(rng.normal(0.0, 0.03, 20_000))
    assert held_rows(np.round(slow)) == 1.0
    assert held_rows(np.round(10.0 * slow + rng.normal(0.0, 0.2, slow.size))) == 1.0
    # Of one that is held every change is a multiple of so many rows behind the last.
    assert held_rows(np.repeat(np.round(slow[::8]), 8)) == 8.0
