"""The command `sindy-surge structure`: which terms ψ'_QS(φ) has, and how sure that is."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.harness.structure_fit import FoundStructure

__all__ = ["add_structure_parser", "run_structure"]

OPTIMIZERS = ("SSR", "STLSQ", "FROLS", "ensemble", "best-subset")
WORDS = ("required", "forbidden", "positive", "negative")

_Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_structure_parser(commands: _Commands) -> None:
    """Add the sub-command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "structure",
        help="which terms the characteristic has, and how sure that is",
        description="Run the sparse regression alone and tell all it knows: terms with errors and "
        "inclusion probabilities, rivals, time constant, dead time, noise, and the structures "
        "tried. A series that carries whole unfiltered runs is fitted by one free run through "
        "them, unless --rows or an option that needs rows is given (--target psi, --degree, "
        "--knots, --constraint, --dead-time, --bootstrap).",
    )
    parser.add_argument("series", type=Path, nargs="+", metavar="SERIES", help="series files")
    parser.add_argument(
        "--target",
        choices=("psi_p", "psi"),
        default="psi_p",
        help="coefficient that is modelled (default: psi_p)",
    )
    parser.add_argument(
        "--hold",
        choices=("first", "zero"),
        default="first",
        help="φ between its samples: joined by lines, or held as in Eq 9 (default: first)",
    )
    parser.add_argument("--rows", action="store_true", help="fit the rows of the segments always")
    _add_search(parser)
    parser.add_argument("--latex", action="store_true", help="print the equation as LaTeX too")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write the report")
    parser.add_argument(
        "--python", type=Path, metavar="FILE", help="write the equation as Python source"
    )
    parser.set_defaults(run=run_structure)


def _add_search(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--degree",
        type=_whole(1, 12),
        metavar="N",
        help="highest power in the library (default: 5)",
    )
    add("--knots", type=_knots, metavar="0.05,0.1", help="knots of the hinges (default: found)")
    add(
        "--optimizer",
        choices=OPTIMIZERS,
        default="SSR",
        help="what proposes structures (default: SSR)",
    )
    add(
        "--max-terms",
        type=_whole(1, 20),
        default=6,
        metavar="N",
        help="largest structure (default: 6)",
    )
    add(
        "--constraint",
        type=_constraint,
        action="append",
        metavar="TERM=WORD",
        help="known beforehand, as 'phi^2=negative': required, forbidden, positive or negative; "
        "may be given again",
    )
    add(
        "--dead-time",
        type=_dead_time,
        metavar="auto|fit|TIME",
        help="how much later than φ ψ' was measured, as 5ms; --dead-time=-5ms where φ is late "
        "(default: auto, tested for)",
    )
    add("--no-psi-terms", action="store_true", help="look for no terms that hold ψ' itself")
    add(
        "--bootstrap",
        type=_whole(0, 10000),
        metavar="N",
        help="resampled records for the inclusion probabilities (default: 100)",
    )
    add(
        "--seed",
        type=_whole(0, 2**32 - 1),
        default=0,
        metavar="N",
        help="seed of the resamples (default: 0)",
    )


def run_structure(arguments: argparse.Namespace) -> None:
    """Run the command.

    Parameters
    ----------
    arguments : argparse.Namespace
        What the parser of :func:`add_structure_parser` gave.

    Raises
    ------
    InputError
        When an input or an option cannot be used; nothing is written then.
    """
    from classic_ml.readers.series_files import read_series
    from comparisons.cli.progress import shown_steps
    from comparisons.harness.rows import check_once
    from comparisons.show.structure_output import structure_text
    from surge_core.files import write_whole

    _check_targets(arguments)
    with shown_steps(3) as begin:
        begin("reading")
        records = [read_series(path) for path in arguments.series]
        check_once(records)
        begin("choosing terms")
        found = _found(arguments, records)
        begin("writing")
        # All is made before anything is written.
        text = structure_text(found, latex=arguments.latex)
        contents = _contents(arguments, found)
        for _, path, content in contents:
            write_whole(path, content)
    lines = [text, *(f"{label}: {path}" for label, path, _ in contents)]
    sys.stdout.write("\n".join(lines) + "\n")


