"""The report's pictures, each with what it shows and how to read it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.page.blocks import Block, Picture, Words
from comparisons.results import Comparison, Truth
from comparisons.show.report.agreement import dwelling_words
from comparisons.show.report.tables import validation_table
from comparisons.show.report.words import coefficient_name

if TYPE_CHECKING:
    from classic_ml.reduction import Reduction
    from comparisons.results import Reconstruction
    from comparisons.show.report.report import ReportSection

__all__ = [
    "characteristic_picture",
    "migration_pictures",
    "reconstruction_pictures",
    "residual_pictures",
    "spectra_pictures",
    "time_pictures",
    "trial_picture",
    "validation_picture",
]

# Of many records fitted together the first few are drawn; the tables hold all.
RECORDS_DRAWN = 4


def migration_pictures(section: ReportSection) -> tuple[Block, ...]:
    """Return the operating points of the reduced record, or the loops over φ of its series.

    Parameters
    ----------
    section : ReportSection
        The section.
    """
    if section.reduction is not None:
        return _operating_points(section.reduction)
    fits = [fit for fit in (section.comparison, section.work) if fit is not None]
    blocks: list[Block] = []
    for fit in fits:
        blocks += [_loops(series, fit.rows.target) for series in fit.records[:RECORDS_DRAWN]]
    return (*blocks, *_left_out(fits[0].records)) if fits else ()


def time_pictures(section: ReportSection) -> tuple[Block, ...]:
    """Return the surge cycles of the reduced record, or φ and the coefficients of its series.

    Parameters
    ----------
    section : ReportSection
        The section.
    """
    from comparisons.show.plots_record import plot_series, plot_surge_cycles
    from comparisons.show.plots_record_words import series_words, surge_cycles_words

    if section.reduction is not None:
        return (
            Picture.of(
                "Quasi-steady surge cycles",
                plot_surge_cycles(section.reduction),
                surge_cycles_words(section.reduction),
                "As Fig 12, 13 and 16 to 19 of the paper. A cycle starts at stall: flow and exit "
                "pressure collapse and the flow reverses; inlet temperature rises in stall and "
                "falls as the machine recovers; corrected speed mirrors it. "
                + _unstalled_words(section.reduction)
                + "A slow slope of temperature or speed over the cycles is the facility, "
                "not the compressor.",
            ),
        )
    fit = section.comparison or section.work
    if fit is None:
        return ()
    pictures = [
        Picture.of(
            f"φ and the coefficients in time, {series.source}",
            plot_series(series),
            series_words(series),
            "Blue: rows in the intervals to be fitted; grey: the rest. Of a long record only the "
            "first seconds from the first interval on are drawn. A gap in ψ marks flow too small "
            "or reversed, where it is not known.",
        )
        for series in fit.records[:RECORDS_DRAWN]
    ]
    return (*pictures, *_left_out(fit.records))


def spectra_pictures(section: ReportSection) -> tuple[Block, ...]:
    """Return the spectra before and after the filter, which only a reduction knows.

    Parameters
    ----------
    section : ReportSection
        The section.
    """
    from comparisons.show.plots_record import plot_inlet_spectra
    from comparisons.show.plots_record_words import filter_words, inlet_spectra_words

    if section.reduction is None:
        return ()
    return (
        Picture.of(
            "Inlet total pressure and corrected flow",
            plot_inlet_spectra(section.reduction),
            inlet_spectra_words(section.reduction),
            "As Fig 4 to 6 of the paper, over the quasi-steady window, first-order trend removed. "
            f"Here: {filter_words(section.reduction)}. The comb at low frequency is the surge "
            "cycle and its harmonics; the peak at 82.5 Hz and its harmonic are rotating stall "
            "cells, which a one-dimensional model cannot use. In the flow the filter attenuates "
            "less, and above the cut-off it can add: the flow is a square root of the filtered "
            "pressures, and that makes new harmonics.",
        ),
    )


def characteristic_picture(fit: Comparison, truth: Truth | None) -> Picture:
    """Return the characteristics of all estimators over the histogram of φ.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    truth : Truth or None
        Of a simulated record.
    """
    from comparisons.show.plots_fit import plot_characteristics
    from comparisons.show.plots_fit_words import characteristics_words

    known = "" if truth is None else f" Dotted black: {truth.label}."
    return Picture.of(
        f"Quasi-steady {coefficient_name(fit)}",
        plot_characteristics(fit, truth),
        characteristics_words(fit, truth),
        "As Fig 23 to 26 of the paper. Bands are ± 2 standard errors of scatter. Shaded: where φ "
        "dwells, from its 5th to its 95th percentile; beyond it curves are faint. "
        + dwelling_words(fit)
        + known,
    )


def reconstruction_pictures(fit: Comparison) -> tuple[Block, ...]:
    """Return the free runs against the measurement, one picture a record.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    from comparisons.show.plots_fit import plot_reconstruction
    from comparisons.show.plots_fit_words import reconstruction_words

    drawn = [i for i in range(len(fit.records)) if np.any(fit.rows.record == i)][:RECORDS_DRAWN]
    best = fit.table[0]
    pictures = [
        Picture.of(
            f"Reconstructed {coefficient_name(fit)}, {fit.records[index].source}",
            plot_reconstruction(fit, index),
            reconstruction_words(fit, index),
            f"As Fig 27 of the paper. Above: {best.label}, the least held-out error; below: all "
            "estimators around the border to the held-out cycles. A free run knows the measured "
            "flow, and of the measured coefficient only the first row of each segment. Shaded "
            "cycles were held out: the lines drawn are of a fit to the other cycles alone.",
        )
        for index in drawn
    ]
    return (*pictures, *_left_out(fit.records))


