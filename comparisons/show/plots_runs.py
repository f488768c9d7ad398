"""Pictures of free runs over time: reconstructions, validation on other records, errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from comparisons.harness.fit_quality import rms
from comparisons.page import style
from comparisons.page.blocks import Picture
from comparisons.results import SYMBOLS, Comparison, FitRows, Reconstruction, estimator_label
from comparisons.results.names import NAMES
from surge_core.rounding import significant
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ZOOM_S = 0.8


def reconstruction(comparison: Comparison, record: int = 0, kind: str = "filtered") -> Picture:
    """Draw the free run of each estimator against the measurement of one record (Fig 27).

    Above, the whole record with the first of the estimators that were fitted to rows of this kind;
    below, the cycles around the border to the held-out rows with all of them.
    """
    ordered = [comparison.result(row.estimator) for row in comparison.table]
    results = [result for result in ordered if result.rows.kind == kind]
    first, rows, source = results[0], results[0].rows, comparison.records[record].source
    own = rows.record == record
    time_s, measured, held_out = rows.time_s[own], rows.measured[own], ~rows.train[own]
    styles = style.estimator_styles(result.name for result in comparison.results)
    runs = {result.label: (styles[result.name], result.trained[own]) for result in results}
    both = bool(held_out.any() and not held_out.all())
    middle = float(time_s[held_out][0]) if both else None
    figure = _two_panels(rows, own, runs, held_out, "held-out cycles", middle=middle)
    errors = ", ".join(
        f"{r.label} {significant(rms(measured - r.trained[own]), 2)}" for r in results
    )
    return Picture(
        f"Reconstructed {NAMES[rows.target]}, {kind} rows of {source}",
        figure,
        f"Measured {SYMBOLS[rows.target]} of {source} from {time_s[0]:.2f} to {time_s[-1]:.2f} s "
        "and its free runs by fits to the rows not held out. rms of the error: "
        f"{errors}.",
        f"As Fig 27 of the paper. Above: {first.label}; below: all that were fitted to {kind} "
        "rows, around the border to the held-out cycles. A free run knows the measured flow, and "
        "of the measured coefficient only the first row of each segment. Shaded cycles were held "
        "out: the lines drawn are of a fit to the other cycles alone.",
    )


def validation(validated: Sequence[Reconstruction]) -> Picture:
    """Draw models that were fitted elsewhere against the measurement of another record.

    Above, the whole record with the first model; below, the cycles in its middle with all of them
    and the first one's band, rows shaded whose φ lies outside the range where it dwelt in the fit.
    """
    best, rows = validated[0], validated[0].rows
    styles = style.estimator_styles(run.model.estimator for run in validated)
    runs = {
        estimator_label(run.model.estimator): (styles[run.model.estimator], run.reconstructed)
        for run in validated
    }
    every = np.ones(rows.phi.size, dtype=np.bool_)
    label = r"$\varphi$ beyond where it dwelt in the fit"
    figure = _two_panels(rows, every, runs, best.beyond, label, band=best.band)
    scores = ", ".join(
        f"{label} {significant(run.score.rms, 2)}"
        for label, run in zip(runs, validated, strict=True)
    )
    return Picture(
        f"Validation: {best.title}, {rows.kind} rows",
        figure,
        f"Measured {best.title}, {rows.kind} rows, and free runs of saved models; rms "
        f"{scores}. In {100.0 * best.outside:.0f} % of the rows φ lies beyond where it "
        "dwelt in the fit.",
        f"Nothing was refitted. Above {next(iter(runs))} over "
        "the whole record, below all models of such rows in its middle, with the pointwise 95 % "
        "band of the first by the covariance of its τ and coefficients: it says where the free run "
        "lies, not how far the measurement scatters. Shaded: φ beyond where it dwelt in the fit "
        "(5th to 95th percentile), where the reconstruction rests on extrapolated curves.",
    )


def errors_in_time(comparison: Comparison) -> Picture:
    """Draw what the free run of each estimator leaves, over time, all to one scale."""
    rows, results = comparison.rows, comparison.results
    # Records of one test keep their order on the clock; others may overlap, so rows are counted.
    by_clock = bool(np.all(np.diff(rows.time_s) > 0.0))
    axes: dict[str, FloatArray] = {}
    for each in (result.rows for result in results):
        counted = rows.sample_period_s * np.arange(each.phi.size, dtype=np.float64)
        axes[each.kind] = each.time_s if by_clock else counted
    styles = style.estimator_styles(result.name for result in results)
    clock = "facility clock [s]" if by_clock else "fitted rows in a row [s]"
    figure, panels = style.strips(len(results), 1.1 + 1.35 * len(results), clock, sharey=True)
    errors, shown = [], []
    for ax, result in zip(panels, results, strict=True):
        rows, axis = result.rows, axes[result.rows.kind]
        error = rows.measured - result.reconstruction
        errors.append(error)
        shade(ax, axis, ~rows.train, "held-out cycles")
        ax.axhline(0.0, color=style.INK, lw=0.6)
        colour, label = styles[result.name].colour, style.printable(result.label)
        ax.plot(*style.broken(axis, error, rows.runs), color=colour, lw=0.9, label=label)
        shown.append(f"{result.label} {significant(result.free_run.rms, 2)}")
    panels[0].set_ylim(*style.robust_limits(*errors, margin=0.1))
    ends = [axis[[0, -1]] for axis in axes.values()]
    panels[0].set_xlim(float(np.min(ends)), float(np.max(ends)))
    symbol = style.coefficient_symbol(rows.target)
    words = f"free-run error of {symbol}: measured - reconstructed [-]"
    figure.supylabel(words, fontsize=10)
    style.legend_above(figure, *panels)
    return Picture(
        f"Free-run errors in time, {NAMES[rows.target]}",
        figure,
        f"Measured minus reconstructed {SYMBOLS[rows.target]} over time, one strip an estimator; "
        f"rms {'; '.join(shown)}.",
        "All strips have one scale. What repeats in every cycle is structure that the model lacks, "
        "not noise; a level that wanders over the cycles is drift.",
    )


def shade(ax: Axes, time_s: FloatArray, where: BoolArray, label: str) -> None:
    """Shade the stretches of rows, by their clock, that a mask marks."""
    name: str | None = label
    step = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
    # Rows of two segments lie further apart than one step; the shade does not bridge them.
    gaps = np.concatenate([[False], np.diff(time_s) > 1.5 * step])
    for run in runs_of(2 * np.cumsum(gaps) + where, time_s.size):
        if where[run.start]:
            left, right = time_s[run.start] - 0.5 * step, time_s[run.stop - 1] + 0.5 * step
            ax.axvspan(left, right, color=style.SHADE, lw=0, zorder=0, label=name)
            name = None


def _two_panels(
    rows: FitRows,
    own: BoolArray,
    runs: Mapping[str, tuple[style.LineStyle, FloatArray]],
    shaded: BoolArray,
    shade_label: str,
    *,
    middle: float | None = None,
    band: FloatArray | None = None,
) -> Figure:
    """Draw the first of some free runs over all of its rows, and below all over a part of them.

    ``middle`` is that of the part, without it that of the record; ``band`` half the width of the
    band of the first run.
    """
    time_s, measured = rows.time_s[own], rows.measured[own]
    pieces = runs_of(rows.labels[own], time_s.size)
    first, last = float(time_s[0]), float(time_s[-1])
    span = min(ZOOM_S, last - first)
    wanted = (0.5 * (first + last) if middle is None else middle) - 0.5 * span
    start = float(np.clip(wanted, first, last - span))
    figure = style.new_figure(height_in=6.6)
    upper, lower = figure.subplots(2, 1)
    for ax, names, ends in (
        (upper, list(runs)[:1], (first, last)),
        (lower, list(runs), (start, start + span)),
    ):
        shade(style.dress(ax), time_s, shaded, shade_label)
        width = 0.8 if len(names) == 1 else 1.2
        # Thick and pale below the thin lines: where they part is seen, where they agree too.
        known = style.broken(time_s, measured, pieces)
        ax.plot(*known, color=style.MEASURED, lw=2.2 * width, label="measured")
        for name in names:
            look, values = runs[name]
            # One alone is full.
            dashes = "-" if len(names) == 1 else look.dashes
            line = style.broken(time_s, values, pieces)
            label = style.printable(name)
            ax.plot(*line, color=look.colour, ls=dashes, lw=width, label=label)
        ax.set_xlim(*ends)
        ax.set_ylim(*style.robust_limits(measured, margin=0.15))
        ax.set_ylabel(f"{style.coefficient_symbol(rows.target)} [-]")
    if band is not None and np.all(np.isfinite(band)):
        look, values = next(iter(runs.values()))
        at_s, low = style.broken(time_s, values - band, pieces)
        high = style.broken(time_s, values + band, pieces)[1]
        label = "its 95 % band"
        lower.fill_between(at_s, low, high, color=look.colour, alpha=0.25, lw=0, label=label)
    lower.set_xlabel("facility clock [s]")
    style.legend_above(figure, lower)
    return figure
