"""One package's fit of ARMAX records, as a process of its own: `peers.py` runs it for each peer.

    python benchmarks/peer_fits.py NAME RECORDS.npz RESULTS.json CAP_S

Each function takes φ and ψ' of shape (n,) and returns τ in seconds. The packages are imported
inside: a peer's process runs in the environment of `requirements-peers.txt`.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]
PERIOD_S = 1e-3
WARM_UP_ROWS = 500
# C must keep its root inside the circle, or the filter that whitens runs away.
LARGEST_C = 0.999


def tau_of(a: float) -> float:
    """Return τ in seconds of the pole of y[k+1] = a y[k] + … (paper, Eq 10)."""
    return -PERIOD_S / np.log(a) if 0.0 < a < 1.0 else float("nan")


def fit_own(phi: FloatArray, y: FloatArray) -> float:
    """LagRegressor, standard errors included."""
    from classic_ml import LagRegressor

    model = LagRegressor(sample_period_s=PERIOD_S, noise="armax").fit(phi[:, None], y)
    return model.time_constant_s_


def fit_scipy(phi: FloatArray, y: FloatArray) -> float:
    """Least squares over the prediction errors, as one would write it by hand."""
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
    return tau_of(found.x[0])


def fit_sysidentpy(phi: FloatArray, y: FloatArray) -> float:
    """NARMAX with a polynomial basis of first degree in φ and φ²: extended least squares."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    terms = np.column_stack([phi, phi**2])
    model = FROLS(
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
    # Its code of y(k-1).
    return tau_of(found[1001])


def fit_sippy(phi: FloatArray, y: FloatArray) -> float:
    """SIPPY's default ARMAX: iterated linear least squares, on centred data."""
    from sippy_unipi import system_identification

    terms = np.column_stack([phi, phi**2])
    model = system_identification(
        y,
        terms.T,
        "ARMAX",
        centering="MeanVal",
        ARMAX_orders=[[1], [[1, 1]], [1], [[0, 0]]],
        ARMAX_mod="ILLS",
        tsample=PERIOD_S,
        max_iterations=200,
    )
    return tau_of(-model.DENOMINATOR[0][0][1])


def fit_statsmodels(phi: FloatArray, y: FloatArray) -> float:
    """SARIMAX: exact Gaussian likelihood of a regression with moving-average errors."""
    from statsmodels.tsa.statespace.sarimax import SARIMAX

    columns = np.column_stack([y[:-1], phi[:-1], phi[:-1] ** 2])
    mean, scale = columns.mean(axis=0), columns.std(axis=0)
    # In raw units its L-BFGS stops beside its start.
    exog = np.column_stack([(columns - mean) / scale, np.ones(y.size - 1)])
    target = (y[1:] - mean[0]) / scale[0]
    result = SARIMAX(target, exog=exog, order=(0, 0, 1)).fit(disp=False, maxiter=200)
    return tau_of(result.params[0])


def fit_jax_sysid(phi: FloatArray, y: FloatArray) -> float:
    """jax-sysid: simulation error of the ARMAX predictor written as a linear system.

    The prediction p[k+1] = -c p[k] + (a + c) y[k] + Σ b_i s_i[k] is a state of its own.
    """
    from jax_sysid.models import LinearModel

    terms = np.column_stack([phi, phi**2])
    columns = np.column_stack([y, terms])
    inputs = (columns - columns.mean(axis=0)) / columns.std(axis=0)
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
    return tau_of(float(gains[0]) + minus_c)


FITS: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "LagRegressor": fit_own,
    "scipy least_squares": fit_scipy,
    "sysidentpy ELS": fit_sysidentpy,
    "SIPPY ILLS": fit_sippy,
    "statsmodels SARIMAX": fit_statsmodels,
    "jax-sysid": fit_jax_sysid,
}


def attempt(name: str, phi: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return τ (nan where the fit failed) and processor seconds of one fit."""
    begun = time.process_time()
    try:
        # SystemExit: there are libraries that leave by sys.exit for a bad argument.
        with contextlib.redirect_stdout(io.StringIO()):
            found = float(FITS[name](phi, y))
    except (Exception, SystemExit):
        found = float("nan")
    return found, time.process_time() - begun


def main() -> None:
    name, records, results, cap_s = sys.argv[1:]
    warnings.simplefilter("ignore")
    with np.load(records) as file:
        phi, y = file["phi"], file["y"]
    # Imports within the first fit, and compilation that is kept, do not count.
    attempt(name, phi[0, :WARM_UP_ROWS], y[0, :WARM_UP_ROWS])
    rows = []
    begun = time.process_time()
    for row in range(y.shape[0]):
        if time.process_time() - begun > float(cap_s):
            break
        rows.append(attempt(name, phi[row], y[row]))
    Path(results).write_text(json.dumps(rows), "utf-8")


if __name__ == "__main__":
    main()
