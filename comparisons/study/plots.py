"""Pictures of a study: differences to the reference, losses over an axis, seconds against loss.

Each comes with the sentence that says in numbers what it shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.page.style import (
    INK,
    LineStyle,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    printable,
)
from comparisons.study.comparison import (
    GroupComparison,
    MethodRow,
    compare_methods,
    losses,
    methods_in,
    score_named,
)
from comparisons.study.scores import Score
from comparisons.study.words import loss_label, value_words, where_words
from surge_core.errors import InputError
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from surge_core.types import FloatArray

__all__ = ["Drawn", "draw_differences", "draw_over_axis", "draw_seconds", "method_styles"]

MARKERS = "osD^vP<X>ph"
# Panels beside each other, and values of an axis that a text alternative tells; tables hold all.
MOST_PANELS, MOST_VALUES = 4, 12
# Distinct numbers of an axis beyond which they are gathered in bins, and other values are cut off.
MOST_PLACES, BINS = 24, 8
# Points of a cloud beyond which no eye tells more; the medians are of all.
MOST_POINTS = 2000
LONGEST_NAME = 26
# Losses further apart than this are drawn on a logarithmic axis.
LOGARITHMIC_RATIO = 30.0
# Share of the distance between two categories over which the methods' dots are spread.
SPREAD = 0.5


@dataclass(frozen=True)
class Drawn:
    """A picture and what it says.

    Parameters
    ----------
    title : str
        What it is.
    figure : Figure
        The picture.
    alt : str
        What it shows, in numbers, for those who cannot see it.
    reading : str
        How to read it.
    """

    title: str
    figure: Figure
    alt: str
    reading: str


def method_styles(methods: Sequence[str]) -> dict[str, tuple[LineStyle, str]]:
    """Return line style and marker of each method, the same in all pictures of a study.

    Parameters
    ----------
    methods : sequence of str
        Names of all methods of the study.
    """
    ordered = sorted(methods)
    styles = estimator_styles(ordered)
    return {name: (styles[name], MARKERS[i % len(MARKERS)]) for i, name in enumerate(ordered)}


def draw_differences(groups: Sequence[GroupComparison], methods: Sequence[str]) -> Drawn:
    """Draw the paired difference of each method to the reference, a panel a group.

    Parameters
    ----------
    groups : sequence of GroupComparison
        Of one score; the first few are drawn.
    methods : sequence of str
        Names of all methods of the study.

    Returns
    -------
    Drawn
        Dots with two standard errors to each side.
    """
    if not groups:
        raise InputError("groups", expected="at least one group of cells", found="none")
    drawn = groups[:MOST_PANELS]
    score, reference = groups[0].score, groups[0].reference
    # By rank over all cells, so that the picture reads as the table does.
    ranked = dict.fromkeys(row.method for group in drawn for row in group.rows)
    shown = [name for name in ranked if name != reference]
    styles = method_styles(methods)
    figure = new_figure(height_in=1.5 + 0.42 * max(len(shown), 2))
    panels = figure.subplots(1, len(drawn), sharey=True, squeeze=False)[0]
    told = []
    for ax, group in zip(panels, drawn, strict=True):
        dress(ax)
        ax.axvline(0.0, color=INK, lw=1.0)
        rows = {row.method: row for row in group.rows}
        for place, name in enumerate(shown):
            if name in rows and math.isfinite(rows[name].against.difference):
                pair = rows[name].against
                _dot(ax, styles[name], (pair.difference, place), xerr=_twice(pair.stderr))
        ax.set_title(printable(where_words(group.where), 40), fontsize=9, loc="left")
        told.append(_differences_told(group))
    first = panels[0]
    first.set_yticks(range(len(shown)), [printable(name, LONGEST_NAME) for name in shown])
    first.set_ylim(len(shown) - 0.5 if shown else 0.5, -0.5)
    unit = f" [{score.unit}]" if score.unit else ""
    told_label = printable(f"worse than {reference} in {loss_label(score)} by{unit}", 100)
    figure.supxlabel(told_label, fontsize=9)
    cut = "" if len(groups) == len(drawn) else f" The first {len(drawn)} of {len(groups)} groups."
    return Drawn(
        f"Paired differences to {reference}",
        figure,
        f"Paired difference of {loss_label(score)} to {reference}. {' '.join(told)}{cut}",
        "Right of the line: worse than the reference on the same cells. Bars are ± 2 standard "
        "errors over records; a dot without bars has an error that is not known, a method without "
        f"a dot has no mean difference.{cut}",
    )


def draw_over_axis(
    table: pd.DataFrame, score: Score | str, axis: str, reference: str | None = None
) -> Drawn:
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
    Drawn
        The reference at its own mean, the others at that mean plus their paired difference.

    Notes
    -----
    A method that fails where records are hard would look better by its own mean than it is; its
    difference on the cells that it shares with the reference does not.
    """
    chosen = score_named(score)
    if axis not in table.columns:
        raise InputError("results", expected=f"the column '{axis}'", found="none of that name")
    table, axis = _binned(table, axis)
    every = compare_methods(table, chosen, reference, (axis,))
    groups = every[:MOST_PLACES]
    if not groups:
        raise InputError("results", expected="at least one cell", found="an empty table")
    values = [group.where[0][1] for group in groups]
    numeric = all(_is_number(value) for value in values)
    methods = methods_in(table)
    styles = method_styles(methods)
    figure = new_figure(height_in=4.4)
    ax = dress(figure.add_subplot())
    points = {name: [_point(group, name) for group in groups] for name in methods}
    for k, name in enumerate(methods):
        shift = 0.0 if numeric else SPREAD * ((k + 0.5) / len(methods) - 0.5)
        places = values if numeric else [i + shift for i in range(len(values))]
        kept = [(x, *p) for x, p in zip(places, points[name], strict=True) if math.isfinite(p[0])]
        style = styles[name]
        for x, mean, error in kept:
            _dot(ax, style, (x, mean), yerr=_twice(error))
        xs, means = [p[0] for p in kept], [p[1] for p in kept]
        ls = style[0].dashes if numeric else "none"
        label = printable(name, LONGEST_NAME)
        ax.plot(xs, means, color=style[0].colour, ls=ls, marker=style[1], ms=6, lw=1.4, label=label)
    if not numeric:
        ax.set_xlim(-0.5, len(values) - 0.5)
        labels = [printable(value_words(value), 20) for value in values]
        ax.set_xticks(range(len(values)), labels, rotation=30 if len(labels) > 6 else 0)
    elif _wide(np.asarray(values, dtype=np.float64)):
        ax.set_xscale("log")
    _scale(ax, [p[0] for several in points.values() for p in several])
    ax.set_xlabel(printable(axis), fontsize=9)
    ax.set_ylabel(_axis_label(chosen, "mean"), fontsize=9)
    legend_above(figure, ax, columns=4)
    base = groups[0].reference
    cut = f" The first {len(groups)} of {len(every)} values." if len(every) > len(groups) else ""
    way = "Higher" if chosen.better == "larger" else "Lower"
    return Drawn(
        f"{_loss_words(chosen)} over {axis}",
        figure,
        f"Mean {_loss_words(chosen)} over {axis}: {_axis_told(values, points)}.{cut}",
        f"Bars are ± 2 standard errors of the paired difference to {base}, which has none itself; "
        f"each method stands at the mean of {base} plus that difference. {way} is better.{cut}",
    )


