"""Lag models taken apart and put together: linear coefficients by what they belong to."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from comparisons.missing_effect.candidates import Bench
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.metric import Metric
from comparisons.missing_effect.structure import Structure
from surge_core.types import FloatArray


def coefficient_groups(fit: Fit, data: LagData) -> dict[str, FloatArray]:
    """Take the linear coefficients of a fit apart, as `Structure.layout` names them."""
    layout = fit.structure.layout(data, fit.nonlinear)
    return {name: fit.coefficients[rows] for name, rows in layout.items()}


def assembled_fit(
    structure: Structure, data: LagData, nonlinear: FloatArray, groups: Mapping[str, FloatArray]
) -> Fit:
    """Put a model together from numbers given by group.

    Parameters
    ----------
    structure : Structure
        Terms and effects.
    data : LagData
        What the model is to be run on.
    nonlinear : ndarray of shape (p,)
        log τ and the parameters of the effects.
    groups : mapping of str to ndarray
        What is not among them, or of another number, gets zeros.
    """
    layout = structure.layout(data, nonlinear)
    coefficients = np.zeros(max(rows.stop for rows in layout.values()))
    for name, rows in layout.items():
        if name in groups and len(groups[name]) == rows.stop - rows.start:
            coefficients[rows] = groups[name]
    return Fit(structure, nonlinear, coefficients, 0.0)


def refitted_on(fit: Fit, data: LagData, metric: Metric) -> Fit:
    """Return a model fitted again to all of some rows."""
    return Bench(data, fit, metric, 1, 1).refitted(fit)
