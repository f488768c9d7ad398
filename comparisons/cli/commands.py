"""What each sub-command does, once its arguments are parsed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from classic_ml.readers.series_files import ledger_path, read_series, write_series
from classic_ml.series import CoefficientSeries
from comparisons.cli.progress import shown_over, shown_steps
from surge_core.errors import InputError
from surge_core.files import check_apart, check_target, write_whole

if TYPE_CHECKING:
    from classic_ml.reduction import Reduction
    from comparisons.harness.estimators import EstimatorSpec
    from comparisons.results import Comparison, FittedLag, Reconstruction

__all__ = [
    "command_line",
    "print_reduction",
    "run_compare",
    "run_demo",
    "run_reconstruct",
    "run_reduce",
    "run_simulate",
]

_T = TypeVar("_T")
HTML = (".html", ".htm")


def run_simulate(arguments: argparse.Namespace) -> None:
    """Run the simulated rig and write its record and its truth."""
    from comparisons.rig import simulate, write_run

    if arguments.hide is None and arguments.hide_size is not None:
        raise InputError(
            "--hide-size",
            expected="a size only with --hide EFFECT",
            found=f"{arguments.hide_size:g} alone",
            remedy="name the effect",
        )
    with shown_steps(2) as begin:
        begin("running the rig")
        run = simulate(
            arguments.case,
            seed=arguments.seed,
            duration_s=arguments.duration,
            hide=arguments.hide,
            hide_size=arguments.hide_size,
        )
        begin("writing")
        write_run(run, arguments.out)
    print(f"raw record: {arguments.out / 'raw.csv'} with {arguments.out / 'test.toml'}")
    print(f"truth:      {arguments.out / 'truth'}")


def run_reduce(arguments: argparse.Namespace) -> None:
    """Reduce a raw record to a series file."""
    from comparisons.cli.reduce import excerpt, reduce_file
    from comparisons.cli.reduction_options import options_named, reduction_settings

    _check_targets(
        [arguments.raw, arguments.test],
        (arguments.out, (".csv", ".nc", ".nc4", ".netcdf")),
        (arguments.report, HTML),
    )
    with options_named():
        reduction = reduce_file(
            arguments.raw,
            arguments.test,
            reduction_settings(arguments),
        )
    write_series(reduction.series, arguments.out)
    if arguments.report:
        from comparisons.show.report import ReportSection, write_report

        drawn, part = excerpt(reduction)
        name = reduction.test.name
        section = ReportSection(title=f"{name}, {part}" if part else name, reduction=drawn)
        write_report(
            arguments.report,
            [section],
            title=f"Reduction of {name}",
            command=command_line(),
            progress=_drawing,
        )
    print_reduction(reduction)
    print(f"series: {arguments.out}")
    if arguments.report:
        print(f"report: {arguments.report}")


def run_compare(arguments: argparse.Namespace) -> None:
    """Fit the estimators to series files and set them side by side."""
    from comparisons.harness.rows import check_once
    from comparisons.harness.saved_models import save_models

    inputs = [*arguments.series, *([arguments.model] if arguments.model else [])]
    _check_targets(inputs, (arguments.json, ()), (arguments.report, HTML), (arguments.save, ()))
    records = [read_series(path) for path in arguments.series]
    check_once(records)
    comparison, work = _compare(records, arguments)
    if arguments.json:
        from comparisons.show.json_output import comparison_document, to_strict_json

        write_whole(arguments.json, to_strict_json(comparison_document(comparison, work)))
    if arguments.save:
        save_models(_models(comparison, work), arguments.save)
    if arguments.report:
        from comparisons.show.report import ReportSection, write_report

        title = ", ".join(Path(record.source).name for record in records)
        section = ReportSection(title=title, comparison=comparison, work=work)
        write_report(
            arguments.report,
            [section],
            title=f"Comparison on {title}",
            command=command_line(),
            progress=_drawing,
        )
    _print_comparison(comparison, work)
    for label, path in (
        ("numbers", arguments.json),
        ("models", arguments.save),
        ("report", arguments.report),
    ):
        if path:
            print(f"{label}: {path}")


def run_reconstruct(arguments: argparse.Namespace) -> None:
    """Run saved models over other records."""
    from comparisons.cli.saved_models import load_any_models
    from comparisons.harness.reconstruction import (
        reconstruct_record,
        reconstruction_csv,
        reconstruction_document,
    )
    from comparisons.show.table import reconstruction_table

    _check_targets(
        [arguments.model, *arguments.series],
        (arguments.json, ()),
        (arguments.report, HTML),
        (arguments.out, (".csv",)),
    )
    models = load_any_models(arguments.model)
    if arguments.estimator is not None:
        if arguments.estimator not in models:
            raise InputError(
                "--estimator",
                expected="one of " + ", ".join(models),
                found=arguments.estimator,
            )
        models = {arguments.estimator: models[arguments.estimator]}
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
    if arguments.out:
        if len(runs) > 1:
            raise InputError(
                "--out",
                expected="one reconstruction",
                found=f"{len(runs)}",
                remedy="name one record and one --estimator of " + ", ".join(models),
            )
        write_whole(arguments.out, reconstruction_csv(runs[0]))
    if arguments.json:
        from comparisons.show.json_output import to_strict_json

        write_whole(arguments.json, to_strict_json(reconstruction_document(runs)))
    if arguments.report:
        _report_reconstructions(arguments.report, runs)
    print(reconstruction_table(runs))


def run_demo(arguments: argparse.Namespace) -> None:
    """Run the whole way on simulated tests and write the report."""
    from comparisons.cli.demo import run

    done = run(arguments.out, arguments.seed, progress=_progress, command=command_line())
    for comparison, work in done.comparisons:
        _print_comparison(comparison, work)
    print(done.summary)
    print(f"report: {done.report}")


def _compare(
    records: Sequence[CoefficientSeries], arguments: argparse.Namespace
) -> tuple[Comparison, Comparison | None]:
    from comparisons.harness.compare import compare_records

    hold, tau_s = arguments.hold, arguments.tau
    comparison = compare_records(
        records,
        degree=arguments.degree,
        hold=hold,
        time_constant_s=tau_s,
        estimators=_with_model(arguments),
        progress=_progress,
    )
    if any(record.psi is None for record in records):
        return comparison, None
    try:
        work = compare_records(
            records,
            target="psi",
            hold=hold,
            time_constant_s=tau_s,
            progress=_progress,
        )
    except InputError as error:
        print(f"ψ was not fitted: {error}", file=sys.stderr)
        return comparison, None
    return comparison, work


def _with_model(arguments: argparse.Namespace) -> tuple[EstimatorSpec, ...] | None:
    """Return the default estimators and those of --model; None without the option."""
    if arguments.model is None:
        return None
    if arguments.hold != "first":
        raise InputError(
            "--model",
            expected="--hold first: a model with effects joins the samples of φ",
            found=f"--hold {arguments.hold}",
        )
    from comparisons.harness.estimators import default_estimators
    from comparisons.missing_effect.extended_estimator import extended_specs
    from comparisons.missing_effect.extended_file import load_extended

    own = default_estimators(degree=arguments.degree, hold="first", time_constant_s=arguments.tau)
    return (*own, *extended_specs(load_extended(arguments.model), [spec.name for spec in own]))


def _models(comparison: Comparison, work: Comparison | None) -> dict[str, FittedLag]:
    # A refused fit is no model: nothing may be reconstructed with it later. One with effects is
    # more than its characteristic and τ, and has a file of its own.
    models = {
        result.name: result.model
        for result in comparison.results
        if result.state != "blowdown" and result.extended is None
    }
    if work is not None:
        models.update({f"{result.name}:psi": result.model for result in work.results})
    return models


def _check_targets(inputs: Sequence[Path], *targets: tuple[Path | None, tuple[str, ...]]) -> None:
    """Refuse, before any work is done, a target that cannot or must not be written."""
    wanted = [(path, suffixes) for path, suffixes in targets if path is not None]
    for path, suffixes in wanted:
        check_target(path, suffixes)
    check_apart(
        [*inputs, *(ledger_path(path) for path in inputs if path.name)],
        [*(path for path, _ in wanted)],
    )


def print_reduction(reduction: Reduction) -> None:
    """Print the ledger of a reduction."""
    for entry in reduction.record.history:
        print(f"{entry.step}: {entry.did}")
        for dropped in entry.dropped:
            print(f"  left out {dropped.what} ({dropped.count}): {dropped.why}")
        for flag in entry.flags:
            print(f"  note: {flag}")


def _print_comparison(comparison: Comparison, work: Comparison | None) -> None:
    from comparisons.show.table import comparison_table

    names = ", ".join(Path(record.source).name for record in comparison.records)
    print(f"Pressure coefficient ψ' of {names}\n\n{comparison_table(comparison)}\n")
    if work is not None:
        print(f"Work coefficient ψ of {names}\n\n{comparison_table(work)}\n")


def _report_reconstructions(path: Path, runs: Sequence[Reconstruction]) -> None:
    from comparisons.show.report import ReportSection, write_report

    by_record: dict[str, list[Reconstruction]] = {}
    for run in runs:
        by_record.setdefault(run.record.source, []).append(run)
    sections = [
        ReportSection(title=Path(source).name, validation=tuple(group))
        for source, group in by_record.items()
    ]
    write_report(path, sections, title="Reconstruction", command=command_line(), progress=_drawing)


def _progress(items: Iterable[_T]) -> Iterable[_T]:
    """Show how far a long work is, on a terminal only."""
    return shown_over(items, unit="fit")


def _drawing(items: Iterable[_T]) -> Iterable[_T]:
    """Show how far the drawing of a report is."""
    return shown_over(items, unit="part", words="drawing")


def command_line() -> str:
    """Return the command as it was typed, for reports."""
    return " ".join(["sindy-surge", *sys.argv[1:]])
