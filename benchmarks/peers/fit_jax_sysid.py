"""jax-sysid: simulation error of a linear model, here the ARMAX predictor written as one.

The prediction p[k+1] = -c p[k] + (a + c) y[k] + Σ b_i s_i[k] is a state of its own, so that the
simulation error of that system, with y among its inputs, is ARMAX's prediction error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax_sysid.models import LinearModel
from worker import FloatArray, lag_parameters, serve, with_level


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    terms = np.column_stack([phi, phi**2])
    columns = np.column_stack([y, terms])
    scale = columns.std(axis=0)
    inputs = (columns - columns.mean(axis=0)) / scale
    target = inputs[:, :1]
    arx = np.linalg.lstsq(inputs[:-1], target[1:, 0])[0]
    model = LinearModel(
        nx=1, ny=1, nu=3, y_in_x=True, ss=[np.zeros((1, 1)), arx[None, :]], x0=target[0]
    )
    # Its default penalties on parameters and start bias the estimate.
    model.loss(rho_x0=0.0, rho_th=0.0)
    model.optimization(adam_epochs=0, lbfgs_epochs=2000, iprint=-1, lbfgs_tol=1e-16)
    model.fit(target, inputs)
    minus_c, gains = float(model.params[0][0, 0]), model.params[1][0]
    b = gains[1:] * scale[0] / scale[1:]
    return with_level(y, terms, lag_parameters(float(gains[0]) + minus_c, b.tolist()))


if __name__ == "__main__":
    serve(fit)
