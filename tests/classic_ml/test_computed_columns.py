"""Columns that are computed where they are asked for are as good as those that are stored."""

from __future__ import annotations

import dataclasses
import gc
import os
import pickle
import weakref
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from classic_ml.columns.computed import ComputedColumn, as_stored, computed, is_computed, widened
from classic_ml.columns.together import computed_together
from classic_ml.columns.workspace import IN_MEMORY, OnDisk
from raw_data import make_test

from classic_ml import read_series
from classic_ml.calibration import calibrate
from classic_ml.columns import workspace
from classic_ml.flow import calculated_mach, reversed_above, true_mach
from classic_ml.planes import local_flows, plane_flows
from classic_ml.readers import read_raw
from classic_ml.readers.series_files import hand_over_series, write_series
from classic_ml.records import Channel
from classic_ml.reduction import IN_SERIES, ReductionSettings, reduce_record
from surge_core.errors import InputError

VALUES = np.random.default_rng(1).standard_normal(100)


def squared() -> np.ndarray:
    return computed(100, lambda rows: VALUES[rows] ** 2)


def test_whatever_is_done_with_it_is_done_with_all_of_its_rows() -> None:
    column, array = squared(), VALUES**2
    assert is_computed(column)
    assert not is_computed(array)
    np.testing.assert_array_equal(column + 1.0, array + 1.0, strict=True)
    np.testing.assert_array_equal(2.0 - column, 2.0 - array, strict=True)
    np.testing.assert_array_equal(column[column > 1.0], array[array > 1.0], strict=True)
    np.testing.assert_array_equal(column[[3, 1]], array[[3, 1]], strict=True)
    np.testing.assert_array_equal(column[::-7], array[::-7], strict=True)
    np.testing.assert_array_equal(np.sqrt(column), np.sqrt(array), strict=True)
    np.testing.assert_array_equal(np.diff(column), np.diff(array), strict=True)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(column)), array, strict=True)
    assert column.max() == array.max()
    assert np.median(column) == np.median(array)
    assert column[-1] == array[-1]
    assert len(column) == 100
    assert sum(column) == sum(array)
    with pytest.raises(IndexError):
        column[100]
    with pytest.raises(ValueError, match="read-only"):
        column[5:7][0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        column += 1.0
    with pytest.raises(ValueError, match="read-only"):
        column[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(column)[0] = 1.0
    with pytest.raises(ValueError, match="ambiguous"):
        bool(column)
    assert column[True].shape == (1, 100)
    assert "100 rows" in repr(column)


def test_pandas_takes_it_for_the_numbers_it_is() -> None:
    column, array = squared(), VALUES**2
    for frame in (pd.DataFrame({"a": column}), pd.DataFrame({"a": array}).assign(b=column)):
        assert set(frame.dtypes) == {np.dtype(np.float64)}
        np.testing.assert_array_equal(frame.iloc[:, -1], array)
    np.testing.assert_array_equal(pd.Series(column), array)


def test_a_kept_block_is_not_changed_from_outside() -> None:
    columns = computed_together(100, ("plain",), lambda rows: {"plain": VALUES[rows].copy()})
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(columns["plain"])[:] = 0.0
    np.testing.assert_array_equal(columns["plain"], VALUES)


def test_a_wider_type_is_that_of_the_array_and_remembers_the_narrow_one() -> None:
    narrow = np.arange(100, dtype=np.int8)
    wide = widened(narrow, np.int64)
    np.testing.assert_array_equal(wide[10:20], np.arange(10, 20), strict=True)
    assert as_stored(wide) is narrow
    assert widened(narrow, np.int8) is narrow
    assert wide.dtype == np.int64
    assert isinstance(wide, ComputedColumn)


def test_columns_of_one_sweep_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", 16)
    asked: list[int] = []

    def evaluate(rows: slice) -> dict[str, np.ndarray]:
        asked.append(rows.start)
        return {"twice": 2.0 * VALUES[rows], "thrice": 3.0 * VALUES[rows]}

    columns = computed_together(100, ("twice", "thrice"), evaluate)
    for rows in workspace.blocks(100):
        around = slice(max(0, rows.start - 1), min(100, rows.stop + 1))
        np.testing.assert_array_equal(columns["twice"][around], 2.0 * VALUES[around])
        np.testing.assert_array_equal(columns["thrice"][rows], 3.0 * VALUES[rows])
    assert asked == list(range(0, 100, 16))
    # In any order, over several blocks, and of nothing.
    np.testing.assert_array_equal(columns["twice"][5:93], 2.0 * VALUES[5:93])
    np.testing.assert_array_equal(columns["thrice"][40:41], 3.0 * VALUES[40:41])
    assert columns["twice"][50:50].size == columns["twice"][48:48].size == 0


@pytest.mark.parametrize("stall_rule", ["threshold", "hub-tip"])
def test_less_that_is_kept_is_the_same_series(stall_rule: str, tmp_path: Path) -> None:
    make_test().write(tmp_path)
    settings = ReductionSettings(stall_rule=stall_rule)
    found = {}
    for keep in ("probes", "averages", "series"):
        for name, place in (("memory", IN_MEMORY), ("disk", OnDisk(tmp_path))):
            raw = read_raw(tmp_path / "raw.csv", tmp_path / "test.toml", workspace=place)
            found[keep, name] = reduce_record(*raw, settings, keep=keep)
    whole = found["probes", "memory"]
    for (keep, _), other in found.items():
        assert other.series.history == whole.series.history
        for name, values in whole.series.columns().items():
            np.testing.assert_array_equal(other.series.columns()[name], values, err_msg=name)
        assert all(
            np.array_equal(channel.values, whole.record[name])
            for name, channel in other.record.channels.items()
        )
        if keep == "series":
            assert set(other.record.channels) <= set(IN_SERIES)


def taken_bytes(folder: Path) -> int:
    """Room on the disk that the nameless files of a folder take in this process."""
    sizes = {}
    for number in os.listdir("/proc/self/fd"):
        try:
            target = os.readlink(f"/proc/self/fd/{number}")
            state = os.stat(f"/proc/self/fd/{number}")
        except OSError:
            continue
        if target.startswith(str(folder)):
            sizes[state.st_ino] = 512 * state.st_blocks
    return sum(sizes.values())


needs_sizes = pytest.mark.skipif(
    not Path("/proc/self/fd").is_dir(), reason="the system does not list its open files"
)


@needs_sizes
def test_a_series_that_is_handed_over_is_written_whole_and_leaves_its_room(tmp_path: Path) -> None:
    make_test().write(tmp_path)
    written, taken = [], []
    for write in (write_series, hand_over_series):
        raw = read_raw(tmp_path / "raw.csv", tmp_path / "test.toml", workspace=OnDisk(tmp_path))
        series = reduce_record(*raw, keep="series").series
        file = tmp_path / f"{write.__name__}.nc"
        write(series, file)
        del raw
        gc.collect()
        written.append(file.read_bytes())
        taken.append(taken_bytes(tmp_path))
        assert read_series(file).n_samples == series.n_samples
    with pytest.raises(InputError, match="found one that was handed over"):
        write_series(series, tmp_path / "again.csv")
    assert written[0] == written[1]
    if taken[0] == 0:
        pytest.skip("the file system does not tell what a file takes")
    assert taken[1] < 0.5 * taken[0]


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_a_part_of_a_series_that_is_handed_over_leaves_the_whole(
    tmp_path: Path, suffix: str
) -> None:
    make_test().write(tmp_path)
    raw = read_raw(tmp_path / "raw.csv", tmp_path / "test.toml", workspace=OnDisk(tmp_path))
    series = reduce_record(*raw, keep="series").series
    phi = np.array(series.phi)
    columns = {name: values[:2000] for name, values in series.columns().items()}
    hand_over_series(dataclasses.replace(series, **columns), tmp_path / f"part{suffix}")
    np.testing.assert_array_equal(series.phi, phi)


def test_two_names_of_one_column_are_both_written(tmp_path: Path) -> None:
    make_test().write(tmp_path)
    raw = read_raw(tmp_path / "raw.csv", tmp_path / "test.toml", workspace=OnDisk(tmp_path))
    series = reduce_record(*raw, keep="series").series
    psi_p = np.array(series.psi_p)
    hand_over_series(dataclasses.replace(series, psi_p_unfiltered=series.psi_p), tmp_path / "s.nc")
    read = read_series(tmp_path / "s.nc")
    np.testing.assert_array_equal(read.psi_p, psi_p)
    np.testing.assert_array_equal(read.psi_p_unfiltered, psi_p)


@pytest.mark.parametrize("chunk", [None, 500])
def test_readings_go_when_the_series_alone_is_kept(chunk: int | None, tmp_path: Path) -> None:
    make_test().write(tmp_path)
    alive: dict[str, int] = {}
    for keep in ("series", "averages"):
        place = OnDisk(tmp_path)
        record, test = read_raw(
            tmp_path / "raw.csv", tmp_path / "test.toml", workspace=place, chunk_rows=chunk
        )
        readings = [weakref.ref(channel.values) for channel in record.channels.values()]
        records = [record]
        del record
        reduction = reduce_record(records.pop(), test, keep=keep)
        gc.collect()
        alive[keep] = sum(reading() is not None for reading in readings)
        assert reduction.series.n_samples
    # On disk the averages are computed from the readings.
    assert alive["series"] == 0 < alive["averages"]


def test_what_is_kept_is_one_of_three() -> None:
    with pytest.raises(InputError, match=r"keep: expected probes or .* found 'all'"):
        reduce_record(*make_test(seconds=0.6).load(), keep="all")


def test_the_ledger_does_not_depend_on_where_the_columns_lie(tmp_path: Path) -> None:
    record, test = make_test(quantise=False).load()
    steps = {}
    for stored in (None, ("T25_K",), ()):
        for place in (IN_MEMORY, OnDisk(tmp_path)):
            here = dataclasses.replace(calibrate(record, test), workspace=place)
            averaged = plane_flows(here, test, stored=stored)
            steps[stored, place is IN_MEMORY] = averaged.history[len(record.history) + 1 :]
    for stored in (None, ("T25_K",), ()):
        assert steps[stored, True] == steps[stored, False]
    assert steps[None, True] == steps[("T25_K",), True]
    assert [entry.step for entry in steps[(), True]] == ["plane averages"]


@needs_sizes
def test_a_discarded_column_leaves_its_room(tmp_path: Path) -> None:
    place, n_rows = OnDisk(tmp_path), 1 << 20
    column = workspace.evaluated(place, n_rows, lambda rows: np.ones(rows.stop - rows.start))
    if taken_bytes(tmp_path) < 8 * n_rows:
        pytest.skip("the file system does not tell what a file takes")
    place.discard(column)
    assert taken_bytes(tmp_path) < n_rows
    # What takes no room on the disk has none to give back.
    place.discard(squared())
    IN_MEMORY.discard(VALUES)
    # A column to come has room of its own, not the hole that this one left.
    del column
    gc.collect()
    other = place.column(n_rows)
    assert taken_bytes(tmp_path) >= 8 * n_rows
    del other
    gc.collect()
    place.tidy(but_rows=n_rows)
    assert taken_bytes(tmp_path) >= 8 * n_rows
    place.tidy()
    assert taken_bytes(tmp_path) < n_rows


@pytest.mark.parametrize("offset", [-0.2, -0.01, 0.0, 0.03])
def test_the_flow_is_reversed_where_eq_2_has_it_below_zero(offset: float) -> None:
    gamma, slope = 1.37, 1.1
    above = reversed_above(slope, offset, gamma)
    ratio = above * (1.0 + np.array([-1e-6, 1e-6]))
    forward = np.full(2, 1e5)
    mach = true_mach(calculated_mach(forward, forward * ratio, gamma), slope, offset)
    assert mach[0] >= 0.0 > mach[1]


def test_rows_below_the_least_flow_of_a_pair_are_not_reversed() -> None:
    """With b < 0 (Eq 2) the aft probe may read a little above the forward one in no flow."""
    record, test = make_test(quantise=False).load()
    record = calibrate(record, test)
    test = dataclasses.replace(
        test, pressures=tuple(dataclasses.replace(p, probe_offset=-0.1) for p in test.pressures)
    )
    share = np.linspace(0.9, 1.1, record.n_samples)
    swept = [
        Channel(pair.aft.name, record[pair.forward.name] * share, "Pa")
        for plane in (25, 31)
        for pair in test.pairs(plane)
    ]
    record = record.after(record.history[-1], add=swept)
    local = local_flows(record, test)
    # Without the flows of plane 31, whose ratio tells alone.
    some = dataclasses.replace(record, workspace=OnDisk())
    told = plane_flows(some, test, stored=("Wc25_kg_s", "P31_Pa")).history[-2].parameters
    assert told == local.history[-1].parameters
    for pair in (*test.pairs(25), *test.pairs(31)):
        reversed_ = float(told[f"reversed_{pair.name}"])
        assert 0.4 < reversed_ < 0.49
        if pair.forward.plane == 25:
            assert reversed_ == round(float(np.mean(local[f"Wc{pair.name}_kg_s"] < 0.0)), 4)
