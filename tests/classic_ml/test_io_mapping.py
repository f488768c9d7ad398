"""Users' names, units and clocks: test.toml maps them, and what does not fit gets a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from raw_data import RawTest, make_test, pascals_of, to_toml, write_csv

from classic_ml.description import COUNT_KEYS
from classic_ml.faults.search import inspect_readings
from classic_ml.io import read_raw
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError

PSI = 0.45359237 * 9.80665 / 0.0254**2
BAROMETER_PA = 101_200.0
Tables = dict[str, Any]
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


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
    "psia": ("degC", {}, lambda p: p / PSI),
    "psig": ("degF", {"reference_Pa": BAROMETER_PA}, lambda p: (p - BAROMETER_PA) / PSI),
    "psid": ("degR", {"reference_Pa": 250e3}, lambda p: (p - 250e3) / PSI),
    "mbar gauge": ("K", {"reference_Pa": "1.012 bar abs"}, lambda p: (p - BAROMETER_PA) / 1e2),
}
TEMPERATURES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "K": lambda t: t,
    "degC": lambda t: t - 273.15,
    "degF": lambda t: (t - 273.15) * 1.8 + 32.0,
    "degR": lambda t: t * 1.8,
}


def in_other_units(made: RawTest, unit: str) -> tuple[Columns, Tables]:
    """Return the columns and the description of a record in a unit of pressure."""
    temperature, more, from_pascals = UNITS[unit]
    columns = {
        n: from_pascals(v) if n.startswith("P") else TEMPERATURES[temperature](v)
        for n, v in pascals_of(made.columns, made.description["channels"]).items()
    }
    tables = described(made, in_unit(unit, temperature, **more))
    del tables["adc"]
    return {"time_s": made.columns["time_s"], **columns}, tables


@pytest.mark.parametrize("unit", UNITS)
def test_pressures_in_any_unit_are_those_of_the_counts(
    made: RawTest, tmp_path: Path, unit: str
) -> None:
    record, _ = read_raw(*write(tmp_path, *in_other_units(made, unit)))
    assert {channel.unit for channel in record.channels.values()} == {"Pa", "K"}
    for name, values in pascals_of(made.columns, made.description["channels"]).items():
        np.testing.assert_allclose(record[name], values, rtol=1e-14, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(("unit", "value"), [("psia", 0.0), ("psig", -14.7)])
def test_no_pressure_is_below_nothing(
    made: RawTest, tmp_path: Path, unit: str, value: float
) -> None:
    columns, tables = in_other_units(made, unit)
    columns["P25_A_tip_aft"][300] = value
    one = inspect_readings(*read_raw(*write(tmp_path, columns, tables)))
    assert np.flatnonzero(one.marks("P25_A_tip_aft")).tolist() == [300]
    columns["P25_A_tip_aft"][300:400] = value
    with pytest.raises(
        InputError, match=r"P25_A_tip_aft: .* above 0 Pa, found .* in row 301; .* reference_Pa"
    ):
        read_raw(*write(tmp_path, columns, tables))


def test_a_record_in_psi_is_reduced_to_the_numbers_of_the_counts(tmp_path: Path) -> None:
    """The whole way: the same surge recorded as counts, and as psig with degF, gives one series."""
    made = make_test(seconds=2.0)
    found = reduce_record(*read_raw(*write(tmp_path, *in_other_units(made, "psig")))).series
    expected = reduce_record(*made.load()).series
    np.testing.assert_array_equal(found.segment, expected.segment)
    np.testing.assert_allclose(found.phi, expected.phi, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.psi_p, expected.psi_p, rtol=1e-10, atol=1e-9)


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
    tables = described(made, same, file={"time_unit": "rpm"})
    with pytest.raises(InputError, match=r"file.time_unit: expected a unit of time"):
        read_raw(*write(tmp_path, columns, tables))


def stating(unit: str, folder: Path, columns: Columns) -> Path:
    """Write a file that states one unit for all pressures."""
    header, *rows = pd.DataFrame(columns).to_csv(index=False).splitlines()
    units = ",".join({"P": unit, "t": "s"}.get(name[0], "-") for name in columns)
    path = folder / "stated.csv"
    path.write_text("\n".join([header, units, *rows]), "utf-8")
    return path


@pytest.mark.parametrize("stated", ["counts", "n/a", "psi", "V"])
def test_a_unit_that_the_file_states_is_held_against_test_toml(
    made: RawTest, tmp_path: Path, stated: str
) -> None:
    raw, toml = stating(stated, tmp_path, made.columns), tmp_path / "test.toml"
    toml.write_text(to_toml(made.description), "utf-8")
    if stated in ("psi", "V"):
        words = rf'P25_A_tip_forward: expected the unit "count", as .* found "{stated}", as the fi'
        with pytest.raises(InputError, match=words):
            read_raw(raw, toml)
        tables = {**made.description, "file": {"units": "from test.toml"}}
        toml.write_text(to_toml(tables), "utf-8")
    record, _ = read_raw(raw, toml)
    np.testing.assert_array_equal(record["P25_A_tip_forward"], made.columns["P25_A_tip_forward"])
