"""The call that both of SIPPY's ways share."""

from __future__ import annotations

import numpy as np
from sippy_unipi import system_identification
from worker import PERIOD_S, FloatArray, lag_parameters, with_level


def fit_armax(phi: FloatArray, y: FloatArray, method: str) -> list[float]:
    """Fit ARMAX(1, [1, 1], 1) on centred data and put the level back.

    A column of ones would be divided by its standard deviation of 0, and all comes out nan.
    """
    terms = np.column_stack([phi, phi**2])
    model = system_identification(
        y,
        terms.T,
        "ARMAX",
        centering="MeanVal",
        ARMAX_orders=[[1], [[1, 1]], [1], [[0, 0]]],
        ARMAX_mod=method,
        tsample=PERIOD_S,
        max_iterations=200,
    )
    a = -model.DENOMINATOR[0][0][1]
    b = [numerator[0] for numerator in model.NUMERATOR[0]]
    return with_level(y, terms, lag_parameters(a, b))
