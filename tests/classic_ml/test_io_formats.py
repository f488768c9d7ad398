"""One record in every format, each written by its own library, reads to the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from raw_data import RawTest, make_test, to_toml, write_csv
from scipy.io import savemat

from classic_ml.io import read_raw
from classic_ml.io.formats import open_stored
from surge_core.errors import InputError

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


def semicolons(path: Path, columns: Columns) -> None:
    pd.DataFrame(columns).to_csv(path, sep=";", decimal=",", index=False)


def tabs(path: Path, columns: Columns) -> None:
    pd.DataFrame(columns).to_csv(path, sep="\t", index=False)


def stamps(path: Path, columns: Columns) -> None:
    dates = pd.Timestamp("2024-05-01T12:00:00") + pd.to_timedelta(columns["time_s"], unit="s")
    pd.DataFrame({**columns, "time_s": dates.map(lambda d: d.isoformat(sep=" "))}).to_csv(
        path, index=False
    )


def matlab(path: Path, columns: Columns) -> None:
    savemat(path, columns, do_compression=True, long_field_names=True)


def matlab_struct(path: Path, columns: Columns) -> None:
    upright = {name: values[:, np.newaxis] for name, values in columns.items()}
    savemat(path, {"run": upright, "note": "a text"}, long_field_names=True)


def matlab_73(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file[f"run/{name}"] = values[np.newaxis, :]
            file[f"run/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        letters = file.create_dataset("note", data=np.frombuffer("µm".encode("utf-16-le"), "<u2"))
        letters.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def netcdf(path: Path, columns: Columns) -> None:
    variables = {name: ("row", values) for name, values in columns.items()}
    xr.Dataset(variables).to_netcdf(path, engine="h5netcdf")


def netcdf_3(path: Path, columns: Columns) -> None:
    variables = {name: ("row", values) for name, values in columns.items()}
    xr.Dataset(variables).to_netcdf(path, engine="scipy")


def hdf5(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"daq/{name}", data=values, compression="gzip", chunks=True)


def hdf5_compound(path: Path, columns: Columns) -> None:
    rows = np.zeros(501, dtype=[(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        rows[name] = values
    with h5py.File(path, "w") as file:
        file["table"] = rows


def tdms(path: Path, columns: Columns) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [nptdms.ChannelObject("daq", name, values) for name, values in columns.items()]
        )


def tdms_waveforms(path: Path, columns: Columns) -> None:
    nptdms = pytest.importorskip("nptdms")
    start = np.datetime64("2024-05-01T12:00:00", "us")
    stated = {"wf_start_time": start, "wf_start_offset": 0.0, "wf_increment": 1e-3}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("daq", name, values, stated)
                for name, values in columns.items()
                if name != "time_s"
            ]
        )


def parquet(path: Path, columns: Columns) -> None:
    pq.write_table(pa.table(columns), path, row_group_size=100)


def parquet_stamps(path: Path, columns: Columns) -> None:
    dates = pd.Timestamp("2024-05-01T12:00:00") + pd.to_timedelta(columns["time_s"], unit="s")
    pd.DataFrame({**columns, "time_s": dates}).to_parquet(path)


WRITERS: dict[str, tuple[str, Callable[[Path, Columns], None]]] = {
    "CSV": (".csv", write_csv),
    "CSV of semicolons and decimal commas": (".csv", semicolons),
    "CSV of tabs": (".csv", tabs),
    "CSV with dates": (".csv", stamps),
    "MAT": (".mat", matlab),
    "MAT struct": (".mat", matlab_struct),
    "MAT 7.3": (".mat", matlab_73),
    "netCDF-4": (".nc", netcdf),
    "netCDF-3": (".nc", netcdf_3),
    "HDF5": (".h5", hdf5),
    "HDF5 compound": (".h5", hdf5_compound),
    "TDMS": (".tdms", tdms),
    "TDMS waveforms": (".tdms", tdms_waveforms),
    "Parquet": (".parquet", parquet),
    "Parquet with dates": (".parquet", parquet_stamps),
}


@pytest.mark.parametrize("format_", WRITERS)
def test_every_format_gives_the_same_record(made: RawTest, tmp_path: Path, format_: str) -> None:
    suffix, write = WRITERS[format_]
    expected, test = read_raw(*made.write(tmp_path))
    path = tmp_path / f"other{suffix}"
    write(path, made.columns)
    record, _ = read_raw(path, test)
    assert (record.start_s, record.sample_rate_hz) == (0.0, expected.sample_rate_hz)
    for name in test.channel_names:
        np.testing.assert_allclose(record[name], expected[name], rtol=1e-12)
        assert record.channel(name).unit == expected.channel(name).unit
    assert record[test.channel_names[0]].dtype == np.float64


@pytest.mark.parametrize("kind", [np.int16, np.uint16, np.int32, np.float32])
@pytest.mark.parametrize("format_", ["MAT", "netCDF-4", "HDF5", "TDMS", "Parquet"])
def test_codes_are_read_as_they_are_stored(
    made: RawTest, tmp_path: Path, format_: str, kind: type[np.generic]
) -> None:
    suffix, write = WRITERS[format_]
    _, test = read_raw(*made.write(tmp_path))
    columns = dict(made.columns)
    for probe in test.pressures:
        columns[probe.name] = columns[probe.name].astype(kind)
    path = tmp_path / f"other{suffix}"
    write(path, columns)
    record, _ = read_raw(path, test)
    for probe in test.pressures:
        np.testing.assert_array_equal(record[probe.name], made.columns[probe.name])


def test_large_whole_numbers_are_not_rewritten(tmp_path: Path) -> None:
    """Addresses and lengths of a file are 64 bits wide; so may its data be."""
    values = np.arange(200, dtype=np.int64) + 5575230279
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file.attrs["run"] = np.int64(5575230279)
        file["time"], file["count"] = np.arange(200) / 1e3, values
    with open_stored(tmp_path / "raw.h5") as stored:
        (block,) = stored.blocks(("count",))
    np.testing.assert_array_equal(block[0], values)


def test_packed_netcdf_is_unpacked_in_double_precision(tmp_path: Path) -> None:
    packed = np.arange(-100, 100, dtype=np.int16)
    attributes = {"scale_factor": 0.1, "add_offset": 300.0, "_FillValue": np.int16(7), "units": "K"}
    xr.Dataset({"T": ("row", packed, attributes)}).to_netcdf(tmp_path / "raw.nc", engine="h5netcdf")
    with open_stored(tmp_path / "raw.nc") as stored:
        (block,) = stored.blocks(("T",))
    expected = np.where(packed == 7, np.nan, 300.0 + 0.1 * packed)
    np.testing.assert_allclose(block[0], expected, rtol=1e-15)
    assert stored.units == {"T": "K"}


def test_units_are_taken_from_where_each_format_keeps_them(tmp_path: Path) -> None:
    values = np.linspace(10.0, 20.0, 150)
    time_s = np.arange(150) / 1e3
    (tmp_path / "a.csv").write_text(
        "time_s,P\ns,psia\n" + "".join(f"{t},{p}\n" for t, p in zip(time_s, values, strict=True))
    )
    pd.DataFrame({"time_s": time_s, "P [psia]": values}).to_csv(tmp_path / "b.csv", index=False)
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["time_s"], file["P"] = time_s, values
        file["P"].attrs["units"] = "psia"
    field = pa.field("P", pa.float64(), metadata={"units": "psia"})
    pq.write_table(pa.table([values], schema=pa.schema([field])), tmp_path / "d.parquet")
    for path in sorted(tmp_path.iterdir()):
        with open_stored(path) as stored:
            assert "psia" in stored.units.values(), path


def test_several_groups_must_be_chosen_from(made: RawTest, tmp_path: Path) -> None:
    path = tmp_path / "raw.h5"
    with h5py.File(path, "w") as file:
        for group in ("one", "two"):
            for name, values in made.columns.items():
                file[f"{group}/{name}"] = values
    tables = dict(made.description)
    toml = tmp_path / "test.toml"
    toml.write_text(to_toml(tables), "utf-8")
    with pytest.raises(InputError, match="group"):
        read_raw(path, toml)
    toml.write_text(to_toml({**tables, "file": {"group": "two"}}), "utf-8")
    record, _ = read_raw(path, toml)
    assert record.n_samples == made.columns["time_s"].size
    toml.write_text(to_toml({**tables, "file": {"group": "three"}}), "utf-8")
    with pytest.raises(InputError, match="three"):
        read_raw(path, toml)


def test_tdms_channels_that_were_not_sampled_together_are_refused(
    made: RawTest, tmp_path: Path
) -> None:
    nptdms = pytest.importorskip("nptdms")
    _, toml = made.write(tmp_path)
    for change in ({"wf_start_offset": 0.01}, {"wf_increment": 2e-3}):
        with nptdms.TdmsWriter(tmp_path / "raw.tdms") as writer:
            writer.write_segment(
                [
                    nptdms.ChannelObject(
                        "daq",
                        name,
                        values,
                        {"wf_start_offset": 0.0, "wf_increment": 1e-3}
                        | (change if name == "T31_B" else {}),
                    )
                    for name, values in made.columns.items()
                    if name != "time_s"
                ]
            )
        with pytest.raises(InputError, match="T31_B"):
            read_raw(tmp_path / "raw.tdms", toml)


@pytest.mark.parametrize("format_", [f for f in WRITERS if not f.startswith("CSV")])
def test_a_file_cut_short_is_refused_in_one_sentence(
    made: RawTest, tmp_path: Path, format_: str
) -> None:
    suffix, write = WRITERS[format_]
    _, toml = made.write(tmp_path)
    path = tmp_path / f"cut{suffix}"
    write(path, made.columns)
    data = path.read_bytes()
    for size in (0, 100, len(data) // 2):
        path.write_bytes(data[:size])
        with pytest.raises(InputError) as refused:
            read_raw(path, toml)
        assert str(path) in str(refused.value)
        assert "\n" not in str(refused.value)
