"""test.toml: each key is checked, and all that is missing or wrong is said at once."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import pytest
from raw_data import RawTest, make_test, to_toml

from classic_ml.io import TestDescription, read_test_description
from surge_core.errors import InputError

PROBE = "P31_B_hub_aft"
CHANNEL = f"channels/{PROBE}"


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


def edited(tables: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return a copy with one key set, or deleted where the value is ``...``."""
    head, _, rest = path.partition("/")
    copy = dict(tables)
    if rest:
        copy[head] = edited(copy.get(head, {}), rest, value)
    elif value is ...:
        del copy[head]
    else:
        copy[head] = value
    return copy


def read(folder: Path, tables: dict[str, Any]) -> TestDescription:
    file = folder / "test.toml"
    file.write_text(to_toml(tables), "utf-8")
    return read_test_description(file)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("test", ..., "test: expected a table with name, sample_rate_hz, .*, found nothing"),
        ("test/sample_rate_hz", "1000", "test.sample_rate_hz: expected a number above 0"),
        ("compressor/gamma", 1.0, "compressor.gamma: .* between 1 and 2, found 1.0"),
        ("compressor/mean_radius_m", 280.0, "mean_radius_m: .* found 280.0; is it in mm"),
        ("planes/25/area_m2", 2938.0, "planes.25.area_m2: .* is it in cm²"),
        ("near_stall/P25_Pa", 55.0, "near_stall.P25_Pa: .* found 55.0; is it in kPa"),
        ("near_stall/P25_Pa", "7.98 psi", "near_stall.P25_Pa: .*absolute pressure"),
        ("adc/bits", 12.0, "adc.bits: expected a whole number from 4 to 32, found 12.0"),
        ("adc", ..., "adc.bits: .* 4 to 32, found nothing; adc.low_V, adc.high_V: .*voltage"),
        (f"{CHANNEL}/calibrate_count", 2048.0, "at least 100 counts from zero_count"),
        (f"{CHANNEL}/calibrate_pressure_Pa", 6.0, "calibrate_pressure_Pa: .*is it in kPa"),
        (f"{CHANNEL}/unit", "psia", f'{PROBE}.unit: expected "count" beside zoc.* found "psia"'),
        (
            f"{CHANNEL}/unit",
            "volts",
            f'{PROBE}.unit: expected "count" or a unit of pressure, .*psi.* found "volts"',
        ),
        (f"{CHANNEL}/reference_Pa", 1e5, f"{PROBE}.reference_Pa: expected none beside"),
        ("channels/T31_A/unit", "psi", "channels.T31_A.unit: expected a unit of temperature"),
        (f"{CHANNEL}/kind", "flow", f'{PROBE}.kind: expected "pressure" or "temperature"'),
        (f"{CHANNEL}/facing", "forward", "one forward .*B_hub_forward.*B_hub_aft.* stated twice"),
        (f"{CHANNEL}/probe_slope", 1.5, "probe_slope: expected that of its mate"),
        (f"{CHANNEL}/column", "T25_A", "a column of its own, found 'T25_A'"),
        ("channels/T25_A/time_constant", 0.01, "'time_constant' .is 'time_constant_s' meant"),
        ("channels", {}, "a thermocouple at plane 25 and .*probes at plane 25 and .*plane 31"),
        ("segmentation/threshold_lbm_s", 0.0, "threshold_lbm_s: "),
        ("segmentaton", {"threshold_lbm_s": 50.0}, "'segmentaton' .is 'segmentation' meant"),
        ("defualts", {}, "file, defaults, found the key 'defualts'"),
        ("window", {"from_s": 2.0, "to_s": 1.0}, "window.to_s: expected more than from_s"),
        ("limits", {"T99": [1.0, 2.0]}, "limits.T99: expected the name of a channel"),
        ("limits", {"T31_A": [600.0, 200.0]}, r"limits.T31_A: expected a range \[low, high\]"),
        (
            "near_stall_shifts",
            {PROBE: 0.1},
            f"shifts.{PROBE}: expected the name of a forward probe",
        ),
        (
            "defaults",
            {"pressur": {"unit": "count"}, "pressure": {"slope": 1.0}, "31": 3.0},
            "defaults.pressur: .* a pattern of no name; .*defaults.pressure: .* found slope; "
            ".*defaults.31: expected a table",
        ),
        ("file", {"time_unit": 3}, "file.time_unit: expected a text"),
        ("file", {"clock": "from the rate"}, "'column' or 'from rate', found 'from the rate'"),
        ("file", 3, "file: expected a table, found 3"),
    ],
)
def test_a_bad_description_is_refused(
    made: RawTest, tmp_path: Path, path: str, value: Any, words: str
) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, edited(made.description, path, value))
    assert str(caught.value).startswith(str(tmp_path / "test.toml"))
    assert "\n" not in str(caught.value)


def test_the_optional_tables_are_read(made: RawTest, tmp_path: Path) -> None:
    plain = read(tmp_path, {k: v for k, v in made.description.items() if k != "segmentation"})
    assert plain.threshold_lbm_s is None
    assert plain.window_s is None
    assert (plain.file.time, plain.file.clock, plain.file.units) == ("time_s", "column", "check")
    tables = {
        "segmentation": {"threshold_lbm_s": "none"},
        "window": {"from_s": 1.8, "to_s": 3.6},
        "limits": {"T31_A": [200.0, 620.0]},
        "near_stall": {
            **made.description["near_stall"],
            "P25_Pa": "7.9771 psia",
            "T25_K": "-0.67 degF",
        },
    }
    test = read(tmp_path, made.description | tables)
    assert test.threshold_lbm_s == "none"
    assert test.window_s == (1.8, 3.6)
    assert dict(test.limits) == {"T31_A": (200.0, 620.0)}
    assert test.near_stall.P25_Pa == pytest.approx(7.9771 * 6894.757293168, rel=1e-12)
    assert pytest.approx(255.0, rel=1e-12) == test.near_stall.T25_K
    assert test.rotor_velocity_m_s == pytest.approx(334.27, abs=0.01)
    assert pickle.loads(pickle.dumps(test)) == test


def test_defaults_stand_for_what_many_channels_share(made: RawTest, tmp_path: Path) -> None:
    """The same test, its calibration written once by kind, by plane and by a pattern of names."""
    expected = read(tmp_path, made.description)
    shared = {"kind", "unit", "plane", "probe_slope", "probe_offset"}
    channels = {}
    for name, table in made.description["channels"].items():
        channels[name] = {key: value for key, value in table.items() if key not in shared}
    defaults: dict[str, Any] = {
        "pressure": {"unit": "count"},
        "temperature": {"unit": "K"},
        "31": {"probe_slope": 4.0},
        "P*": {"kind": "pressure"},
        "T*": {"kind": "temperature"},
        "?25_*": {"plane": 25},
        "?31_*": {"plane": 31},
    }
    for plane in (25, 31):
        for pair in expected.pairs(plane):
            keys = {name: getattr(pair.aft, name) for name in ("probe_slope", "probe_offset")}
            defaults[f"P{pair.name}_*"] = keys
    test = read(tmp_path, {**made.description, "channels": channels, "defaults": defaults})
    assert dataclasses.replace(test, source="") == dataclasses.replace(expected, source="")
    own = {**channels, PROBE: {**channels[PROBE], "probe_slope": 2.0}}
    with pytest.raises(InputError, match=r"probe_slope: expected that of its mate .* and 2"):
        read(tmp_path, {**made.description, "channels": own, "defaults": defaults})
