"""The command `sindy-surge structure`: which terms ψ'_QS(φ) has, and how sure that is."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from comparisons.cli.command import Command, command_line, read_records, write_asked
from comparisons.cli.options import JSON, REPORT, SERIES, argument, whole
from surge_core.progress import shown_steps


def _run(given: argparse.Namespace) -> Iterable[str]:
    from comparisons.harness.structure_fit import find_structure
    from comparisons.page.html import render_page
    from comparisons.show.json_output import structure_document
    from comparisons.show.structure_output import structure_parts, structure_text

    with shown_steps([0.3, 1.5, 0.2]) as begin:
        begin("reading")
        records = read_records(given.series)
        begin("choosing terms")
        found = find_structure(records, rows=given.rows, n_bootstrap=given.bootstrap)
        names = ", ".join(Path(record.source).name for record in found.records)
        begin("writing")
        written = write_asked(
            given,
            json=lambda: structure_document(found),
            report=lambda: render_page(
                [(names, structure_parts(found))],
                title=f"Structure of the characteristic of {names}",
                command=command_line(),
            ),
        )
    return structure_text(found), *written


COMMAND = Command(
    "structure",
    help="which terms the characteristic has, and how sure that is",
    description="Run the sparse regression alone and report all it finds: terms, errors, "
    "inclusion probabilities, rivals, time constant, dead time, noise, and the structures "
    "tried. A series that carries whole unfiltered runs is fitted by one free run through "
    "them, unless --rows or --bootstrap is given. SparseLagRegressor takes a library, "
    "constraints and optimizers in Python.",
    arguments=(
        SERIES,
        argument("--rows", action="store_true", help="fit the rows of the segments always"),
        argument(
            "--bootstrap",
            type=whole(0, 10000),
            metavar="N",
            help="resampled records for the inclusion probabilities (default: 100)",
        ),
        JSON,
        REPORT,
    ),
    run=_run,
)
