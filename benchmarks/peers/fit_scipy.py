"""scipy alone: least squares over the prediction errors of ARMAX, as one would write it by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter
from worker import FloatArray, lag_parameters, serve

# C must keep its root inside the circle, or the filter that whitens runs away.
LARGEST_C = 0.999


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    columns = np.column_stack([y, np.ones_like(phi), phi, phi**2])[:-1]
    target = y[1:]
    arx = np.linalg.lstsq(columns, target)[0]

    def errors(parameters: FloatArray) -> FloatArray:
        raw = target - columns @ parameters[:4]
        return np.asarray(lfilter([1.0], [1.0, parameters[4]], raw))

    found = least_squares(
        errors,
        [*arx, 0.0],
        bounds=([-np.inf] * 4 + [-LARGEST_C], [np.inf] * 4 + [LARGEST_C]),
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    return lag_parameters(float(found.x[0]), found.x[1:4].tolist())


if __name__ == "__main__":
    serve(fit)
