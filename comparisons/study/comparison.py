"""Methods of a study side by side: paired over what they share, with errors over records.

Two methods are compared on cells that differ in nothing but the method, so that what makes a
record hard is hard for both and falls out of the difference; see `paired`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comparisons.study.method_table import LEVEL, GroupComparison, MethodRow
from comparisons.study.paired import (
    SAME,
    Cells,
    Paired,
    group_cells,
    jackknife,
    losses,
    paired,
)
from comparisons.study.scores import SCORES, Score
from surge_core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["compare_methods", "methods_in", "score_named", "study_text"]

# Below so many records neither an error nor its normal approximation is to be relied on.
FEWEST_RECORDS = 5
# A method with fewer than this share of the cells of the fullest one is not ranked.
RUNNING_SHARE = 0.5


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
        whole = groups[0][1] if not by else group_cells(table, chosen, ())[0][1]
        reference = _winner(whole, chosen)
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
    blocks = []
    for score in map(score_named, scores):
        groups = compare_methods(table, score, reference)
        if by and groups:
            groups += compare_methods(table, score, groups[0].reference, by)
        blocks += [str(group) for group in groups]
    return "\n\n".join(blocks) or "No cells: there is nothing to compare."


def methods_in(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the names of the methods in alphabetical order."""
    return tuple(sorted({str(name) for name in table["method"]}))


def score_named(score: Score | str) -> Score:
    """Return a score by its name, or as it is.

    Parameters
    ----------
    score : Score or str
        A score, or its name in `SCORES`.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if isinstance(score, Score):
        return score
    if score not in SCORES:
        raise InputError("score", expected="one of " + ", ".join(SCORES), found=repr(score))
    return SCORES[score]


def _winner(cells: Cells, score: Score) -> str:
    """Return the method with the smallest mean loss over the cells that all in the running share.

    A method that could score less than half of what another could is not in the running, else one
    that fails nearly everywhere would leave next to no cells to choose by.
    """
    counts = cells.scored.sum(axis=0)
    enough = counts >= max(1.0, RUNNING_SHARE * counts.max())
    running = [j for j in np.lexsort((np.arange(counts.size), -counts)) if enough[j]]
    if not running:
        return cells.methods[0]
    shared, kept = np.ones(cells.record.size, bool), []
    for j in running:
        if np.any(shared & cells.scored[:, j]):
            shared &= cells.scored[:, j]
            kept.append(int(j))
    lost = losses(score, cells.values[shared])

    def merit(j: int) -> tuple[float, float, str]:
        if score.better == "target":
            mean = abs(float(np.mean(cells.values[shared, j])) - score.target)
        else:
            mean = float(np.mean(lost[:, j]))
        return mean, float(np.median(lost[:, j])), cells.methods[j]

    return cells.methods[min(kept, key=merit)]


def _compared(
    cells: Cells, score: Score, reference: str, where: tuple[tuple[str, Any], ...]
) -> GroupComparison:
    n = len(cells.methods)
    r = cells.methods.index(reference) if reference in cells.methods else None
    against = [Paired() if r is None else paired(cells, score, j, r) for j in range(n)]
    ranks = _ranks(against, float(np.max(np.nan_to_num(np.abs(losses(score, cells.values))))))
    ranked = [j for j in range(n) if ranks[j] == 1]
    best = ranked[0] if ranked else None
    to_best = [Paired() if best is None else paired(cells, score, j, best) for j in range(n)]
    rows = [
        MethodRow(
            cells.methods[j],
            int(cells.ran[:, j].sum()),
            int(cells.failed[:, j].sum()),
            int(cells.scored[:, j].sum()),
            *_levels(cells, score, j),
            against[j],
            to_best[j],
            ranks[j],
            _standing(ranks[j], j == best, to_best[j]),
            "; ".join(_doubts(cells, j, r, reference, against[j], ranks[j])),
        )
        for j in range(n)
    ]
    rows.sort(key=lambda row: (row.rank is None, row.rank or 0, row.standing != "best", row.method))
    name = "" if best is None else cells.methods[best]
    return GroupComparison(score, where, reference, name, tuple(rows))


def _levels(cells: Cells, score: Score, j: int) -> tuple[float, float, float, float, float, float]:
    """Return mean, loss, each with its error, median and rms of a method's own cells."""
    kept = cells.scored[:, j]
    values = cells.values[kept, j]
    if not values.size:
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    zero = score.better == "zero"
    median = float(np.median(np.abs(values) if zero else values))
    rms = math.sqrt(float(np.mean(values**2))) if zero else math.nan
    mean, error = jackknife(values, cells.record[kept])
    if score.better == "target":
        return mean, error, abs(mean - score.target), error, median, rms
    loss = jackknife(losses(score, values), cells.record[kept])
    return mean, error, *loss, median, rms


