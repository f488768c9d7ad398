"""Mistakes in how test.toml is written: no TOML, values of another type, unknown names."""

from __future__ import annotations

from mistake import HARMLESS, REDUCE, REFUSED, Mistake
from spoiling import as_bytes, as_text, replaced, toml, written

__all__ = ["TYPES"]

PROBE = "P31_B_hub_aft"
CHANNEL = f"channels/{PROBE}"
SAME = (1e-9, 1e-9)
SOURCE = "test.toml"

TYPES = (
    Mistake(
        "toml-missing",
        "test.toml is not there",
        REFUSED,
        ("none.toml", "no such file"),
        REDUCE.replace("test.toml", "none.toml"),
    ),
    Mistake(
        "toml-empty",
        "test.toml is empty",
        REFUSED,
        ("test.toml", "[test]"),
        spoil=written(SOURCE, ""),
    ),
    Mistake(
        "toml-cut",
        "test.toml ends in the middle of a line",
        REFUSED,
        ("test.toml", "TOML", "line"),
        spoil=as_text(lambda text: text[: text.index("zero_count") + 12], SOURCE),
    ),
    Mistake(
        "toml-noise",
        "test.toml is binary noise",
        REFUSED,
        ("test.toml", "TOML"),
        spoil=written(SOURCE, b"\xff\xfe\x00\x01" * 400),
    ),
    Mistake(
        "toml-utf16",
        "test.toml is saved as UTF-16",
        REFUSED,
        ("test.toml", "UTF-8"),
        spoil=as_bytes(lambda data: data.decode().encode("utf-16"), SOURCE),
    ),
    Mistake(
        "toml-bom",
        "test.toml begins with a byte-order mark, as Windows programs write it",
        HARMLESS,
        why="the mark is skipped",
        within=SAME,
        spoil=as_bytes(lambda data: b"\xef\xbb\xbf" + data, SOURCE),
    ),
    Mistake(
        "toml-crlf",
        "the lines of test.toml end as on Windows",
        HARMLESS,
        why="both ends of line are read",
        within=SAME,
        spoil=as_text(lambda text: text.replace("\n", "\r\n"), SOURCE),
    ),
    Mistake(
        "toml-is-json",
        "test.toml is JSON",
        REFUSED,
        ("test.toml", "TOML"),
        spoil=written(SOURCE, '{"test": {"name": "x"}}'),
    ),
    Mistake(
        "toml-swapped",
        "raw record and description are exchanged on the command line",
        REFUSED,
        ("raw.csv", "TOML"),
        "reduce test.toml --test raw.csv -o reduced.csv",
    ),
    Mistake(
        "toml-string",
        "a number is in quotation marks",
        REFUSED,
        ("test.toml", "[test]", "rotor_speed_rpm", "number", "11400"),
        spoil=toml(("test/rotor_speed_rpm", "11400")),
    ),
    Mistake(
        "toml-bool",
        "a number is true",
        REFUSED,
        ("test.toml", "[compressor]", "gamma", "true"),
        spoil=toml(("compressor/gamma", True)),
    ),
    Mistake(
        "toml-list",
        "a number is a list",
        REFUSED,
        ("test.toml", "planes.25", "area_m2", "[0.2938]"),
        spoil=toml(("planes/25/area_m2", [0.2938])),
    ),
    Mistake(
        "toml-table",
        "a number is a table",
        REFUSED,
        ("test.toml", "[near_stall]", "P25_Pa", "table"),
        spoil=toml(("near_stall/P25_Pa", {"value": 55e3})),
    ),
    Mistake(
        "toml-number-for-table",
        "a table is a number",
        REFUSED,
        ("test.toml", "[adc]", "12"),
        spoil=toml(("adc", 12)),
    ),
    Mistake(
        "toml-list-for-table",
        "a table is written twice, as [[adc]]",
        REFUSED,
        ("test.toml", "[adc]", "[a table]"),
        spoil=replaced("[adc]", "[[adc]]", SOURCE),
    ),
    Mistake(
        "toml-number-for-text",
        "the name of the test is a number",
        REFUSED,
        ("test.toml", "[test]", "name", "text", "7"),
        spoil=toml(("test/name", 7)),
    ),
    Mistake(
        "toml-float-for-whole",
        "the number of bits is a float",
        REFUSED,
        ("test.toml", "[adc]", "bits", "whole"),
        spoil=toml(("adc/bits", 12.5)),
    ),
    Mistake(
        "toml-whole-for-float",
        "a length is a whole number",
        HARMLESS,
        why="a whole number is a number",
        within=SAME,
        spoil=toml(("near_stall/P25_Pa", 55000), ("test/sample_rate_hz", 1000)),
    ),
    Mistake(
        "toml-nan",
        "a number is nan",
        REFUSED,
        ("test.toml", "[adc]", "low_V", "nan"),
        spoil=toml(("adc/low_V", float("nan"))),
    ),
    Mistake(
        "toml-inf",
        "a number is inf",
        REFUSED,
        ("test.toml", "inertia_per_m", "inf"),
        spoil=toml(("compressor/inertia_per_m", float("inf"))),
    ),
    Mistake(
        "toml-huge-whole",
        "a number has 400 digits",
        REFUSED,
        ("test.toml", "internal_volume_m3"),
        spoil=replaced("internal_volume_m3 = 0.08", "internal_volume_m3 = 1" + "0" * 400, SOURCE),
    ),
    Mistake(
        "toml-too-many-digits",
        "a number has 5000 digits",
        REFUSED,
        ("test.toml",),
        spoil=replaced("internal_volume_m3 = 0.08", "internal_volume_m3 = 1" + "0" * 5000, SOURCE),
    ),
    Mistake(
        "toml-date",
        "a number is a date",
        REFUSED,
        ("test.toml", "[near_stall]", "from_s"),
        spoil=replaced("from_s = 0.0", "from_s = 2026-01-01", SOURCE),
    ),
    Mistake(
        "toml-key-misspelt",
        "a key is misspelt",
        REFUSED,
        ("test.toml", "zero_counts", "zero_count"),
        spoil=toml(
            (
                CHANNEL,
                lambda t: {"zero_counts" if k == "zero_count" else k: v for k, v in t.items()},
            )
        ),
    ),
    Mistake(
        "toml-table-misspelt",
        "a table is misspelt",
        REFUSED,
        ("test.toml", "segmentaton", "segmentation"),
        spoil=toml(("segmentaton/threshold_lbm_s", 50.0)),
    ),
    Mistake(
        "toml-key-twice",
        "a key is there twice",
        REFUSED,
        ("test.toml", "line"),
        spoil=replaced("gamma = 1.4", "gamma = 1.4\ngamma = 1.3", SOURCE),
    ),
    Mistake(
        "toml-table-twice",
        "a table is there twice",
        REFUSED,
        ("test.toml", "adc", "line"),
        spoil=as_text(lambda text: text + "\n[adc]\nbits = 12\n", SOURCE),
    ),
    Mistake(
        "toml-nested",
        "a value is nested a hundred thousand deep",
        REFUSED,
        ("test.toml", "nested"),
        spoil=as_text(lambda text: text + "\n[deep]\nx = " + "[" * 100_000 + "]" * 100_000, SOURCE),
    ),
    Mistake(
        "toml-huge",
        "test.toml is a data file of 30 MB",
        REFUSED,
        ("test.toml",),
        spoil=written(SOURCE, b"0.1,0.2\n" * 4_000_000),
    ),
)
