"""τ by trial: the error of the reconstruction for each τ that is held fixed, as in the paper."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.characteristics import polynomial_basis
from classic_ml.emptied_band import emptied_above_hz
from comparisons.harness.fit_quality import block_errors, paired_difference
from comparisons.harness.rows import FitRows
from surge_core.errors import InputError
from surge_core.lag import FirstOrderLag, Hold
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from comparisons.harness.compare import Comparison

__all__ = [
    "TauEstimate",
    "TauTrial",
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


@dataclass(frozen=True)
class TauEstimate:
    """τ as an estimator found it.

    Parameters
    ----------
    name, label : str
        Key and what people call it.
    tau_s, stderr_s : float
        τ and its standard error, in seconds.
    rms : float
        Error of that estimator's own reconstruction, its curve and starts as in the comparison.
    """

    name: str
    label: str
    tau_s: float
    stderr_s: float
    rms: float


@dataclass(frozen=True)
class TauTrial:
    """Reconstruction error over τ.

    Parameters
    ----------
    tau_s : ndarray of shape (n,)
        Values at which τ was held, in seconds.
    refitted_rms : ndarray of shape (n,)
        Error of the free run with the curve refitted to each τ.
    held_rms : ndarray of shape (n,)
        The same with the curve of the best τ.
    best_tau_s : float
        τ of least error with a curve of its own, between the values by a parabola.
    interval_s : tuple of float
        Values of τ whose error exceeds the least by no more than two paired standard errors; an
        end that the values do not reach is that of the values.
    least_rms : float
        Error at the best τ: below it no lag with such a curve gets.
    noise_rms : float
        Standard deviation of the white noise on the measurement: below it no model gets. nan
        where a low-pass has taken the noise out of the band from which it is read.
    n_rows : int
        Rows that were scored.
    target : {"psi_p", "psi"}
        Which coefficient it is.
    estimates : tuple of TauEstimate
        What estimators found on the same rows.
    """

    tau_s: FloatArray
    refitted_rms: FloatArray
    held_rms: FloatArray
    best_tau_s: float
    interval_s: tuple[float, float]
    least_rms: float
    noise_rms: float
    n_rows: int
    target: str
    estimates: tuple[TauEstimate, ...] = ()

    def at(self, tau_s: float) -> float:
        """Return the error with a refitted curve at one τ, between the values by straight lines."""
        return float(np.interp(math.log(tau_s), np.log(self.tau_s), self.refitted_rms))


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
    scored: NDArray[np.bool_] | None = None,
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
    averaged = terms
    if terms is None:
        terms = np.asarray(polynomial_basis(degree).fit_transform(rows.X))
    if np.count_nonzero(keep) <= terms.shape[1] + 1:
        raise InputError(
            "τ by trial",
            expected=f"more than {terms.shape[1] + 1} scored rows",
            found=str(np.count_nonzero(keep)),
        )
    lags = [FirstOrderLag(float(tau), rows.sample_period_s, hold) for tau in taus]
    fits = [_refit(rows, terms, keep, lag) for lag in lags]
    refitted = np.array([_rms(error) for _, error in fits])
    best = int(np.argmin(refitted))
    curve = terms @ fits[best][0]
    held = np.array([_rms(_with_curve(rows, curve, keep, lag)) for lag in lags])
    best_tau = _vertex(taus, refitted, best)
    least = _rms(_refit(rows, terms, keep, FirstOrderLag(best_tau, rows.sample_period_s, hold))[1])
    return TauTrial(
        taus,
        refitted,
        held,
        best_tau,
        _interval(taus, best_tau, [error for _, error in fits], best, rows, keep),
        min(least, float(refitted[best])),
        # With inputs of another kind the rows are averages, whose noise is no longer white.
        _noise(rows) if averaged is None else math.nan,
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
        estimate = TauEstimate(
            result.name,
            result.label,
            result.model.time_constant_s,
            result.model.time_constant_stderr_s,
            whole.model_.residual_std_,
        )
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
        TauEstimate(
            result.name,
            result.label,
            result.model.time_constant_s,
            result.model.time_constant_stderr_s,
            result.free_run.rms,
        )
        for result in comparison.results
        if math.isfinite(result.model.time_constant_s)
    )


def _increasing(taus_s: ArrayLike) -> FloatArray:
    taus = np.atleast_1d(np.asarray(taus_s, dtype=np.float64))
    if (
        taus.ndim != 1
        or not np.all(np.isfinite(taus))
        or taus[0] <= 0.0
        or np.any(np.diff(taus) <= 0)
    ):
        raise InputError(
            "taus_s", expected="values above 0 that increase, in s", found=repr(taus_s)
        )
    return taus


def _refit(
    rows: FitRows, terms: FloatArray, keep: NDArray[np.bool_], lag: FirstOrderLag
) -> tuple[FloatArray, FloatArray]:
    """Return the curve's coefficients by least squares and the errors of the scored rows."""
    blocks = []
    for run in rows.runs:
        both = np.column_stack([rows.measured[run], lag.respond(terms[run], terms[run][0])])
        blocks.append(_without_start(both, lag, keep[run]))
    stacked = np.concatenate(blocks)
    coef = np.asarray(np.linalg.lstsq(stacked[:, 1:], stacked[:, 0])[0], dtype=np.float64)
    return coef, np.asarray(stacked[:, 0] - stacked[:, 1:] @ coef)


