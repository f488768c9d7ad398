"""The lag model by one free run through whole records, from unfiltered signals.

This is the estimate that reads τ right on a record that passed the whole sensor chain. Four things
change together against the classical fit: the run is simulated (output error), rows where the
model does not hold are simulated through but not scored, φ and ψ' come from unfiltered pressures
and are averaged last, alike, over one period of the stall cells, and the inputs act as straight
lines between samples. Any one of them alone makes τ worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.characteristics import polynomial_basis, term_names
from classic_ml.errors import InputError
from classic_ml.filtering import period_average
from classic_ml.first_order_lag import Hold
from classic_ml.fit_state import FitState
from classic_ml.lag_model import LagRegressor
from classic_ml.leverage import linearised_fit
from classic_ml.records import FloatArray
from classic_ml.residual_checks import (
    CheckRow,
    coverage,
    input_correlation,
    leverage,
    normality,
)
from classic_ml.runs import runs_of
from classic_ml.series import CoefficientSeries

__all__ = [
    "StackedRuns",
    "WholeRunFit",
    "WholeRunRows",
    "fit_whole_runs",
    "has_whole_run",
    "whole_run_rows",
]

# Where the line of the unstalled branch is levelled, the same for all records of a fit.
UNSTALLED_PHI = 0.25
# The slowest cells that turn, some 10 Hz: a longer average would be one over surge itself.
LONGEST_AVERAGE_S = 0.1
# A filtered signal and its original agree to 0.9 and more, even under strong stall cells.
LEAST_LIKENESS = 0.5
# Width of the average that tells the reversed flow behind the loss term, in seconds.
LOSS_AVERAGE_S = 0.005
# Errors that all cycles of a record share and no jackknife over cycles sees: the calibration
# readings, the rectified noise of probes near zero flow, rows at the edge of the model. Set so
# that the stated intervals hold the truth as often as they say (benchmarks/tau_on_the_rig.py).
COMMON_TAU_SHARE = 0.025
COMMON_CURVE_SHARE = 0.025
# Below this share of the in-stall rows in forward flow the record is one blowdown after another.
LEAST_SCORED_SHARE = 0.15
LEAST_SCORED_ROWS = 60


@dataclass(frozen=True)
class WholeRunRows:
    """The averaged signals of one free run through a record.

    Parameters
    ----------
    phi : ndarray of shape (n,)
        Averaged flow coefficient.
    terms : ndarray of shape (n, q)
        The s_i(φ) in stall, averaged after they were formed.
    nuisance : ndarray of shape (n, 4)
        What carries the state through unstalled and reversed rows: level and slope of the
        unstalled branch, the loss in reversed flow and its derivative. A column is zero where a
        record has no such rows.
    psi_p : ndarray of shape (n,)
        Averaged ψ'.
    weight : ndarray of shape (n,)
        1 where the run is scored, 0 where it is simulated through.
    time_s : ndarray of shape (n,)
        Facility clock.
    in_stall_rows : int
        Rows in stall, scored or not.
    """

    phi: FloatArray
    terms: FloatArray
    nuisance: FloatArray
    psi_p: FloatArray
    weight: FloatArray
    time_s: FloatArray
    in_stall_rows: int


@dataclass(frozen=True)
class StackedRuns:
    """All runs of a fit, one behind the other.

    Parameters
    ----------
    phi, psi_p, time_s : ndarray of shape (n,)
        Averaged signals and the facility clock.
    terms : ndarray of shape (n, q)
        Inputs of the lag, the nuisances last.
    run : ndarray of int, shape (n,)
        Number of the run of each row.
    """

    phi: FloatArray
    psi_p: FloatArray
    time_s: FloatArray
    terms: FloatArray
    run: NDArray[np.int64]


@dataclass(frozen=True)
class WholeRunFit:
    """A fitted lag model, with the attributes of an estimator (DESIGN section 5).

    Parameters
    ----------
    time_constant_s_, time_constant_stderr_s_ : float
        τ and its standard error, in seconds; NaN where the record does not hold it.
    terms_ : list of str
        Names of the terms.
    coef_ : ndarray of shape (q,)
        β_i.
    covariance_ : ndarray of shape (q, q)
        Of β, with the errors that all cycles share.
    degree : int
        Of the characteristic.
    n_blocks_, n_scored_ : int
        Blocks behind the jackknife and rows scored.
    fit_state_ : FitState
        How it ended.
    model_ : LagRegressor
        The fit behind it, over the averaged terms and the nuisances.
    rows_ : tuple of WholeRunRows
        What was fitted.
    kept_ : tuple of int
        Columns of terms and nuisances that the fit used.
    """

    time_constant_s_: float
    time_constant_stderr_s_: float
    terms_: list[str]
    coef_: FloatArray
    covariance_: FloatArray
    degree: int
    n_blocks_: int
    n_scored_: int
    fit_state_: FitState
    model_: LagRegressor
    rows_: tuple[WholeRunRows, ...]
    kept_: tuple[int, ...]

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ψ'_QS and its standard error at φ, of shape (n,)."""
        powers = np.vander(np.ravel(np.asarray(phi, dtype=np.float64)), self.degree + 1)[:, ::-1]
        variance: FloatArray = np.einsum("ij,jk,ik->i", powers, self.covariance_, powers)
        return powers @ self.coef_, np.sqrt(np.maximum(variance, 0.0))

    def stacked(self) -> tuple[StackedRuns, NDArray[np.bool_]]:
        """Return what was fitted, and which rows were scored."""
        X, y, weight, labels = _stacked(self.rows_)
        X = X[:, self.kept_]
        stacked = StackedRuns(
            np.concatenate([row.phi for row in self.rows_]),
            y,
            np.concatenate([row.time_s for row in self.rows_]),
            X,
            labels,
        )
        return stacked, weight > 0.0

    def checks(self, stated_phi: tuple[float, float]) -> tuple[CheckRow, ...]:
        """Check the errors of the scored rows.

        Whiteness is not among the checks: errors of averaged signals are coloured by the average.

        Parameters
        ----------
        stated_phi : tuple of float
            Range of φ in which the curve is stated.
        """
        if not math.isfinite(self.time_constant_s_):
            return ()
        X, y, weight, labels = _stacked(self.rows_)
        X = X[:, self.kept_]
        fit = linearised_fit(self.model_, X, y, labels, weight)
        phi = np.concatenate([row.phi for row in self.rows_])[fit.rows]
        pieces = list(fit.pieces)
        return (
            input_correlation(fit.errors, phi, pieces),
            normality(fit.errors, pieces),
            leverage(self.model_, fit, X[fit.rows]),
            coverage(phi, runs_of(fit.segment, fit.segment.size), stated_phi),
        )


