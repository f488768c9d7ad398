"""The command `sindy-surge study`: a method-comparison study from a TOML file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.cli.command import Command, command_line
from comparisons.cli.options import argument, whole
from surge_core.errors import InputError
from surge_core.progress import shown_count

if TYPE_CHECKING:
    import pandas as pd

    from comparisons.study.spec import StudySpec


def _run(given: argparse.Namespace) -> Iterator[str]:
    from comparisons.study.comparison import compare_scores
    from comparisons.study.design import cells_of
    from comparisons.study.report import render_study_report
    from comparisons.study.run import RESULTS, check_study
    from comparisons.study.spec import read_spec
    from surge_core.files import write_whole

    spec = read_spec(given.spec)
    if not given.dry_run:
        check_study(spec, given.out, resume=given.resume)
    cells = len(cells_of(spec))
    methods = ", ".join(method.name for method in spec.method)
    points = cells // len(spec.method)
    yield f"{spec.title}: {cells} cells ({points} points, methods {methods})"
    yield f"axes: {', '.join(spec.axes) or 'none'}"
    if given.dry_run:
        return
    table = run_cells(given, spec)
    reasons = table[table["state"] == "failed"]["reason"].value_counts()
    if reasons.sum() == len(table):
        raise InputError(
            str(given.spec),
            expected="cells that can be fitted",
            found=f"{len(table)} that failed, {reasons.iloc[0]} of them with: {reasons.index[0]}",
            remedy=f"{given.out / RESULTS} has the reason of each",
        )
    if len(reasons):
        yield f"{reasons.sum()} of {len(table)} cells failed; table and report have the reasons"
    yield ""
    for groups in compare_scores(table, spec.scores, spec.reference, spec.by, spec.margin):
        yield from (f"{group}\n" for group in groups)
    page = given.out / "report.html"
    write_whole(page, render_study_report(table, spec, command=command_line()))
    yield f"table:  {given.out / RESULTS}"
    yield f"report: {page}"


def run_cells(given: argparse.Namespace, spec: StudySpec) -> pd.DataFrame:
    """Run the cells of a study with the options of ``OF_CELLS``; return all fits as a table."""
    from joblib import cpu_count

    from comparisons.study.design import cells_of
    from comparisons.study.run import run_study

    jobs = given.jobs or cpu_count()
    options = {"jobs": jobs, "scheduler": given.scheduler, "resume": given.resume}
    with shown_count(unit="fit", total=len(cells_of(spec))) as progress:
        return run_study(spec, given.out, **options, progress=progress)


# How the cells of a study are run, `bench` among them.
OF_CELLS = (
    argument("--resume", action="store_true", help="go on with what is in DIR; finished fits stay"),
    argument(
        "--jobs",
        type=whole(1, 1024),
        default=0,
        metavar="N",
        help="worker processes on this machine (default: one a core; 1: none)",
    ),
    argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work instead",
    ),
)
COMMAND = Command(
    "study",
    help="compare methods over a declared design: thousands of fits into one table",
    description="Run every cell of a study: DIR/results.parquet with one row a fit and "
    "DIR/report.html. Finished cells are kept in DIR/cells.jsonl as they come; --resume runs "
    "the rest, and those that failed.",
    arguments=(
        argument("spec", type=Path, metavar="SPEC.toml", help="what is compared over what"),
        argument("--out", type=Path, required=True, metavar="DIR", help="folder"),
        *OF_CELLS,
        argument("--dry-run", action="store_true", help="say how many cells there are, and stop"),
    ),
    run=_run,
)
