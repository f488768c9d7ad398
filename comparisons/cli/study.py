"""The command `sindy-surge study`: a method-comparison study from a TOML file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import pandas as pd
from joblib import cpu_count

from comparisons.cli.output import command_line
from comparisons.study.comparison import compare_methods
from comparisons.study.design import cells_of
from comparisons.study.report import render_study_report
from comparisons.study.run import RESULTS, check_study, run_study
from comparisons.study.spec import StudySpec, read_spec
from surge_core.errors import InputError
from surge_core.files import write_whole
from surge_core.progress import shown_count


def run(given: argparse.Namespace) -> Iterator[str]:
    """Run every cell of a study, and compare the methods."""
    spec = read_spec(given.spec)
    check_study(spec, given.out, resume=given.resume or given.dry_run)
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
        found = f"{len(table)} that failed, {reasons.iloc[0]} of them with: {reasons.index[0]}"
        remedy = f"{given.out / RESULTS} has the reason of each"
        raise InputError(
            str(given.spec), expected="cells that can be fitted", found=found, remedy=remedy
        )
    if len(reasons):
        yield f"{reasons.sum()} of {len(table)} cells failed; table and report have the reasons"
    yield ""
    for score in spec.scores:
        groups = compare_methods(table, score, spec.reference, spec.by, spec.margin)
        yield from (f"{group}\n" for group in groups)
    page = given.out / "report.html"
    write_whole(page, render_study_report(table, spec, command=command_line()))
    yield f"table:  {given.out / RESULTS}"
    yield f"report: {page}"


def run_cells(given: argparse.Namespace, spec: StudySpec) -> pd.DataFrame:
    """Run the cells of a study with the options of ``OF_CELLS``; return all fits as a table."""
    jobs = given.jobs or cpu_count()
    options = {"jobs": jobs, "scheduler": given.scheduler, "resume": given.resume}
    with shown_count(unit="fit", total=len(cells_of(spec))) as progress:
        return run_study(spec, given.out, **options, progress=progress)
