"""What a user's simulation model lacks: the workflow from model and records to a verdict."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
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
from comparisons.missing_effect.systems.bench import BETTER_WHITE, Bench, with_offsets
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
from comparisons.missing_effect.systems.fit import (
    FORETOLD_BADLY,
    Fit,
    settled,
    start_error,
)
from comparisons.missing_effect.systems.metric import Metric, metric_of, raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.open_terms import OPEN_TERMS
from comparisons.missing_effect.systems.places import Placed, SystemEffect
from comparisons.missing_effect.systems.quantities import (
    AT_BOUND,
    asked_beyond,
    at_bound,
    correlation_of,
    covariance,
    is_nothing,
    numbers_of,
    widened,
)
from comparisons.missing_effect.systems.records import Records, check_run, rows_together, runs_of
from comparisons.missing_effect.systems.remarks import (
    WORTH_SAYING,
    beyond_words,
    clock_words,
    open_words,
    refitted_words,
    start_words,
    unknown_words,
)
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import reads_at_once
from comparisons.missing_effect.systems.structure import HALF_SAMPLE, MOST_OFFSET, Run
from comparisons.missing_effect.systems.system import (
    LEAST_LOST,
    RIVAL_SHARE,
    ModelRound,
    ModelSystem,
)
from surge_core.threads import one_thread
from surge_core.types import FloatArray

MOST_EFFECTS = 4
# Steps of a fit to a check record, for what training records cannot know.
REFIT_STEPS = 25
STILL_FORETOLD = "inputs and states still foretell the error that is left"
BESIDE_UNNAMED = "a term without a name had to stand beside it, for which it may stand in"

Progress = Callable[[str], None]
# A fit to all training rows, the covariance of its numbers, its metric, and the bounds in its way.
Whole = tuple[Fit, FloatArray, Metric, dict[str, str]]


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
    checks = [_checkable(without_repeats(e, held), records) for e in given]
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


def _checkable(experiment: Experiment, records: Records) -> Experiment:
    """Return a check record; refuse another rate, or too few rows."""
    period_s = records.whole[0].sample_period_s
    n, own_s = experiment.n_samples, experiment.sample_period_s
    settle = _first_rows(records.model, experiment)
    experiment.require(
        abs(own_s - period_s) <= 1e-6 * period_s,
        "sample period",
        f"that of the training records, {period_s:g} s",
        f"{own_s:g} s",
        "resample it: lags and timing offsets are given in samples",
    )
    expected = f"more than twice the {settle} rows from which its start is estimated"
    experiment.require(settle < n // 2, "rows", expected, f"{n}")
    return experiment


def _first_rows(model: Model, experiment: Experiment) -> int:
    """Return the rows that the start of a check record comes from, at least."""
    n = experiment.n_samples
    # Several rows a state; a number of the record's own shows slowly and takes a tenth of it. So
    # many readings of each output, in a third of the rows at most.
    wanted = max(10, 5 * len(model.states), n // 10 if model.per_record else 0)
    read = np.isfinite(experiment.columns(model.output_names)).cumsum(axis=0).min(axis=1)
    most = max(wanted, min(int(np.searchsorted(read, wanted)) + 1, n // 3))
    return experiment.settle or most


def _concluded(
    base: Bench,
    bench: Bench,
    rounds: tuple[ModelRound, ...],
    checks: Sequence[Experiment],
    left: Leftover,
) -> SystemDiagnosis:
    records = base.records
    plain = _whole(base)
    before, before_cov, _, asked = plain
    asked = asked if _as_good_wider(bench, before, asked) else {}
    whole, checked, gone = _standing(base if asked else bench, plain, checks)
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
        _run(e, "fitted", model, [fit.paths[r].outputs for fit in (before, after)])
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
            *start_words([_first_rows(model, e) for e in checks], checked),
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


def _standing(
    bench: Bench, plain: Whole, checks: Sequence[Experiment]
) -> tuple[Whole, tuple[CheckRun, ...], dict[Placed, str]]:
    """Return the fit to all rows with what stands there, on check records, and what does not."""
    before, gone = plain[0], dict[Placed, str]()
    while effects := bench.fit.structure.effects:
        whole = _whole(bench)
        fit, cov = whole[:2]
        simulated = () if fit.failed else checks
        runs = tuple(_checked(bench.records, e, before, fit) for e in simulated)
        # What fits two thirds of the rows may run away on all of them, or on a check record: of an
        # arm, an error of 16 degrees became one of 32 000.
        away = [run.after_rms / np.fmax(run.swing, FORETOLD_BADLY * run.before_rms) for run in runs]
        lost = [np.isfinite(run.before_rms) & ~(x < 1.0) for run, x in zip(runs, away, strict=True)]
        wild = not fit.cost <= before.cost or bool(np.any(lost))
        zero = [] if wild else [e for e in effects if is_nothing(fit, e, cov)]
        less = {e.key: _without(bench, e) for e in zero}
        # Of a state without a scale of its own no number is fixed, whatever it explains: a coil
        # that saturates won 10 386 log-units by a number that was 0 within its error.
        idle = [e for e in zero if not _whole(less[e.key])[0].cost > fit.cost + LEAST_LOST]
        # A name is shown with what it does to check records; a term that helps none is no use, nor
        # is what came after a name: of a heater, all records went 15 to 20 % more wrong.
        further = len(effects) > 1 or effects[-1].unnamed
        spoilt = not wild and further and bool(runs) and all(run.spoilt for run in runs)
        if not (wild or idle or spoilt):
            for one in zero:
                at = int(fit.structure.slots_of(one)[0])
                cov[at, at] = np.inf
            return whole, runs, gone
        last, why = (*effects, *idle)[-1], "its number is 0 within its error"
        if wild or not idle:
            last, why = effects[-1], "with it the error on every check record grows"
        gone[last] = "with it the model runs away, or all rows fit worse" if wild else why
        bench = less.get(last.key) or _without(bench, last)
    return plain, tuple(_checked(bench.records, e, before, before) for e in checks), gone


def _without(bench: Bench, placed: Placed) -> Bench:
    structure = bench.fit.structure
    theta = np.delete(bench.fit.theta, structure.slots_of(placed))
    return bench.refitted(structure.without(placed), theta)


def _whole(bench: Bench) -> Whole:
    """Fit a model to all training rows, in the raw metric; and say which bounds are in the way."""
    structure = replace(bench.fit.structure, offsets_free=False)
    runs = runs_of(bench.records, bench.records.whole, structure.between, begun=True)
    raw = raw_metric([run.outputs for run in runs])
    fit = replace(bench.fit, structure=structure).again(runs, raw)
    cov, beyond = covariance(fit, runs, raw), asked_beyond(fit, runs, raw)
    for placed in structure.effects:
        if placed.effect.kind == Kind.INPUT_DELAY:
            at = int(structure.slots_of(placed)[0])
            cov[at, at] += _moved_the_other_way(fit, bench.records, raw, placed.place.at, at) ** 2
            # What is held and read at once is the same for all delays of the last row, uniform
            # there (GUM 4.3.7): one of 530 ms came out as 599.91 ± 0.10 ms, at rows of 100 ms.
            cov[at, at] += reads_at_once(structure, runs[0], fit.theta, placed.place.at) / 3.0
    return fit, cov, raw if fit.failed else metric_of(fit.errors), beyond


def _moved_the_other_way(fit: Fit, records: Records, raw: Metric, j: int, at: int) -> float:
    """Return by how much a delay of input j moves where that runs the other way between samples.

    What is held is late by half a sample itself; nothing, where the records reject that way.
    """
    if fit.failed or records.between[j] != "auto":
        return 0.0
    ways, theta = fit.structure.ways, fit.theta.copy()
    held = ways[j] == "held"
    other_way = (*ways[:j], "cubic" if held else "held", *ways[j + 1 :])
    structure = replace(fit.structure, between=other_way)
    theta[at] += HALF_SAMPLE if held else -HALF_SAMPLE
    runs = runs_of(records, records.whole, structure.between, begun=True)
    other = replace(fit, structure=structure, theta=theta).again(runs, raw)
    lost = (other.cost - fit.cost) / rows_together(fit)
    return float(other.theta[at] - fit.theta[at]) if lost < BETTER_WHITE else 0.0


def _as_good_wider(bench: Bench, before: Fit, beyond: Collection[str]) -> bool:
    """Tell whether wider bounds explain most of what the added effects do."""
    if not (beyond and bench.fit.structure.effects):
        return False
    runs = runs_of(bench.records, bench.records.whole, before.structure.between, begun=True)
    # Inputs early by a third of a row stood in for a stiffness at its bound.
    timed = replace(before, theta=with_offsets(before, bench.fit))
    wide = widened(timed, beyond).again(runs, raw_metric([run.outputs for run in runs]))
    return before.cost - wide.cost > RIVAL_SHARE * (before.cost - _whole(bench)[0].cost)


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


def _run(
    experiment: Experiment,
    kind: str,
    model: Model,
    simulated: Sequence[FloatArray],
    settle: int = 0,
    loose: float | FloatArray = 0.0,
) -> CheckRun:
    """Return a record with its simulations before, after, and fitted to the record itself."""
    n, period_s = experiment.n_samples, experiment.sample_period_s
    time_s = experiment.first_s + period_s * np.arange(n, dtype=np.float64)
    before, after, *own = simulated
    return CheckRun(
        experiment.name,
        kind,
        period_s,
        time_s,
        model.outputs,
        experiment.columns(model.output_names),
        before,
        after,
        settle,
        experiment.channels,
        own[0] if own else None,
        loose,
    )


def _checked(records: Records, experiment: Experiment, before: Fit, after: Fit) -> CheckRun:
    """Simulate a check record; its start comes from its first rows, which are not scored.

    Beyond the noise, it is fitted as well: what that takes away no training record can know.
    """

    def begun(fit: Fit, rows: int) -> tuple[Fit, Run, Metric]:
        run = check_run(records, experiment, fit)
        raw = raw_metric([run.outputs]).with_size_of(fit.errors)
        return settled(fit, [run], raw, rows=rows), run, raw

    rows, least = experiment.n_samples // 3, _first_rows(records.model, experiment)
    first, run, raw = begun(after, least)
    rows, loose = start_error(first, run, raw, least, least if experiment.settle else rows)
    was = begun(before, rows)[0].paths[0].outputs
    there, run, raw = (first, run, raw) if rows == least else begun(after, rows)
    simulated = [was, there.paths[0].outputs]
    if not there.failed and np.any(
        WORTH_SAYING * there.rms > np.asarray(metric_of(after.errors).sigma)
    ):
        simulated.append(there.again([run], raw, most=REFIT_STEPS).paths[0].outputs)
    return _run(experiment, "check", records.model, simulated, settle=rows, loose=loose)
