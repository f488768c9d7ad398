"""From the end of a search to a diagnosis: the gap, τ under every name, and the numbers."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.candidates import Bench, LagCandidate, LagRound
from comparisons.missing_effect.catalogue.workings import shape_columns
from comparisons.missing_effect.covariance import largest_correlation, orthonormal, sandwich
from comparisons.missing_effect.effect import Effect, FittedParameter, Parameter
from comparisons.missing_effect.fit import Fit, solved
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.noise import Metric
from comparisons.missing_effect.open_terms import with_own_state
from comparisons.missing_effect.ports import Ports, n_powers
from comparisons.missing_effect.quantities import equation_of, label_of, letters_of
from comparisons.missing_effect.results import (
    CORRELATION,
    LEAST_SIZE,
    SIZE,
    Gap,
    MissingEffect,
    ParameterRow,
)
from comparisons.missing_effect.runs import rms
from comparisons.missing_effect.search import verdict_of
from surge_core.terms import pretty_term
from surge_core.types import FloatArray

# Standard errors below which an amplitude is not known, and its name not firm.
LEAST_AMPLITUDE = 3.0

# What a term without a name needs.
TO_NAME = "cycles at other amplitudes and other speeds of φ, which say what the term stands for"

AliasSets = Mapping[Hashable, Sequence[LagCandidate]]
# Directions of all other numbers that are no rounding.
LEAST_BASIS = 1e-9
# Steps of a threshold, as shares of the range of φ.
JUMP_STEPS = (1e-4, 2e-4, 3e-4, 5e-4, 7e-4, 1e-3, 2e-3, 3e-3)


def concluded(
    base: Bench,
    final: Bench,
    rounds: Sequence[LagRound],
    sets: AliasSets,
    otherwise: str,
    doubts: tuple[str, ...],
    floor_rms: float | None = None,
) -> LagDiagnosis:
    """Return the diagnosis that a search has come to from one model to another, on the same rows.

    ``sets`` holds the alias set of each effect found, it first; ``otherwise`` is the verdict where
    nothing was found, ``doubts`` why no name is firm, and the floor the measurement noise (that of
    the model after where it is not given).
    """
    noise, left, held = final.own_noise, (base.left, final.left), final.held
    before = base.on_all_rows(base.fit)
    after = final.on_all_rows(final.fit) if final.found else before
    covariance = covariance_of(after, final)
    earlier = covariance_of(before, rounds[0].bench) if final.found else covariance
    values = fitted_parameters(after, final, covariance)
    missing = []
    for effect in final.found:
        numbers, members = values[effect.name], sets[effect.name]
        evidence = _evidence_numbers(members[0]) if members else {}
        why: tuple[str, ...] = ()
        if not effect.unnamed:
            evidence[SIZE] = size_in_errors(effect, after, final)
            why = (*_lost(numbers[0], effect.parameters[0], evidence[SIZE]), *doubts)
        evidence |= _correlation(effect, after, covariance)
        names = [c.added[0] for c in members]
        missing.append(missing_effect(effect, numbers, evidence, why, names))
    return LagDiagnosis(
        verdict=verdict_of(missing, otherwise),
        missing=tuple(missing),
        parameters=_parameters((before, earlier), (after, covariance)),
        unavailable={},
        gap=Gap(float(rms(left[0][held])), float(rms(left[1][held])), floor_rms or noise.sigma),
        tau_by_alias_s=_tau_by_alias(final, sets, after),
        before=before,
        after=after,
        left=left,
        data=final.data,
        noise=noise,
        leftover=rounds[-1].leftover,
        rounds=tuple(rounds),
    )


def missing_effect(
    effect: Effect,
    parameters: tuple[FittedParameter, ...],
    evidence: Mapping[str, float],
    doubts: tuple[str, ...] = (),
    alias_set: Sequence[Effect] = (),
) -> MissingEffect:
    """Return an effect that a lag model lacks."""
    letters, members = letters_of(effect), alias_set or [effect]
    return MissingEffect(
        effect.name,
        tuple(e.name for e in members),
        bool(doubts),
        parameters,
        evidence,
        doubts,
        label_of(effect),
        {"port": effect.port},
        tuple(map(label_of, members)),
        effect.unnamed,
        equation_of(effect),
        f"{effect.says.removesuffix('.')} ({letters})" if letters else effect.says,
        {e.name: TO_NAME if e.unnamed else e.confirm for e in members},
        "" if effect.unnamed else effect.on_tau,
    )


def _parameters(
    before: tuple[Fit, FloatArray], after: tuple[Fit, FloatArray]
) -> tuple[ParameterRow, ...]:
    """Return τ and the coefficients of the characteristic without and with what was added."""
    columns = []
    for fit, covariance in (before, after):
        error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        first, n = len(fit.structure.free), len(fit.structure.terms)
        values = [fit.tau_s, *fit.coefficients[:n].tolist()]
        columns.append((values, [fit.tau_s * error[0], *error[first : first + n]]))
    (old, old_errors), (new, new_errors) = columns
    names = [("τ", "s"), *((f"β of {pretty_term(t)}", "1") for t in before[0].structure.terms)]
    return tuple(
        ParameterRow(name, unit, old[i], new[i], float(old_errors[i]), float(new_errors[i]))
        for i, (name, unit) in enumerate(names)
    )


def _lost(amplitude: FittedParameter, parameter: Parameter, size: float) -> tuple[str, ...]:
    """Say how an effect, or its own amplitude among its numbers, is lost; empty where it is known.

    What all of them do together may be large all the same: a heating whose time is far longer than
    the records is a straight drift, and that is then not what its name says.
    """
    if size < LEAST_SIZE:
        return (
            f"what it does to ψ' is not distinguished from nothing ({size:.1f} standard errors, "
            "all its numbers together)",
        )
    low, high = parameter.low, parameter.high
    # A share of the range in place of the error called every a₂ below 1e-4 s² lost.
    at_bound = min(amplitude.value - low, high - amplitude.value) <= amplitude.stderr
    if abs(amplitude.value) < LEAST_AMPLITUDE * amplitude.stderr:
        errors = abs(amplitude.value) / amplitude.stderr
        lost = f"is not distinguished from zero ({errors:.1f} standard errors)"
    elif np.isfinite(high - low) and at_bound:
        lost = "stands at the bound of what is physical"
    else:
        return ()
    return (
        f"{amplitude.name} {lost}: only what its numbers do together is known, which a simpler "
        "effect may do too",
    )


def _correlation(effect: Effect, fit: Fit, covariance: FloatArray) -> dict[str, float]:
    """Return the largest correlation of two free numbers of an effect, where it has two."""
    own = fit.structure.slots[effect.name]
    at = [place for place, number in enumerate(fit.structure.free) if number in own]
    largest = largest_correlation(covariance[np.ix_(at, at)])
    return {CORRELATION: largest} if largest else {}


def _tau_by_alias(final: Bench, sets: AliasSets, after: Fit) -> dict[str, float]:
    return {
        member.name: (after if member.name == name else final.on_all_rows(member.fit)).tau_s
        for name, members in sets.items()
        for member in members
    }


def _evidence_numbers(candidate: LagCandidate) -> dict[str, float]:
    """Return the evidence of a candidate by name."""
    e = candidate.evidence
    return {
        "train_gain": e.train,
        "later_gain": e.later,
        "other_record_gain": e.other,
        "held_out_z": e.z,
        "p_value": e.p_value,
        "score": e.score,
        **({"share": e.share} if np.isfinite(e.share) else {}),
    }


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
    here = solved(fit.structure, data, bench.metric, fit.nonlinear).cost
    for at, step, there in fit.structure.beside(data, fit.nonlinear, JUMP_STEPS):
        lost = solved(fit.structure, data, bench.metric, there).cost - here
        # A step that costs half a log-unit is one standard error.
        out[at] = max(out[at], step / float(np.sqrt(2.0 * max(lost, 0.5))))
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
        return _size_of_waves(coefficients, errors)
    return float(coefficients[0]), float(errors[0])


def _size_of_waves(waves: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Return the size of sines and cosines of any phase, in turn, and its error.

    Each pair weighs by what it knows; the errors of its waves are part of their squares. Of eight
    records with 20 to 60 episodes r is off by 0.15 to 1.5 errors.
    """
    squares, variances = (np.sum(v.reshape(-1, 2) ** 2, axis=1) for v in (waves, errors))
    # An episode that is not scored knows nothing.
    weight = np.where(variances > 0.0, 1.0 / np.where(variances > 0.0, variances, 1.0), 0.0)
    known = max(float(np.sum(weight)), 1e-300)
    squared = float(weight @ (squares - variances)) / known
    return float(np.sqrt(max(squared, 0.0))), float((2.0 * known) ** -0.5)


