"""What a command is: what is typed, and the module of its name that does the work."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from comparisons.cli.options import Argument
from surge_core.errors import InputError
from surge_core.files import check_apart, check_target
from surge_core.threads import one_thread


@dataclass(frozen=True)
class Command:
    """A command of `sindy-surge`; the module of its name gives the lines that are printed.

    ``arguments`` stand in the order of the help; ``add`` adds what is no plain argument, ahead of
    them; ``more`` stands below the help as it is.
    """

    name: str
    help: str
    description: str
    arguments: tuple[Argument, ...]
    add: Callable[[argparse.ArgumentParser], None] | None = None
    more: str = ""

    def add_to(self, commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
        """Add the command to those of the parser."""
        parser = commands.add_parser(
            self.name, help=self.help, description=self.description, epilog=self.more
        )
        if self.more:
            parser.formatter_class = argparse.RawDescriptionHelpFormatter
        if self.add is not None:
            self.add(parser)
        for each in self.arguments:
            parser.add_argument(*each.flags, **each.details)
        parser.set_defaults(command=self)

    def carry_out(self, given: argparse.Namespace) -> None:
        """Check the files, do the work and print what it gives."""
        self._check_files(given)
        # Loaded here: `--help` stays instant.
        module = import_module(f"comparisons.cli.{self.name.replace('-', '_')}")
        with one_thread():
            for line in module.run(given):
                print(line)

    def _check_files(self, given: argparse.Namespace) -> None:
        """Refuse, before any work is done, a missing input, and a target not to be written."""
        typed = [(each, getattr(given, each.name)) for each in self.arguments]
        read: list[Path] = []
        for each, value in typed:
            if each.file == "read" and value:
                read += value if isinstance(value, list) else [value]
        for path in read:
            if not path.exists():
                raise InputError(str(path), expected="a file that exists", found="no such file")
        for each, path in typed:
            # The nearest that is there must be a folder.
            above = (path, *path.absolute().parents) if each.file == "folder" and path else ()
            if not next((place.is_dir() for place in above if place.exists()), True):
                raise InputError(str(path), expected="a folder to write to", found="a file")
        targets = [(path, each.suffixes) for each, path in typed if each.file == "written" and path]
        for path, suffixes in targets:
            check_target(path, suffixes)
        if targets:
            from classic_ml.io.series import ledger_path

            # The ledger beside a series is read too.
            ledgers = (ledger_path(path) for path in read if path.name)
            check_apart([*read, *ledgers], [path for path, _ in targets])
