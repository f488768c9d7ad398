"""The averaged signals of one free run through a record, and which of its rows are scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from classic_ml.filters import period_average
from classic_ml.series import CoefficientSeries
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "WholeRunRows",
    "has_whole_run",
    "is_blowdown",
    "moving_columns",
    "scored_until",
    "stacked_rows",
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

    @property
    def cycle(self) -> NDArray[np.int64]:
        """Number of the surge cycle of each row: from one entry into stall to the next."""
        # The first nuisance is the averaged state: 1 where unstalled.
        stalled = self.nuisance[:, 0] < 0.5
        entries = np.concatenate([[False], stalled[1:] & ~stalled[:-1]])
        return np.cumsum(entries).astype(np.int64)


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
        (series.free_run[inside] == 2).astype(np.float64),
        series.time_s[inside],
        int(np.count_nonzero(inside & series.stalled)),
    )


def scored_until(
    rows: Sequence[WholeRunRows], until_s: Sequence[float] | None
) -> tuple[WholeRunRows, ...]:
    """Return the rows, scored up to a time only; the rest is held out.

    Parameters
    ----------
    rows : sequence of WholeRunRows
        One for each record.
    until_s : sequence of float, optional
        Time for each record; without it all stays as it is.
    """
    if until_s is None:
        return tuple(rows)
    return tuple(
        replace(
            row,
            weight=np.where(row.time_s <= end, row.weight, 0.0),
            in_stall_rows=int(row.in_stall_rows * np.mean(row.time_s <= end)),
        )
        for row, end in zip(rows, until_s, strict=True)
    )


def is_blowdown(rows: Sequence[WholeRunRows]) -> bool:
    """Tell whether hardly a row in stall is in forward flow: then τ is not to be read.

    Parameters
    ----------
    rows : sequence of WholeRunRows
        One for each record.
    """
    scored = sum(float(row.weight.sum()) for row in rows)
    in_stall = sum(row.in_stall_rows for row in rows)
    return scored < max(LEAST_SCORED_SHARE * in_stall, LEAST_SCORED_ROWS)


def stacked_rows(
    rows: Sequence[WholeRunRows],
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
    """Return the runs one behind the other.

    Parameters
    ----------
    rows : sequence of WholeRunRows
        One for each record.

    Returns
    -------
    inputs : ndarray of shape (n, n_terms + 4)
        Terms and nuisances.
    psi_p, weight : ndarray of shape (n,)
        Averaged ψ' and weights.
    run : ndarray of int, shape (n,)
        Number of the run of each row.
    """
    return (
        np.concatenate([np.column_stack([row.terms, row.nuisance]) for row in rows]),
        np.concatenate([row.psi_p for row in rows]),
        np.concatenate([row.weight for row in rows]),
        np.concatenate([np.full(row.phi.size, i) for i, row in enumerate(rows)]),
    )


def moving_columns(inputs: FloatArray, n_terms: int) -> tuple[int, ...]:
    """Return the columns of the terms, and of the nuisances those of which a record has any.

    Parameters
    ----------
    inputs : ndarray of shape (n, n_terms + 4)
        Terms and nuisances; columns that are nothing would make the fit look rank deficient.
    n_terms : int
        Number of terms.
    """
    moving = np.ptp(inputs[:, n_terms:], axis=0) > 1e-9
    return (*range(n_terms), *(n_terms + np.flatnonzero(moving)).tolist())


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
