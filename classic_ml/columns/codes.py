"""Whole numbers of 16 bits among readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from surge_core.types import FloatArray

__all__ = ["as_codes"]


@as_written
def as_codes(readings: FloatArray, codes: NDArray[np.uint16]) -> bool:
    """Write readings as whole numbers of 16 bits, and tell whether all of them are such.

    Parameters
    ----------
    readings : ndarray of shape (n,)
        The readings.
    codes : ndarray of uint16, shape (n,)
        Where they go.
    """
    whole = True
    for k in range(readings.size):
        inside = readings[k] if 0.0 <= readings[k] <= 65535.0 else 0.0
        codes[k] = np.uint16(inside)
        whole &= codes[k] == readings[k]
    return whole
