"""What the commands share: options, files that are checked before any work, what was typed."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from surge_core.errors import InputError
from surge_core.files import check_apart, check_target, write_whole
from surge_core.progress import shown_over

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries

__all__ = [
    "Commands",
    "add_raw",
    "add_series",
    "add_targets",
    "check_files",
    "command_line",
    "fitting",
    "number",
    "read_records",
    "time_constant",
    "whole",
    "write_all",
]

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"

# Suffixes that a target may have; any where none are listed.
SUFFIXES = {"report": (".html", ".htm")}
TARGETS: dict[str, tuple[str, str]] = {
    "json": ("FILE", "write the numbers as JSON"),
    "report": ("FILE.html", "write the report"),
}


def add_series(parser: argparse.ArgumentParser, *, nargs: str = "+") -> None:
    """Add the argument for series files.

    Parameters
    ----------
    parser : argparse parser
        Of a command.
    nargs : str
        How many there are.
    """
    parser.add_argument(
        "series", type=Path, nargs=nargs, metavar="SERIES", help="series (.csv or .nc)"
    )


def add_raw(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for a raw record and the description of its test.

    Parameters
    ----------
    parser : argparse parser
        Of a command.
    """
    formats = "raw record (CSV, MAT, netCDF, HDF5, TDMS, Parquet)"
    parser.add_argument("raw", type=Path, metavar="RAW", help=formats)
    words = "description of the test"
    parser.add_argument("--test", type=Path, required=True, metavar="TEST.toml", help=words)


def add_targets(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add options for files that are written: ``json``, ``report``.

    Parameters
    ----------
    parser : argparse parser
        Of a command.
    *names : str
        Which of them.
    """
    for name in names:
        metavar, words = TARGETS[name]
        parser.add_argument(f"--{name}", type=Path, metavar=metavar, help=words)


def check_files(inputs: Iterable[Path | None], **targets: Path | None) -> None:
    """Refuse, before any work is done, a missing input and a target that must not be written.

    Parameters
    ----------
    inputs : iterable of path or None
        Files that are read; the ledger beside a series is one too.
    **targets : path or None
        Files that are to be written, by the name of their option.

    Raises
    ------
    InputError
        Naming the file.
    """
    from classic_ml.io.series import ledger_path

    read = [path for path in inputs if path is not None]
    for path in read:
        if not path.exists():
            raise InputError(str(path), expected="a file that exists", found="no such file")
    written = {name: path for name, path in targets.items() if path is not None}
    for name, path in written.items():
        check_target(path, SUFFIXES.get(name, ()))
    check_apart([*read, *(ledger_path(path) for path in read if path.name)], written.values())


def read_records(paths: Sequence[Path]) -> list[CoefficientSeries]:
    """Read series files, each once: a record that is held out must not be fitted too.

    Parameters
    ----------
    paths : sequence of path
        The files.

    Raises
    ------
    InputError
        When one cannot be used, or is given twice.
    """
    from classic_ml.io.series import read_series
    from comparisons.harness.rows import check_once

    records = [read_series(path) for path in paths]
    check_once(records)
    return records


def write_all(contents: Iterable[tuple[str, Path | None, Callable[[], str]]]) -> list[str]:
    """Write texts once all are made, and return a line on each.

    Parameters
    ----------
    contents : iterable of (str, path or None, callable)
        What it is, where it goes (nowhere with None) and what makes it.
    """
    made = [(label, path, make()) for label, path, make in contents if path is not None]
    for _, path, text in made:
        write_whole(path, text)
    return [f"{label}: {path}" for label, path, _ in made]


def command_line() -> str:
    """Return the command as it was typed, for reports."""
    return " ".join(["sindy-surge", *sys.argv[1:]])


def fitting(items: Iterable[Any]) -> Iterable[Any]:
    """Show how far fits are, on a terminal only.

    Parameters
    ----------
    items : iterable
        What is fitted.
    """
    return shown_over(items, unit="fit", words="fitting")


def drawing(items: Iterable[Any]) -> Iterable[Any]:
    """Show how far the drawing of a report is, on a terminal only.

    Parameters
    ----------
    items : iterable
        Pictures.
    """
    return shown_over(items, unit="picture", words="drawing")


def whole(low: int, high: int | None = None) -> Callable[[str], int]:
    """Return a type of options: whole numbers within limits.

    Parameters
    ----------
    low, high : int
        The least and the greatest that is taken; no greatest without it.
    """
    limits = f"of at least {low}" if high is None else f"from {low} to {high}"

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if value < low or (high is not None and value > high):
            raise argparse.ArgumentTypeError(f"expected a whole number {limits}, found '{text}'")
        return value

    return read


def number(text: str) -> float:
    """Read a finite number, as a type of options.

    Parameters
    ----------
    text : str
        What was typed.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a number, found '{text}'")
    return value


def time_constant(text: str) -> float:
    """Read a time such as ``18ms``, as a type of options; seconds without a unit.

    Parameters
    ----------
    text : str
        What was typed.
    """
    from comparisons.harness.tau_trial import parse_tau

    try:
        return parse_tau(text)
    except InputError as error:
        # argparse prints the words of its own error alone.
        words = f"expected {error.expected}, found {error.found}; {error.remedy}"
        raise argparse.ArgumentTypeError(words.rstrip("; ")) from None
