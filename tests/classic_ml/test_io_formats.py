"""One record in every format, each written by its own library, reads to the same numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from raw_data import RawTest, make_test, to_toml
from stored_records import FORMS

from classic_ml.inspect import draft_test_toml, inspect_file
from classic_ml.io import read_raw
from classic_ml.io.formats import open_stored
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


@pytest.mark.parametrize("kind", [np.float64, np.int16])
@pytest.mark.parametrize("form", FORMS)
def test_every_format_gives_the_same_record(
    made: RawTest, tmp_path: Path, form: str, kind: type
) -> None:
    suffix, write = FORMS[form]
    expected, test = read_raw(*made.write(tmp_path))
    path = tmp_path / f"other{suffix}"
    write(path, {n: v.astype(kind) if n[0] == "P" else v for n, v in made.columns.items()})
    record, _ = read_raw(path, test)
    assert (record.start_s, record.sample_rate_hz) == (0.0, expected.sample_rate_hz)
    for name in test.channel_names:
        np.testing.assert_allclose(record[name], expected[name], rtol=1e-12)
        assert record.channel(name).unit == expected.channel(name).unit


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


def test_a_netcdf_clock_since_a_date_is_in_its_unit(made: RawTest, tmp_path: Path) -> None:
    _, toml = made.write(tmp_path)
    data = xr.Dataset({name: ("row", values) for name, values in made.columns.items()})
    data["time_s"] = 1e3 * data["time_s"] + 5e6
    data["time_s"].attrs["units"] = "ms since 2024-05-01T11:00:00"
    data.to_netcdf(tmp_path / "raw.nc", engine="h5netcdf")
    assert read_raw(tmp_path / "raw.nc", toml)[0].start_s == 5000.0


def test_units_are_taken_from_where_each_format_keeps_them(tmp_path: Path) -> None:
    values = np.linspace(10.0, 20.0, 150)
    time_s = np.arange(150) / 1e3
    (tmp_path / "a.csv").write_text(
        "time_s,P\ns,psia\n" + "".join(f"{t},{p}\n" for t, p in zip(time_s, values, strict=True))
    )
    pd.DataFrame({"time_s": time_s, "P [psia]": values}).to_csv(tmp_path / "b.csv", index=False)
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["time_s"], file["P"] = time_s, values
        file["P"].attrs["Units"] = "psia"
    field = pa.field("P", pa.float64(), metadata={"units": "psia"})
    pq.write_table(pa.table([values], schema=pa.schema([field])), tmp_path / "d.parquet")
    with TdmsWriter(tmp_path / "e.tdms") as writer:
        writer.write_segment([ChannelObject("g", "P", values, {"unit_string": "psia"})])
    for path in sorted(tmp_path.iterdir()):
        with open_stored(path) as stored:
            assert "psia" in stored.units.values(), path


def test_a_unit_in_the_brackets_of_a_name_is_read(tmp_path: Path) -> None:
    units = {
        "PT25 fwd [psia]": "psia",
        "Time (ms)": "ms",
        "P31 {kPa(g)}": "kPa(g)",
        "T25_A (°C)": "°C",
        "P25 raw (counts)": "counts",
        "P25 (C)": "",
        "T25 (C)": "C",
        "P25 (fwd)": "",
        "P25 []": "",
        "speed (rpm)": "",
    }
    pd.DataFrame({name: [1.0, 2.0] for name in units}).to_csv(tmp_path / "raw.csv", index=False)
    with open_stored(tmp_path / "raw.csv") as stored:
        assert stored.units == {name: unit for name, unit in units.items() if unit}


def test_several_groups_must_be_chosen_from(made: RawTest, tmp_path: Path) -> None:
    path, toml = tmp_path / "raw.h5", tmp_path / "test.toml"
    with h5py.File(path, "w") as file:
        for group in ("one", "two"):
            for name, values in made.columns.items():
                file[f"{group}/{name}"] = values
    toml.write_text(to_toml(made.description), "utf-8")
    with pytest.raises(InputError, match="channels in 'one', 'two'; write group"):
        read_raw(path, toml)
    toml.write_text(to_toml({**made.description, "file": {"group": "two"}}), "utf-8")
    assert read_raw(path, toml)[0].n_samples == made.columns["time_s"].size
    toml.write_text(to_toml({**made.description, "file": {"group": "three"}}), "utf-8")
    with pytest.raises(InputError, match=r"the group three, .* 'one', 'two'"):
        read_raw(path, toml)


def test_tdms_waveforms_are_read_by_their_rate(made: RawTest, tmp_path: Path) -> None:
    _, toml = made.write(tmp_path)
    stated = {"wf_start_offset": 0.0, "wf_increment": 1e-3}
    channels = {name: values for name, values in made.columns.items() if name != "time_s"}
    with TdmsWriter(tmp_path / "raw.tdms") as writer:
        writer.write_segment([ChannelObject("daq", n, v, stated) for n, v in channels.items()])
    with pytest.raises(InputError, match=r'no such column.* clock = "from rate"'):
        read_raw(tmp_path / "raw.tdms", toml)
    toml.write_text(to_toml({**made.description, "file": {"clock": "from rate"}}), "utf-8")
    record, test = read_raw(tmp_path / "raw.tdms", toml)
    np.testing.assert_array_equal(record["T25_A"], channels["T25_A"])
    assert "sample_rate_hz = 1000.0" in draft_test_toml(inspect_file(tmp_path / "raw.tdms"))
    for raw in ("raw.tdms", "raw.csv"):
        with pytest.raises(InputError, match=r"expected 1200 samples a second, .* found 1000"):
            read_raw(tmp_path / raw, replace(test, sample_rate_hz=1200.0))
