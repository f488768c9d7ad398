"""The commands on measured records, and on a test as it runs: what is typed."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from comparisons.cli.command import Command
from comparisons.cli.options import (
    FIGURES,
    HOLD,
    JSON,
    METHOD,
    NO_TWINS,
    RAW,
    REDUCTION,
    REPORT,
    SERIES,
    SERIES_SUFFIXES,
    argument,
    folder,
    number,
    reads,
    time_constant,
    whole,
    writes,
)

# More points than this only blacken a picture: 100 s at 1 kHz.
REPORT_ROWS = 100_000
HIGHEST_DEGREE, DEFAULT_DEGREE = 8, 2
# More is no missing effect any more but another model.
MOST_EFFECTS = 3
DEFAULT_MODEL_EFFECTS, MOST_MODEL_EFFECTS = 4, 6
_PART = "of the part of the file that is read, on its clock; the near-stall reading is read with it"
_RECORDS: dict[str, Any] = {"nargs": "+", "default": [], "metavar": "RECORD"}


_OF_LIVE = """\
While it runs, the operating point comes from pressures behind a causal low-pass (48 Hz, about 7 ms
late). Surge is reported when the flow at plane 25 has run backwards for 3 ms, some 12 ms after the
machine itself; the time constant is that of `reduce` and `compare` over the last half minute.

Rows whose clock was had are dropped, what is no row is counted and left out. Where rows are missing
the record goes on as a new piece, matched by the near-stall reading of the first one. The longest
piece is reduced; the rows of all are kept beside it.

The run ends with the input, with the end mark of the format, after --timeout, or with Ctrl-C or
SIGTERM; then the rows are reduced as `reduce` would with the same options. They are on disk all the
time: after a crash, reduce that file.

The feed is lines of text, as `cat raw.csv` gives them. The first line of every connection holds the
names of the columns, the second one may hold their units, every further one a row of plain decimal
numbers. Between them stand commas, semicolons or tabs; beside the latter two a comma may be the
decimal sign. Lines that begin with # count for nothing, but for "#end", which ends
the run."""


def _units(text: str) -> tuple[str, ...]:
    from classic_ml.units import kind_of_unit

    units = tuple(part.strip() for part in text.split(","))
    kinds = [kind_of_unit(unit) for unit in units]
    if len(set(kinds)) < len(kinds) or not {"pressure", "temperature"}.issuperset(kinds):
        raise argparse.ArgumentTypeError(
            f"expected a unit of pressure and one of temperature, as psia,degF, found '{text}'"
        )
    return units


def _add_source(parser: argparse.ArgumentParser) -> None:
    """Add where the rows of `live` come from, and the options of the reduction as a group."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "input", nargs="?", choices=("-",), metavar="-", help="read the standard input"
    )
    source.add_argument(
        "--listen",
        type=_address,
        metavar="[HOST:]PORT",
        help="wait for a sender here, and again when it is gone (default host: 127.0.0.1; "
        "on another address any machine that reaches it can send)",
    )
    source.add_argument("--unix", type=Path, metavar="PATH", help="wait on a Unix socket")
    words = "for the running estimate and for the series at the end"
    group = parser.add_argument_group("options of `reduce`", words)
    for each in REDUCTION:
        group.add_argument(*each.flags, **each.details)


