"""Pictures of what the estimators leave: errors over time, over frequency and over lags."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.harness.residual_analysis import (
    Correlation,
    error_correlation,
    segment_spectrum,
)
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    FAINT,
    INK,
    QUIET,
    broken,
    coefficient_symbol,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    plain_numbers,
    printable,
    robust_limits,
)
from comparisons.results import SYMBOLS, Comparison, EstimatorResult
from comparisons.show.plots_fit import NAMES, largest, shade
from surge_core.rounding import significant
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["errors_in_time", "residual_structure"]

FEWEST_LAGS, MOST_LAGS = 5, 40


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
    counted = rows.sample_period_s * np.arange(rows.phi.size, dtype=np.float64)
    axis: FloatArray = rows.time_s if by_clock else counted
    styles = estimator_styles(result.name for result in results)
    figure = new_figure(height_in=1.1 + 1.35 * len(results))
    panels = np.atleast_1d(np.asarray(figure.subplots(len(results), 1, sharex=True, sharey=True)))
    errors, shown = [], []
    for ax, result in zip(panels, results, strict=True):
        error = rows.measured - result.reconstruction
        errors.append(error)
        shade(dress(ax), axis, ~rows.train, "held-out cycles")
        ax.axhline(0.0, color=INK, lw=0.6)
        colour, label = styles[result.name].colour, printable(result.label)
        ax.plot(*broken(axis, error, rows.runs), color=colour, lw=0.9, label=label)
        at = largest(error)
        shown.append(
            f"{result.label} {significant(result.free_run.rms, 2)}, at most "
            f"{significant(abs(float(error[at])), 2)} at {rows.time_s[at]:.2f} s"
        )
    panels[0].set_ylim(*robust_limits(*errors, margin=0.1))
    panels[0].set_xlim(float(axis[0]), float(axis[-1]))
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


def residual_structure(comparison: Comparison) -> Picture:
    """Draw what the residuals hold over frequency and over lags.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.

    Returns
    -------
    Picture
        Spectra of the free-run errors beside that of the measurement; autocorrelation of the
        one-step errors and their correlation with φ, each with its 99 % band.
    """
    figure = new_figure(height_in=7.0)
    grid = figure.add_gridspec(2, 2)
    spectra = dress(figure.add_subplot(grid[0, :]))
    _error_spectra(spectra, comparison)
    own, with_phi = (dress(figure.add_subplot(grid[1, column])) for column in (0, 1))
    shown = _correlations(own, with_phi, comparison)
    legend_above(figure, spectra)
    return Picture.of(
        f"Structure of the residuals, {NAMES[comparison.rows.target]}",
        figure,
        f"Spectra of the free-run errors of {SYMBOLS[comparison.rows.target]} beside the measured "
        "signal; autocorrelation of the one-step errors and their correlation with φ: "
        f"{'; '.join(shown)}.",
        "Above: where an error's spectrum lies far below the grey signal the model explains that "
        "frequency; where it lies in the grey band it explains nothing. Below left: one-step "
        "errors should stay inside the grey band at 99 % of the lags; on data that were low-passed "
        "they do not. Below right: positive lags are errors that follow φ. What leaves the band "
        "there, φ could still explain: the characteristic, the lag or the alignment of φ lacks "
        "something. The grey band is the widest of the estimators'.",
    )


def _error_spectra(ax: Axes, comparison: Comparison) -> None:
    rows = comparison.rows
    whole = segment_spectrum(rows.measured, rows.runs, rows.sample_period_s)
    hertz, (low, high) = whole.frequency_hz, whole.band99
    ax.loglog(hertz, whole.density, color=FAINT, lw=1.4, label="measured signal")
    styles = estimator_styles(result.name for result in comparison.results)
    for result in comparison.results:
        error = rows.measured - result.reconstruction
        spectrum = segment_spectrum(error, rows.runs, rows.sample_period_s)
        look: dict[str, Any] = {
            "color": styles[result.name].colour,
            "linestyle": styles[result.name].dashes,
        }
        label = printable(result.label)
        ax.loglog(spectrum.frequency_hz, spectrum.density, **look, lw=1.1, label=label)
    band = whole.density / high, whole.density / low
    label = "99 % band of the measured signal"
    ax.fill_between(hertz, *band, color=FAINT, alpha=0.3, lw=0, label=label)
    ax.set_xlim(float(hertz[0]), float(hertz[-1]))
    plain_numbers(ax.xaxis)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"density of {coefficient_symbol(rows.target)} [1/Hz]")


def _correlations(own: Axes, with_phi: Axes, comparison: Comparison) -> list[str]:
    """Draw both correlations and return what they show."""
    styles = estimator_styles(result.name for result in comparison.results)
    limits, shown = [], []
    for result in comparison.results:
        itself, cross = _correlations_of(comparison, result)
        limits.append((itself.limit99, cross.limit99))
        look: dict[str, Any] = {
            "color": styles[result.name].colour,
            "marker": ".",
            "markersize": 3.5,
            "lw": 0.9,
        }
        for ax, correlation in ((own, itself), (with_phi, cross)):
            ax.plot(1e3 * correlation.lag_s, correlation.value, **look)
        outside = 100.0 * float(np.mean(np.abs(itself.value) > itself.limit99))
        shown.append(f"{result.label} {outside:.0f} % of its lags outside the band")
    for ax, limit in zip((own, with_phi), np.max(limits, axis=0), strict=True):
        ax.axhspan(-limit, limit, color="#dddddd", alpha=0.6, lw=0, zorder=0)
        ax.axhline(0.0, color=INK, lw=0.6)
        ax.set_xlabel("lag [ms]")
        ax.set_title("grey: 99 % band", fontsize=8.5, color=QUIET, loc="right", pad=3)
    own.set_ylabel("autocorrelation of\none-step errors [-]")
    with_phi.set_ylabel("correlation of one-step\n" + r"errors with $\varphi$ [-]")
    return shown


def _correlations_of(
    comparison: Comparison, result: EstimatorResult
) -> tuple[Correlation, Correlation]:
    """Return the autocorrelation of an estimator's one-step errors and that with φ."""
    rows, errors = comparison.rows, result.errors_one_step
    # Beyond half a segment few products are left, and the estimates fall to zero.
    typical = int(np.median([run.stop - run.start for run in rows.runs]))
    n_lags = max(FEWEST_LAGS, min(MOST_LAGS, typical // 2))
    return (
        error_correlation(errors, rows.runs, rows.sample_period_s, n_lags),
        error_correlation(errors, rows.runs, rows.sample_period_s, n_lags, phi=rows.phi),
    )
