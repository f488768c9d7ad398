"""Every format: the same rig record gives the same columns, bit for bit, as it does as CSV."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from nptdms import ChannelObject, RootObject, TdmsWriter
from raw_data import RawTest, make_test, write_csv
from scipy.io import netcdf_file, savemat

from classic_ml.readers import read_raw
from classic_ml.readers.raw_files import open_raw
from classic_ml.readers.raw_formats import open_stored
from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.test_description import FileLayout
from classic_ml.readers.test_toml import read_test_description
from surge_core.errors import InputError

Columns = Mapping[str, np.ndarray]
CODES = np.dtype(np.uint16)


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5, rate_hz=1000.0)


def stored_types(columns: Columns) -> dict[str, np.ndarray]:
    """Counts as a converter gives them, the rest as doubles."""
    return {n: v.astype(CODES) if n.startswith("P") else v for n, v in columns.items()}


def write_parquet(path: Path, columns: Columns) -> None:
    table = pa.table(stored_types(columns))
    pq.write_table(table, path, row_group_size=64)


def write_hdf5(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in stored_types(columns).items():
            file.create_dataset(f"run/{name}", data=values.astype(values.dtype.newbyteorder(">")))
        file.create_dataset("calibration", data=np.arange(7.0))
        file.attrs["rig"] = "made up"


def write_compound(path: Path, columns: Columns) -> None:
    types = stored_types(columns)
    table = np.empty(len(columns["time_s"]), dtype=[(n, v.dtype) for n, v in types.items()])
    for name, values in types.items():
        table[name] = values
    with h5py.File(path, "w") as file:
        file.create_dataset("scan/table", data=table, chunks=(50,), compression="gzip")


def write_named_matrix(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        file["data"] = np.column_stack(list(columns.values()))
        file["names"] = np.array(list(columns), dtype="S40")


def write_netcdf4(path: Path, columns: Columns) -> None:
    data = {n: ("time_s", v) for n, v in stored_types(columns).items() if n != "time_s"}
    dataset = xr.Dataset(data, coords={"time_s": columns["time_s"]})
    for name in dataset.variables:
        dataset[name].attrs["units"] = {"P": "counts", "T": "K", "t": "s"}[str(name)[0]]
    dataset.to_netcdf(path, engine="h5netcdf")


def write_netcdf3(path: Path, columns: Columns) -> None:
    with netcdf_file(str(path), "w") as file:
        file.createDimension("row", None)
        for name, values in columns.items():
            kind = "i2" if name.startswith("P") else "f8"
            file.createVariable(name, kind, ("row",))[:] = values.astype(kind)


def write_mat_vectors(path: Path, columns: Columns) -> None:
    shaped = {n: v[:, None] if n.startswith("P") else v for n, v in stored_types(columns).items()}
    savemat(path, {**shaped, "fs": 1000.0, "comment": "made up"}, do_compression=True)


def write_mat_matrix(path: Path, columns: Columns) -> None:
    names = np.array(list(columns), dtype=object)
    savemat(path, {"data": np.column_stack(list(columns.values())), "channels": names})


def write_mat_4(path: Path, columns: Columns) -> None:
    savemat(path, dict(columns), format="4")


def write_mat_struct(path: Path, columns: Columns) -> None:
    savemat(path, {"test": {"rig": "made up", "raw": dict(columns)}})


def write_mat_series(path: Path, columns: Columns) -> None:
    """Every channel as what is left of a timeseries, with the same clock beside each."""
    time_s = columns["time_s"]
    parts = {n: {"time_s": time_s, "Data": v} for n, v in columns.items() if n != "time_s"}
    savemat(path, parts)


def write_simulink(path: Path, columns: Columns) -> None:
    """Simulink's structure with time, as To Workspace blocks leave it."""
    fields = [("values", object), ("dimensions", object), ("label", object)]
    signals = np.zeros(len(columns) - 1, dtype=fields)
    for number, name in enumerate(n for n in columns if n != "time_s"):
        signals[number] = (columns[name][:, None], 1.0, name)
    savemat(path, {"out": {"time_s": columns["time_s"], "signals": signals}})


