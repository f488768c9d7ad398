"""The workflow on whole runs from raw counts: names by what they explain beyond twins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from classic_ml.series import CoefficientSeries
from classic_ml.whole_record_fit import LARGEST_SHARE
from classic_ml.whole_run import check_rates
from comparisons.missing_effect.candidates import Bench, LagCandidate
from comparisons.missing_effect.catalogue import NAMELESS, find_effect
from comparisons.missing_effect.conclusion import AliasSets, concluded, missing_effect
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import fit_structure
from comparisons.missing_effect.lag_result import LagDiagnosis, ReverseLoss
from comparisons.missing_effect.loading import block_rows, readings_of, whole_data
from comparisons.missing_effect.quantities import size_words
from comparisons.missing_effect.results import LEAST_SIZE, SIZE, Absent, Untold
from comparisons.missing_effect.search import alias_sets, search, verdict_of
from comparisons.missing_effect.whole_run_alignment import PlaneTiming
from comparisons.missing_effect.whole_run_spectra import RippleLine, averaged_noise, ripple_line
from comparisons.missing_effect.whole_runs import (
    FEWEST_TWINS,
    INERTIA,
    SENSITIVITY,
    SHAPED,
    Nulls,
    Progress,
    WholeRuns,
    nulls_of,
    number_of,
    plain_bench,
    rms_left,
)
from surge_core.errors import require
from surge_core.types import FloatArray

# Beyond so many times what twins leave, model error rules the errors, and a name may be another's.
MUCH = 2.0
# Averaged φ² above this is a reversal and not its edge; what the loss must explain there.
LEAST_LOSS = 1e-5
LEAST_REVERSED_ROWS = 10
LEAST_LOSS_SHARE = 0.4
NO_TWINS = "no twins of the record were measured"
NO_MEASURE = (
    "the model leaves more than twice as much of these records as of their twins, which are no "
    "measure of chance then"
)
# Twice a wrong ∫dx/A was firm at 2.5 and 2.8, on machines whose twins lack a part of their errors.
FIRM_Z = 3.0
# A name that closes less of the gap between the model and its twins leaves more than it explains,
# and something else may be there: clean records of another rig, whose unstalled branch has a
# corner, bore names that closed 0.25 to 0.44 of it, late planes and drifts 0.7 and more.
LEAST_CLOSED = 0.5
MORE_STAYS = "more than half of what the model leaves beyond its twins stays"
LEFT_OPEN = "with it the record leaves τ open by {:.0f} %, and what is read as it may be the lag"
FEW_CYCLES = f"on the cycles left out it wins by fewer than {FIRM_Z:g} standard errors"
REVERSED = "reverse_flow_branch"
SECOND_PATTERN = "what a second pattern of stall cells leaves takes other names"
WITHOUT_PATTERN = "a record at a throttle or speed without the second pattern"
BETTER_RECORDS = "or a record with loops in stall between the deep cycles, or at a higher rate"


def diagnose_whole_runs(
    records: Sequence[CoefficientSeries],
    terms: tuple[str, ...],
    *,
    catalogue: Sequence[Effect],
    most_effects: int,
    n_twins: int,
    progress: Progress,
) -> LagDiagnosis:
    """Find what the lag model of whole runs lacks; one immersion is refused."""
    check_rates(records)
    ordered = sorted(records, key=lambda record: float(record.time_s[0]))
    readings = readings_of(ordered)
    require(
        all(one.passes.shift is not None for one in readings),
        "records",
        "probes at hub and tip, whose flows show when the machine is in stall",
        "one immersion alone",
        "add a probe pair at hub or tip",
    )
    data = whole_data(ordered, readings)
    lines = [line for reading in readings if (line := ripple_line(reading)) is not None]
    line = max(lines, key=lambda one: one.height) if len(lines) == len(readings) else None
    unavailable = {e.name: why for e in catalogue if (why := e.missing_channel(data)) is not None}
    # A ripple is looked for as a line, the loss in reversed flow in rows that are not scored.
    apart = {e.name for e in catalogue if e.episodes or e.name == REVERSED} | unavailable.keys()
    effects = [e for e in catalogue if e.name not in apart]
    timing = PlaneTiming.of([one.signals.chain.alignment for one in readings], effects)
    effects = [e for e in effects if e not in timing.refuted]
    effects, blind = ([], effects) if line or timing.slow else (effects, [])
    base = plain_bench(data, readings, terms, len(effects), block_rows(data))
    if n_twins and effects:
        leader = _of_leader(base, effects)
        nulls = nulls_of(
            ordered, readings, base, effects, leader, n_twins=n_twins, progress=progress
        )
        base = replace(base, nulls=nulls)
    nulls = base.nulls
    bench, rounds = search(base, effects, (), most_effects)
    sets: AliasSets = alias_sets(bench, rounds, effects)
    if timing.slow:
        bench, rounds, sets = timing.named(base)
    much = not (blind or rms_left(bench) <= MUCH * nulls.rms)
    otherwise = "unexplained_structure" if much and n_twins else "nothing_missing"
    diagnosis = concluded(
        base,
        bench,
        rounds,
        sets,
        ("named" if n_twins else "provisional") if line else otherwise,
        (NO_MEASURE,) if much else (),
        averaged_noise(readings),
    )
    diagnosis = _with_shared(diagnosis, nulls)
    # Twins lack the first effect, so that they are no null of a second beside it.
    missing = tuple(
        timing.judged(
            item
            if timing.found.late
            or item.provisional
            or not (
                why := _doubt(i, sets[item.effect], base)
                or _nameless(sets[item.effect], base, catalogue)
            )
            else item.doubted(why)
        )
        for i, item in enumerate(diagnosis.missing)
    )
    verdict = verdict_of(missing, diagnosis.verdict) if timing.slow else diagnosis.verdict
    if missing and all(item.provisional for item in missing):
        verdict = "provisional"
    named = {name for item in missing if not item.provisional for name in item.alias_set}
    others = [e for e in (*effects, *blind) if e.name not in named]
    untold, absent = _decided(others, nulls)
    if timing.slow:
        untold = timing.untold(others)
    if line:
        untold = tuple(Untold(e.name, SECOND_PATTERN, WITHOUT_PATTERN) for e in others)
    diagnosis = replace(
        diagnosis,
        verdict=verdict,
        missing=missing,
        remarks=(*diagnosis.remarks, *timing.remarks),
        unavailable=unavailable,
        catalogue=tuple(catalogue),
        untold=untold,
        absent=tuple(one for one in (*timing.absent, *absent) if one.effect not in diagnosis.names),
    )
    return _with_line(_with_reverse_loss(diagnosis, bench, bool(n_twins)), line, bool(n_twins))


def _of_leader(bench: WholeRuns, effects: Sequence[Effect]) -> FloatArray:
    """Return what the effect that explains most adds to ψ', on the fine rows.

    With it in the twins the null would hold what is looked for: a drift that the model without it
    takes for a τ of a second, say. What is shaped by φ has no part of its own.
    """
    tried = bench.tried([e for e in effects if e.name not in SHAPED]).candidates
    best, data = min(tried, key=lambda c: c.fit.cost), bench.data
    without = best.fit.without_amplitude(best.added[0], data)
    added = best.fit.output(data) - without.output(data)
    return np.asarray(np.interp(np.arange(data["phi"].size), data.rows, added))


def _doubt(place: int, members: Sequence[LagCandidate], bench: WholeRuns) -> str:
    """Say why a set is not firm; nothing where one of it is beyond its null.

    That asks for the first set, a record that decides about it, most of its cycles and most of the
    gap.
    """
    by_effect = bench.nulls.by_effect
    # Blocks that speak by themselves do not make up for it: of four cycles three were loud for a
    # second lag, at 2.4 standard errors, where the curve had a kink.
    beyond = [
        c.evidence.z > FIRM_Z
        for c in members
        if c.evidence.accepted
        and c.name in by_effect
        and by_effect[c.name].is_sure(number_of(c.added[0], c.fit, bench))
    ]
    if place or not beyond:
        return NO_MEASURE
    if not any(beyond):
        return FEW_CYCLES
    gap = 1.0 - (bench.nulls.rms / rms_left(bench)) ** 2
    if members[0].evidence.share < LEAST_CLOSED * gap:
        return MORE_STAYS
    # On a straight curve −ℓ dφ/dt is the lag to first order. Asked of every name this cost 4 of 16
    # true delays and one of 22 drifts, with which τ was open by 12 to 14 %.
    share = by_effect[INERTIA].open_tau if members[0].name == INERTIA else 0.0
    return LEFT_OPEN.format(100.0 * share) if share > LARGEST_SHARE else ""


def _with_shared(diagnosis: LagDiagnosis, nulls: Nulls) -> LagDiagnosis:
    """Add what all cycles share to the errors of τ and of what is missing: no scatter of cycles.

    The errors over cycles alone were 0.04 ms for a delay that was 0.4 ms off, and 0.29 ms for a τ
    that was 2.1 ms off.
    """
    tau, *others = diagnosis.parameters
    missing, log_tau = [], []
    for item in diagnosis.missing:
        null, (first, *more) = nulls.by_effect.get(item.effect), item.parameters
        both, evidence = first.stderr, item.evidence
        if null is not None:
            log_tau.append(null.shared[1])
            if item.effect not in (*SHAPED, "facility_heating") and both > 0.0:
                both = float(np.hypot(both, null.shared[0]))
                evidence = {**evidence, SIZE: evidence[SIZE] * first.stderr / both}
        numbers = replace(first, stderr=both), *more
        missing.append(replace(item, parameters=numbers, evidence=evidence))
    last = max(log_tau, default=nulls.log_tau)
    tau = replace(
        tau,
        before_stderr=float(np.hypot(tau.before_stderr, tau.before * nulls.log_tau)),
        after_stderr=float(np.hypot(tau.after_stderr, tau.after * last)),
    )
    return replace(diagnosis, parameters=(tau, *others), missing=tuple(missing))


def _nameless(
    members: Sequence[LagCandidate], bench: WholeRuns, catalogue: Sequence[Effect]
) -> str:
    """Say that something whose name does not compete would do as well; nothing where none would.

    With the late plane or the drifting gain of altered counts taken out of the catalogue, 7 of 8
    records bore another name firmly.
    """
    names, first = {effect.name for effect in catalogue}, members[0]
    others = [find_effect(name) for name in NAMELESS if name not in names]
    for other in bench.tried(others).candidates:
        share = 1.0 - other.fit.cost / bench.fit.cost
        enough = share >= (1.0 - bench.policy.alias.share) * first.evidence.share
        # As in `WholeRuns.near`: far from its reference a drift of the zero is one of the gain.
        if enough or (first.name, other.name) == ("bias_drift", SENSITIVITY):
            return f"{NAMELESS[other.name]} would do as well, and has no name in the catalogue"
    return ""


def _decided(
    effects: Sequence[Effect], nulls: Nulls
) -> tuple[tuple[Untold, ...], tuple[Absent, ...]]:
    """Return the effects about which twins decide nothing, and those that would have been seen."""
    untold, absent = [], []
    for effect in effects:
        null = nulls.by_effect.get(effect.name)
        if null is None or not np.isfinite(null.matters):
            continue
        if null.can_be_told:
            name = "rms" if effect.name in SHAPED else effect.parameters[0].name
            absent.append(Absent(effect.name, name, null.decided_from, null.unit))
            continue
        why = f"fewer than {FEWEST_TWINS} twins of this record could be measured"
        if np.isfinite(null.decided_from):
            seen = size_words(null.decided_from, null.unit)
            why = f"measured twins of this record show that it is seen from {seen} on"
        why = f"{why}, and {size_words(null.matters, null.unit)} would matter"
        untold.append(Untold(effect.name, why, f"{effect.confirm}; {BETTER_RECORDS}"))
    return tuple(untold), tuple(absent)


def _with_line(diagnosis: LagDiagnosis, line: RippleLine | None, twins: bool) -> LagDiagnosis:
    """Add the second pattern of cells, which the rake differences have taken off."""
    if line is None:
        return diagnosis
    # The spectrum around the line moves its amplitude.
    stderr = line.amplitude / float(np.sqrt(2.0 * line.height))
    found = missing_effect(
        find_effect("rotating_stall_ripple"),
        (
            FittedParameter("r", line.amplitude, stderr, "1"),
            FittedParameter("f", line.frequency_hz, line.frequency_stderr_hz, "Hz"),
        ),
        {"line_over_background": line.height},
        () if twins else (NO_TWINS,),
    )
    return replace(diagnosis, missing=(found, *diagnosis.missing), ripple=line)


def _with_reverse_loss(diagnosis: LagDiagnosis, bench: Bench, twins: bool) -> LagDiagnosis:
    """Name the loss in reversed flow, which acts without the lag: no lag model holds it.

    It is judged in the reversed rows, where the run is not scored: by how much of what a model
    without it leaves there it explains.
    """
    data = bench.data
    if not data.has_reverse_loss:
        return diagnosis
    loss = data.sampled(data.nuisance[:, -2])
    rows = loss > LEAST_LOSS
    if np.count_nonzero(rows) < LEAST_REVERSED_ROWS:
        return diagnosis
    bare = replace(data, nuisance=np.ascontiguousarray(data.nuisance[:, :-2]))
    fit = diagnosis.after
    fit = fit_structure(fit.structure, bare, bench.metric, [fit.nonlinear])
    left, loss = (data.measured - fit.output(bare))[rows], loss[rows]
    size = float(loss @ left) / float(loss @ loss)
    after = left - size * loss
    share = 1.0 - float(after @ after) / float(left @ left)
    if size <= 0.0 or share < LEAST_LOSS_SHARE:
        return diagnosis
    # Neighbouring rows of an average say the same; one a reversal is what there is.
    reversals = 1 + int(np.count_nonzero(np.diff(np.flatnonzero(rows)) > 1))
    stderr = float(np.sqrt(np.mean(after**2) / (np.mean(loss**2) * reversals)))
    if size < LEAST_SIZE * stderr:
        return diagnosis
    found = missing_effect(
        find_effect(REVERSED),
        (
            # The probes see reversed flow from behind, and their mean is not the flow: on five
            # machines c was 0.4 to 1.5 of the true one, which no scatter of this record shows.
            FittedParameter("c", size, np.nan, "1"),
            FittedParameter("lagged", 0.0, 0.0, "1"),
        ),
        {"share_of_reversed_rows": share, SIZE: size / stderr if stderr > 0.0 else np.inf},
        () if twins else (NO_TWINS,),
    )
    verdict = diagnosis.verdict
    if verdict == "nothing_missing":
        verdict = "named" if twins else "provisional"
    remark = (
        f"the loss in reversed flow accounts for {100.0 * share:.0f} % of the error in "
        f"{reversals} reversals, which were not used to find τ; how large it is stays open, "
        "since the probes see reversed flow from behind"
    )
    return replace(
        diagnosis,
        missing=(*diagnosis.missing, found),
        verdict=verdict,
        reverse_loss=ReverseLoss(loss, left, size, share),
        remarks=(*diagnosis.remarks, remark),
    )
