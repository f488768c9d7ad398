"""The lag model by one free run through whole records, from unfiltered signals.

This is the estimate that reads τ right on a record that passed the whole sensor chain. Four things
change together against the classical fit: the run is simulated (output error), rows where the
model does not hold are simulated through but not scored, φ and ψ' come from unfiltered pressures
and are averaged last, alike, over one period of the stall cells, and the inputs act as straight
lines between samples. Any one of them alone makes τ worse.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.characteristics import lag_sheet, polynomial_names
from classic_ml.checks import CheckRow, coverage, input_correlation, leverage
from classic_ml.lag_regressor import LagRegressor
from classic_ml.records import counted
from classic_ml.segments import near
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run_rows import (
    WholeRunRows,
    is_blowdown,
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

# What could as well be taken for granted: rows this much farther from every change, and this share
# of the scored rows at either end of φ left out.
FARTHER_S = (0.002, 0.004)
LEFT_OUT_SHARE = 0.15
# No choice of rows speaks for a time constant beyond twice or below half of the estimate.
FARTHEST = math.log(2.0)


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
    n_blocks_ : int
        Blocks behind the jackknife.
    fit_state_ : FitState
        How it ended.
    model_ : LagRegressor
        The fit behind it, over the averaged terms and the nuisances.
    rows_ : tuple of WholeRunRows
        What was fitted.
    """

    time_constant_s_: float
    time_constant_stderr_s_: float
    terms_: list[str]
    coef_: FloatArray
    covariance_: FloatArray
    degree: int
    n_blocks_: int
    fit_state_: FitState
    model_: LagRegressor
    rows_: tuple[WholeRunRows, ...]

    def _sheet(self) -> Sheet:
        return lag_sheet(self, self.fit_state_.advice, *self._about())

    def _about(self) -> Iterator[Field]:
        """Yield what is shown beside equation, state and τ."""
        n_rows = sum(row.phi.size for row in self.rows_)
        yield Field(
            "fitted to",
            f"{counted(len(self.rows_), 'run')} of unfiltered signals, {n_rows} rows, "
            "averaged over one period of the stall cells",
        )
        yield Field(
            "scored",
            f"{self.n_scored_} rows in forward flow in stall; errors from {self.n_blocks_} "
            "blocks, with those that all cycles share",
        )

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ψ'_QS and its standard error at φ, of shape (n,)."""
        powers = np.vander(np.ravel(np.asarray(phi, dtype=np.float64)), self.degree + 1)[:, ::-1]
        variance: FloatArray = np.einsum("ij,jk,ik->i", powers, self.covariance_, powers)
        return powers @ self.coef_, np.sqrt(np.maximum(variance, 0.0))

    @property
    def measurement_share_(self) -> float:
        """Standard deviation of log τ that is of the measurement: other readings share it."""
        return 0.0

    @property
    def trusted_phi(self) -> FloatArray:
        """φ of the rows at which the curve is known."""
        return np.concatenate([row.scored_phi for row in self.rows_])

    @property
    def n_scored_(self) -> int:
        """Rows scored."""
        return int(sum(row.weight.sum() for row in self.rows_))

    def withheld(self, state: FitState) -> Self:
        """Return the fit without τ and its errors, which a state withholds."""
        return replace(
            self,
            time_constant_s_=math.nan,
            time_constant_stderr_s_=math.nan,
            covariance_=np.full_like(self.covariance_, math.nan),
            fit_state_=state,
        )

    def stacked(self) -> WholeRunRows:
        """Return what was fitted, and which rows were scored."""
        return stacked_rows(self.rows_)

    def checks(self, stated_phi: tuple[float, float]) -> tuple[CheckRow, ...]:
        """Check the errors of the scored rows.

        Whiteness and normality are not among the checks: errors of averaged signals are coloured by
        the average, and an interval from a jackknife rests on neither.

        Parameters
        ----------
        stated_phi : tuple of float
            Range of φ in which the curve is stated.
        """
        if not math.isfinite(self.time_constant_s_):
            return ()
        rows = self.stacked()
        fit = self.model_.linearised(rows.inputs, rows.psi_p, rows.run, rows.weight)
        phi = rows.phi[fit.rows]
        pieces = list(fit.pieces)
        return (
            input_correlation(fit.errors, phi, pieces),
            leverage(self.model_, fit, rows.inputs[fit.rows]),
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
    stacked, held = stacked_rows(rows), time_constant_s is not None
    model = output_error(records[0].sample_period_s, hold, time_constant_s)
    n_terms, n_blocks, state = degree + 1, 0, FitState.BLOWDOWN
    tau_s = stderr_s = math.nan
    coef, covariance = np.zeros(n_terms), np.full((n_terms, n_terms), math.nan)
    # Without a row to score nothing is fitted, not even to the rows that are held out.
    if np.any(stacked.scored):
        stacked.fitted(model)
        coef, n_blocks = model.coef_[:n_terms], int(model.n_blocks_)
        blowdown = is_blowdown(rows)
        # A held τ was not read from these rows.
        if held or not blowdown:
            tau_s, stderr_s = model.time_constant_s_, model.time_constant_stderr_s_
        if not blowdown:
            state, covariance = model.fit_state_, model.covariance_[:n_terms, :n_terms]
            if not held and until_s is None:
                spread = specification_spread(records, degree=degree, hold=hold)
                stderr_s = math.hypot(stderr_s, spread.log_tau * tau_s)
                covariance = covariance + spread.curve
    return WholeRunFit(
        tau_s,
        stderr_s,
        polynomial_names("phi", degree),
        coef,
        covariance,
        degree,
        n_blocks,
        state,
        model,
        rows,
    )


@dataclass(frozen=True)
class Spread:
    """How far τ and the curve move under choices that could as well have been made.

    The standard deviation of log τ, and the covariance of the coefficients.
    """

    log_tau: float
    curve: FloatArray

    def level(self, phi: FloatArray) -> float:
        """Return the root mean square error of the curve over φ."""
        powers = np.vander(phi, self.curve.shape[0])[:, ::-1]
        return float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", powers, self.curve, powers))))


def specification_spread(
    records: Sequence[CoefficientSeries], *, degree: int = 2, hold: Hold = "first"
) -> Spread:
    """Fit other rows and another degree.

    A jackknife over cycles cannot see what all cycles share; what the choices of the fit make of it
    shows here. Arguments as for :func:`fit_whole_runs`.
    """
    rows = [whole_run_rows(record, degree) for record in records]
    period_s = records[0].sample_period_s
    chosen = [rows]
    for far in (round(each / period_s) for each in FARTHER_S):
        chosen.append([row.without(near(row.weight == 0.0, far, far)) for row in rows])
    ends = np.array([LEFT_OUT_SHARE, 1.0 - LEFT_OUT_SHARE])
    low, high = np.quantile(np.concatenate([row.scored_phi for row in rows]), ends)
    chosen.append([row.without(row.phi < low) for row in rows])
    chosen.append([row.without(row.phi >= high) for row in rows])
    logs, curves = [], []
    higher = [whole_run_rows(record, degree + 1) for record in records]
    for each, order in [*((one, degree) for one in chosen), (higher, degree + 1)]:
        stacked = stacked_rows(each)
        if np.count_nonzero(stacked.scored) <= order + 1 + each[0].nuisance.shape[1]:
            continue
        model = stacked.fitted(output_error(period_s, hold))
        logs.append(math.log(max(model.time_constant_s_, 1e-6)))
        if order == degree:
            curves.append(model.coef_[: degree + 1])
    apart = np.clip(np.array(logs) - logs[0], -FARTHEST, FARTHEST)
    moved = np.array(curves) - np.mean(curves, axis=0)
    return Spread(float(np.std(apart)), moved.T @ moved / len(curves))


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


def output_error(
    sample_period_s: float, hold: Hold, time_constant_s: float | None = None
) -> LagRegressor:
    """Return the lag by output error over terms that are formed already."""
    from sklearn.preprocessing import FunctionTransformer

    return LagRegressor(
        sample_period_s,
        noise="output-error",
        hold=hold,
        basis=FunctionTransformer(),
        time_constant_s=time_constant_s,
    )
