"""The workflow: where, who, added, shown; and what it says when there is nothing to add."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.candidates import Bench, Candidate
from comparisons.missing_effect.catalogue import CATALOGUE, FLOW_NOISE
from comparisons.missing_effect.conclusion import concluded, missing_effect
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.excitation import block_rows
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.loading import is_whole, load_data
from comparisons.missing_effect.metric import Metric
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.open_terms import open_terms
from comparisons.missing_effect.results import MissingEffect
from comparisons.missing_effect.search import (
    Round,
    aliases,
    leftover_of,
    refitted_without,
    search_round,
)
from comparisons.missing_effect.structure import Structure
from comparisons.missing_effect.whole_run_diagnosis import diagnose_whole_runs
from comparisons.missing_effect.whole_runs import N_TWINS, Progress
from surge_core.errors import InputError
from surge_core.threads import one_thread

MOST_EFFECTS = 3
# Errors with more memory than this are a drift that no term explains, and not a noise.
LARGEST_MEMORY = 0.9


def polynomial_terms(degree: int) -> tuple[str, ...]:
    """Return the names of the powers of φ up to a degree.

    Parameters
    ----------
    degree : int
        From 1 on.

    Raises
    ------
    InputError
        For a degree that is no characteristic.
    """
    if not 1 <= degree <= 8:
        raise InputError("degree", expected="1 to 8", found=f"{degree}")
    return ("1", "phi", *(f"phi^{k}" for k in range(2, degree + 1)))


@one_thread()
def diagnose(
    records: Sequence[CoefficientSeries],
    degree: int = 2,
    *,
    terms: Sequence[str] | None = None,
    catalogue: Sequence[Effect] = CATALOGUE,
    most_effects: int = MOST_EFFECTS,
    n_twins: int = N_TWINS,
    progress: Progress = iter,
) -> LagDiagnosis:
    """Find what the lag model of one or several records lacks.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate; several regimes tell more than one.
    degree : int
        Degree of the base characteristic.
    terms : sequence of str, optional
        Terms of the base characteristic, in place of the powers of φ.
    catalogue : sequence of Effect
        Names that compete.
    most_effects : int
        At most so many are added.
    n_twins : int
        Twins that are measured of records from raw counts; without them names are provisional.
    progress : callable
        Wraps the iteration over the twins.

    Raises
    ------
    InputError
        When the records do not go together or hold too few rows.
    """
    base = tuple(terms) if terms is not None else polynomial_terms(degree)
    if most_effects < 1:
        raise InputError("most_effects", expected="1 or more", found=f"{most_effects}")
    if records and all(map(is_whole, records)):
        found = diagnose_whole_runs(
            records,
            base,
            catalogue=catalogue,
            most_effects=most_effects,
            n_twins=n_twins,
            progress=progress,
        )
        return replace(found, catalogue=tuple(catalogue))
    return diagnose_data(load_data(records), base, catalogue=catalogue, most_effects=most_effects)


def diagnose_data(
    data: LagData,
    terms: Sequence[str],
    *,
    catalogue: Sequence[Effect] = CATALOGUE,
    most_effects: int = MOST_EFFECTS,
) -> LagDiagnosis:
    """Diagnose rows that were loaded before; see :func:`diagnose`.

    Parameters
    ----------
    data : LagData
        Rows, split into fitted and held out.
    terms : sequence of str
        Terms of the base characteristic.
    catalogue : sequence of Effect
        Names that compete.
    most_effects : int
        At most so many are added.
    """
    unavailable = {e.name: why for e in catalogue if (why := e.missing_channel(data)) is not None}
    effects = [e for e in catalogue if e.name not in unavailable]
    open_library = open_terms(data)
    base = first_bench(data, tuple(terms), len(effects))
    rounds: list[Round] = []
    bench = base
    found: list[Effect] = []
    while len(found) < most_effects:
        left = [e for e in effects if e.name not in {f.name for f in found}]
        step = search_round(bench, left, open_library)
        rounds.append(step)
        if step.winner is None or len(found) + len(step.winner.added) > most_effects:
            break
        found += step.winner.added
        bench = replace(step.bench, fit=step.winner.fit).with_states()
        if step.winner.unnamed or not step.leftover.structured:
            break
    final = rounds[-1].bench if rounds[-1].winner is None else bench
    if len(found) > 1:
        final, rounds = _pruned(final, rounds, effects, open_library)
    found_all = _concluded(base, final, rounds, effects, unavailable)
    return replace(found_all, catalogue=tuple(catalogue))


def _pruned(
    bench: Bench, rounds: list[Round], effects: Sequence[Effect], open_library: Sequence[Effect]
) -> tuple[Bench, list[Round]]:
    """Take out effects that those found later made needless: they stood in for what came after."""
    for effect in bench.fit.structure.effects:
        if len(bench.fit.structure.effects) < 2 or _swapped(bench, effect, [effect]):
            continue
        bench = refitted_without(bench, effect)
        left = leftover_of(bench, None, effects, open_library)
        rounds = [*rounds[:-1], replace(rounds[-1], leftover=left)]
    return bench, rounds


def first_bench(data: LagData, terms: tuple[str, ...], n_names: int) -> Bench:
    """Fit the base model and put it on the bench, in the metric of its own errors.

    Parameters
    ----------
    data : LagData
        Rows.
    terms : tuple of str
        Of the characteristic.
    n_names : int
        Names that compete.
    """
    metric = Metric(max(1e-2 * float(np.std(data.measured)), 1e-12))
    starts = [np.array([np.log(tau)]) for tau in _tau_starts(data)]
    benches = [
        Bench.start(data, Structure(terms), metric, start, block_rows(data), n_names)
        for start in starts
    ]
    best = min(benches, key=lambda bench: bench.fit.cost)
    noise = best.noise(best.fit)
    return best.in_metric_of(best.fit, replace(noise, ar=(), innovation=noise.sigma))


def _tau_starts(data: LagData) -> tuple[float, ...]:
    span = max(int(b - a) for a, b in data.runs) * data.sample_period_s
    return (2.0 * data.sample_period_s, min(10.0 * data.sample_period_s, 0.2 * span))


def _concluded(
    base: Bench,
    final: Bench,
    rounds: Sequence[Round],
    effects: Sequence[Effect],
    unavailable: Mapping[str, str],
) -> LagDiagnosis:
    last = rounds[-1]
    noise = final.noise(final.fit)
    found = final.fit.structure.effects
    sets = _alias_sets(final, rounds, effects)
    provisional = bool(found) and (last.leftover.doubtful or any(e.unnamed for e in found))
    verdict = _verdict(found, sets, provisional, last, noise)
    diagnosis = concluded(
        verdict,
        base,
        final,
        sets=sets,
        provisional=provisional,
        noise=noise,
        leftover=last.leftover,
        rounds=rounds,
        unavailable=unavailable,
        gap=noise.sigma,
    )
    if verdict in ("named", "alias_set") and diagnosis.gap.shrink <= 0.0:
        # What wins in whitened errors and nothing in plain ones explains the colour of the noise.
        doubted = tuple(replace(item, provisional=True) for item in diagnosis.missing)
        return replace(diagnosis, verdict="provisional", missing=doubted)
    if verdict != "noise_model_wrong" or noise.flow is None:
        return diagnosis
    return replace(diagnosis, missing=(_noise_on_flow(noise),))


def _noise_on_flow(noise: NoiseModel) -> MissingEffect:
    """Return the noise on φ as what the model of the errors, not that of the lag, lacks."""
    sigma = FittedParameter("sigma_phi", noise.flow_sigma, noise.flow_stderr, "1")
    evidence = {"gain_over_autoregression": noise.flow_gain}
    return missing_effect(FLOW_NOISE, [FLOW_NOISE], False, (sigma,), evidence)


def _verdict(
    found: Sequence[Effect],
    sets: Mapping[str, Sequence[Candidate]],
    provisional: bool,
    last: Round,
    noise: NoiseModel,
) -> str:
    if found:
        if all(effect.unnamed for effect in found):
            return "unnamed_term"
        if provisional:
            return "provisional"
        return "alias_set" if any(len(members) > 1 for members in sets.values()) else "named"
    if last.leftover.structured or sum(noise.ar) > LARGEST_MEMORY:
        return "unexplained_structure"
    if noise.coloured or noise.heavy_tailed:
        return "noise_model_wrong"
    return "nothing_missing"


def _alias_sets(
    final: Bench, rounds: Sequence[Round], effects: Sequence[Effect]
) -> dict[str, tuple[Candidate, ...]]:
    """Return, for each effect found, the candidates that could stand in its place."""
    found = final.fit.structure.effects
    if len(found) == 1:
        for step in rounds:
            if step.winner is not None and step.winner.name == found[0].name:
                base = step.bench.errors(step.bench.fit)
                return {found[0].name: aliases(step.bench, step.winner, step.candidates, base)}
    return {effect.name: _swapped(final, effect, effects) for effect in found}


def _swapped(final: Bench, effect: Effect, effects: Sequence[Effect]) -> tuple[Candidate, ...]:
    """Take one effect out of the model and see which others would do in its place."""
    without = refitted_without(final, effect)
    base = without.errors(without.fit)
    present = set(without.fit.structure.names)
    prober = without.prober()
    names = [e for e in effects if e.name not in present]
    if effect.unnamed:
        names = [effect]
    probes = without.promising([prober.probe(e) for e in names])
    tried = without.ranked([without.weighed(without.fitted(p), [p.effect], base) for p in probes])
    own = next((c for c in tried if c.name == effect.name), None)
    if own is None or not own.evidence.accepted:
        return ()
    return aliases(without, own, [c for c in tried if c is not own], base)