def draw_seconds(table: pd.DataFrame, score: Score | str) -> Drawn:
    """Draw the seconds of each fit against its loss.

    Parameters
    ----------
    table : DataFrame
        Results with the column ``seconds_fit``.
    score : Score or str
        What is compared.

    Returns
    -------
    Drawn
        A faint dot a cell, a large one at the medians of each method.
    """
    chosen = score_named(score)
    for name in ("seconds_fit", chosen.name):
        if name not in table.columns:
            raise InputError("results", expected=f"the column '{name}'", found="none of that name")
    methods = methods_in(table)
    styles = method_styles(methods)
    figure = new_figure(height_in=4.4)
    ax = dress(figure.add_subplot())
    told, every = [], []
    for name in methods:
        seconds, lost = _clouds(table, chosen, name)
        style = styles[name]
        if not seconds.size:
            told.append(f"{name}: no scored cell")
            continue
        step = max(1, math.ceil(seconds.size / MOST_POINTS))
        ax.plot(seconds[::step], lost[::step], style[1], ms=3, alpha=0.35, color=style[0].colour)
        centre = float(np.median(seconds)), float(np.median(lost))
        label = printable(name, LONGEST_NAME)
        ax.plot(*centre, style[1], ms=11, color=style[0].colour, mec=INK, mew=1.0, label=label)
        every.append((seconds, lost))
        told.append(
            f"{name}: {significant(centre[0], 3)} s, {significant(centre[1], 3)} "
            f"({seconds.size} cells)"
        )
    if every:
        if _wide(np.concatenate([seconds for seconds, _ in every])):
            ax.set_xscale("log")
        _scale(ax, np.concatenate([lost for _, lost in every]))
    ax.set_xlabel("seconds of the fit", fontsize=9)
    ax.set_ylabel(_axis_label(chosen), fontsize=9)
    legend_above(figure, ax, columns=4)
    way = "high" if chosen.better == "larger" else "low"
    return Drawn(
        f"Seconds of a fit against {_loss_words(chosen)}",
        figure,
        f"Median seconds of a fit and median {_loss_words(chosen)}: {'; '.join(told)}.",
        "Small: single cells; large: the medians of each method over its own scored cells. Left "
        f"and {way} is best. Infinite scores are not drawn.",
    )


