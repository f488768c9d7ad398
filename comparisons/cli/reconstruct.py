"""The command `sindy-surge reconstruct`: saved models over other records."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.cli.command import Command, command_line, drawing, write_asked
from comparisons.cli.options import JSON, REPORT, SERIES, argument, reads, writes
from surge_core.errors import InputError
from surge_core.progress import shown_over

if TYPE_CHECKING:
    from comparisons.results import Reconstruction


def _run(given: argparse.Namespace) -> Iterable[str]:
    from classic_ml.io.series import read_series
    from comparisons.cli.saved_models import load_any_models
    from comparisons.harness.reconstruction import validate_models
    from comparisons.harness.saved_models import about_models
    from comparisons.show.table import reconstruction_table

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
        json=lambda: _document(runs, recommended),
        report=lambda: _page(runs),
    )
    words = f"recommended by compare for ψ': {recommended}, whose τ and curve are to be quoted."
    shown = recommended in models and any(run.model.target == "psi_p" for run in runs)
    return reconstruction_table(runs), *([words] if shown else []), *written


def _document(runs: Sequence[Reconstruction], recommended: str | None) -> dict[str, Any]:
    return {
        "schema": "sindy-surge/reconstruct/1",
        "recommended": recommended,
        "reconstructions": [run.to_json() for run in runs],
    }


def _page(runs: Sequence[Reconstruction]) -> str:
    from comparisons.show.report import ReportSection, render_report

    by_record: dict[str, list[Reconstruction]] = {}
    for each in runs:
        by_record.setdefault(each.record.source, []).append(each)
    sections = [
        ReportSection(title=Path(source).name, validation=tuple(group))
        for source, group in by_record.items()
    ]
    return render_report(sections, title="Reconstruction", command=command_line(), progress=drawing)


COMMAND = Command(
    "reconstruct",
    help="run a saved model over another record",
    description="Run models saved by `compare --save` or `diagnose --save` over other records, "
    "with nothing refitted: the error on rows of the kind that each was fitted to, the share of "
    "them inside its 95 % band, and which lie beyond the φ of the fit.",
    arguments=(
        reads("model", metavar="MODEL", help="saved by compare --save or diagnose --save"),
        SERIES,
        argument(
            "--estimator",
            metavar="NAME",
            help="classic_ml, paper, classic_ml_arx, classic_ml_output_error or sindy; all "
            "without it",
        ),
        writes(
            "-o",
            "--out",
            metavar="FILE.csv",
            suffixes=(".csv",),
            help="write the reconstruction (of one record by one estimator)",
        ),
        JSON,
        REPORT,
    ),
    run=_run,
)
