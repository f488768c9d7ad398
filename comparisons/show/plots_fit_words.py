"""What the pictures of a comparison show, in numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from comparisons.harness.residual_analysis import segment_spectrum
from comparisons.results import Comparison, TauTrial, Truth, estimator_label
from comparisons.show.plots_fit import correlations_of
from surge_core.rounding import round_to_error, significant
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from comparisons.results import Reconstruction

__all__ = [
    "characteristics_words",
    "reconstruction_words",
    "residual_structure_words",
    "residuals_words",
    "tau_trial_words",
    "validation_words",
]

SYMBOLS = {"psi_p": "ψ'", "psi": "ψ"}


def characteristics_words(comparison: Comparison, truth: Truth | None = None) -> str:
    """Return what the characteristics show: their ends where φ dwells.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    truth : Truth, optional
        The characteristic of a simulated record.
    """
    ends = comparison.valid_phi
    told = []
    for result in comparison.results:
        phi, value, stderr = np.asarray(result.model.table).T
        values = (
            round_to_error(float(np.interp(end, phi, value)), float(np.interp(end, phi, stderr)))
            for end in ends
        )
        told.append(f"{result.label} {' and '.join(values)}")
    if truth is not None and truth.phi[0] <= ends[0] and ends[1] <= truth.phi[-1]:
        values = (
            significant(float(np.interp(end, truth.phi, truth.quasi_steady)), 3) for end in ends
        )
        told.append(f"{truth.label} {' and '.join(values)}")
    places = " and ".join(f"φ = {end:.3f}" for end in ends)
    return (
        f"Quasi-steady {SYMBOLS[comparison.rows.target]} over φ, with the histogram of φ. At "
        f"{places}, between which φ dwells: {'; '.join(told)}."
    )


def reconstruction_words(comparison: Comparison, record: int = 0) -> str:
    """Return what the free runs show on one record: errors, and where the best is most off.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    record : int
        Index of the record.
    """
    rows = comparison.rows
    own = rows.record == record
    best = comparison.result(comparison.table[0].estimator)
    time_s, measured = rows.time_s[own], rows.measured[own]
    errors = ", ".join(
        f"{result.label} {_rms(measured - result.trained[own])}" for result in comparison.results
    )
    return (
        f"Measured {SYMBOLS[rows.target]} of {comparison.records[record].source} from "
        f"{time_s[0]:.2f} to {time_s[-1]:.2f} s and its free runs by fits to the rows not held "
        f"out. rms of the error: {errors}. "
        f"{_worst_words(best.label, time_s, measured, best.trained[own])}"
    )


def residuals_words(comparison: Comparison) -> str:
    """Return what the errors of the free runs show over time.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    rows = comparison.rows
    told = []
    for result in comparison.results:
        error = rows.measured - result.reconstruction
        at = _largest(error)
        told.append(
            f"{result.label} {significant(result.free_run.rms, 2)}, at most "
            f"{significant(abs(float(error[at])), 2)} at {rows.time_s[at]:.2f} s"
        )
    return (
        f"Measured minus reconstructed {SYMBOLS[rows.target]} over time, one strip an estimator; "
        f"rms {'; '.join(told)}."
    )


def residual_structure_words(comparison: Comparison) -> str:
    """Return what the errors hold over frequency and over lags.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    rows = comparison.rows
    told = []
    for result, itself, cross in correlations_of(comparison):
        error = rows.measured - result.reconstruction
        spectrum = segment_spectrum(error, rows.runs, rows.sample_period_s)
        peak_hz = float(spectrum.frequency_hz[int(np.argmax(spectrum.density))])
        outside = 100.0 * float(np.mean(np.abs(itself.value) > itself.limit99))
        at = _largest(cross.value)
        if not math.isfinite(cross.value[at]):
            told.append(f"{result.label} not known")
            continue
        # A minus that stands for nothing reads badly.
        lag_ms = 1e3 * float(cross.lag_s[at]) + 0.0
        told.append(
            f"{result.label} strongest at {significant(peak_hz, 2)} Hz, {outside:.0f} % of its "
            f"lags outside the band, correlation with φ at most {cross.value[at]:+.2f} at "
            f"{lag_ms:g} ms"
        )
    return (
        f"Spectra of the free-run errors of {SYMBOLS[rows.target]} beside the measured signal; "
        f"autocorrelation of the one-step errors and their correlation with φ: {'; '.join(told)}."
    )


def tau_trial_words(trial: TauTrial) -> str:
    """Return what the error over the τ that is held shows.

    Parameters
    ----------
    trial : TauTrial
        Reconstruction error over τ.
    """
    low, high = (1e3 * edge for edge in trial.interval_s)
    found = ", ".join(
        f"{estimate.label} {1e3 * estimate.tau_s:.3g} ms" for estimate in trial.estimates
    )
    noise = (
        f"; the noise of the measurement is {significant(trial.noise_rms, 2)}"
        if math.isfinite(trial.noise_rms)
        else ""
    )
    return (
        f"Error of the free run of {SYMBOLS[trial.target]} over the τ that is held, "
        f"{1e3 * trial.tau_s[0]:.3g} to {1e3 * trial.tau_s[-1]:.3g} ms: least, "
        f"{significant(trial.least_rms, 3)}, at {1e3 * trial.best_tau_s:.3g} ms, no worse from "
        f"{low:.3g} to {high:.3g} ms{noise}." + (f" Found: {found}." if found else "")
    )


def validation_words(reconstructions: tuple[Reconstruction, ...]) -> str:
    """Return what free runs of models fitted elsewhere show.

    Parameters
    ----------
    reconstructions : tuple of Reconstruction
        One or several models on one record.
    """
    best = min(reconstructions, key=lambda run: run.score.rms)
    rows = best.rows
    label = estimator_label(best.model.estimator)
    scores = ", ".join(
        f"{estimator_label(run.model.estimator)} {significant(run.score.rms, 2)}"
        for run in reconstructions
    )
    return (
        f"Measured {SYMBOLS[rows.target]} of {best.record.source} and free runs of models fitted "
        f"elsewhere; rms {scores}. "
        f"{_worst_words(label, rows.time_s, rows.measured, best.reconstructed)} In "
        f"{100.0 * best.outside:.0f} % of the rows φ lies beyond where it dwelt in the fit."
    )


def _worst_words(
    label: str, time_s: FloatArray, measured: FloatArray, simulated: FloatArray
) -> str:
    at = _largest(measured - simulated)
    return (
        f"Measurement and {label} part most at {time_s[at]:.2f} s: "
        f"{significant(float(measured[at]), 3)} against {significant(float(simulated[at]), 3)}."
    )


def _largest(values: FloatArray) -> int:
    """Return where a signal is furthest from zero; a refused fit is known nowhere."""
    return int(np.argmax(np.where(np.isfinite(values), np.abs(values), -1.0)))


def _rms(error: FloatArray) -> str:
    return significant(float(np.sqrt(np.mean(error**2))), 2)
