"""The command `sindy-surge structure`: which terms ψ'_QS(φ) has, and how sure that is."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.cli.shared import (
    Commands,
    add_series,
    add_targets,
    check_files,
    command_line,
    read_records,
    time_constant,
    whole,
    write_all,
)
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.progress import shown_steps

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.harness.structure_fit import FoundStructure

__all__ = ["add_parser", "run"]

OPTIMIZERS = ("SSR", "STLSQ", "FROLS", "best-subset")
WORDS = ("required", "forbidden", "positive", "negative")


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "structure",
        help="which terms the characteristic has, and how sure that is",
        description="Run the sparse regression alone and report all it finds: terms, errors, "
        "inclusion probabilities, rivals, time constant, dead time, noise, and the structures "
        "tried. A series that carries whole unfiltered runs is fitted by one free run through "
        "them, unless --rows or an option that needs rows is given (--target psi, --degree, "
        "--knots, --constraint, --dead-time, --bootstrap).",
    )
    add_series(parser)
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
    add_targets(parser, "json", "report")
    parser.add_argument(
        "--python", type=Path, metavar="FILE", help="write the equation as Python source"
    )
    parser.set_defaults(run=run)


def _add_search(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--degree",
        type=whole(1, 12),
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
        type=whole(1, 20),
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
        type=whole(0, 10000),
        metavar="N",
        help="resampled records for the inclusion probabilities (default: 100)",
    )
    add(
        "--seed",
        type=whole(0, 2**32 - 1),
        default=0,
        metavar="N",
        help="seed of the resamples (default: 0)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Choose the terms of the characteristic and report all that is known of them.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Raises
    ------
    InputError
        When an input or an option cannot be used; nothing is written then.
    """
    from comparisons.show.structure_output import structure_document, structure_text
    from comparisons.show.structure_report import structure_report

    targets = {name: getattr(arguments, name) for name in ("json", "report", "python")}
    check_files(arguments.series, **targets)
    with shown_steps(3) as begin:
        begin("reading")
        records = read_records(arguments.series)
        begin("choosing terms")
        found = _found(arguments, records)
        begin("writing")
        text = structure_text(found, latex=arguments.latex)
        written = write_all(
            [
                ("numbers", arguments.json, lambda: to_strict_json(structure_document(found))),
                (
                    "report",
                    arguments.report,
                    lambda: structure_report(found, command=command_line()),
                ),
                ("equation", arguments.python, lambda: found.equation("python")),
            ]
        )
    for line in (text, *written):
        print(line)


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
    size = text.strip().removeprefix("-")
    # No time constant may be zero; a dead time may.
    if re.fullmatch(r"0+(\.0*)?\s*(s|ms|us|µs)?", size):
        return 0.0
    try:
        seconds = time_constant(size)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"auto, fit or a time: {error}") from None
    return -seconds if text.strip().startswith("-") else seconds


def _knots(text: str) -> list[float]:
    try:
        knots = [float(part) for part in text.split(",")]
    except ValueError:
        knots = [math.nan]
    if not all(map(math.isfinite, knots)):
        raise argparse.ArgumentTypeError(f"expected values of φ, as 0.05,0.1: '{text}'")
    return knots
