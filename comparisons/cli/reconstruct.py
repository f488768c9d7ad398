"""The command `sindy-surge reconstruct`: saved models over other records."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.cli.shared import (
    Commands,
    add_series,
    add_targets,
    check_files,
    command_line,
    drawing,
    write_all,
)

if TYPE_CHECKING:
    from comparisons.results import Reconstruction

__all__ = ["add_parser", "run"]


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "reconstruct",
        help="run a saved model over another record",
        description="Run models saved by `compare --save` or `diagnose --save` over other records, "
        "with nothing refitted, and score the reconstruction.",
    )
    parser.add_argument(
        "model", type=Path, metavar="MODEL", help="saved by compare --save or diagnose --save"
    )
    add_series(parser)
    parser.add_argument(
        "--estimator",
        default=None,
        metavar="NAME",
        help="classic_ml, paper, classic_ml_arx, classic_ml_output_error or sindy; all without it",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="FILE.csv",
        help="write the reconstruction (of one record by one estimator)",
    )
    add_targets(parser, "json", "report")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run saved models over other records.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    """
    from classic_ml.io.series import read_series
    from comparisons.cli.saved_models import load_any_models
    from comparisons.harness.reconstruction import (
        reconstruct_record,
    )
    from comparisons.show.table import reconstruction_table
    from surge_core.errors import InputError
    from surge_core.files import check_target, to_strict_json
    from surge_core.progress import shown_over

    targets = {name: getattr(arguments, name) for name in ("json", "report", "out")}
    check_files([arguments.model, *arguments.series], **targets)
    if arguments.out:
        check_target(arguments.out, (".csv",))
    models = _chosen(load_any_models(arguments.model), arguments.estimator)
    records = [read_series(path) for path in arguments.series]
    runs = [
        reconstruct_record(model, record)
        for record in shown_over(records, unit="record")
        for model in models.values()
        if model.target == "psi_p" or record.psi is not None
    ]
    if not runs:
        raise InputError(
            ", ".join(record.source for record in records),
            expected="the coefficient that the model gives (psi)",
            found="none",
        )
    if arguments.out and len(runs) > 1:
        raise InputError(
            "--out",
            expected="one reconstruction",
            found=f"{len(runs)}",
            remedy="name one record and one --estimator of " + ", ".join(models),
        )
    write_all(
        [
            ("reconstruction", arguments.out, runs[0].to_csv),
            ("scores", arguments.json, lambda: to_strict_json(_document(runs))),
            ("report", arguments.report, lambda: _page(runs)),
        ]
    )
    print(reconstruction_table(runs))


def _chosen(models: dict[str, Any], name: str | None) -> dict[str, Any]:
    from surge_core.errors import InputError

    if name is None:
        return models
    if name not in models:
        raise InputError("--estimator", expected="one of " + ", ".join(models), found=name)
    return {name: models[name]}


def _document(runs: Sequence[Reconstruction]) -> dict[str, Any]:
    reconstructions = [run.to_json() for run in runs]
    return {"schema": "sindy-surge/reconstruct/1", "reconstructions": reconstructions}


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
