"""Methods of a study side by side: paired over what they share, with errors over records.

Two methods are compared on cells that differ in nothing but the method, so that what makes a
record hard is hard for both and falls out of the difference. Cells of one record are not
independent: errors are a jackknife that leaves out one whole record at a time (Tukey 1958; for
clusters of unequal size as in Bell & McCaffrey, Survey Methodology 28, 2002).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import rankdata
from scipy.stats import t as student_t

from comparisons.study.scores import SCORES, Score
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.errors import InputError
from surge_core.rounding import round_like, round_to_error
from surge_core.types import FloatArray, IntArray

# States of a cell: no numbers at all, and a fit that ended well; any other ended badly.
FAILED, ENDED_WELL = "failed", ("ok", "converged")
# Below so many records neither an error nor its normal approximation is to be relied on.
FEWEST_RECORDS = 5
# What a difference must exceed to matter: a share of the reference's loss, or of a coverage.
MARGIN, COVERAGE_MARGIN = 0.10, 0.05
# Of all verdicts of a group together.
LEVEL = 0.05
# A method with fewer than this share of the cells of the fullest one is not ranked.
RUNNING_SHARE = 0.5
# Differences that agree to so many digits of the greatest loss share a rank, and an error smaller
# than that is none.
DIGITS = 12
# Heads of a table of methods, and what they say.
COLUMNS = {
    "#": "rank by the difference to the reference",
    "method": "name in the study",
    "cells": "cells that it was run on",
    "failed": "of them failed",
    "mean": "over its own cells",
    "loss": "mean over its own cells: of the absolute value, where zero is best",
    "pairs": "cells shared with the reference",
    "records": "independent records that the pairs come from",
    "Δ to reference": "paired difference of the mean loss ± standard error over records; positive "
    "is worse",
    "verdict": "better or worse than the reference: the difference is not zero (5 % over all rows, "
    "Holm); equivalent: it lies within the margin (two one-sided tests at 5 %); else undecided",
    "trust": "why not to trust it",
}


@dataclass(frozen=True)
class MethodRow:
    """One method in a group of cells.

    Parameters
    ----------
    method : str
        Its name.
    n_cells, n_failed : int
        Cells it was run on, and of them failed.
    mean, mean_stderr : float
        Mean of the score over its own cells (the bias, for an error that should be zero), and its
        standard error clustered by record.
    loss, loss_stderr : float
        Mean loss over its own cells and its standard error: the mean for "smaller", its negative
        for "larger", the mean absolute value for "zero", the distance of the mean for "target".
    n_pairs, n_records : int
        Cells that it and the reference could score, and the independent records they come from.
    difference, stderr : float
        Mean loss minus that of the reference over the pairs, and its standard error clustered by
        record, in the unit of the score; the error is NaN with one record, both are without a pair.
    trust : str
        Why not to trust this row; may be empty.
    rank : int or None
        By the difference to the reference; equal ones share a rank.
    verdict : {"better", "worse", "equivalent", "undecided", ""}
        Against the reference; empty for itself and where there is no pair.
    """

    method: str
    n_cells: int
    n_failed: int
    mean: float
    mean_stderr: float
    loss: float
    loss_stderr: float
    n_pairs: int
    n_records: int
    difference: float
    stderr: float
    trust: str
    rank: int | None = None
    verdict: str = ""


@dataclass(frozen=True)
class GroupComparison(Displayed):
    """Methods side by side over the cells of one group.

    Parameters
    ----------
    score : Score
        What is compared.
    place : str
        Axes and their values in words; "all cells" for all together.
    reference, best : str
        Method that the others are compared with; the first by rank, or empty.
    rows : tuple of MethodRow
        By rank, those without one last.
    """

    score: Score
    place: str
    reference: str
    best: str
    rows: tuple[MethodRow, ...]

    def row(self, method: str) -> MethodRow:
        """Return the row of a method."""
        return next(row for row in self.rows if row.method == method)

    @property
    def caption(self) -> str:
        """What is compared, in which unit, over what and with which method."""
        unit = f" [{self.score.unit}]" if self.score.unit else ""
        return f"{self.score.label}{unit}, {self.place}, against {self.reference}"

    def lead(self) -> str:
        """Return in one sentence which method is best and how far each is from the reference."""
        label, unit = self.score.loss_label, self.score.unit
        if not self.best:
            return f"{self.place}: {self.reference}, the reference, has no value of {label}."
        best = self.row(self.best)
        loss = f"{round_like(best.loss, best.loss_stderr)} {unit}".rstrip()
        others = [
            f"{row.method} {self._difference(row)} {unit}".rstrip()
            + (f" ({row.verdict})" if row.verdict else "")
            for row in self.rows
            if row.method != self.reference
        ]
        words = f"{self.place}: {best.method} is best by {label}, {loss}"
        if others:
            words += f"; against {self.reference}: {', '.join(others)}"
        return f"{words}; paired over {best.n_records} records."

    def grid(self) -> Grid:
        """Return the table of methods, under the heads of `COLUMNS`."""
        rows = tuple(
            (
                str(row.rank or "–"),
                row.method,
                str(row.n_cells),
                str(row.n_failed),
                round_like(row.mean, row.mean_stderr),
                round_like(row.loss, row.loss_stderr),
                str(row.n_pairs),
                str(row.n_records),
                self._difference(row),
                row.verdict,
                row.trust,
            )
            for row in self.rows
        )
        words = frozenset([1, len(COLUMNS) - 2, len(COLUMNS) - 1])
        marks = ("best",) if self.best else ()
        return Grid(self.caption, tuple(COLUMNS), rows, words, marks, COLUMNS)

    def _difference(self, row: MethodRow) -> str:
        if row.method == self.reference:
            return "reference"
        return round_to_error(row.difference, row.stderr)

    def _sheet(self) -> Sheet:
        grid = self.grid()
        shown = replace(grid, header=grid.header[:-1], rows=tuple(row[:-1] for row in grid.rows))
        fields = [Field("in short", self.lead())]
        if cautions := tuple(f"{row.method}: {row.trust}" for row in self.rows if row.trust):
            fields.append(Field("caution", cautions, "advice"))
        return Sheet(f"Methods by {self.score.loss_label}", tuple(fields), (shown,))


def compare_methods(
    table: pd.DataFrame,
    score: Score | str,
    reference: str | None = None,
    by: Sequence[str] = (),
    margin: float = MARGIN,
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
        Axes; each combination of their values is a further group.
    margin : float
        Share of the reference's loss within which a difference does not matter.

    Returns
    -------
    tuple of GroupComparison
        Over all cells, then of each group in the order of the axes' values.

    Raises
    ------
    InputError
        When the reference is no method.
    """
    chosen = SCORES[score] if isinstance(score, str) else score
    cells = _numbered(table, chosen)
    names = sorted(set(cells["method"]))
    if reference is not None and reference not in names:
        raise InputError("reference", expected="one of " + ", ".join(names), found=repr(reference))
    against = reference or _winner(cells, chosen)
    others = len(names) - 1
    # A reference chosen by the same data stands for a comparison of all pairs.
    tests = others if reference else math.comb(len(names), 2)
    groups = cells.groupby(list(by), dropna=False) if by else ()
    return (
        _compared(cells, chosen, against, "all cells", margin, tests),
        *(
            _compared(part, chosen, against, ", ".join(map(_value_words, by, at)), margin, others)
            for at, part in groups
        ),
    )


