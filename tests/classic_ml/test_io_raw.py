"""Raw records: what is read is what was recorded, and every bad file gets one clear sentence."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from raw_data import RawTest, make_test, to_toml, write_csv

from classic_ml.io import read_raw
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


@pytest.fixture
def files(made: RawTest, tmp_path: Path) -> tuple[Path, Path]:
    return made.write(tmp_path)


def refusal(raw: Path, test: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_raw(raw, test)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert "expected" in sentence
    return sentence


def test_a_raw_record_is_read_as_it_was_recorded(made: RawTest, files: tuple[Path, Path]) -> None:
    record, test = read_raw(*files)
    assert record.n_samples == 501
    assert record.sample_rate_hz == 1000.0
    assert set(record.channels) == set(made.columns) - {"time_s"}
    for name, channel in record.channels.items():
        np.testing.assert_array_equal(channel.values, made.columns[name])
        assert channel.unit == ("K" if name.startswith("T") else "count")
    np.testing.assert_allclose(record.time_s, made.columns["time_s"], atol=1e-12)
    assert record.history[0].step == "read"
    assert len(test.pairs(25)) == len(test.pairs(31)) == 4
    assert {p.name for p in test.pairs(25)} == {"25_A_tip", "25_A_hub", "25_B_tip", "25_B_hub"}


Columns = dict[str, np.ndarray]
PROBE = "P31_B_hub_aft"


def _with(name: str, values: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, name: values(columns[name].astype(float))}


def _at(row: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[row] = value
        return values

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: {**c, "P99": c[PROBE]}, r'column P99: expected a table \[channels."P99"\]'),
        (_with(PROBE, _at(41, np.inf)), f"channel {PROBE}: .* inf in row 42"),
        (_with(PROBE, _at(7, -3.0)), f"{PROBE}: expected counts of a 12-bit .* -3 in row 8"),
        (_with("time_s", lambda v: v * 1.01), "expected 1000 samples a second"),
        (_with("time_s", _at(30, 0.0306)), "a uniform step"),
        (lambda c: {k: np.delete(v, 40) for k, v in c.items()}, "a step of 0.002 s after 0.039"),
        (lambda c: {k: v[:99] for k, v in c.items()}, "at least 100 rows, found 99"),
        (lambda c: {k: v[:0] for k, v in c.items()}, "rows below the header, found none"),
    ],
)
def test_a_bad_table_is_refused(
    made: RawTest, tmp_path: Path, change: Callable[[Columns], Columns], words: str
) -> None:
    raw, test = made.write(tmp_path)
    write_csv(raw, change(dict(made.columns)))
    sentence = refusal(raw, test)
    assert str(raw) in sentence
    with pytest.raises(InputError, match=words):
        read_raw(raw, test)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda text: b"", "an empty file"),
        (lambda text: bytes(range(256)) * 40, "binary data|an empty file"),
        (lambda text: text.encode()[:9000] + b"\x00\xff\xfe\x80" * 90, "binary data"),
        (lambda t: t.replace("\n", ",1.0\n").replace(",1.0\n", "\n", 1).encode(), "found 22 in"),
        (lambda t: t.replace("0.05,", "0.05,?", 1).encode(), r"P25_A_tip_forward: .* '\?\d"),
        (lambda t: t.replace("T25_A", "T25_B").encode(), "T25_B: expected each column once"),
        (
            lambda t: re.sub(r"\n(0\.011,[^,]*,)[^,]*", r"\n\1", t).encode(),
            "an empty cell in row 12",
        ),
        (lambda t: t.replace("T25_A", "").encode(), "under a name, found one without"),
        (lambda t: f"cell 7; run 12\n\n{t}".encode(), "above the header"),
    ],
)
def test_a_spoiled_file_is_refused(
    files: tuple[Path, Path], content: Callable[[str], bytes], words: str
) -> None:
    raw, test = files
    raw.write_bytes(content(raw.read_text("utf-8")))
    with pytest.raises(InputError, match=words):
        read_raw(raw, test)
    assert str(raw) in refusal(raw, test)


def long_record(folder: Path, made: RawTest, copies: int = 6) -> tuple[Path, Path]:
    """The record several times over, on one clock, as codes of 16 bits in Parquet."""
    n = made.columns["time_s"].size - 1
    columns = {
        name: np.tile(values[:n], copies).astype(np.int16 if name.startswith("P") else float)
        for name, values in made.columns.items()
    }
    columns["time_s"] = np.arange(n * copies) / 1e3
    pq.write_table(pa.table(columns), folder / "long.parquet", row_group_size=150)
    toml = folder / "test.toml"
    toml.write_text(to_toml(made.description), "utf-8")
    return folder / "long.parquet", toml


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_window_reads_its_rows_and_the_near_stall_reading(
    made: RawTest, tmp_path: Path, suffix: str
) -> None:
    raw, toml = long_record(tmp_path, made)
    if suffix == ".csv":
        pd.read_parquet(raw).to_csv(raw.with_suffix(".csv"), index=False)
    whole, test = read_raw(raw, toml)
    part, _ = read_raw(raw.with_suffix(suffix), toml, window=(0.4, 1.25))
    # The near-stall reading at the beginning is part of it, with all rows between.
    assert (part.start_s, part.n_samples) == (0.0, 1251)
    shifted = dataclasses.replace(test, near_stall_shifts={"T25_A": 0.0})
    alone, _ = read_raw(raw.with_suffix(suffix), shifted, window=(0.4, 1.25))
    assert (alone.start_s, alone.n_samples) == (0.4, 851)
    assert "a part of the file" in alone.history[0].did
    for name in whole.channels:
        np.testing.assert_array_equal(part[name], whole[name][:1251])
        np.testing.assert_array_equal(alone[name], whole[name][400:1251])
    for window in ((2.0, 1.0), (100.0, 200.0)):
        with pytest.raises(InputError, match=r"window|100\.\.\.|rows"):
            read_raw(raw, shifted, window=window)


def test_a_file_too_long_to_be_read_whole_is_read_by_its_window(
    made: RawTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw, toml = long_record(tmp_path, made)
    monkeypatch.setattr("classic_ml.io.raw.MOST_VALUES", 2000 * 21)
    with pytest.raises(InputError, match=r"at most 2000 rows of 21 columns.*--from-s"):
        read_raw(raw, toml)
    assert read_raw(raw, toml, window=(0.2, 1.0))[0].n_samples == 1001
    toml.write_text(to_toml({**made.description, "window": {"from_s": 0.2, "to_s": 1.0}}), "utf-8")
    assert read_raw(raw, toml)[0].n_samples == 1001
    # What can be read whole is, whatever the window of its quasi-steady cycles.
    monkeypatch.setattr("classic_ml.io.raw.MOST_VALUES", 10**9)
    assert read_raw(raw, toml)[0].n_samples == 3000


def test_a_row_at_fault_behind_the_start_of_a_window_has_its_number_in_the_file(
    made: RawTest, tmp_path: Path
) -> None:
    raw, _ = long_record(tmp_path, made)
    table = pd.read_parquet(raw).astype(float)
    table.loc[899, "P31_A_tip_aft"] = np.nan
    table.to_parquet(raw, index=False)
    test = dataclasses.replace(read_raw(*made.write(tmp_path))[1], near_stall_shifts={"T25_A": 0.0})
    with pytest.raises(InputError, match=r"P31_A_tip_aft: .* in row 900"):
        read_raw(raw, test, window=(0.8, 1.25))
    assert read_raw(raw, test, window=(1.0, 1.25))[0].n_samples == 251
