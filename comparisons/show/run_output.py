"""A whole analysis as JSON and as one page; each step under its own schema."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from comparisons.analysis import Analysis
from comparisons.missing_effect.document import diagnosis_document
from comparisons.missing_effect.report import diagnosis_parts
from comparisons.page.blocks import Part, Words
from comparisons.show.inspection import inspect_document, inspect_text
from comparisons.show.json_output import (
    comparison_document,
    record_document,
    structure_document,
)
from comparisons.show.report import ReportSection
from comparisons.show.structure_output import structure_parts
from comparisons.show.work_output import work_document, work_table

RUN_SCHEMA = "sindy-surge/run/1"


def run_document(found: Analysis) -> dict[str, Any]:
    """Return an analysis as plain JSON types.

    A step that refused has ``{"refused": sentence}`` for its document.
    """
    series, record = found.reduction.series, found.reduction.record
    made = {
        "inspect": inspect_document(found.inspection),
        "reduce": {**record_document(series), "history": [asdict(e) for e in record.history]},
        "compare": comparison_document(found.comparison),
        "structure": found.structure and structure_document(found.structure),
        "diagnose": found.diagnosis and diagnosis_document(found.diagnosis),
        "work": found.work and work_document(found.work, record.source),
    }
    steps = {
        name: {"refused": found.refusals[name]} if document is None else document
        for name, document in made.items()
    }
    return {"schema": RUN_SCHEMA, "answer": found.answer.to_json(), **steps}


def run_section(found: Analysis) -> ReportSection:
    """Return an analysis as a section of a report."""
    parts: list[Part] = []
    if found.diagnosis is not None:
        parts += diagnosis_parts(found.diagnosis)
    evidence = [Part.together("Evidence: what is missing", parts)]
    if found.structure is not None:
        terms = structure_parts(found.structure)
        evidence.append(Part.together("Evidence: terms of ψ'_QS", terms))
    if found.work is not None:
        words = Words(work_table(found.work), "code")
        evidence.append(Part("Evidence: ψ_QS from the power", (words,)))
    return ReportSection(
        found.answer.test,
        found.comparison,
        reduction=found.reduction,
        extra=tuple(part for part in evidence if part.blocks),
        quality=(Words(inspect_text(found.inspection, None), "code"),),
        answer=found.answer,
    )
