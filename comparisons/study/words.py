"""A comparison of methods in words: lead sentences and tables for the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from comparisons.results import TableField
from comparisons.study.comparison import (
    LEVEL,
    GroupComparison,
    MethodRow,
    compare_methods,
    score_named,
)
from comparisons.study.scores import Score
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error, significant

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "difference_words",
    "fields_of",
    "lead_sentence",
    "loss_label",
    "plain",
    "score_table",
    "study_text",
    "value_words",
    "where_words",
]

WIDTH = 100
INDENT = "   "
SHORTEST_NAME = 10
# Methods told of in a lead sentence; the table holds all.
MOST_TOLD = 6
SUPERLATIVES = {"smaller": "smallest", "larger": "greatest", "zero": "smallest"}
METHOD = 1


def study_text(
    table: pd.DataFrame,
    scores: Sequence[Score | str],
    reference: str | None = None,
    by: Sequence[str] = (),
) -> str:
    """Return lead sentence and table of each score, at most 100 columns wide.

    Parameters
    ----------
    table : DataFrame
        Results, one row a cell.
    scores : sequence of Score or str
        What is compared.
    reference : str, optional
        Method that the others are compared with; the best without it.
    by : sequence of str
        Axes; each combination of their values has a table of its own, after that of all cells.
    """
    if not len(table):
        return "No cells: there is nothing to compare."
    blocks = []
    for score in map(score_named, scores):
        if score.name not in table.columns:
            blocks.append(f"{score.label} ({score.name}): not among the results")
            continue
        groups = compare_methods(table, score, reference)
        if by:
            groups += compare_methods(table, score, groups[0].reference, by)
        blocks += [score_table(group) for group in groups]
    return "\n\n".join(blocks)


def score_table(group: GroupComparison) -> str:
    """Return the lead sentence and the table of one group, at most 100 columns wide.

    Parameters
    ----------
    group : GroupComparison
        Methods side by side.

    Returns
    -------
    str
        Below each row stand its standing, its records and why not to trust it.
    """
    fields = fields_of(group.score)
    cells = [[plain(field.text(row, group)) for field in fields] for row in group.rows]
    lines = _aligned(fields, cells)
    unit = f" [{group.score.unit}]" if group.score.unit else ""
    body = [lines[0], lines[1]]
    for start, row in zip(lines[2:], group.rows, strict=True):
        body += [start, *_wrapped(plain(_below(row, group)), INDENT)]
    title = (
        f"{group.score.label}{unit}, {where_words(group.where)}; differences to {group.reference}"
    )
    return "\n".join([*_wrapped(plain(lead_sentence(group))), "", *_wrapped(plain(title)), *body])


def lead_sentence(group: GroupComparison) -> str:
    """Return in one sentence which method is best and by how much.

    Parameters
    ----------
    group : GroupComparison
        Methods side by side.
    """
    where = f"{where_words(group.where)}: " if group.where else ""
    label = loss_label(group.score)
    if not any(row.n_scored for row in group.rows):
        return f"{where}no method has a value of {label}."
    if not group.best:
        return f"{where}no method can be ranked by {label}: {_medians(group)}."
    best = group.row(group.best)
    others = [row for row in group.rows if row.method != group.best]
    told = [_against_best(row, group.score) for row in others[:MOST_TOLD]]
    if len(others) > MOST_TOLD:
        told.append(f"{len(others) - MOST_TOLD} more stand in the table")
    if not others:
        told = ["no other method was run"]
    doubt = f" Do not lean on it: {best.trust}." if best.trust else ""
    return f"{where}{_praise(best, group.score)}; {'; '.join(told)}.{doubt}"


def fields_of(score: Score, *, full: bool = False) -> tuple[TableField, ...]:
    """Return the columns of a table of methods; each text takes a row and its group.

    Parameters
    ----------
    score : Score
        What is compared.
    full : bool
        With what the terminal says below the rows: records, medians, standing, trust.
    """
    more = (
        TableField("records", "independent records of the pairs", _records_count),
        TableField(
            "median Δ",
            "median of the differences of the pairs",
            _median_difference,
        ),
        TableField("standing", "against the best, by the 95 % interval", _standing, False),
        TableField("trust", "why not to trust this row", _trust, False),
    )
    return (
        TableField(
            "#",
            "rank by the difference to the reference; equal ones share it",
            _rank,
        ),
        TableField("method", "name in the study", _method, False),
        TableField("cells", "cells that it was run on", _cells),
        TableField("failed", "of them failed", _failed),
        *_level_fields(score),
        TableField(
            "gross",
            "share of scored cells ten spreads beyond the median of the best, or infinite",
            _gross,
        ),
        TableField("pairs", "cells shared with the reference", _pairs),
        TableField(
            "Δ to reference",
            "paired difference of the mean loss ± standard error over records; positive is worse",
            _difference,
        ),
        TableField(
            "wins",
            "share of pairs with the smaller loss; a tie counts half",
            _wins,
        ),
        *(more if full else ()),
    )


def loss_label(score: Score) -> str:
    """Return what the loss of a score is called.

    Parameters
    ----------
    score : Score
        The score.
    """
    if score.better == "zero":
        return f"|{score.label}|"
    if score.better == "target":
        return f"|share “{score.label}” − {score.target:g}|"
    return score.label


def difference_words(value: float, error: float, unit: str = "") -> str:
    """Return a difference with its error and its unit.

    Parameters
    ----------
    value, error : float
        The difference and its standard error.
    unit : str
        Its unit.
    """
    text = round_to_error(value, error)
    # A difference of percentages is no percentage of either.
    unit = "percentage points" if unit == "%" else unit
    return f"{text} {unit}" if unit and text != NOT_KNOWN else text


def where_words(where: tuple[tuple[str, Any], ...]) -> str:
    """Return the axes and values of a group.

    Parameters
    ----------
    where : tuple of tuple of str and object
        Axes and their values.
    """
    return ", ".join(f"{name} = {value_words(v)}" for name, v in where) or "all cells"


def value_words(value: Any) -> str:
    """Return the value of an axis.

    Parameters
    ----------
    value : object
        Number, text or None.
    """
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def plain(text: str) -> str:
    """Return text without control characters, which a terminal would obey.

    Parameters
    ----------
    text : str
        Any text.
    """
    return "".join(c if c.isprintable() else "?" for c in text)


def _level_fields(score: Score) -> tuple[TableField, ...]:
    if score.better == "target":
        return (TableField("share", f"of cells; {score.target:g} is best", _mean),)
    if score.better != "zero":
        return (
            TableField("mean", "over its own cells", _mean),
            TableField("median", "over its own cells", _median),
        )
    return (
        TableField("bias", "mean over its own cells", _mean),
        TableField("mean |·|", "of the absolute values", _loss),
        TableField("median |·|", "of the absolute values", _median),
        TableField("rms", "root mean square", _rms),
    )


def _mean(row: MethodRow, _: GroupComparison) -> str:
    return round_like(row.mean, row.mean_stderr)


def _loss(row: MethodRow, _: GroupComparison) -> str:
    return round_like(row.loss, row.loss_stderr)


def _median(row: MethodRow, _: GroupComparison) -> str:
    # Not to the error of the mean, which one gross failure makes larger than any median.
    return significant(row.median, 3)


def _rms(row: MethodRow, _: GroupComparison) -> str:
    return round_like(row.rms, row.loss_stderr)


def _difference(row: MethodRow, group: GroupComparison) -> str:
    if row.method == group.reference:
        return "reference"
    return round_to_error(row.against.difference, row.against.stderr)


def _standing(row: MethodRow, _: GroupComparison) -> str:
    return row.standing


def _records_count(row: MethodRow, _: GroupComparison) -> str:
    return str(row.against.n_records)


def _rank(row: MethodRow, _: GroupComparison) -> str:
    return "–" if row.rank is None else str(row.rank)


def _method(row: MethodRow, _: GroupComparison) -> str:
    return row.method


def _cells(row: MethodRow, _: GroupComparison) -> str:
    return str(row.n_cells)


def _failed(row: MethodRow, _: GroupComparison) -> str:
    return str(row.n_failed)


def _pairs(row: MethodRow, _: GroupComparison) -> str:
    return str(row.against.n_pairs)


def _gross(row: MethodRow, _: GroupComparison) -> str:
    return _percent(row.gross)


def _wins(row: MethodRow, group: GroupComparison) -> str:
    return "" if row.method == group.reference else _percent(row.against.wins)


def _median_difference(row: MethodRow, group: GroupComparison) -> str:
    return "" if row.method == group.reference else significant(row.against.median, 3)


def _trust(row: MethodRow, _: GroupComparison) -> str:
    return row.trust


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if math.isfinite(share) else NOT_KNOWN


def _records(number: int) -> str:
    return "1 record" if number == 1 else f"{number} records"


def _below(row: MethodRow, group: GroupComparison) -> str:
    """Return what stands below a row of the terminal's table."""
    standing = row.standing
    if standing in (LEVEL, "worse") and group.best != group.reference:
        told = round_to_error(row.to_best.difference, row.to_best.stderr)
        standing = f"{standing} ({told})"
    parts = [standing]
    if row.against.n_pairs:
        parts.append(_records(row.against.n_records))
    if row.method != group.reference and math.isfinite(row.against.median):
        parts.append(f"median Δ {significant(row.against.median, 3)}")
    if row.trust:
        parts.append(f"caution: {row.trust}")
    return "; ".join(parts)