def write_mat73(path: Path, columns: Columns) -> None:
    """What MATLAB writes: HDF5 behind a block of text, arrays transposed, a struct as a group."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("raw")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in stored_types(columns).items():
            item = group.create_dataset(name, data=values[None, :])
            kind = "uint16" if values.dtype == CODES else "double"
            item.attrs["MATLAB_class"] = np.bytes_(kind)
        note = group.create_dataset("note", data=np.array([[104], [105]], dtype=np.uint16))
        note.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_group("#refs#")
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file, made up".ljust(124) + b"\x00\x02IM")


def write_mat73_cells(path: Path, columns: Columns) -> None:
    """A matrix beside a cell array of its names, in version 7.3."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file["data"] = np.stack(list(columns.values()))
        hidden = file.create_group("#refs#")
        cells = file.create_dataset("names", (len(columns), 1), dtype=h5py.ref_dtype)
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        for number, name in enumerate(columns):
            codes = np.array([[ord(letter)] for letter in name], dtype=np.uint16)
            text = hidden.create_dataset(f"n{number}", data=codes)
            text.attrs["MATLAB_class"] = np.bytes_("char")
            cells[number, 0] = text.ref
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file, made up".ljust(124) + b"\x00\x02IM")


def write_tdms(path: Path, columns: Columns) -> None:
    """Three segments, the clock as properties of the waveforms."""
    rows = len(columns["time_s"])
    with TdmsWriter(path) as writer:
        for start in range(0, rows, 200):
            properties: dict[str, Any] = {"wf_increment": 1e-3, "wf_start_offset": 0.0}
            objects = [
                ChannelObject("Rakes", name, values[start : start + 200], properties)
                for name, values in stored_types(columns).items()
                if name != "time_s"
            ]
            writer.write_segment([RootObject({"rig": "made up"}), *objects])


def write_tdms_column(path: Path, columns: Columns) -> None:
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", n, v) for n, v in columns.items()])


WRITERS: dict[str, tuple[str, Callable[[Path, Columns], None]]] = {
    "csv": (".csv", lambda path, columns: write_csv(path, dict(columns))),
    "parquet": (".parquet", write_parquet),
    "hdf5": (".h5", write_hdf5),
    "hdf5 compound": (".hdf5", write_compound),
    "hdf5 matrix": (".h5", write_named_matrix),
    "netcdf4": (".nc", write_netcdf4),
    "netcdf3": (".nc", write_netcdf3),
    "mat vectors": (".mat", write_mat_vectors),
    "mat matrix": (".mat", write_mat_matrix),
    "mat 4": (".mat", write_mat_4),
    "mat struct": (".mat", write_mat_struct),
    "mat timeseries": (".mat", write_mat_series),
    "mat simulink": (".mat", write_simulink),
    "mat 7.3": (".mat", write_mat73),
    "mat 7.3 cells": (".mat", write_mat73_cells),
    "tdms": (".tdms", write_tdms),
    "tdms column": (".tdms", write_tdms_column),
}


def rows_of(raw: RawFile, rows: int = 65_536) -> np.ndarray:
    return np.concatenate(list(raw.chunks(rows)))


@pytest.mark.parametrize("form", WRITERS)
def test_every_format_gives_the_same_columns(made: RawTest, tmp_path: Path, form: str) -> None:
    suffix, write = WRITERS[form]
    _, toml = made.write(tmp_path)
    test = read_test_description(toml)
    path = tmp_path / f"record{suffix}"
    write(path, made.columns)
    raw = open_raw(path, test)
    assert raw.names == ("time_s", *test.channel_names)
    values = rows_of(raw)
    for number, name in enumerate(raw.names):
        np.testing.assert_array_equal(values[:, number], made.columns[name], err_msg=name)
    np.testing.assert_array_equal(rows_of(raw, 37), values)
    assert {len(chunk) for chunk in raw.chunks(100)} <= {100, 1}
    assert raw.n_rows in (None, 501)


@pytest.mark.parametrize("form", ["csv", "parquet", "hdf5", "netcdf3", "mat struct", "tdms"])
def test_every_format_gives_the_same_record(made: RawTest, tmp_path: Path, form: str) -> None:
    suffix, write = WRITERS[form]
    _, toml = made.write(tmp_path)
    reference, _ = made.load()
    path = tmp_path / f"record{suffix}"
    write(path, made.columns)
    record, _ = read_raw(path, toml)
    assert (record.start_s, record.sample_rate_hz) == (reference.start_s, reference.sample_rate_hz)
    for name, channel in reference.channels.items():
        np.testing.assert_array_equal(record[name], channel.values)
        assert record.channel(name).unit == channel.unit


Change = Callable[[Path, Columns], None]


