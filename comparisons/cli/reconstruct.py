"""The command `sindy-surge reconstruct`: saved models over other records."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from classic_ml.io.series import read_series
from comparisons.cli.output import page, write_asked
from comparisons.cli.saved_models import load_any_models
from comparisons.harness.reconstruction import validate_models
from comparisons.harness.saved_models import about_models
from comparisons.results import Reconstruction
from comparisons.show.report import ReportSection, report_pages
from comparisons.show.table import reconstruction_table
from surge_core.errors import InputError
from surge_core.progress import shown_over


def run(given: argparse.Namespace) -> Iterable[str]:
    """Run saved models over records, and score them."""
    models, only = load_any_models(given.model), given.estimator
    if only not in (None, *models):
        raise InputError("--estimator", expected="one of " + ", ".join(models), found=only)
    recommended, fitted = about_models(given.model)
    names = sorted(models, key=lambda name: name != recommended)
    models = {name: models[name] for name in names if only in (None, name)}
    records = [read_series(path) for path in given.series]
    runs = validate_models(models.values(), shown_over(records, unit="record"), fitted)
    if not runs:
        raise InputError(
            ", ".join(record.source for record in records),
            expected="the coefficient that the model gives (psi)",
            found="none",
        )
    if given.out and len(runs) > 1:
        remedy = "name one record and one --estimator of " + ", ".join(models)
        raise InputError(
            "--out", expected="one reconstruction", found=str(len(runs)), remedy=remedy
        )
    written = write_asked(
        given,
        out=runs[0].to_csv,
        json=lambda: {
            "schema": "sindy-surge/reconstruct/1",
            "recommended": recommended,
            "reconstructions": [run.to_json() for run in runs],
        },
        report=lambda: _page(runs),
    )
    words = f"recommended by compare for ψ': {recommended}, whose τ and curve are to be quoted."
    shown = recommended in models and any(run.model.target == "psi_p" for run in runs)
    return reconstruction_table(runs), *([words] if shown else []), *written


def _page(runs: Sequence[Reconstruction]) -> str:
    by_record: dict[str, list[Reconstruction]] = {}
    for each in runs:
        by_record.setdefault(each.record.source, []).append(each)
    sections = [
        ReportSection(title=Path(source).name, validation=tuple(group))
        for source, group in by_record.items()
    ]
    return page("Reconstruction", report_pages(sections))
