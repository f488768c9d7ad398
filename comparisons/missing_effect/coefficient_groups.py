"""Lag models taken apart, put together and fitted again: coefficients by what they belong to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.candidates import Bench
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.metric import Metric
from comparisons.missing_effect.structure import Structure
from comparisons.missing_effect.uncertainty import linear_columns
from surge_core.types import FloatArray


@dataclass(frozen=True)
class CoefficientGroups:
    """The linear coefficients of one model.

    Parameters
    ----------
    terms : ndarray of shape (n_terms,)
        Of the characteristic.
    effects : mapping of str to ndarray
        Of each effect that has columns, by its name.
    nuisance : ndarray of shape (k,)
        Of the inputs that belong to no characteristic.
    """

    terms: FloatArray
    effects: Mapping[str, FloatArray]
    nuisance: FloatArray


def coefficient_groups(fit: Fit, data: LagData) -> CoefficientGroups:
    """Take the linear coefficients of a fit apart.

    Parameters
    ----------
    fit : Fit
        A fitted model.
    data : LagData
        What it was fitted to.
    """
    columns = linear_columns(fit, data)
    n_terms, n_nuisance = len(fit.structure.terms), data.nuisance.shape[1]
    first = _n_driven(fit.structure, data, fit.nonlinear)
    return CoefficientGroups(
        fit.coefficients[:n_terms],
        {name: fit.coefficients[rows] for name, rows in columns.items()},
        fit.coefficients[first : first + n_nuisance],
    )


def assembled_fit(
    structure: Structure, data: LagData, nonlinear: FloatArray, groups: CoefficientGroups
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
    groups : CoefficientGroups
        Effects that are not among them get zeros; so do nuisances of another number.
    """
    empty = Fit(structure, nonlinear, np.zeros(0), 0.0)
    columns = linear_columns(empty, data)
    n_terms, n_nuisance = len(structure.terms), data.nuisance.shape[1]
    size = n_terms + n_nuisance + sum(rows.stop - rows.start for rows in columns.values())
    coefficients = np.zeros(size)
    coefficients[:n_terms] = groups.terms
    for name, rows in columns.items():
        if name in groups.effects:
            coefficients[rows] = groups.effects[name]
    if groups.nuisance.size == n_nuisance:
        first = _n_driven(structure, data, nonlinear)
        coefficients[first : first + n_nuisance] = groups.nuisance
    return Fit(structure, nonlinear, coefficients, 0.0)


def refitted_on(fit: Fit, data: LagData, metric: Metric) -> Fit:
    """Return a model fitted again to all of some rows.

    Parameters
    ----------
    fit : Fit
        Where to start.
    data : LagData
        Rows, all of them to be fitted.
    metric : Metric
        How errors are weighed.
    """
    return Bench(data, fit, metric, 1, 1).refitted(fit)


def _n_driven(structure: Structure, data: LagData, nonlinear: FloatArray) -> int:
    return int(structure.ports(data, nonlinear).driven.shape[1])
