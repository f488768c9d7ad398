"""Slow drift of the output, as a spline with knots stated in seconds."""

from __future__ import annotations

import numpy as np

from classic_ml.records import FloatArray

__all__ = ["spline_columns"]


def spline_columns(
    n_rows: int, sample_period_s: float, knot_spacing_s: float, weight: FloatArray
) -> FloatArray:
    """Return the columns of a continuous piecewise-linear drift of zero mean.

    Parameters
    ----------
    n_rows : int
        Rows of the record.
    sample_period_s : float
        Sample period, in seconds.
    knot_spacing_s : float
        Distance of the knots, in seconds; 0.25 to 2 s serve equally well where the lag is tens
        of milliseconds.
    weight : ndarray of shape (n_rows,)
        Weights of the rows; the mean is taken over those.

    Returns
    -------
    ndarray of shape (n_rows, n_intervals)
        Hat functions at the knots, less their mean, the last one left out: the constant belongs
        to the characteristic, of which a drift could not be told apart.
    """
    duration_s = (n_rows - 1) * sample_period_s
    n_intervals = max(1, round(duration_s / knot_spacing_s))
    position = np.linspace(0.0, n_intervals, n_rows)
    columns = np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(n_intervals)))
    total = float(weight.sum())
    return columns - (weight @ columns / total if total > 0.0 else 0.0)
