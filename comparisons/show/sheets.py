"""What is shown of comparisons, models, diagnoses and studies in a notebook."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from surge_core.display import Field, Grid, Sheet
from surge_core.rounding import round_to_error

if TYPE_CHECKING:
    from comparisons.harness.compare import Comparison
    from comparisons.harness.lag_value import FittedLag
    from comparisons.harness.structure_fit import FoundStructure
    from comparisons.study.comparison import GroupComparison, PairwiseDifferences

__all__ = [
    "comparison_sheet",
    "lag_value_sheet",
    "methods_sheet",
    "pairwise_sheet",
    "structure_html",
]

SYMBOLS = {"psi_p": "ψ'", "psi": "ψ"}


def comparison_sheet(comparison: Comparison) -> Sheet:
    """Return what is shown of a comparison: the table of the terminal.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    from comparisons.harness.cautions import grouped_cautions
    from comparisons.show.table import FIELDS, comparison_cells

    rows = comparison.rows
    low, high = comparison.valid_phi
    cautions = tuple(grouped_cautions(comparison.cautions))
    fields = (
        Field("records", tuple(PurePath(record.source).name for record in comparison.records)),
        Field(
            "rows",
            f"{rows.phi.size} in {rows.n_segments} segments, {1 / rows.sample_period_s:g} Hz",
        ),
        Field("φ dwells", f"{low:.3f} to {high:.3f} (5th to 95th percentile)"),
        *((Field("cautions", cautions, "advice"),) if cautions else ()),
    )
    grid = Grid(
        f"Estimators of {SYMBOLS[rows.target]}, best first",
        tuple(field.heading for field in FIELDS),
        tuple(map(tuple, comparison_cells(comparison))),
        frozenset(i for i, field in enumerate(FIELDS) if not field.numeric),
        marked=0,
    )
    return Sheet(f"Comparison of {len(comparison.results)} estimators", fields, (grid,))


def lag_value_sheet(model: FittedLag) -> Sheet:
    """Return what is shown of a fitted lag model.

    Parameters
    ----------
    model : FittedLag
        The model.
    """
    low, high = (1e3 * end for end in model.ci95_s)
    interval: tuple[Field, ...] = ()
    if math.isfinite(low) and math.isfinite(high):
        interval = (Field("τ, 95 % interval", f"{low:.3g} to {high:.3g} ms"),)
    dead = (Field("dead time", f"{1e3 * model.dead_time_s:.3g} ms"),) if model.dead_time_s else ()
    return Sheet(
        f"Lag model of {SYMBOLS[model.target]} by {model.estimator}",
        (
            Field("time constant τ", _tau(model.time_constant_s, model.time_constant_stderr_s)),
            *interval,
            *dead,
            Field("hold", model.hold),
            Field("φ dwells", f"{model.valid_phi[0]:.3f} to {model.valid_phi[1]:.3f}"),
        ),
        (_terms(model.terms, model.coefficients, model.stderr),),
    )


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


def structure_html(found: FoundStructure) -> str:
    """Return what is shown of a structure, or why there is none.

    Parameters
    ----------
    found : FoundStructure
        The structure.
    """
    if found.refused:
        code, advice = found.state
        return Sheet("No structure", (Field("state", f"{code}: {advice}", "advice"),)).html()
    from sindy_surge.display import html_summary

    return html_summary(found.summary)


def _terms(terms: tuple[str, ...], values: tuple[float, ...], errors: tuple[float, ...]) -> Grid:
    rows = tuple(
        (name, round_to_error(value, error))
        for name, value, error in zip(terms, values, errors, strict=True)
    )
    return Grid("Quasi-steady characteristic", ("term", "coefficient ± std error"), rows)


def _tau(value_s: float, stderr_s: float) -> str:
    known = np.isfinite(value_s)
    return f"{round_to_error(1e3 * value_s, 1e3 * stderr_s)} ms" if known else "not known"
