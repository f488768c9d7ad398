"""The averaged signals of free runs through records, and which of their rows are scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.filters import period_average
from classic_ml.lag_regressor import LagRegressor
from classic_ml.series import CoefficientSeries
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray

# Where the line of the unstalled branch is levelled, the same for all records of a fit.
UNSTALLED_PHI = 0.25
# Width of the average that finds the reversed flow behind the loss term, in seconds.
LOSS_AVERAGE_S = 0.005
# Below this share of the in-stall rows in forward flow the record is one blowdown after another.
LEAST_SCORED_SHARE = 0.15
LEAST_SCORED_ROWS = 60
SIGNALS = ("phi", "terms", "nuisance", "psi_p", "weight", "time_s")


@dataclass(frozen=True)
class WholeRunRows:
    """The averaged signals of one free run through a record, or of several behind each other.

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
    run : ndarray of int, shape (n,)
        Number of the run of each row.
    """

    phi: FloatArray
    terms: FloatArray
    nuisance: FloatArray
    psi_p: FloatArray
    weight: FloatArray
    time_s: FloatArray
    in_stall_rows: int
    run: IntArray

    @property
    def scored(self) -> BoolArray:
        """Rows that are scored."""
        return np.asarray(self.weight > 0.0)

    @property
    def moving(self) -> FloatArray:
        """The nuisances of which a record has any: others would make a fit look rank deficient."""
        return np.asarray(self.nuisance[:, np.ptp(self.nuisance, axis=0) > 1e-9])

    @property
    def inputs(self) -> FloatArray:
        """Inputs of the lag: the terms, then the nuisances."""
        return np.asfortranarray(np.column_stack([self.terms, self.moving]))

    def fitted(self, model: LagRegressor) -> LagRegressor:
        """Return a model, fitted to these rows."""
        return model.fit(self.inputs, self.psi_p, segments=self.run, sample_weight=self.weight)

    @property
    def scored_phi(self) -> FloatArray:
        """Averaged φ of the rows that are scored: where a fit to them knows the curve."""
        return np.asarray(self.phi[self.scored])

    def without(self, left_out: BoolArray) -> WholeRunRows:
        """Return the same with some rows simulated through."""
        return replace(self, weight=np.where(left_out, 0.0, self.weight))

    @property
    def cycle(self) -> IntArray:
        """Number of the surge cycle of each row: from one entry into stall to the next."""
        # The first nuisance is the averaged state: 1 where unstalled.
        stalled = self.nuisance[:, 0] < 0.5
        entries = np.concatenate([[False], stalled[1:] & ~stalled[:-1]])
        return np.cumsum(entries).astype(np.int64)


def has_whole_run(series: CoefficientSeries) -> bool:
    """Return whether a series carries the unfiltered columns that a whole-run fit needs."""
    scored = series.free_run is not None and bool(np.any(series.free_run == 2))
    columns = (series.phi_unfiltered, series.psi_p_unfiltered, series.stalled)
    return scored and all(c is not None for c in columns) and _average_s(series) is not None


def whole_run_rows(
    series: CoefficientSeries,
    degree: int = 2,
    *,
    terms: Callable[[FloatArray], FloatArray] | None = None,
) -> WholeRunRows:
    """Average the signals of a record's free run over one period of the stall cells.

    Terms first, average last: the average is linear and passes through the lag unchanged, which
    φ² of an averaged φ would not.

    Parameters
    ----------
    series : CoefficientSeries
        With the unfiltered columns.
    degree : int
        Of the characteristic.
    terms : callable, optional
        Gives the s_i at φ of shape (n,) as columns, in place of the powers up to ``degree``.

    Raises
    ------
    InputError
        When the series lacks them.
    """
    period_s = _average_s(series)
    phi, psi_p = series.phi_unfiltered, series.psi_p_unfiltered
    stalled_rows, free_run = series.stalled, series.free_run
    if phi is None or psi_p is None or stalled_rows is None or free_run is None or not period_s:
        raise InputError(
            series.source,
            expected="the columns phi_unfiltered, psi_p_unfiltered, stalled and free_run, and a "
            "ledger with the entry 'free run'",
            found="a series without them",
            remedy="reduce the raw record with `sindy-surge reduce`",
        )
    rate = series.sample_rate_hz
    stalled = stalled_rows.astype(np.float64)

    def average(values: FloatArray) -> FloatArray:
        return period_average(values, period_s, rate)

    inside = free_run > 0
    values = np.vander(phi, degree + 1, increasing=True) if terms is None else terms(phi)
    other = [average(1.0 - stalled), average((1.0 - stalled) * (phi - UNSTALLED_PHI))]
    smooth = period_average(phi, LOSS_AVERAGE_S, rate)
    loss = average(stalled * np.where(smooth < 0.0, smooth**2, 0.0))
    # An unlagged loss e is the answer of the lag to e + τ de/dt: with its derivative beside it the
    # term acts without the lag for any τ.
    nuisance = [*other, loss, np.gradient(loss)]
    return WholeRunRows(
        average(phi)[inside],
        np.column_stack([average(stalled * value) for value in values.T])[inside],
        np.column_stack(nuisance)[inside],
        average(psi_p)[inside],
        (free_run[inside] == 2).astype(np.float64),
        series.time_s[inside],
        int(np.count_nonzero(inside & stalled_rows)),
        np.zeros(np.count_nonzero(inside), np.int64),
    )


def scored_until(
    rows: Sequence[WholeRunRows], until_s: Sequence[float] | None
) -> tuple[WholeRunRows, ...]:
    """Return the rows of each record, scored up to its time only; the rest is held out."""
    if until_s is None:
        return tuple(rows)
    shares = [float(np.mean(row.time_s <= end)) for row, end in zip(rows, until_s, strict=True)]
    return tuple(
        replace(row.without(row.time_s > end), in_stall_rows=int(row.in_stall_rows * share))
        for row, end, share in zip(rows, until_s, shares, strict=True)
    )


def is_blowdown(rows: Sequence[WholeRunRows]) -> bool:
    """Tell whether hardly a row in stall is in forward flow: then τ is not to be read."""
    scored = sum(float(row.weight.sum()) for row in rows)
    in_stall = sum(row.in_stall_rows for row in rows)
    return scored < max(LEAST_SCORED_SHARE * in_stall, LEAST_SCORED_ROWS)


def stacked_rows(rows: Sequence[WholeRunRows]) -> WholeRunRows:
    """Return the runs one behind the other."""
    return replace(
        rows[0],
        **{name: np.concatenate([getattr(row, name) for row in rows]) for name in SIGNALS},
        in_stall_rows=sum(row.in_stall_rows for row in rows),
        run=np.repeat(range(len(rows)), [row.phi.size for row in rows]),
    )


def _average_s(series: CoefficientSeries) -> float | None:
    """Return what the free run is averaged over as the ledger says, None where it does not."""
    stated = [e.parameters.get("average_s") for e in series.history if e.step == "free run"]
    found = stated[-1] if stated else None
    return float(found) if isinstance(found, int | float) and 0.0 < found < 1.0 else None