def _address(text: str) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``; the host is this machine without one."""
    host, _, port = text.rpartition(":")
    try:
        return host.strip("[]") or "127.0.0.1", whole(0, 65_535)(port)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"expected HOST:PORT or PORT, found {text!r}") from None


def _seconds(text: str) -> float:
    if (value := number(text)) <= 0.0:
        raise argparse.ArgumentTypeError(f"expected seconds above 0, found {text!r}")
    return value


RUN = Command(
    "run",
    help="from a raw record to the answer: τ, characteristic, what is missing, on one page",
    description="Inspect and reduce a raw record, compare the estimators, choose the terms of the "
    "characteristic, look for what the lag model lacks, and fit the work characteristic where T31 "
    "allows. Leaves report.html, run.json and series.csv in a folder; the terminal has the answer.",
    arguments=(
        *RAW,
        folder(
            "--out",
            default=Path("run"),
            help="folder for the page, the numbers and the series (default: run)",
        ),
        FIGURES,
        NO_TWINS,
    ),
)
INSPECT = Command(
    "inspect",
    help="show what is in a raw record or a series, and draft its test.toml",
    description="Show the channels of a file (CSV, MAT, netCDF, HDF5, TDMS, Parquet) with units, "
    "rate, gaps, ranges and saturation; with --test also which column feeds which channel, the "
    "ranges in SI and what reduce would make of the record.",
    arguments=(
        reads("file", metavar="FILE", help="raw record or series"),
        reads("--test", metavar="TEST.toml", help="description of its test"),
        argument(
            "--group", metavar="NAME", help="group, struct or table to look into, without --test"
        ),
        writes(
            "--draft",
            metavar="TEST.toml",
            help="write a test.toml to begin with; a file that exists is left alone",
        ),
        argument(
            "--units",
            type=_units,
            default=(),
            metavar="UNIT,UNIT",
            help="units of pressure and temperature, as psia,degF, that --draft writes for columns "
            "without one",
        ),
        writes("--json", metavar="FILE", help="write the findings as JSON"),
    ),
)
REDUCE = Command(
    "reduce",
    help="raw counts to φ, ψ' and ψ",
    description="Reduce a raw record: counts to pressures, the airflow equations, φ, ψ', ψ and "
    "the intervals to be fitted.",
    arguments=(
        *RAW,
        writes(
            "-o",
            "--out",
            required=True,
            metavar="SERIES",
            suffixes=SERIES_SUFFIXES,
            help="series (.csv or .nc)",
        ),
        argument(
            "--from-s", type=float, metavar="SECONDS", help=f"start {_PART} (default: all of it)"
        ),
        argument("--to-s", type=float, metavar="SECONDS", help=f"end {_PART} (default: all of it)"),
        *REDUCTION,
        writes(
            "--report",
            metavar="FILE.html",
            suffixes=(".html", ".htm"),
            help=f"report of the reduction; its pictures show at most {REPORT_ROWS} rows",
        ),
    ),
)
LIVE = Command(
    "live",
    help="follow a test as it runs, and reduce it at the end",
    description="Take the rows of a running test from a pipe or a socket, show operating point, "
    "surge and a running estimate, and end with the series that `reduce` gives.",
    arguments=(
        argument("--test", type=Path, required=True, help="description of the test (.toml)"),
        argument(
            "-o",
            "--out",
            type=Path,
            metavar="SERIES",
            help="series (.csv or .nc; default: live-DATE-TIME.csv)",
        ),
        argument("--raw", type=Path, metavar="FILE.csv", help="keep the raw record here"),
        argument(
            "--timeout",
            type=_seconds,
            default=math.inf,
            metavar="S",
            help="end the run after so long without a row (default: wait)",
        ),
        argument(
            "--page",
            type=whole(0, 65535),
            metavar="PORT",
            help="show a page on 127.0.0.1 (0: any free port)",
        ),
        argument("--quiet", action="store_true", help="say nothing but errors"),
    ),
    add=_add_source,
    more=_OF_LIVE,
)
COMPARE = Command(
    "compare",
    help="fit the estimators to the same series and set them side by side",
    description="Fit the paper's maximum-likelihood lag model and the sparse regression to the "
    "same record: characteristics, time constants, reconstructions, held-out errors.",
    arguments=(
        SERIES,
        JSON,
        REPORT,
        FIGURES,
        writes("--save", metavar="MODEL", help="save the fitted models"),
        reads(
            "--model",
            metavar="FILE",
            help="set a lag model with effects, saved by diagnose, beside the estimators: its "
            "numbers are fitted again, its structure stays",
        ),
        argument(
            "--degree",
            type=whole(1, 12),
            default=2,
            metavar="N",
            help="degree of the classical characteristic (default: 2)",
        ),
        METHOD,
        HOLD,
        argument(
            "--tau",
            type=time_constant,
            metavar="TAU",
            help="hold τ of the classical estimators, as 18ms or 0.018 (seconds); else it is "
            "fitted",
        ),
        NO_TWINS,
    ),
)
RECONSTRUCT = Command(
    "reconstruct",
    help="run a saved model over another record",
    description="Run models saved by `compare --save` or `diagnose --save` over other records, "
    "with nothing refitted: the error on rows of the kind that each was fitted to, the share of "
    "them inside its 95 % band, and which lie beyond the φ of the fit.",
    arguments=(
        reads("model", metavar="MODEL", help="saved by compare --save or diagnose --save"),
        SERIES,
        argument(
            "--estimator",
            metavar="NAME",
            help="classic_ml, paper, classic_ml_arx, classic_ml_output_error or sindy; all "
            "without it",
        ),
        writes(
            "-o",
            "--out",
            metavar="FILE.csv",
            suffixes=(".csv",),
            help="write the reconstruction (of one record by one estimator)",
        ),
        JSON,
        REPORT,
    ),
)
DIAGNOSE = Command(
    "diagnose",
    help="find where a model and the records part, and name what is missing",
    description="Fit the lag model, find where its free run and the measurement part, name the "
    "physical effect that is missing, add it, and show on rows that were held out how far the "
    "gap shrinks; or say that nothing is missing, that several names fit alike, or that "
    "something is there without a name. Several records show more than one: the last is never "
    "fitted. With --model the same is asked of a simulation model of your own, of any system: "
    "the file is executed, the records of --fit are fitted, and those of --check are only "
    "simulated.",
    arguments=(
        reads("series", nargs="*", metavar="SERIES", help="series (.csv or .nc)"),
        reads("--model", metavar="model.py", help="your own model, a Python file; executed"),
        reads(
            "--fit", help="records for --model (.csv, .mat, .npz, .nc) that are fitted", **_RECORDS
        ),
        reads("--check", help="records for --model that are only simulated", **_RECORDS),
        JSON,
        REPORT,
        writes("--save", metavar="MODEL", help="save the model with what was added"),
        argument(
            "--degree",
            type=whole(1, HIGHEST_DEGREE),
            metavar="N",
            help=f"degree of the base characteristic (default: {DEFAULT_DEGREE})",
        ),
        argument(
            "--base",
            choices=("polynomial", "sindy"),
            help="base terms: powers of φ up to --degree, or those that the sparse regression "
            "discovers on the fitted rows (default: polynomial)",
        ),
        argument(
            "--limits",
            action="store_true",
            help="plant each effect into these records and say how small it may be and still be "
            "named; takes minutes",
        ),
        argument(
            "--separate",
            action="store_true",
            help="say which further measurement would separate the names of an alias set",
        ),
        NO_TWINS,
        argument(
            "--max-effects",
            type=int,
            metavar="N",
            help=f"add at most so many effects (default and most: {MOST_EFFECTS}; with --model "
            f"{DEFAULT_MODEL_EFFECTS}, at most {MOST_MODEL_EFFECTS})",
        ),
    ),
)
WORK = Command(
    "work",
    help="fit the work characteristic ψ_QS to a raw record with T31",
    description="Reduce a raw record without a low-pass, undo the lag of the thermocouples and "
    "fit the piecewise-linear work characteristic of Fig 22 to the power that the blading "
    "delivers, with rows near zero flow weighted down.",
    arguments=(
        *RAW,
        argument(
            "--breakpoints",
            type=number,
            nargs=2,
            metavar=("D1", "D2"),
            help="φ at which the slope changes (default: searched)",
        ),
        argument("--tau", type=time_constant, metavar="TAU", help="hold τ, as 18ms"),
        JSON,
    ),
)
ORDERS = Command(
    "orders",
    help="choose noise model, order of C, input lag and degree",
    description="Fit every combination of noise model (arx, armax, output error), order of C, "
    "whole-sample lag of φ and degree of the characteristic to the rows of a series, and rank "
    "them by BIC and by the later cycles.",
    arguments=(
        SERIES,
        argument(
            "--degrees",
            type=whole(0, 12),
            nargs="+",
            default=[1, 2, 3],
            metavar="N",
            help="(default: 1 2 3)",
        ),
        argument(
            "--lags",
            type=whole(0, 10_000),
            nargs="+",
            default=[0, 1, 2],
            metavar="K",
            help="(default: 0 1 2)",
        ),
        JSON,
    ),
)
STRUCTURE = Command(
    "structure",
    help="which terms the characteristic has, and how sure that is",
    description="Run the sparse regression alone and report all it finds: terms, errors, "
    "inclusion probabilities, rivals, time constant, dead time, noise, and the structures "
    "tried. A series that carries whole unfiltered runs is fitted by one free run through "
    "them. SparseLagRegressor takes a library, "
    "constraints and optimizers in Python.",
    arguments=(
        SERIES,
        JSON,
        REPORT,
    ),
)
DISCOVER = Command(
    "discover",
    help="the equations of any measured system",
    description="Find dx/dt = Θ(x, u) Ξ from noisy measurements of the states: which terms of a "
    "library each equation has, their coefficients and errors, and the models that the data "
    "cannot separate from it. Several files are several trajectories. SparseDynamics takes any "
    "pysindy library, optimizer and differentiation in Python.",
    arguments=(
        reads("files", nargs="+", metavar="FILE", help="CSV with time_s and a column per state"),
        argument("--states", default="", metavar="x,v", help="columns that are states"),
        argument(
            "--loop",
            action="store_true",
            help="FILE is a reduced series: find the surge loop behind its phi and psi_p "
            "(unfiltered ones where it has them), with one branch or two; the plenum pressure is "
            "the column plenum of a CSV, in the unit of psi_p, and hidden without it",
        ),
        argument("--inputs", default="", metavar="u", help="columns that are inputs"),
        argument(
            "--library",
            default="poly3",
            metavar="SPEC",
            help="candidate terms, such as poly3+sqrt(psi) (default: poly3)",
        ),
        argument("--hidden", default="", metavar="h", help="states that were not measured"),
        argument(
            "--known",
            action="append",
            default=[],
            metavar="EQUATION",
            help="an equation that is given, such as 'phi: psi_c=1.8, psi=-1.8'; one of a "
            "measured state must hold each hidden state",
        ),
        JSON,
        REPORT,
    ),
)
