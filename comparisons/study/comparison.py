"""Methods of a study side by side: paired over what they share, with errors over records.

Two methods are compared on cells that differ in nothing but the method, so that what makes a
record hard is hard for both and falls out of the difference; see `paired`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.stats import rankdata

from comparisons.study.paired import Cells, Paired, group_cells, jackknife, losses, paired
from comparisons.study.scores import Score, loss_label, score_named
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.errors import InputError
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error, significant

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COLUMNS",
    "LEVEL",
    "Column",
    "GroupComparison",
    "MethodRow",
    "compare_methods",
    "study_text",
    "value_words",
]

# Below so many records neither an error nor its normal approximation is to be relied on.
FEWEST_RECORDS = 5
# A method with fewer than this share of the cells of the fullest one is not ranked.
RUNNING_SHARE = 0.5
# Differences that agree to so many digits of the greatest loss share a rank.
DIGITS = 12
LEVEL = "level with the best"


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
    against, to_best : Paired
        The method against the reference and against the best.
    rank : int or None
        By the difference to the reference; equal ones share a rank.
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
    against: Paired
    to_best: Paired
    rank: int | None
    trust: str

    @property
    def standing(self) -> str:
        """Against the best, by the 95 % interval: "best", `LEVEL`, "worse" or "not known"."""
        if self.rank is None:
            return "not known"
        if self.rank == 1:
            return "best"
        if not math.isfinite(self.to_best.stderr):
            return "not known"
        return LEVEL if self.to_best.difference <= self.to_best.reach else "worse"


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
        """Return in one sentence which method is best and how far the others are from it."""
        label, unit = loss_label(self.score), self.score.unit
        if not self.best:
            return f"{self.place}: no method has a value of {label}."
        best = self.row(self.best)
        said = [
            f"{best.method} is best by {label}, {round_like(best.loss, best.loss_stderr)} {unit}"
        ]
        for row in self.rows:
            if row.method != self.best:
                how_far = round_to_error(row.to_best.difference, row.to_best.stderr)
                said.append(f"{row.method} {row.standing} ({how_far} {unit}".rstrip() + ")")
        words = "; ".join(sentence.rstrip() for sentence in said)
        return f"{self.place}: {words}; paired over {best.against.n_records} records."

    def _sheet(self) -> Sheet:
        shown = [column for column in COLUMNS if column.in_text]
        grid = Grid(
            self.caption,
            tuple(column.heading for column in shown),
            tuple(tuple(column.text(row, self) for column in shown) for row in self.rows),
            frozenset(i for i, column in enumerate(shown) if not column.numeric),
            marked=0 if self.best else None,
        )
        fields = [Field("in short", self.lead())]
        if cautions := tuple(f"{row.method}: {row.trust}" for row in self.rows if row.trust):
            fields.append(Field("caution", cautions, "advice"))
        return Sheet(f"Methods by {loss_label(self.score)}", tuple(fields), (grid,))


class Column(NamedTuple):
    """One column of a table of methods.

    Parameters
    ----------
    heading, meaning : str
        Its head, and what it says.
    text : callable
        ``text(row, group)`` gives a cell.
    numeric, in_text : bool
        Whether it holds numbers, and whether a terminal shows it.
    """

    heading: str
    meaning: str
    text: Callable[[MethodRow, GroupComparison], str]
    numeric: bool = True
    in_text: bool = True


def _difference(row: MethodRow, group: GroupComparison) -> str:
    if row.method == group.reference:
        return "reference"
    return round_to_error(row.against.difference, row.against.stderr)


def _wins(row: MethodRow, group: GroupComparison) -> str:
    if row.method == group.reference:
        return ""
    known = math.isfinite(row.against.wins)
    return f"{100.0 * row.against.wins:.0f} %" if known else NOT_KNOWN


COLUMNS = (
    Column("#", "rank by the difference to the reference", lambda r, _: str(r.rank or "–")),
    Column("method", "name in the study", lambda r, _: r.method, numeric=False),
    Column("cells", "cells that it was run on", lambda r, _: str(r.n_cells)),
    Column("failed", "of them failed", lambda r, _: str(r.n_failed)),
    Column("mean", "over its own cells", lambda r, _: round_like(r.mean, r.mean_stderr)),
    Column(
        "loss",
        "mean over its own cells: of the absolute value, where zero is best",
        lambda r, _: round_like(r.loss, r.loss_stderr),
    ),
    # Not to the error of the mean, which one gross failure makes larger than any median.
    Column("median", "of the absolute value likewise", lambda r, _: significant(r.median, 3)),
    Column("pairs", "cells shared with the reference", lambda r, _: str(r.against.n_pairs)),
    Column(
        "Δ to reference",
        "paired difference of the mean loss ± standard error over records; positive is worse",
        _difference,
    ),
    Column("wins", "share of pairs with the smaller loss; a tie counts half", _wins),
    Column("records", "independent", lambda r, _: str(r.against.n_records), in_text=False),
    Column("standing", "against the best", lambda r, _: r.standing, numeric=False, in_text=False),
    Column("trust", "why not to trust it", lambda r, _: r.trust, numeric=False, in_text=False),
)


def compare_methods(
    table: pd.DataFrame,
    score: Score | str,
    reference: str | None = None,
    by: Sequence[str] = (),
) -> tuple[GroupComparison, ...]:
    """Compare the methods of a study with a reference, over pairs alone.

    Parameters
    ----------
    table : DataFrame
        Results, one row a cell.
    score : Score or str
        What is compared, or its name in `SCORES`.
    reference : str, optional
        Method that the others are compared with; without it the one with the smallest mean loss
        over the cells that all methods share.
    by : sequence of str
        Axes; each combination of their values is a group of its own.

    Returns
    -------
    tuple of GroupComparison
        In the order of the axes' values; empty for a table without rows.

    Raises
    ------
    InputError
        When a column is missing, two rows are the same cell, or the reference is no method.
    """
    chosen = score_named(score)
    groups = group_cells(table, chosen, by)
    names = methods_in(table)
    if reference is not None and reference not in names:
        raise InputError("reference", expected="one of " + ", ".join(names), found=repr(reference))
    if not groups:
        return ()
    if reference is None:
        reference = _winner(group_cells(table, chosen, ())[0][1], chosen)
    return tuple(_compared(cells, chosen, reference, where) for where, cells in groups)


def study_text(
    table: pd.DataFrame,
    scores: Sequence[Score | str],
    reference: str | None = None,
    by: Sequence[str] = (),
) -> str:
    """Return lead sentence and table of each score.

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
    groups: list[GroupComparison] = []
    for score in scores:
        whole = compare_methods(table, score, reference)
        groups += whole
        if by and whole:
            groups += compare_methods(table, score, whole[0].reference, by)
    return "\n\n".join(map(str, groups)) or "No cells: there is nothing to compare."


