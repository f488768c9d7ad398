"""The estimators of a comparison, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from classic_ml.first_order_lag import Hold
from comparisons.fit_rows import FitRows

__all__ = ["EstimatorSpec", "default_estimators", "psi_breakpoints"]


@dataclass(frozen=True)
class EstimatorSpec:
    """How one estimator of a comparison is made.

    Parameters
    ----------
    name : str
        Key in the JSON.
    label : str
        What people call it.
    build : callable
        ``build(rows) -> estimator``, unfitted, following scikit-learn's contract and DESIGN
        section 5; ``fit(X, y, segments)`` is called on it.
    """

    name: str
    label: str
    build: Callable[[FitRows], Any]


def default_estimators(
    *,
    degree: int = 2,
    hold: Hold = "first",
    breakpoints: tuple[float, float] | None = None,
) -> tuple[EstimatorSpec, ...]:
    """Return the paper's way in its three noise models, and the sparse regression.

    Parameters
    ----------
    degree : int
        Degree of the classical pressure characteristic.
    hold : {"zero", "first"}
        How φ acts between samples; the same for all.
    breakpoints : tuple of float, optional
        Take the piecewise-linear inputs of Fig 22 in place of the polynomial, as the paper does
        for the work coefficient.
    """

    def classical(noise: str) -> Callable[[FitRows], Any]:
        def build(rows: FitRows) -> Any:
            from classic_ml import LagRegressor, PiecewiseLinear

            basis = PiecewiseLinear(breakpoints) if breakpoints else None
            return LagRegressor(
                rows.sample_period_s,
                noise=noise,  # type: ignore[arg-type]
                degree=degree,
                hold=hold,
                basis=basis,
                # The classical recursion, as in the paper's program. On data low-passed at 48 Hz
                # C has a root near the unit circle and remembers the start through a whole
                # segment, so that the two starts give different curves.
                exact_start=False,
            )

        return build

    def sparse(rows: FitRows) -> Any:
        from sindy_surge import SparseLagRegressor

        return SparseLagRegressor(sample_period_s=rows.sample_period_s, hold=hold)

    return (
        EstimatorSpec("classic_ml", "maximum likelihood (armax)", classical("armax")),
        EstimatorSpec("classic_ml_arx", "least squares (arx)", classical("arx")),
        EstimatorSpec(
            "classic_ml_output_error", "free run (output error)", classical("output-error")
        ),
        EstimatorSpec("sindy", "sparse regression (SINDy)", sparse),
    )


def psi_breakpoints(rows: FitRows, hold: Hold = "first") -> tuple[float, float]:
    """Choose the two breakpoints of Fig 22 that fit best, from the deciles of φ.

    The paper fixed them beforehand from low-speed data; without such data they are searched
    among the pairs of deciles at least a tenth of the range apart.

    Parameters
    ----------
    rows : FitRows
        The rows to be fitted.
    hold : {"zero", "first"}
        How φ acts between samples.
    """
    from classic_ml import LagRegressor, PiecewiseLinear

    deciles = np.percentile(rows.phi, np.arange(10, 100, 10))
    apart = 0.1 * float(np.ptp(rows.phi))
    pairs = [(a, b) for a, b in combinations(deciles, 2) if b - a > apart]
    if not pairs:
        low, high = np.percentile(rows.phi, [30.0, 70.0])
        return float(low), float(max(high, low + max(apart, 1e-6)))
    costs = []
    for pair in pairs:
        model = LagRegressor(
            rows.sample_period_s, noise="arx", hold=hold, basis=PiecewiseLinear(pair)
        ).fit(rows.X, rows.measured, rows.labels)
        costs.append(model.residual_std_)
    return _rounded(pairs[int(np.argmin(costs))])


def _rounded(pair: tuple[float, float]) -> tuple[float, float]:
    # Three decimals of φ are what a characteristic can be read to; names stay short.
    low, high = round(float(pair[0]), 3), round(float(pair[1]), 3)
    return (low, high) if low < high else (float(pair[0]), float(pair[1]))
