"""Pictures of a comparison: characteristics, reconstruction, residuals, validation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comparisons.harness.residual_analysis import (
    Correlation,
    autocorrelation,
    cross_correlation,
    dwelt_on,
    phi_density,
    segment_spectrum,
)
from comparisons.page.style import (
    FAINT,
    INK,
    MEASURED,
    QUIET,
    SHADE,
    axes_of,
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
from comparisons.results import Comparison, EstimatorResult, Truth, estimator_label
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from comparisons.results import Reconstruction

__all__ = [
    "correlations_of",
    "plot_characteristics",
    "plot_reconstruction",
    "plot_residual_structure",
    "plot_residuals",
    "plot_validation",
]

BAND = 2.0
# Share of the picture's height that the histogram under the curves takes.
HISTOGRAM_SHARE = 0.32
ZOOM_S = 0.8
FEWEST_LAGS = 5
MOST_LAGS = 40
COLUMN = "#bcc5d0"
DWELLING = r"where $\varphi$ dwells (5th to 95th percentile)"


def plot_characteristics(
    comparison: Comparison, truth: Truth | None = None, ax: Axes | None = None
) -> Axes:
    """Draw each estimator's quasi-steady characteristic over the histogram of φ.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    truth : Truth, optional
        The characteristic of a simulated record.
    ax : Axes, optional
        Where to draw; a new figure without it.

    Returns
    -------
    Axes
        Curves with bands of ± 2 standard errors, full where φ dwells and faint outside
        (paper, Fig 23 to 26).
    """
    ax = axes_of(ax, 6.0)
    rows = comparison.rows
    low, high = comparison.valid_phi
    _histogram_behind(ax, rows.phi, comparison.valid_phi)
    styles = estimator_styles(result.name for result in comparison.results)
    seen = []
    for result in comparison.results:
        phi, value, stderr = np.asarray(result.model.table).T
        inside = (phi >= low) & (phi <= high) & dwelt_on(phi, rows.phi)
        style = styles[result.name]
        seen.append(value[inside])
        ax.plot(phi, value, color=style.colour, linestyle=style.dashes, lw=1.0, alpha=0.35)
        ax.plot(
            phi,
            np.where(inside, value, np.nan),
            color=style.colour,
            linestyle=style.dashes,
            lw=1.8,
            label=printable(result.label),
        )
        ax.fill_between(
            phi,
            value - BAND * stderr,
            value + BAND * stderr,
            where=inside.tolist(),
            color=style.colour,
            alpha=0.16,
            lw=0,
        )
    if truth is not None:
        shown = (truth.phi >= rows.phi.min()) & (truth.phi <= rows.phi.max())
        seen.append(truth.quasi_steady[(truth.phi >= low) & (truth.phi <= high)])
        ax.plot(
            truth.phi[shown],
            truth.quasi_steady[shown],
            color="black",
            lw=1.6,
            linestyle=(0, (1, 1.5)),
            label=printable(truth.label),
        )
    bottom, top = robust_limits(*seen, np.percentile(rows.measured, [2.0, 98.0]), margin=0.12)
    ax.set_ylim(bottom - HISTOGRAM_SHARE * 0.5 * (top - bottom), top)
    ax.set_xlim(*robust_limits(rows.phi, margin=0.02))
    ax.set_xlabel(r"flow coefficient $\varphi$ [-]")
    symbol = coefficient_symbol(rows.target, quasi_steady=True)
    word = "pressure" if rows.target == "psi_p" else "work"
    ax.set_ylabel(f"quasi-steady {word} coefficient {symbol} [-]")
    # Above the axes: inside them it would lie on the histogram or on the curves.
    legend(ax, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, columnspacing=1.6)
    return ax


def plot_reconstruction(comparison: Comparison, record: int = 0) -> Figure:
    """Draw the free run of each estimator against the measurement of one record.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    record : int
        Index of the record.

    Returns
    -------
    Figure
        Above, the whole record with the best estimator; below, the cycles around the border to
        the held-out rows with all of them (paper, Fig 27).
    """
    figure = new_figure(height_in=6.6)
    upper, lower = figure.subplots(2, 1)
    symbol = coefficient_symbol(comparison.rows.target)
    own = comparison.rows.record == record
    best = comparison.result(comparison.table[0].estimator)
    _reconstruction_panel(dress(upper), comparison, own, (best,))
    _reconstruction_panel(
        dress(lower), comparison, own, comparison.results, _border(comparison, own)
    )
    for ax in (upper, lower):
        ax.set_ylabel(f"{symbol} [-]")
    lower.set_xlabel("facility clock [s]")
    legend_above(figure, lower)
    return figure


def plot_residuals(comparison: Comparison) -> Figure:
    """Draw what the free run of each estimator leaves, over time.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.

    Returns
    -------
    Figure
        One strip an estimator, measurement minus reconstruction, all to one scale.
    """
    rows = comparison.rows
    results = comparison.results
    # Records of one test keep their order on the clock; others may overlap, so rows are counted.
    by_clock = bool(np.all(np.diff(rows.time_s) > 0.0))
    axis: FloatArray = (
        rows.time_s
        if by_clock
        else rows.sample_period_s * np.arange(rows.phi.size, dtype=np.float64)
    )
    errors = [rows.measured - result.reconstruction for result in results]
    styles = estimator_styles(result.name for result in results)
    figure = new_figure(height_in=1.1 + 1.35 * len(results))
    panels = np.atleast_1d(np.asarray(figure.subplots(len(results), 1, sharex=True, sharey=True)))
    for ax, result, error in zip(panels, results, errors, strict=True):
        dress(ax)
        _shade(ax, axis, ~rows.train, "held-out cycles")
        ax.axhline(0.0, color=INK, lw=0.6)
        ax.plot(
            *broken(axis, error, rows.runs),
            color=styles[result.name].colour,
            lw=0.9,
            label=printable(result.label),
        )
    panels[0].set_ylim(*robust_limits(*errors, margin=0.1))
    panels[0].set_xlim(float(axis[0]), float(axis[-1]))
    panels[-1].set_xlabel("facility clock [s]" if by_clock else "fitted rows in a row [s]")
    figure.supylabel(
        f"free-run error of {coefficient_symbol(rows.target)}: measured - reconstructed [-]",
        fontsize=10,
    )
    legend_above(figure, *panels)
    return figure


def plot_residual_structure(comparison: Comparison) -> Figure:
    """Draw what the residuals hold over frequency and over lags.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.

    Returns
    -------
    Figure
        Spectra of the free-run errors beside that of the measurement; autocorrelation of the
        one-step errors and their correlation with φ, each with its 99 % band.
    """
    figure = new_figure(height_in=7.0)
    grid = figure.add_gridspec(2, 2)
    spectra = dress(figure.add_subplot(grid[0, :]))
    itself = dress(figure.add_subplot(grid[1, 0]))
    with_phi = dress(figure.add_subplot(grid[1, 1]))
    _error_spectra(spectra, comparison)
    _correlations(itself, with_phi, comparison)
    legend_above(figure, spectra)
    return figure


def plot_validation(reconstructions: tuple[Reconstruction, ...]) -> Figure:
    """Draw models that were fitted elsewhere against the measurement of another record.

    Parameters
    ----------
    reconstructions : tuple of Reconstruction
        One or several models on one record.

    Returns
    -------
    Figure
        Above, the whole record with the best model; below, the cycles in its middle with all of
        them, rows shaded whose φ lies outside the range where it dwelt in the fit.
    """
    best = min(reconstructions, key=lambda run: run.score.rms)
    rows = best.rows
    time_s, runs = rows.time_s, rows.runs
    figure = new_figure(height_in=6.6)
    upper, lower = figure.subplots(2, 1)
    middle = 0.5 * float(time_s[0] + time_s[-1])
    low, high = best.model.valid_phi
    outside = (rows.phi < low) | (rows.phi > high)
    _shade(dress(lower), time_s, outside, r"$\varphi$ beyond where it dwelt in the fit")
    styles = estimator_styles(run.model.estimator for run in reconstructions)
    for ax, shown, width in ((dress(upper), (best,), 0.8), (lower, reconstructions, 1.2)):
        x, y = broken(time_s, rows.measured, runs)
        ax.plot(x, y, color=MEASURED, lw=2.2 * width, label="measured")
        for run in shown:
            style = styles[run.model.estimator]
            x, y = broken(time_s, run.reconstructed, runs)
            ax.plot(
                x,
                y,
                color=style.colour,
                linestyle="-" if ax is upper else style.dashes,
                lw=width,
                label=printable(estimator_label(run.model.estimator)),
            )
        ax.set_ylim(*robust_limits(rows.measured, margin=0.15))
        ax.set_ylabel(f"{coefficient_symbol(rows.target)} [-]")
    upper.set_xlim(float(time_s[0]), float(time_s[-1]))
    lower.set_xlim(
        max(middle - 0.5 * ZOOM_S, float(time_s[0])), min(middle + 0.5 * ZOOM_S, float(time_s[-1]))
    )
    lower.set_xlabel("facility clock [s]")
    legend_above(figure, lower)
    return figure


def _histogram_behind(ax: Axes, phi: FloatArray, valid_phi: tuple[float, float]) -> None:
    histogram = phi_density(phi)
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
    ax.fill([], [], color=SHADE, label=DWELLING)
    ax.fill([], [], color=COLUMN, label=r"histogram of $\varphi$")
    behind.stairs(histogram.density, histogram.edges, fill=True, color=COLUMN, lw=0)
    behind.set_ylim(0.0, float(histogram.density.max()) / HISTOGRAM_SHARE)
    behind.set_ylabel(
        r"histogram: share of rows per unit $\varphi$", fontsize=8.5, color="#777777", loc="bottom"
    )
    top = float(histogram.density.max())
    behind.set_yticks([0.0, top], ["0", f"{top:.2g}"])
    behind.tick_params(labelsize=8, colors="#777777")
    behind.spines[["top", "right", "left", "bottom"]].set_visible(False)


def _border(comparison: Comparison, own: NDArray[np.bool_]) -> tuple[float, float]:
    rows = comparison.rows
    time_s = rows.time_s[own]
    held_out = time_s[~rows.train[own]]
    # The border lies where the held-out rows of this record begin, if it has both kinds.
    middle = held_out[0] if 0 < held_out.size < time_s.size else 0.5 * (time_s[0] + time_s[-1])
    span = min(ZOOM_S, float(time_s[-1] - time_s[0]))
    start = float(np.clip(middle - 0.5 * span, time_s[0], time_s[-1] - span))
    return start, start + span


def _reconstruction_panel(
    ax: Axes,
    comparison: Comparison,
    own: NDArray[np.bool_],
    results: tuple[EstimatorResult, ...],
    span: tuple[float, float] | None = None,
) -> None:
    rows = comparison.rows
    keep = own.copy() if span is None else own & (rows.time_s >= span[0]) & (rows.time_s <= span[1])
    time_s = rows.time_s[keep]
    runs = runs_of(rows.labels[keep], time_s.size)
    _shade(ax, time_s, ~rows.train[keep], "held-out cycles")
    width = 0.8 if span is None else 1.2
    measured = rows.measured[keep]
    # Thick and pale below the thin lines: where they part is seen, where they agree too.
    ax.plot(*broken(time_s, measured, runs), color=MEASURED, lw=2.2 * width, label="measured")
    styles = estimator_styles(result.name for result in comparison.results)
    for result in results:
        style = styles[result.name]
        ax.plot(
            *broken(time_s, result.trained[keep], runs),
            color=style.colour,
            linestyle="-" if span is None else style.dashes,
            lw=width,
            label=printable(result.label),
        )
    ax.set_ylim(*robust_limits(measured, margin=0.15))
    if time_s.size:
        ax.set_xlim(float(time_s[0]), float(time_s[-1]))


def _shade(ax: Axes, time_s: FloatArray, where: NDArray[np.bool_], label: str) -> None:
    """Shade the stretches of rows that a mask marks."""
    name: str | None = label
    step = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
    # Rows of two segments lie further apart than one step; the shade does not bridge them.
    gaps = np.concatenate([[False], np.diff(time_s) > 1.5 * step])
    for run in runs_of(2 * np.cumsum(gaps) + where, time_s.size):
        if where[run.start]:
            left, right = time_s[run.start] - 0.5 * step, time_s[run.stop - 1] + 0.5 * step
            ax.axvspan(left, right, color=SHADE, lw=0, zorder=0, label=name)
            name = None


def _error_spectra(ax: Axes, comparison: Comparison) -> None:
    rows = comparison.rows
    whole = segment_spectrum(rows.measured, rows.runs, rows.sample_period_s)
    ax.loglog(whole.frequency_hz, whole.density, color=FAINT, lw=1.4, label="measured signal")
    styles = estimator_styles(result.name for result in comparison.results)
    for result in comparison.results:
        spectrum = segment_spectrum(
            rows.measured - result.reconstruction, rows.runs, rows.sample_period_s
        )
        ax.loglog(
            spectrum.frequency_hz,
            spectrum.density,
            color=styles[result.name].colour,
            linestyle=styles[result.name].dashes,
            lw=1.1,
            label=printable(result.label),
        )
    low, high = whole.band99
    ax.fill_between(
        whole.frequency_hz,
        whole.density / high,
        whole.density / low,
        color=FAINT,
        alpha=0.3,
        lw=0,
        label="99 % band of the measured signal",
    )
    ax.set_xlim(float(whole.frequency_hz[0]), float(whole.frequency_hz[-1]))
    _plain_decades(ax)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"density of {coefficient_symbol(rows.target)} [1/Hz]")


def _plain_decades(ax: Axes) -> None:
    """Label a logarithmic axis of frequency with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def correlations_of(
    comparison: Comparison,
) -> list[tuple[EstimatorResult, Correlation, Correlation]]:
    """Return for each estimator the autocorrelation of its one-step errors and that with φ.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    rows = comparison.rows
    # Beyond half a segment few products are left, and the estimates fall to zero by themselves.
    typical = int(np.median([run.stop - run.start for run in rows.runs]))
    n_lags = max(FEWEST_LAGS, min(MOST_LAGS, typical // 2))
    out = []
    for result in comparison.results:
        errors = result.errors_one_step
        itself = autocorrelation(errors, rows.runs, rows.sample_period_s, n_lags)
        cross = cross_correlation(errors, rows.phi, rows.runs, rows.sample_period_s, n_lags)
        out.append((result, itself, cross))
    return out


def _correlations(own: Axes, with_phi: Axes, comparison: Comparison) -> None:
    styles = estimator_styles(result.name for result in comparison.results)
    limits = []
    for result, itself, cross in correlations_of(comparison):
        style = styles[result.name]
        limits.append((itself.limit99, cross.limit99))
        for ax, correlation in ((own, itself), (with_phi, cross)):
            ax.plot(
                1e3 * correlation.lag_s,
                correlation.value,
                color=style.colour,
                marker=".",
                markersize=3.5,
                lw=0.9,
            )
    for ax, limit in zip((own, with_phi), np.max(limits, axis=0), strict=True):
        ax.axhspan(-limit, limit, color="#dddddd", alpha=0.6, lw=0, zorder=0)
        ax.axhline(0.0, color=INK, lw=0.6)
        ax.set_xlabel("lag [ms]")
        ax.set_title("grey: 99 % band", fontsize=8.5, color=QUIET, loc="right", pad=3)
    own.set_ylabel("autocorrelation of\none-step errors [-]")
    with_phi.set_ylabel("correlation of one-step\n" + r"errors with $\varphi$ [-]")
