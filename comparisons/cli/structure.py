"""The command `sindy-surge structure`: which terms ψ'_QS(φ) has, and how sure that is."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from comparisons.cli.shared import (
    HOLD,
    JSON,
    REPORT,
    SERIES,
    Command,
    argument,
    command_line,
    read_records,
    seed,
    whole,
    write_asked,
)
from surge_core.progress import shown_steps

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.harness.structure_fit import FoundStructure

__all__ = ["COMMAND"]

WORDS = ("required", "forbidden", "positive", "negative")


def _run(given: argparse.Namespace) -> Iterable[str]:
    from comparisons.show.structure_output import structure_document, structure_text
    from comparisons.show.structure_report import structure_report

    with shown_steps(3) as begin:
        begin("reading")
        records = read_records(given.series)
        begin("choosing terms")
        found = _found(given, records)
        begin("writing")
        written = write_asked(
            given,
            json=lambda: structure_document(found),
            report=lambda: structure_report(found, command=command_line()),
        )
    return structure_text(found), *written


def _found(given: argparse.Namespace, records: Sequence[CoefficientSeries]) -> FoundStructure:
    from comparisons.harness.structure_fit import find_structure

    return find_structure(
        records,
        target=given.target,
        hold=given.hold,
        rows=given.rows,
        optimizer=given.optimizer,
        max_terms=given.max_terms,
        psi_terms=not given.no_psi_terms,
        seed=given.seed,
        constraints=_joined(given.constraint),
        n_bootstrap=given.bootstrap,
    )


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


COMMAND = Command(
    "structure",
    help="which terms the characteristic has, and how sure that is",
    description="Run the sparse regression alone and report all it finds: terms, errors, "
    "inclusion probabilities, rivals, time constant, dead time, noise, and the structures "
    "tried. A series that carries whole unfiltered runs is fitted by one free run through "
    "them, unless --rows or an option that needs rows is given (--target psi, "
    "--constraint, --bootstrap).",
    arguments=(
        SERIES,
        argument(
            "--target",
            choices=("psi_p", "psi"),
            default="psi_p",
            help="coefficient that is modelled (default: psi_p)",
        ),
        HOLD,
        argument("--rows", action="store_true", help="fit the rows of the segments always"),
        argument(
            "--optimizer",
            choices=("SSR", "STLSQ", "FROLS", "best-subset"),
            default="SSR",
            help="what proposes structures (default: SSR)",
        ),
        argument(
            "--max-terms",
            type=whole(1, 20),
            default=6,
            metavar="N",
            help="largest structure (default: 6)",
        ),
        argument(
            "--constraint",
            type=_constraint,
            action="append",
            metavar="TERM=WORD",
            help="known beforehand, as 'phi^2=negative': required, forbidden, positive or "
            "negative; may be given again",
        ),
        argument(
            "--no-psi-terms", action="store_true", help="look for no terms that hold ψ' itself"
        ),
        argument(
            "--bootstrap",
            type=whole(0, 10000),
            metavar="N",
            help="resampled records for the inclusion probabilities (default: 100)",
        ),
        seed("resamples"),
        JSON,
        REPORT,
    ),
    run=_run,
)
