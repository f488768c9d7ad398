"""Warnings about a fitted τ, in words: drift, noise models that disagree, unlike filters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from classic_ml.emptied_band import emptied_above_hz
from classic_ml.lag_regressor import LagRegressor
from classic_ml.records import LedgerEntry
from comparisons.harness.rows import FitRows
from comparisons.harness.tau_trial import TauEstimate
from surge_core.fit_state import FitState
from surge_core.lag import Hold
from surge_core.segments import runs_of
from surge_core.types import FloatArray

__all__ = [
    "Drift",
    "Misalignment",
    "drift_of",
    "drift_warnings",
    "filter_warnings",
    "ledger_filters",
    "misalignment",
    "noise_model_warnings",
]

FALSE_ALARM = 0.01
# With knots five time constants apart the error of τ is twice that with knots of a second, with
# knots two apart six times (white noise, a well excited record).
TAUS_A_KNOT = 5.0
# A drift lengthens τ; arx and armax go up with its size where output error still holds.
LONGER = 1.15
# Below this share of the errors a drift moves no τ.
DOMINATES = 1.0
LEAST_DRIFT_S = 5.0
# Corners this far apart are two filters: of one filter, corners are read up to twice apart.
CORNER_RATIO = 2.5
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
        """Whether the drift is larger than the errors."""
        return self.rms > DOMINATES * self.error_rms


@dataclass(frozen=True)
class Misalignment:
    """How much later ψ' follows φ than a lag says.

    Parameters
    ----------
    delay_s, stderr_s : float
        Dead time and its standard error, in seconds; negative where ψ' comes first.
    threshold : float
        Standard errors beyond which it is significant.
    sample_period_s : float
        Sample period, in seconds.
    """

    delay_s: float
    stderr_s: float
    threshold: float
    sample_period_s: float

    @property
    def significant(self) -> bool:
        """Whether it is more than chance, and more than the hold of φ is worth."""
        return (
            abs(self.delay_s) > self.threshold * self.stderr_s
            and abs(self.delay_s) > LEAST_DELAY_SAMPLES * self.sample_period_s
        )


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
    model = LagRegressor(
        rows.sample_period_s,
        noise="output-error",
        drift="spline",
        degree=degree,
        hold=hold,
        knot_spacing_s=knot_spacing_s,
    ).fit(rows.X, rows.measured, rows.labels)
    if model.fit_state_ is not FitState.CONVERGED:
        return None
    fit = model.linearised(rows.X, rows.measured, rows.labels)
    slopes = [np.diff(fit.aside[p]) / rows.sample_period_s for p in fit.pieces]
    steepness = _rms(np.concatenate(slopes))
    size = _rms(fit.aside - np.mean(fit.aside))
    return Drift(
        size,
        _rms(fit.errors),
        size / steepness if steepness > 0.0 else math.inf,
        float(model.time_constant_s_),
        float(model.time_constant_stderr_s_),
        knot_spacing_s,
    )


def drift_warnings(estimates: Sequence[TauEstimate], drift: Drift | None) -> tuple[str, ...]:
    """Warn where τ nears the time scale of a drift, or moves once the drift is modelled.

    Parameters
    ----------
    estimates : sequence of TauEstimate
        τ of each estimator.
    drift : Drift or None
        From :func:`drift_of`.

    Returns
    -------
    tuple of str
        One sentence an estimator and finding; none where there is nothing to say.
    """
    if drift is None:
        return ()
    words = []
    own_upper = drift.tau_s + 2.0 * drift.stderr_s
    if own_upper * TAUS_A_KNOT > drift.knot_spacing_s:
        words.append(
            f"τ of {_ms(drift.tau_s)} is not short against the {drift.knot_spacing_s:g} s between "
            "the knots of the drift, which takes up much of what tells τ: set the knots "
            f"{TAUS_A_KNOT:g} or more time constants apart"
        )
    if not drift.dominates:
        return tuple(words)
    # The error of a fit without the drift is blown up by the drift: that of the fit with it counts.
    moved = max(LONGER * drift.tau_s, drift.tau_s + _beyond(1) * drift.stderr_s)
    for estimate in estimates:
        if not math.isfinite(estimate.tau_s):
            continue
        if estimate.tau_s * LEAST_DRIFT_S > drift.time_s:
            words.append(
                f"{estimate.label}: τ of {_ms(estimate.tau_s)} nears the {drift.time_s:.2g} s over "
                "which the level drifts: it may be the drift's time and not the compressor's"
            )
        elif estimate.tau_s > moved:
            words.append(
                f"{estimate.label}: τ is {_ms(estimate.tau_s)} without and {_ms(drift.tau_s)} with "
                f"a slow drift of the level ({drift.rms:.2g} rms against errors of "
                f"{drift.error_rms:.2g}): the drift is read as lag"
            )
    return tuple(words)


def noise_model_warnings(estimates: Sequence[TauEstimate]) -> tuple[str, ...]:
    """Warn where noise models put τ further apart than their errors allow.

    Parameters
    ----------
    estimates : sequence of TauEstimate
        Of arx, armax and output error on the same rows.

    Returns
    -------
    tuple of str
        One sentence with all pairs that part, or nothing.

    Notes
    -----
    |τ₁ - τ₂| is held against √(s₁² + s₂²) times the 1 % point for as many pairs. The errors of
    the two stem from the same rows and mostly cancel in the difference, so that false alarms are
    rarer than that.
    """
    known = [e for e in estimates if math.isfinite(e.tau_s) and math.isfinite(e.stderr_s)]
    pairs = list(combinations(known, 2))
    apart = [
        (one, two)
        for one, two in pairs
        if abs(one.tau_s - two.tau_s) > _beyond(len(pairs)) * math.hypot(one.stderr_s, two.stderr_s)
    ]
    if not apart:
        return ()
    said = "; ".join(
        f"{one.label} {_ms(one.tau_s)} against {two.label} {_ms(two.tau_s)}" for one, two in apart
    )
    return (
        f"noise models disagree on τ by more than their errors allow ({said}): at most one of "
        "them is right about the errors, and where none passes the whiteness check none may be; "
        "output error with a drift holds whatever the errors' colour",
    )


def ledger_filters(history: Iterable[LedgerEntry]) -> tuple[str, ...]:
    """Return the low-passes that a record's ledger shows, each once.

    Parameters
    ----------
    history : iterable of LedgerEntry
        Ledger of a record.
    """
    found = [
        f"{entry.parameters['phase']} order {entry.parameters.get('order', '?')} at "
        f"{entry.parameters['cutoff_hz']:g} Hz"
        for entry in history
        if entry.step == "filter"
        and entry.parameters.get("phase") not in (None, "none")
        and isinstance(entry.parameters.get("cutoff_hz"), int | float)
    ]
    return tuple(dict.fromkeys(found))


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
    late = _late(rows, margin)
    model = LagRegressor(
        late.sample_period_s,
        noise="output-error",
        drift="spline",
        degree=degree,
        hold=hold,
        dead_time_s="fit",
    ).fit(late.X, late.measured, late.labels)
    if model.fit_state_ is not FitState.CONVERGED:
        return None
    n = model.n_blocks_
    tail = 0.5 * FALSE_ALARM
    return Misalignment(
        float(model.dead_time_s_) - margin * rows.sample_period_s,
        float(model.dead_time_stderr_s_),
        float(t.isf(tail, n - 1) if n > 1 else norm.isf(tail)),
        rows.sample_period_s,
    )


def filter_warnings(
    rows: FitRows,
    histories: Iterable[Iterable[LedgerEntry]] = (),
    *,
    degree: int = 2,
    hold: Hold = "first",
) -> tuple[str, ...]:
    """Warn where ψ' and φ seem to have passed different filters.

    Parameters
    ----------
    rows : FitRows
        The rows.
    histories : iterable of iterable of LedgerEntry
        Ledgers of the records.
    degree : int
        Degree of the characteristic.
    hold : {"zero", "first"}
        How φ acts between samples.

    Returns
    -------
    tuple of str
        From the ledgers, from the corners of the two spectra, and from a dead time.
    """
    words = []
    for history in histories:
        filters = ledger_filters(history)
        if len(filters) > 1:
            words.append(
                f"the ledger shows {len(filters)} different low-passes ({'; '.join(filters)}): "
                "unless each went over all channels, φ and ψ' were filtered differently"
            )
    words += _unlike_corners(rows)
    found = misalignment(rows, degree=degree, hold=hold)
    if found is not None and found.significant:
        first, second = ("ψ'", "φ") if found.delay_s > 0.0 else ("φ", "ψ'")
        words.append(
            f"{first} comes {_ms(abs(found.delay_s))} ± {_ms(found.stderr_s)} later than the lag "
            f"on {second} says: filtered differently, misaligned, or a lag of higher order; that "
            "much delay moves τ by as much or more"
        )
    return tuple(dict.fromkeys(words))


def _unlike_corners(rows: FitRows) -> list[str]:
    corners = [
        emptied_above_hz(signal, rows.labels, sample_period_s=rows.sample_period_s)
        for signal in (rows.measured, rows.phi)
    ]
    own, other = corners
    # A φ without noise is empty by itself: that alone says nothing of a filter.
    if own is None or (other is not None and max(own / other, other / own) < CORNER_RATIO):
        return []
    if other is not None and other < own:
        return []
    beside = "that of φ is not" if other is None else f"that of φ from {other:.2g} Hz on"
    return [
        f"the spectrum of ψ' is emptied from {own:.2g} Hz on, {beside}: ψ' was low-passed and φ "
        "was not, or differently; filter ψ' and every s_i(φ) alike"
    ]


def _late(rows: FitRows, margin: int) -> FitRows:
    """Let ψ' come some rows later than it did, so that a dead time of either sign is positive."""
    keep = np.zeros(rows.phi.size, dtype=np.bool_)
    at = np.arange(rows.phi.size)
    for run in runs_of(rows.labels, rows.labels.size):
        keep[run.start + margin : run.stop] = True
    measured = np.asarray(rows.measured[np.maximum(at - margin, 0)])
    return replace(rows, measured=measured).part(keep)


def _beyond(n_tests: int) -> float:
    from scipy.stats import norm

    return float(norm.isf(0.5 * FALSE_ALARM / n_tests))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
