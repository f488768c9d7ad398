"""Columns hold what was put into them, in memory and on disk, and leave no trace."""

from __future__ import annotations

import gc
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from classic_ml import CoefficientSeries
from classic_ml.columns import workspace
from classic_ml.columns.computed import ComputedColumn
from classic_ml.columns.growing import STAGED_ROWS, GrowingColumns
from classic_ml.columns.workspace import (
    IN_MEMORY,
    OnDisk,
    Workspace,
    blocks,
    evaluated,
)
from classic_ml.records import Channel, Record
from surge_core.errors import InputError

RNG = np.random.default_rng(0)


@pytest.fixture(params=["memory", "disk"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Workspace:
    return IN_MEMORY if request.param == "memory" else OnDisk(tmp_path)


def test_blocks_cover_the_rows_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", 4)
    assert list(blocks(9)) == [slice(0, 4), slice(4, 8), slice(8, 9)]
    assert list(blocks(9, 3)) == [slice(3, 7), slice(7, 9)]
    assert list(blocks(0)) == list(blocks(5, 5)) == []


@pytest.mark.parametrize("dtype", [np.float64, np.int64, np.bool_])
def test_a_column_keeps_what_is_put_into_it(place: Workspace, dtype: type[np.generic]) -> None:
    values = RNG.integers(0, 2, 1000).astype(dtype)
    column = place.zeros(1000, dtype)
    assert not column.any()
    column[:100] = values[:100]
    place.release()
    place.put(column, slice(600, 1000), values[600:])
    place.put(column, slice(100, 600), values[100:600])
    place.release()
    np.testing.assert_array_equal(column, values, strict=True)


@pytest.mark.parametrize("n_rows", [None, 1000, 400, 3000])
def test_a_column_is_written_in_order(place: Workspace, n_rows: int | None) -> None:
    values = RNG.standard_normal(1000)
    writer = place.writer(n_rows)
    # Every second value of an array does not lie in one piece.
    for part in (values[:1], np.repeat(values[1:700], 2)[::2], values[700:]):
        writer.append(part)
        place.release()
    column = writer.finished()
    np.testing.assert_array_equal(column, values, strict=True)
    with pytest.raises(ValueError, match="read-only"):
        column[0] = 1.0


def test_an_empty_column_is_one(place: Workspace) -> None:
    assert place.zeros(0).shape == place.writer().finished().shape == (0,)


def test_functions_of_rows_are_those_of_the_whole(
    place: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", 7)
    squares = evaluated(place, 50, lambda rows: np.arange(rows.start, rows.stop) ** 2, np.int64)
    np.testing.assert_array_equal(squares, np.arange(50) ** 2, strict=True)


@pytest.mark.parametrize("pieces", [[1] * 30, [5, 0, STAGED_ROWS, 1], [3 * STAGED_ROWS, 2], []])
def test_columns_grow_by_rows(place: Workspace, pieces: list[int]) -> None:
    rows = RNG.standard_normal((sum(pieces), 3))
    grown, first = GrowingColumns(place, 3), 0
    for n in pieces:
        grown.append(rows[first : first + n])
        first += n
        assert grown.n_rows == first
    for column, expected in zip(grown.finished(), rows.T, strict=True):
        np.testing.assert_array_equal(column, expected)


def test_rows_of_another_width_are_refused() -> None:
    with pytest.raises(InputError, match="3 values in each"):
        GrowingColumns(IN_MEMORY, 3).append(np.zeros((5, 2)))


def test_columns_on_disk_have_no_name_and_their_room_is_taken_anew(tmp_path: Path) -> None:
    def open_files() -> int:
        gc.collect()
        return len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else 0

    before = open_files()
    place = OnDisk(tmp_path)
    first = place.column(1000)
    first[:] = 7.0
    part = first[10:20]
    other = place.column(1000)
    other[:] = 0.0
    assert list(tmp_path.iterdir()) == []
    # A view holds its column, whose room nobody else may have.
    del first, other
    again, fresh = place.column(1000), place.column(1000)
    again[:], fresh[:] = 1.0, 2.0
    assert np.all(part == 7.0)
    at_most = open_files()
    for _ in range(20):
        del again, fresh
        again, fresh = place.column(1000), place.column(1000)
    assert open_files() == at_most
    del again, part
    # What begins as zeros never has anything of another column in it.
    assert not place.zeros(1000).any()
    # A column lives on without its place, and all files are closed with both.
    fresh[:] = 2.0
    del place
    assert np.all(fresh == 2.0)
    del fresh
    assert open_files() == before


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        OnDisk(tmp_path / "none").zeros(10)


def test_what_lies_on_disk_can_be_handed_to_another_process(tmp_path: Path) -> None:
    place = OnDisk(tmp_path)
    column = evaluated(place, 200, lambda rows: np.arange(rows.start, rows.stop) * 1e-3)
    record = Record({"T": Channel("T", column, "K")}, 1000.0, workspace=place)
    copy = pickle.loads(pickle.dumps(record))
    assert copy.workspace is IN_MEMORY
    np.testing.assert_array_equal(copy["T"], column)
    series = CoefficientSeries(
        column, np.sin(column), np.cos(column), np.ones(200, np.int64), workspace=place
    )
    assert series.time_s is column
    again = pickle.loads(pickle.dumps(series))
    assert again.workspace is IN_MEMORY
    np.testing.assert_array_equal(again.psi_p, series.psi_p)


def test_readings_on_disk_are_narrow_for_as_long_as_they_can_be(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    codes = rng.integers(0, 65_536, 20_000).astype(float)
    for spoil in (None, 0, 7_000, 19_999):
        values = codes.copy()
        if spoil is not None:
            values[spoil] = rng.choice([-1.0, 0.5, 65_536.0])
        writer = OnDisk(tmp_path).readings_writer(values.size)
        for start in range(0, values.size, 999):
            writer.append(values[start : start + 999])
        column = writer.finished()
        assert column.size == values.size
        assert isinstance(column, ComputedColumn) is (spoil is None)
        np.testing.assert_array_equal(np.asarray(column), values)
        for rows in (slice(3, 3), slice(6_990, 7_010), slice(19_000, None), slice(None, None, 7)):
            np.testing.assert_array_equal(column[rows], values[rows])
        assert column[-1] == values[-1]
        with pytest.raises(ValueError, match="read-only"):
            column[10:20][:] = 0.0


def test_what_follows_from_other_columns_is_the_same_in_both_places(tmp_path: Path) -> None:
    values = np.random.default_rng(6).standard_normal(5_000)
    values.setflags(write=False)
    for place in (IN_MEMORY, OnDisk(tmp_path)):
        column = place.derived(values.size, lambda rows: 2.0 * values[rows] + 1.0)
        np.testing.assert_array_equal(np.asarray(column), 2.0 * values + 1.0)
        assert len(column) == values.size
        record = Record({"x": Channel("x", column, "1")}, 1000.0, workspace=place)
        np.testing.assert_array_equal(record["x"][40:90], column[40:90])


@pytest.mark.parametrize("on_disk", [False, True])
def test_rows_of_a_finished_column_are_written_anew(on_disk: bool, tmp_path: Path) -> None:
    place: Workspace = OnDisk(tmp_path) if on_disk else IN_MEMORY
    column = evaluated(place, 1_000, lambda rows: np.arange(rows.start, rows.stop, dtype=float))
    place.overwrite(column, slice(200, 203), np.array([-1.0, -2.0, -3.0]))
    expected = np.arange(1_000.0)
    expected[200:203] = [-1.0, -2.0, -3.0]
    np.testing.assert_array_equal(column, expected)
    assert not column.flags.writeable


def test_too_many_columns_for_the_limit_of_open_files_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resource = pytest.importorskip("resource", reason="limits of open files are a matter of POSIX")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    place, kept = OnDisk(tmp_path), []
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
    try:
        with pytest.raises(InputError, match=r"raise the limit \(ulimit -n 8192\)"):
            kept += [place.column(10) for _ in range(64)]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