def residual_pictures(fit: Comparison) -> tuple[Block, ...]:
    """Return the residuals over time, over frequency and over lags.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    from comparisons.show.plots_fit import plot_residual_structure, plot_residuals
    from comparisons.show.plots_fit_words import residual_structure_words, residuals_words

    name = coefficient_name(fit)
    return (
        Picture.of(
            f"Free-run errors in time, {name}",
            plot_residuals(fit),
            residuals_words(fit),
            "All strips have one scale. What repeats in every cycle is structure that the model "
            "lacks, not noise; a level that wanders over the cycles is drift.",
        ),
        Picture.of(
            f"Structure of the residuals, {name}",
            plot_residual_structure(fit),
            residual_structure_words(fit),
            "Above: where an error's spectrum lies far below the grey signal the model explains "
            "that frequency; where it lies in the grey band it explains nothing. Below left: "
            "one-step errors should stay inside the grey band at 99 % of the lags; on data that "
            "were low-passed they do not. Below right: positive lags are errors that follow φ. "
            "What leaves the band there, φ could still explain: the characteristic, the lag or the "
            "alignment of φ lacks something. The grey band is the widest of the estimators'.",
        ),
    )


def trial_picture(fit: Comparison, truth: Truth | None) -> tuple[Block, ...]:
    """Return the reconstruction error over the τ that is held, as the paper had to try it.

    Parameters
    ----------
    fit : Comparison
        Of the pressure coefficient.
    truth : Truth or None
        Marked where it is known.
    """
    from comparisons.harness.tau_trial import trial_of
    from comparisons.show.plots_fit_words import tau_trial_words
    from comparisons.show.plots_tau_trial import plot_tau_trial

    trial = trial_of(fit)
    where = (
        "the scored rows of the free run through the unfiltered signals"
        if fit.has_whole_run
        else "the fitted rows, from each segment's own start"
    )
    true_s = truth.time_constant_s if truth else None
    return (
        Picture.of(
            "Reconstruction error over τ",
            plot_tau_trial(trial, true_s, marked_as="truth"),
            tau_trial_words(trial),
            f"Scored on {where}. "
            "As the paper found its 18 ms, by trial. A flat bottom says that the record hardly "
            "tells τ; a least error far from an estimate says that the two answer different "
            "questions. `compare --tau` holds a value.",
        ),
    )


def validation_picture(runs: tuple[Reconstruction, ...]) -> tuple[Block, ...]:
    """Return models fitted elsewhere against other records: pictures and a table.

    Parameters
    ----------
    runs : tuple of Reconstruction
        Models and the records they were run on.
    """
    from comparisons.show.plots_fit import plot_validation
    from comparisons.show.plots_fit_words import validation_words

    groups: dict[tuple[str, str], list[Reconstruction]] = {}
    for run in runs:
        groups.setdefault((run.record.source, run.model.target), []).append(run)
    blocks: list[Block] = []
    for (source, target), members in groups.items():
        symbol = "ψ'" if target == "psi_p" else "ψ"
        blocks.append(
            Picture.of(
                f"Validation on {source}: {symbol}",
                plot_validation(tuple(members)),
                validation_words(tuple(members)),
                "Nothing was fitted to this record. Above the model with the least error over the "
                "whole record, below all models in its middle. Shaded: φ beyond where it dwelt in "
                "the fit (5th to 95th percentile), where the reconstruction rests on extrapolated "
                "curves.",
            )
        )
    if runs:
        blocks.append(validation_table(runs))
    return tuple(blocks)


def _operating_points(reduction: Reduction) -> tuple[Block, ...]:
    from comparisons.show.plots_record import plot_hub_and_tip, plot_operating_points
    from comparisons.show.plots_record_words import hub_and_tip_words, operating_points_words

    blocks: list[Block] = [
        Picture.of(
            "Face average",
            plot_operating_points(reduction),
            operating_points_words(reduction),
            "As Fig 9 (left) and Fig 11 (right) of the paper. The star marks the highest pressure "
            "ratio before the first stall. From there the machine reverses, blows down at reversed "
            "flow and settles into cycles that need not return to the first stall point: the "
            "heated inlet drives corrected speed down.",
        )
    ]
    figure = plot_hub_and_tip(reduction)
    if figure is not None:
        blocks.append(
            Picture.of(
                "Tip and hub",
                figure,
                hub_and_tip_words(reduction),
                "As Fig 14 and 15 of the paper. Flow at the tip reverses further than at the hub: "
                "the reversal is not axisymmetric, and an average of both hides it.",
            )
        )
    return tuple(blocks)


def _unstalled_words(reduction: Reduction) -> str:
    in_stall = reduction.series.in_stall
    if in_stall is None or bool(np.all(in_stall[reduction.record["window"] > 0.5])):
        return "The machine is in stall throughout the window. "
    return "Shaded: unstalled, not fitted. "


def _loops(series: CoefficientSeries, target: str) -> Picture:
    from comparisons.show.plots_record import plot_loops
    from comparisons.show.plots_record_words import loops_words

    symbol = "ψ'" if target == "psi_p" else "ψ"
    return Picture.of(
        f"{symbol} over φ, {series.source}",
        plot_loops(series, target),
        loops_words(series, target),
        "The record came as coefficients, so that pressure ratio and flow are not known. A loop "
        "that is open is lag: at one φ the coefficient is higher on the way down than on the way "
        "up, or the other way round. Blue: intervals that are fitted.",
    )


def _left_out(records: tuple[CoefficientSeries, ...]) -> tuple[Words, ...]:
    if len(records) <= RECORDS_DRAWN:
        return ()
    return (
        Words(f"The first {RECORDS_DRAWN} of {len(records)} records are drawn; all were fitted."),
    )
