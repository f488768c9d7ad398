"""Methods side by side as values that show themselves: rows, lead sentence, columns."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from comparisons.study.paired import Paired
from comparisons.study.scores import Score
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error, significant

__all__ = [
    "LEVEL",
    "Column",
    "GroupComparison",
    "MethodRow",
    "columns_of",
    "loss_label",
    "value_words",
]

LEVEL = "level with the best"
# Methods named in a lead sentence; the table holds all.
MOST_NAMED = 6
SUPERLATIVES = {"smaller": "smallest", "larger": "greatest", "zero": "smallest"}


@dataclass(frozen=True)
class MethodRow:
    """One method in a group of cells.

    Parameters
    ----------
    method : str
        Its name.
    n_cells, n_failed, n_scored : int
        Cells it was run on, that failed, and that have the score.
    mean, mean_stderr : float
        Mean of the score over its own cells (the bias, for an error that should be zero), and its
        standard error clustered by record.
    loss, loss_stderr : float
        Mean loss over its own cells and its standard error: the mean for "smaller", its negative
        for "larger", the mean absolute value for "zero", the distance of the mean for "target".
    median : float
        Median of the score; of its absolute value where zero is best.
    rms : float
        Root mean square of a score that should be zero, else NaN.
    against, to_best : Paired
        The method against the reference and against the best.
    rank : int or None
        By the difference to the reference; equal ones share a rank.
    standing : str
        "best", "level with the best", "worse", "error not known" or "not ranked".
    trust : str
        Why not to trust this row; may be empty.
    """

    method: str
    n_cells: int
    n_failed: int
    n_scored: int
    mean: float
    mean_stderr: float
    loss: float
    loss_stderr: float
    median: float
    rms: float
    against: Paired
    to_best: Paired
    rank: int | None
    standing: str
    trust: str


@dataclass(frozen=True)
class GroupComparison(Displayed):
    """Methods side by side over the cells of one group.

    Parameters
    ----------
    score : Score
        What is compared.
    where : tuple of tuple of str and object
        Axes and their values; empty for all cells together.
    reference, best : str
        Method that the others are compared with; the first by rank, or empty.
    rows : tuple of MethodRow
        By rank, those without one last.
    """

    score: Score
    where: tuple[tuple[str, Any], ...]
    reference: str
    best: str
    rows: tuple[MethodRow, ...]

    def row(self, method: str) -> MethodRow:
        """Return the row of a method."""
        return next(row for row in self.rows if row.method == method)

    @property
    def place(self) -> str:
        """Axes and their values in words."""
        return ", ".join(f"{name} = {value_words(v)}" for name, v in self.where) or "all cells"

    @property
    def caption(self) -> str:
        """What is compared, in which unit, over what and with which method."""
        unit = f" [{self.score.unit}]" if self.score.unit else ""
        return f"{self.score.label}{unit}, {self.place}, against {self.reference}"

    def lead(self) -> str:
        """Return in one sentence which method is best and by how much."""
        where = f"{self.place}: " if self.where else ""
        label = loss_label(self.score)
        if not any(row.n_scored for row in self.rows):
            return f"{where}no method has a value of {label}."
        if not self.best:
            return f"{where}no method can be ranked by {label}: no pair with the reference."
        best = self.row(self.best)
        others = [row for row in self.rows if row.method != self.best]
        named = [_against_best(row, self.score) for row in others[:MOST_NAMED]]
        if len(others) > MOST_NAMED:
            named.append(f"{len(others) - MOST_NAMED} more stand in the table")
        doubt = f" Do not lean on it: {best.trust}." if best.trust else ""
        rest = "; ".join(named) or "no other method was run"
        return f"{where}{_praise(best, self.score)}; {rest}.{doubt}"

    def _sheet(self) -> Sheet:
        columns = columns_of(self)
        grid = Grid(
            self.caption,
            tuple(column.heading for column in columns),
            tuple(zip(*(column.cells for column in columns), strict=True)),
            frozenset(i for i, column in enumerate(columns) if not column.numeric),
            marked=next((i for i, row in enumerate(self.rows) if row.method == self.best), None),
        )
        cautions = tuple(f"{row.method}: {row.trust}" for row in self.rows if row.trust)
        fields = [Field("in short", self.lead())]
        if cautions:
            fields.append(Field("caution", cautions, "advice"))
        return Sheet(f"Methods by {loss_label(self.score)}", tuple(fields), (grid,))


class Column(NamedTuple):
    """One column of a table of methods.

    Parameters
    ----------
    heading, meaning : str
        Its head, and what it says.
    cells : tuple of str
        One a method, in the order of the rows.
    numeric : bool
        Whether it holds numbers.
    """

    heading: str
    meaning: str
    cells: tuple[str, ...]
    numeric: bool = True


def columns_of(group: GroupComparison, *, full: bool = False) -> tuple[Column, ...]:
    """Return the columns of a table of methods.

    Parameters
    ----------
    group : GroupComparison
        What was compared.
    full : bool
        With records, standing and trust.
    """
    score = group.score

    def column(
        heading: str, meaning: str, text: Callable[[MethodRow], str], numeric: bool = True
    ) -> Column:
        return Column(heading, meaning, tuple(map(text, group.rows)), numeric)

    def difference(row: MethodRow) -> str:
        if row.method == group.reference:
            return "reference"
        return round_to_error(row.against.difference, row.against.stderr)

    def wins(row: MethodRow) -> str:
        if row.method == group.reference:
            return ""
        known = math.isfinite(row.against.wins)
        return f"{100.0 * row.against.wins:.0f} %" if known else NOT_KNOWN

    def mean(row: MethodRow) -> str:
        return round_like(row.mean, row.mean_stderr)

    def median(row: MethodRow) -> str:
        # Not to the error of the mean, which one gross failure makes larger than any median.
        return significant(row.median, 3)

    if score.better == "target":
        own = [column("share", f"of cells; {score.target:g} is best", mean)]
    elif score.better == "zero":
        size = "of the absolute values"
        own = [
            column("bias", "mean over its own cells", mean),
            column("mean |·|", size, lambda row: round_like(row.loss, row.loss_stderr)),
            column("median |·|", size, median),
            column("rms", "root mean square", lambda row: round_like(row.rms, row.loss_stderr)),
        ]
    else:
        own = [column(n, "over its own cells", f) for n, f in (("mean", mean), ("median", median))]
    columns = [
        column(
            "#",
            "rank by the difference to the reference; equal ones share it",
            lambda row: "–" if row.rank is None else str(row.rank),
        ),
        column("method", "name in the study", lambda row: row.method, numeric=False),
        column("cells", "cells that it was run on", lambda row: str(row.n_cells)),
        column("failed", "of them failed", lambda row: str(row.n_failed)),
        *own,
        column("pairs", "cells shared with the reference", lambda row: str(row.against.n_pairs)),
        column(
            "Δ to reference",
            "paired difference of the mean loss ± standard error over records; positive is worse",
            difference,
        ),
        column("wins", "share of pairs with the smaller loss; a tie counts half", wins),
    ]
    if full:
        standing = "against the best, by the 95 % interval"
        records = "independent records of the pairs"
        columns += [
            column("records", records, lambda row: str(row.against.n_records)),
            column("standing", standing, lambda row: row.standing, numeric=False),
            column("trust", "why not to trust this row", lambda row: row.trust, numeric=False),
        ]
    return tuple(columns)


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


def _records(number: int) -> str:
    return "1 record" if number == 1 else f"{number} records"


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
    # A difference of percentages is no percentage of either.
    unit = "percentage points" if score.unit == "%" else score.unit
    difference = f"{round_to_error(pair.difference, pair.stderr)} {unit}".strip()
    over = f"paired over {_records(pair.n_records)}"
    if row.standing == "worse":
        return f"{row.method} is {difference} worse ({over})"
    if row.standing == LEVEL:
        return f"{row.method} is level with it (difference {difference}, {over})"
    if row.standing == "error not known":
        return f"{row.method} is {difference} off, by one record alone"
    return f"{row.method} is not ranked ({row.trust or 'it has no mean difference'})"
