"""What a file says of its clock is heeded, whatever test.toml takes for the time of a row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from raw_data import RawTest, make_test, to_toml, write_csv

from classic_ml.inspection import inspect_file
from classic_ml.inspection_draft import draft_test_toml
from classic_ml.readers import read_raw
from classic_ml.readers.iso_stamps import stamp_of
from classic_ml.readers.raw_formats import open_stored
from surge_core.errors import InputError

Columns = dict[str, np.ndarray]
FROM_RATE = {"clock": "from rate"}
NOON = np.datetime64("2024-05-01T12:00:00.000000")
MS = np.timedelta64(1, "ms")
STEP = {"wf_increment": 1e-3}


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


def described(folder: Path, made: RawTest, file: dict[str, Any] | None = None) -> Path:
    path = folder / "test.toml"
    tables = {**made.description, **({"file": file} if file is not None else {})}
    path.write_text(to_toml(tables), "utf-8")
    return path


def write_tdms(
    path: Path, columns: Columns, properties: Callable[[str], dict[str, Any]], *, clock: bool
) -> None:
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("run", name, values, properties(name))
                for name, values in columns.items()
                if clock or name != "time_s"
            ]
        )


def late(key: str, on_time: Any, then: Any) -> Callable[[str], dict[str, Any]]:
    """Properties in which plane 31 differs."""
    return lambda name: {**STEP, key: then if name.startswith("P31") else on_time}


@pytest.mark.parametrize("way", ["made", "column", "from rate"])
@pytest.mark.parametrize(
    ("properties", "words"),
    [
        (late("wf_start_time", NOON, NOON + 20 * MS), "starts 0.02 s later"),
        (late("wf_start_time", NOON, NOON - 20 * MS), "starts 0.02 s earlier"),
        (late("wf_start_offset", 0.0, 0.02), "starts 0.02 s later"),
        (late("wf_increment", 1e-3, 2e-3), "steps by 0.002 s where the first steps by 0.001 s"),
    ],
)
def test_channels_that_were_not_sampled_together_are_refused(
    made: RawTest, tmp_path: Path, properties: Any, words: str, way: str
) -> None:
    path = tmp_path / "raw.tdms"
    write_tdms(path, made.columns, properties, clock=way == "column")
    test = described(tmp_path, made, FROM_RATE if way == "from rate" else None)
    with pytest.raises(InputError, match=f"P25_A_tip_forward and P31_A_tip_forward: .*{words}"):
        read_raw(path, test)
    assert words in inspect_file(path).sampled_apart


def test_starts_that_say_the_same_in_two_ways_are_one(made: RawTest, tmp_path: Path) -> None:
    """A date and an offset that make one moment; a skew of no account."""
    path = tmp_path / "raw.tdms"

    def properties(name: str) -> dict[str, Any]:
        if name.startswith("P31"):
            return {**STEP, "wf_start_time": NOON - 20 * MS, "wf_start_offset": 0.02}
        skew = np.timedelta64(2, "us") if name.startswith("T") else np.timedelta64(0, "us")
        return {**STEP, "wf_start_time": NOON + skew}

    write_tdms(path, made.columns, properties, clock=True)
    record, _ = read_raw(path, described(tmp_path, made))
    np.testing.assert_array_equal(record["P31_A_hub_aft"], made.columns["P31_A_hub_aft"])
    assert inspect_file(path).sampled_apart == ""


def test_channels_that_nobody_reads_may_start_when_they_like(made: RawTest, tmp_path: Path) -> None:
    path = tmp_path / "raw.tdms"
    columns = {"other": made.columns["T25_A"], **made.columns}
    write_tdms(
        path, columns, lambda n: {"wf_increment": 5e-4 if n == "other" else 1e-3}, clock=False
    )
    record, _ = read_raw(path, described(tmp_path, made, {"other_columns": "ignore"}))
    assert record.n_samples == 501


def test_a_step_of_the_file_that_is_not_the_rate_is_refused(made: RawTest, tmp_path: Path) -> None:
    path, test = tmp_path / "raw.tdms", described(tmp_path, made, FROM_RATE)
    write_tdms(path, made.columns, lambda _: {"wf_increment": 2e-3}, clock=False)
    with pytest.raises(InputError, match=r"expected 1000 samples .* found 500 by its wf_increment"):
        read_raw(path, test)
    # What LabVIEW writes where nobody has set a step.
    write_tdms(path, made.columns, lambda _: {"wf_increment": 1.0}, clock=False)
    assert read_raw(path, test)[0].sample_rate_hz == 1000.0


def dated(columns: Columns, *, index: str | None, gap: bool = False) -> pd.DataFrame:
    frame = pd.DataFrame({n: v for n, v in columns.items() if n != "time_s"})
    ticks = np.round(columns["time_s"] * 1e6).astype("timedelta64[us]")
    frame.index = pd.DatetimeIndex(NOON + ticks, name=index)
    return frame.drop(frame.index[200:347]) if gap else frame


@pytest.mark.parametrize("index", [None, "Recorded"])
def test_a_gap_in_a_clock_that_is_passed_over_is_seen(
    made: RawTest, tmp_path: Path, index: str | None
) -> None:
    path, test = tmp_path / "raw.parquet", described(tmp_path, made, FROM_RATE)
    dated(made.columns, index=index).to_parquet(path)
    record, _ = read_raw(path, test)
    np.testing.assert_array_equal(record["T25_A"], made.columns["T25_A"])
    dated(made.columns, index=index, gap=True).to_parquet(path)
    with pytest.raises(InputError, match=r"step of 0\.148 where others have 0.001, before row 201"):
        read_raw(path, test)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t, ""),
        (lambda t: 1e3 * t, ""),
        (lambda t: np.arange(t.size) + 5.0, ""),
        # Too coarse, or too uneven, to tell anything.
        (lambda t: np.round(t, 2), ""),
        (lambda t: t + np.random.default_rng(1).uniform(0.0, 9e-3, t.size), ""),
        (np.zeros_like, ""),
        (lambda t: 2.0 * t, "expected 1000 samples a second, .* found 500"),
        (lambda t: t + 0.02 * (t > 0.3), "a step of 0.021 where others have 0.001, before row 302"),
    ],
)
def test_a_clock_that_is_passed_over_is_believed_where_it_is_even(
    made: RawTest, tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    path, test = tmp_path / "raw.csv", described(tmp_path, made, FROM_RATE)
    write_csv(path, {**made.columns, "time_s": change(made.columns["time_s"])})
    if not words:
        assert read_raw(path, test)[0].n_samples == 501
        return
    with pytest.raises(InputError, match=f"column time_s: .*{words}"):
        read_raw(path, test)


def stamped(columns: Columns, text: Callable[[pd.Timestamp], str], path: Path) -> None:
    frame = pd.DataFrame({n: v for n, v in columns.items() if n != "time_s"})
    ticks = np.round(columns["time_s"] * 1e9).astype("timedelta64[ns]")
    stamps = pd.DatetimeIndex(np.datetime64("2024-05-01T23:59:59.8", "ns") + ticks)
    frame.insert(0, "Stamp", [text(stamp) for stamp in stamps])
    frame.to_csv(path, index=False)


@pytest.mark.parametrize("chunk", [None, 13])
@pytest.mark.parametrize(
    "text",
    [
        # Python leaves a fraction of zero away, and the last of these is past midnight.
        lambda stamp: stamp.isoformat(),
        lambda stamp: stamp.isoformat(sep=" ", timespec="nanoseconds"),
        lambda stamp: stamp.isoformat() + "Z",
        lambda stamp: f"{stamp.isoformat()}+02:00",
    ],
)
def test_dates_in_a_csv_table_are_a_clock(
    made: RawTest, tmp_path: Path, text: Callable[[pd.Timestamp], str], chunk: int | None
) -> None:
    """The times of a printed clock, to the last bit, in pieces of any size."""
    path = tmp_path / "raw.csv"
    stamped(made.columns, text, path)
    test = described(tmp_path, made, {"time": "Stamp"})
    stored = open_stored(path)
    times = np.concatenate([block[:, 0] for block in stored.chunks(chunk or 9999)])
    np.testing.assert_array_equal(times, np.arange(501) / 1000.0)
    record, _ = read_raw(path, test)
    assert "seconds from the first sample at 2024-05-01" in record.history[0].did
    np.testing.assert_array_equal(record["T31_B"], made.columns["T31_B"])


def test_dates_are_drafted_as_the_clock(made: RawTest, tmp_path: Path) -> None:
    path = tmp_path / "raw.csv"
    stamped(made.columns, lambda stamp: stamp.isoformat(), path)
    inspection = inspect_file(path)
    assert inspection.clock is not None
    assert inspection.clock.about.startswith("seconds from the first sample at 2024-05-01T23:59")
    draft = draft_test_toml(inspection)
    assert 'time = "Stamp"' in draft
    assert "sample_rate_hz = 1000.0" in draft


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        (
            "yesterday",
            "Stamp: expected a date and time in every row, without .* 'yesterday' in row",
        ),
        ("2024-05-01T12:00:00Z", "without a zone as in row 1, found '2024-05-01T12:00:00Z' in row"),
        ("", "an empty cell in row 40"),
    ],
)
def test_a_cell_that_is_no_date_is_named(
    made: RawTest, tmp_path: Path, cell: str, words: str
) -> None:
    path = tmp_path / "raw.csv"
    stamped(made.columns, lambda stamp: stamp.isoformat(), path)
    lines = path.read_text("utf-8").splitlines()
    lines[40] = ",".join([cell, *lines[40].split(",")[1:]])
    path.write_text("\n".join(lines), "utf-8")
    with pytest.raises(InputError, match=words):
        read_raw(path, described(tmp_path, made, {"time": "Stamp"}))
    # The slow look goes on with the numbers of the quick one.
    found = inspect_file(path)
    stamp = found.channel("Stamp")
    assert stamp is not None
    assert (stamp.not_finite, stamp.first_not_finite, stamp.maximum) == (1, 40, 0.5)


@pytest.mark.parametrize(
    ("text", "ticks"),
    [
        ("1970-01-01T00:00:01", 10**9),
        ("1969-12-31 23:59:59.999999999", -1),
        ("2024-05-01T14:00:00.25+02:00", 1714564800 * 10**9 + 25 * 10**7),
        ("2024-02-30T00:00:00", None),
        ("3024-02-03T00:00:00", None),
        ("12:00:00", None),
        ("2024-05-01T12:00:00.0123456789", None),
    ],
)
def test_dates_are_whole_nanoseconds(text: str, ticks: int | None) -> None:
    found = stamp_of(text)
    assert (None if found is None else found[0]) == ticks


NOTES = ["ok", 'he said "now, then"', "", "a, b", "5 °C", "nan"]


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("quick", [True, False])
def test_what_nobody_asked_for_is_not_parsed(
    made: RawTest, tmp_path: Path, encoding: str, quick: bool
) -> None:
    path = tmp_path / "raw.csv"
    frame = pd.DataFrame(made.columns)
    frame.insert(3, "Note", [NOTES[row % len(NOTES)] for row in range(len(frame))])
    frame.to_csv(path, index=False, encoding=encoding)
    if not quick:
        # Where the quick look stumbles, the slow one goes on.
        text = path.read_bytes().replace(b"\n0.05,", b"\n+0.05,")
        path.write_bytes(text)
    record, _ = read_raw(path, described(tmp_path, made, {"other_columns": "ignore"}))
    for name in ("P25_A_hub_forward", "T31_B"):
        np.testing.assert_array_equal(record[name], made.columns[name])
    with pytest.raises(InputError, match=r"channel Note: expected a table \[channels.Note\]"):
        read_raw(path, described(tmp_path, made))


@pytest.mark.parametrize("quick", [True, False])
@pytest.mark.parametrize(
    ("separator", "decimal", "end"),
    [(";", ",", "\n"), (";", ".", "\r\n"), ("\t", ".", "\n"), ("\t", ",", "\n"), (",", ".", "\r")],
)
def test_tables_of_other_countries_are_read(
    made: RawTest, tmp_path: Path, separator: str, decimal: str, end: str, quick: bool
) -> None:
    """Semicolons, tabs, decimal commas and the line ends of an old Macintosh; the same numbers."""
    rng = np.random.default_rng(3)
    columns = {**made.columns, "T25_A": 255.0 + rng.normal(size=501)}
    write_csv(tmp_path / "plain.csv", columns)
    text = (tmp_path / "plain.csv").read_text("utf-8")
    if not quick:
        text = text.replace("\n0.05,", "\n+0.05,")
    if separator != ",":
        text = text.replace(",", separator).replace(".", decimal)
    path = tmp_path / "raw.csv"
    path.write_bytes(text.replace("\n", end).encode())
    record, _ = read_raw(path, described(tmp_path, made))
    for name in ("P25_A_hub_forward", "T25_A"):
        np.testing.assert_array_equal(record[name], columns[name])