def _with_curve(
    rows: FitRows, curve: FloatArray, keep: NDArray[np.bool_], lag: FirstOrderLag
) -> FloatArray:
    """Return the errors of the scored rows with a curve held, the starts still free."""
    errors = []
    for run in rows.runs:
        error = rows.measured[run] - lag.respond(curve[run], curve[run][0])
        errors.append(_without_start(error[:, None], lag, keep[run])[:, 0])
    return np.concatenate(errors)


def _without_start(columns: FloatArray, lag: FirstOrderLag, keep: NDArray[np.bool_]) -> FloatArray:
    decay = lag.decay(columns.shape[0])[keep]
    rows = columns[keep]
    power = float(decay @ decay)
    return rows - np.outer(decay, decay @ rows / power) if power > 0.0 else rows


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _vertex(taus: FloatArray, rms: FloatArray, best: int) -> float:
    """Return the τ of least error, by the parabola of the squares over log τ."""
    if best in (0, taus.size - 1):
        return float(taus[best])
    x, y = np.log(taus[best - 1 : best + 2]), rms[best - 1 : best + 2] ** 2
    square, slope, _ = np.polyfit(x - x[1], y, 2)
    move = -0.5 * slope / square if square > 0.0 else 0.0
    return float(np.exp(x[1] + np.clip(move, x[0] - x[1], x[2] - x[1])))


def _interval(
    taus: FloatArray,
    best_tau: float,
    errors: list[FloatArray],
    best: int,
    rows: FitRows,
    keep: NDArray[np.bool_],
) -> tuple[float, float]:
    """Return the values whose error is within two paired standard errors of the least."""
    whole = np.zeros(rows.phi.size)

    def blocks(error: FloatArray) -> FloatArray:
        whole[keep] = error
        return block_errors(whole, rows.runs, keep)

    reference = blocks(errors[best])
    near = []
    for error in errors:
        difference, paired = paired_difference(blocks(error), reference)
        near.append(difference <= 2.0 * paired)
    low = high = best
    while low > 0 and near[low - 1]:
        low -= 1
    while high < taus.size - 1 and near[high + 1]:
        high += 1
    return min(float(taus[low]), best_tau), max(float(taus[high]), best_tau)


def _noise(rows: FitRows) -> float:
    """Return the white noise on the measurement, from its third differences."""
    if emptied_above_hz(rows.measured, rows.labels, sample_period_s=rows.sample_period_s):
        return math.nan
    # Their variance is 1 + 9 + 9 + 1 times that of white noise; a smooth signal hardly shows.
    parts = [np.diff(rows.measured[run], n=3) for run in rows.runs if run.stop - run.start > 3]
    if not parts:
        return math.nan
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2) / 20.0))
