"""The command `sindy-surge`: what each sub-command takes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO, TypeAlias, cast

from comparisons.cli.diagnose import add_diagnose_parser
from comparisons.cli.inspect import add_inspect_parser
from comparisons.cli.live import add_live_parser
from comparisons.cli.one_sentence import (
    OneLineParser,
    PrintableStream,
    beyond_memory,
    printable,
    sentence,
    too_deep,
    too_many_digits,
)
from comparisons.cli.orders import add_orders_parser
from comparisons.cli.reduction_options import add_reduction_options
from comparisons.cli.structure import add_structure_parser
from comparisons.cli.study import add_study_parser
from comparisons.cli.total_system import add_total_system_parser

__all__ = ["build_parser", "main"]

EXIT_DONE = 0
EXIT_UNUSABLE = 2
# 128 + SIGINT, as a shell reports a process that was interrupted.
EXIT_INTERRUPTED = 130


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
    try:
        for stream in (sys.stdout, sys.stderr):
            # A terminal that cannot show Greek gets a replacement sign, not an exception.
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors="replace")
        return _run(build_parser().parse_args(argv))
    except KeyboardInterrupt:
        print("sindy-surge: interrupted; files that were finished are whole", file=sys.stderr)
        return EXIT_INTERRUPTED


def _run(arguments: argparse.Namespace) -> int:
    from surge_core.errors import InputError
    from surge_core.errors import InputError as SparseInputError

    try:
        with _printed(arguments):
            arguments.run(arguments)
        sys.stdout.flush()
    except (InputError, SparseInputError) as error:
        words = sentence(error)
    except MemoryError:
        words = beyond_memory(arguments)
    except RecursionError:
        words = too_deep(arguments)
    except BrokenPipeError:
        # `sindy-surge … | head` closes our output: that is not a failure.
        sys.stderr.close()
        return EXIT_DONE
    except ValueError as error:
        # Python refuses to read a whole number of more digits; all else is a fault of ours.
        if "int_max_str_digits" not in str(error):
            raise
        words = too_many_digits(arguments)
    except OSError as error:
        words = printable(f"{error.filename or 'output'}: {error.strerror}")
    else:
        return EXIT_DONE
    print(f"sindy-surge: {words}", file=sys.stderr)
    return EXIT_UNUSABLE


def _printed(arguments: argparse.Namespace) -> AbstractContextManager[object]:
    """Write out what names out of files would tell a terminal to do; `live` draws on it itself."""
    if getattr(arguments, "draws", False):
        return nullcontext()
    return redirect_stdout(cast("TextIO", PrintableStream(sys.stdout)))


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all sub-commands."""
    parser: argparse.ArgumentParser = OneLineParser(
        prog="sindy-surge",
        description="Post-stall characteristics and the time constant of a compressor from its "
        "surge records, by two rival estimators side by side.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_demo(commands)
    _add_simulate(commands)
    _add_reduce(commands)
    add_live_parser(commands)
    commands.choices["live"].set_defaults(draws=True)
    _add_compare(commands)
    _add_reconstruct(commands)
    add_diagnose_parser(commands)
    _add_reproduce(commands)
    _add_work(commands)
    add_inspect_parser(commands)
    add_orders_parser(commands)
    add_structure_parser(commands)
    add_study_parser(commands)
    add_total_system_parser(commands)
    return parser


class _Version(argparse.Action):
    """Print the version; the package metadata is read only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"sindy-surge {version('sindy-surge')}")
        parser.exit()


_Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def _add_demo(commands: _Commands) -> None:
    parser = commands.add_parser(
        "demo",
        help="simulate a surge test, reduce it, fit both estimators, write a report",
        description="Simulate an E3-like surge test at 98.5 % and 90 % speed, reduce the raw "
        "counts, run the estimators on both coefficients and write one HTML report.",
    )
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder (default: demo)")
    parser.add_argument("--seed", type=_seed, default=0, help="seed of the sensors (default: 0)")
    parser.set_defaults(run=_command("demo"))


def _add_simulate(commands: _Commands) -> None:
    parser = commands.add_parser(
        "simulate",
        help="run the simulated test rig and write its raw record",
        description="Run the simulated test rig: DIR/raw.csv and DIR/test.toml as a real rig "
        "would leave them, and apart from them the truth in DIR/truth.",
    )
    parser.add_argument(
        "--case",
        default="985",
        help="parameter set: 985, 90, 95, 985-second, blowdown or 75-stall (default: 985)",
    )
    parser.add_argument("--seed", type=_seed, default=0, help="seed of the sensors (default: 0)")
    parser.add_argument(
        "--duration",
        type=float,
        default=4.0,
        metavar="SECONDS",
        help="length, 0.2 to 120 (default: 4)",
    )
    parser.add_argument(
        "--hide",
        metavar="EFFECT",
        help="hide an effect in the record, such as flow_inertia, which only DIR/truth names; an "
        "unknown name lists them",
    )
    parser.add_argument(
        "--hide-size",
        type=float,
        metavar="NUMBER",
        help="its size, in the unit that DIR/truth/truth.toml states (default: one per effect)",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder")
    parser.set_defaults(run=_command("simulate"))


def _add_reduce(commands: _Commands) -> None:
    parser = commands.add_parser(
        "reduce",
        help="raw counts to φ, ψ' and ψ",
        description="Reduce a raw record: counts to pressures, the airflow equations, φ, ψ', ψ "
        "and the intervals to be fitted.",
    )
    parser.add_argument(
        "raw",
        type=Path,
        metavar="RAW",
        help="raw record (.csv, .parquet, .tdms, .mat, .nc or .h5)",
    )
    parser.add_argument("--test", type=Path, required=True, help="description of the test (.toml)")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="SERIES", help="series (.csv or .nc)"
    )
    add_reduction_options(parser)
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE.html",
        help="report of the reduction; its pictures show at most 100000 rows",
    )
    parser.set_defaults(run=_command("reduce"))


def _add_compare(commands: _Commands) -> None:
    parser = commands.add_parser(
        "compare",
        help="fit the estimators to the same series and set them side by side",
        description="Fit the paper's maximum-likelihood lag model and the sparse regression to "
        "the same rows: characteristics, time constants, reconstructions, held-out errors.",
    )
    _add_series(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write the report")
    parser.add_argument("--save", type=Path, metavar="MODEL", help="save the fitted models")
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="set a lag model with effects, saved by diagnose, beside the estimators: its numbers "
        "are fitted again, its structure stays",
    )
    parser.add_argument(
        "--degree",
        type=_degree,
        default=2,
        metavar="N",
        help="degree of the classical characteristic (default: 2)",
    )
    parser.add_argument(
        "--hold",
        choices=("first", "zero"),
        default="first",
        help="φ between its samples: joined by lines, or held as in Eq 9 (default: first)",
    )
    parser.add_argument(
        "--tau",
        type=_tau,
        metavar="TAU",
        help="hold τ of the classical estimators, as 18ms or 0.018 (seconds); else it is fitted",
    )
    parser.set_defaults(run=_command("compare"))


def _add_reconstruct(commands: _Commands) -> None:
    parser = commands.add_parser(
        "reconstruct",
        help="run a saved model over another record",
        description="Run models saved by `compare --save` or `diagnose --save` over other records, "
        "with nothing refitted, and score the reconstruction.",
    )
    parser.add_argument(
        "model", type=Path, metavar="MODEL", help="saved by compare --save or diagnose --save"
    )
    _add_series(parser)
    parser.add_argument(
        "--estimator",
        default=None,
        metavar="NAME",
        help="classic_ml, paper, classic_ml_arx, classic_ml_output_error or sindy; all without it",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the scores as JSON")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="FILE.csv",
        help="write the reconstruction (of one record by one estimator)",
    )
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write the report")
    parser.set_defaults(run=_command("reconstruct"))


def _add_reproduce(commands: _Commands) -> None:
    parser = commands.add_parser(
        "reproduce",
        help="check the paper claim by claim on four simulated instabilities",
        description="Simulate the paper's four instabilities and its steady rotating stall, reduce "
        "the raw counts and fit them the paper's way, and print each claim of the paper with the "
        "number it states, the number found and whether it holds.",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON")
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE.html",
        help="write the report, with counterparts of the paper's figures",
    )
    parser.add_argument("--seed", type=_seed, default=0, help="seed of the sensors (default: 0)")
    parser.set_defaults(run=_run_reproduce)


def _add_work(commands: _Commands) -> None:
    parser = commands.add_parser(
        "work",
        help="fit the work characteristic ψ_QS to a raw record with T31",
        description="Reduce a raw record without a low-pass, undo the lag of the thermocouples and "
        "fit the piecewise-linear work characteristic of Fig 22 to the power that the blading "
        "delivers, with rows near zero flow weighted down.",
    )
    parser.add_argument(
        "raw", type=Path, metavar="RAW", help="raw record (CSV, MAT, netCDF, HDF5, TDMS, Parquet)"
    )
    parser.add_argument(
        "--test", type=Path, required=True, metavar="TEST.toml", help="its test description"
    )
    parser.add_argument(
        "--breakpoints",
        type=float,
        nargs=2,
        metavar=("D1", "D2"),
        help="φ at which the slope changes (default: searched)",
    )
    parser.add_argument("--tau", type=_tau, metavar="TAU", help="hold τ, as 18ms")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
    parser.set_defaults(run=_run_work)


def _run_work(arguments: argparse.Namespace) -> None:
    from comparisons.cli.work import run_work

    run_work(arguments)


def _run_reproduce(arguments: argparse.Namespace) -> None:
    from comparisons.cli.reproduce import command_line, reproduce, show_progress

    print(
        reproduce(
            seed=arguments.seed,
            json_path=arguments.json,
            report=arguments.report,
            progress=show_progress,
            command=command_line(),
        )
    )


def _tau(text: str) -> float:
    from comparisons.harness.tau_trial import parse_tau
    from surge_core.errors import InputError

    try:
        return parse_tau(text)
    except InputError as error:
        # argparse prints the words of its own error alone.
        words = f"expected {error.expected}, found {error.found}; {error.remedy}"
        raise argparse.ArgumentTypeError(words.rstrip("; ")) from None


def _add_series(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "series", type=Path, nargs="+", metavar="SERIES", help="series (.csv or .nc)"
    )


class _command:
    """Import the commands only when one is run: `--help` answers at once."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, arguments: argparse.Namespace) -> None:
        from comparisons.cli import commands

        getattr(commands, f"run_{self.name}")(arguments)


def _seed(text: str) -> int:
    return _whole(text, 0, 2**32 - 1)


def _degree(text: str) -> int:
    return _whole(text, 1, 12)


def _whole(text: str, low: int, high: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"expected a whole number from {low} to {high}: '{text}'")
    return value
