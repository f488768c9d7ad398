"""A record reduced chunk by chunk gives the numbers of the record in one piece, to the last bit."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from classic_ml.columns.computed import ComputedColumn
from classic_ml.columns.workspace import IN_MEMORY, OnDisk, Workspace
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_data import RawTest, make_test

from classic_ml import filtering
from classic_ml.columns import workspace as places
from classic_ml.faults import probe_agreement
from classic_ml.readers import read_raw
from classic_ml.readers.series_files import ledger_path
from classic_ml.reduction import STEPS, ReductionSettings, reduce_record
from comparisons.cli import reduce as reduce_command
from comparisons.cli.parser import EXIT_DONE, EXIT_INTERRUPTED, EXIT_UNUSABLE, main
from comparisons.cli.reduce import excerpt
from comparisons.rig import simulate, write_run
from surge_core.errors import InputError

INDEPENDENT = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "independent_rig_985"


@cache
def made() -> RawTest:
    """Cycles short enough for many of them, cells, noise, and pressures beyond the converter."""
    whole = make_test(period_s=0.09, cells_lbm_s=8.0, noise_counts=1.5, lag_thermocouples=True)
    columns = dict(whole.columns)
    # A stuck probe goes with its mate; a few clipped codes do not matter.
    columns["P31_B_hub_aft"] = np.where(columns["time_s"] > 1.1, 2000.0, columns["P31_B_hub_aft"])
    columns["P25_A_tip_forward"] = columns["P25_A_tip_forward"].copy()
    columns["P25_A_tip_forward"][[640, 641, 1500]] = 4095.0
    return dataclasses.replace(whole, columns=columns)


def cut(raw: RawTest, n_rows: int) -> RawTest:
    return dataclasses.replace(raw, columns={n: v[:n_rows] for n, v in raw.columns.items()})


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Everything that a reduction says, but for the folder it was done in."""

    said: str
    columns: dict[str, np.ndarray]


def reduced(folder: Path, chunk: int | None, place: Workspace, **given: Any) -> Outcome:
    """Reduce the record of a folder, or tell why it cannot be."""
    try:
        record, test = read_raw(
            folder / "raw.csv", folder / "test.toml", chunk_rows=chunk, workspace=place
        )
        reduction = reduce_record(record, test, ReductionSettings(**given), keep="averages")
    except InputError as error:
        return Outcome(str(error).replace(str(folder), ""), {})
    said = json.dumps([dataclasses.asdict(entry) for entry in reduction.record.history])
    channels = {f"channel {n}": c.values for n, c in reduction.record.channels.items()}
    return Outcome(
        f"{reduction.window_s} {said}".replace(str(folder), ""),
        channels | reduction.series.columns(),
    )


def assert_same(one: Outcome, other: Outcome) -> None:
    assert one.said == other.said
    assert one.columns.keys() == other.columns.keys()
    for name, values in one.columns.items():
        np.testing.assert_array_equal(values, other.columns[name], strict=True, err_msg=name)


@cache
def in_one_piece(n_rows: int, **given: Any) -> Outcome:
    with TemporaryDirectory() as name:
        cut(made(), n_rows).write(Path(name))
        return reduced(Path(name), None, IN_MEMORY, **given)


@given(
    n_rows=st.one_of(st.integers(900, 1800), st.integers(60, 1800)),
    chunk=st.integers(1, 2000),
    block=st.integers(40, 1500),
    phase=st.sampled_from(["zero", "zero", "causal", "none"]),
)
@settings(max_examples=30, deadline=None)
def test_neither_chunk_nor_block_nor_place_matters(
    n_rows: int, chunk: int, block: int, phase: str
) -> None:
    whole = in_one_piece(n_rows, phase=phase)
    with TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        folder = Path(name)
        cut(made(), n_rows).write(folder)
        patch.setattr(places, "BLOCK_ROWS", block)
        assert_same(whole, reduced(folder, chunk, OnDisk(folder), phase=phase))


def test_the_record_of_these_tests_is_reduced_and_its_faults_are_found() -> None:
    whole = in_one_piece(1800)
    assert whole.columns["segment"].max() > 3
    assert "P25_A_tip_forward: 3 rows clipped" in whole.said
    assert "pair 31_B_hub" in whole.said


def test_blocks_of_a_few_rows_give_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut(made(), 1100).write(tmp_path)
    monkeypatch.setattr(places, "BLOCK_ROWS", 11)
    small = reduced(tmp_path, 5, OnDisk(tmp_path))
    assert small.columns
    assert_same(in_one_piece(1100), small)


