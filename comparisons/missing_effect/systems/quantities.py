"""Numbers of effects in physical units, and their standard errors."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.covariance import largest_correlation, sandwich
from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from comparisons.missing_effect.systems.structure import Run
from comparisons.missing_effect.systems.units import product_of_units
from surge_core.types import FloatArray

# Blocks over which scores are summed for the sandwich: errors of neighbouring rows go together.
SANDWICH_BLOCKS = 40
POWERS = {Term.LINEAR: 1, Term.SQUARE: 2, Term.CUBE: 3, Term.DRAG: 2, Term.SIZE: 1, Term.GAP: 1}


def covariance(fit: Fit, runs: Sequence[Run], metric: Metric) -> FloatArray:
    """Return the covariance of θ, zero for what is not fitted: a sandwich over blocks of rows.

    Behind θ stand the parameters that each record has of its own, record by record.
    """
    # Offsets are held in the raw fit, but they are not known exactly.
    which = replace(fit.structure, offsets_free=True).free
    m, n_x = which.size, len(fit.structure.model.states)
    size = m + n_x * len(runs)
    if fit.failed:
        size = fit.theta.size + len(runs) * len(fit.structure.model.per_record)
        return np.full((size, size), np.nan)
    normal, scores = np.zeros((size, size)), []
    blocks = max(4, SANDWICH_BLOCKS // len(runs))
    answers = fit.whitened_answers(runs, metric.with_size_of(fit.errors), which)
    for (at, J, error), run in zip(answers, runs, strict=True):
        for rows in np.array_split(np.arange(run.n_samples), blocks):
            part = J[rows].reshape(-1, at.size)
            normal[np.ix_(at, at)] += part.T @ part
            score = np.zeros(size)
            score[at] = part.T @ error[rows].ravel()
            scores.append(score)
        normal[at[m:], at[m:]] += 1.0 / run.x0_sd**2
    spread, blind = sandwich(normal, np.array(scores))
    spread[blind, blind] = np.inf
    model = fit.structure.model
    of_records = [m + n_x * r + i for r in range(len(runs)) for i in range(model.own_states, n_x)]
    kept = np.r_[np.arange(m), np.array(of_records, dtype=np.int64)]
    at = np.r_[which, fit.theta.size + np.arange(len(of_records))]
    whole = np.zeros((at.size + fit.theta.size - m,) * 2)
    whole[np.ix_(at, at)] = spread[np.ix_(kept, kept)]
    return whole


def numbers_of(
    fit: Fit, placed: Placed, cov: FloatArray, clock: FloatArray
) -> tuple[FittedParameter, ...]:
    """Return the numbers of one effect in physical units.

    Parameters
    ----------
    fit : Fit
        With the effect.
    placed : Placed
        The effect.
    cov : ndarray
        Covariance of θ.
    clock : ndarray of shape (4,)
        Of a run: sample period, and middle and half length of the records' span.
    """
    model = fit.structure.model
    at = int(fit.structure.slots_of(placed)[0])
    out: list[tuple[str, float, float, str]] = []
    for slot, number in enumerate(placed.effect.numbers):
        if placed.held[slot] and not number.held:
            continue
        factor, unit = _factor(model, placed, slot, clock)
        if slot == 0 and placed.effect.resists:
            factor = -factor
        if placed.effect.kind == Kind.DRIFT:
            # Told as a share of the parameter as it is now, not as it was without the drift.
            factor *= placed.scales[0] / max(abs(float(fit.theta[placed.place.at])), 1e-300)
        value, variance = float(fit.theta[at + slot]), float(cov[at + slot, at + slot])
        out.append((number.name, factor * value, abs(factor) * float(np.sqrt(variance)), unit))
    if placed.effect.linear and placed.effect.kind in (Kind.TERM, Kind.HYSTERESIS):
        out = _balanced(fit, placed, cov, out, at)
    return tuple(FittedParameter(n, float(v), float(e), u) for n, v, e, u in out)


def correlation_of(fit: Fit, placed: Placed, cov: FloatArray) -> float:
    """Return the largest correlation of two numbers of one effect; 0 where it has no two."""
    at = fit.structure.slots_of(placed)[np.flatnonzero([not held for held in placed.held])]
    return largest_correlation(cov[np.ix_(at, at)])


def _balanced(
    fit: Fit,
    placed: Placed,
    cov: FloatArray,
    numbers: list[tuple[str, float, float, str]],
    at: int,
) -> list[tuple[str, float, float, str]]:
    """Tell an amplitude as a force where the user said which parameter multiplies dx/dt."""
    model = fit.structure.model
    name = model.state_names[placed.place.at]
    if name not in model.balance:
        return numbers
    parameter, unit = model.balance[name]
    i = model.param_names.index(parameter)
    mass = fit.theta[i]
    first, value, _, own = numbers[0]
    amplitude = fit.theta[at]
    slope = np.array([value, value * mass / amplitude if amplitude else 0.0])
    variance = float(slope @ cov[np.ix_([i, at], [i, at])] @ slope)
    stderr = float(np.sqrt(max(variance, 0.0)))
    whole = product_of_units((unit, 1), (own, 1), (model.states[name], -1), ("s", 1))
    return [(first, value * mass, stderr, whole), *numbers[1:]]


def _factor(model: Model, placed: Placed, slot: int, clock: FloatArray) -> tuple[float, str]:
    """Return the factor to physical units, and the unit, of one number."""
    kind, code = placed.effect.kind, placed.effect.code
    _, own, _ = placed.scales
    period_s, half_s = float(clock[1]), float(clock[3])
    if kind in (Kind.TERM, Kind.HYSTERESIS):
        return _term_factor(model, placed, slot)
    if kind in (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.OUTPUT_LAG):
        return period_s, "s"
    if kind == Kind.DRIFT:
        return 1.0 / half_s, "1/s"
    if kind == Kind.RECORDING:
        return (period_s, "s") if slot == 0 else (period_s**2, "s²")
    unit = _channel_unit(model, placed)
    if kind == Kind.OUTPUT_MAP and code in (Map.SQUARE, Map.CUBE):
        power = 1 if code == Map.SQUARE else 2
        return own**-power, product_of_units((unit, -power))
    number = slot > 0 or (kind == Kind.OUTPUT_MAP and code == Map.ABSOLUTE)
    return (1.0, "1") if number else (own, unit)


def _term_factor(model: Model, placed: Placed, slot: int) -> tuple[float, str]:
    """Return factor and unit of a number of a term in an equation."""
    kind, code, place = placed.effect.kind, placed.effect.code, placed.place
    into, own, other, *_ = placed.floats
    units = [*model.states.values(), *model.inputs.values()]
    signal = units[place.signal] if place.signal >= 0 else "1"
    enters = (units[place.at], 1), ("s", -1)
    if kind == Kind.HYSTERESIS:
        return (
            (into, product_of_units(*enters)),
            (own * other, product_of_units((signal, 1), ("s", 1))),
            (1.0, "1"),
        )[slot]
    if slot > 0:
        return (own, signal) if slot == 1 else (1.0, "1")
    if code == Term.CALLED:
        return into / own, product_of_units(*enters, (_unit_of_term(model, placed), -1))
    if code in (Term.PRODUCT, Term.SQUARE_PRODUCT):
        power = 1 if code == Term.PRODUCT else 2
        unit = product_of_units(*enters, (signal, -power), (units[place.other], -1))
        return into / (own**power * other), unit
    power = POWERS.get(Term(code), 0)
    return into / own**power, product_of_units(*enters, (signal, -power))


def _unit_of_term(model: Model, placed: Placed) -> str:
    """Return the unit of a term of the user's own, "1" for what is no product of powers."""
    written = placed.effect.equation.removeprefix("+ c ")
    params = {name: q.unit for name, q in model.params.items()}
    known: dict[str, str] = {**model.states, **model.inputs, **params}
    names = set(re.findall(r"[^\W\d]\w*", written))
    if not names <= set(known) or re.search(r"[^\w\s^*/·²³]", written):
        return "1"
    return re.sub(r"[^\W\d]\w*", lambda name: f"({known[name[0]]})", written)


def _channel_unit(model: Model, placed: Placed) -> str:
    kind, at = placed.effect.kind, placed.place.at
    if kind in (Kind.OUTPUT_MAP, Kind.OUTPUT_LAG):
        return list(model.outputs.values())[at]
    if kind in (Kind.STATE_LIMIT, Kind.OVERFLOW):
        return str(list(model.states.values())[at])
    return list(model.inputs.values())[at]
