"""The report of a study: one HTML file with what came out, how sure it is and what failed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.page.blocks import Block, Bullets, Head, Part, Table, Words
from comparisons.page.html import render_page
from comparisons.study.comparison import compare_methods, methods_in, score_named
from comparisons.study.method_table import GroupComparison, columns_of, value_words
from comparisons.study.plots import draw_differences, draw_over_axis
from comparisons.study.spec import Range, StudySpec
from surge_core.files import check_target, write_whole
from surge_core.rounding import significant

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["render_study_report", "write_study_report"]

# Reasons, groups of one score and axes that are shown; what is left out is counted.
MOST_REASONS, MOST_GROUPS, MOST_AXES = 40, 24, 12
READING = (
    "Mean and median are over the method's own cells; differences over the cells that it shares "
    "with the reference, so that what is hard for both falls out. Errors leave out one whole "
    "record at a time. Level: the 95 % interval of the difference to the best holds zero "
    "(Student's t with few records, never less than two standard errors): no difference was "
    "detected, which is not the same as equal."
)


def write_study_report(
    path: Path, table: pd.DataFrame, spec: StudySpec, *, command: str = "sindy-surge study"
) -> None:
    """Write the report of a study, whole or not at all.

    Parameters
    ----------
    path : path
        Target, ending in ``.html``.
    table : DataFrame
        Results, one row a cell.
    spec : StudySpec
        The study.
    command : str
        The command line that made it.

    Raises
    ------
    InputError
        When the target cannot be written; it is refused before any picture is drawn.
    """
    check_target(path, (".html", ".htm"))
    write_whole(path, render_study_report(table, spec, command=command))


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

    Returns
    -------
    str
        HTML with its style and its pictures in it; all text is escaped.
    """
    reference = spec.reference if spec.reference in methods_in(table) else None
    scores = [score_named(score) for score in spec.scores]
    whole = {score: compare_methods(table, score, reference) for score in scores}
    leads = tuple(group.lead() for groups in whole.values() for group in groups)
    extent = (
        f"{len(table)} cells of {table['method'].nunique()} methods on "
        f"{table['record'].nunique()} records; {int((table['state'] == 'failed').sum())} failed. "
        f"Axes: {', '.join(spec.axes) or 'none'}."
    )
    sections = [("In short", [Part("Lead", (Bullets(leads), Words(extent, "quiet")))])]
    sections += [
        (_capital(score.label), _score_parts(table, spec, groups))
        for score, groups in whole.items()
        if groups
    ]
    run = [
        Part("Failed cells", _failures(table)),
        Part("Timings", _timings(table)),
        Part("Specification", (_specification(spec),)),
    ]
    sections.append(("How the study was run", run))
    return render_page(sections, title=spec.title, command=command)


def _score_parts(
    table: pd.DataFrame, spec: StudySpec, whole: Sequence[GroupComparison]
) -> list[Part]:
    score, reference = whole[0].score, whole[0].reference
    groups = compare_methods(table, score, reference, spec.by) if spec.by else ()
    tables: list[Block] = [_method_table(group) for group in (*whole, *groups[:MOST_GROUPS])]
    if len(groups) > MOST_GROUPS:
        tables.append(Words(f"The first {MOST_GROUPS} of {len(groups)} groups are shown."))
    leads = tuple(group.lead() for group in groups[:MOST_GROUPS])
    parts = (
        Part("Methods", (*tables, Words(READING, "quiet"))),
        Part(f"By {', '.join(spec.by)}", (Bullets(leads),) if leads else ()),
        Part("Pictures", _pictures(table, spec, [*whole, *groups])),
    )
    return [part for part in parts if part.blocks]


def _method_table(group: GroupComparison) -> Table:
    columns = columns_of(group, full=True)
    heads = tuple(
        Head(c.heading, c.meaning, c.numeric, c.heading == "trust", "reference" * c.numeric)
        for c in columns
    )
    rows = tuple(zip(*(column.cells for column in columns), strict=True))
    marks = tuple("best" if row.method == group.best else "" for row in group.rows)
    return Table(_capital(group.caption), heads, rows, marks)


def _pictures(
    table: pd.DataFrame, spec: StudySpec, groups: Sequence[GroupComparison]
) -> tuple[Block, ...]:
    if not any(row.n_scored for row in groups[0].rows):
        return ()
    score, methods = groups[0].score, methods_in(table)
    drawn = [draw_differences(groups, methods)] if len(methods) > 1 else []
    drawn += [
        draw_over_axis(table, score, axis, groups[0].reference) for axis in spec.axes[:MOST_AXES]
    ]
    return tuple(drawn)


def _failures(table: pd.DataFrame) -> tuple[Block, ...]:
    """Return how many cells ended in each state other than "ok", by method and reason."""
    bad = table[table["state"] != "ok"]
    if not len(bad):
        return (Words("Every cell ended in the state “ok”."),)
    counts = bad.groupby(["method", "state", "reason"]).size().sort_values(ascending=False)
    ends: Any = counts.head(MOST_REASONS).items()
    rows = tuple((method, state, str(n), reason) for (method, state, reason), n in ends)
    heads = (
        Head("method"),
        Head("state"),
        Head("cells", numeric=True),
        Head("reason or advice", prose=True),
    )
    left = f"{len(counts) - MOST_REASONS} more reasons stand in the table."
    more = (Words(left),) if len(counts) > MOST_REASONS else ()
    return Table("Cells that did not end well", heads, rows), *more


def _timings(table: pd.DataFrame) -> tuple[Block, ...]:
    """Return seconds by method and the share of fits in all seconds."""
    fits, records, reductions = (
        float(table[name].sum()) for name in ("seconds_fit", "seconds_record", "seconds_reduction")
    )
    seconds = table.groupby("method")["seconds_fit"].agg(["count", "sum", "median", "max"])
    rows = tuple(
        (str(name), str(int(count)), *(significant(float(value), 3) for value in several))
        for name, count, *several in seconds.itertuples()
    )
    heads = [Head("method"), Head("cells", numeric=True)]
    heads += [Head(f"{word} [s]", numeric=True) for word in ("sum", "median", "longest")]
    words = (
        f"{len(table)} cells: {significant(fits, 3)} s in fits, {significant(records, 3)} s in "
        f"records, {significant(reductions, 3)} s in reductions."
    )
    return Words(words), Table("Seconds of fits", tuple(heads), rows)


def _specification(spec: StudySpec) -> Table:
    given: dict[str, Sequence[Any]] = {
        "record.source": [spec.source],
        "seeds": spec.seeds,
        "design": [f"{spec.design.random} random points" if spec.design else "grid"],
    }
    given |= {k: [v] if isinstance(v, Range) else v for k, v in spec.settings.items()}
    rows = [(name, ", ".join(map(value_words, values))) for name, values in given.items()]
    for method in spec.method:
        parameters = ", ".join(f"{key} = {value}" for key, value in method.parameters.items())
        rows.append((f"method {method.name}", f"{method.import_path} {parameters}".strip()))
    return Table("The specification", (Head("setting"), Head("value", prose=True)), tuple(rows))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