def _praise(best: MethodRow, score: Score) -> str:
    unit = f" {score.unit}" if score.unit else ""
    if score.better == "target":
        share = round_to_error(best.mean, best.mean_stderr)
        return f"{best.method} has the share “{score.label}” nearest to {score.target:g}: {share}"
    zero = score.better == "zero"
    value, error = (best.loss, best.loss_stderr) if zero else (best.mean, best.mean_stderr)
    median = significant(best.median, 3)
    return (
        f"{best.method} has the {SUPERLATIVES[score.better]} {loss_label(score)}: "
        f"{round_like(value, error)}{unit} on average, median {median}{unit}"
    )


def _against_best(row: MethodRow, score: Score) -> str:
    pair = row.to_best
    told = difference_words(pair.difference, pair.stderr, score.unit)
    over = f"paired over {_records(pair.n_records)}"
    if row.standing == "worse":
        return f"{row.method} is {told} worse ({over})"
    if row.standing == LEVEL:
        return f"{row.method} is level with it (difference {told}, {over})"
    if row.standing == "error not known":
        return f"{row.method} is {told} off, by one record alone"
    return f"{row.method} is not ranked ({row.trust or 'it has no mean difference'})"


def _medians(group: GroupComparison) -> str:
    unit = f" {group.score.unit}" if group.score.unit else ""
    known = [row for row in group.rows if math.isfinite(row.median)]
    told = [f"{row.method} has the median {significant(row.median, 3)}{unit}" for row in known]
    return "; ".join(told[:MOST_TOLD]) or "no pair with the reference"


