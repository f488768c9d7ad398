"""Users' names, units and clocks: test.toml maps them, and what does not fit gets a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from raw_data import RawTest, make_test, to_toml, write_csv

from classic_ml.calibration import calibrate, probe_pressure_Pa
from classic_ml.io import read_raw
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError

PSI = 0.45359237 * 9.80665 / 0.0254**2
BAROMETER_PA = 101_200.0
COUNT_KEYS = ("zoc_reference_Pa", "zero_count", "calibrate_count", "calibrate_pressure_Pa")
Tables = dict[str, Any]
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


@pytest.fixture(scope="module")
def pascals(made: RawTest) -> Columns:
    """The pressures of the record by their zero and calibrate readings, in Pa."""
    columns = {}
    for name, table in made.description["channels"].items():
        values = made.columns[name]
        if table["kind"] == "pressure":
            gain = (table["calibrate_count"] - table["zero_count"]) / table["calibrate_pressure_Pa"]
            values = (values - table["zero_count"]) / gain + table["zoc_reference_Pa"]
        columns[name] = values
    return columns


def described(made: RawTest, change: Callable[[str, Tables], Tables], **top: Any) -> Tables:
    """The description with every channel changed, and tables added to it."""
    channels = {n: change(n, dict(t)) for n, t in made.description["channels"].items()}
    return {**made.description, "channels": channels, **top}


def in_unit(unit: str, temperature: str = "K", **more: Any) -> Callable[[str, Tables], Tables]:
    """Channels in a unit of pressure, without what belongs to counts."""

    def change(name: str, table: Tables) -> Tables:
        if table["kind"] == "temperature":
            return {**table, "unit": temperature}
        kept = {key: value for key, value in table.items() if key not in COUNT_KEYS}
        return {**kept, "unit": unit, **more}

    return change


def same(_: str, table: Tables) -> Tables:
    return table


def write(folder: Path, columns: Columns, tables: Tables, name: str = "raw.csv") -> list[Path]:
    raw, toml = folder / name, folder / "test.toml"
    write_csv(raw, columns)
    toml.write_text(to_toml(tables), "utf-8")
    return [raw, toml]


UNITS: dict[str, tuple[str, dict[str, Any], Callable[[np.ndarray], np.ndarray]]] = {
    "Pa": ("Pa", {"reference_Pa": 0.0}, lambda p: p),
    "psia": ("psia", {}, lambda p: p / PSI),
    "psi absolute": ("psi", {"reference_Pa": 0.0}, lambda p: p / PSI),
    "psig": ("psig", {"reference_Pa": BAROMETER_PA}, lambda p: (p - BAROMETER_PA) / PSI),
    "psid": ("psid", {"reference_Pa": 250e3}, lambda p: (p - 250e3) / PSI),
    "kPa gauge": ("kPa", {"reference_Pa": BAROMETER_PA}, lambda p: (p - BAROMETER_PA) / 1e3),
    "reference as text": (
        "mbar gauge",
        {"reference_Pa": "1.012 bar abs"},
        lambda p: (p - BAROMETER_PA) / 1e2,
    ),
    "inHg": ("inHg abs", {}, lambda p: p / (13595.1 * 9.80665 * 0.0254)),
}
TEMPERATURES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "K": lambda t: t,
    "degC": lambda t: t - 273.15,
    "degF": lambda t: (t - 273.15) * 1.8 + 32.0,
    "degR": lambda t: t * 1.8,
}


@pytest.mark.parametrize("form", UNITS)
def test_pressures_in_any_unit_are_those_of_the_counts(
    made: RawTest, pascals: Columns, tmp_path: Path, form: str
) -> None:
    unit, more, from_pascals = UNITS[form]
    temperature = list(TEMPERATURES)[len(form) % len(TEMPERATURES)]
    tables = described(made, in_unit(unit, temperature, **more))
    del tables["adc"]
    columns = {
        n: from_pascals(v) if n.startswith("P") else TEMPERATURES[temperature](v)
        for n, v in pascals.items()
    }
    record, test = read_raw(*write(tmp_path, {"time_s": made.columns["time_s"], **columns}, tables))
    assert {record.channel(n).unit for n in columns} == {"Pa", "K"}
    for name, values in pascals.items():
        np.testing.assert_allclose(record[name], values, rtol=1e-14, atol=1e-9, err_msg=name)
    counted, counts = made.load()
    found, expected = calibrate(record, test), calibrate(counted, counts)
    for name in columns:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-12, atol=1e-7)
    did = found.history[-1].did
    assert "16 pressures recorded as such" in did
    assert "counts" not in did


def test_a_record_in_psi_is_reduced_to_the_numbers_of_the_counts(tmp_path: Path) -> None:
    """The whole way: the same surge recorded as counts, and as psig with degF, gives one series."""
    made = make_test(seconds=2.0)
    columns = {"time_s": made.columns["time_s"]}
    for name, table in made.description["channels"].items():
        values = made.columns[name]
        if table["kind"] == "pressure":
            gain = (table["calibrate_count"] - table["zero_count"]) / table["calibrate_pressure_Pa"]
            values = (values - table["zero_count"]) / gain + table["zoc_reference_Pa"]
            columns[name] = (values - BAROMETER_PA) / PSI
        else:
            columns[name] = TEMPERATURES["degF"](values)
    tables = described(made, in_unit("psig", "degF", reference_Pa=BAROMETER_PA))
    del tables["adc"]
    found = reduce_record(*read_raw(*write(tmp_path, columns, tables))).series
    expected = reduce_record(*made.load()).series
    np.testing.assert_array_equal(found.segment, expected.segment)
    np.testing.assert_allclose(found.phi, expected.phi, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.psi_p, expected.psi_p, rtol=1e-10, atol=1e-9)


def test_counts_and_pressures_go_together_in_one_record(
    made: RawTest, pascals: Columns, tmp_path: Path
) -> None:
    """One pair in psia among transducers in counts."""
    others = ("P25_A_tip_forward", "P25_A_tip_aft")
    change = in_unit("psia")
    tables = described(made, lambda n, t: change(n, t) if n in others else t)
    columns = {**made.columns, **{n: pascals[n] / PSI for n in others}}
    record, test = read_raw(*write(tmp_path, columns, tables))
    assert record.channel(others[0]).unit == "Pa"
    assert record.channel("P25_A_hub_aft").unit == "count"
    found = calibrate(record, test)
    for name in others:
        np.testing.assert_allclose(found[name], pascals[name], rtol=1e-14)
    for probe in test.pressures:
        if probe.name not in others:
            expected = probe_pressure_Pa(probe, test, made.columns[probe.name])
            np.testing.assert_array_equal(found[probe.name], expected)
    assert found.history[-1].did.startswith("14 pressures from counts")


def test_columns_have_the_names_of_their_users(made: RawTest, tmp_path: Path) -> None:
    """Names with spaces and brackets, a clock in milliseconds, columns that are of no concern."""
    renamed = {n: f"{n.replace('_', ' ')} [rig 2]" for n in made.description["channels"]}
    tables = described(
        made,
        lambda n, t: {**t, "column": renamed[n]},
        file={"time": "Time (ms)", "other_columns": "ignore"},
    )
    columns = {
        "Time (ms)": 1e3 * made.columns["time_s"],
        **{renamed[n]: made.columns[n] for n in renamed},
        "Speed [rpm]": np.full(501, 11_400.0),
    }
    record, test = read_raw(*write(tmp_path, columns, tables))
    reference, _ = made.load()
    assert set(record.channels) == set(reference.channels)
    for name in reference.channels:
        np.testing.assert_array_equal(record[name], reference[name])
    np.testing.assert_allclose(record.time_s, reference.time_s, atol=1e-12)
    assert test.file.time == "Time (ms)"
    assert test.pressures[0].file_column == "P25 A tip forward [rig 2]"


@pytest.mark.parametrize("unit", ["s", "ms", "us", "min"])
def test_a_clock_is_in_the_unit_that_test_toml_says(
    made: RawTest, tmp_path: Path, unit: str
) -> None:
    scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "min": 1.0 / 60.0}[unit]
    columns = {**made.columns, "time_s": (made.columns["time_s"] + 3.0) * scale}
    tables = described(made, same, file={"time_unit": unit})
    record, _ = read_raw(*write(tmp_path, columns, tables))
    assert record.start_s == pytest.approx(3.0, abs=1e-12)
    assert record.sample_rate_hz == 1000.0


def test_a_clock_may_be_made_or_moved(made: RawTest, tmp_path: Path) -> None:
    columns = {n: v for n, v in made.columns.items() if n != "time_s"}
    tables = described(made, same, file={"clock": "from rate", "start_s": 7200.0})
    record, _ = read_raw(*write(tmp_path, columns, tables))
    assert record.start_s == 7200.0
    assert "from the sample rate" in record.history[0].did
    np.testing.assert_array_equal(record["T25_A"], made.columns["T25_A"])
    late = {**made.columns, "time_s": made.columns["time_s"] + 3.8e9}
    tables = described(made, same, file={"start_s": 0.5})
    record, _ = read_raw(*write(tmp_path, late, tables))
    assert record.start_s == 0.5
    assert record.n_samples == 501


def dated_parquet(path: Path, columns: Columns) -> None:
    ticks = np.datetime64("2024-05-01T12:00:00", "ns") + (
        np.round(columns["time_s"] * 1e9).astype("timedelta64[ns]")
    )
    rest = {n: v for n, v in columns.items() if n != "time_s"}
    pq.write_table(pa.table({"time_s": pa.array(ticks), **rest}), path)


def dated_netcdf(path: Path, columns: Columns) -> None:
    ticks = np.datetime64("2024-05-01T12:00:00", "ns") + (
        np.round(columns["time_s"] * 1e9).astype("timedelta64[ns]")
    )
    rest = {n: ("time_s", v) for n, v in columns.items() if n != "time_s"}
    dataset = xr.Dataset(rest, coords={"time_s": ticks})
    encoding = {"time_s": {"units": "microseconds since 2024-05-01T11:00:00", "dtype": "int64"}}
    dataset.to_netcdf(path, engine="h5netcdf", encoding=encoding)


def dated_tdms(path: Path, columns: Columns) -> None:
    ticks = np.datetime64("2024-05-01T12:00:00", "us") + (
        np.round(columns["time_s"] * 1e6).astype("timedelta64[us]")
    )
    with TdmsWriter(path) as writer:
        rest = [ChannelObject("g", n, v) for n, v in columns.items() if n != "time_s"]
        writer.write_segment([ChannelObject("g", "time_s", ticks), *rest])


@pytest.mark.parametrize(
    ("name", "writer"),
    [("raw.parquet", dated_parquet), ("raw.nc", dated_netcdf), ("raw.tdms", dated_tdms)],
)
def test_a_clock_of_dates_counts_from_the_first_sample_and_says_so(
    made: RawTest, tmp_path: Path, name: str, writer: Callable[[Path, Columns], None]
) -> None:
    _, toml = made.write(tmp_path)
    writer(tmp_path / name, made.columns)
    record, _ = read_raw(tmp_path / name, toml)
    reference, _ = made.load()
    assert record.start_s == 0.0
    said = record.history[0].did
    assert "seconds from the first sample at 2024-05-01T12:00:00" in said
    for channel in reference.channels:
        np.testing.assert_array_equal(record[channel], reference[channel])


def stating(unit: str, kind: str) -> Callable[[Path, Columns], Path]:
    """Write a file that states one unit for all pressures."""

    def csv(folder: Path, columns: Columns) -> Path:
        path = folder / "stated.csv"
        lines = [",".join(columns)]
        lines.append(",".join({"P": unit, "t": "s"}.get(n[0], "-") for n in columns))
        lines += [
            ",".join(repr(float(v)) for v in row) for row in zip(*columns.values(), strict=True)
        ]
        path.write_text("\n".join(lines), "utf-8")
        return path

    def hdf5(folder: Path, columns: Columns) -> Path:
        path = folder / "stated.h5"
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values
                if name.startswith("P"):
                    file[name].attrs["Units"] = unit
        return path

    def parquet(folder: Path, columns: Columns) -> Path:
        path = folder / "stated.parquet"
        fields = [
            pa.field(n, pa.float64(), metadata={"units": unit} if n.startswith("P") else None)
            for n in columns
        ]
        pq.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), path)
        return path

    def tdms(folder: Path, columns: Columns) -> Path:
        path = folder / "stated.tdms"
        with TdmsWriter(path) as writer:
            writer.write_segment(
                [
                    ChannelObject("g", n, v, {"unit_string": unit} if n.startswith("P") else {})
                    for n, v in columns.items()
                ]
            )
        return path

    return {"csv": csv, "hdf5": hdf5, "parquet": parquet, "tdms": tdms}[kind]


@pytest.mark.parametrize("kind", ["csv", "hdf5", "parquet", "tdms"])
def test_a_unit_that_the_file_states_is_held_against_test_toml(
    made: RawTest, tmp_path: Path, kind: str
) -> None:
    for stated, goes in (("counts", True), ("n/a", True), ("psi", False), ("V", False)):
        raw = stating(stated, kind)(tmp_path, made.columns)
        toml = tmp_path / "test.toml"
        toml.write_text(to_toml(made.description), "utf-8")
        if goes:
            read_raw(raw, toml)
            continue
        words = rf'P25_A_tip_forward: expected the unit "count", as .* found "{stated}", as the fi'
        with pytest.raises(InputError, match=words):
            read_raw(raw, toml)
        tables = {**made.description, "file": {"units": "from test.toml"}}
        toml.write_text(to_toml(tables), "utf-8")
        record, _ = read_raw(raw, toml)
        np.testing.assert_array_equal(
            record["P25_A_tip_forward"], made.columns["P25_A_tip_forward"]
        )


def test_a_gauge_reading_is_never_taken_as_absolute(
    made: RawTest, pascals: Columns, tmp_path: Path
) -> None:
    columns = {"time_s": made.columns["time_s"], **pascals}
    raw = stating("psig", "csv")(tmp_path, columns)
    toml = tmp_path / "test.toml"
    for unit, more, words in (
        ("psia", {}, 'expected the unit "psia", as .* found "psig"'),
        ("psi", {"reference_Pa": 0.0}, 'expected the unit "psi", as .* found "psig"'),
        ("psi", {}, 'reading of 0 "psi" stands for, found nothing'),
    ):
        toml.write_text(to_toml(described(made, in_unit(unit, **more))), "utf-8")
        with pytest.raises(InputError, match=words):
            read_raw(raw, toml)


@pytest.mark.parametrize(
    ("file", "columns", "words"),
    [
        ({"time": "Time"}, {}, r"column Time: expected it in the header.*is 'time_s' meant"),
        ({"time_unit": "rpm"}, {}, "file.time_unit: expected a unit of time"),
        ({}, {"PT 1 [psi]": 1.0}, r'\[channels."PT 1 \[psi\]"\] .* other_columns'),
    ],
)
def test_a_file_table_that_does_not_fit_is_refused(
    made: RawTest, tmp_path: Path, file: Any, columns: dict[str, float], words: str
) -> None:
    added = {n: np.full(501, v) for n, v in columns.items()}
    paths = write(tmp_path, {**made.columns, **added}, {**made.description, "file": file})
    with pytest.raises(InputError, match=words) as caught:
        read_raw(*paths)
    assert "\n" not in str(caught.value)


def test_a_column_that_is_not_there_is_named_with_its_neighbours(
    made: RawTest, tmp_path: Path
) -> None:
    tables = described(made, lambda n, t: {**t, "column": "t25a"} if n == "T25_A" else t)
    words = r"channel T25_A \(column 't25a'\): .* is 'T25_A' meant\? then write column = \"T25_A\""
    with pytest.raises(InputError, match=words):
        read_raw(*write(tmp_path, made.columns, tables))
