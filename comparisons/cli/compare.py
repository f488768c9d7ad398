"""The command `sindy-surge compare`: the estimators on the same series, side by side."""

from __future__ import annotations

import argparse
import sys
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
    fitting,
    read_records,
    time_constant,
    whole,
    write_all,
)

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.harness.estimators import EstimatorSpec
    from comparisons.results import Comparison

__all__ = ["add_parser", "models_to_save", "print_comparison", "run"]


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "compare",
        help="fit the estimators to the same series and set them side by side",
        description="Fit the paper's maximum-likelihood lag model and the sparse regression to "
        "the same rows: characteristics, time constants, reconstructions, held-out errors.",
    )
    add_series(parser)
    add_targets(parser, "json", "report")
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
        type=whole(1, 12),
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
        type=time_constant,
        metavar="TAU",
        help="hold τ of the classical estimators, as 18ms or 0.018 (seconds); else it is fitted",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit the estimators to series files and set them side by side.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    """
    from comparisons.harness.saved_models import save_models
    from comparisons.show.json_output import comparison_document
    from comparisons.show.report import ReportSection, render_report
    from surge_core.files import to_strict_json

    targets = {name: getattr(arguments, name) for name in ("json", "report", "save")}
    check_files([*arguments.series, arguments.model], **targets)
    records = read_records(arguments.series)
    comparison, work = _compare(records, arguments)
    title = ", ".join(Path(record.source).name for record in records)

    def page() -> str:
        return render_report(
            [ReportSection(title=title, comparison=comparison, work=work)],
            title=f"Comparison on {title}",
            command=command_line(),
            progress=drawing,
        )

    written = write_all(
        [
            (
                "numbers",
                arguments.json,
                lambda: to_strict_json(comparison_document(comparison, work)),
            ),
            ("report", arguments.report, page),
        ]
    )
    if arguments.save:
        save_models(models_to_save(comparison, work), arguments.save)
        written.insert(1 if arguments.json else 0, f"models: {arguments.save}")
    print_comparison(comparison, work)
    for line in written:
        print(line)


def print_comparison(comparison: Comparison, work: Comparison | None) -> None:
    """Print the tables of both coefficients.

    Parameters
    ----------
    comparison : Comparison
        Of ψ'.
    work : Comparison or None
        Of ψ.
    """
    from comparisons.show.table import comparison_table

    names = ", ".join(Path(record.source).name for record in comparison.records)
    print(f"Pressure coefficient ψ' of {names}\n\n{comparison_table(comparison)}\n")
    if work is not None:
        print(f"Work coefficient ψ of {names}\n\n{comparison_table(work)}\n")


def models_to_save(comparison: Comparison, work: Comparison | None = None) -> dict[str, Any]:
    """Return the models that `reconstruct` may run, by name.

    Parameters
    ----------
    comparison : Comparison
        Of ψ'. A refused fit is no model; one with effects has a file of its own.
    work : Comparison or None
        Of ψ; its models are called ``NAME:psi``.
    """
    models = {
        result.name: result.model
        for result in comparison.results
        if result.state != "blowdown" and result.extended is None
    }
    if work is not None:
        models |= {f"{result.name}:psi": result.model for result in work.results}
    return models


def _compare(
    records: Sequence[CoefficientSeries], arguments: argparse.Namespace
) -> tuple[Comparison, Comparison | None]:
    from comparisons.harness.compare import compare_records
    from surge_core.errors import InputError

    given: dict[str, Any] = {
        "hold": arguments.hold,
        "time_constant_s": arguments.tau,
        "progress": fitting,
    }
    comparison = compare_records(
        records, degree=arguments.degree, estimators=_with_model(arguments), **given
    )
    if any(record.psi is None for record in records):
        return comparison, None
    try:
        return comparison, compare_records(records, target="psi", **given)
    except InputError as error:
        print(f"ψ was not fitted: {error}", file=sys.stderr)
        return comparison, None


def _with_model(arguments: argparse.Namespace) -> tuple[EstimatorSpec, ...] | None:
    """Return the default estimators and those of --model; None without the option."""
    if arguments.model is None:
        return None
    from comparisons.harness.estimators import default_estimators
    from comparisons.missing_effect.extended_estimator import extended_specs
    from comparisons.missing_effect.extended_file import load_extended
    from surge_core.errors import InputError

    if arguments.hold != "first":
        raise InputError(
            "--model",
            expected="--hold first: a model with effects joins the samples of φ",
            found=f"--hold {arguments.hold}",
        )
    own = default_estimators(degree=arguments.degree, hold="first", time_constant_s=arguments.tau)
    return (*own, *extended_specs(load_extended(arguments.model), [spec.name for spec in own]))
