"""sysidentpy: NARMAX with a polynomial basis, extended least squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares
from worker import FloatArray, lag_parameters, serve, with_level

# Codes of sysidentpy's regressors: y(k-1), x1(k-1), x2(k-1).
Y_CODE, PHI_CODE, PHI_SQUARED_CODE = 1001, 2001, 3001


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    terms = np.column_stack([phi, phi**2])
    model = FROLS(
        # The library of a first-degree polynomial in these is the model itself: four terms.
        order_selection=False,
        n_terms=4,
        ylag=1,
        xlag=[[1], [1]],
        elag=1,
        estimator=LeastSquares(unbiased=True),
        basis_function=Polynomial(degree=1),
        model_type="NARMAX",
    )
    model.fit(X=terms, y=y[:, None])
    found = dict(zip(np.ravel(model.final_model).tolist(), np.ravel(model.theta), strict=True))
    b = [found[PHI_CODE], found[PHI_SQUARED_CODE]]
    # Its own constant is split between two equal columns, so that half of it is dropped.
    return with_level(y, terms, lag_parameters(float(found[Y_CODE]), b))


if __name__ == "__main__":
    serve(fit)