def jackknife(
    values: FloatArray, record: ArrayLike, target: float | None = None
) -> tuple[float, float]:
    """Return the mean of values (n,) and its standard error over records, each left out once.

    With a target the values have two columns, and it is how much further the mean of the first lies
    from the target than that of the second. The error is NaN with one record, both are without a
    value.
    """
    if not values.size:
        return math.nan, math.nan
    _, cluster, counts = np.unique(record, return_inverse=True, return_counts=True)
    columns = values.reshape(values.shape[0], -1)
    sums = np.stack([np.bincount(cluster, weights=column) for column in columns.T], axis=1)

    def measured(total: FloatArray, count: IntArray) -> FloatArray:
        means = total / count[..., None]
        if target is None:
            return means[..., 0]
        return np.abs(means[..., 0] - target) - np.abs(means[..., 1] - target)

    whole = float(measured(sums.sum(axis=0), counts.sum()))
    if counts.size < 2:
        return whole, math.nan
    # About the whole's value rather than the mean of the parts: a little wider, never smaller.
    spread = measured(sums.sum(axis=0) - sums, counts.sum() - counts) - whole
    error = math.sqrt((counts.size - 1) / counts.size * float(np.sum(spread**2)))
    size = float(np.max(np.abs(columns), initial=0.0))
    return whole, error if error > 10.0**-DIGITS * size else 0.0