def is_of_stall_alone(effect: Effect, size: FittedParameter, fit: Fit, bench: Bench) -> bool:
    """Tell whether the tone of a ripple is weaker out of stall, beyond its errors.

    Where no rows are out of stall, or the tone goes on there, hum of the mains looks the same.
    """
    data, gate = with_own_state(bench.data, fit), fit.values_of(effect)[1]
    stalled = data["in_stall"] if "in_stall" in data else np.asarray(data["phi"] < gate, float)
    outside = data.with_signal("in_stall", 1.0 - stalled)
    columns = effect.acts(Ports.of(data, data["phi"], ()), outside, fit.values_of(effect)).added
    # In plain errors: colour that was fitted to a tone which goes on would take it away.
    metric = Metric(bench.own_noise.sigma)
    seen = metric.whitened(columns, data)
    inverse = np.linalg.pinv(seen.T @ seen)
    waves = inverse @ (seen.T @ fit.errors(data, metric))
    there, error = _size_of_waves(waves, np.sqrt(np.diag(inverse)))
    return bool(size.value - there > LEAST_AMPLITUDE * np.hypot(size.stderr, error))


def covariance_of(fit: Fit, bench: Bench) -> FloatArray:
    """Return the covariance of the free parameters of a fit, then its linear ones.

    The fit itself takes from the sums of few blocks: of 11 blocks and 6 numbers, a heating's error
    came out 1.4 times too small in 40 records of normal noise and in 40 of Student noise. So no
    error is below that of rows each for itself, which is right there (0.9 and 1.0 times).
    """
    data = with_own_state(bench.data, fit)
    solution = solved(fit.structure, data, bench.metric, fit.nonlinear)
    both = np.column_stack([solution.slopes(fit.structure.free), solution.columns])
    seen = bench.metric.seen(both, solution.decay, data)
    rows = bench.rows
    scores = seen * solution.errors[:, None]
    counted = rows.block >= 0
    sums = np.zeros((int(rows.block.max()) + 1, seen.shape[1]))
    np.add.at(sums, rows.block[counted], scores[counted])
    moved = seen * _moved(bench)[:, None]
    covariance, by_rows = (sandwich(moved.T @ moved, s)[0] for s in (sums, scores[counted]))
    variance = np.diag(covariance)
    wider = np.sqrt(np.maximum(1.0, np.diag(by_rows) / np.where(variance > 0.0, variance, np.inf)))
    return np.asarray(covariance * np.outer(wider, wider))