def methods_in(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the names of the methods in alphabetical order."""
    return tuple(sorted({str(name) for name in table["method"]}))


def value_words(value: Any) -> str:
    """Return the value of an axis: a number, a text or None."""
    if value is None:
        return "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _winner(cells: Cells, score: Score) -> str:
    """Return the method with the smallest mean loss over the cells that all in the running share.

    A method that could score less than half of what another could is not in the running, else one
    that fails nearly everywhere would leave next to no cells to choose by.
    """
    counts = cells.scored.sum(axis=0)
    running = np.flatnonzero(counts >= max(1.0, RUNNING_SHARE * counts.max()))
    shared = cells.scored[:, running].all(axis=1)
    if not running.size or not shared.any():
        return cells.methods[int(np.argmax(counts))]
    values = cells.values[np.ix_(shared, running)]
    if score.better == "target":
        lost = np.abs(values.mean(axis=0) - score.target)
    else:
        lost = losses(score, values).mean(axis=0)
    return cells.methods[int(running[np.argmin(lost)])]


def _compared(
    cells: Cells, score: Score, reference: str, where: tuple[tuple[str, Any], ...]
) -> GroupComparison:
    n = len(cells.methods)
    r = cells.methods.index(reference) if reference in cells.methods else None
    against = [Paired() if r is None else paired(cells, score, j, r) for j in range(n)]
    ranks = _ranks(against, float(np.max(np.nan_to_num(np.abs(losses(score, cells.values))))))
    best = ranks.index(1) if 1 in ranks else None
    rows = [
        MethodRow(
            cells.methods[j],
            int(cells.ran[:, j].sum()),
            int(cells.failed[:, j].sum()),
            int(cells.scored[:, j].sum()),
            *_levels(cells, score, j),
            against[j],
            Paired() if best is None else paired(cells, score, j, best),
            ranks[j],
            "; ".join(_doubts(cells, j, against[j])),
        )
        for j in range(n)
    ]
    rows.sort(key=lambda row: (row.rank is None, row.rank or 0, row.method))
    name = "" if best is None else cells.methods[best]
    return GroupComparison(score, where, reference, name, tuple(rows))


def _levels(cells: Cells, score: Score, j: int) -> tuple[float, float, float, float, float]:
    """Return mean and loss, each with its error, and median of a method's own cells."""
    kept = cells.scored[:, j]
    values, record = cells.values[kept, j], cells.record[kept]
    if not values.size:
        return math.nan, math.nan, math.nan, math.nan, math.nan
    mean, error = jackknife(values, record)
    median = float(np.median(np.abs(values) if score.better == "zero" else values))
    if score.better == "target":
        return mean, error, abs(mean - score.target), error, median
    return mean, error, *jackknife(losses(score, values), record), median


def _ranks(against: list[Paired], size: float) -> list[int | None]:
    fullest = max((pair.n_pairs for pair in against), default=0)
    ranks: list[int | None] = [None] * len(against)
    known = [
        j
        for j, pair in enumerate(against)
        if math.isfinite(pair.difference) and pair.n_pairs >= RUNNING_SHARE * fullest
    ]
    differences = np.array([against[j].difference for j in known]) / (size or 1.0)
    for j, rank in zip(known, rankdata(np.round(differences, DIGITS), "min"), strict=True):
        ranks[j] = int(rank)
    return ranks


def _doubts(cells: Cells, j: int, pair: Paired) -> list[str]:
    """Return why not to trust the row of a method."""
    ran, lost = int(cells.ran[:, j].sum()), int((cells.ran & ~cells.scored)[:, j].sum())
    doubts = []
    if lost:
        doubts.append(f"no score on {lost} of its {ran} cells: survivors only")
    if pair.n_records < FEWEST_RECORDS:
        doubts.append(f"independent records: {pair.n_records}, fewer than {FEWEST_RECORDS}")
    if cells.bad[:, j].any():
        doubts.append(f"{int(cells.bad[:, j].sum())} of its {ran} cells ended badly")
    return doubts