def cut(write: Change, share: float) -> Change:
    """Leave off the end of a file."""

    def written(path: Path, columns: Columns) -> None:
        write(path, columns)
        content = path.read_bytes()
        path.write_bytes(content[: int(len(content) * share)])

    return written


def content(made_of: bytes) -> Change:
    return lambda path, _: path.write_bytes(made_of) and None


def with_nan(write: Change) -> Change:
    def written(path: Path, columns: Columns) -> None:
        spoiled = np.array(columns["T25_A"])
        spoiled[41] = np.nan
        write(path, {**columns, "T25_A": spoiled})

    return written


def null_parquet(path: Path, columns: Columns) -> None:
    table = pa.table(dict(columns))
    values = pa.array([None if row == 41 else v for row, v in enumerate(columns["T25_A"])])
    place = table.column_names.index("T25_A")
    pq.write_table(table.set_column(place, "T25_A", values), path)


def filled_netcdf(path: Path, columns: Columns) -> None:
    """A packed variable, one value of which was never written."""
    with netcdf_file(str(path), "w") as file:
        file.createDimension("row", 501)
        for name, values in columns.items():
            variable = file.createVariable(name, "f8", ("row",))
            variable[:] = values
            if name == "T25_A":
                variable.missing_value = -999.0
                variable[41] = -999.0


def in_groups(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for group in ("run 1", "run 2"):
            for name, values in columns.items():
                file[f"{group}/{name}"] = values


def text_column(path: Path, columns: Columns) -> None:
    texts = pa.array([str(v) for v in columns["T25_A"]])
    pq.write_table(pa.table({**columns, "T25_A": texts}), path)


def two_rates(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values[::10] if name == "T25_A" else values


def two_clocks(path: Path, columns: Columns) -> None:
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("g", n, v, {"wf_increment": 2e-3 if n == "T25_A" else 1e-3})
                for n, v in columns.items()
                if n != "time_s"
            ]
        )


def other_times(path: Path, columns: Columns) -> None:
    """Structs with clocks of their own, one of which is late."""
    parts = {
        n: {"time_s": columns["time_s"] + (1e-3 if n == "T31_B" else 0.0), "Data": v}
        for n, v in columns.items()
        if n != "time_s"
    }
    savemat(path, parts)


