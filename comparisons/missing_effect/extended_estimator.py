"""A lag model with effects beside the other estimators of a comparison."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.series import CoefficientSeries
from comparisons.harness.estimators import EstimatorSpec
from comparisons.missing_effect.extended_lag import ExtendedLag
from comparisons.missing_effect.extended_parts import REVERSE, SHAPE, by_record, on_segments
from comparisons.missing_effect.extended_refit import refitted
from comparisons.results import FitRows
from surge_core.types import FloatArray

_CURVE_NAMES = {REVERSE: "phi^2[phi<0]", SHAPE: "characteristic_shape"}


@dataclass(frozen=True)
class ExtendedLagFit:
    """A fitted lag model with effects, with the attributes of an estimator.

    Its terms and its characteristic are functions of φ alone; what else the model holds is in
    ``extended_``, which reconstructs.

    Parameters
    ----------
    extended_ : ExtendedLag
        The model.
    from_whole_runs_ : bool
        Whether it was fitted to unfiltered signals of whole records.
    """

    extended_: ExtendedLag
    from_whole_runs_: bool = False

    @property
    def time_constant_s_(self) -> float:
        """τ, in seconds."""
        return self.extended_.time_constant_s

    @property
    def time_constant_stderr_s_(self) -> float:
        """Its standard error, in seconds."""
        return self.extended_.time_constant_stderr_s

    @property
    def terms_(self) -> list[str]:
        """Names of the terms, effects that are functions of φ alone among them."""
        bent = [_CURVE_NAMES[name] for name in self._bending]
        return [*self.extended_.terms, *bent]

    @property
    def coef_(self) -> FloatArray:
        """One coefficient a term; of a free shape the largest it adds."""
        return np.array([*self.extended_.coefficients, *self._bent(0)])

    @property
    def covariance_(self) -> FloatArray:
        """Variances of the coefficients; those between them are in the characteristic's error."""
        return np.diag(np.array([*self.extended_.stderr, *self._bent(1)]) ** 2)

    @property
    def n_blocks_(self) -> int:
        """Blocks behind the standard errors."""
        return self.extended_.n_blocks

    @property
    def cautions_(self) -> tuple[str, ...]:
        """What a reader should know of its scores."""
        words = [
            f"{name} is left out of the reconstruction: its phase is not known beforehand"
            for name in self.extended_.left_out
        ]
        if self.from_whole_runs_:
            words.append("fitted to unfiltered signals, scored on the filtered rows of the others")
        return tuple(words)

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ψ'_QS and its standard error at φ, of shape (n,)."""
        points = np.asarray(phi, dtype=np.float64)
        grid, _, stderr = np.asarray(self.extended_.table).T
        return self.extended_.quasi_steady(points), np.interp(points, grid, stderr)

    @property
    def _bending(self) -> tuple[str, ...]:
        names, _ = self.extended_.curve_terms()
        return names[len(self.extended_.terms) :]

    def _bent(self, which: int) -> list[float]:
        """Return the amplitudes of what bends the curve, or their standard errors."""
        by_name = {added.name: added for added in self.extended_.effects}
        found = [by_name[name] for name in self._bending]
        return [(added.values, added.stderr)[which][0] for added in found]


def extended_specs(
    models: Mapping[str, ExtendedLag], taken: Collection[str] = ()
) -> tuple[EstimatorSpec, ...]:
    """Return how models read from a file take part in a comparison: refitted, structure kept.

    One whose name another estimator has (``taken``) is called ``extended_…``.
    """
    specs = []
    for key, model in models.items():
        name = f"extended_{key}" if key in taken else key
        named = replace(model, estimator=name)
        specs.append(
            EstimatorSpec(
                name,
                model.label,
                partial(_fit_rows, named),
                partial(_fit_records, named),
            )
        )
    return tuple(specs)


def _fit_records(
    model: ExtendedLag, records: Sequence[CoefficientSeries], until_s: Sequence[float] | None
) -> ExtendedLagFit:
    return ExtendedLagFit(refitted(model, records, until_s), from_whole_runs_=True)


def _fit_rows(
    model: ExtendedLag, rows: FitRows, records: Sequence[CoefficientSeries]
) -> ExtendedLagFit:
    """Fit the rows alone, with what their records know beside φ."""
    marked = []
    for record, own, at in by_record(rows, records):
        if np.any(own):
            labels = np.zeros(record.n_samples, dtype=np.int64)
            labels[at] = rows.labels[own]
            marked.append(on_segments(record, labels))
    return ExtendedLagFit(refitted(model, marked))