def _ranks(against: list[Paired], size: float) -> list[int | None]:
    fullest = max((pair.n_pairs for pair in against), default=0)
    known = [
        j
        for j, pair in enumerate(against)
        if math.isfinite(pair.difference) and pair.n_pairs >= RUNNING_SHARE * fullest
    ]
    ranks: list[int | None] = [None] * len(against)
    previous: int | None = None
    for place, j in enumerate(sorted(known, key=lambda k: against[k].difference), start=1):
        tied = (
            previous is not None
            and against[j].difference - against[previous].difference <= SAME * size
        )
        ranks[j] = ranks[previous] if tied and previous is not None else place
        previous = j
    return ranks


def _standing(rank: int | None, is_best: bool, to_best: Paired) -> str:
    if rank is None:
        return "not ranked"
    if is_best:
        return "best"
    if rank == 1:
        return LEVEL
    if not math.isfinite(to_best.stderr):
        return "error not known"
    return LEVEL if to_best.difference <= to_best.reach else "worse"


def _doubts(
    cells: Cells, j: int, r: int | None, reference: str, pair: Paired, rank: int | None
) -> list[str]:
    """Return why not to trust the row of a method."""
    scored = cells.scored[:, j]
    if not scored.any():
        failed = int(cells.failed[:, j].sum())
        return [f"no score on any of its {_cells(cells.ran[:, j])}, {failed} of them failed"]
    if pair.n_pairs == 0:
        return [f"shares no scored cell with the reference {reference}: not compared"]
    doubts = []
    if pair.n_records < 2:
        doubts.append("one record alone: the error of the difference is not known")
    if pair.n_records < FEWEST_RECORDS:
        doubts.append(
            f"{pair.n_records} independent record{'s' * (pair.n_records > 1)}, fewer "
            f"than {FEWEST_RECORDS}"
        )
    doubts += _unlike(cells, j, r)
    if cells.bad[:, j].any():
        doubts.append(
            f"{int(cells.bad[:, j].sum())} of its {_cells(cells.ran[:, j])} ended badly, as their "
            "states say: their numbers are not to be used"
        )
    if rank is None:
        doubts.append("too few pairs to be ranked")
    if pair.n_records > 1 and pair.stderr == 0.0 and j != r and pair.difference != 0.0:
        doubts.append("all records differ alike: the error of the difference is not known")
    return doubts


def _unlike(cells: Cells, j: int, r: int | None) -> list[str]:
    """Return on which cells one of the two has no score."""
    scored, ran = cells.scored[:, j], cells.ran[:, j]
    if r is None or j == r:
        lost = int((ran & ~scored).sum())
        return [f"no score on {lost} of its {_cells(ran)}: survivors only"] if lost else []
    other = cells.scored[:, r]
    cases = (
        (ran & ~scored & other, "no score on {} that the reference could score: survivors only"),
        (
            scored & cells.ran[:, r] & ~other,
            "the reference has no score on {} that this method could score",
        ),
        (~ran & other, "not run on {} of the reference"),
    )
    return [words.format(_cells(which)) for which, words in cases if which.any()]


def _cells(which: NDArray[np.bool_]) -> str:
    count = int(which.sum())
    return "1 cell" if count == 1 else f"{count} cells"
