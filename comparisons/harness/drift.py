"""What makes τ doubtful on the rows themselves: a slow drift, and φ and ψ' out of step."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from classic_ml.lag_regressor import LagRegressor
from comparisons.harness.fit_quality import rms
from comparisons.results import FitRows
from surge_core.fit_state import FitState
from surge_core.lag import Hold

__all__ = ["TAUS_A_KNOT", "Drift", "Misalignment", "drift_of", "misalignment"]

FALSE_ALARM = 0.01
# With knots five time constants apart the error of τ is twice that with knots of a second, with
# knots two apart six times (white noise, a well excited record).
TAUS_A_KNOT = 5.0
# A share of a sample is what the hold of φ between its samples is worth.
LEAST_DELAY_SAMPLES = 0.5
MARGIN_ROWS = 30
FEWEST_ROWS = 200


@dataclass(frozen=True)
class Drift:
    """What wanders slowly in a record.

    Parameters
    ----------
    rms : float
        Of the drift, in the unit of the coefficient.
    error_rms : float
        Of what lag and drift leave.
    time_s : float
        Time scale, rms over rms of the slope: T of exp(-t/T), 1/ω of a sine.
    tau_s, stderr_s : float
        τ of the fit with the drift, and its standard error, in seconds.
    knot_spacing_s : float
        Knots of the spline, in seconds.
    """

    rms: float
    error_rms: float
    time_s: float
    tau_s: float
    stderr_s: float
    knot_spacing_s: float

    @property
    def dominates(self) -> bool:
        """Whether the drift is larger than the errors: a smaller one moves no τ."""
        return self.rms > self.error_rms


@dataclass(frozen=True)
class Misalignment:
    """How much later ψ' follows φ than a lag says.

    Parameters
    ----------
    delay_s, stderr_s : float
        Dead time and its standard error, in seconds; negative where ψ' comes first.
    significant : bool
        Whether it is more than chance, and more than the hold of φ is worth.
    """

    delay_s: float
    stderr_s: float
    significant: bool


def drift_of(
    rows: FitRows, *, degree: int = 2, hold: Hold = "first", knot_spacing_s: float = 1.0
) -> Drift | None:
    """Fit output error with a slow spline and return what the spline took.

    Parameters
    ----------
    rows : FitRows
        The rows.
    degree : int
        Degree of the characteristic.
    hold : {"zero", "first"}
        How φ acts between samples.
    knot_spacing_s : float
        Knots of the spline, in seconds.

    Returns
    -------
    Drift or None
        None where that fit did not end well.
    """
    model = _with_drift(rows, degree=degree, hold=hold, knot_spacing_s=knot_spacing_s)
    if model.fit_state_ is not FitState.CONVERGED:
        return None
    fit = model.linearised(rows.X, rows.measured, rows.labels)
    slopes = [np.diff(fit.aside[p]) / rows.sample_period_s for p in fit.pieces]
    steepness = rms(np.concatenate(slopes))
    size = rms(fit.aside - np.mean(fit.aside))
    return Drift(
        size,
        rms(fit.errors),
        size / steepness if steepness > 0.0 else math.inf,
        float(model.time_constant_s_),
        float(model.time_constant_stderr_s_),
        knot_spacing_s,
    )


def misalignment(rows: FitRows, *, degree: int = 2, hold: Hold = "first") -> Misalignment | None:
    """Fit a dead time of either sign beside the lag, by output error with a drift.

    Parameters
    ----------
    rows : FitRows
        The rows.
    degree : int
        Degree of the characteristic.
    hold : {"zero", "first"}
        How φ acts between samples.

    Returns
    -------
    Misalignment or None
        None where the segments are too short for it or the fit did not end well.
    """
    from scipy.stats import norm, t

    shortest = min(run.stop - run.start for run in rows.runs)
    margin = min(MARGIN_ROWS, shortest // 25)
    if margin < 1 or rows.phi.size < FEWEST_ROWS:
        return None
    model = _with_drift(_late(rows, margin), degree=degree, hold=hold, dead_time_s="fit")
    if model.fit_state_ is not FitState.CONVERGED:
        return None
    n, tail = model.n_blocks_, 0.5 * FALSE_ALARM
    threshold = t.isf(tail, n - 1) if n > 1 else norm.isf(tail)
    delay_s = float(model.dead_time_s_) - margin * rows.sample_period_s
    stderr_s = float(model.dead_time_stderr_s_)
    least_s = max(threshold * stderr_s, LEAST_DELAY_SAMPLES * rows.sample_period_s)
    return Misalignment(delay_s, stderr_s, abs(delay_s) > least_s)


def _with_drift(rows: FitRows, **options: Any) -> LagRegressor:
    model = LagRegressor(rows.sample_period_s, noise="output-error", drift="spline", **options)
    return model.fit(rows.X, rows.measured, rows.labels)


def _late(rows: FitRows, margin: int) -> FitRows:
    """Let ψ' come some rows later than it did, so that a dead time of either sign is positive."""
    keep = np.zeros(rows.phi.size, dtype=np.bool_)
    for run in rows.runs:
        keep[run.start + margin : run.stop] = True
    earlier = np.maximum(np.arange(rows.phi.size) - margin, 0)
    return replace(rows, measured=rows.measured[earlier]).part(keep)
