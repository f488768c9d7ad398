"""Mistakes on the command line itself, and in where results are to go."""

from __future__ import annotations

import os
from pathlib import Path

from mistake import REDUCE, REFUSED, Mistake, Spoil

__all__ = ["OPTIONS", "TARGETS"]

COMPARE = "compare series.csv"


def _reduce(id_: str, did: str, options: str, *says: str) -> Mistake:
    return Mistake(f"option-{id_}", did, REFUSED, says, f"{REDUCE} {options}")


OPTIONS = (
    Mistake(
        "option-command",
        "there is no such command",
        REFUSED,
        ("reduse", "reduce"),
        "reduse raw.csv",
    ),
    Mistake("option-none", "gives no command", REFUSED, ("COMMAND",), ""),
    Mistake(
        "option-unknown",
        "there is no such option",
        REFUSED,
        ("--cuttoff",),
        f"{REDUCE} --cuttoff 48",
    ),
    Mistake(
        "option-test-missing",
        "leaves test.toml away",
        REFUSED,
        ("--test",),
        "reduce raw.csv -o reduced.csv",
    ),
    _reduce("cutoff-zero", "a cut-off of zero", "--cutoff 0", "--cutoff", "above 0"),
    _reduce("cutoff-nan", "a cut-off of nan", "--cutoff nan", "--cutoff", "nan"),
    _reduce("cutoff-word", "a cut-off in words", "--cutoff 48Hz", "--cutoff", "48Hz"),
    _reduce(
        "cutoff-nyquist",
        "a cut-off beyond half the sample rate",
        "--cutoff 600",
        "--cutoff",
        "600",
        "500",
    ),
    _reduce("order", "a filter of order 4", "--filter-order 4", "--filter-order", "3 or 5"),
    _reduce("phase", "there is no such phase", "--phase sideways", "--phase", "zero"),
    _reduce("threshold-negative", "a negative threshold", "--threshold=-50", "--threshold", "-50"),
    _reduce("threshold-nan", "a threshold of nan", "--threshold nan", "--threshold", "nan"),
    _reduce(
        "hysteresis", "a band wider than the threshold", "--hysteresis 60", "--hysteresis", "60"
    ),
    _reduce(
        "window-reversed",
        "a window that ends before it begins",
        "--window 1.9 0.8",
        "--window",
        "earlier first",
    ),
    _reduce(
        "window-outside",
        "a window beyond the record",
        "--window 5 9",
        "--window",
        "0.000 to 2.000 s",
    ),
    _reduce("window-before", "a window before the surge", "--window 0 0.25", "--window"),
    _reduce("window-one", "a window of one time", "--window 1.0", "--window", "2"),
    Mistake(
        "option-degree",
        "a degree of zero",
        REFUSED,
        ("--degree", "1 to 12"),
        f"{COMPARE} --degree 0",
    ),
    Mistake(
        "option-degree-word",
        "a degree in words",
        REFUSED,
        ("--degree", "two"),
        f"{COMPARE} --degree two",
    ),
    Mistake(
        "option-tau-seconds",
        "τ = 18, meant in milliseconds",
        REFUSED,
        ("--tau", "18"),
        f"{COMPARE} --tau 18",
    ),
    Mistake("option-tau-negative", "a negative τ", REFUSED, ("--tau",), f"{COMPARE} --tau=-18ms"),
    Mistake(
        "option-tau-unit", "τ in minutes", REFUSED, ("--tau", "18min"), f"{COMPARE} --tau 18min"
    ),
    Mistake("option-seed", "a negative seed", REFUSED, ("--seed",), "simulate --seed=-1 -o run"),
    Mistake(
        "option-case",
        "there is no such case",
        REFUSED,
        ("1985", "985"),
        "simulate --case 1985 -o run",
    ),
    Mistake(
        "option-duration",
        "a record of a year",
        REFUSED,
        ("duration",),
        "simulate --duration 3e7 -o run",
    ),
    Mistake(
        "option-jobs", "no worker", REFUSED, ("--jobs",), "study study.toml --out study --jobs 0"
    ),
    Mistake(
        "option-model-degree",
        "an option of the compressor with another model",
        REFUSED,
        ("--degree", "--model"),
        "diagnose --model model.py --fit train.csv --degree 3",
    ),
    Mistake("option-diagnose-nothing", "gives diagnose nothing", REFUSED, ("SERIES",), "diagnose"),
    Mistake(
        "option-size-alone",
        "the size of an effect without the effect",
        REFUSED,
        ("--hide-size", "--hide"),
        "simulate --hide-size 3 -o run",
    ),
    Mistake(
        "option-breakpoints",
        "breakpoints in the wrong order",
        REFUSED,
        ("--breakpoints",),
        "work raw.csv --test test.toml --breakpoints 0.1 0.05",
    ),
    Mistake(
        "option-volume",
        "a volume factor of zero",
        REFUSED,
        ("--volume-factor",),
        "total-system raw.csv --test test.toml --facility facility.toml --volume-factor 0",
    ),
)


