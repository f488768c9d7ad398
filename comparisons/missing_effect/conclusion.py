"""From the end of a search to a diagnosis: the gap, τ under every name, and the numbers."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from comparisons.missing_effect.candidates import Bench, LagCandidate, LagRound
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.episodes import errors_on
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LATER, OTHER
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.leftover import Leftover
from comparisons.missing_effect.metric import Metric
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.open_terms import with_own_state
from comparisons.missing_effect.quantities import equation_of, label_of, letters_of
from comparisons.missing_effect.results import (
    CORRELATION,
    SIZE,
    Gap,
    MissingEffect,
    ParameterRow,
)
from comparisons.missing_effect.search import verdict_of
from comparisons.missing_effect.uncertainty import (
    LEAST_SIZE,
    covariance_of,
    fitted_parameters,
    on_all_rows,
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
    otherwise: str,
    base: Bench,
    final: Bench,
    *,
    sets: AliasSets,
    provisional: bool,
    noise: NoiseModel,
    leftover: Leftover,
    rounds: Sequence[LagRound],
    unavailable: Mapping[str, str],
    gap: Gap | float,
    left: tuple[FloatArray, FloatArray] | None = None,
) -> LagDiagnosis:
    """Return the diagnosis that a search has come to.

    Parameters
    ----------
    otherwise : str
        The verdict where nothing was found.
    base, final : Bench
        The model before and after, on the same rows.
    sets : mapping of str to sequence of Candidate
        Alias set of each effect found, it first.
    provisional : bool
        Whether names stand for something that may be another.
    noise : NoiseModel
        Of the model after.
    leftover : Leftover
        What it leaves.
    rounds : sequence of Round
        The search.
    unavailable : mapping of str to str
        Effects that these records cannot show, and why.
    gap : Gap or float
        The held-out errors; or the measurement noise, and they are those of later time and of
        another record.
    left : tuple of two ndarray, optional
        Errors before and after of all rows, held-out ones by fits to others; those of the models
        on the bench without it.
    """
    found, data = final.fit.structure.effects, final.data
    before = on_all_rows(base.fit, base)
    after = on_all_rows(final.fit, final) if found else before
    values = fitted_parameters(after, final)
    sizes = {e.name: size_in_errors(e, after, final) for e in found if not e.unnamed}
    bounds = {e.name: (e.parameters[0].low, e.parameters[0].high) for e in found}
    unsure = {
        name
        for name, size in sizes.items()
        if size < LEAST_SIZE or _lost(values[name][0], bounds[name])
    }
    covariance = covariance_of(after, with_own_state(data, after), final)
    missing = tuple(
        missing_effect(
            effect,
            [c.added[0] for c in sets[effect.name]] or [effect],
            not effect.unnamed and (provisional or effect.name in unsure),
            values[effect.name],
            {
                **(evidence_numbers(sets[effect.name][0]) if sets[effect.name] else {}),
                **({SIZE: sizes[effect.name]} if effect.name in sizes else {}),
                **_correlation(effect, after, covariance),
            },
            _doubt(values[effect.name][0], bounds[effect.name])
            if sizes.get(effect.name, 0.0) >= LEAST_SIZE
            else (),
        )
        for effect in found
    )
    if left is None:
        left = (
            errors_on(base.fit, base.data, Metric())[0],
            errors_on(final.fit, data, Metric())[0],
        )
    if not isinstance(gap, Gap):
        held = data.scored() & np.isin(data.part, (LATER, OTHER))
        gap = Gap(_rms(left[0][held]), _rms(left[1][held]), gap)
    first = rounds[0].bench if rounds else base
    earlier = covariance_of(before, with_own_state(first.data, before), first)
    return LagDiagnosis(
        verdict=verdict_of(missing, otherwise),
        missing=missing,
        parameters=_parameters((before, earlier), (after, covariance)),
        unavailable=unavailable,
        gap=gap,
        tau_by_alias_s=_tau_by_alias(final, sets, after),
        before=before,
        after=after,
        before_fitted=base.fit,
        after_fitted=final.fit,
        left=left,
        data=data,
        noise=noise,
        leftover=leftover,
        rounds=tuple(rounds),
    )


def missing_effect(
    effect: Effect,
    members: Sequence[Effect],
    provisional: bool,
    parameters: tuple[FittedParameter, ...],
    evidence: Mapping[str, float],
    doubts: tuple[str, ...] = (),
) -> MissingEffect:
    """Return an effect that a lag model lacks.

    Parameters
    ----------
    effect : Effect
        What was found.
    members : sequence of Effect
        Its alias set, it first.
    provisional : bool
        Whether it may be another.
    parameters : tuple of FittedParameter
        Its numbers.
    evidence : mapping of str to float
        What speaks for it.
    doubts : tuple of str
        Why the name is not firm.
    """
    letters = letters_of(effect)
    return MissingEffect(
        effect.name,
        tuple(e.name for e in members),
        provisional,
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


def _doubt(amplitude: FittedParameter, bounds: tuple[float, float]) -> tuple[str, ...]:
    lost = _lost(amplitude, bounds)
    return (
        (
            f"{amplitude.name} {lost}: only what its numbers do together is known, which a simpler "
            "effect may do too",
        )
        if lost
        else ()
    )


def _lost(amplitude: FittedParameter, bounds: tuple[float, float]) -> str:
    """Say how an effect's own amplitude is lost among its numbers; empty where it is known.

    What all of them do together may be large all the same: a heating whose time is far longer than
    the records is a straight drift, and that is then not what its name says.
    """
    if abs(amplitude.value) < LEAST_AMPLITUDE * amplitude.stderr:
        size = abs(amplitude.value) / amplitude.stderr
        return f"is not distinguished from zero ({size:.1f} standard errors)"
    low, high = bounds
    at_bound = min(amplitude.value - low, high - amplitude.value) < AT_BOUND * (high - low)
    return "stands at the bound of what is physical" if np.isfinite(high - low) and at_bound else ""


def _correlation(effect: Effect, fit: Fit, covariance: FloatArray) -> dict[str, float]:
    """Return the largest correlation of two free numbers of an effect, where it has two."""
    first = 1
    for other in fit.structure.effects:
        if other.name == effect.name:
            break
        first += len(other.nonlinear)
    own = range(first, first + len(effect.nonlinear))
    at = [place for place, number in enumerate(fit.structure.free) if number in own]
    if len(at) < 2:
        return {}
    part = covariance[np.ix_(at, at)]
    scale = np.sqrt(np.maximum(np.diag(part), 0.0))
    if not np.all(scale > 0.0):
        return {}
    apart = np.triu(part / np.outer(scale, scale), 1).ravel()
    return {CORRELATION: float(apart[np.argmax(np.abs(apart))])}


def _tau_by_alias(final: Bench, sets: AliasSets, after: Fit) -> dict[str, float]:
    out: dict[str, float] = {}
    for name, members in sets.items():
        for member in members:
            out[member.name] = (
                after.tau_s if member.name == name else on_all_rows(member.fit, final).tau_s
            )
    return out


def evidence_numbers(candidate: LagCandidate) -> dict[str, float]:
    """Return the evidence of a candidate by name.

    Parameters
    ----------
    candidate : Candidate
        Weighed.
    """
    e = candidate.evidence
    numbers = {
        "train_gain": e.train,
        "later_gain": e.later,
        "other_record_gain": e.other,
        "held_out_z": e.z,
        "p_value": e.p_value,
        "score": e.score,
    }
    if np.isfinite(e.share):
        numbers["share"] = e.share
    return numbers


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