def has_whole_run(series: CoefficientSeries) -> bool:
    """Tell whether a series carries the unfiltered columns that a whole-run fit needs."""
    return (
        series.phi_unfiltered is not None
        and series.psi_p_unfiltered is not None
        and series.stalled is not None
        and series.free_run is not None
        and bool(np.any(series.free_run == 2))
        and _average_s(series) is not None
    )


def whole_run_rows(series: CoefficientSeries, degree: int = 2) -> WholeRunRows:
    """Average the signals of a record's free run over one period of the stall cells.

    Powers first, average last: the average is linear and passes through the lag unchanged, which
    φ² of an averaged φ would not.

    Parameters
    ----------
    series : CoefficientSeries
        With the unfiltered columns.
    degree : int
        Of the characteristic.

    Raises
    ------
    InputError
        When the series lacks them.
    """
    period_s = _average_s(series)
    phi, psi_p = series.phi_unfiltered, series.psi_p_unfiltered
    if phi is None or psi_p is None or series.stalled is None or series.free_run is None:
        raise InputError(
            series.source,
            expected="the columns phi_unfiltered, psi_p_unfiltered, stalled and free_run",
            found="a series without them",
            remedy="reduce the raw record with `sindy-surge reduce`",
        )
    if period_s is None:
        raise InputError(
            series.source, expected="a ledger with the entry 'free run'", found="none beside it"
        )
    rate = series.sample_rate_hz
    stalled = series.stalled.astype(np.float64)

    def average(values: FloatArray) -> FloatArray:
        return period_average(values, period_s, rate)

    inside = series.free_run > 0
    _check_alike(series, inside)
    powers = [average(stalled * phi**power) for power in range(degree + 1)]
    other = [average(1.0 - stalled), average((1.0 - stalled) * (phi - UNSTALLED_PHI))]
    smooth = period_average(phi, LOSS_AVERAGE_S, rate)
    loss = average(stalled * np.where(smooth < 0.0, smooth**2, 0.0))
    # An unlagged loss e is the answer of the lag to e + τ de/dt: with its derivative beside it the
    # term acts without the lag for any τ.
    nuisance = [*other, loss, np.gradient(loss)]
    return WholeRunRows(
        average(phi)[inside],
        np.column_stack(powers)[inside],
        np.column_stack(nuisance)[inside],
        average(psi_p)[inside],
        (series.free_run[inside] == 2).astype(np.float64),
        series.time_s[inside],
        int(np.count_nonzero(inside & series.stalled)),
    )


