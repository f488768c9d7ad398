"""Errors on all rows of a model whose ripple has a phase of its own in each episode."""

from __future__ import annotations

import numpy as np

from comparisons.missing_effect.catalogue.output_effects import stall_episodes
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData
from comparisons.missing_effect.metric import Metric
from surge_core.types import FloatArray


def errors_on(fit: Fit, data: LagData, metric: Metric) -> tuple[FloatArray, tuple[float, float]]:
    """Return the errors on all rows of a fit to the fitted ones, and what phases cost.

    The phase of a ripple means nothing in another episode: where it was not fitted it is fitted
    again, at the amplitude of the rest, and costs one log-unit, in later time or another record.
    """
    ripple = next((effect for effect in fit.structure.effects if effect.episodes), None)
    if ripple is None:
        return fit.errors(data, metric), (0.0, 0.0)
    bare, values = without_episodes(fit, ripple, data.train)
    errors = bare.errors(data, metric)
    amplitudes = fit.coefficients[bare.coefficients.size :]
    size = float(np.sqrt(2.0 * np.mean(amplitudes**2))) if amplitudes.size else 0.0
    phase = 2.0 * np.pi * values[0] * data.sampled(data["time_s"])
    costs = {TRAIN: 0.0, LATER: 0.0, OTHER: 0.0}
    for rows in stall_episodes(data, float(values[1])):
        near = slice(rows.start, min(rows.stop + metric.ar.size, data.n_samples))
        columns = np.zeros((data.n_samples, 2))
        columns[rows, 0], columns[rows, 1] = np.sin(phase[rows]), np.cos(phase[rows])
        seen = metric.whitened(columns, data)[near]
        along = np.linalg.lstsq(seen, errors[near], rcond=None)[0]
        part, norm = int(data.part[rows].max()), float(np.hypot(*along))
        if part != TRAIN and norm > 0.0:
            along = along * (size / norm)
            costs[part] += 1.0
        errors[near] -= seen @ along
    return errors, (costs[LATER], costs[OTHER])


def without_episodes(fit: Fit, ripple: Effect, data: LagData) -> tuple[Fit, FloatArray]:
    """Return a fit without the columns of its ripple, and the ripple's values."""
    values = fit.values_of(ripple)
    structure, nonlinear = fit.structure.without(ripple, fit.nonlinear)
    # The ripple stands last behind the lag, so its columns are the last ones.
    own = 2 * len(stall_episodes(data, float(values[1])))
    return Fit(structure, nonlinear, fit.coefficients[: fit.coefficients.size - own], 0.0), values
