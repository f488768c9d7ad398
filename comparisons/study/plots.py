"""The picture of a study: paired differences to the reference, a panel a group."""

from __future__ import annotations

import math
from collections.abc import Sequence

from comparisons.page.blocks import Picture
from comparisons.page.style import INK, dress, estimator_styles, new_figure, printable
from comparisons.study.comparison import GroupComparison
from comparisons.study.scores import loss_label
from surge_core.rounding import round_to_error

__all__ = ["draw_differences"]

# Panels beside each other; tables hold all.
MOST_PANELS = 4
LONGEST_NAME = 26


def draw_differences(groups: Sequence[GroupComparison]) -> Picture:
    """Draw the paired difference of each method to the reference, a panel a group.

    Parameters
    ----------
    groups : sequence of GroupComparison
        Of one score, at least one; the first few are drawn.

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
    styles = estimator_styles(sorted(ranked))
    figure = new_figure(height_in=1.5 + 0.42 * max(len(shown), 2))
    panels = figure.subplots(1, len(drawn), sharey=True, squeeze=False)[0]
    sentences = []
    for ax, group in zip(panels, drawn, strict=True):
        dress(ax)
        ax.axvline(0.0, color=INK, lw=1.0)
        differences = []
        for row in group.rows:
            pair, colour = row.against, styles[row.method].colour
            if row.method != reference and math.isfinite(pair.difference):
                bars = 2.0 * pair.stderr if math.isfinite(pair.stderr) else None
                place = shown.index(row.method)
                ax.errorbar([pair.difference], [place], fmt="o", xerr=bars, color=colour, capsize=3)
                known = round_to_error(pair.difference, pair.stderr)
                differences.append(f"{row.method} {known} {score.unit}".strip())
        ax.set_title(printable(group.place, 40), fontsize=9, loc="left")
        sentences.append(f"{group.place}: {', '.join(differences) or 'no other method'}.")
    panels[0].set_yticks(range(len(shown)), [printable(name, LONGEST_NAME) for name in shown])
    panels[0].set_ylim(len(shown) - 0.5 if shown else 0.5, -0.5)
    label = f"worse than {reference} in {loss_label(score)}"
    figure.supxlabel(printable(f"{label} [{score.unit or '1'}]", 100), fontsize=9)
    return Picture(
        f"Paired differences to {reference}",
        figure,
        f"Paired difference of {loss_label(score)} to {reference}. {' '.join(sentences)}",
        "Right of the line: worse than the reference on the same cells. Bars are ± 2 standard "
        "errors over records; a dot without bars has an error that is not known.",
    )
