"""Pictures of a comparison, each with what it shows: characteristics, free runs, validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.harness.fit_quality import dwelt_on
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    MEASURED,
    SHADE,
    LineStyle,
    broken,
    coefficient_symbol,
    dress,
    estimator_styles,
    legend,
    legend_above,
    new_figure,
    printable,
    robust_limits,
)
from comparisons.results import SYMBOLS, Comparison, EstimatorResult, Truth, estimator_label
from surge_core.rounding import round_to_error, significant
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from comparisons.results import Reconstruction

NAMES = {"psi_p": "pressure coefficient ψ'", "psi": "work coefficient ψ"}
# Standard errors that a band takes.
BAND = 2.0
# Share of the picture's height that the histogram under the curves takes.
HISTOGRAM_BINS = 60
HISTOGRAM_SHARE = 0.32
ZOOM_S = 0.8
COLUMN = "#bcc5d0"


def characteristics(comparison: Comparison, truth: Truth | None = None) -> Picture:
    """Draw each estimator's quasi-steady characteristic over the histogram of φ (Fig 23 to 26).

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    truth : Truth, optional
        The characteristic of a simulated record.

    Returns
    -------
    Picture
        Curves with bands of ± 2 standard errors, full where φ dwells and faint outside.
    """
    rows, ends = comparison.rows, comparison.valid_phi
    ax = dress(new_figure(height_in=6.0).add_subplot())
    _histogram_behind(ax, rows.phi, ends)
    seen, shown = [], []
    for result in comparison.results:
        phi, value, stderr = np.asarray(result.model.table).T
        inside = (phi >= ends[0]) & (phi <= ends[1]) & dwelt_on(phi, rows.phi)
        seen.append(value[inside])
        _curve_with_band(ax, comparison, result, inside)
        at_ends = (
            round_to_error(float(np.interp(end, phi, value)), float(np.interp(end, phi, stderr)))
            for end in ends
        )
        shown.append(f"{result.label} {' and '.join(at_ends)}")
    if truth is not None:
        drawn = (truth.phi >= rows.phi.min()) & (truth.phi <= rows.phi.max())
        curve = truth.phi[drawn], truth.quasi_steady[drawn]
        dots: dict[str, Any] = {"color": "black", "lw": 1.6, "linestyle": (0, (1, 1.5))}
        ax.plot(*curve, **dots, label=printable(truth.label))
        seen.append(truth.quasi_steady[(truth.phi >= ends[0]) & (truth.phi <= ends[1])])
        if truth.phi[0] <= ends[0] and ends[1] <= truth.phi[-1]:
            true = (significant(v, 3) for v in np.interp(ends, truth.phi, truth.quasi_steady))
            shown.append(f"{truth.label} {' and '.join(true)}")
    bottom, top = robust_limits(*seen, np.percentile(rows.measured, [2.0, 98.0]), margin=0.12)
    ax.set_ylim(bottom - HISTOGRAM_SHARE * 0.5 * (top - bottom), top)
    ax.set_xlim(*robust_limits(rows.phi, margin=0.02))
    ax.set_xlabel(r"flow coefficient $\varphi$ [-]")
    symbol = coefficient_symbol(rows.target, quasi_steady=True)
    word = "pressure" if rows.target == "psi_p" else "work"
    ax.set_ylabel(f"quasi-steady {word} coefficient {symbol} [-]")
    # Above the axes: inside them it would lie on the histogram or on the curves.
    legend(ax, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, columnspacing=1.6)
    places = " and ".join(f"φ = {end:.3f}" for end in ends)
    known = "" if truth is None else f" Dotted black: {truth.label}."
    return Picture.of(
        f"Quasi-steady {NAMES[rows.target]}",
        ax,
        f"Quasi-steady {SYMBOLS[rows.target]} over φ, with the histogram of φ. At {places}, "
        f"between which φ dwells: {'; '.join(shown)}.",
        "As Fig 23 to 26 of the paper. Bands are ± 2 standard errors of scatter. Shaded: where φ "
        "dwells, from its 5th to its 95th percentile; beyond it curves are faint, for "
        f"they are extrapolated there.{known}",
    )


def reconstruction(comparison: Comparison, record: int = 0, kind: str = "filtered") -> Picture:
    """Draw the free run of each estimator against the measurement of one record (Fig 27).

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    record : int
        Index of the record.
    kind : {"filtered", "unfiltered"}
        Which rows: those of the estimators that were fitted to such.

    Returns
    -------
    Picture
        Above, the whole record with the first of these estimators; below, the cycles around the
        border to the held-out rows with all of them.
    """
    ordered = [comparison.result(row.estimator) for row in comparison.table]
    results = [result for result in ordered if result.rows.kind == kind]
    first, rows, source = results[0], results[0].rows, comparison.records[record].source
    own = rows.record == record
    symbol = coefficient_symbol(rows.target)
    figure = new_figure(height_in=6.6)
    upper, lower = figure.subplots(2, 1)
    start_s, end_s = _border(rows.time_s[own], ~rows.train[own])
    around = own & (rows.time_s >= start_s) & (rows.time_s <= end_s)
    _run_panel(upper, comparison, own, (first,))
    _run_panel(lower, comparison, around, results)
    for ax in (upper, lower):
        ax.set_ylabel(f"{symbol} [-]")
    lower.set_xlabel("facility clock [s]")
    legend_above(figure, lower)
    time_s, measured = rows.time_s[own], rows.measured[own]
    errors = ", ".join(f"{r.label} {_rms(measured - r.trained[own])}" for r in results)
    return Picture.of(
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


def validation(runs: Sequence[Reconstruction]) -> Picture:
    """Draw models that were fitted elsewhere against the measurement of another record.

    Parameters
    ----------
    runs : sequence of Reconstruction
        One or several models on one record.

    Returns
    -------
    Picture
        Above, the whole record with the first model; below, the cycles in its middle with all of
        them and the first one's band, rows shaded whose φ lies outside the range where it dwelt in
        the fit.
    """
    best = runs[0]
    rows = best.rows
    styles = estimator_styles(run.model.estimator for run in runs)
    time_s = rows.time_s
    figure = new_figure(height_in=6.6)
    upper, lower = figure.subplots(2, 1)
    shade(dress(lower), time_s, best.beyond, r"$\varphi$ beyond where it dwelt in the fit")
    colour, band = styles[best.model.estimator].colour, best.band
    for number, run in enumerate(rows.runs if np.all(np.isfinite(band)) else ()):
        ends = (best.reconstructed - band)[run], (best.reconstructed + band)[run]
        label = "its 95 % band" if number == 0 else None
        lower.fill_between(time_s[run], *ends, color=colour, alpha=0.25, lw=0, label=label)
    signals = [(run.model.estimator, run.reconstructed) for run in runs]
    first_only = [(best.model.estimator, best.reconstructed)]
    for ax, shown in ((dress(upper), first_only), (lower, signals)):
        _draw_runs(ax, time_s, rows.measured, rows.runs, shown, styles)
        ax.set_ylabel(f"{coefficient_symbol(rows.target)} [-]")
    first, last = float(time_s[0]), float(time_s[-1])
    middle = 0.5 * (first + last)
    upper.set_xlim(first, last)
    lower.set_xlim(max(middle - 0.5 * ZOOM_S, first), min(middle + 0.5 * ZOOM_S, last))
    lower.set_xlabel("facility clock [s]")
    legend_above(figure, lower)
    scores = ", ".join(
        f"{estimator_label(run.model.estimator)} {significant(run.score.rms, 2)}" for run in runs
    )
    return Picture.of(
        f"Validation: {best.title}, {rows.kind} rows",
        figure,
        f"Measured {best.title}, {rows.kind} rows, and free runs of saved models; rms "
        f"{scores}. In {100.0 * best.outside:.0f} % of the rows φ lies beyond where it "
        "dwelt in the fit.",
        f"Nothing was refitted. Above {estimator_label(best.model.estimator)} over "
        "the whole record, below all models of such rows in its middle, with the pointwise 95 % "
        "band of the first by the covariance of its τ and coefficients: it says where the free run "
        "lies, not how far the measurement scatters. Shaded: φ beyond where it dwelt in the fit "
        "(5th to 95th percentile), where the reconstruction rests on extrapolated curves.",
    )


def shade(ax: Axes, time_s: FloatArray, where: BoolArray, label: str) -> None:
    """Shade the stretches of rows that a mask marks.

    Parameters
    ----------
    ax : Axes
        Where.
    time_s : ndarray of shape (n,)
        Clock of the rows, in seconds.
    where : ndarray of bool, shape (n,)
        The mask.
    label : str
        Entry of the legend.
    """
    name: str | None = label
    step = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
    # Rows of two segments lie further apart than one step; the shade does not bridge them.
    gaps = np.concatenate([[False], np.diff(time_s) > 1.5 * step])
    for run in runs_of(2 * np.cumsum(gaps) + where, time_s.size):
        if where[run.start]:
            left, right = time_s[run.start] - 0.5 * step, time_s[run.stop - 1] + 0.5 * step
            ax.axvspan(left, right, color=SHADE, lw=0, zorder=0, label=name)
            name = None


def _curve_with_band(
    ax: Axes, comparison: Comparison, result: EstimatorResult, inside: BoolArray
) -> None:
    phi, value, stderr = np.asarray(result.model.table).T
    style = estimator_styles(each.name for each in comparison.results)[result.name]
    look: dict[str, Any] = {"color": style.colour, "linestyle": style.dashes}
    ax.plot(phi, value, **look, lw=1.0, alpha=0.35)
    full = np.where(inside, value, np.nan)
    ax.plot(phi, full, **look, lw=1.8, label=printable(result.label))
    ends = value - BAND * stderr, value + BAND * stderr
    ax.fill_between(phi, *ends, where=inside.tolist(), color=style.colour, alpha=0.16, lw=0)


def _histogram_behind(ax: Axes, phi: FloatArray, valid_phi: tuple[float, float]) -> None:
    density, edges = np.histogram(phi, bins=HISTOGRAM_BINS, density=True)
    behind = ax.twinx()
    behind.set_zorder(0)
    ax.set_zorder(1)
    ax.patch.set_visible(False)
    # A record can leave a hole in the range: there the curve rests on nothing.
    grid = np.linspace(*valid_phi, 400)
    dwelt = dwelt_on(grid, phi)
    for run in runs_of(dwelt, grid.size):
        if dwelt[run.start]:
            behind.axvspan(float(grid[run.start]), float(grid[run.stop - 1]), color=SHADE, lw=0)
    # Entries of the legend for what lies on the axes behind.
    ax.fill([], [], color=SHADE, label=r"where $\varphi$ dwells (5th to 95th percentile)")
    ax.fill([], [], color=COLUMN, label=r"histogram of $\varphi$")
    behind.stairs(density, edges, fill=True, color=COLUMN, lw=0)
    top = float(density.max())
    behind.set_ylim(0.0, top / HISTOGRAM_SHARE)
    words = r"histogram: share of rows per unit $\varphi$"
    behind.set_ylabel(words, fontsize=8.5, color="#777777", loc="bottom")
    behind.set_yticks([0.0, top], ["0", f"{top:.2g}"])
    behind.tick_params(labelsize=8, colors="#777777")
    behind.spines[:].set_visible(False)


def _border(time_s: FloatArray, held_out: BoolArray) -> tuple[float, float]:
    """Return the time around the border to the held-out rows, if a record has both kinds."""
    first, last = float(time_s[0]), float(time_s[-1])
    both = 0 < np.count_nonzero(held_out) < time_s.size
    middle = float(time_s[held_out][0]) if both else 0.5 * (first + last)
    span = min(ZOOM_S, last - first)
    start = float(np.clip(middle - 0.5 * span, first, last - span))
    return start, start + span


def _run_panel(
    ax: Axes, comparison: Comparison, keep: BoolArray, results: Sequence[EstimatorResult]
) -> None:
    rows = results[0].rows
    time_s = rows.time_s[keep]
    shade(dress(ax), time_s, ~rows.train[keep], "held-out cycles")
    signals = [(result.name, result.trained[keep]) for result in results]
    labels = {result.name: result.label for result in results}
    styles = estimator_styles(result.name for result in comparison.results)
    runs = runs_of(rows.labels[keep], time_s.size)
    _draw_runs(ax, time_s, rows.measured[keep], runs, signals, styles, labels)
    if time_s.size:
        ax.set_xlim(float(time_s[0]), float(time_s[-1]))


def _draw_runs(
    ax: Axes,
    time_s: FloatArray,
    measured: FloatArray,
    runs: list[slice],
    signals: Sequence[tuple[str, FloatArray]],
    styles: Mapping[str, LineStyle],
    labels: Mapping[str, str] | None = None,
) -> None:
    """Draw free runs over the measurement; one alone is drawn thin and full."""
    alone = len(signals) == 1
    width = 0.8 if alone else 1.2
    # Thick and pale below the thin lines: where they part is seen, where they agree too.
    ax.plot(*broken(time_s, measured, runs), color=MEASURED, lw=2.2 * width, label="measured")
    for name, values in signals:
        style, label = styles[name], (labels or {}).get(name) or estimator_label(name)
        dashes = "-" if alone else style.dashes
        line = broken(time_s, values, runs)
        ax.plot(*line, color=style.colour, ls=dashes, lw=width, label=printable(label))
    ax.set_ylim(*robust_limits(measured, margin=0.15))


def _rms(error: FloatArray) -> str:
    return significant(float(np.sqrt(np.mean(error**2))), 2)
