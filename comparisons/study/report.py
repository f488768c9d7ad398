"""The report of a study: one HTML file with what came out, how sure it is and what failed."""

from __future__ import annotations

from typing import Any

import pandas as pd

from comparisons.page.blocks import Bullets, Part, Words
from comparisons.page.html import render_page
from comparisons.study.comparison import compare_methods
from comparisons.study.spec import StudySpec
from surge_core.display import Grid

# Groups of one score and reasons that are shown; the table has all.
MOST_GROUPS, MOST_REASONS = 24, 40
READING = (
    "Mean, loss and median are over the method's own cells; differences over the cells that it "
    "shares with the reference, so that what is hard for both falls out. Errors leave out one "
    "whole record at a time. Undecided: the data say neither that two methods differ nor that "
    "they differ by less than the margin."
)


def render_study_report(
    table: pd.DataFrame, spec: StudySpec, *, command: str = "sindy-surge study"
) -> str:
    """Return the report of a study as one self-contained HTML page.

    Parameters
    ----------
    table : DataFrame
        Results, one row a cell.
    spec : StudySpec
        The study: what is compared, with which method and by which axes.
    command : str
        The command line that made it.
    """
    groups = [
        compare_methods(table, score, spec.reference, spec.by, spec.margin)[: 1 + MOST_GROUPS]
        for score in spec.scores
    ]
    extent = (
        f"{len(table)} cells of {table['method'].nunique()} methods on "
        f"{table['record'].nunique()} records; {int((table['state'] == 'failed').sum())} failed. "
        f"Axes: {', '.join(spec.axes) or 'none'}."
    )
    leads = tuple(several[0].lead() for several in groups)
    sections = [("In short", [Part("Lead", (Bullets(leads), Words(extent, "quiet")))])]
    for several in groups:
        tables = [group.grid() for group in several]
        part = Part("Methods", (*tables, Words(READING, "quiet")))
        sections.append((several[0].score.label.capitalize(), [part]))
    sections.append(("Cells that did not end well", [Part("Reasons", (_failures(table),))]))
    return render_page(sections, title=spec.title, command=command)


def _failures(table: pd.DataFrame) -> Grid:
    """Return how many cells ended in each state other than "ok", by method and reason."""
    bad = table[table["state"] != "ok"]
    counts = bad.groupby(["method", "state", "reason"]).size().sort_values(ascending=False)
    ends: Any = counts.head(MOST_REASONS).items()
    rows = tuple((method, state, str(n), reason) for (method, state, reason), n in ends)
    heads = ("method", "state", "cells", "reason")
    return Grid(f"{len(bad)} of {len(table)} cells", heads, rows, frozenset({0, 1, 3}))
