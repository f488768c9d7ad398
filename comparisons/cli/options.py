"""Arguments of commands: what an argument is, types of values, and those that commands share."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

LONGEST_TAU_S = 10.0
SERIES_SUFFIXES = (".csv", ".nc", ".nc4", ".netcdf")
TIME_UNITS = {None: 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}


@dataclass(frozen=True)
class Argument:
    """One argument of a command, as argparse takes it, and whether it is a file."""

    flags: tuple[str, ...]  # Its names
    details: dict[str, Any]  # Further arguments of ``add_argument``
    # A file that must exist, one that is written, or a folder to write to, which need not exist.
    file: Literal["", "read", "written", "folder"] = ""
    suffixes: tuple[str, ...] = ()  # Those that a written file may have; any where none are listed

    @property
    def name(self) -> str:
        """Where argparse puts the value."""
        long = next((flag for flag in self.flags if flag.startswith("--")), self.flags[0])
        return str(self.details.get("dest", long.lstrip("-").replace("-", "_")))


def argument(*flags: str, **details: Any) -> Argument:
    """Return an argument that is no file, or a file that its command checks."""
    return Argument(flags, details)


def reads(*flags: str, **details: Any) -> Argument:
    """Return an argument for files that are read."""
    return Argument(flags, {"type": Path, **details}, "read")


def writes(*flags: str, suffixes: tuple[str, ...] = (), **details: Any) -> Argument:
    """Return an argument for a file that is written."""
    return Argument(flags, {"type": Path, **details}, "written", suffixes)


def folder(*flags: str, **details: Any) -> Argument:
    """Return an argument for a folder to write to, which need not exist yet."""
    return Argument(flags, {"type": Path, "metavar": "DIR", **details}, "folder")


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a type of options: whole numbers within limits, both of which are taken."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            words = f"expected a whole number from {low} to {high}, found '{text}'"
            raise argparse.ArgumentTypeError(words)
        return value

    return read


def number(text: str) -> float:
    """Read a finite number, as a type of options."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a number, found '{text}'")
    return value


def time_constant(text: str) -> float:
    """Read a time such as ``18ms``, as a type of options; seconds without a unit."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(s|ms|us|µs)?\s*", text)
    try:
        seconds = float(match[1]) * TIME_UNITS[match[2]] if match else math.nan
    except ValueError:
        seconds = math.nan
    if 0.0 < seconds <= LONGEST_TAU_S:
        return seconds
    found = f"{seconds:g} s" if math.isfinite(seconds) else repr(text)
    # A plain 18 is 18 ms without its unit, not 18 s.
    bare = match is not None and match[2] is None and seconds > LONGEST_TAU_S
    remedy = f"; write {text.strip()}ms if milliseconds are meant" if bare else ""
    raise argparse.ArgumentTypeError(
        "expected a time constant such as 18ms or 0.018 (seconds), above 0 and up to "
        f"{LONGEST_TAU_S:g} s, found {found}{remedy}"
    )


def seed(highest: int = 2**32 - 1) -> Argument:
    """Return the argument for the seed of a rig."""
    words = "seed of the sensors (default: 0)"
    return argument("--seed", type=whole(0, highest), default=0, metavar="N", help=words)


SERIES = reads("series", nargs="+", metavar="SERIES", help="series (.csv or .nc)")
RAW = (
    reads("raw", metavar="RAW", help="raw record (CSV, MAT, netCDF, HDF5, TDMS, Parquet)"),
    reads("--test", required=True, metavar="TEST.toml", help="description of the test"),
)
JSON = writes("--json", metavar="FILE", help="write the numbers as JSON")
REPORT = writes(
    "--report", metavar="FILE.html", suffixes=(".html", ".htm"), help="write the report"
)
FIGURES = folder(
    "--figures",
    help="write every picture of the page as SVG and PDF, every table as CSV and LaTeX, and the "
    "characteristic as a lookup table (CSV, JSON)",
)
METHOD = argument(
    "--method",
    action="append",
    default=[],
    metavar="MODULE:CLASS",
    help="a method of your own beside the others: a class with fit and predict; or pysindy, frols, "
    "narx, prediction_error; may be repeated",
)
HOLD = argument(
    "--hold",
    choices=("first", "zero"),
    default="first",
    help="φ between its samples: joined by lines, or held as in Eq 9 (default: first)",
)
NO_TWINS = argument(
    "--no-twins",
    action="store_true",
    help="do not measure twins of the records from raw counts: twice as quick, but the interval of "
    "classic_ml lacks the errors of calibration and of noise near zero flow, and every name of a "
    "missing effect is provisional",
)
# The options of a reduction, which `live` has too; each is stored under the name of the field of
# the settings behind it.
REDUCTION = (
    argument(
        "--filter-order",
        type=whole(1, 99),
        metavar="N",
        help="Butterworth order, 3 or 5 (default: 3)",
    ),
    argument(
        "--cutoff",
        dest="cutoff_hz",
        type=number,
        metavar="HZ",
        help="filter cut-off (default: 48)",
    ),
    argument(
        "--phase",
        choices=("zero", "causal", "none"),
        help="filter direction (default: zero)",
    ),
    argument(
        "--invert-thermocouples",
        dest="thermocouple_inversion",
        action="store_const",
        const=True,
        help="undo the lag of the thermocouples",
    ),
    argument(
        "--threshold",
        dest="threshold_lbm_s",
        type=number,
        metavar="LBM_S",
        help="corrected flow below which the machine is in stall (default: test.toml's, else "
        "estimated from the record)",
    ),
    argument(
        "--window",
        dest="window_s",
        type=number,
        nargs=2,
        metavar=("FROM_S", "TO_S"),
        help="window of the quasi-steady cycles, else from test.toml, else found",
    ),
)
