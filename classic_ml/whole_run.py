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

from classic_ml.characteristics import polynomial_names
from classic_ml.checks import (
    CheckRow,
    coverage,
    input_correlation,
    leverage,
    normality,
)
from classic_ml.fitted_curve import characteristic_grid, equation_with_errors, milliseconds
from classic_ml.lag_regressor import LagRegressor
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run_rows import (
    WholeRunRows,
    has_whole_run,
    is_blowdown,
    moving_columns,
    scored_until,
    stacked_rows,
    whole_run_rows,
)
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.lag import Hold
from surge_core.segments import runs_of
from surge_core.types import FloatArray

__all__ = [
    "StackedRuns",
    "WholeRunFit",
    "WholeRunRows",
    "check_rates",
    "fit_whole_runs",
    "has_whole_run",
    "whole_run_rows",
]

# Errors that all cycles of a record share and no jackknife over cycles sees: the calibration
# readings, the rectified noise of probes near zero flow, rows at the edge of the model. Set so
# that the stated intervals hold the truth as often as they say (benchmarks/tau_on_the_rig.py).
COMMON_TAU_SHARE = 0.025
COMMON_CURVE_SHARE = 0.025


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
class WholeRunFit(Displayed):
    """A fitted lag model, with the attributes of an estimator.

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

    def _sheet(self) -> Sheet:
        state = self.fit_state_
        held = " (held)" if self.model_.time_constant_s is not None else ""
        n_rows, n_runs = sum(row.phi.size for row in self.rows_), len(self.rows_)
        lag = self.time_constant_s_, self.time_constant_stderr_s_
        curve = self.terms_, self.coef_, self.covariance_
        fields = (
            Field("equation", equation_with_errors(lag, *curve)),
            Field("state", state.advice, "good" if state is FitState.CONVERGED else "advice"),
            Field("time constant τ", milliseconds(*lag) + held),
            Field(
                "fitted to",
                f"{n_runs} run{'' if n_runs == 1 else 's'} of unfiltered signals, {n_rows} rows, "
                "averaged over one period of the stall cells",
            ),
            Field(
                "scored",
                f"{self.n_scored_} rows in forward flow in stall; errors from {self.n_blocks_} "
                "blocks, with those that all cycles share",
            ),
        )
        return Sheet("WholeRunFit", fields, (characteristic_grid(*curve),))

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ψ'_QS and its standard error at φ, of shape (n,)."""
        powers = np.vander(np.ravel(np.asarray(phi, dtype=np.float64)), self.degree + 1)[:, ::-1]
        variance: FloatArray = np.einsum("ij,jk,ik->i", powers, self.covariance_, powers)
        return powers @ self.coef_, np.sqrt(np.maximum(variance, 0.0))

    def stacked(self) -> tuple[StackedRuns, NDArray[np.bool_]]:
        """Return what was fitted, and which rows were scored."""
        X, y, weight, labels = stacked_rows(self.rows_)
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
        X, y, weight, labels = stacked_rows(self.rows_)
        X = X[:, self.kept_]
        fit = self.model_.linearised(X, y, labels, weight)
        phi = np.concatenate([row.phi for row in self.rows_])[fit.rows]
        pieces = list(fit.pieces)
        return (
            input_correlation(fit.errors, phi, pieces),
            normality(fit.errors, pieces),
            leverage(self.model_, fit, X[fit.rows]),
            coverage(phi, runs_of(fit.segment, fit.segment.size), stated_phi),
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
    check_rates(records)
    rows = scored_until([whole_run_rows(record, degree) for record in records], until_s)
    X, y, weight, labels = stacked_rows(rows)
    kept = moving_columns(X, degree + 1)
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
        polynomial_names("phi", degree),
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
    state = model.fit_state_
    covariance = model.covariance_[:n_terms, :n_terms].copy()
    covariance[0, 0] += (COMMON_CURVE_SHARE * float(np.mean(np.abs(scored_psi_p)))) ** 2
    tau_s, stderr_s = model.time_constant_s_, model.time_constant_stderr_s_
    if not held:
        stderr_s = math.hypot(stderr_s, COMMON_TAU_SHARE * tau_s)
    if is_blowdown(rows):
        state = FitState.BLOWDOWN
        covariance[:] = math.nan
        # A held τ was not read from these rows.
        tau_s, stderr_s = (tau_s, stderr_s) if held else (math.nan, math.nan)
    return WholeRunFit(
        tau_s,
        stderr_s,
        polynomial_names("phi", degree),
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


def check_rates(records: Sequence[CoefficientSeries]) -> None:
    """Refuse records of unlike sample rates, and no records.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        The records of one fit.

    Raises
    ------
    InputError
        When they do not go together.
    """
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
