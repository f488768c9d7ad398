"""The paper's estimator with its own switches, and fits with the time constant held."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from classic_ml import LagRegressor, PiecewiseLinear
from classic_ml.series import CoefficientSeries
from comparisons.harness.estimators import psi_breakpoints
from comparisons.harness.fit_quality import trusted_range
from comparisons.harness.rows import stack_rows
from comparisons.results import FitRows, FittedLag
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray

__all__ = ["fit_held", "fit_paper", "fit_steady"]

CURVE_POINTS = 121
TERMS = ("1", "phi", "phi^2")


def fit_paper(
    series: CoefficientSeries,
    *,
    target: str = "psi_p",
    link_segments: bool = False,
    basis: Any = None,
) -> FittedLag:
    """Fit Eq 9 by maximum likelihood with zero-order hold: a parabola (Eq 12), for ψ Fig 22.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    target : {"psi_p", "psi"}
        Which coefficient.
    link_segments : bool
        Link the in-stall intervals into one series, as the paper did.
    basis : scikit-learn transformer, optional
        Other terms.

    Returns
    -------
    FittedLag
        τ and the characteristic.
    """
    rows = stack_rows([series], target)
    if basis is None and target == "psi":
        basis = PiecewiseLinear(psi_breakpoints(rows, "zero"))
    model = LagRegressor(
        rows.sample_period_s,
        noise="armax",
        degree=2,
        hold="zero",
        basis=basis,
        link_segments=link_segments,
        exact_start=False,
    ).fit(rows.X, rows.measured, segments=rows.labels)
    name = "classic_ml_linked" if link_segments else "classic_ml"
    return FittedLag.from_estimator(
        model, name, target, "zero", _grid(rows), trusted_range(rows.phi)
    )


def fit_held(series: CoefficientSeries, time_constant_s: float) -> FittedLag:
    """Fit the parabola of ψ' with the time constant held: linear least squares on the free run.

    Each segment has a start of its own, as in a reconstruction.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    time_constant_s : float
        The time constant, in seconds.

    Returns
    -------
    FittedLag
        The curve; the standard error of the time constant is 0, since it was not estimated.
    """
    rows = stack_rows([series])
    lag = FirstOrderLag(time_constant_s, rows.sample_period_s, "zero")
    powers = np.vander(rows.phi, len(TERMS), increasing=True)
    columns = np.zeros((rows.phi.size, len(TERMS) + rows.n_segments))
    for i, run in enumerate(rows.runs):
        columns[run, : len(TERMS)] = lag.respond(powers[run], np.zeros(len(TERMS)))
        columns[run, len(TERMS) + i] = lag.decay(run.stop - run.start)
    return _linear(rows, columns, time_constant_s, 0.0)


def fit_steady(series: CoefficientSeries) -> FittedLag:
    """Fit a static parabola to a steady record, as a low-speed test gives it.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record of steady stall.

    Returns
    -------
    FittedLag
        The curve, with a time constant of nan.
    """
    rows = stack_rows([series])
    powers = np.vander(rows.phi, len(TERMS), increasing=True)
    return _linear(rows, powers, math.nan, math.nan)


def _linear(rows: FitRows, columns: FloatArray, tau_s: float, stderr_s: float) -> FittedLag:
    solution, *_ = np.linalg.lstsq(columns, rows.measured)
    error = rows.measured - columns @ solution
    variance = float(np.mean(error**2))
    covariance = (variance * np.linalg.pinv(columns.T @ columns))[: len(TERMS), : len(TERMS)]
    grid = _grid(rows)
    powers = np.vander(grid, len(TERMS), increasing=True)
    value = powers @ solution[: len(TERMS)]
    spread = np.sqrt(np.einsum("ij,jk,ik->i", powers, covariance, powers))
    return FittedLag(
        "held",
        rows.target,
        tau_s,
        stderr_s,
        TERMS,
        tuple(float(b) for b in solution[: len(TERMS)]),
        tuple(float(s) for s in np.sqrt(np.diag(covariance))),
        "zero",
        trusted_range(rows.phi),
        tuple(zip(grid.tolist(), value.tolist(), spread.tolist(), strict=True)),
    )


def _grid(rows: FitRows) -> FloatArray:
    return np.linspace(float(rows.phi.min()), float(rows.phi.max()), CURVE_POINTS)
