"""Channels of a slower logger, held on the clock of a faster one: found, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from clean_records import CLEAN, clean_record, with_channels

from classic_ml.faults.plateaus import check_held, held_rows
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError
from surge_core.types import FloatArray

QUICK = ("985/1", "75-stall/1", "made/1/1")


def hold(rows: int, first: int = 0) -> Callable[[FloatArray], FloatArray]:
    """Keep every so many-th value, the first one from a row on, until the next one comes."""

    def held(values: FloatArray) -> FloatArray:
        return values[np.maximum((np.arange(values.size) - first) // rows * rows + first, 0)]

    return held


def found_in(record: Record, names: Sequence[str]) -> dict[str, int]:
    return {name: held_rows(record[name]) for name in names}


@pytest.mark.parametrize("name", CLEAN)
def test_no_clean_record_is_held(name: str) -> None:
    record, test = clean_record(name)
    found = found_in(record, test.channel_names)
    assert set(found.values()) == {1}
    check_held(record, test)


@pytest.mark.parametrize("rows", [2, 3, 4, 10])
@pytest.mark.parametrize("name", QUICK)
def test_whole_factors_are_read_off_in_every_channel(name: str, rows: int) -> None:
    record, test = clean_record(name)
    held = with_channels(record, hold(rows, first=1), "")
    assert found_in(held, test.channel_names) == dict.fromkeys(test.channel_names, rows)


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


def test_pressures_held_alike_are_late_alike_and_pass() -> None:
    record, test = clean_record("985/1")
    check_held(with_channels(record, hold(2), "P"), test)
    # So are those that are late by little in seconds.
    check_held(replace(with_channels(record, hold(2), "P31"), sample_rate_hz=1e4), test)


def test_a_coarse_slow_channel_repeats_its_values_and_is_not_held() -> None:
    rng = np.random.default_rng(4)
    slow = np.cumsum(rng.normal(0.0, 0.03, 20_000))
    assert held_rows(np.round(slow)) == 1
    assert held_rows(np.round(10.0 * slow + rng.normal(0.0, 0.2, slow.size))) == 1
    # Of one that is held every change is a multiple of so many rows behind the last.
    assert held_rows(np.repeat(np.round(slow[::8]), 8)) == 8
