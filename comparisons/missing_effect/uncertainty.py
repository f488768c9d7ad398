"""Standard errors of the numbers of a fit, and how large an effect is beside its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.missing_effect.candidates import Bench
from comparisons.missing_effect.catalogue.workings import shape_columns, stall_episodes
from comparisons.missing_effect.covariance import orthonormal, sandwich
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import Fit, solved
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.open_terms import with_own_state
from comparisons.missing_effect.ports import n_powers
from surge_core.types import FloatArray

# Below this many standard errors an effect is not distinguished from none: its 95 % interval
# holds zero.
LEAST_SIZE = 2.0
# Directions of all other numbers that are no rounding.
LEAST_BASIS = 1e-9

# Steps of a threshold, as shares of the range of φ.
JUMP_STEPS = (1e-4, 2e-4, 3e-4, 5e-4, 7e-4, 1e-3, 2e-3, 3e-3)


def fitted_parameters(
    fit: Fit, bench: Bench, covariance: FloatArray
) -> dict[str, tuple[FittedParameter, ...]]:
    """Return the numbers of each effect with their standard errors.

    The covariance is that of clusters: the errors of one surge cycle may depend on each other.
    """
    data = with_own_state(bench.data, fit)
    free = list(fit.structure.free)
    stderr = np.zeros(fit.nonlinear.size)
    stderr[free] = np.sqrt(np.maximum(np.diag(covariance)[: len(free)], 0.0))
    stderr = _over_jumps(fit, data, bench, stderr)
    linear = np.sqrt(np.maximum(np.diag(covariance)[len(free) :], 0.0))
    out = {}
    columns = fit.structure.layout(data, fit.nonlinear)
    for effect in fit.structure.effects:
        slots, numbers = iter(fit.structure.slots[effect.name]), []
        for parameter in effect.parameters:
            if parameter.kind == "linear":
                value, error = _amplitude(effect, fit, data, columns[effect.name], linear)
            else:
                at = next(slots)
                value, error = float(fit.nonlinear[at]), float(stderr[at])
            numbers.append(FittedParameter(parameter.name, value, error, parameter.unit))
        out[effect.name] = tuple(numbers)
    return out


def _over_jumps(fit: Fit, data: LagData, bench: Bench, stderr: FloatArray) -> FloatArray:
    """Widen the errors of thresholds that φ turns back at: there the slope on one side misleads.

    Each of several steps to either side is taken for as many standard errors as it costs.
    """
    out = stderr.copy()
    reach = data.phi_range[1] - data.phi_range[0]
    here = solved(fit.structure, data, bench.metric, fit.nonlinear).cost
    for at in fit.structure.switching:
        for step in JUMP_STEPS:
            for sign in (-1.0, 1.0):
                there = fit.nonlinear.copy()
                there[at] += sign * step * reach
                lost = solved(fit.structure, data, bench.metric, there).cost - here
                # A step that costs half a log-unit is one standard error.
                error = step * reach / float(np.sqrt(2.0 * max(lost, 0.5)))
                out[at] = max(out[at], error)
    return out


def _amplitude(
    effect: Effect, fit: Fit, data: LagData, rows: slice, stderr: FloatArray
) -> tuple[float, float]:
    coefficients, errors = fit.coefficients[rows], stderr[rows]
    if effect.name == "characteristic_shape":
        intervals, low, high = fit.values_of(effect).tolist()
        grid = np.linspace(low, high, 200)
        curve = shape_columns(grid, (low, high), int(intervals), n_powers(fit.structure.terms))
        added = curve @ coefficients
        worst = int(np.argmax(np.abs(added)))
        return float(added[worst]), float(np.sqrt(np.sum((curve[worst] * errors) ** 2)))
    if effect.episodes:
        size = float(np.sqrt(2.0 * np.mean(coefficients**2)))
        n = len(stall_episodes(data, float(fit.values_of(effect)[1])))
        return size, float(np.sqrt(np.mean(errors**2) / max(n, 1)))
    return float(coefficients[0]), float(errors[0])


def covariance_of(fit: Fit, bench: Bench) -> FloatArray:
    """Return the covariance of the free parameters of a fit, then its linear ones."""
    data = with_own_state(bench.data, fit)
    solution = solved(fit.structure, data, bench.metric, fit.nonlinear)
    slopes = fit.structure.slopes(data, fit.nonlinear, solution.coefficients, fit.structure.free)
    answer = fit.structure.respond(data, fit.nonlinear)
    seen = bench.metric.seen(np.column_stack([slopes, answer.columns]), solution.decay, data)
    rows = bench.rows
    scores = seen * solution.errors[:, None]
    counted = rows.block >= 0
    sums = np.zeros((int(rows.block.max()) + 1, seen.shape[1]))
    np.add.at(sums, rows.block[counted], scores[counted])
    return sandwich(seen.T @ seen, sums)[0]


def size_in_errors(effect: Effect, fit: Fit, bench: Bench) -> float:
    """Return how many standard errors large what an effect does to the answer is.

    It is taken as a whole, since its numbers may each be worth nothing where what they make
    together is well known (a slow drift has a rate, and neither a size nor a time), and both may
    stand at their bounds, where slopes tell no error. Of what the answer loses with the amplitude
    at zero, the part that nothing else in the model can make up for is compared with what the
    errors are in that direction; those of one block may depend on each other.
    """
    data, structure = with_own_state(bench.data, fit), fit.structure
    solution = solved(structure, data, bench.metric, fit.nonlinear)
    fit = replace(fit, coefficients=solution.coefficients)
    lost = fit.output(data) - fit.without_amplitude(effect, data).output(data)
    free = [i for i in structure.free if i not in structure.slots[effect.name]]
    slopes = structure.slopes(data, fit.nonlinear, solution.coefficients, free)
    columns = structure.respond(data, fit.nonlinear).columns
    if effect.linear:
        columns = np.delete(columns, fit.structure.layout(data, fit.nonlinear)[effect.name], axis=1)
    joint = np.column_stack([lost, slopes, columns])
    seen = bench.metric.seen(joint, solution.decay, data)
    basis = orthonormal(seen[:, 1:], LEAST_BASIS)
    alone = seen[:, 0] - basis @ (basis.T @ seen[:, 0])
    counted = bench.rows.block >= 0
    sums = np.bincount(bench.rows.block[counted], (alone * solution.errors)[counted])
    n_blocks = int(np.unique(bench.rows.block[counted]).size)
    error = float(np.sqrt(np.sum(sums**2) * n_blocks / max(n_blocks - 1, 1)))
    squared = float(alone @ alone)
    return squared / error if error > 0.0 else (np.inf if squared > 0.0 else 0.0)
