"""The command `sindy-surge structure`: which terms ψ'_QS(φ) has, and how sure that is."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from comparisons.cli.output import page, read_records, write_asked
from comparisons.harness.structure_fit import find_structure
from comparisons.show.json_output import structure_document
from comparisons.show.structure_output import structure_parts
from surge_core.progress import shown_steps


def run(given: argparse.Namespace) -> Iterable[str]:
    """Choose the terms and say how sure each is."""
    with shown_steps([0.3, 1.5, 0.2]) as begin:
        begin("reading")
        records = read_records(given.series)
        begin("choosing terms")
        found = find_structure(records)
        names = ", ".join(Path(record.source).name for record in found.records)
        title = f"Structure of the characteristic of {names}"
        begin("writing")
        written = write_asked(
            given,
            json=lambda: structure_document(found),
            report=lambda: page(title, [(names, structure_parts(found))]),
        )
    return str(found), *written
