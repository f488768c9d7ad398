"""Numbers of effects in physical units, and their standard errors."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.covariance import largest_correlation, sandwich
from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import AT_OUTPUTS, Placed
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from comparisons.missing_effect.systems.structure import Run
from comparisons.missing_effect.systems.units import product_of_units
from surge_core.types import FloatArray, IntArray

# Blocks over which scores are summed for the sandwich: errors of neighbouring rows go together.
SANDWICH_BLOCKS = 40
# Share of a parameter's range that counts as at its bound, and standard errors beyond it that say
# that the records want it wider.
AT_BOUND, BEYOND = 1e-4, 3.0
# How much wider a bound is made that stands in the way.
WIDER = 10.0
# Powers of the scales in which the numbers of an effect are given, slot by slot: of what it
# enters, of its own signal, of a second signal or a time, of the sample period, of half the span.
ACTS_IN, ENTERS = (Kind.TERM, Kind.HYSTERESIS), {"into": 1, "second": -1}
SLOTS_IN: dict[Kind, tuple[dict[str, int], ...]] = {
    Kind.HYSTERESIS: (ENTERS, {"own": 1, "other": 1}),
    Kind.DRIFT: ({"into": 1, "half": -1},),
    Kind.RECORDING: ({"period": 1}, {"period": 2}),
    **dict.fromkeys((Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.OUTPUT_LAG), ({"period": 1},)),
}
# How often its signal counts in a term, and in what it makes of a reading.
POWERS = {
    **dict.fromkeys((Term.LINEAR, Term.SIZE, Term.GAP, Term.PRODUCT, Term.CALLED), 1),
    **dict.fromkeys((Term.SQUARE, Term.DRAG, Term.SQUARE_PRODUCT), 2),
    Term.CUBE: 3,
}
READING_POWERS = {Map.SQUARE: -1, Map.CUBE: -2, Map.ABSOLUTE: 0}


def covariance(fit: Fit, runs: Sequence[Run], metric: Metric) -> FloatArray:
    """Return the covariance of θ, zero for what is not fitted: a sandwich over blocks of rows.

    Behind θ stand the parameters that each record has of its own, record by record.
    """
    # Offsets are held in the raw fit, but they are not known exactly.
    which = replace(fit.structure, offsets_free=True).free
    m, k = which.size, fit.structure.started.size
    if fit.failed:
        size = fit.theta.size + len(runs) * len(fit.structure.model.per_record)
        return np.full((size, size), np.nan)
    spread, blind = sandwich(*_slopes(fit, runs, metric, which)[::2])
    spread[blind, blind] = np.inf
    model = fit.structure.model
    own = range(model.own_states, len(model.states))
    of_records = [m + k * r + i for r in range(len(runs)) for i in own]
    kept = np.r_[np.arange(m), np.array(of_records, dtype=np.int64)]
    at = np.r_[which, fit.theta.size + np.arange(len(of_records))]
    whole = np.zeros((at.size + fit.theta.size - m,) * 2)
    whole[np.ix_(at, at)] = spread[np.ix_(kept, kept)]
    return whole


def asked_beyond(fit: Fit, runs: Sequence[Run], metric: Metric) -> dict[str, str]:
    """Return the parameters at a bound beyond which the runs ask for more, and that in words.

    The slopes of the errors ask for a step across it of more than three standard errors. Those of
    each record's own are not looked at.
    """
    params = fit.structure.model.params
    room = [min(p.high - v, v - p.low) for p, v in zip(params.values(), fit.theta, strict=False)]
    near = [r < AT_BOUND * (p.high - p.low) for r, p in zip(room, params.values(), strict=True)]
    if fit.failed or not any(near):
        return {}
    which = fit.structure.free
    normal, pull, scores = _slopes(fit, runs, metric, which)
    # What the bound brings about is no scatter.
    spread, blind = sandwich(normal, scores - scores.mean(axis=0))
    step = np.linalg.lstsq(normal, pull + scores.sum(axis=0), rcond=None)[0]
    out = {}
    for i, (name, p) in enumerate(params.items()):
        column = np.flatnonzero(which == i)
        if not near[i] or not column.size or blind[column[0]]:
            continue
        asked = float(step[column[0]] / np.sqrt(spread[column[0], column[0]]))
        high = p.high - fit.theta[i] < fit.theta[i] - p.low
        if (asked if high else -asked) > BEYOND:
            unit = "" if p.unit == "1" else f" {p.unit}"
            bound = f"above its bound of {p.high:g}" if high else f"below its bound of {p.low:g}"
            out[name] = f"{name} {bound}{unit}".rstrip()
    return out


def widened(fit: Fit, names: Collection[str]) -> Fit:
    """Return a fit with the bounds of these parameters ten times wider, on their side of zero."""
    model = fit.structure.model
    params = {
        name: replace(p, low=_further(p.low, -1), high=_further(p.high, 1)) if name in names else p
        for name, p in model.params.items()
    }
    return replace(fit, structure=replace(fit.structure, model=replace(model, params=params)))


def _further(bound: float, side: int) -> float:
    """Return a bound ten times as far out; zero, which says what is physical, stays."""
    return bound * WIDER ** (side if bound > 0.0 else -side)


def _slopes(
    fit: Fit, runs: Sequence[Run], metric: Metric, which: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the normal matrix and the downhill slopes of starts and of blocks of rows."""
    blocks = max(4, SANDWICH_BLOCKS // len(runs))
    return fit.slopes(runs, metric.with_size_of(fit.errors), which, None, blocks)


def numbers_of(
    fit: Fit, placed: Placed, cov: FloatArray, clock: FloatArray
) -> tuple[FittedParameter, ...]:
    """Return the numbers of one effect of a fit in physical units, by the covariance of θ.

    The clock of a run holds the sample period and the half length of the records' span.
    """
    model = fit.structure.model
    at = int(fit.structure.slots_of(placed)[0])
    out = []
    for slot, number in enumerate(placed.effect.numbers):
        if placed.held[slot] and not number.held:
            continue
        factor, unit = _factor(model, placed, slot, clock)
        if slot == 0 and placed.effect.resists:
            factor = -factor
        value, stderr = float(fit.theta[at + slot]), float(np.sqrt(cov[at + slot, at + slot]))
        if stderr > number.high - number.low:
            # The errors of a shape turn back here, as about the peak of a curve: to first order
            # nothing is known of it, and to second order it is.
            stderr = np.inf if slot == 0 and placed.effect.linear else np.nan
        out.append(FittedParameter(number.name, factor * value, abs(factor) * stderr, unit))
    if placed.effect.linear and placed.effect.kind in ACTS_IN:
        out[0] = _balanced(fit, placed, cov, out[0], at)
    return tuple(out)


def at_bound(fit: Fit, placed: Placed) -> str:
    """Say that the first number of an effect ended as far out as it is searched; empty elsewhere.

    Its nearer bound is what it has in plain forms: no effect, an exponent of one.
    """
    if not placed.effect.numbers or placed.held[0]:
        return ""
    number, value = placed.effect.numbers[0], float(fit.theta[fit.structure.slots_of(placed)[0]])
    room = max(abs(number.low), abs(number.high)) - abs(value)
    near = room < AT_BOUND * (number.high - number.low)
    return f"{number.name} stands at the end of what is searched" if near else ""


def correlation_of(fit: Fit, placed: Placed, cov: FloatArray) -> float:
    """Return the largest correlation of two numbers of one effect; 0 where it has no two."""
    at = fit.structure.slots_of(placed)[np.flatnonzero([not held for held in placed.held])]
    return largest_correlation(cov[np.ix_(at, at)])


def is_nothing(fit: Fit, placed: Placed, cov: FloatArray) -> bool:
    """Tell whether the one number of an effect is zero within its error."""
    at, effect = int(fit.structure.slots_of(placed)[0]), placed.effect
    alone = effect.linear and len(effect.numbers) == 1
    return alone and bool(float(fit.theta[at]) ** 2 < cov[at, at] < np.inf)


def _balanced(
    fit: Fit, placed: Placed, cov: FloatArray, number: FittedParameter, at: int
) -> FittedParameter:
    """Tell an amplitude as a force where the user said which parameter multiplies dx/dt."""
    model = fit.structure.model
    name = model.state_names[placed.place.at]
    if name not in model.balance:
        return number
    parameter, unit = model.balance[name]
    i = model.param_names.index(parameter)
    mass, amplitude, value = float(fit.theta[i]), float(fit.theta[at]), number.value
    slope = np.array([value, value * mass / amplitude if amplitude else 0.0])
    variance = float(slope @ cov[np.ix_([i, at], [i, at])] @ slope)
    whole = product_of_units((unit, 1), (number.unit, 1), (model.states[name], -1), ("s", 1))
    stderr = float(np.sqrt(max(variance, 0.0)))
    return replace(number, value=value * mass, stderr=stderr, unit=whole)


def _powers(placed: Placed, slot: int) -> dict[str, int]:
    """Return the powers of the scales in which one number is given; none for a share."""
    kind, code = placed.effect.kind, placed.effect.code
    slots = SLOTS_IN.get(kind, ({"own": 1},))
    if kind == Kind.TERM:
        second = code in (Term.PRODUCT, Term.SQUARE_PRODUCT)
        first = {**ENTERS, "own": -POWERS.get(Term(code), 0), "other": -second}
        slots = (first, {"own": 1})
    elif kind == Kind.OUTPUT_MAP:
        slots = ({"own": READING_POWERS.get(Map(code), 1)},)
    return slots[slot] if slot < len(slots) else {}


def _factor(model: Model, placed: Placed, slot: int, clock: FloatArray) -> tuple[float, str]:
    """Return the factor to physical units, and the unit, of one number."""
    effect, place = placed.effect, placed.place
    into, own, other, *_ = placed.floats
    scales = {"into": into, "own": own, "other": other, "period": clock[1], "half": clock[3]}
    signals = [*model.states.values(), *model.inputs.values()]
    units = dict.fromkeys(("second", "other", "period", "half"), "s")
    units["into"] = signals[place.at] if effect.kind in ACTS_IN else "1"
    units["own"] = signals[place.signal] if place.signal >= 0 else "1"
    if effect.kind in AT_OUTPUTS:
        units["own"] = list(model.outputs.values())[place.at]
    elif effect.kind == Kind.DRIFT:
        units["into"] = list(model.params.values())[place.at].unit
    elif effect.expression is not None:
        units["own"] = _unit_of_term(model, placed)
    if effect.kind == Kind.TERM and place.other >= 0:
        units["other"] = signals[place.other]
    powers = {name: power for name, power in _powers(placed, slot).items() if power}
    factor = math.prod(float(scales.get(name, 1.0)) ** power for name, power in powers.items())
    return factor, product_of_units(*((units[name], power) for name, power in powers.items()))


def _unit_of_term(model: Model, placed: Placed) -> str:
    """Return the unit of a term of the user's own, "1" for what is no product of powers."""
    written = placed.effect.equation.removeprefix("+ c ")
    params = {name: q.unit for name, q in model.params.items()}
    known: dict[str, str] = {**model.states, **model.inputs, **params}
    names = set(re.findall(r"[^\W\d]\w*", written))
    if not names <= set(known) or re.search(r"[^\w\s^*/·²³]", written):
        return "1"
    return re.sub(r"[^\W\d]\w*", lambda name: f"({known[name[0]]})", written)
