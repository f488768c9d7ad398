"""statsmodels' SARIMAX: exact Gaussian likelihood of a regression with moving-average errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from statsmodels.tsa.statespace.sarimax import SARIMAX
from worker import FloatArray, lag_parameters, serve


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    columns = np.column_stack([y[:-1], phi[:-1], phi[:-1] ** 2])
    mean, scale = columns.mean(axis=0), columns.std(axis=0)
    # In raw units its L-BFGS stops beside its start.
    exog = np.column_stack([(columns - mean) / scale, np.ones(y.size - 1)])
    target = (y[1:] - mean[0]) / scale[0]
    result = SARIMAX(target, exog=exog, order=(0, 0, 1)).fit(disp=False, maxiter=200)
    slopes = result.params[:3] * scale[0] / scale
    constant = mean[0] + scale[0] * result.params[3] - slopes @ mean
    return lag_parameters(float(slopes[0]), [constant, slopes[1], slopes[2]])


if __name__ == "__main__":
    serve(fit)