def fit_whole_runs(
    records: Sequence[CoefficientSeries],
    *,
    degree: int = 2,
    hold: Hold = "first",
    time_constant_s: float | None = None,
    until_s: Sequence[float] | None = None,
) -> WholeRunFit:
    """Fit one lag model to whole runs through one or several records.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate, with their unfiltered columns.
    degree : int
        Degree of the characteristic.
    hold : {"zero", "first"}
        How φ acts between samples.
    time_constant_s : float, optional
        Hold τ at this value.
    until_s : sequence of float, optional
        Score each record up to this time only; the rest is held out.

    Returns
    -------
    WholeRunFit
        Refused by its state, with τ NaN, where hardly a row is in forward flow in stall.

    Raises
    ------
    InputError
        When a series lacks the unfiltered columns.
    """
    rows = tuple(whole_run_rows(record, degree) for record in records)
    _check_rates(records)
    if until_s is not None:
        rows = tuple(
            WholeRunRows(
                row.phi,
                row.terms,
                row.nuisance,
                row.psi_p,
                np.where(row.time_s <= end, row.weight, 0.0),
                row.time_s,
                int(row.in_stall_rows * np.mean(row.time_s <= end)),
            )
            for row, end in zip(rows, until_s, strict=True)
        )
    X, y, weight, labels = _stacked(rows)
    # Nuisances of which no record has anything would make the fit look rank deficient.
    n_terms = degree + 1
    moving = np.ptp(X[:, n_terms:], axis=0) > 1e-9
    kept = (*range(n_terms), *(n_terms + np.flatnonzero(moving)).tolist())
    X = X[:, kept]
    model = LagRegressor(
        records[0].sample_period_s,
        noise="output-error",
        hold=hold,
        basis=_identity(),
        time_constant_s=time_constant_s,
    )
    if not np.any(weight > 0.0):
        return _refusal(model, rows, degree)
    model.fit(X, y, segments=labels, sample_weight=weight)
    return _result(model, rows, degree, y[weight > 0.0], kept, held=time_constant_s is not None)


def _refusal(model: LagRegressor, rows: tuple[WholeRunRows, ...], degree: int) -> WholeRunFit:
    """Without a row to score: nothing is fitted, not even to the rows that are held out."""
    return WholeRunFit(
        math.nan,
        math.nan,
        _names(degree),
        np.zeros(degree + 1),
        np.full((degree + 1, degree + 1), math.nan),
        degree,
        0,
        0,
        FitState.BLOWDOWN,
        model,
        rows,
        (),
    )


