"""``sindy-surge study``: a method-comparison study from a TOML file."""

from __future__ import annotations

import argparse
import signal
from pathlib import Path
from typing import Any

__all__ = ["add_study_parser"]

# Reasons of failed cells that are printed; the report has all.
MOST_REASONS = 5


def add_study_parser(commands: Any) -> None:
    """Add the sub-command to a parser's commands.

    Parameters
    ----------
    commands : argparse sub-parsers
        Where it goes.
    """
    parser = commands.add_parser(
        "study",
        help="compare methods over a declared design: thousands of fits into one table",
        description="Run every cell of a study: DIR/results.parquet with one row a fit, "
        "DIR/report.html, the resolved specification and versions. Finished cells are kept in "
        "DIR/journal.jsonl as they come; --resume runs the rest.",
    )
    parser.add_argument("spec", type=Path, metavar="SPEC.toml", help="what is compared over what")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder")
    parser.add_argument(
        "--resume", action="store_true", help="go on with the study in DIR; finished cells stay"
    )
    parser.add_argument(
        "--retry-failed", action="store_true", help="with --resume: run cells that failed once more"
    )
    parser.add_argument(
        "--jobs",
        type=_jobs,
        default=0,
        metavar="N",
        help="worker processes on this machine (default: one a core; 1: none)",
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work instead"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="say how many cells there are, and stop"
    )
    parser.set_defaults(run=run_study_command)


def _jobs(text: str) -> int:
    try:
        jobs = int(text)
    except ValueError:
        jobs = 0
    if jobs < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 on, found {text!r}")
    return jobs


def run_study_command(arguments: argparse.Namespace) -> None:
    """Run the study that the arguments name."""
    from comparisons.study.design import count_cells, count_points
    from comparisons.study.run import check_study
    from comparisons.study.spec import read_spec

    spec = read_spec(arguments.spec)
    if not arguments.dry_run:
        check_study(spec, arguments.out, resume=arguments.resume)
    cells = count_cells(spec)
    axes = ", ".join(spec.axes) or "none"
    methods = ", ".join(method.name for method in spec.methods)
    print(f"{spec.title}: {cells} cells ({count_points(spec)} points, methods {methods})")
    print(f"axes: {axes}")
    if arguments.dry_run:
        return
    table, files = _run(spec, cells, arguments)
    _conclude(spec, table, files)


def _run(spec: Any, cells: int, arguments: argparse.Namespace) -> tuple[Any, Any]:
    from joblib import cpu_count

    from comparisons.study.engines import engine_for
    from comparisons.study.run import StudyFiles, run_study
    from surge_core.progress import shown_count

    jobs = arguments.jobs or cpu_count()
    engine = engine_for(jobs, arguments.scheduler)
    # A scheduler of jobs ends a process by SIGTERM: as Ctrl-C, workers end with it.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with shown_count(unit="cell", total=cells) as told:
            table = run_study(
                spec,
                arguments.out,
                engine=engine,
                resume=arguments.resume,
                retry_failed=arguments.retry_failed,
                # Of a cluster's workers the provenance says nothing that was not seen.
                workers=None if arguments.scheduler else jobs,
                told=told,
            )
    finally:
        signal.signal(signal.SIGTERM, before)
    return table, StudyFiles(arguments.out)


def _conclude(spec: Any, table: Any, files: Any) -> None:
    """Print the comparison and write the page."""
    from comparisons.cli.shared import command_line
    from comparisons.study.comparison import methods_in
    from comparisons.study.report import write_study_report
    from comparisons.study.run import resolved
    from comparisons.study.words import study_text

    failed = int((table["state"] == "failed").sum())
    if failed:
        print(f"{failed} of {len(table)} cells failed; the table has the reason of each:")
        reasons = table.loc[table["state"] == "failed", "reason"].value_counts()
        for reason, count in list(reasons.items())[:MOST_REASONS]:
            print(f"  {count} x {reason}")
    reference = spec.reference if spec.reference in methods_in(table) else None
    print()
    print(study_text(table, spec.scores, reference=reference, by=spec.by))
    write_study_report(
        files.report,
        table,
        spec_words=resolved(spec),
        scores=spec.scores,
        reference=reference,
        by=spec.by,
        title=spec.title,
        command=command_line(),
    )
    print(f"table:  {files.results}")
    print(f"report: {files.report}")
