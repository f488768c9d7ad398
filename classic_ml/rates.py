"""Rates of change of a part of a column, as they are in the whole of it."""

from __future__ import annotations

import numpy as np

from surge_core.types import FloatArray

__all__ = ["rate_in"]


def rate_in(values: FloatArray, rows: slice, sample_period_s: float) -> FloatArray:
    """Return the central difference in some rows of a signal.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The whole signal, of which one row more to each side is read.
    rows : slice
        From a row to another, both given.
    sample_period_s : float
        Time between two samples.

    Returns
    -------
    ndarray of shape (rows.stop - rows.start,)
        These rows of ``np.gradient``: one-sided at the ends of the signal alone.
    """
    first, stop = max(0, rows.start - 1), min(values.size, rows.stop + 1)
    around = np.gradient(values[first:stop], sample_period_s)
    return np.asarray(around[rows.start - first : rows.stop - first])
