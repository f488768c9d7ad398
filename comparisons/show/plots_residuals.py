"""Picture of what the estimators leave: errors over time."""

from __future__ import annotations

import numpy as np

from comparisons.page.blocks import Picture
from comparisons.page.style import (
    INK,
    broken,
    coefficient_symbol,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    printable,
    robust_limits,
)
from comparisons.results import SYMBOLS, Comparison
from comparisons.show.plots_fit import NAMES, shade
from surge_core.rounding import significant
from surge_core.types import FloatArray


def errors_in_time(comparison: Comparison) -> Picture:
    """Draw what the free run of each estimator leaves, over time, all to one scale.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    rows, results = comparison.rows, comparison.results
    # Records of one test keep their order on the clock; others may overlap, so rows are counted.
    by_clock = bool(np.all(np.diff(rows.time_s) > 0.0))
    axes: dict[str, FloatArray] = {}
    for each in (result.rows for result in results):
        counted = rows.sample_period_s * np.arange(each.phi.size, dtype=np.float64)
        axes[each.kind] = each.time_s if by_clock else counted
    styles = estimator_styles(result.name for result in results)
    figure = new_figure(height_in=1.1 + 1.35 * len(results))
    panels = np.atleast_1d(np.asarray(figure.subplots(len(results), 1, sharex=True, sharey=True)))
    errors, shown = [], []
    for ax, result in zip(panels, results, strict=True):
        rows, axis = result.rows, axes[result.rows.kind]
        error = rows.measured - result.reconstruction
        errors.append(error)
        shade(dress(ax), axis, ~rows.train, "held-out cycles")
        ax.axhline(0.0, color=INK, lw=0.6)
        colour, label = styles[result.name].colour, printable(result.label)
        ax.plot(*broken(axis, error, rows.runs), color=colour, lw=0.9, label=label)
        shown.append(f"{result.label} {significant(result.free_run.rms, 2)}")
    panels[0].set_ylim(*robust_limits(*errors, margin=0.1))
    ends = [axis[[0, -1]] for axis in axes.values()]
    panels[0].set_xlim(float(np.min(ends)), float(np.max(ends)))
    panels[-1].set_xlabel("facility clock [s]" if by_clock else "fitted rows in a row [s]")
    symbol = coefficient_symbol(rows.target)
    words = f"free-run error of {symbol}: measured - reconstructed [-]"
    figure.supylabel(words, fontsize=10)
    legend_above(figure, *panels)
    return Picture.of(
        f"Free-run errors in time, {NAMES[rows.target]}",
        figure,
        f"Measured minus reconstructed {SYMBOLS[rows.target]} over time, one strip an estimator; "
        f"rms {'; '.join(shown)}.",
        "All strips have one scale. What repeats in every cycle is structure that the model lacks, "
        "not noise; a level that wanders over the cycles is drift.",
    )