def _clouds(table: pd.DataFrame, score: Score, name: str) -> tuple[FloatArray, FloatArray]:
    import pandas as pd

    rows = table[(table["method"].astype(str) == name) & (table["state"] != "failed")]
    seconds, values = (
        pd.to_numeric(rows[column]).to_numpy(dtype=np.float64, na_value=np.nan)
        for column in ("seconds_fit", score.name)
    )
    lost = _sign(score) * losses(score, values)
    kept = np.isfinite(seconds) & np.isfinite(lost)
    # Sorted, so that the picture does not depend on the order of the rows.
    order = np.lexsort((lost[kept], seconds[kept]))
    return seconds[kept][order], lost[kept][order]


def _point(group: GroupComparison, name: str) -> tuple[float, float]:
    """Return where a method stands in a group: the reference's mean plus the difference."""
    rows: Mapping[str, MethodRow] = {row.method: row for row in group.rows}
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


def _dot(
    ax: Axes,
    style: tuple[LineStyle, str],
    at: tuple[float, float],
    **bars: Any,
) -> None:
    ax.errorbar(
        [at[0]], [at[1]], fmt=style[1], ms=6, color=style[0].colour, capsize=3, lw=1.3, **bars
    )


def _twice(error: float) -> float | None:
    return 2.0 * error if math.isfinite(error) and error > 0.0 else None


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _wide(values: FloatArray) -> bool:
    """Whether positive values lie so far apart that only a logarithmic axis shows them all."""
    known = values[np.isfinite(values)]
    return bool(known.size and known.min() > 0.0 and known.max() > LOGARITHMIC_RATIO * known.min())


def _scale(ax: Axes, values: Sequence[float] | FloatArray) -> None:
    if _wide(np.asarray(values, dtype=np.float64)):
        ax.set_yscale("log")


def _loss_words(score: Score) -> str:
    label = loss_label(score)
    return f"{label} [{score.unit}]" if score.unit else label


def _axis_label(score: Score, lead: str = "") -> str:
    return printable(f"{lead} {_loss_words(score)}".strip(), 90)


def _binned(table: pd.DataFrame, axis: str) -> tuple[pd.DataFrame, str]:
    """Return the results with many numbers of an axis gathered in bins of equal counts."""
    import pandas as pd

    distinct = table[axis].dropna().unique().tolist()
    if len(distinct) <= MOST_PLACES or not all(map(_is_number, distinct)):
        return table, axis
    values = pd.to_numeric(table[axis]).to_numpy(dtype=np.float64, na_value=np.nan)
    edges = np.quantile(np.asarray(distinct, dtype=np.float64), np.linspace(0.0, 1.0, BINS + 1))
    number = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    middles = np.full(values.size, np.nan)
    for b in range(BINS):
        inside = (number == b) & np.isfinite(values)
        middles[inside] = np.median(values[inside]) if inside.any() else np.nan
    name = f"{axis} (middles of {BINS} bins)"
    return table.assign(**{name: middles}), name


def _differences_told(group: GroupComparison) -> str:
    told = []
    for row in group.rows:
        if row.method == group.reference:
            continue
        pair = row.against
        known = math.isfinite(pair.difference)
        told.append(
            f"{row.method} {round_to_error(pair.difference, pair.stderr)}"
            if known
            else f"{row.method} not known"
        )
    where = f"{where_words(group.where)}: " if group.where else ""
    unit = f" {group.score.unit}" if group.score.unit else ""
    return f"{where}{', '.join(told) or 'no other method'}{unit if told else ''}."


def _axis_told(values: list[Any], points: Mapping[str, list[tuple[float, float]]]) -> str:
    told = []
    # First and last of many values say most.
    half = MOST_VALUES // 2
    kept = [i for i in range(len(values)) if i < half or i >= len(values) - half]
    for name, several in points.items():
        numbers = ", ".join(
            f"{significant(several[i][0], 3)} at {value_words(values[i])}" for i in kept
        )
        told.append(f"{name} {numbers}")
    cut = "" if len(kept) == len(values) else f" (the ends of {len(values)} values)"
    return "; ".join(told) + cut
