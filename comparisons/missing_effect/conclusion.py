"""From the end of a search to a diagnosis: the gap, τ under every name, and the numbers."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from comparisons.missing_effect.candidates import Bench, LagCandidate, LagRound
from comparisons.missing_effect.covariance import largest_correlation
from comparisons.missing_effect.effect import Effect, FittedParameter, Parameter
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.quantities import equation_of, label_of, letters_of
from comparisons.missing_effect.results import CORRELATION, SIZE, Gap, MissingEffect, ParameterRow
from comparisons.missing_effect.search import verdict_of
from comparisons.missing_effect.uncertainty import (
    LEAST_SIZE,
    covariance_of,
    fitted_parameters,
    size_in_errors,
)
from surge_core.terms import pretty_term
from surge_core.types import FloatArray

# Standard errors below which an amplitude is not known, and its name not firm.
LEAST_AMPLITUDE = 3.0
# Share of its range that counts as at its bound.
AT_BOUND = 1e-3

# What a term without a name needs.
TO_NAME = "cycles at other amplitudes and other speeds of φ, which say what the term stands for"

AliasSets = Mapping[Hashable, Sequence[LagCandidate]]


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
        names = [c.added[0] for c in members] or [effect]
        missing.append(missing_effect(effect, names, numbers, evidence, why))
    first = rounds[0].bench
    earlier = covariance_of(before, first)
    return LagDiagnosis(
        verdict=verdict_of(missing, otherwise),
        missing=tuple(missing),
        parameters=_parameters((before, earlier), (after, covariance)),
        unavailable={},
        gap=Gap(_rms(left[0][held]), _rms(left[1][held]), floor_rms or noise.sigma),
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
    members: Sequence[Effect],
    parameters: tuple[FittedParameter, ...],
    evidence: Mapping[str, float],
    doubts: tuple[str, ...] = (),
) -> MissingEffect:
    """Return an effect that a lag model lacks."""
    letters = letters_of(effect)
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
    at_bound = min(amplitude.value - low, high - amplitude.value) < AT_BOUND * (high - low)
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


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
