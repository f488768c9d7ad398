"""The table of mistakes: the likely bad inputs, each tried through the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from mistake import REDUCE, Mistake, Spoil
from spoiling import (
    Values,
    as_bytes,
    as_lines,
    as_text,
    at_rows,
    cell,
    channel,
    every,
    exchanged,
    lines,
    named,
    replaced,
    table,
    toml,
    written,
)
from stored_records import write_stored

Outcome = Literal["refused", "flagged", "harmless"]
PROBE = "P31_B_hub_aft"
PAIRS_25 = tuple(
    (f"P25_{rake}_{place}_forward", f"P25_{rake}_{place}_aft")
    for rake in "AB"
    for place in ("tip", "hub")
)
SAME = (1e-9, 1e-9)
# What leaving out one of four pairs, or a straight line over a few rows, may change.
NEAR = (0.01, 0.05)
COMPARE = "compare series.csv --json compared.json"
MODEL = "reconstruct model.json series.csv -o again.csv"
OWN = "diagnose --model model.py --fit train.csv --report own.html"
STUDY = "study study.toml --out study --jobs 1"
SYSTEM = "total-system raw.csv --test test.toml --facility facility.toml --json system.json"


def refused(id_: str, says: str, spoil: Spoil, command: str = REDUCE) -> Mistake:
    """Return a row that is refused; the words are parted by bars."""
    return Mistake(id_, "refused", tuple(says.split("|")), spoil, command)


def flagged(
    id_: str, says: str, spoil: Spoil, within: tuple[float, float] | None = None
) -> Mistake:
    """Return a row that is reduced with a flag."""
    return Mistake(id_, "flagged", tuple(says.split("|")), spoil, within=within)


def harmless(id_: str, spoil: Spoil) -> Mistake:
    """Return a row that is reduced to the numbers of the clean files."""
    return Mistake(id_, "harmless", (), spoil, within=SAME)


def nothing(_: Path) -> None:
    """Leave the files as they are."""


def stored(suffix: str, change: Callable[[bytes], bytes] = lambda data: data) -> Spoil:
    """Put the record into another format, damaged."""

    def spoil(folder: Path) -> None:
        path = write_stored(folder, suffix)
        path.write_bytes(change(path.read_bytes()))

    return spoil


def halved(data: bytes) -> bytes:
    return data[: len(data) // 2]


def moved(old: str, new: str) -> Spoil:
    """Give a file another name."""

    def spoil(folder: Path) -> None:
        (folder / old).rename(folder / new)

    return spoil


def in_format(suffix: str) -> str:
    return REDUCE.replace("raw.csv", f"raw{suffix}")


def model(**changes: Any) -> Spoil:
    """Set keys of the one model of a saved file."""

    def change(text: str) -> str:
        document = json.loads(text)
        document["models"]["classic_ml"] |= changes
        return json.dumps(document)

    return as_text(change, "model.json")


def gap(read: pd.DataFrame) -> pd.DataFrame:
    return read.drop(index=range(998, 1100))


def spikes(values: Values) -> Values:
    values[900:1900:97] += 700.0
    return np.clip(values, 0.0, 4095.0)


def held(rows: int) -> Callable[[Values], Values]:
    return lambda values: np.repeat(values[::rows], rows)[: values.size]


def noise(values: Values) -> Values:
    return np.round(np.random.default_rng(3).normal(2048.0, 5.0, values.size))


def decimal_commas(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


RAW_FILES = (
    refused("raw-missing", "none.csv|no such file", nothing, REDUCE.replace("raw.csv", "none.csv")),
    refused("raw-no-header", "raw.csv|header|time_s", as_lines(lambda rows: rows[1:])),
    refused(
        "raw-utf16", "raw.csv|UTF-16|UTF-8", as_bytes(lambda data: data.decode().encode("utf-16"))
    ),
    harmless("raw-bom", as_bytes(lambda data: b"\xef\xbb\xbf" + data)),
    harmless("raw-spreadsheet", as_text(decimal_commas)),
    harmless("raw-bars", as_text(lambda text: text.replace(",", "|"))),
    refused("raw-spaces", "raw.csv|commas|spaces", as_text(lambda text: text.replace(",", "  "))),
    refused("clock-dates", "raw.csv|time_s|from rate", cell("time_s", 0, "2026-01-02 10:00:00")),
    refused(
        "raw-decimal-commas",
        "raw.csv|values in every row|row 1",
        lines(lambda line: line.replace(".", ",")),
    ),
    refused("raw-nan", f"{PROBE}|finite|row 812", cell(PROBE, 812, "nan")),
    refused(
        "raw-cut",
        "raw.csv|values in every row|cut short",
        as_text(lambda text: text[: len(text) * 2 // 3].rsplit(",", 4)[0]),
    ),
    refused(
        "raw-channel-missing",
        f"raw.csv|{PROBE}|no such column|test.toml",
        table(lambda read: read.drop(columns=PROBE)),
    ),
    refused("raw-clock-missing", "raw.csv|time_s|Time", named({"time_s": "Time"})),
)
FORMATS = (
    *(
        refused(f"{s[1:]}-cut", f"raw{s}|cut short", stored(s, halved), in_format(s))
        for s in (".mat", ".h5", ".nc", ".tdms", ".parquet")
    ),
    refused("h5-is-csv", "raw.h5|HDF5", moved("raw.csv", "raw.h5"), in_format(".h5")),
)
CLOCKS = (
    refused("clock-gap", "raw.csv|time_s|uniform step", table(gap)),
    refused(
        "clock-ms", "raw.csv|time_s|1000 samples a second|ms", channel("time_s", lambda v: 1e3 * v)
    ),
)
READINGS = (
    refused("counts-16-bit", "raw.csv|12-bit|4095", every("P", lambda v: v * 16.0)),
    refused("couples-celsius", "raw.csv|T25_A|K", every("T", lambda v: v - 273.15)),
    refused(
        "swapped-planes",
        "raw.csv|near stall",
        exchanged(*((name, name.replace("P25", "P31")) for pair in PAIRS_25 for name in pair)),
    ),
    refused("swapped-facing", "raw.csv|25_A_tip|forward and aft exchanged", exchanged(PAIRS_25[0])),
    flagged(
        "swapped-rakes",
        "P25_A_tip_forward|P25_B_tip_forward",
        exchanged(("P25_A_tip_forward", "P25_B_tip_forward")),
    ),
    refused("disconnected", "raw.csv|P25_B_hub_aft", channel("P25_B_hub_aft", noise)),
    flagged(
        "clipped-outside",
        f"{PROBE}|clipped",
        channel(PROBE, at_rows(slice(330, 345), 4095.0)),
        SAME,
    ),
    flagged(
        "clipped-window",
        "pair 31_B_hub|clipped",
        channel(PROBE, at_rows(slice(1000, 1065), 4095.0)),
        NEAR,
    ),
    flagged("spikes", "P25_A_tip_aft", channel("P25_A_tip_aft", spikes), NEAR),
    flagged(
        "stuck",
        "pair 31_B_hub|stuck",
        channel(PROBE, lambda v: at_rows(slice(313, None), v[313])(v)),
        NEAR,
    ),
    refused("held-probe", f"raw.csv|{PROBE}|each value 4 times|late", channel(PROBE, held(4))),
    flagged("couple-dead", "T31", every("T31", lambda v: np.full(v.size, 0.994 * 698.0)), NEAR),
    refused("before-surge", "raw.csv|no surge", as_lines(lambda rows: rows[:280])),
    refused(
        "begins-in-surge", "test.toml|[near_stall]", as_lines(lambda rows: [rows[0], *rows[700:]])
    ),
    flagged("few-cycles", "cycles|uncertain", as_lines(lambda rows: rows[:1340])),
)
TEST_TOML = (
    refused(
        "toml-missing", "none.toml|no such file", nothing, REDUCE.replace("test.toml", "none.toml")
    ),
    refused("toml-cut", "test.toml|TOML", as_text(lambda t: t[:1000], "test.toml")),
    refused(
        "toml-swapped", "raw.csv|TOML", nothing, "reduce test.toml --test raw.csv -o reduced.csv"
    ),
    refused(
        "toml-several",
        f"test.gamma|near_stall.T25_K|{PROBE}.zero_count".replace("test.gamma", "compressor.gamma"),
        toml(
            ("compressor/gamma", 14.0),
            ("near_stall/T25_K", -18.0),
            (f"channels/{PROBE}/zero_count", ...),
        ),
    ),
    harmless("toml-crlf", as_text(lambda text: text.replace("\n", "\r\n"), "test.toml")),
    refused(
        "zero-calibrate-exchanged",
        "raw.csv|W25 and W31|zero and calibrate",
        toml(
            (
                f"channels/{PROBE}",
                lambda t: {
                    **t,
                    "zero_count": t["calibrate_count"],
                    "calibrate_count": t["zero_count"],
                },
            )
        ),
    ),
    flagged(
        "calibrate-plane",
        "all probes of plane 31 read|calibrate_pressure_Pa",
        toml(
            *(
                (f"channels/{name.replace('P25', 'P31')}/calibrate_pressure_Pa", lambda p: 0.8 * p)
                for pair in PAIRS_25
                for name in pair
            )
        ),
    ),
    refused(
        "near-stall-outside",
        "test.toml|[near_stall]|5 to 5.2 s",
        toml(("near_stall/from_s", 5.0), ("near_stall/to_s", 5.2)),
    ),
    refused(
        "threshold-word",
        "test.toml: segmentation.threshold_lbm_s|none|'auto'",
        toml(("segmentation/threshold_lbm_s", "auto")),
    ),
    refused(
        "near-stall-in-surge",
        "test.toml [near_stall]|end before the surge",
        toml(("near_stall/to_s", 0.5)),
    ),
    refused(
        "window-outside",
        "test.toml|[window]|0.000 to 2.000 s",
        toml(("window", {"from_s": 5.0, "to_s": 6.0})),
    ),
    flagged(
        "limits-psi",
        "pair 31_B_hub|beyond its limits",
        toml((f"limits/{PROBE}", [0.0, 300.0])),
        NEAR,
    ),
)
SERIES = (
    refused("series-missing", "none.csv|no such file", nothing, "compare none.csv"),
    refused("series-is-raw", "raw.csv|phi|reduce", nothing, "compare raw.csv"),
    refused(
        "series-time", "series.csv|time_s|rename", named({"time_s": "time"}, "series.csv"), COMPARE
    ),
    refused(
        "series-ms",
        "series.csv|time_s|in ms?|1000",
        channel("time_s", lambda v: 1e3 * v, "series.csv"),
        COMPARE,
    ),
    refused("series-twice", "series.csv|once", nothing, "compare series.csv series.csv"),
    refused(
        "ledger-broken",
        "series.ledger.json|delete it or reduce",
        written("series.ledger.json", "{half"),
        COMPARE,
    ),
)
MODELS = (
    refused(
        "model-and-series-exchanged",
        "series.csv|model",
        nothing,
        "reconstruct series.csv model.json",
    ),
    refused("model-cut", "model.json|model", as_text(lambda t: t[:300], "model.json"), MODEL),
    refused("model-tau-negative", "model.json|time constant", model(time_constant_s=-0.018), MODEL),
    refused("model-hold", "model.json|hold|third", model(hold="third"), MODEL),
    refused(
        "own-syntax", "model.py|line 2|SyntaxError", written("model.py", "x = 1\ny = (\n"), OWN
    ),
    refused("own-column", "train.csv|position", named({"position": "place"}, "train.csv"), OWN),
    refused(
        "own-gap",
        "train.csv|time_s|gap",
        table(lambda read: read.drop(index=range(100, 120)), "train.csv"),
        OWN,
    ),
    refused("study-key", "study.toml|seed", replaced("seeds", "seed", "study.toml"), STUDY),
    refused(
        "study-method",
        "study.toml|classic",
        replaced('"classic_ml"', '"classic"', "study.toml"),
        STUDY,
    ),
    refused(
        "facility-key-missing",
        "facility.toml|discharge_m3",
        toml(("volumes/discharge_m3", ...), file="facility.toml"),
        SYSTEM,
    ),
    refused(
        "facility-breaks",
        "facility.toml|work_break_1|work_break_2",
        toml(("compressor/work_break_1", 9.0), file="facility.toml"),
        SYSTEM,
    ),
)
OPTIONS = tuple(
    refused(id_, says, nothing, command)
    for id_, says, command in (
        ("option-command", "reduse|reduce", "reduse raw.csv"),
        ("option-unknown", "--cuttoff", f"{REDUCE} --cuttoff 48"),
        ("option-test-missing", "--test", "reduce raw.csv -o reduced.csv"),
        ("option-cutoff-nyquist", "--cutoff|600|500", f"{REDUCE} --cutoff 600"),
        ("option-cutoff-no-filter", "--phase none|--cutoff", f"{REDUCE} --phase none --cutoff 30"),
        (
            "raw-is-a-series",
            "series.csv|raw record|compare",
            REDUCE.replace("raw.csv", "series.csv"),
        ),
        ("option-order", "--filter-order|3, 5", f"{REDUCE} --filter-order 4"),
        ("option-window-reversed", "--window", f"{REDUCE} --window 1.5 1.0"),
        ("option-part-reversed", "--to-s", f"{REDUCE} --from-s 1.5 --to-s 1.0"),
        ("option-degree", "--degree|1 to 12", "compare series.csv --degree 40"),
        ("target-suffix", "reduced.xlsx|.csv", REDUCE.replace("reduced.csv", "reduced.xlsx")),
        ("target-folder", "out/reduced.csv|folder", REDUCE.replace("reduced", "out/reduced")),
        ("target-raw", "raw.csv|input", REDUCE.replace("reduced.csv", "raw.csv")),
    )
)
MISTAKES: tuple[Mistake, ...] = (
    *RAW_FILES,
    *FORMATS,
    *CLOCKS,
    *READINGS,
    *TEST_TOML,
    *SERIES,
    *MODELS,
    *OPTIONS,
)
