"""The rows of records, as a lag model with effects is run on them and fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.loading import load_data
from surge_core.types import FloatArray

__all__ = ["fitted_data", "row_of_sample", "rows_in", "segment_data"]


def segment_data(record: CoefficientSeries) -> LagData:
    """Return the rows of a record's segments, whatever unfiltered columns it carries beside them.

    Parameters
    ----------
    record : CoefficientSeries
        The record.

    Raises
    ------
    InputError
        When it has too few rows in segments.
    """
    plain = replace(record, phi_unfiltered=None, psi_p_unfiltered=None, stalled=None, free_run=None)
    return load_data([plain])


def row_of_sample(data: LagData, record: CoefficientSeries) -> NDArray[np.int64]:
    """Return the row of the record that each sample stands for, of shape (n,).

    Parameters
    ----------
    data : LagData
        What :func:`segment_data` gave.
    record : CoefficientSeries
        The record behind it.
    """
    return rows_in(record, data.sampled(data["time_s"]))


def rows_in(record: CoefficientSeries, time_s: FloatArray) -> NDArray[np.int64]:
    """Return the rows of a record at given times of its clock, of shape (n,).

    Parameters
    ----------
    record : CoefficientSeries
        The record.
    time_s : ndarray of shape (n,)
        Times of some of its rows, in seconds.
    """
    at = np.rint((time_s - record.time_s[0]) / record.sample_period_s)
    return np.asarray(at.astype(np.int64))


def fitted_data(
    records: Sequence[CoefficientSeries], until_s: Sequence[float] | None = None
) -> LagData:
    """Return the scored rows of records, all of them to be fitted.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate.
    until_s : sequence of float, optional
        Score each record up to this time only.

    Raises
    ------
    InputError
        When they do not go together or hold too few rows.
    """
    data = load_data(records)
    part = np.full(data.n_samples, TRAIN, dtype=np.int8)
    if until_s is None:
        return replace(data, part=part).over_all_phi()
    # The rows stand in the order of the records' clocks.
    order = np.argsort([float(record.time_s[0]) for record in records], kind="stable")
    end_s = np.asarray(until_s, dtype=np.float64)[order][data.record]
    inside = data.sampled(data["time_s"]) <= end_s
    return replace(data, part=part, weight=data.weight * inside).up_to(inside).over_all_phi()