def _folder(name: str) -> Spoil:
    return lambda folder: (folder / name).mkdir()


def _unwritable(folder: Path) -> None:
    (folder / "shut").mkdir()
    os.chmod(folder / "shut", 0o500)


def _keep(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "keep.txt").write_text("mine", "utf-8")


TARGETS = (
    Mistake(
        "target-suffix",
        "the series is to be a spreadsheet",
        REFUSED,
        ("reduced.xlsx", ".csv"),
        REDUCE.replace("reduced.csv", "reduced.xlsx"),
    ),
    Mistake(
        "target-folder-missing",
        "the folder of the series is not there",
        REFUSED,
        ("out/reduced.csv", "folder"),
        REDUCE.replace("reduced.csv", "out/reduced.csv"),
    ),
    Mistake(
        "target-is-folder",
        "the series is a folder",
        REFUSED,
        ("reduced.csv", "folder"),
        REDUCE,
        spoil=_folder("reduced.csv"),
    ),
    Mistake(
        "target-raw",
        "the series would replace the raw record",
        REFUSED,
        ("raw.csv", "input"),
        REDUCE.replace("reduced.csv", "raw.csv"),
    ),
    Mistake(
        "target-raw-hard-link",
        "the series would replace a hard link of the raw record",
        REFUSED,
        ("same.csv", "input"),
        REDUCE.replace("reduced.csv", "same.csv"),
        spoil=lambda folder: (folder / "same.csv").hardlink_to(folder / "raw.csv"),
    ),
    Mistake(
        "target-raw-other-way",
        "the series would replace the raw record by another path",
        REFUSED,
        ("raw.csv", "input"),
        REDUCE.replace("reduced.csv", "./sub/../raw.csv"),
        spoil=_folder("sub"),
    ),
    Mistake(
        "target-test",
        "the series would replace test.toml",
        REFUSED,
        ("test.toml",),
        REDUCE.replace("reduced.csv", "test.toml"),
    ),
    Mistake(
        "target-link",
        "the series would replace the raw record through a link",
        REFUSED,
        ("link.csv", "input"),
        REDUCE.replace("reduced.csv", "link.csv"),
        spoil=lambda folder: (folder / "link.csv").symlink_to(folder / "raw.csv"),
    ),
    Mistake(
        "target-ledger",
        "the numbers would replace the ledger of the series",
        REFUSED,
        ("series.ledger.json", "input"),
        f"{COMPARE} --json series.ledger.json",
    ),
    Mistake(
        "target-twice",
        "numbers and model go to one file",
        REFUSED,
        ("out.json", "another output"),
        f"{COMPARE} --json out.json --save out.json",
    ),
    Mistake(
        "target-report-suffix",
        "the report is to be a PDF",
        REFUSED,
        ("report.pdf", ".html"),
        f"{REDUCE} --report report.pdf",
    ),
    Mistake(
        "target-report-is-series",
        "report and series go to one file",
        REFUSED,
        ("reduced.csv",),
        f"{REDUCE} --report reduced.csv",
    ),
    Mistake(
        "target-study",
        "the folder of the study is a file",
        REFUSED,
        ("study.toml",),
        "study study.toml --out study.toml --jobs 1",
    ),
    Mistake(
        "target-simulate",
        "the folder of a simulation has files in it",
        REFUSED,
        ("folder",),
        "simulate -o sub",
        spoil=_keep,
    ),
    Mistake(
        "target-shut",
        "the folder of the series cannot be written to",
        REFUSED,
        ("shut/reduced.csv", "written"),
        REDUCE.replace("reduced.csv", "shut/reduced.csv"),
        spoil=_unwritable,
    ),
    Mistake(
        "target-device",
        "the numbers go to a device",
        REFUSED,
        ("/dev/full", "device"),
        f"{COMPARE} --json /dev/full",
    ),
)
