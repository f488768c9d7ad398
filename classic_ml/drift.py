"""Slow drift of the output, as a spline with knots stated in seconds."""

from __future__ import annotations

import numpy as np

from classic_ml.errors import InputError
from classic_ml.records import FloatArray

__all__ = ["spline_columns"]

# Two gigabytes of dense columns: more is a mistake in the knot spacing or a job for pieces.
MOST_VALUES = 250_000_000


def spline_columns(
    weight: FloatArray, runs: list[slice], sample_period_s: float, knot_spacing_s: float
) -> FloatArray:
    """Return the columns of a continuous piecewise-linear drift of zero mean.

    Parameters
    ----------
    weight : ndarray of shape (n_rows,)
        Weights of the rows; the mean is taken over those.
    runs : list of slice
        The segments. The time between two of them is not known, so each drifts on its own: as
        a spline where it is longer than the knots are apart, else as one level.
    sample_period_s : float
        Sample period, in seconds.
    knot_spacing_s : float
        Distance of the knots, in seconds; 0.25 to 2 s serve equally well where the lag is tens
        of milliseconds.

    Returns
    -------
    ndarray of shape (n_rows, n_columns)
        Hat functions at the knots, less their mean, the last one left out: the constant belongs
        to the characteristic, of which a drift could not be told apart.

    Raises
    ------
    InputError
        When the columns would not fit into memory.
    """
    lengths = [run.stop - run.start for run in runs]
    intervals = [round((n - 1) * sample_period_s / knot_spacing_s) for n in lengths]
    n_columns = sum(n + 1 for n in intervals) - 1
    if weight.size * n_columns > MOST_VALUES:
        raise InputError(
            "knot_spacing_s",
            expected=f"at most {MOST_VALUES // weight.size} knots over {weight.size} rows",
            found=f"{n_columns}",
            remedy="raise knot_spacing_s or fit a part of the record",
        )
    columns = np.zeros((weight.size, n_columns + 1))
    at = 0
    for run, length, n_intervals in zip(runs, lengths, intervals, strict=True):
        position = np.linspace(0.0, n_intervals, length)
        distance = np.abs(position[:, None] - np.arange(n_intervals + 1))
        columns[run, at : at + n_intervals + 1] = np.maximum(0.0, 1.0 - distance)
        at += n_intervals + 1
    total = float(weight.sum())
    centred = columns - (weight @ columns / total if total > 0.0 else 0.0)
    return np.asarray(centred[:, :-1])
