"""The estimators of a comparison, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.rows import FitRows
from surge_core.lag import Hold

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
    fit_records : callable, optional
        ``fit_records(records, until_s) -> fitted`` takes whole records in place of the rows, each
        scored up to a time of its own (None: all of it), where they carry what it needs.
    fit_rows : callable, optional
        ``fit_rows(rows, records) -> fitted`` takes the rows and the records they come from, in
        place of ``build``, for a model that needs more channels than φ.
    """

    name: str
    label: str
    build: Callable[[FitRows], Any]
    fit_records: Callable[[Sequence[CoefficientSeries], Sequence[float] | None], Any] | None = None
    fit_rows: Callable[[FitRows, Sequence[CoefficientSeries]], Any] | None = None

    def fitted(
        self, rows: FitRows, records: Sequence[CoefficientSeries], until_s: Sequence[float] | None
    ) -> Any:
        """Fit whole records where this estimator can and they carry what it takes, else the rows.

        Parameters
        ----------
        rows : FitRows
            The rows, only those to be fitted.
        records : sequence of CoefficientSeries
            The records they come from.
        until_s : sequence of float, optional
            Time up to which each record is fitted.
        """
        if self.fit_records is not None and rows.target == "psi_p" and _are_whole(records):
            return self.fit_records(records, until_s)
        if self.fit_rows is not None:
            return self.fit_rows(rows, records)
        return self.build(rows).fit(rows.X, rows.measured, segments=rows.labels)


def default_estimators(
    *,
    degree: int = 2,
    hold: Hold = "first",
    breakpoints: tuple[float, float] | None = None,
    time_constant_s: float | None = None,
) -> tuple[EstimatorSpec, ...]:
    """Return maximum likelihood, the paper's way, two other noise models, and sparse regression.

    ``classic_ml`` and ``sindy`` are one free run through each whole record, from unfiltered
    signals, where the reduction left them in the series; else they are armax and the sparse
    regression on the rows. ``paper`` is armax on the rows always.

    Parameters
    ----------
    degree : int
        Degree of the classical pressure characteristic.
    hold : {"zero", "first"}
        How φ acts between samples; the same for all.
    breakpoints : tuple of float, optional
        Take the piecewise-linear inputs of Fig 22 in place of the polynomial, as the paper does
        for the work coefficient.
    time_constant_s : float, optional
        Hold τ of the classical estimators at this value, as the paper had to.
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
                time_constant_s=time_constant_s,
            )

        return build

    def sparse(rows: FitRows) -> Any:
        from sindy_surge import SparseLagRegressor
        from sindy_surge.library import piecewise_linear_library

        # Terms with ψ' are not what a characteristic over φ is; `SparseLagRegressor` by itself
        # looks for them.
        plain: dict[str, Any] = {"hold": hold, "psi_terms": False, "output_name": rows.target}
        if rows.target == "psi_p":
            return SparseLagRegressor(rows.sample_period_s, **plain)
        # A line and two breakpoints, as in Fig 22; here the data choose where.
        return SparseLagRegressor(
            rows.sample_period_s,
            library=piecewise_linear_library(rows.X),
            max_terms=4,
            constraints={"1": "required"},
            **plain,
        )

    def whole(records: Sequence[CoefficientSeries], until_s: Sequence[float] | None) -> Any:
        from classic_ml.whole_run import fit_whole_runs

        return fit_whole_runs(
            records, degree=degree, hold=hold, time_constant_s=time_constant_s, until_s=until_s
        )

    def sparse_whole(records: Sequence[CoefficientSeries], until_s: Sequence[float] | None) -> Any:
        from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs

        return fit_sparse_whole_runs(records, hold=hold, until_s=until_s)

    # The paper has no way of its own to the work coefficient beside that of classic_ml.
    paper = EstimatorSpec("paper", "the paper's way (armax)", classical("armax"))
    return (
        EstimatorSpec("classic_ml", "maximum likelihood", classical("armax"), whole),
        *(() if breakpoints else (paper,)),
        EstimatorSpec("classic_ml_arx", "least squares (arx)", classical("arx")),
        EstimatorSpec(
            "classic_ml_output_error", "free run (output error)", classical("output-error")
        ),
        EstimatorSpec("sindy", "sparse regression (SINDy)", sparse, sparse_whole),
    )


def _are_whole(records: Sequence[CoefficientSeries]) -> bool:
    from classic_ml.whole_run import has_whole_run

    return all(has_whole_run(record) for record in records)


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
