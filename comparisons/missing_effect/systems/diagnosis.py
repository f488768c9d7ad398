"""What a user's simulation model lacks: the workflow from model and records to a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.nulls import Leftover
from comparisons.missing_effect.results import CORRELATION, MissingEffect, ParameterRow
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.search import (
    alias_sets,
    is_worth_adding,
    search,
    search_round,
    verdict_of,
)
from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.doubts import (
    doubts_beside,
    doubts_of,
    leftover_of,
    one_sided,
    proves,
    undecided,
)
from comparisons.missing_effect.systems.experiments import Experiment, held_rows, without_repeats
from comparisons.missing_effect.systems.fit import FORETOLD_BADLY, Fit
from comparisons.missing_effect.systems.metric import metric_of
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.open_terms import OPEN_TERMS
from comparisons.missing_effect.systems.places import Placed, SystemEffect
from comparisons.missing_effect.systems.quantities import (
    AT_BOUND,
    at_bound,
    correlation_of,
    numbers_of,
)
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.remarks import (
    beyond_words,
    clock_words,
    open_words,
    refitted_words,
    start_words,
    unknown_words,
)
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.standing import (
    as_good_wider,
    checkable,
    first_rows,
    shown_run,
    standing,
    whole_fit,
)
from comparisons.missing_effect.systems.structure import MOST_OFFSET
from comparisons.missing_effect.systems.system import ModelRound, ModelSystem
from surge_core.threads import one_thread
from surge_core.types import FloatArray

MOST_EFFECTS = 4
STILL_FORETOLD = "inputs and states still foretell the error that is left"
BESIDE_UNNAMED = "a term without a name had to stand beside it, for which it may stand in"

Progress = Callable[[str], None]


@one_thread()
def diagnose_model(
    model: Model,
    fit: Experiment | Sequence[Experiment],
    check: Experiment | Sequence[Experiment] = (),
    *,
    catalogue: Sequence[SystemEffect] = SYSTEM_CATALOGUE,
    library: Sequence[SystemEffect] = OPEN_TERMS,
    most_effects: int = MOST_EFFECTS,
    progress: Progress | None = None,
) -> SystemDiagnosis:
    """Find what a model lacks, name it, add it, and show the error fall on other records.

    Names come from the training records alone: two thirds are fitted and the last third is held
    out of the fits. Check records are simulated at the end: no name is chosen by them, and they can
    only speak against one.

    Parameters
    ----------
    model : Model
        The user's model.
    fit : Experiment or sequence of Experiment
        Training records, of whatever lengths.
    check : Experiment or sequence of Experiment
        Records that are simulated and shown.
    catalogue : sequence of SystemEffect
        The names.
    library : sequence of SystemEffect
        Terms without a name, for what no name fits (`open_effect` makes one's own).
    most_effects : int
        Add at most so many.
    progress : callable, optional
        Told in a few words what begins.

    Returns
    -------
    SystemDiagnosis

    Raises
    ------
    InputError
        When records do not fit the model.
    """
    report = progress or (lambda _: None)
    model = model.with_record_parameters()
    fits, given = (
        [e.of(model) for e in ([runs] if isinstance(runs, Experiment) else runs)]
        for runs in (fit, check)
    )
    rows = {name: held_rows(name, fits, given) for name in model.output_names} if fits else {}
    held = {name: every for name, every in rows.items() if every > 1}
    records = Records.of(model, [without_repeats(e, held) for e in fits])
    checks = [checkable(without_repeats(e, held), records) for e in given]
    report("fitting the model")
    system, rounds = search(ModelSystem.of(records), catalogue, library, most_effects, report)
    base = rounds[0].bench if rounds else system
    if records.shortened and len(system.found) < most_effects and not system.failed:
        report("looking for what changes slowly")
        system, rounds = _with_drift(system, rounds, catalogue)
    sets = alias_sets(system, rounds, catalogue)
    rounds = [
        replace(s, aliases=sets.get(s.winner.added[0].key, s.aliases)) if s.winner else s
        for s in rounds
    ]
    report("testing what is left")
    left = leftover_of(system, catalogue, library)
    report("fitting all rows")
    diagnosis = _concluded(base, system, tuple(rounds), checks, left)
    said = [
        f"The output {name} is held for {every} rows after each reading: only rows with a new "
        "reading are fitted and scored"
        for name, every in held.items()
    ]
    return replace(diagnosis, remarks=(*said, *diagnosis.remarks))


def _with_drift(
    system: ModelSystem, rounds: list[ModelRound], catalogue: Sequence[SystemEffect]
) -> tuple[ModelSystem, list[ModelRound]]:
    """Look for a drift over whole records, of which the search saw the first rows alone."""
    drifts = [effect for effect in catalogue if effect.kind is Kind.DRIFT]
    whole = system.over_whole_records()
    step = None if not drifts or whole.failed else search_round(whole, drifts, ())
    if step is None or step.winner is None:
        return system, rounds
    moved = whole.with_better(step.winner.fit, step.winner.onward)
    if not is_worth_adding(step, whole, moved):
        return system, rounds
    # A round that added nothing is the last one, and this one stands in its place.
    last, keys = rounds[-1].winner, {e.key for e in system.found}
    idle = last is None or not last.keys <= keys
    return moved, [*rounds[: len(rounds) - idle], step]


def _concluded(
    base: Bench,
    bench: Bench,
    rounds: tuple[ModelRound, ...],
    checks: Sequence[Experiment],
    left: Leftover,
) -> SystemDiagnosis:
    records = base.records
    plain = whole_fit(base)
    before, before_cov, _, asked = plain
    asked = asked if as_good_wider(bench, before, asked) else {}
    whole, checked, gone = standing(base if asked else bench, plain, checks)
    after, after_cov, metric, beyond = whole
    added = after.structure.effects
    keys = {e.key for e in added}
    beyond = asked | beyond
    won = [(r, p) for r in rounds if r.winner for p in r.winner.added if p.key in keys]
    model = records.model
    errors = before.rms, after.rms, np.asarray(metric.sigma)
    names = [placed for _, placed in won]
    missing = tuple(
        _found(after, after_cov, r, p, records, checked, beyond, left, errors, names)
        for r, p in won
    )
    unnamed = any(item.unnamed for item in missing)
    if left.structured or unnamed:
        # A name beyond the first may stand in for what is left, or for what has no name; so may the
        # first, without a check record to prove it.
        sure, why = int(proves(checked)), STILL_FORETOLD if left.structured else BESIDE_UNNAMED
        later = [item if item.unnamed else item.doubted(why) for item in missing[sure:]]
        missing = (*missing[:sure], *later)
    # What acts in the training rows as well does not act in a check record alone.
    apart = () if left.structured else checked
    badly = "" if missing else _badly_foretold(base, apart)
    left_over = left.structured or left.late or left.disturbed
    halved = undecided(rounds[-1]) if rounds and not missing else ""
    open_ = not missing and any((gone, beyond, badly, halved, left_over))
    parameters = _parameters(records, (before, before_cov), (after, after_cov))
    offsets = _offsets(model, after, after_cov)
    training = tuple(
        shown_run(e, "fitted", model, [fit.paths[r].outputs for fit in (before, after)])
        for r, e in enumerate(records.whole)
    )
    return SystemDiagnosis(
        verdict=verdict_of(missing, "unexplained_structure" if open_ else "nothing_missing"),
        missing=missing,
        parameters=parameters,
        unavailable={
            name: why
            for name, why in (rounds[-1].refused if rounds else {}).items()
            if all(name not in item.alias_set for item in missing)
        },
        remarks=(
            *beyond_words(beyond),
            *unknown_words(parameters),
            *clock_words(offsets, after),
            *open_words(base.records.model, missing, left, gone, badly, halved),
            *start_words([first_rows(model, e) for e in checks], checked),
            *refitted_words(checked),
        ),
        model=model,
        records=records,
        rounds=rounds,
        before=before,
        after=after,
        offsets=offsets,
        training=training,
        checks=checked,
        floor=metric.sigma,
    )


def _found(
    fit: Fit,
    cov: FloatArray,
    step: ModelRound,
    placed: Placed,
    records: Records,
    checks: Sequence[CheckRun],
    beyond: Mapping[str, str],
    left: Leftover,
    errors: Sequence[FloatArray],
    found: Sequence[Placed],
) -> MissingEffect:
    winner = step.winner
    assert winner is not None
    model, evidence = records.model, winner.evidence
    aliases = [c.added[0] for c in step.aliases] if len(winner.added) == 1 else [placed]
    numbers = numbers_of(fit, placed, cov, step.bench.train[0].clock)
    alone = len(found) == 1
    doubts = doubts_of(step, placed, numbers, checks, model, left, errors, alone=alone)
    doubts += doubts_beside(placed, numbers, found, left, model, checks, one_sided(fit, records))
    doubts += tuple(f"the records ask for {bound}" for bound in beyond.values())
    doubts += tuple(filter(None, [at_bound(fit, placed)]))
    confirm = {placed.label(model): placed.words(model).confirm}
    for one in aliases:
        confirm.setdefault(one.label(model), one.words(model).confirm)
    return MissingEffect(
        placed.name,
        tuple(dict.fromkeys(one.name for one in aliases)),
        bool(doubts),
        numbers,
        {
            "train": evidence.train,
            "held_out": evidence.later,
            "z": evidence.z,
            "score": evidence.score,
            "p_value": evidence.p_value,
            CORRELATION: correlation_of(fit, placed, cov),
        },
        doubts,
        placed.label(model),
        placed.where(model),
        tuple(one.label(model) for one in aliases),
        placed.effect.unnamed,
        placed.equation(model),
        placed.words(model).says,
        confirm,
    )


def _badly_foretold(bench: Bench, checks: Sequence[CheckRun]) -> str:
    """Return which rows that are not fitted go far more wrong than those that are, if any do.

    What happens in them alone cannot be found: nothing is fitted to them. Larger noise on a check
    record is none of it, and neither are the errors of its start. Beside its mean a model is no
    use: of a cart, 3.4 was left on rows that swing by 63, and 6.0 on a record that swings by 3.3.
    """
    largest = FORETOLD_BADLY * bench.fit.rms
    if np.any(bench.held_out_rms() > largest):
        return "The last third of the training rows"
    for run in checks:
        rms, useful = run.before_rms, np.fmin(largest, run.swing)
        most = np.hypot(useful, FORETOLD_BADLY * run.loose)
        new = metric_of([run.errors(before=True)]).sigma if np.isfinite(rms).all() else np.zeros(1)
        if not np.all((rms <= most) | (rms <= FORETOLD_BADLY * np.asarray(new))):
            return f"The check record {run.name}"
    return ""


def _parameters(records: Records, *fits: tuple[Fit, FloatArray]) -> tuple[ParameterRow, ...]:
    """Return the parameters by the fits before and after, those of each record one row a record."""
    model, rows = records.model, []
    for i, (name, p) in enumerate(model.params.items()):
        rows.append(_row(name, p, [(fit.theta[i], cov[i, i]) for fit, cov in fits]))
    for k, (name, p) in enumerate(model.per_record.items()):
        for r, record in enumerate(records.whole):
            at, c = model.own_states + k, k + len(model.per_record) * r
            own = [(fit.starts[r][at], np.diag(cov)[fit.theta.size + c]) for fit, cov in fits]
            rows.append(_row(f"{name} of {record.name}", p, own))
    return tuple(rows)


def _row(name: str, p: P, fitted: Sequence[tuple[float, float]]) -> ParameterRow:
    """Return a parameter by its values and variances before and after."""
    (before, after), (before_stderr, after_stderr) = zip(
        *((float(value), float(np.sqrt(max(variance, 0.0)))) for value, variance in fitted),
        strict=True,
    )
    # What may be anywhere within its bounds is not fixed.
    before_stderr, after_stderr = (
        np.inf if error > p.high - p.low else error for error in (before_stderr, after_stderr)
    )
    at_bound = min(after - p.low, p.high - after) < AT_BOUND * (p.high - p.low)
    return ParameterRow(name, p.unit, before, after, before_stderr, after_stderr, at_bound)


def _offsets(model: Model, fit: Fit, cov: FloatArray) -> tuple[FittedParameter, ...]:
    at = fit.structure.offsets
    values, errors = fit.theta[at] + 0.0, np.sqrt(np.maximum(np.diag(cov)[at], 0.0))
    errors[errors > 2.0 * MOST_OFFSET] = np.inf
    each = zip(model.input_names, values.tolist(), errors.tolist(), strict=True)
    return tuple(FittedParameter(name, value, error, "samples") for name, value, error in each)
