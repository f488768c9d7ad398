"""τ by trial: the error of the reconstruction for each τ that is held fixed, as in the paper."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.emptied_band import emptied_above_hz
from comparisons.harness.fit_quality import block_errors, paired_difference, rms
from comparisons.results import Comparison, FitRows, TauEstimate, TauTrial
from surge_core.errors import InputError
from surge_core.lag import FirstOrderLag, Hold
from surge_core.types import BoolArray, FloatArray

__all__ = [
    "estimates_of",
    "parse_tau",
    "reconstruction_error_over_tau",
    "trial_of",
    "trial_taus",
]

N_TAUS = 61
# Half a decade and more to either side shows both arms of the curve.
REACH = 4.0
LONGEST_TAU_S = 10.0
RUN_AWAY_S = 1.0
_TAU = re.compile(r"([0-9.eE+-]+)\s*(s|ms|us|µs)?")
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}


def parse_tau(text: str) -> float:
    """Read a time constant as a user writes it.

    Parameters
    ----------
    text : str
        A number with a unit, ``18ms`` or ``0.018 s``, or a plain number of seconds.

    Returns
    -------
    float
        In seconds.

    Raises
    ------
    InputError
        When it is no number, has another unit, or no compressor has such a τ: a plain ``18`` is
        18 ms without its unit, not 18 s.
    """
    expected = "a time constant such as 18ms or 0.018 (seconds)"
    match = _TAU.fullmatch(text.strip())
    try:
        value = float(match.group(1)) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or not math.isfinite(value):
        raise InputError("--tau", expected=expected, found=repr(text))
    seconds = value * _UNITS[match.group(2) or "s"]
    if not 0.0 < seconds <= LONGEST_TAU_S:
        remedy = f"write {text.strip()}ms if milliseconds are meant" if value > 0.0 else ""
        raise InputError(
            "--tau",
            expected=f"{expected}, above 0 and up to {LONGEST_TAU_S:g} s",
            found=f"{seconds:g} s",
            remedy="" if match.group(2) else remedy,
        )
    return seconds


def trial_taus(*around_s: float, n: int = N_TAUS) -> FloatArray:
    """Return values of τ spaced evenly on a log scale around some estimates.

    Parameters
    ----------
    around_s : float
        Estimates; those that are not finite or longer than a second do not count.
    n : int
        How many values.
    """
    # A τ of many seconds is a fit that ran away; it must not stretch the axis.
    known = [tau for tau in around_s if 0.0 < tau <= RUN_AWAY_S] or [0.018]
    return np.geomspace(min(known) / REACH, max(known) * REACH, n)


def reconstruction_error_over_tau(
    rows: FitRows,
    taus_s: ArrayLike | None = None,
    *,
    degree: int = 2,
    hold: Hold = "first",
    scored: BoolArray | None = None,
    terms: FloatArray | None = None,
    estimates: Sequence[TauEstimate] = (),
) -> TauTrial:
    """Reconstruct with each τ in turn and score the free run.

    Parameters
    ----------
    rows : FitRows
        The rows, e.g. ``comparison.rows``.
    taus_s : array-like of shape (n,), optional
        Values of τ, in seconds and increasing; without them, around the estimates.
    degree : int
        Degree of the characteristic that is refitted.
    hold : {"zero", "first"}
        How φ acts between samples.
    scored : ndarray of bool, shape (n_rows,), optional
        Rows that count; the others are simulated through. All without it.
    terms : ndarray of shape (n_rows, q), optional
        Inputs of the lag in place of the powers of φ.
    estimates : sequence of TauEstimate
        What estimators found, see :func:`estimates_of`.

    Returns
    -------
    TauTrial

    Raises
    ------
    InputError
        When the values of τ do not increase from above zero, or nothing is scored.

    Notes
    -----
    For a held τ the free run is linear in the curve's coefficients and in the start of each
    segment, and least squares gives both at once (the paper set τ by trial, after its fit had
    given 243 ms where 18 ms reconstructs).
    """
    taus = trial_taus(*(e.tau_s for e in estimates)) if taus_s is None else _increasing(taus_s)
    keep = np.ones(rows.phi.size, dtype=np.bool_) if scored is None else scored
    inputs = np.vander(rows.phi, degree + 1, increasing=True) if terms is None else terms
    if np.count_nonzero(keep) <= inputs.shape[1] + 1:
        raise InputError(
            "τ by trial",
            expected=f"more than {inputs.shape[1] + 1} scored rows",
            found=str(np.count_nonzero(keep)),
        )

    def refitted_at(tau_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the curve's coefficients by least squares, and the errors."""
        measured, answers = _scored(rows, inputs, keep, tau_s, hold)
        coef = np.asarray(np.linalg.lstsq(answers, measured)[0])
        return coef, measured - answers @ coef

    fits = [refitted_at(tau_s) for tau_s in taus]
    errors = [error for _, error in fits]
    refitted = np.array([rms(error) for error in errors])
    best = int(np.argmin(refitted))
    curve = (inputs @ fits[best][0])[:, None]
    held = []
    for tau_s in taus:
        measured, answers = _scored(rows, curve, keep, tau_s, hold)
        held.append(rms(measured - answers[:, 0]))
    best_tau = _vertex(taus, refitted, best)
    return TauTrial(
        taus,
        refitted,
        np.array(held),
        best_tau,
        _interval(taus, best_tau, errors, best, rows, keep),
        min(rms(refitted_at(best_tau)[1]), float(refitted[best])),
        # With inputs of another kind the rows are averages, whose noise is no longer white.
        _noise(rows) if terms is None else math.nan,
        int(np.count_nonzero(keep)),
        rows.target,
        tuple(estimates),
    )


