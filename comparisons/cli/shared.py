"""What a command is, and what the commands share: options, files, what was typed."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surge_core.errors import InputError
from surge_core.files import check_apart, check_target, to_strict_json, write_whole
from surge_core.progress import shown_over
from surge_core.threads import one_thread

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.page.blocks import Part
    from comparisons.results import Answer

# How far fits, twins, passes of a step and pictures are, on a terminal only.
fitting = partial(shown_over, unit="fit", words="fitting")
measuring = partial(shown_over, unit="twin", words="measuring twins")
working = partial(shown_over, unit="pass")
drawing = partial(shown_over, unit="picture", words="drawing")

LONGEST_TAU_S = 10.0
TIME_UNITS = {None: 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
# What the line on a written file calls it, by the option.
LABELS = {
    "json": "numbers",
    "python": "equation",
    "out": "reconstruction",
    "save_facility": "facility",
}


@dataclass(frozen=True)
class Argument:
    """One argument of a command, as argparse takes it, and whether it is a file.

    Parameters
    ----------
    flags : tuple of str
        Its names.
    details : dict
        Further arguments of ``add_argument``.
    read : bool
        A file that must exist.
    written : bool
        A file that is written.
    suffixes : tuple of str
        Those that a written file may have; any where none are listed.
    """

    flags: tuple[str, ...]
    details: dict[str, Any]
    read: bool = False
    written: bool = False
    suffixes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Where argparse puts the value."""
        long = next((flag for flag in self.flags if flag.startswith("--")), self.flags[0])
        return str(self.details.get("dest", long.lstrip("-").replace("-", "_")))

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Add the argument to a parser, or to a group of one."""
        parser.add_argument(*self.flags, **self.details)


def argument(*flags: str, **details: Any) -> Argument:
    """Return an argument that is no file, or a file that its command checks."""
    return Argument(flags, details)


def reads(*flags: str, metavar: str, **details: Any) -> Argument:
    """Return an argument for files that are read."""
    return Argument(flags, {"type": Path, "metavar": metavar, **details}, read=True)


def writes(*flags: str, metavar: str, suffixes: tuple[str, ...] = (), **details: Any) -> Argument:
    """Return an argument for a file that is written."""
    details = {"type": Path, "metavar": metavar, **details}
    return Argument(flags, details, written=True, suffixes=suffixes)


@dataclass(frozen=True)
class Command:
    """A command of `sindy-surge`.

    Parameters
    ----------
    name, help, description : str
        As in the help.
    arguments : tuple of Argument
        In the order of the help.
    run : callable
        Does the work and gives the lines that are printed.
    add : callable, optional
        Adds to the parser what is no plain argument, ahead of the others.
    formatter : type
        How argparse sets the help.
    """

    name: str
    help: str
    description: str
    arguments: tuple[Argument, ...]
    run: Callable[[argparse.Namespace], Iterable[str]]
    add: Callable[[argparse.ArgumentParser], None] | None = None
    formatter: type[argparse.HelpFormatter] = argparse.HelpFormatter

    def add_to(self, commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
        """Add the command to those of the parser."""
        parser = commands.add_parser(
            self.name,
            help=self.help,
            description=self.description,
            formatter_class=self.formatter,
        )
        if self.add is not None:
            self.add(parser)
        for each in self.arguments:
            each.add_to(parser)
        parser.set_defaults(command=self)

    def carry_out(self, given: argparse.Namespace) -> None:
        """Check the files, do the work and print what it gives.

        Parameters
        ----------
        given : argparse.Namespace
            What was typed.

        Raises
        ------
        InputError
            When an input or an option cannot be used; nothing is written then.
        """
        self.check_files(given)
        with one_thread():
            for line in self.run(given):
                print(line)

    def check_files(self, given: argparse.Namespace) -> None:
        """Refuse, before any work is done, a missing input and a target that must not be written.

        Parameters
        ----------
        given : argparse.Namespace
            What was typed.

        Raises
        ------
        InputError
            Naming the file.
        """
        typed = [(each, getattr(given, each.name)) for each in self.arguments]
        read: list[Path] = []
        for each, value in typed:
            if each.read and value is not None:
                read += value if isinstance(value, list) else [value]
        for path in read:
            if not path.exists():
                raise InputError(str(path), expected="a file that exists", found="no such file")
        written = []
        for each, path in typed:
            if each.written and path is not None:
                check_target(path, each.suffixes)
                written.append(path)
        if written:
            from classic_ml.io.series import ledger_path

            # The ledger beside a series is read too.
            check_apart([*read, *(ledger_path(path) for path in read if path.name)], written)


SERIES = reads("series", nargs="+", metavar="SERIES", help="series (.csv or .nc)")
RAW = (
    reads("raw", metavar="RAW", help="raw record (CSV, MAT, netCDF, HDF5, TDMS, Parquet)"),
    reads("--test", required=True, metavar="TEST.toml", help="description of the test"),
)
JSON = writes("--json", metavar="FILE", help="write the numbers as JSON")
REPORT = writes(
    "--report", metavar="FILE.html", suffixes=(".html", ".htm"), help="write the report"
)
FIGURES = argument(
    "--figures",
    type=Path,
    metavar="DIR",
    help="write every picture of the page as SVG and PDF, every table as CSV and LaTeX, and the "
    "characteristic as a lookup table (CSV, JSON)",
)
SCHEDULER = argument(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler whose workers do the work instead",
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


def seed(what: str = "sensors", highest: int = 2**32 - 1) -> Argument:
    """Return the argument for the seed of something random."""
    words = f"seed of the {what} (default: 0)"
    return argument("--seed", type=whole(0, highest), default=0, metavar="N", help=words)


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


def write_asked(
    given: argparse.Namespace, **contents: Callable[[], str | dict[str, Any] | list[Any]]
) -> list[str]:
    """Write the texts that were asked for once all are made, and return a line on each.

    Parameters
    ----------
    given : argparse.Namespace
        What was typed.
    **contents : callable
        By the name of the option, what makes its text, or the document that becomes JSON.
    """
    made = []
    for name, make in contents.items():
        path = getattr(given, name)
        if path is not None:
            content = make()
            text = content if isinstance(content, str) else to_strict_json(content)
            made.append((name, path, text))
    for _, path, text in made:
        write_whole(path, text)
    return [f"{LABELS.get(name, name)}: {path}" for name, path, _ in made]


def check_folder(path: Path) -> Path:
    """Return a folder that can be written to, which need not exist yet.

    Parameters
    ----------
    path : path
        The folder.

    Raises
    ------
    InputError
        When a file is in its place or above it.
    """
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise InputError(str(path), expected="a folder to write to", found="a file")
    return path


def take_away(
    folder: Path | None, pages: Sequence[tuple[str, Sequence[Part]]], answer: Answer
) -> list[str]:
    """Write what a page shows as files where that was asked for, and return a line on it.

    Parameters
    ----------
    folder : path or None
        Where; nothing is written without it.
    pages : sequence of (str, sequence of Part)
        Sections of the page.
    answer : Answer
        Whose characteristic becomes a lookup table.
    """
    if folder is None:
        return []
    from comparisons.show.figures import write_curve, write_figures

    n = write_figures(pages, folder)
    if answer.curve is not None:
        write_curve(answer.curve, folder)
        n += 2
    return [f"figures and tables: {folder} ({n} files)"]


def command_line() -> str:
    """Return the command as it was typed, for reports."""
    return " ".join(["sindy-surge", *sys.argv[1:]])


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