def _result(
    model: LagRegressor,
    rows: tuple[WholeRunRows, ...],
    degree: int,
    scored_psi_p: FloatArray,
    kept: tuple[int, ...],
    *,
    held: bool,
) -> WholeRunFit:
    n_terms = degree + 1
    n_scored = int(sum(row.weight.sum() for row in rows))
    in_stall = sum(row.in_stall_rows for row in rows)
    state = model.fit_state_
    covariance = model.covariance_[:n_terms, :n_terms].copy()
    covariance[0, 0] += (COMMON_CURVE_SHARE * float(np.mean(np.abs(scored_psi_p)))) ** 2
    tau_s, stderr_s = model.time_constant_s_, model.time_constant_stderr_s_
    if not held:
        stderr_s = math.hypot(stderr_s, COMMON_TAU_SHARE * tau_s)
    if n_scored < max(LEAST_SCORED_SHARE * in_stall, LEAST_SCORED_ROWS):
        state = FitState.BLOWDOWN
        covariance[:] = math.nan
        # A held τ was not read from these rows.
        tau_s, stderr_s = (tau_s, stderr_s) if held else (math.nan, math.nan)
    return WholeRunFit(
        tau_s,
        stderr_s,
        _names(degree),
        model.coef_[:n_terms],
        covariance,
        degree,
        int(model.n_blocks_),
        n_scored,
        state,
        model,
        rows,
        kept,
    )


def _names(degree: int) -> list[str]:
    basis = polynomial_basis(degree).fit(np.zeros((2, 1)))
    return term_names(basis, ["phi"], degree + 1)


def _stacked(
    rows: Sequence[WholeRunRows],
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
    return (
        np.concatenate([np.column_stack([row.terms, row.nuisance]) for row in rows]),
        np.concatenate([row.psi_p for row in rows]),
        np.concatenate([row.weight for row in rows]),
        np.concatenate([np.full(row.phi.size, i) for i, row in enumerate(rows)]),
    )


def _check_rates(records: Sequence[CoefficientSeries]) -> None:
    periods = [record.sample_period_s for record in records]
    if not periods or max(periods) - min(periods) > 1e-6 * periods[0]:
        raise InputError(
            ", ".join(record.source for record in records) or "records",
            expected="records of one sample rate",
            found=" and ".join(f"{1.0 / period:g} Hz" for period in periods) or "none",
            remedy="fit them one at a time",
        )


def _identity() -> object:
    from sklearn.preprocessing import FunctionTransformer

    return FunctionTransformer()


def _average_s(series: CoefficientSeries) -> float | None:
    for entry in reversed(series.history):
        if entry.step == "free run" and "average_s" in entry.parameters:
            return _checked_average_s(series, entry.parameters["average_s"])
    return None


def _checked_average_s(series: CoefficientSeries, found: object) -> float:
    low, high = 2.0 * series.sample_period_s, LONGEST_AVERAGE_S
    if isinstance(found, int | float) and not isinstance(found, bool) and low <= found <= high:
        return float(found)
    raise InputError(
        f"{series.source}: ledger, step 'free run', average_s",
        expected=f"a number of seconds from {low:g} to {high:g}",
        found=repr(found),
        remedy="reduce the record again",
    )


def _check_alike(series: CoefficientSeries, inside: NDArray[np.bool_]) -> None:
    """Refuse unfiltered columns that are not those of the filtered ones beside them."""
    for name in ("phi", "psi_p"):
        filtered, plain = (
            getattr(series, name)[inside],
            getattr(series, f"{name}_unfiltered")[inside],
        )
        if np.ptp(plain) == 0.0 or np.corrcoef(filtered, plain)[0, 1] < LEAST_LIKENESS:
            raise InputError(
                f"{series.source}: column {name}_unfiltered",
                expected=f"the signal that {name} was filtered from",
                found="another one",
                remedy="reduce the record again",
            )