@pytest.mark.parametrize(
    "given",
    [
        {"stall_rule": "hub-tip"},
        {"threshold_lbm_s": "none"},
        {"hysteresis_lbm_s": 8.0},
        {"work_form": "mass-balance", "phase": "none", "thermocouple_inversion": True},
        {"window_s": (0.9, 1.6), "near_stall_match": "forward"},
    ],
    ids=str,
)
def test_each_way_through_the_reduction_gives_the_same_numbers(
    given: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut(made(), 1800).write(tmp_path)
    whole = reduced(tmp_path, None, IN_MEMORY, **given)
    assert whole.columns
    monkeypatch.setattr(places, "BLOCK_ROWS", 137)
    assert_same(whole, reduced(tmp_path, 100, OnDisk(tmp_path), **given))


@pytest.mark.parametrize("kept", ["all", "a pair less", "no T31", "a short dropout"])
@pytest.mark.parametrize("rows", [150, 100_000])
def test_what_was_looked_at_ahead_is_what_would_have_been_computed(
    kept: str, rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Blocks and pieces of the filter so short that most of them are not touched by a fault.
    monkeypatch.setattr(places, "BLOCK_ROWS", rows)
    monkeypatch.setattr(filtering, "PIECE_ROWS", rows)
    raw = make_test(period_s=0.09) if kept == "all" else made()
    if kept == "a short dropout":
        columns = dict(raw.columns)
        columns["P25_A_tip_forward"] = columns["P25_A_tip_forward"].copy()
        columns["P25_A_tip_forward"][1500:1504] = 4095.0
        raw = dataclasses.replace(make_test(period_s=0.09), columns=columns)
    if kept == "no T31":
        limits = {"limits": {name: [200, 620] for name in ("T31_A", "T31_B")}}
        raw = dataclasses.replace(make_test(period_s=0.09), description=raw.description | limits)
    raw.write(tmp_path)
    quick = reduced(tmp_path, None, IN_MEMORY)
    assert quick.columns
    assert ("psi" in quick.columns) is (kept != "no T31")
    on_disk = reduced(tmp_path, 100, OnDisk(tmp_path))
    assert_same(quick, on_disk)
    monkeypatch.setattr("classic_ml.look_ahead._same_channels", lambda *_: False)
    assert_same(quick, reduced(tmp_path, None, IN_MEMORY))


def test_no_column_that_is_computed_is_ever_computed_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    longest = 0

    def rows_of(column: ComputedColumn, key: int | slice) -> Any:
        nonlocal longest
        if isinstance(key, slice):
            longest = max(longest, len(range(*key.indices(column.size))))
        return cut_rows(column, key)

    def whole(*_: object) -> None:
        raise AssertionError("computed whole")

    cut_rows = ComputedColumn.__getitem__
    monkeypatch.setattr(ComputedColumn, "__getitem__", rows_of)
    monkeypatch.setattr(ComputedColumn, "__array__", whole)
    monkeypatch.setattr(places, "BLOCK_ROWS", 100)
    monkeypatch.setattr(filtering, "PIECE_ROWS", 100)
    monkeypatch.setattr(probe_agreement, "READINGS", 100)
    raw = made()
    raw.write(tmp_path)
    assert reduced(tmp_path, 100, OnDisk(tmp_path), stall_rule="hub-tip").columns
    # A piece of the filter with what it remembers before and behind, 368 rows each.
    assert 300 < longest < 1200 < len(raw.columns["time_s"])


def command(folder: Path, out: Path, *more: str) -> int:
    raw, test = str(folder / "raw.csv"), str(folder / "test.toml")
    return main(["reduce", raw, "--test", test, "-o", str(out), *more])


def files_of(folder: Path, out: Path, *more: str) -> list[bytes]:
    """Run the command, and return what it leaves behind but for the files of the record."""
    before = {path for path in folder.iterdir() if path.name in ("raw.csv", "test.toml", "truth")}
    assert command(folder, out, *more) == EXIT_DONE
    left = sorted(set(folder.iterdir()) - before)
    expected = {out, ledger_path(out)} if out.suffix == ".csv" else {out}
    assert set(left) == expected
    content = [path.read_bytes() for path in left]
    for path in left:
        path.unlink()
    return content


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    write_run(simulate("985", seed=1, duration_s=2.5), folder)
    shutil.rmtree(folder / "truth")
    return folder


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_the_files_are_the_same_whatever_the_chunk(rig: Path, suffix: str) -> None:
    out = rig / f"series{suffix}"
    whole = files_of(rig, out)
    for chunk in (1, 7, 997, 65_536, 10**9):
        assert files_of(rig, out, "--chunk", str(chunk)) == whole


@pytest.mark.skipif(
    not (INDEPENDENT / "raw.csv").is_file(),
    reason="the shared data folder is not beside the repository (../shared/data)",
)
def test_the_independent_record_is_the_same_whatever_the_chunk(tmp_path: Path) -> None:
    for name in ("raw.csv", "test.toml"):
        shutil.copy(INDEPENDENT / name, tmp_path / name)
    out = tmp_path / "series.nc"
    whole = files_of(tmp_path, out)
    for chunk in (7, 997):
        assert files_of(tmp_path, out, "--chunk", str(chunk)) == whole


def test_a_chunk_of_no_rows_is_refused(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for rows in ("0", "-3", "many", "1.5"):
        with pytest.raises(SystemExit) as left:
            command(rig, rig / "series.nc", "--chunk", rows)
        assert left.value.code == EXIT_UNUSABLE
        assert "--chunk: expected a whole number of rows, at least 1" in capsys.readouterr().err
    with pytest.raises(InputError, match="chunk_rows: expected at least 1 row, found 0"):
        read_raw(rig / "raw.csv", rig / "test.toml", chunk_rows=0)


def test_a_disk_with_too_little_room_is_told_beforehand(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    usage = shutil.disk_usage(rig)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1_000_000))
    assert command(rig, rig / "series.nc", "--chunk", "500") == EXIT_UNUSABLE
    told = capsys.readouterr().err
    assert f"{rig}: expected room for" in told
    assert "0.001 GB; free some, or let TMPDIR name a folder on another disk" in told
    assert not (rig / "series.nc").exists()
    # In memory nothing of the kind is needed.
    assert command(rig, rig / "series.nc") == EXIT_DONE
    (rig / "series.nc").unlink()


def test_a_long_record_goes_to_the_disk_unasked_where_there_is_room(
    rig: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = rig / "series.nc"
    whole = files_of(rig, out)
    folders: list[Path | None] = []

    class Noted(OnDisk):
        def __init__(self, folder: Path | None = None) -> None:
            folders.append(folder)
            super().__init__(folder)

    monkeypatch.setattr("comparisons.cli.reduce.OnDisk", Noted)
    monkeypatch.setattr("comparisons.cli.reduce.IN_MEMORY_BYTES", 1_000_000)
    monkeypatch.delenv("TMPDIR", raising=False)
    assert files_of(rig, out) == whole
    assert folders == [rig]
    usage = shutil.disk_usage(rig)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1_000_000))
    assert files_of(rig, out) == whole
    assert folders == [rig]


def test_a_disk_that_is_full_on_the_way_is_told_and_nothing_is_left(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reserved = 0

    def reserve(file: int, _: int, size: int) -> None:
        nonlocal reserved
        reserved += size
        if reserved > 150_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        os.ftruncate(file, size)

    monkeypatch.setattr(os, "posix_fallocate", reserve)
    before = set(rig.iterdir())
    assert command(rig, rig / "series.nc", "--chunk", "500") == EXIT_UNUSABLE
    assert "MB more of temporary files, found a full disk" in capsys.readouterr().err
    assert set(rig.iterdir()) == before


def test_an_interruption_leaves_nothing_behind(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    before = set(rig.iterdir())
    for place in ("classic_ml.reduction.find_cycles", "classic_ml.readers.series_files._write"):
        with monkeypatch.context() as patch:
            patch.setattr(place, interrupted)
            assert command(rig, rig / "series.nc", "--chunk", "500") == EXIT_INTERRUPTED
        assert set(rig.iterdir()) == before
    capsys.readouterr()


def test_columns_lie_in_tmpdir_where_that_is_set(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders: list[Path] = []
    monkeypatch.setattr(
        reduce_command, "OnDisk", lambda folder: folders.append(folder) or OnDisk(folder)
    )
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    files_of(rig, rig / "series.nc", "--chunk", "500")
    monkeypatch.delenv("TMPDIR")
    files_of(rig, rig / "series.nc", "--chunk", "500")
    assert folders == [tmp_path, rig]


def test_how_far_it_is_is_told(rig: Path) -> None:
    rows: list[int] = []
    steps: list[int] = []
    record, test = read_raw(
        rig / "raw.csv", rig / "test.toml", chunk_rows=1000, progress=rows.append
    )
    reduce_record(record, test, progress=steps.append)
    assert rows == [1000, 1000, 501]
    assert sum(steps) == STEPS


def at_row(row: int, name: str, value: float) -> RawTest:
    columns = dict(made().columns)
    columns[name] = columns[name].astype(float)
    columns[name][row] = value
    return dataclasses.replace(made(), columns=columns)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (at_row(1234, "P25_B_hub_aft", 5000.0), "found 5000 in row 1235"),
        (at_row(1234, "P25_B_hub_aft", np.nan), "found 'nan' in row 1235"),
        (at_row(2000, "T25_A", -3.0), "found -3 in row 2001"),
        (at_row(2000, "time_s", 1.999), "it repeats at row 2001"),
        (at_row(1999, "time_s", 1.5), "it runs back at row 2000"),
        (at_row(2000, "time_s", 2.0003), "a step of 0.0013 s after 1.999 s (row 2000)"),
    ],
)
@pytest.mark.parametrize("chunk", [1, 400, 5000])
def test_a_fault_is_named_by_its_row_in_the_file(
    raw: RawTest, words: str, chunk: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw.write(tmp_path)
    # The row lies at the border of two blocks.
    monkeypatch.setattr(places, "BLOCK_ROWS", 200)
    assert words in reduced(tmp_path, chunk, OnDisk(tmp_path)).said


def test_a_gap_between_two_chunks_is_a_gap(tmp_path: Path) -> None:
    columns = {name: np.delete(values, 1000) for name, values in made().columns.items()}
    dataclasses.replace(made(), columns=columns).write(tmp_path)
    said = reduced(tmp_path, 1000, OnDisk(tmp_path)).said
    assert "a step of 0.002 s after 0.999 s (row 1000)" in said


def test_a_fault_over_the_border_of_blocks_is_one_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = dict(made().columns)
    columns["P25_B_tip_aft"] = columns["P25_B_tip_aft"].copy()
    columns["P25_B_tip_aft"][1990:2075] = 2100.0
    dataclasses.replace(made(), columns=columns).write(tmp_path)
    whole = reduced(tmp_path, None, IN_MEMORY)
    assert "P25_B_tip_aft: 85 rows stuck or dropped out, 1.990 to 2.074 s" in whole.said
    for block in (1000, 2000, 50):
        monkeypatch.setattr(places, "BLOCK_ROWS", block)
        assert_same(whole, reduced(tmp_path, 333, OnDisk(tmp_path)))


def test_of_a_long_record_the_report_draws_a_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made().write(tmp_path)
    place = OnDisk(tmp_path)
    record, test = read_raw(tmp_path / "raw.csv", tmp_path / "test.toml", workspace=place)
    reduction = reduce_record(record, test, keep="averages")
    assert excerpt(reduction) == (reduction, "")
    monkeypatch.setattr(reduce_command, "REPORT_ROWS", 800)
    part, words = excerpt(reduction)
    assert part.record.n_samples == part.series.n_samples == 800
    first = round(1e3 * part.series.time_s[0])
    assert words == f"{first / 1e3:.3f} to {first / 1e3 + 0.799:.3f} s of the record"
    rows = slice(first, first + 800)
    assert rows.start < record.rows_between(*reduction.window_s).start < rows.stop
    np.testing.assert_array_equal(part.series.phi, reduction.series.phi[rows])
    np.testing.assert_array_equal(part.record["P25_Pa"], reduction.record["P25_Pa"][rows])
    assert part.record.history == reduction.record.history
    out = tmp_path / "report.html"
    assert command(tmp_path, tmp_path / "s.nc", "--chunk", "900", "--report", str(out)) == 0
    assert words in out.read_text("utf-8")


# Run as a process of its own: the peak of its memory is that of this reduction alone.
PROCESS = """
import sys
from comparisons.cli import main
assert main(sys.argv[1:]) == 0
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print("peak", peak.split()[1])
"""


def peak_bytes(folder: Path, n_rows: int) -> int:
    import pyarrow as pa
    from pyarrow import parquet

    columns = made().columns
    # From the second cycle on over and over.
    rows = np.arange(n_rows)
    rows[660:] = 660 + (rows[660:] - 660) % 1800
    table = {name: values[rows] for name, values in columns.items()}
    table["time_s"] = np.arange(n_rows) / 1000.0
    parquet.write_table(pa.table(table), folder / "raw.parquet", row_group_size=20_000)
    arguments = ["reduce", "raw.parquet", "--test", "test.toml", "--chunk", "20000", "-o", "s.nc"]
    done = subprocess.run(
        [sys.executable, "-c", PROCESS, *arguments],
        cwd=folder,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return 1024 * int(done.stdout.rsplit("peak ", 1)[1])


@pytest.mark.skipif(
    not Path("/proc/self/status").is_file(), reason="the system does not tell the peak of memory"
)
def test_memory_does_not_grow_with_the_record(tmp_path: Path) -> None:
    whole = make_test(period_s=0.09)
    whole.write(tmp_path)
    # Both are longer than a block, of which there are some at once in any record.
    short, long = peak_bytes(tmp_path, 140_000), peak_bytes(tmp_path, 600_000)
    # One column more would be 3.7 MB, the record itself 77 MB.
    assert long - short < 25e6