def _moved(bench: Bench) -> FloatArray:
    """Return which errors count by their size: one that is held down moves nothing further."""
    weight = bench.metric.weight
    return np.ones(bench.data.n_samples) if weight is None else np.asarray(weight >= 1.0, float)


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
    lost = solution.output - fit.without_amplitude(effect, data).output(data)
    slopes = solution.slopes([i for i in structure.free if i not in structure.slots[effect.name]])
    columns = solution.columns
    if effect.linear:
        columns = np.delete(columns, fit.structure.layout(data, fit.nonlinear)[effect.name], axis=1)
    joint = np.column_stack([lost, slopes, columns])
    seen = bench.metric.seen(joint, solution.decay, data)
    basis = orthonormal(seen[:, 1:], LEAST_BASIS)
    alone = seen[:, 0] - basis @ (basis.T @ seen[:, 0])
    counted = bench.rows.block >= 0
    sums = np.bincount(bench.rows.block[counted], (alone * solution.errors)[counted])
    n_blocks = int(np.unique(bench.rows.block[counted]).size)
    by_rows = np.sum((alone * solution.errors)[counted] ** 2)
    error = float(np.sqrt(max(np.sum(sums**2) * n_blocks / max(n_blocks - 1, 1), by_rows)))
    squared = float(np.sum((alone * _moved(bench)) ** 2))
    return squared / error if error > 0.0 else (np.inf if squared > 0.0 else 0.0)