def _numbered(table: pd.DataFrame, score: Score) -> pd.DataFrame:
    """Return the results with the score, and numbers of what methods share and of the record."""
    values = pd.to_numeric(table[score.name], errors="coerce").astype(float)
    # A failed cell has no score, nor has a simulation that ran off to infinity.
    values = values.where((table["state"] != FAILED) & np.isfinite(values))
    # The varied axes are the columns with a dot in their names.
    axes = [str(name) for name in table.columns if "." in str(name)]
    # Errors on filtered rows and on unfiltered ones are no pair.
    if score.name.startswith(("free_run", "one_step", "held_out")) and "scored" in table.columns:
        axes.append("scored")
    shared = table.groupby(["record", "reduction", *axes], dropna=False).ngroup()
    # Records that were drawn together (one seed at several settings) are not independent.
    draw = table["draw" if "draw" in table.columns else "record"]
    cells = table.assign(_value=values, _cell=shared, _draw=pd.factorize(draw)[0])
    return cells.sort_values(["_cell", "method"])


def _winner(cells: pd.DataFrame, score: Score) -> str:
    """Return the method with the smallest mean loss over the cells that all in the running share.

    A method that could score less than half of what another could is not in the running, else one
    that fails nearly everywhere would leave next to no cells to choose by.
    """
    counts = cells.groupby("method")["_value"].count()
    running = counts.index[counts >= max(1.0, RUNNING_SHARE * counts.max())]
    values = cells.pivot(index="_cell", columns="method", values="_value")[running].dropna()
    if values.empty:
        return str(counts.idxmax())
    if score.better == "target":
        return str((values.mean() - score.target).abs().idxmin())
    return str(score.losses(values).mean().idxmin())


def _compared(
    cells: pd.DataFrame, score: Score, reference: str, place: str, margin: float, tests: int
) -> GroupComparison:
    wide = cells.pivot(index="_cell", columns="method", values="_value")
    draw = cells.groupby("_cell")["_draw"].first()
    rows = [_row(part, wide, draw, score, reference) for _, part in cells.groupby("method")]
    level = next((row.loss for row in rows if row.method == reference), math.nan)
    reach = COVERAGE_MARGIN if score.better == "target" else margin * abs(level)
    verdicts = _verdicts([row for row in rows if row.method != reference], reach, tests)
    ranks = _ranks(rows, float(score.losses(wide).abs().max().max()))
    rows = [replace(r, rank=ranks.get(r.method), verdict=verdicts.get(r.method, "")) for r in rows]
    rows.sort(key=lambda row: (row.rank is None, row.rank or 0, row.method))
    best = rows[0].method if rows[0].rank else ""
    return GroupComparison(score, place, reference, best, tuple(rows))


