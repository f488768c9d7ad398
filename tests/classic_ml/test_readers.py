"""Raw records: what is read is what was recorded, and every bad file gets one clear sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raw_data import RawTest, make_test, to_toml, write_csv

from classic_ml.readers import read_raw, read_test_description
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


@pytest.fixture
def files(made: RawTest, tmp_path: Path) -> tuple[Path, Path]:
    return made.write(tmp_path)


def refusal(raw: Path, test: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_raw(raw, test)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert "expected" in sentence
    return sentence


def test_a_raw_record_is_read_as_it_was_recorded(made: RawTest, files: tuple[Path, Path]) -> None:
    record, test = read_raw(*files)
    assert record.n_samples == 501
    assert record.sample_rate_hz == 1000.0
    assert set(record.channels) == set(made.columns) - {"time_s"}
    for name, channel in record.channels.items():
        np.testing.assert_array_equal(channel.values, made.columns[name])
        assert channel.unit == ("K" if name.startswith("T") else "count")
    np.testing.assert_allclose(record.time_s, made.columns["time_s"], atol=1e-12)
    assert record.history[0].step == "read"
    assert len(test.pairs(25)) == len(test.pairs(31)) == 4
    assert {p.name for p in test.pairs(25)} == {"25_A_tip", "25_A_hub", "25_B_tip", "25_B_hub"}


def test_the_order_of_columns_does_not_matter(made: RawTest, tmp_path: Path) -> None:
    raw, test = made.write(tmp_path)
    one, _ = read_raw(raw, test)
    write_csv(raw, dict(reversed(made.columns.items())))
    other, _ = read_raw(raw, test)
    for name in one.channels:
        np.testing.assert_array_equal(one[name], other[name])


def test_a_clock_that_starts_late_keeps_facility_time(made: RawTest, tmp_path: Path) -> None:
    late = {**made.columns, "time_s": made.columns["time_s"] + 7200.0}
    raw, test = RawTest(late, made.description, {}).write(tmp_path)
    record, _ = read_raw(raw, test)
    assert record.start_s == 7200.0


Columns = dict[str, np.ndarray]
PROBE = "P31_B_hub_aft"


def _without(name: str) -> Callable[[Columns], Columns]:
    return lambda columns: {k: v for k, v in columns.items() if k != name}


def _with(name: str, values: Callable[[np.ndarray], np.ndarray]) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, name: values(columns[name].astype(float))}


def _at(row: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[row] = value
        return values

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_without(PROBE), f"raw.csv: channel {PROBE}: .* found no such column"),
        (_without("time_s"), "expected a table with a header and a column time_s"),
        (lambda c: {**c, "P99": c[PROBE]}, r"channel P99: expected a table \[channels.P99\]"),
        (
            lambda c: {**c, "note": np.where(c["time_s"] > 0.2, np.nan, 0.0)},
            r"channel note: expected a table \[channels.note\]",
        ),
        (_with(PROBE, _at(41, np.nan)), f"channel {PROBE}: .* 'nan' in row 42"),
        (_with(PROBE, _at(41, np.inf)), f"channel {PROBE}: .* 'inf' in row 42"),
        (_with(PROBE, _at(7, -3.0)), f"{PROBE}: expected counts of a 12-bit .* -3 in row 8"),
        (_with(PROBE, lambda v: 5e4 + v), f"{PROBE}: expected counts of a 12-bit converter"),
        (_with("T25_A", lambda v: v - 273.15), "T25_A: expected absolute temperatures in K"),
        (_with("time_s", lambda v: v * 1e3), "sample_rate_hz says, found 1; is it in ms"),
        (_with("time_s", lambda v: v * 1.01), "expected 1000 samples a second"),
        (_with("time_s", _at(30, 0.0306)), "a uniform step"),
        (lambda c: {k: np.delete(v, 40) for k, v in c.items()}, "a step of 0.002 s after 0.039"),
        (lambda c: {k: v[:99] for k, v in c.items()}, "at least 100 rows, found 99"),
        (lambda c: {k: v[:0] for k, v in c.items()}, "rows below the header, found none"),
    ],
)
def test_a_bad_table_is_refused(
    made: RawTest, tmp_path: Path, change: Callable[[Columns], Columns], words: str
) -> None:
    raw, test = made.write(tmp_path)
    write_csv(raw, change(dict(made.columns)))
    sentence = refusal(raw, test)
    assert str(raw) in sentence
    with pytest.raises(InputError, match=words):
        read_raw(raw, test)


def _cut(text: str) -> bytes:
    return text[: len(text) * 2 // 3].rsplit(",", 5)[0].encode()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda text: b"", "an empty file"),
        (lambda text: b"\n\n\n", "an empty file"),
        (lambda text: bytes(range(256)) * 40, "binary data|an empty file"),
        (lambda text: text.encode()[:9000] + b"\x00\xff\xfe\x80" * 90, "binary data in row"),
        (_cut, "21 values in every row, found \\d+ in row .* cut short"),
        (lambda t: t.replace("\n", ",1.0\n").replace(",1.0\n", "\n", 1).encode(), "found 22 in"),
        (lambda t: t.replace("0.05,", "0.05,?", 1).encode(), r"P25_A_tip_forward: .* '\?\d"),
        (lambda t: t.replace("0.05,", "0.05,,", 1).encode(), "found 22 in row 51"),
        (lambda t: t.replace("T25_A", "T25_B").encode(), "T25_B: expected each column once"),
        (lambda t: t.replace("T25_A", "").encode(), "a name for every column"),
        (lambda t: t.split("\n", 1)[1].encode(), "a header and a column time_s"),
    ],
)
def test_a_spoiled_file_is_refused(
    files: tuple[Path, Path], content: Callable[[str], bytes], words: str
) -> None:
    raw, test = files
    raw.write_bytes(content(raw.read_text("utf-8")))
    with pytest.raises(InputError, match=words):
        read_raw(raw, test)
    assert str(raw) in refusal(raw, test)


def test_an_empty_cell_is_named(files: tuple[Path, Path]) -> None:
    raw, test = files
    lines = raw.read_text("utf-8").splitlines()
    cells = lines[12].split(",")
    cells[3] = ""
    lines[12] = ",".join(cells)
    raw.write_text("\n".join(lines), "utf-8")
    assert "P25_A_hub_forward" in refusal(raw, test)
    assert "an empty cell in row 12" in refusal(raw, test)


@pytest.mark.parametrize("name", ["nothing.csv", "raw.dat", ""])
def test_a_file_that_is_not_there_or_not_a_table_is_refused(
    files: tuple[Path, Path], name: str
) -> None:
    raw, test = files
    (raw.parent / "raw.dat").write_bytes(raw.read_bytes())
    sentence = refusal(raw.parent / name, test)
    assert any(w in sentence for w in ("no such file", "a folder", "the suffix '.dat'"))


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


CHANNEL = f"channels/{PROBE}"


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("test", ..., r"expected a table \[test\], found none"),
        ("near_stall", ..., r"expected a table \[near_stall\], found none"),
        ("planes/31", ..., r"expected a table \[planes.31\]"),
        ("test/sample_rate_hz", ..., r"\[test\] sample_rate_hz: expected a number above 0"),
        ("test/sample_rate_hz", "1000", "found '1000'"),
        ("test/sample_rate_hz", True, "found true"),
        ("test/sample_rate_hz", -1.0, "above 0, found -1"),
        ("test/name", 7, r"\[test\] name: expected a text, found 7"),
        ("compressor/gamma", 1.0, "above 1 and below 2, found 1"),
        ("compressor/mean_radius_m", 0.0, "in m at least 0.02 and at most 2, found 0"),
        ("compressor/mean_radius_m", 280.0, "a number in m .* found 280; is it in mm"),
        ("compressor/gas_constant_J_kg_K", 53.35, r"in J/\(kg K\) .* air has 287.05"),
        ("compressor/internal_volume_m3", 80.0, "in m³ .* found 80; is it in litres"),
        ("compressor/inertia_per_m", 1e5, "in 1/m .* found 100000"),
        ("planes/25/area_m2", 2938.0, r"\[planes.25\] area_m2: .* in m² .* is it in cm²"),
        ("test/rotor_speed_rpm", 0.0, "revolutions a minute at least 100"),
        ("test/rotor_speed_rpm", 1e6, "at most 200000, found 1e\\+06"),
        ("test/design_corrected_speed_rpm", 20.0, "is it in Hz"),
        ("near_stall/P25_Pa", 55.0, "in Pa .* found 55; is it in kPa"),
        ("near_stall/T25_K", -18.0, "in K .* is it in °C"),
        ("adc/bits", 12.0, "a whole number from 4 to 32, found 12.0"),
        ("adc/high_V", -5.0, r"\[adc\] high_V: expected more than low_V"),
        ("planes/25/area_m2", [1.0], "found \\[1.0\\]"),
        ("near_stall/to_s", 0.0, r"\[near_stall\] to_s: expected a time after from_s"),
        ("near_stall/T25_K", ..., r"\[near_stall\] T25_K"),
        (f"{CHANNEL}/zero_count", ..., rf"\[channels.{PROBE}\] zero_count: .* found nothing"),
        (f"{CHANNEL}/calibrate_count", ..., "calibrate_count: .* found nothing$"),
        (f"{CHANNEL}/calibrate_count", 5000.0, "at most 4095, found 5000"),
        (f"{CHANNEL}/calibrate_count", 2048.0, "at least 100 counts from zero_count"),
        (f"{CHANNEL}/calibrate_pressure_Pa", 0.0, "a pressure other than zero"),
        (f"{CHANNEL}/unit", "psia", r'zoc_reference_Pa: expected none for a channel in "psia"'),
        (f"{CHANNEL}/unit", "codes", r'unit: expected "count", or a unit of .* found "codes"'),
        (f"{CHANNEL}/reference_Pa", 1e5, "reference_Pa: expected none for a channel in counts"),
        ("channels/T31_A/unit", "psi", r"\[channels.T31_A\] unit: expected a unit of temperature"),
        ("channels/T31_A/unit", "delta_degC", r'unit: expected a unit of temp.* "delta_degC"'),
        ("channels/T31_A/unit", 7, r"\[channels.T31_A\] unit: expected a text, found 7"),
        ("adc", ..., r"expected a table \[adc\], since P25_A_tip_forward is in counts"),
        (f"{CHANNEL}/kind", "flow", '"pressure" or "temperature", found "flow"'),
        (f"{CHANNEL}/plane", 26, "plane: expected 25 or 31, found 26"),
        (f"{CHANNEL}/immersion", "mid", '"hub" or "tip"'),
        (f"{CHANNEL}/facing", "forward", "one forward and one aft probe at rake B hub of plane 31"),
        (f"{CHANNEL}/probe_slope", 1.5, "probe_slope: expected the same probe_slope for both"),
        (f"{CHANNEL}/probe_offset", float("nan"), "found nan"),
        ("channels/T25_A/recovery_factor", 0.0, "at least 0.5 and at most 1.1"),
        ("channels/T25_A/time_constant", 0.01, "found 'time_constant'; is 'time_constant_s' meant"),
        ("segmentation/threshold_lbm_s", "off", '"none"'),
        ("segmentation/threshold_lbm_s", 0.0, "above 0"),
        ("segmentation/hysteresis_lbm_s", 50.0, "more than the hysteresis"),
        (
            "segmentation/threshold",
            50.0,
            "only hysteresis_lbm_s, threshold_lbm_s, found 'threshold'; is 'threshold_lbm_s' meant",
        ),
        ("segmentaton", {"threshold_lbm_s": 50.0}, "found 'segmentaton'; is 'segmentation' meant"),
        ("window", {"from_s": 2.0, "to_s": 1.0}, "a time after from_s"),
        ("limits", {"T99": [1.0, 2.0]}, "the name of a channel"),
        ("limits", {"T31_A": [600.0, 200.0]}, r"a range \[low, high\]"),
        ("limits", {"T31_A": 600.0}, r"a range \[low, high\]"),
        ("limits", 3.0, r"expected a table \[limits\], found 3.0"),
        ("channels", {}, r"pressure probes at plane 25, found none"),
    ],
)
def test_a_bad_description_is_refused(
    made: RawTest, tmp_path: Path, path: str, value: Any, words: str
) -> None:
    file = tmp_path / "test.toml"
    file.write_text(to_toml(edited(made.description, path, value)), "utf-8")
    with pytest.raises(InputError, match=words) as caught:
        read_test_description(file)
    assert str(caught.value).startswith(str(file))


@pytest.mark.parametrize("content", [b"", b"[test", b"\xff\xfe\x00", b"a = 1"])
def test_a_file_that_is_not_a_description_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "test.toml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"test\.toml"):
        read_test_description(file)
    with pytest.raises(InputError, match="no such file"):
        read_test_description(tmp_path / "none.toml")
    with pytest.raises(InputError, match="a folder"):
        read_test_description(tmp_path)


def test_the_optional_tables_are_read(made: RawTest, tmp_path: Path) -> None:
    tables = made.description | {
        "segmentation": {"threshold_lbm_s": "none"},
        "window": {"from_s": 1.8, "to_s": 3.6},
        "limits": {"T31_A": [200.0, 620.0]},
    }
    file = tmp_path / "test.toml"
    file.write_text(to_toml(tables), "utf-8")
    test = read_test_description(file)
    assert test.threshold_lbm_s == "none"
    assert test.window_s == (1.8, 3.6)
    assert dict(test.limits) == {"T31_A": (200.0, 620.0)}
    file.write_text(to_toml(made.description), "utf-8")
    plain = read_test_description(file)
    assert plain.threshold_lbm_s == 50.0
    assert plain.window_s is None
    assert plain.hysteresis_lbm_s == 0.0


def test_the_rotor_velocity_is_that_of_the_physical_speed(
    files: tuple[Path, Path],
) -> None:
    test = read_test_description(files[1])
    assert test.rotor_velocity_m_s == pytest.approx(334.27, abs=0.01)


def test_a_description_survives_pickling(files: tuple[Path, Path]) -> None:
    import pickle

    test = read_test_description(files[1])
    assert pickle.loads(pickle.dumps(test)) == test


def test_a_column_of_text_that_nobody_described_is_named_as_such(files: tuple[Path, Path]) -> None:
    raw, test = files
    header, *rows = raw.read_text("utf-8").splitlines()
    raw.write_text("\n".join([header + ",remark", *(row + ",ok" for row in rows)]), "utf-8")
    assert f"channel remark: expected a table [channels.remark] in {test}" in refusal(raw, test)


def test_a_key_that_is_misspelt_is_suggested_where_another_is_missing(
    made: RawTest, tmp_path: Path
) -> None:
    tables = edited(made.description, f"{CHANNEL}/calibrate_count", ...)
    file = tmp_path / "test.toml"
    file.write_text(to_toml(edited(tables, f"{CHANNEL}/calibrate_counts", 3000.0)), "utf-8")
    with pytest.raises(InputError, match="found nothing; is 'calibrate_counts' meant"):
        read_test_description(file)