def trial_of(comparison: Comparison) -> TauTrial:
    """Try τ over the rows of a comparison, or over its whole runs where it has such a fit.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.

    Returns
    -------
    TauTrial
        Of whole runs, on averaged unfiltered signals with the estimate from them alone: the other
        estimators saw other rows.
    """
    hold = comparison.results[0].model.hold
    for result in comparison.results:
        whole = result.whole_run
        if whole is None or not math.isfinite(result.model.time_constant_s):
            continue
        inputs, scored = whole.stacked()
        estimate = replace(result.estimate, rms=whole.model_.residual_std_)
        rows = FitRows(
            inputs.phi,
            inputs.psi_p,
            inputs.time_s,
            inputs.run,
            inputs.run,
            comparison.rows.sample_period_s,
            "psi_p",
            np.ones(inputs.phi.size, dtype=np.bool_),
        )
        return reconstruction_error_over_tau(
            rows, hold=hold, scored=scored, terms=inputs.terms, estimates=(estimate,)
        )
    powers = [term for term in comparison.results[0].model.terms if term.startswith("phi")]
    return reconstruction_error_over_tau(
        comparison.rows,
        degree=max(len(powers), 1),
        hold=hold,
        estimates=estimates_of(comparison),
    )


def estimates_of(comparison: Comparison) -> tuple[TauEstimate, ...]:
    """Return the τ of each estimator of a comparison that found one."""
    return tuple(
        result.estimate
        for result in comparison.results
        if math.isfinite(result.model.time_constant_s)
    )


def _increasing(taus_s: ArrayLike) -> FloatArray:
    taus = np.atleast_1d(np.asarray(taus_s, dtype=np.float64))
    steps = np.diff(np.concatenate([[0.0], taus.ravel()]))
    if taus.ndim != 1 or not np.all(np.isfinite(steps) & (steps > 0.0)):
        raise InputError(
            "taus_s", expected="values above 0 that increase, in s", found=repr(taus_s)
        )
    return taus


def _scored(
    rows: FitRows, inputs: FloatArray, keep: BoolArray, tau_s: float, hold: Hold
) -> tuple[FloatArray, FloatArray]:
    """Return ψ' and the lag's answers to the inputs on scored rows, a free start taken out."""
    lag = FirstOrderLag(float(tau_s), rows.sample_period_s, hold)
    blocks = []
    for run in rows.runs:
        answers = lag.respond(inputs[run], inputs[run][0])
        columns = np.column_stack([rows.measured[run], answers])[keep[run]]
        decay = lag.decay(run.stop - run.start)[keep[run]]
        power = float(decay @ decay)
        # What any start would add to each column.
        own = np.outer(decay, decay @ columns / power) if power > 0.0 else 0.0
        blocks.append(columns - own)
    stacked = np.concatenate(blocks)
    return stacked[:, 0], stacked[:, 1:]


def _vertex(taus: FloatArray, error: FloatArray, best: int) -> float:
    """Return the τ of least error, by the parabola of the squares over log τ."""
    if best in (0, taus.size - 1):
        return float(taus[best])
    x, y = np.log(taus[best - 1 : best + 2]), error[best - 1 : best + 2] ** 2
    square, slope, _ = np.polyfit(x - x[1], y, 2)
    move = -0.5 * slope / square if square > 0.0 else 0.0
    return float(np.exp(x[1] + np.clip(move, x[0] - x[1], x[2] - x[1])))


def _interval(
    taus: FloatArray,
    best_tau: float,
    errors: list[FloatArray],
    best: int,
    rows: FitRows,
    keep: BoolArray,
) -> tuple[float, float]:
    """Return the values whose error is within two paired standard errors of the least."""
    whole = np.zeros(rows.phi.size)
    blocks = []
    for error in errors:
        whole[keep] = error
        blocks.append(block_errors(whole, rows.runs, keep))
    near = []
    for own in blocks:
        difference, paired = paired_difference(own, blocks[best])
        near.append(difference <= 2.0 * paired)
    far = np.flatnonzero(~np.array([*near[:best], True, *near[best + 1 :]]))
    low = int(far[far < best].max(initial=-1)) + 1
    high = int(far[far > best].min(initial=taus.size)) - 1
    return min(float(taus[low]), best_tau), max(float(taus[high]), best_tau)


def _noise(rows: FitRows) -> float:
    """Return the white noise on the measurement, from its third differences."""
    if emptied_above_hz(rows.measured, rows.labels, sample_period_s=rows.sample_period_s):
        return math.nan
    # Their variance is 1 + 9 + 9 + 1 times that of white noise; a smooth signal hardly shows.
    steps = np.concatenate([np.diff(rows.measured[run], n=3) for run in rows.runs])
    return rms(steps) / math.sqrt(20.0) if steps.size else math.nan