def linked(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values
        del file["T25_A"]
        file["T25_A"] = h5py.ExternalLink("other.h5", "/T25_A")


MAT, H5, NC, TDMS, PQ = ".mat", ".h5", ".nc", ".tdms", ".parquet"
NO_NUMBER = r"channel T25_A: expected a finite number in every row, found 'nan' in row 42"
BAD: dict[str, tuple[str, Change, str]] = {
    **{
        f"empty {suffix}": (suffix, lambda path, _: path.write_bytes(b"") and None, "an empty file")
        for suffix in (MAT, H5, NC, TDMS, PQ)
    },
    **{
        f"text {suffix}": (suffix, content(b"time_s,P\n1,2\n" * 900), words)
        for suffix, words in (
            (MAT, "expected a MAT file, .* found a table of text; rename it, .* in .csv"),
            (H5, "an HDF5 file, as the suffix '.h5' says, found a table of text; rename it"),
            (NC, "a netCDF file, as the suffix '.nc' says"),
            (TDMS, "a TDMS file, as the suffix '.tdms' says"),
            (PQ, "a Parquet file, as the suffix '.parquet' says"),
        )
    },
    "parquet as csv": (
        ".csv",
        write_parquet,
        "a CSV table, as the suffix '.csv' says, found a Parquet file; .* ends in .parquet",
    ),
    "hdf5 as tdms": (TDMS, write_hdf5, "found an HDF5 file"),
    "mat 7.3 as tdms": (TDMS, write_mat73, r"found a MAT file \(7.3\); rename it, .* ends in .mat"),
    "workbook as csv": (
        ".csv",
        content(b"PK\x03\x04" * 99),
        "a zip archive or a workbook of Excel",
    ),
    "cut hdf5": (H5, cut(write_hdf5, 0.6), "an HDF5 file, found one that was cut short"),
    "cut netcdf4": (NC, cut(write_netcdf4, 0.5), "a netCDF file, found one that was cut"),
    "cut netcdf3": (NC, cut(write_netcdf3, 0.9), "the file ends before its variable"),
    "headless netcdf3": (NC, cut(write_netcdf3, 0.01), "the file ends in its header"),
    "garbage netcdf3": (NC, content(b"CDF\x02" + bytes(range(256)) * 9), "a header that is none"),
    "cut mat": (MAT, cut(write_mat_struct, 0.7), "what cannot be read .*; was it cut short"),
    "cut mat 7.3": (MAT, cut(write_mat73, 0.7), "version 7.3, found one that was cut short"),
    "cut parquet": (PQ, cut(write_parquet, 0.7), "found what cannot be read .*; was it cut short"),
    "sealed parquet": (PQ, content(b"PARE" * 200), "a Parquet file, found what cannot be read"),
    "garbage tdms": (TDMS, content(b"TDSm" + bytes(range(256)) * 9), "expected channels, found no"),
    "cut tdms": (TDMS, cut(write_tdms, 0.9), "a whole TDMS file, found its last segment cut short"),
    "nan hdf5": (H5, with_nan(write_hdf5), NO_NUMBER),
    "nan mat": (MAT, with_nan(write_mat_matrix), NO_NUMBER),
    "nan tdms": (TDMS, with_nan(write_tdms), NO_NUMBER),
    "nan parquet": (PQ, with_nan(write_parquet), NO_NUMBER),
    "null parquet": (PQ, null_parquet, NO_NUMBER),
    "missing netcdf": (NC, filled_netcdf, NO_NUMBER),
    "groups": (
        H5,
        in_groups,
        r"the channels in one group, found channels in 'run 1', 'run 2'; write group = \"run 2\"",
    ),
    "text column": (PQ, text_column, "channel T25_A: .* found a column of string"),
    "two rates": (H5, two_rates, "T25_A: .* found 51 values where the record has 501"),
    "two clocks": (TDMS, two_clocks, "P25_A_tip_forward and T25_A: .* steps by 0.002 s"),
    "other times": (MAT, other_times, r"channels .* and T31_B: expected the same times for both"),
    "link": (H5, linked, "T25_A: .* found a link to another file"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_in_one_sentence(made: RawTest, tmp_path: Path, case: str) -> None:
    suffix, write, words = BAD[case]
    _, toml = made.write(tmp_path)
    path = tmp_path / f"record{suffix}"
    write(path, made.columns)
    with pytest.raises(InputError, match=words) as caught:
        read_raw(path, toml)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_tdms_file_that_was_cut_short_can_be_looked_at(made: RawTest, tmp_path: Path) -> None:
    """A logger that died leaves whole segments and a part of one."""
    path = tmp_path / "record.tdms"
    cut(write_tdms, 0.9)(path, made.columns)
    raw = open_stored(path, lenient=True)
    assert set(raw.names) == set(made.columns)
    values = rows_of(raw)
    assert 400 <= len(values) < 501
    for number, name in enumerate(raw.names):
        np.testing.assert_array_equal(values[:, number], made.columns[name][: len(values)])


@pytest.mark.parametrize("group", ["run 1", "/run 1/"])
def test_one_of_several_groups_is_named(made: RawTest, tmp_path: Path, group: str) -> None:
    in_groups(tmp_path / "record.h5", made.columns)
    raw = open_stored(tmp_path / "record.h5", FileLayout(group=group))
    assert set(raw.names) == set(made.columns)
    both = open_stored(tmp_path / "record.h5", FileLayout(group="/", time="run 1/time_s"))
    assert f"run 2/{raw.names[0]}" in both.names
    with pytest.raises(InputError, match=r"group run 3: .* found only 'run 1', 'run 2'"):
        open_stored(tmp_path / "record.h5", FileLayout(group="run 3"))


def test_small_numbers_of_every_width_and_order_are_read(tmp_path: Path) -> None:
    """Integers and floats of every width, either end first, scaled ones and truth values."""
    rng = np.random.default_rng(0)
    kinds = ("<i2", ">i2", "<u2", ">i4", "<i8", ">f4", "<f4", ">f8", "<f2", "?", "i1")
    columns = {f"c{k}": rng.integers(0, 2, 300).astype(kind) for k, kind in enumerate(kinds)}
    with h5py.File(tmp_path / "all.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values
    native = {n: v.astype(v.dtype.newbyteorder("=")) for n, v in columns.items()}
    pq.write_table(pa.table(native), tmp_path / "all.parquet")
    for name in ("all.h5", "all.parquet"):
        raw = open_stored(tmp_path / name)
        values = rows_of(raw)
        assert values.dtype == np.float64
        for number, column in enumerate(raw.names):
            np.testing.assert_array_equal(values[:, number], columns[column].astype(float))
    with netcdf_file(str(tmp_path / "packed.nc"), "w") as file:
        file.createDimension("row", 300)
        codes = rng.integers(-9000, 9000, 300)
        packed = file.createVariable("P", "i2", ("row",))
        packed[:] = codes
        packed.scale_factor, packed.add_offset, packed.units = 0.5, 100.0, "kPa"
    raw = open_stored(tmp_path / "packed.nc")
    np.testing.assert_array_equal(rows_of(raw)[:, 0], 0.5 * codes + 100.0)
    assert raw.units == {"P": "kPa"}


def test_what_pandas_writes_is_a_table_like_any_other(made: RawTest, tmp_path: Path) -> None:
    """An index of its own beside the columns, and one that is the clock."""
    _, toml = made.write(tmp_path)
    table = pd.DataFrame(made.columns)
    table.iloc[::-1].iloc[::-1].to_parquet(tmp_path / "a.parquet")
    table[table["time_s"] >= 0.0].set_index(np.random.default_rng(0).permutation(501)).to_parquet(
        tmp_path / "b.parquet"
    )
    table.set_index("time_s").to_parquet(tmp_path / "c.parquet")
    for name in ("a.parquet", "b.parquet", "c.parquet"):
        record, _ = read_raw(tmp_path / name, toml)
        np.testing.assert_array_equal(record["T31_B"], made.columns["T31_B"])
    raw = open_stored(tmp_path / "b.parquet")
    assert raw.unusable == {"__index_level_0__": "an index of pandas"}


def test_units_are_found_where_each_format_keeps_them(tmp_path: Path) -> None:
    values = np.arange(120.0)
    savemat(
        tmp_path / "a.mat",
        {"run": {"P": values, "T": values + 1.0, "units": {"P": "psia", "T": "degF"}}},
    )
    savemat(
        tmp_path / "b.mat",
        {
            "data": np.column_stack([values, values + 1.0]),
            "names": np.array(["P", "T"], dtype=object),
            "units": np.array(["psia", "degF"], dtype=object),
        },
    )
    with TdmsWriter(tmp_path / "c.tdms") as writer:
        channels = [
            ChannelObject("g", "P", values, {"unit_string": "psia", "wf_increment": 0.01}),
            ChannelObject("g", "T", values + 1.0, {"unit_string": "degF", "wf_increment": 0.01}),
        ]
        writer.write_segment(channels)
    for name in ("a.mat", "b.mat", "c.tdms"):
        units = dict(open_stored(tmp_path / name).units)
        assert {n: units[n] for n in "PT"} == {"P": "psia", "T": "degF"}, name
    assert (
        open_stored(tmp_path / "c.tdms").clock == "from wf_start_offset 0 s and wf_increment 0.01 s"
    )


def test_a_package_that_is_missing_is_named_with_its_extra(
    made: RawTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "record.tdms"
    write_tdms(path, made.columns)
    monkeypatch.setattr("classic_ml.readers.optional_package.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"nptdms.* not installed; pip install 'sindy-surge\[tdms"):
        open_stored(path)


def test_nothing_in_a_mat_file_is_executed(tmp_path: Path) -> None:
    """A Python object in a MAT file is no number, and stays what it is."""
    path = tmp_path / "odd.mat"
    cells = np.array([np.arange(3.0), "text", np.array([])], dtype=object)
    savemat(path, {"t": np.arange(150.0), "P": np.arange(150.0), "odd": cells})
    raw = open_stored(path)
    assert set(raw.names) == {"t", "P"}
    assert raw.unusable == {"odd": "a cell array"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s;P\n0,0;1.5\n0,1;2.5\n", "one decimal sign .* found '0,0' and '1.5'"),
        ("time_s;P\n0;1\n" + "1;2\n" * 150 + "2,5;1\n", "time_s: .* '2,5' in row 152"),
        ("time_s;P\n0,0;1,5\n" + "0,1;2,5\n" * 150 + "0,2;1.234\n", "P: .* '1.234' in row 152"),
        ("0,0;1,5\n0,1;2,5\n", "found numbers in the first line"),
        ("time_s,P\n0,0,1,5\n0,1,2,5\n", "found 4 in row 1; are numbers written with a comma"),
        ("time_s,P\n0,1_000\n", "channel P: .* found '1_000' in row 1"),
    ],
)
def test_a_csv_table_of_another_country_is_answered(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "raw.csv"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError, match=words):
        rows_of(open_stored(path))


def test_csv_is_read_as_it_was_printed(tmp_path: Path) -> None:
    """Shortest and longest decimals, exponents, signs, spaces, quotes, blank lines, CRLF, a BOM."""
    rng = np.random.default_rng(1)
    numbers = np.concatenate(
        [rng.normal(size=300) * 10.0 ** rng.integers(-300, 300, 300), [5e-324, 1.7e308, 0.1, -0.0]]
    )
    texts = [[repr(float(v)), f"{v:.25e}", f" {v!r} "] for v in numbers.tolist()]
    lines = ['\ufeff"a",b , c', *(",".join(row) for row in texts)]
    path = tmp_path / "raw.csv"
    path.write_bytes("\r\n".join(lines).encode("utf-8") + b"\r\n\r\n")
    raw = open_stored(path)
    assert raw.names == ("a", "b", "c")
    values = rows_of(raw)
    for column in range(3):
        np.testing.assert_array_equal(values[:, column], numbers)
    # Where the quick look stumbles, the slow one gives the same numbers.
    lines[150] = "+" + lines[150].lstrip("-")
    path.write_bytes("\n".join(lines).encode("utf-8"))
    np.testing.assert_array_equal(np.abs(rows_of(open_stored(path), 64)), np.abs(values))


def test_a_row_of_units_below_the_header_is_read(tmp_path: Path) -> None:
    path = tmp_path / "raw.csv"
    path.write_text("t,P [bar],T\nms,psia,°C\n0,1,2\n1,2,3\n", "utf-8")
    raw = open_stored(path)
    assert raw.units == {"t": "ms", "P [bar]": "psia", "T": "°C"}
    np.testing.assert_array_equal(rows_of(raw), [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]])
    path.write_bytes("Zeit,T (°C)\n0,1\n".encode("cp1252"))
    assert open_stored(path).units == {"T (°C)": "°C"}


def classic_5(values: np.ndarray) -> bytes:
    """A CDF-5 file with one record variable, byte for byte after the specification."""

    def whole(*numbers: int) -> bytes:
        return b"".join(int(n).to_bytes(8, "big") for n in numbers)

    def name(text: str) -> bytes:
        return whole(len(text)) + text.encode().ljust(-(-len(text) // 4) * 4, b"\0")

    def tag(number: int, count: int) -> bytes:
        return number.to_bytes(4, "big") + whole(count)

    unit = name("units") + (2).to_bytes(4, "big") + name("psi")
    head = b"CDF\x05" + whole(len(values)) + tag(10, 1) + name("row") + whole(0) + tag(0, 0)
    variable = name("P") + whole(1, 0) + tag(12, 1) + unit + (8).to_bytes(4, "big") + whole(2)
    head += tag(11, 1) + variable
    return head + whole(len(head) + 8) + values.astype(">u2").tobytes()


def test_every_kind_of_classic_netcdf_is_read(tmp_path: Path) -> None:
    """64-bit offsets, one record variable without padding, matrices left aside, CDF-5."""
    rng = np.random.default_rng(3)
    values, matrix = rng.integers(0, 4096, 301), rng.normal(size=(301, 3))
    for version in (1, 2):
        path = tmp_path / f"v{version}.nc"
        with netcdf_file(str(path), "w", version=version) as file:
            file.createDimension("row", None)
            file.createDimension("three", 3)
            file.createVariable("P", "i2", ("row",))[:] = values
            if version == 2:
                file.createVariable("M", "f8", ("row", "three"))[:] = matrix
                file.createVariable("T", "f4", ("row",))[:] = matrix[:, 0]
                file.createVariable("text", "c", ("three",))[:] = b"abc"
        raw = open_stored(path)
        expected = np.column_stack([values, matrix[:, 0].astype(np.float32)])[:, :version]
        np.testing.assert_array_equal(rows_of(raw, 17), expected)
        assert ("M" in raw.unusable) == (version == 2)
    (tmp_path / "v5.nc").write_bytes(classic_5(values))
    raw = open_stored(tmp_path / "v5.nc")
    assert (raw.names, dict(raw.units), raw.n_rows) == (("P",), {"P": "psi"}, 301)
    np.testing.assert_array_equal(rows_of(raw)[:, 0], values)
