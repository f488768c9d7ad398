"""Pictures of a study: differences to the reference, and losses over an axis.

Each comes with the sentence that says in numbers what it shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.page.blocks import Picture
from comparisons.page.style import (
    INK,
    LineStyle,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    printable,
)
from comparisons.study.comparison import compare_methods, methods_in, score_named
from comparisons.study.method_table import GroupComparison, loss_label, value_words
from comparisons.study.scores import Score
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from surge_core.types import FloatArray

__all__ = ["draw_differences", "draw_over_axis"]

MARKERS = "osD^vP<X>ph"
# Panels beside each other, and values of an axis; tables hold all.
MOST_PANELS, MOST_VALUES, BINS = 4, 24, 8
LONGEST_NAME = 26
# Losses further apart than this are drawn on a logarithmic axis.
LOGARITHMIC_RATIO = 30.0
# Share of the distance between two categories over which the methods' dots are spread.
SPREAD = 0.5


def draw_differences(groups: Sequence[GroupComparison], methods: Sequence[str]) -> Picture:
    """Draw the paired difference of each method to the reference, a panel a group.

    Parameters
    ----------
    groups : sequence of GroupComparison
        Of one score, at least one; the first few are drawn.
    methods : sequence of str
        Names of all methods of the study.

    Returns
    -------
    Picture
        Dots with two standard errors to each side.
    """
    drawn = groups[:MOST_PANELS]
    score, reference = groups[0].score, groups[0].reference
    # By rank over all cells, so that the picture reads as the table does.
    ranked = dict.fromkeys(row.method for group in drawn for row in group.rows)
    shown = [name for name in ranked if name != reference]
    styles = _styles(methods)
    figure = new_figure(height_in=1.5 + 0.42 * max(len(shown), 2))
    panels = figure.subplots(1, len(drawn), sharey=True, squeeze=False)[0]
    sentences = []
    for ax, group in zip(panels, drawn, strict=True):
        dress(ax)
        ax.axvline(0.0, color=INK, lw=1.0)
        differences = []
        for row in group.rows:
            pair = row.against
            if row.method != reference and math.isfinite(pair.difference):
                place = shown.index(row.method)
                _dot(ax, styles[row.method], pair.difference, place, xerr=_twice(pair.stderr))
                known = round_to_error(pair.difference, pair.stderr)
                differences.append(f"{row.method} {known} {score.unit}".strip())
        ax.set_title(printable(group.place, 40), fontsize=9, loc="left")
        sentences.append(f"{group.place}: {', '.join(differences) or 'no other method'}.")
    panels[0].set_yticks(range(len(shown)), [printable(name, LONGEST_NAME) for name in shown])
    panels[0].set_ylim(len(shown) - 0.5 if shown else 0.5, -0.5)
    label = f"worse than {reference} in {loss_label(score)}"
    figure.supxlabel(printable(f"{label} [{score.unit or '1'}]", 100), fontsize=9)
    cut = "" if len(groups) == len(drawn) else f" The first {len(drawn)} of {len(groups)} groups."
    return Picture(
        f"Paired differences to {reference}",
        figure,
        f"Paired difference of {loss_label(score)} to {reference}. {' '.join(sentences)}{cut}",
        "Right of the line: worse than the reference on the same cells. Bars are ± 2 standard "
        "errors over records; a dot without bars has an error that is not known, a method without "
        f"a dot has no mean difference.{cut}",
    )


def draw_over_axis(
    table: pd.DataFrame, score: Score | str, axis: str, reference: str | None = None
) -> Picture:
    """Draw the mean of the score of each method over a varied axis.

    Parameters
    ----------
    table : DataFrame
        Results, one row a cell.
    score : Score or str
        What is compared.
    axis : str
        Column of the axis: lines over numbers, grouped dots over anything else.
    reference : str, optional
        Method that the others are compared with; the best without it.

    Returns
    -------
    Picture
        The reference at its own mean, the others at that mean plus their paired difference.

    Notes
    -----
    A method that fails where records are hard would look better by its own mean than it is; its
    difference on the cells that it shares with the reference does not.
    """
    import pandas as pd

    chosen = score_named(score)
    if table[axis].nunique() > MOST_VALUES and table[axis].dtype.kind == "f":
        # Of a random design no two points share a value: bins of equal counts, at their medians.
        bins = pd.qcut(table[axis], BINS, duplicates="drop")
        table = table.assign(**{axis: table.groupby(bins, observed=True)[axis].transform("median")})
    every = compare_methods(table, chosen, reference, (axis,))
    groups = every[:MOST_VALUES]
    values = [group.where[0][1] for group in groups]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    methods = methods_in(table)
    styles = _styles(methods)
    figure = new_figure(height_in=4.4)
    ax = dress(figure.add_subplot())
    sentences, means = [], []
    for k, name in enumerate(methods):
        shift = 0.0 if numeric else SPREAD * ((k + 0.5) / len(methods) - 0.5)
        xs, ys = [], []
        for i, group in enumerate(groups):
            mean, error = _mean_of(group, name)
            if math.isfinite(mean):
                xs.append(values[i] if numeric else i + shift)
                ys.append(mean)
                _dot(ax, styles[name], xs[-1], mean, yerr=_twice(error))
        style, marker = styles[name]
        ls = style.dashes if numeric else "none"
        label = printable(name, LONGEST_NAME)
        ax.plot(xs, ys, color=style.colour, ls=ls, marker=marker, ms=6, lw=1.4, label=label)
        means += ys
        known = [significant(_mean_of(group, name)[0], 3) for group in groups]
        said = zip(known, values, strict=True)
        sentences.append(f"{name} {', '.join(f'{m} at {value_words(v)}' for m, v in said)}")
    if not numeric:
        labels = [printable(value_words(value), 20) for value in values]
        ax.set_xticks(range(len(values)), labels, rotation=30 if len(labels) > 6 else 0)
    elif _wide(values):
        ax.set_xscale("log")
    if _wide(means):
        ax.set_yscale("log")
    ax.set_xlabel(printable(axis), fontsize=9)
    ax.set_ylabel(printable(f"mean {_with_unit(chosen)}", 90), fontsize=9)
    legend_above(figure, ax, columns=4)
    base = groups[0].reference
    cut = f" The first {len(groups)} of {len(every)} values." if len(every) > len(groups) else ""
    return Picture(
        f"{_with_unit(chosen)} over {axis}",
        figure,
        f"Mean {_with_unit(chosen)} over {axis}: {'; '.join(sentences)}.{cut}",
        f"Bars are ± 2 standard errors of the paired difference to {base}, which has none itself; "
        f"each method stands at the mean of {base} plus that difference. "
        f"{'Higher' if chosen.better == 'larger' else 'Lower'} is better.{cut}",
    )


def _styles(methods: Sequence[str]) -> dict[str, tuple[LineStyle, str]]:
    """Return line style and marker of each method, the same in all pictures of a study."""
    ordered = sorted(methods)
    styles = estimator_styles(ordered)
    return {name: (styles[name], MARKERS[i % len(MARKERS)]) for i, name in enumerate(ordered)}


def _mean_of(group: GroupComparison, name: str) -> tuple[float, float]:
    """Return where a method stands in a group: the reference's mean plus the difference."""
    rows = {row.method: row for row in group.rows}
    if name not in rows or group.reference not in rows:
        return math.nan, math.nan
    sign = _sign(group.score)
    base = sign * rows[group.reference].loss
    if name == group.reference:
        return base, 0.0
    return base + sign * rows[name].against.difference, rows[name].against.stderr


def _sign(score: Score) -> float:
    """Return what turns a loss into what people know the score as."""
    return -1.0 if score.better == "larger" else 1.0


def _dot(ax: Axes, style: tuple[LineStyle, str], x: float, y: float, **bars: Any) -> None:
    ax.errorbar([x], [y], fmt=style[1], ms=6, color=style[0].colour, capsize=3, lw=1.3, **bars)


def _twice(error: float) -> float | None:
    return 2.0 * error if math.isfinite(error) and error > 0.0 else None


def _wide(values: Sequence[float] | FloatArray) -> bool:
    """Return whether positive values lie so far apart that a logarithmic axis is needed."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    return bool(known.size and known.min() > 0.0 and known.max() > LOGARITHMIC_RATIO * known.min())


def _with_unit(score: Score) -> str:
    label = loss_label(score)
    return f"{label} [{score.unit}]" if score.unit else label
