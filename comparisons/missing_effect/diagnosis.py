"""The workflow: where, who, added, shown; and what it says when there is nothing to add."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.candidates import Bench, LagRound
from comparisons.missing_effect.catalogue import CATALOGUE, FLOW_NOISE
from comparisons.missing_effect.conclusion import (
    AliasSets,
    concluded,
    is_of_stall_alone,
    missing_effect,
)
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import Structure
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import COARSE, LagDiagnosis
from comparisons.missing_effect.loading import block_rows, is_whole, load_data
from comparisons.missing_effect.noise import Metric, NoiseModel
from comparisons.missing_effect.open_terms import open_terms
from comparisons.missing_effect.ports import powers_of_phi
from comparisons.missing_effect.probes import Leftover
from comparisons.missing_effect.search import alias_sets, search, verdict_of
from comparisons.missing_effect.whole_run_diagnosis import diagnose_whole_runs
from comparisons.missing_effect.whole_runs import N_TWINS, Progress
from surge_core.errors import require
from surge_core.threads import one_thread

MOST_EFFECTS = 3
# Weights settle to a tenth of a standard error in three rounds, of six measured.
WEIGHT_ROUNDS = 3
BESIDE_A_TERM = "a term without a name had to stand beside it"
IN_ALL_ROWS = (
    "its tone is not shown to be weaker out of stall, and hum of the mains at 50 or 60 Hz or a "
    "tone of the structure looks the same"
)
NO_SMALLER = "it makes the error on held-out rows no smaller"


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
    require(1 <= degree <= 8, "degree", "1 to 8", f"{degree}")
    base = powers_of_phi(degree) if terms is None else tuple(terms)
    require(most_effects >= 1, "most_effects", "1 or more", f"{most_effects}")
    if records and all(map(is_whole, records)):
        return diagnose_whole_runs(
            records,
            base,
            catalogue=catalogue,
            most_effects=most_effects,
            n_twins=n_twins,
            progress=progress,
        )
    return diagnose_data(load_data(records), base, catalogue=catalogue, most_effects=most_effects)


def diagnose_data(
    data: LagData,
    terms: Sequence[str],
    *,
    catalogue: Sequence[Effect] = CATALOGUE,
    most_effects: int = MOST_EFFECTS,
) -> LagDiagnosis:
    """Diagnose rows that were loaded before; see :func:`diagnose`."""
    unavailable = {e.name: why for e in catalogue if (why := e.missing_channel(data)) is not None}
    effects = [e for e in catalogue if e.name not in unavailable]
    base = first_bench(data, tuple(terms), len(effects))
    library = open_terms(data)
    final, rounds = search(base, effects, library, most_effects)
    sets = alias_sets(final, rounds, effects)
    # Weights and colour of another model hold down what that lacks: a heating of 2.4 % in Student
    # noise read 3.0 ± 0.05 %, and 2.6 ± 0.1 % with its own. Of a pair the metric is that of the
    # best single effect: a delay beside hysteresis read 3.7 ± 0.1 ms for 4.0, and 3.97 ± 0.03 now.
    for _ in range(WEIGHT_ROUNDS if final.found else 0):
        final = final.in_metric_of(final.fit, final.own_noise)
    if final.found:
        rounds[-1] = replace(rounds[-1], leftover=final.leftover(None, effects, library))
    found = _concluded(base, final if final.found else base, rounds, sets)
    return replace(found, catalogue=tuple(catalogue), unavailable=unavailable)


def first_bench(data: LagData, terms: tuple[str, ...], n_names: int) -> Bench:
    """Fit the base model and put it on the bench, in the metric of its own errors."""
    metric = Metric(max(1e-2 * float(np.std(data.measured)), 1e-12))
    span_s = max(int(b - a) for a, b in data.runs) * data.sample_period_s
    taus_s = 2.0 * data.sample_period_s, min(10.0 * data.sample_period_s, 0.2 * span_s)
    starts = [np.array([np.log(tau_s)]) for tau_s in taus_s]
    best = Bench.start(data, Structure(terms), metric, starts, block_rows(data), n_names)
    for _ in range(WEIGHT_ROUNDS):
        noise = best.noise(best.fit)
        noise = replace(noise, ar=(), flow=None, innovation=noise.sigma)
        best = best.in_metric_of(best.fit, noise)
    return best


def _concluded(
    base: Bench, final: Bench, rounds: Sequence[LagRound], sets: AliasSets
) -> LagDiagnosis:
    leftover, noise = rounds[-1].leftover, final.own_noise
    beside = any(effect.unnamed for effect in final.found)
    doubts = (*leftover.doubts, *[BESIDE_A_TERM] * beside)
    diagnosis = concluded(base, final, rounds, sets, _otherwise(leftover, noise, final), doubts)
    if not doubts:
        diagnosis = _beside_kin(diagnosis, final)
    diagnosis = _of_instrument(diagnosis, final)
    verdict = diagnosis.verdict
    if verdict in ("named", "alias_set") and diagnosis.gap.shrink <= 0.0:
        # What wins in whitened errors and nothing in plain ones explains the colour of the noise.
        doubted = tuple(item.doubted(NO_SMALLER) for item in diagnosis.missing)
        return replace(diagnosis, verdict="provisional", missing=doubted)
    if verdict != "noise_model_wrong" or noise.flow is None:
        return diagnosis
    # The model of the errors lacks it, not that of the lag.
    sigma = FittedParameter("sigma_phi", noise.flow_sigma, noise.flow_stderr, "1")
    evidence = {"gain_over_autoregression": noise.flow_gain}
    return replace(diagnosis, missing=(missing_effect(FLOW_NOISE, (sigma,), evidence),))


def _beside_kin(diagnosis: LagDiagnosis, final: Bench) -> LagDiagnosis:
    """Doubt a single name where its kin would do as well: the right name may be in no catalogue.

    With the right one taken out, 8 of 22 records of a delay, a second lag or a branch in reversed
    flow (1.5 standard deviations of the noise) bore another firmly, and left nothing but chance.
    """
    missing = tuple(
        item.doubted(f"{effect.kin.name} would do as well, and may be what is there")
        if effect.kin is not None
        and len(item.alias_set) == 1
        and _stands_in(effect.kin, effect, final)
        else item
        for effect, item in zip(final.found, diagnosis.missing, strict=True)
    )
    return replace(diagnosis, missing=missing, verdict=verdict_of(missing, diagnosis.verdict))


def _of_instrument(diagnosis: LagDiagnosis, final: Bench) -> LagDiagnosis:
    """Doubt what the readings may make by themselves: a tone in all rows, and coarse steps."""
    missing, after, step = list(diagnosis.missing), diagnosis.after, diagnosis.coarse_step
    for i, (effect, item) in enumerate(zip(final.found, diagnosis.missing, strict=True)):
        if effect.episodes and not is_of_stall_alone(effect, item.parameters[0], after, final):
            missing[i] = missing[i].doubted(IN_ALL_ROWS)
        if step:
            missing[i] = missing[i].doubted(f"readings of ψ' step by {step:.3g}, {COARSE}")
    verdict = verdict_of(missing, diagnosis.verdict)
    return replace(diagnosis, missing=tuple(missing), verdict=verdict)


def _stands_in(kin: Effect, effect: Effect, final: Bench) -> bool:
    """Tell whether the rows do not tell an effect from its kin, or do not show it alone."""
    tried = final.stand_ins(effect, None, [effect, kin])
    return not tried or any(candidate.name == kin.name for candidate in tried)


def _otherwise(left: Leftover, noise: NoiseModel, final: Bench) -> str:
    """Return the verdict where nothing was found: errors that outlast a block are a drift."""
    if left.structured or (1.0 - sum(noise.ar)) * final.block_rows < 1.0:
        return "unexplained_structure"
    if noise.coloured or noise.heavy_tailed:
        return "noise_model_wrong"
    return "nothing_missing"


class FirmNames:
    """Names effects as ``sindy-surge diagnose`` does, with its defaults: as the bench asks it."""

    def firm_names(self, records: Sequence[CoefficientSeries]) -> tuple[str, ...]:
        """Return the effects that are named firmly on records of one machine."""
        return tuple(
            each.effect
            for each in diagnose(list(records)).missing
            if not (each.provisional or each.unnamed or len(each.alias_set) > 1)
        )
