"""Planes and immersions by other names than 25, 31, hub and tip; another number of rakes."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raw_data import make_test, to_toml, write_csv

from classic_ml.io import read_raw, read_test_description
from classic_ml.reduction import reduce_record
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record.rakes import rake_signals_of
from comparisons.rig import simulate, write_run
from surge_core.errors import InputError

OTHER = {25: "2", 31: "3"}


def renamed(tables: dict[str, Any], immersions: dict[str, str]) -> dict[str, Any]:
    """Return a test.toml with planes 2 and 3 and other immersions."""
    near = {key.replace("25", "2").replace("31", "3"): v for key, v in tables["near_stall"].items()}
    planes = {
        name: {**tables["planes"][str(plane)], "station": station, "immersions": [*immersions]}
        for (plane, name), station in zip(OTHER.items(), ("inlet", "exit"), strict=True)
    }
    inside = {new: old for old, new in immersions.items()}
    channels = {}
    for key, table in tables["channels"].items():
        channels[key] = {**table, "plane": OTHER[table["plane"]]}
        if "immersion" in table:
            channels[key]["immersion"] = inside[table["immersion"]]
    return {**tables, "near_stall": near, "planes": planes, "channels": channels}


def series_of(raw: Path, tables: dict[str, Any]) -> CoefficientSeries:
    test = raw.with_name("other.toml")
    test.write_text(to_toml(tables), "utf-8")
    return reduce_record(*read_raw(raw, test)).series


def test_other_names_give_the_same_series(tmp_path: Path) -> None:
    write_run(simulate("985", seed=3, duration_s=2.5), tmp_path)
    raw = tmp_path / "raw.csv"
    tables = tomllib.loads((tmp_path / "test.toml").read_text("utf-8"))
    plain = series_of(raw, tables)
    other = series_of(raw, renamed(tables, {"inner": "hub", "outer": "tip"}))
    assert other.columns().keys() == plain.columns().keys()
    for name, column in plain.columns().items():
        found, expected = (each.astype(float) for each in (other.columns()[name], column))
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0, err_msg=name)


def test_an_immersion_between_takes_part_in_the_averages(tmp_path: Path) -> None:
    """A mid immersion that reads the mean of hub and tip leaves φ as it is, near enough."""
    made = make_test(seconds=3.0, quantise=False)
    raw, test = made.write(tmp_path)
    plain = reduce_record(*read_raw(raw, test)).series
    channels, columns = dict(made.description["channels"]), dict(made.columns)
    for name in [name for name in channels if "_hub_" in name]:
        mid, tip = name.replace("hub", "50"), name.replace("hub", "tip")
        # In pressure: with the law of the hub's probe, counts of the hub's calibration.
        hub_table, tip_table = channels[name], channels[tip]
        pressures = [in_pascal(columns[n], t) for n, t in ((name, hub_table), (tip, tip_table))]
        channels[mid] = {**hub_table, "immersion": "50"}
        columns[mid] = in_counts(np.mean(pressures, axis=0), hub_table)
    planes = {
        name: {**table, "immersions": ["hub", "50", "tip"]}
        for name, table in made.description["planes"].items()
    }
    write_csv(raw, columns)
    series = series_of(raw, {**made.description, "planes": planes, "channels": channels})
    assert "Wc25_A_50_kg_s" in series.rakes
    signals = rake_signals_of(series)
    assert signals is not None
    levels = [signals.at(signals.flow_kg_s, 25, each) for each in ("hub", "50", "tip")]
    expected = np.mean([level for level in levels if level is not None], axis=0)
    np.testing.assert_allclose(signals.mean(signals.flow_kg_s, 25), expected, rtol=1e-12)
    assert signals.hub_minus_tip() is not None
    assert np.sqrt(np.mean((series.phi - plain.phi) ** 2)) < 0.02


def in_pascal(counts: np.ndarray, table: dict[str, Any]) -> np.ndarray:
    gain = (table["calibrate_count"] - table["zero_count"]) / table["calibrate_pressure_Pa"]
    return np.asarray((counts - table["zero_count"]) / gain + table["zoc_reference_Pa"])


def in_counts(pressure: np.ndarray, table: dict[str, Any]) -> np.ndarray:
    gain = (table["calibrate_count"] - table["zero_count"]) / table["calibrate_pressure_Pa"]
    return np.asarray(table["zero_count"] + gain * (pressure - table["zoc_reference_Pa"]))


@pytest.mark.parametrize("rakes", ["A", "ABC"])
def test_any_number_of_rakes(tmp_path: Path, rakes: str) -> None:
    made = make_test(seconds=3.0)
    channels, columns = made.description["channels"], made.columns
    for name in [name for name in channels if "_B" in name]:
        table, values = channels[name], columns[name]
        if "B" not in rakes:
            del channels[name], columns[name]
        else:
            other = name.replace("_B", "_C")
            channels[other], columns[other] = {**table, "rake": "C"}, values
    series = reduce_record(*made.load()).series
    truth = made.truth["phi"]
    assert np.sqrt(np.mean((series.phi - truth)[100:-100] ** 2)) < 0.05


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("planes/2", "station", ..., "planes: expected two tables.* 2 .without a station.*25 and"),
        ("planes/3", "station", "inlet", r"found 2 .inlet., 3 .inlet."),
        ("planes/2", "area_m2", 2938.0, "planes.2.area_m2: .* found 2938"),
        ("planes/2", "immersions", ["a", "b_c", "d"], "planes.2.immersions: expected names from"),
        ("channels/P25_A_tip_aft", "plane", 25, "P25_A_tip_aft.plane: expected 2 or 3, found '25'"),
        ("channels/P25_A_tip_aft", "immersion", "tip", '"inner" or "outer", found \'tip\''),
        ("near_stall", "P2_Pa", ..., "near_stall.P2_Pa: expected an absolute .* found nothing"),
        ("near_stall", "P25_Pa", 55e3, "keys out of .*P2_Pa, .*found the key 'P25_Pa"),
        ("defaults", "25", {"unit": "K"}, "defaults.25: .* a pattern of no name"),
    ],
)
def test_wrong_names_are_refused_with_the_choices(
    tmp_path: Path, table: str, key: str, value: Any, words: str
) -> None:
    tables = renamed(make_test(seconds=0.5).description, {"inner": "hub", "outer": "tip"})
    place = tables
    for part in table.split("/"):
        place = place.setdefault(part, {})
    place[key] = value
    if value is ...:
        del place[key]
    file = tmp_path / "test.toml"
    file.write_text(to_toml(tables), "utf-8")
    with pytest.raises(InputError, match=words):
        read_test_description(file)