def _aligned(fields: Sequence[TableField], cells: list[list[str]]) -> list[str]:
    """Return head, rule and rows; long names are cut in the middle so that the width holds."""
    rows = [[field.heading for field in fields], *cells]
    widths = [max(len(row[i]) for row in rows) for i in range(len(fields))]
    others = sum(widths) - widths[METHOD]
    gap = "  "
    if others + SHORTEST_NAME + len(gap) * (len(fields) - 1) > WIDTH:
        gap = " "
    room = WIDTH - others - len(gap) * (len(fields) - 1)
    widths[METHOD] = min(widths[METHOD], max(room, SHORTEST_NAME))
    for row in rows:
        row[METHOD] = _cut(row[METHOD], widths[METHOD])
    lines = [
        gap.join(
            text.rjust(width) if field.numeric else text.ljust(width)
            for text, width, field in zip(row, widths, fields, strict=True)
        ).rstrip()
        for row in rows
    ]
    return [lines[0], "─" * (sum(widths) + len(gap) * (len(widths) - 1)), *lines[1:]]


def _cut(name: str, width: int) -> str:
    if len(name) <= width:
        return name
    head = width // 2
    return f"{name[:head]}…{name[len(name) - (width - head - 1) :]}"


def _wrapped(prose: str, indent: str = "") -> list[str]:
    return textwrap.wrap(
        prose, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
    )
