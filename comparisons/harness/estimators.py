"""The estimators of a comparison, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, Literal

import numpy as np

from classic_ml.characteristics import PiecewiseLinear
from classic_ml.lag_regressor import LagRegressor
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record_fit import N_TWINS
from classic_ml.whole_record_run import fit_whole_records, has_rakes
from classic_ml.whole_run import fit_whole_runs
from classic_ml.whole_run_rows import has_whole_run
from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs
from comparisons.results import ESTIMATOR_LABELS, FitRows
from sindy_surge import SparseLagRegressor
from sindy_surge.library import piecewise_linear_library
from surge_core.lag import Hold


@dataclass(frozen=True)
class EstimatorSpec:
    """How one estimator of a comparison is made.

    Parameters
    ----------
    name : str
        Key in the JSON.
    label : str
        What people call it.
    fit_rows : callable
        ``fit_rows(rows, records) -> fitted`` takes the rows, and the records that they come from
        for a model that needs more channels than φ.
    fit_records : callable, optional
        ``fit_records(records, until_s) -> fitted`` takes whole records in place of the rows, each
        scored up to a time of its own (None: all of it), where they carry what it needs.
    carries : callable
        Whether a record does.
    """

    name: str
    label: str
    fit_rows: Callable[[FitRows, Sequence[CoefficientSeries]], Any]
    fit_records: Callable[[Sequence[CoefficientSeries], Sequence[float] | None], Any] | None = None
    carries: Callable[[CoefficientSeries], bool] = has_whole_run

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
        whole = rows.target == "psi_p" and all(map(self.carries, records))
        if self.fit_records is not None and whole:
            return self.fit_records(records, until_s)
        return self.fit_rows(rows, records)


def default_estimators(
    *,
    degree: int = 2,
    hold: Hold = "first",
    breakpoints: tuple[float, float] | None = None,
    time_constant_s: float | None = None,
    n_twins: int = N_TWINS,
    measuring: Callable[[Iterable[int]], Iterable[int]] = iter,
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
    n_twins : int
        Twins of each record behind the interval of ``classic_ml``.
    measuring : callable
        Wraps the iteration over the twins, to show how far it is.
    """

    def classical(
        noise: Literal["arx", "armax", "output-error"], rows: FitRows, _: Any
    ) -> LagRegressor:
        # The classical recursion, as in the paper's program. On data low-passed at 48 Hz C has a
        # root near the unit circle and remembers the start through a whole segment, so that the
        # two starts give different curves.
        model = LagRegressor(
            rows.sample_period_s,
            noise=noise,
            degree=degree,
            hold=hold,
            basis=PiecewiseLinear(breakpoints) if breakpoints else None,
            exact_start=False,
            time_constant_s=time_constant_s,
        )
        return model.fit(rows.X, rows.measured, segments=rows.labels)

    def sparse(rows: FitRows, _: Any) -> Any:
        # Terms with ψ' are not what a characteristic over φ is; `SparseLagRegressor` alone looks
        # for them.
        options: dict[str, Any] = {"hold": hold, "psi_terms": False, "output_name": rows.target}
        if rows.target == "psi":
            # A line and two breakpoints, as in Fig 22; here the data choose where.
            options |= {"library": piecewise_linear_library(rows.X), "max_terms": 4}
            options["constraints"] = {"1": "required"}
        model = SparseLagRegressor(rows.sample_period_s, **options)
        return model.fit(rows.X, rows.measured, segments=rows.labels)

    def whole(records: Sequence[CoefficientSeries], until_s: Sequence[float] | None) -> Any:
        if hold == "first" and time_constant_s is None:
            return fit_whole_records(
                records, degree=degree, until_s=until_s, n_twins=n_twins, progress=measuring
            )
        return fit_whole_runs(
            records, degree=degree, hold=hold, time_constant_s=time_constant_s, until_s=until_s
        )

    def sparse_whole(records: Sequence[CoefficientSeries], until_s: Sequence[float] | None) -> Any:
        return fit_sparse_whole_runs(records, hold=hold, until_s=until_s)

    def carries(record: CoefficientSeries) -> bool:
        return has_whole_run(record) or (has_rakes(record) and time_constant_s is None)

    specs: dict[str, tuple[Any, ...]] = {
        "classic_ml": (partial(classical, "armax"), whole, carries),
        "paper": (partial(classical, "armax"), None),
        "classic_ml_arx": (partial(classical, "arx"), None),
        "classic_ml_output_error": (partial(classical, "output-error"), None),
        "sindy": (sparse, sparse_whole),
    }
    return tuple(
        EstimatorSpec(name, ESTIMATOR_LABELS[name], *fits)
        for name, fits in specs.items()
        # The paper has no way of its own to the work coefficient beside that of classic_ml.
        if not (breakpoints and name == "paper")
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
    deciles = np.percentile(rows.phi, np.arange(10, 100, 10))
    apart = 0.1 * float(np.ptp(rows.phi))
    pairs = [(float(a), float(b)) for a, b in combinations(deciles, 2) if b - a > apart]

    def cost(pair: tuple[float, float]) -> float:
        basis = PiecewiseLinear(pair)
        model = LagRegressor(rows.sample_period_s, noise="arx", hold=hold, basis=basis)
        return float(model.fit(rows.X, rows.measured, rows.labels).residual_std_)

    # A φ that hardly ever moves has no pair of deciles that far apart.
    low, high = min(pairs or [(float(deciles[0]), float(rows.phi.max()))], key=cost)
    # Three decimals of φ are what a characteristic can be read to; names stay short.
    return (round(low, 3), round(high, 3)) if high - low > 1e-3 else (low, high)
