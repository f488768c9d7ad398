"""Codes that end within the range that test.toml states are found, and count as clipped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clean_records import CLEAN, clean_record, with_channels

from classic_ml.columns import workspace
from classic_ml.faults.converter_range import CodeRange, codes_seen
from classic_ml.faults.marks import CLIPPED
from classic_ml.faults.search import inspect_readings
from classic_ml.faults.standstill import tallies
from classic_ml.io import TestDescription
from classic_ml.records import FloatArray, Record

# Records of which some readings are clipped, in the blowdown alone.
CLIPPING = ("985/1", "90/1", "blowdown/1", "independent")


def with_bits(test: TestDescription, bits: int) -> TestDescription:
    assert test.converter is not None
    return replace(test, converter=replace(test.converter, bits=bits))


def seen(record: Record, test: TestDescription) -> CodeRange:
    return codes_seen(record, test, tallies(record, test.channel_names))


def clipped_rows(record: Record, test: TestDescription) -> dict[str, list[int]]:
    inspected = inspect_readings(record, test, whole=True)
    return {
        name: np.flatnonzero(inspected[f"fault_{name}"].astype(int) & CLIPPED).tolist()
        for name in test.channel_names
        if f"fault_{name}" in inspected and name.startswith("P")
    }


@pytest.mark.parametrize("name", CLEAN)
def test_a_clean_record_is_as_stated(name: str) -> None:
    record, test = clean_record(name)
    found = seen(record, test)
    assert (found.test, found.ends, found.flags) == (test, {}, ())


@pytest.mark.parametrize("bits", [13, 14, 16])
@pytest.mark.parametrize("name", CLIPPING)
def test_too_many_bits_are_told_and_clipped_codes_count_all_the_same(name: str, bits: int) -> None:
    record, test = clean_record(name)
    wide = with_bits(test, bits)
    found = seen(record, wide)
    (flag,) = found.flags
    assert "no code is above 4095" in flag
    assert "is the converter one of 12 bits?" in flag
    assert found.test == test
    whole = clipped_rows(record, test)
    assert whole
    assert clipped_rows(record, wide) == whole


@pytest.mark.parametrize("name", ["95/1", "made/1/1", "75-stall/1"])
def test_a_record_that_reaches_no_end_tells_nothing(name: str) -> None:
    record, test = clean_record(name)
    wide = with_bits(test, 16)
    assert seen(record, wide) == CodeRange(wide, {}, ())


@pytest.mark.parametrize("unused", [1, 2, 4])
@pytest.mark.parametrize("name", CLIPPING)
def test_codes_written_to_the_left_of_their_word_end_short_of_it(name: str, unused: int) -> None:
    record, test = clean_record(name)
    step = 2**unused
    left = with_channels(record, lambda v: v * step, "P")
    wide = with_bits(test, 12 + unused)
    (flag,) = seen(left, wide).flags
    assert f"no code is above {4096 * step - step}" in flag
    assert f"all go by {step}" in flag
    assert "is the converter one of 12 bits?" in flag
    lower = {n: [r for r in rows if left[n][r] > 0] for n, rows in clipped_rows(left, wide).items()}
    assert lower == clipped_rows(record, test)


def test_a_common_end_within_the_range_counts_as_clipped() -> None:
    record, test = clean_record("985/1")
    names = ("P25_A_tip_aft", "P25_B_tip_aft")
    cut = with_channels(record, lambda v: np.minimum(v, 3300.0), *names)
    found = seen(cut, test)
    assert set(found.ends) == set(names)
    (flag,) = found.flags
    assert "P25_A_tip_aft and 1 more are cut off at code 3300 alike" in flag
    rows = clipped_rows(cut, test)
    for name in names:
        assert rows[name] == np.flatnonzero(cut[name] == 3300.0).tolist()


def test_one_steady_channel_at_a_round_code_is_no_end() -> None:
    """Near stall a quiet channel stands still at its largest code, which may be any."""
    record, test = clean_record("75-stall/1")

    def steady(values: FloatArray) -> FloatArray:
        values[:] = np.minimum(values, 2000.0)
        values[:300] = 2047.0
        return values

    spoiled = with_channels(record, lambda v: np.minimum(v, 2000.0), "P")
    spoiled = with_channels(spoiled, steady, "P31_A_tip_forward")
    assert seen(spoiled, test).test == test


def test_blocks_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    record, test = clean_record("985/1")
    wide = with_bits(test, 16)
    cut = with_channels(record, lambda v: np.minimum(v, 3300.0), "P25")
    whole = seen(record, wide), seen(cut, test)
    assert whole[1].ends
    for block in (7, 640):
        monkeypatch.setattr(workspace, "BLOCK_ROWS", block)
        assert (seen(record, wide), seen(cut, test)) == whole
