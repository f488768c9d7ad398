"""What a command is, and what the commands do alike: read series, write what was asked for."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.cli.options import Argument
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

# What the line on a written file calls it, by the option.
LABELS = {
    "json": "numbers",
    "out": "reconstruction",
    "save_facility": "facility",
}


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
        """Check the files, do the work and print what it gives."""
        self._check_files(given)
        with one_thread():
            for line in self.run(given):
                print(line)

    def _check_files(self, given: argparse.Namespace) -> None:
        """Refuse, before any work is done, a missing input, and a target not to be written."""
        typed = [(each, getattr(given, each.name)) for each in self.arguments]
        read: list[Path] = []
        for each, value in typed:
            if each.read and value is not None:
                read += value if isinstance(value, list) else [value]
        for path in read:
            if not path.exists():
                raise InputError(str(path), expected="a file that exists", found="no such file")
        targets = [(path, each.suffixes) for each, path in typed if each.written and path]
        for path, suffixes in targets:
            check_target(path, suffixes)
        if targets:
            from classic_ml.io.series import ledger_path

            # The ledger beside a series is read too.
            ledgers = (ledger_path(path) for path in read if path.name)
            check_apart([*read, *ledgers], [path for path, _ in targets])


def read_records(paths: Sequence[Path]) -> list[CoefficientSeries]:
    """Read series files, each once: a record that is held out must not be fitted too."""
    from classic_ml.io.series import read_series
    from comparisons.harness.rows import check_once

    records = [read_series(path) for path in paths]
    check_once(records)
    return records


def write_asked(
    given: argparse.Namespace, **contents: Callable[[], str | dict[str, Any] | list[Any]]
) -> list[str]:
    """Write the texts that were asked for once all are made, and return a line on each.

    ``contents`` has, by the name of the option, what makes its text or the document of its JSON.
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
    """Return a folder that can be written to, which need not exist yet."""
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise InputError(str(path), expected="a folder to write to", found="a file")
    return path


def take_away(
    folder: Path | None, pages: Sequence[tuple[str, Sequence[Part]]], answer: Answer
) -> list[str]:
    """Write what a page shows as files where that was asked for, and return a line on it."""
    if folder is None:
        return []
    from comparisons.show.figures import write_figures

    n = write_figures(pages, folder, answer.curve)
    return [f"figures and tables: {folder} ({n} files)"]


def command_line() -> str:
    """Return the command as it was typed, for reports."""
    return " ".join(["sindy-surge", *sys.argv[1:]])
