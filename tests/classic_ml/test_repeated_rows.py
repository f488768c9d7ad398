"""Rows written twice under a clock that was made anew are found to the row, and no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clean_records import CLEAN, clean_record, rows_of, with_channels

from classic_ml.columns import workspace
from classic_ml.columns.workspace import OnDisk
from classic_ml.faults.repeated_rows import (
    WINDOW,
    _mix,
    _mix_numbers,
    repeated_rows,
    rows_repeated,
)
from classic_ml.records import Channel, FloatArray
from classic_ml.reduction import reduce_record

# Behind the steady part, in which rows without noise are alike.
STARTS = (700, 1500, 2201)


@pytest.mark.parametrize("name", CLEAN)
def test_no_row_of_a_clean_record_is_there_twice(name: str) -> None:
    record, test = clean_record(name)
    found = rows_repeated(record, test)
    assert (len(found.still), len(found.again)) == (0, 0)
    assert repeated_rows(record, test) == []


@pytest.mark.parametrize("length", [2, 10, 100, 500])
@pytest.mark.parametrize("name", CLEAN)
def test_a_block_that_is_there_twice_is_found_to_the_row(name: str, length: int) -> None:
    record, test = clean_record(name)
    for start in STARTS:
        stop = start + length
        twice = rows_of(record, np.r_[0:stop, start : record.n_samples])
        assert rows_repeated(twice, test).again.tolist() == [[stop, stop + length, length]]


@pytest.mark.parametrize("times", [1, 3])
@pytest.mark.parametrize("name", CLEAN)
def test_a_row_that_is_there_again_is_found(name: str, times: int) -> None:
    record, test = clean_record(name)
    for row in STARTS:
        again = rows_of(record, np.r_[0 : row + 1, [row] * times, row + 1 : record.n_samples])
        assert rows_repeated(again, test).still.tolist() == [[row + 1, row + 1 + times]]


def test_the_flags_say_when_and_what_it_is() -> None:
    record, test = clean_record("985/1")
    twice = rows_of(record, np.r_[0:2000, 1900 : record.n_samples])
    (flag,) = repeated_rows(twice, test)
    assert flag.startswith("100 rows repeat earlier ones to the last digit in all 20 channels")
    assert "2.000 to 2.099 s those of 0.1 s before" in flag
    # One place that is there again, and four more.
    often = np.sort(np.r_[0 : record.n_samples, 1000:3500:500])
    (flag,) = repeated_rows(rows_of(record, often), test)
    assert flag.startswith(
        "5 rows repeat the readings of the row before in all pressures, at 1.001"
    )
    assert "2 more places" in flag


def test_a_reduction_flags_them_and_goes_on() -> None:
    record, test = clean_record("985/1")
    twice = rows_of(record, np.r_[0:2000, 1900 : record.n_samples])
    told = [flag for entry in reduce_record(twice, test).record.history for flag in entry.flags]
    assert any("100 rows repeat earlier ones" in flag for flag in told)


def test_a_record_of_copies_of_some_cycles_is_one_finding() -> None:
    record, test = clean_record("985/1")
    tiled = rows_of(record, np.r_[0:1200, np.tile(np.arange(1200, 3000), 4)])
    assert rows_repeated(tiled, test).again.tolist() == [[3000, 8400, 1800]]
    (flag,) = repeated_rows(tiled, test)
    assert "copies of one piece" in flag


def test_one_channel_that_differs_is_enough() -> None:
    """Neighbouring rows of all pressures are enough to go by, a block is one of all channels."""
    record, test = clean_record("985/1")
    twice = rows_of(record, np.r_[0:2000, 1900 : record.n_samples])

    def changed(values: FloatArray) -> FloatArray:
        values[2000:2100] += 1.0
        return values

    other = with_channels(twice, changed, "P25_A_tip_aft")
    assert repeated_rows(other, test) == []


def test_channels_that_are_all_held_are_no_repeated_rows() -> None:
    record, test = clean_record("985/1")
    pairs = rows_of(record, np.arange(record.n_samples) // 2 * 2)
    assert rows_repeated(pairs, test).still.size == 0


def test_a_block_further_away_than_the_window_is_not_looked_for() -> None:
    record, test = clean_record("made/1/1")
    rng = np.random.default_rng(3)
    once = np.r_[0:2000, 500:800]
    far = WINDOW + 100

    def between(values: FloatArray) -> FloatArray:
        filling = np.round(rng.normal(2000.0, 300.0, far))
        return np.concatenate((values[:2000], filling, values[500:800]))

    assert rows_repeated(rows_of(record, once), test).again.tolist() == [[2000, 2300, 1500]]
    channels = {
        n: Channel(n, between(np.array(c.values)), c.unit) for n, c in record.channels.items()
    }
    assert rows_repeated(replace(record, channels=channels), test).again.size == 0


def test_blocks_and_places_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    record, test = clean_record("90/1")
    order = np.sort(np.r_[0:2000, [900, 1200]])
    record = rows_of(record, np.r_[order, 1900:4001, 1900:3000])
    whole = rows_repeated(record, test)
    assert len(whole.still) >= 2
    assert len(whole.again) >= 2
    for block in (1, 7, 640, 1001):
        monkeypatch.setattr(workspace, "BLOCK_ROWS", block)
        found = rows_repeated(record, test)
        np.testing.assert_array_equal(found.still, whole.still)
        np.testing.assert_array_equal(found.again, whole.again)
    disk = OnDisk()

    def computed(channel: Channel) -> Channel:
        values = channel.values
        column = disk.derived(values.size, lambda part: values[part].copy())
        return Channel(channel.name, column, channel.unit)

    channels = {name: computed(c) for name, c in record.channels.items()}
    found = rows_repeated(replace(record, channels=channels, workspace=disk), test)
    np.testing.assert_array_equal(found.again, whole.again)


def test_a_reading_has_one_hash_however_it_is_stored() -> None:
    """Which rows share a place of the table is in the finding: in memory and on disk the same."""
    codes = np.array([0, 1, 1409, 4095, 65535], dtype=np.uint16)
    hashes = [np.arange(5, dtype=np.uint64) for _ in range(2)]
    _mix(codes, hashes[0])
    numbers = codes.astype(np.float64)
    _mix_numbers(numbers, numbers.view(np.uint64), hashes[1])
    np.testing.assert_array_equal(*hashes)
    others = np.array([-1.0, 0.5, 65536.0, 1409.25, 1e300])
    found = np.zeros(5, dtype=np.uint64)
    _mix_numbers(others, others.view(np.uint64), found)
    assert np.unique(found).size == 5
    assert not set(found) & set(hashes[0])


def test_copies_with_odd_rows_are_told_alike_in_memory_and_on_disk(tmp_path: Path) -> None:
    record, test = clean_record("985/1")
    copied = rows_of(record, np.r_[0:3000, np.tile(np.arange(1000, 3000), 20)])
    odd = copied["P31_A_tip_forward"].copy()
    odd[np.random.default_rng(0).integers(3000, odd.size, 60)] = 4095.0
    copied = with_channels(copied, lambda _: odd, "P31_A_tip_forward")
    place = OnDisk(tmp_path)

    def stored(channel: Channel) -> Channel:
        writer = place.readings_writer(channel.values.size)
        writer.append(channel.values)
        return Channel(channel.name, writer.finished(), channel.unit)

    channels = {name: stored(channel) for name, channel in copied.channels.items()}
    on_disk = replace(copied, channels=channels, workspace=place)
    assert repeated_rows(on_disk, test) == repeated_rows(copied, test) != []
