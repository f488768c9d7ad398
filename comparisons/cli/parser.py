"""The command `sindy-surge`: its commands, and what becomes of a mistake."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from importlib.metadata import version
from io import TextIOWrapper
from typing import Any, NoReturn

from comparisons.cli import commands_records, commands_rigs
from surge_core.errors import InputError

EXIT_DONE = 0
EXIT_UNUSABLE = 2
# 128 + SIGINT, as a shell reports a process that was interrupted.
EXIT_INTERRUPTED = 130
# A sentence that lists all mistakes of a file may be long; beyond this, rows of it are in it.
LONGEST = 1400

# In the order of `--help`.
COMMANDS = (
    commands_rigs.DEMO,
    commands_records.RUN,
    commands_rigs.SIMULATE,
    commands_records.INSPECT,
    commands_records.REDUCE,
    commands_records.LIVE,
    commands_records.COMPARE,
    commands_records.RECONSTRUCT,
    commands_records.DIAGNOSE,
    commands_records.WORK,
    commands_records.ORDERS,
    commands_records.STRUCTURE,
    commands_records.DISCOVER,
    commands_rigs.REPRODUCE,
    commands_rigs.STUDY,
    commands_rigs.BENCH,
    commands_rigs.TOTAL_SYSTEM,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process without it.

    Returns
    -------
    int
        0: done, whatever the verdict; 2: unusable input, said in one sentence on stderr; 130:
        interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show Greek gets a replacement sign, not an exception.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        given = build_parser().parse_args(argv)
        given.command.carry_out(given)
        sys.stdout.flush()
    except InputError as error:
        words = _one_line(str(error))
    except MemoryError:
        words = "input: expected data that fit into memory, found more"
    except BrokenPipeError:
        # `sindy-surge … | head` closes our output: that is not a failure.
        sys.stderr.close()
        return EXIT_DONE
    except OSError as error:
        words = _one_line(f"{error.filename or 'output'}: {error.strerror}")
    except KeyboardInterrupt:
        print("sindy-surge: interrupted; files that were finished are whole", file=sys.stderr)
        return EXIT_INTERRUPTED
    else:
        return EXIT_DONE
    print(f"sindy-surge: {words}", file=sys.stderr)
    return EXIT_UNUSABLE


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all commands; nothing heavy is imported for it."""
    parser: argparse.ArgumentParser = _Parser(
        prog="sindy-surge",
        description="Post-stall characteristics and the time constant of a compressor from its "
        "surge records, by two rival estimators side by side.",
    )
    named = f"sindy-surge {version('sindy-surge')}"
    parser.add_argument("--version", action="version", version=named, help="print the version")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_to(commands)
    return parser


def _one_line(text: str) -> str:
    r"""Return a text as one printable line, its middle left out where it is too long."""
    line = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )
    if len(line) <= LONGEST:
        return line
    first, last = line[: LONGEST // 2], line[-LONGEST // 2 :]
    return f"{first.rpartition(' ')[0] or first} … {last.partition(' ')[2] or last}"


class _Parser(argparse.ArgumentParser):
    """A parser that refuses in one line, without the whole usage above it."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # "-5ms" is a value like "-5": what is wrong with it, its option says.
        self._negative_number_matcher = re.compile(r"-\.?\d.*")

    def error(self, message: str) -> NoReturn:
        words = _one_line(message.removeprefix("argument "))
        self.exit(2, f"{self.prog}: {words}; what is expected: {self.prog} --help\n")
