"""``sindy-surge study``: a method-comparison study from a TOML file."""

from __future__ import annotations

import argparse
from pathlib import Path

from comparisons.cli.shared import Commands, command_line, whole
from surge_core.errors import InputError

__all__ = ["add_parser"]


def add_parser(commands: Commands) -> None:
    """Add the sub-command to a parser's commands.

    Parameters
    ----------
    commands : argparse sub-parsers
        Where it goes.
    """
    parser = commands.add_parser(
        "study",
        help="compare methods over a declared design: thousands of fits into one table",
        description="Run every cell of a study: DIR/results.parquet with one row a fit and "
        "DIR/report.html. Finished cells are kept in DIR/cells.jsonl as they come; --resume runs "
        "the rest, and those that failed.",
    )
    parser.add_argument("spec", type=Path, metavar="SPEC.toml", help="what is compared over what")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder")
    parser.add_argument(
        "--resume", action="store_true", help="go on with the study in DIR; finished cells stay"
    )
    parser.add_argument(
        "--jobs",
        type=whole(1, 1024),
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


def run_study_command(arguments: argparse.Namespace) -> None:
    """Run the study that the arguments name."""
    from joblib import cpu_count

    from comparisons.study.comparison import study_text
    from comparisons.study.design import cells_of
    from comparisons.study.report import write_study_report
    from comparisons.study.run import RESULTS, check_study, run_study
    from comparisons.study.spec import read_spec
    from surge_core.progress import shown_count

    spec = read_spec(arguments.spec)
    if not arguments.dry_run:
        check_study(spec, arguments.out, resume=arguments.resume)
    cells = len(cells_of(spec))
    methods = ", ".join(method.name for method in spec.method)
    points = cells // len(spec.method)
    print(f"{spec.title}: {cells} cells ({points} points, methods {methods})")
    print(f"axes: {', '.join(spec.axes) or 'none'}")
    if arguments.dry_run:
        return
    with shown_count(unit="cell", total=cells) as progress:
        table = run_study(
            spec,
            arguments.out,
            jobs=arguments.jobs or cpu_count(),
            scheduler=arguments.scheduler,
            resume=arguments.resume,
            progress=progress,
        )
    reasons = table[table["state"] == "failed"]["reason"].value_counts()
    if reasons.sum() == len(table):
        raise InputError(
            str(arguments.spec),
            expected="cells that can be fitted",
            found=f"{len(table)} that failed, {reasons.iloc[0]} of them with: {reasons.index[0]}",
            remedy=f"{arguments.out / RESULTS} has the reason of each",
        )
    if len(reasons):
        print(f"{reasons.sum()} of {len(table)} cells failed; table and report have the reasons")
    print()
    print(study_text(table, spec.scores, reference=spec.reference, by=spec.by))
    page = arguments.out / "report.html"
    write_study_report(page, table, spec, command=command_line())
    print(f"table:  {arguments.out / RESULTS}")
    print(f"report: {page}")