def _found(arguments: argparse.Namespace, records: Sequence[CoefficientSeries]) -> FoundStructure:
    from comparisons.harness.structure_fit import find_structure

    found = find_structure(
        records,
        target=arguments.target,
        hold=arguments.hold,
        rows=arguments.rows,
        optimizer=arguments.optimizer,
        max_terms=arguments.max_terms,
        psi_terms=not arguments.no_psi_terms,
        seed=arguments.seed,
        degree=arguments.degree,
        knots=arguments.knots,
        constraints=_joined(arguments.constraint),
        dead_time_s=arguments.dead_time,
        n_bootstrap=arguments.bootstrap,
    )
    if found.refused and arguments.python:
        raise InputError(
            "--python",
            expected="a fit with an equation",
            found=f"the state {found.state[0]}",
            remedy="nothing was written; --rows fits the rows of the segments",
        )
    return found


def _contents(arguments: argparse.Namespace, found: FoundStructure) -> list[tuple[str, Path, str]]:
    from comparisons.show.json_output import to_strict_json
    from comparisons.show.structure_output import structure_document
    from comparisons.show.structure_report import structure_report

    command = " ".join(["sindy-surge", *sys.argv[1:]])
    contents = []
    if arguments.json:
        contents.append(("numbers", arguments.json, to_strict_json(structure_document(found))))
    if arguments.report:
        contents.append(("report", arguments.report, structure_report(found, command=command)))
    if arguments.python:
        contents.append(("equation", arguments.python, found.equation("python")))
    return contents


def _check_targets(arguments: argparse.Namespace) -> None:
    """Refuse, before any work is done, a target that cannot or must not be written."""
    from classic_ml.readers.series_files import ledger_path
    from surge_core.files import check_apart, check_target

    outputs = [path for path in (arguments.json, arguments.report, arguments.python) if path]
    for path in outputs:
        check_target(path, (".html", ".htm") if path is arguments.report else ())
    check_apart([*arguments.series, *map(ledger_path, arguments.series)], outputs)


def _joined(constraints: Sequence[tuple[str, str]] | None) -> dict[str, str] | None:
    """Join what was said of one term in several options."""
    if constraints is None:
        return None
    joined: dict[str, str] = {}
    for name, words in constraints:
        joined[name] = f"{joined[name]} {words}" if name in joined else words
    return joined


def _constraint(text: str) -> tuple[str, str]:
    name, equals, words = text.rpartition("=")
    known = words.split()
    if not equals or not name.strip() or not known or not set(known) <= set(WORDS):
        raise argparse.ArgumentTypeError(
            f"expected a term and one of {', '.join(WORDS)}, as 'phi^2=negative': '{text}'"
        )
    return name.strip(), " ".join(known)


def _dead_time(text: str) -> float | str:
    if text in ("auto", "fit"):
        return text
    from comparisons.harness.tau_trial import parse_tau

    size = text.strip().removeprefix("-")
    # No time constant may be zero; a dead time may.
    if re.fullmatch(r"0+(\.0*)?\s*(s|ms|us|µs)?", size):
        return 0.0
    try:
        seconds = parse_tau(size)
    except InputError as error:
        words = f"expected auto, fit or a time such as 5ms or 0.005 (seconds), found {error.found}"
        raise argparse.ArgumentTypeError("; ".join(filter(None, (words, error.remedy)))) from None
    return -seconds if text.strip().startswith("-") else seconds


def _knots(text: str) -> list[float]:
    try:
        knots = [float(part) for part in text.split(",")]
    except ValueError:
        knots = [math.nan]
    if not all(map(math.isfinite, knots)):
        raise argparse.ArgumentTypeError(f"expected values of φ, as 0.05,0.1: '{text}'")
    return knots


def _whole(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"expected a whole number from {low} to {high}: '{text}'"
            )
        return value

    return read
