"""The report of a study: one HTML file with what came out, how sure it is and what failed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.page.blocks import Block, Bullets, Cell, Head, Part, Picture, Table, Words
from comparisons.study.comparison import (
    GroupComparison,
    axes_in,
    compare_methods,
    methods_in,
    pairwise,
    score_named,
)
from comparisons.study.paired import plain_values
from comparisons.study.scores import Score
from comparisons.study.words import fields_of, lead_sentence, loss_label, value_words, where_words
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    import pandas as pd

    from comparisons.show.report import ReportSection
    from comparisons.study.plots import Drawn

__all__ = ["render_study_report", "study_sections", "write_study_report"]

FAILED = "failed"
# Reasons, and groups of one score, that are shown; what is left out is counted.
MOST_REASONS, MOST_GROUPS, MOST_AXES = 40, 24, 12
PROSE = ("trust",)


@dataclass(frozen=True)
class _Study:
    """Results, and what is asked of them."""

    table: pd.DataFrame
    reference: str | None
    by: tuple[str, ...]


def write_study_report(
    path: str | Path,
    table: pd.DataFrame,
    spec_words: Mapping[str, Any],
    scores: Sequence[Score | str],
    reference: str | None = None,
    by: Sequence[str] = (),
    *,
    title: str = "Study of methods",
    command: str = "sindy-surge study",
    version: str | None = None,
) -> None:
    """Write the report of a study, whole or not at all.

    Parameters
    ----------
    path : str or path
        Target, ending in ``.html``.
    table, spec_words, scores, reference, by, title, command, version
        See :func:`render_study_report`.

    Raises
    ------
    InputError
        When the target cannot be written; it is refused before any picture is drawn.
    """
    from surge_core.files import check_target, write_whole

    target = Path(path)
    check_target(target, (".html", ".htm"))
    page = render_study_report(
        table,
        spec_words,
        scores,
        reference,
        by,
        title=title,
        command=command,
        version=version,
    )
    write_whole(target, page)


def render_study_report(
    table: pd.DataFrame,
    spec_words: Mapping[str, Any],
    scores: Sequence[Score | str],
    reference: str | None = None,
    by: Sequence[str] = (),
    *,
    title: str = "Study of methods",
    command: str = "sindy-surge study",
    version: str | None = None,
) -> str:
    """Return the report of a study as one self-contained HTML page.

    Parameters
    ----------
    table : DataFrame
        Results, one row a cell.
    spec_words : mapping
        The resolved specification; mappings within it are flattened under dotted names.
    scores : sequence of Score or str
        What is compared, a section each.
    reference : str, optional
        Method that the others are compared with; the best of each score without it.
    by : sequence of str
        Axes; each combination of their values has a table of its own.
    title, command : str
        Title of the page and the command line that made it.
    version : str, optional
        Version of this package; that of the installed one without it.

    Returns
    -------
    str
        HTML with its style and its pictures in it; all text is escaped.
    """
    from comparisons.show.report import render_report

    sections = study_sections(table, spec_words, scores, reference, by)
    return render_report(sections, title=title, command=command, version=version)


def study_sections(
    table: pd.DataFrame,
    spec_words: Mapping[str, Any],
    scores: Sequence[Score | str],
    reference: str | None = None,
    by: Sequence[str] = (),
) -> tuple[ReportSection, ...]:
    """Return the sections of the report: results, one a score, and how the study was run.

    Parameters
    ----------
    table, spec_words, scores, reference, by
        See :func:`render_study_report`.
    """
    from comparisons.show.report import ReportSection

    study = _Study(table, reference, tuple(by))
    known = [score for score in map(score_named, scores) if score.name in table.columns]
    lacking = [s.label for s in map(score_named, scores) if s.name not in table.columns]
    whole = {score.name: compare_methods(table, score, reference) for score in known}
    leads = tuple(lead_sentence(group) for groups in whole.values() for group in groups)
    blocks: list[Block] = [Bullets(leads)] if leads else [Words("No cells: nothing to compare.")]
    if lacking:
        blocks.append(Words(f"Not among the results: {', '.join(lacking)}.", "caution"))
    parts = [Part("Lead", (*blocks, Words(_extent(table), "quiet")))]
    sections = [ReportSection("In short", extra=tuple(parts))]
    for score in known:
        if whole[score.name]:
            extra = _score_parts(study, score, whole[score.name])
            sections.append(ReportSection(_capital(score.label), extra=extra))
    run = (
        Part("Failed cells", _failures(table)),
        Part("Timings", _timings(table)),
        Part("Specification", (_specification(spec_words),)),
    )
    return (*sections, ReportSection("How the study was run", extra=run))


def _score_parts(
    study: _Study, score: Score, whole: tuple[GroupComparison, ...]
) -> tuple[Part, ...]:
    reference = whole[0].reference
    groups = compare_methods(study.table, score, reference, study.by) if study.by else ()
    tables: list[Block] = [_method_table(group) for group in (*whole, *groups[:MOST_GROUPS])]
    if len(groups) > MOST_GROUPS:
        tables.append(Words(f"The first {MOST_GROUPS} of {len(groups)} groups are shown."))
    told = tuple(lead_sentence(group) for group in groups[:MOST_GROUPS])
    parts = (
        Part("Methods", (*tables, Words(_READING, "quiet"))),
        Part(f"By {', '.join(study.by)}", (Bullets(told),) if told else ()),
        Part("Every method against every other", _pairwise_blocks(study, score)),
        Part("Pictures", tuple(_pictures(study, score, (*whole, *groups)))),
    )
    return tuple(part for part in parts if part.blocks)


_READING = (
    "Mean and median are over the method's own cells; differences over the cells that it shares "
    "with the reference, so that what is hard for both falls out. Errors leave out one whole "
    "record at a time. Level: the 95 % interval of the difference to the best holds zero "
    "(Student's t with few records, never less than two standard errors): not told apart, which is "
    "not the same as equal."
)


def _method_table(group: GroupComparison) -> Table:
    fields = fields_of(group.score, full=True)
    heads = tuple(
        Head(f.heading, f.meaning, f.numeric, f.heading in PROSE, "reference" if f.numeric else "")
        for f in fields
    )
    rows = tuple(tuple(field.text(row, group) for field in fields) for row in group.rows)
    marks = tuple("best" if row.method == group.best else "" for row in group.rows)
    unit = f" [{group.score.unit}]" if group.score.unit else ""
    caption = f"{group.score.label}{unit}, {where_words(group.where)}, against {group.reference}"
    return Table(_capital(caption), heads, rows, marks)


def _pairwise_blocks(study: _Study, score: Score) -> tuple[Block, ...]:
    matrix = pairwise(study.table, score)
    if len(matrix.methods) < 2:
        return ()
    rows: list[tuple[str | Cell, ...]] = []
    for i, name in enumerate(matrix.methods):
        cells: list[str | Cell] = [name]
        for j, pair in enumerate(matrix.pairs[i]):
            if i == j:
                cells.append("")
            else:
                told = round_to_error(pair.difference, pair.stderr)
                cells.append(Cell(told, f"{pair.n_pairs} pairs, {pair.n_records} records"))
        rows.append(tuple(cells))
    heads = (Head("worse by … than"), *(Head(name, numeric=True) for name in matrix.methods))
    unit = f" [{score.unit}]" if score.unit else ""
    caption = f"{_capital(loss_label(score))}{unit}: the row's method minus the column's"
    return (Table(caption, heads, tuple(rows)),)


def _pictures(study: _Study, score: Score, groups: Sequence[GroupComparison]) -> list[Block]:
    from comparisons.study.plots import draw_differences, draw_over_axis, draw_seconds

    table, reference = study.table, groups[0].reference
    methods = methods_in(table)
    scored = any(row.n_scored for row in groups[0].rows)
    if not scored:
        return []
    blocks: list[Block] = []
    if len(methods) > 1:
        blocks.append(_picture(draw_differences(groups, methods)))
    axes = [axis for axis in axes_in(table) if _varies(table, axis)]
    for axis in axes[:MOST_AXES]:
        blocks.append(_picture(draw_over_axis(table, score, axis, reference)))
    if len(axes) > MOST_AXES:
        blocks.append(Words(f"The first {MOST_AXES} of {len(axes)} axes are drawn."))
    if "seconds_fit" in table.columns:
        blocks.append(_picture(draw_seconds(table, score)))
    return blocks


def _picture(drawn: Drawn) -> Picture:
    return Picture.of(drawn.title, drawn.figure, drawn.alt, drawn.reading)


def _varies(table: pd.DataFrame, axis: str) -> bool:
    return int(table[axis].nunique(dropna=False)) > 1


def _extent(table: pd.DataFrame) -> str:
    axes = [axis for axis in axes_in(table) if _varies(table, axis)]
    failed = int((table["state"] == FAILED).sum())
    return (
        f"{len(table)} cells of {table['method'].nunique()} methods on "
        f"{table['record'].nunique()} records; {failed} failed. Axes: {', '.join(axes) or 'none'}."
    )


def _failures(table: pd.DataFrame) -> tuple[Block, ...]:
    """Return how many cells ended in each state other than "ok", by method and reason."""
    counts: dict[tuple[str, str, str], int] = {}
    for method, state, reason in zip(
        table["method"], table["state"], _texts(table, "reason"), strict=True
    ):
        if state != "ok":
            key = (str(method), str(state), reason)
            counts[key] = counts.get(key, 0) + 1
    if not counts:
        return (Words("Every cell ended in the state “ok”."),)
    ordered = sorted(counts.items(), key=lambda item: (item[0][1] != FAILED, -item[1], item[0]))
    rows = tuple((m, s, str(count), r) for (m, s, r), count in ordered[:MOST_REASONS])
    heads = (
        Head("method"),
        Head("state"),
        Head("cells", numeric=True),
        Head("reason or advice", prose=True),
    )
    blocks: list[Block] = [Table("Cells that did not end well", heads, rows)]
    if len(ordered) > MOST_REASONS:
        left = sum(count for _, count in ordered[MOST_REASONS:])
        blocks.append(Words(f"{left} more cells with {len(ordered) - MOST_REASONS} other reasons."))
    return tuple(blocks)


def _timings(table: pd.DataFrame) -> tuple[Block, ...]:
    """Return seconds by method and the share of fits in all seconds."""
    if "seconds_fit" not in table.columns or not len(table):
        return (Words("No seconds were recorded."),)
    seconds = _numbers(table, "seconds_fit")
    methods = np.array([str(name) for name in table["method"]], dtype=object)
    rows = []
    for name in methods_in(table):
        own = seconds[(methods == name) & np.isfinite(seconds)]
        told = [own.sum(), np.median(own), own.max()] if own.size else [math.nan] * 3
        rows.append((name, str(own.size), *(significant(float(value), 3) for value in told)))
    heads = [Head("method"), Head("cells", "with a time", numeric=True)]
    heads += [Head(f"{word} [s]", numeric=True) for word in ("sum", "median", "longest")]
    fits = float(np.nansum(seconds))
    # What cells share was made once, though each of them states its seconds.
    records = _once(table, "seconds_record", ("record",))
    reductions = _once(table, "seconds_reduction", ("record", "reduction"))
    whole = fits + records + reductions
    share = f"{100.0 * fits / whole:.0f} %" if whole > 0.0 else "no share"
    told_words = (
        f"{len(table)} cells: {significant(fits, 3)} s in fits, {significant(records, 3)} s in "
        f"records, {significant(reductions, 3)} s in reductions; fits are {share} of it."
    )
    return Words(told_words), Table("Seconds of fits", tuple(heads), tuple(rows))


def _once(table: pd.DataFrame, column: str, keys: tuple[str, ...]) -> float:
    if column not in table.columns:
        return 0.0
    longest: dict[tuple[str, ...], float] = {}
    for *key, seconds in zip(*(table[name] for name in keys), _numbers(table, column), strict=True):
        if math.isfinite(seconds):
            named = tuple(map(str, key))
            longest[named] = max(longest.get(named, 0.0), float(seconds))
    return math.fsum(longest.values())


def _specification(words: Mapping[str, Any]) -> Table:
    rows = tuple(_flat(words))
    heads = (Head("setting"), Head("value", prose=True))
    return Table("The specification as it was resolved", heads, rows)


def _flat(words: Mapping[str, Any], lead: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in words.items():
        name = f"{lead}{key}"
        if isinstance(value, Mapping):
            rows += _flat(value, f"{name}.") or [(name, "none")]
        elif isinstance(value, list | tuple) and any(isinstance(v, Mapping) for v in value):
            rows += _flat({str(i): v for i, v in enumerate(value, start=1)}, f"{name}.")
        elif isinstance(value, list | tuple):
            rows.append((name, ", ".join(value_words(item) for item in value) or "none"))
        else:
            rows.append((name, value_words(value)))
    return rows


def _texts(table: pd.DataFrame, column: str) -> list[str]:
    if column not in table.columns:
        return [""] * len(table)
    return ["" if value is None else str(value) for value in plain_values(table[column])]


def _numbers(table: pd.DataFrame, column: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    import pandas as pd

    return pd.to_numeric(table[column]).to_numpy(dtype=np.float64, na_value=np.nan)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
