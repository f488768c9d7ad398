"""What is shown of the methods of a study in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from surge_core.display import Field, Grid, Sheet
from surge_core.rounding import round_to_error

if TYPE_CHECKING:
    from comparisons.study.comparison import GroupComparison, PairwiseDifferences

__all__ = ["methods_sheet", "pairwise_sheet"]


def methods_sheet(group: GroupComparison) -> Sheet:
    """Return what is shown of methods side by side.

    Parameters
    ----------
    group : GroupComparison
        Of one score.
    """
    from comparisons.study.words import fields_of, lead_sentence, where_words

    fields = fields_of(group.score)
    methods = [row.method for row in group.rows]
    unit = f" [{group.score.unit}]" if group.score.unit else ""
    grid = Grid(
        f"{group.score.label}{unit}, {where_words(group.where)}, against {group.reference}",
        tuple(field.heading for field in fields),
        tuple(tuple(field.text(row, group) for field in fields) for row in group.rows),
        frozenset(i for i, field in enumerate(fields) if not field.numeric),
        marked=methods.index(group.best) if group.best in methods else None,
    )
    return Sheet("Methods of a study", (Field("in short", lead_sentence(group)),), (grid,))


def pairwise_sheet(matrix: PairwiseDifferences) -> Sheet:
    """Return what is shown of every method against every other.

    Parameters
    ----------
    matrix : PairwiseDifferences
        Differences of mean losses.
    """
    from comparisons.study.words import loss_label

    rows = tuple(
        (
            name,
            *(
                "" if i == j else round_to_error(pair.difference, pair.stderr)
                for j, pair in enumerate(matrix.pairs[i])
            ),
        )
        for i, name in enumerate(matrix.methods)
    )
    unit = f" [{matrix.score.unit}]" if matrix.score.unit else ""
    grid = Grid("Worse by … than", ("method", *matrix.methods), rows)
    told = f"{loss_label(matrix.score)}{unit}: the row's method minus the column's"
    return Sheet("Every method against every other", (Field("difference", told),), (grid,))