def _row(
    part: pd.DataFrame, wide: pd.DataFrame, draw: pd.Series[int], score: Score, reference: str
) -> MethodRow:
    """Return a method on its own cells, and against the reference over what both could score."""
    name = str(part["method"].iloc[0])
    values = wide[name].dropna()
    records = draw[values.index]
    mean, error = jackknife(values.to_numpy(), records)
    loss = (abs(mean - score.target), error)
    if score.better != "target":
        loss = jackknife(score.losses(values).to_numpy(), records)
    both = wide.reindex(columns=[name, reference]).dropna()
    shared = draw[both.index]
    if score.better == "target":
        # Of a single cell the distance to a share means nothing: only of the mean of many.
        apart = jackknife(both.to_numpy(), shared, score.target)
    else:
        own, other = score.losses(both).to_numpy().T
        apart = jackknife(own - other, shared)
    failed = int((part["state"] == FAILED).sum())
    pairs = (len(both), np.unique(shared).size)
    doubts = "; ".join(_doubts(part, *pairs))
    return MethodRow(name, len(part), failed, mean, error, *loss, *pairs, *apart, doubts)


def _ranks(rows: Sequence[MethodRow], size: float) -> dict[str, int]:
    fullest = max(row.n_pairs for row in rows)
    known = {
        row.method: row.difference / (size or 1.0)
        for row in rows
        if math.isfinite(row.difference) and row.n_pairs >= RUNNING_SHARE * fullest
    }
    ranks = rankdata(np.round(list(known.values()), DIGITS), "min").tolist()
    return {name: int(rank) for name, rank in zip(known, ranks, strict=True)}


def _verdicts(rows: Sequence[MethodRow], margin: float, tests: int) -> dict[str, str]:
    """Return what the paired differences of methods to a reference say, out of so many tests.

    "better" and "worse" are two-sided tests by Student's t over records, at 5 % over all together
    (Holm, Scandinavian Journal of Statistics 6, 1979); "equivalent", with half the width of what
    counts as equal, is two one-sided tests at 5 % each (Schuirmann, Journal of Pharmacokinetics and
    Biopharmaceutics 15, 1987), and goes first.
    """
    found = {row.method: "undecided" for row in rows if row.n_pairs}
    known = [row for row in rows if row.n_records > 1 and math.isfinite(row.stderr)]
    left, rejecting = max(tests, len(known)), True
    for row in sorted(known, key=lambda row: _two_sided(row.difference, row)):
        rejecting = rejecting and _two_sided(row.difference, row) * left <= LEVEL
        left -= 1
        room = margin - abs(row.difference)
        if room > 0.0 and 0.5 * _two_sided(room, row) <= LEVEL:
            found[row.method] = "equivalent"
        elif rejecting:
            found[row.method] = "worse" if row.difference > 0.0 else "better"
    return found


def _two_sided(difference: float, row: MethodRow) -> float:
    """Return the p-value that a difference with the error of a row is none."""
    if row.stderr == 0.0:
        return 1.0 if difference == 0.0 else 0.0
    return float(2.0 * student_t.sf(abs(difference) / row.stderr, row.n_records - 1))


def _doubts(part: pd.DataFrame, n_pairs: int, n_records: int) -> list[str]:
    """Return why not to trust the row of a method."""
    ran, lost = len(part), int(part["_value"].isna().sum())
    bad = int((~part["state"].isin([FAILED, *ENDED_WELL])).sum())
    doubts = []
    if lost < ran and not n_pairs:
        doubts.append("scored on other rows than the reference")
    if lost:
        doubts.append(f"no score on {lost} of its {ran} cells" + ": survivors only" * (lost < ran))
    if n_records < FEWEST_RECORDS:
        doubts.append(f"independent records: {n_records}, fewer than {FEWEST_RECORDS}")
    if bad:
        doubts.append(f"{bad} of its {ran} cells ended badly")
    return doubts


def _value_words(name: str, value: Any) -> str:
    """Return an axis and its value: a number, a text or none."""
    if isinstance(value, float):
        return f"{name} = none" if math.isnan(value) else f"{name} = {value:.6g}"
    return f"{name} = {'none' if value is None else value}"
