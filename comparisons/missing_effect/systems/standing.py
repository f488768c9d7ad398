"""What stands on all training rows and on check records: the last fits of a diagnosis."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.bench import BETTER_WHITE, Bench, with_offsets
from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.fit import FORETOLD_BADLY, Fit, settled, start_error
from comparisons.missing_effect.systems.metric import Metric, metric_of, raw_metric
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.quantities import (
    asked_beyond,
    covariance,
    is_nothing,
    widened,
)
from comparisons.missing_effect.systems.records import Records, check_run, rows_together, runs_of
from comparisons.missing_effect.systems.remarks import WORTH_SAYING
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import reads_at_once
from comparisons.missing_effect.systems.structure import HALF_SAMPLE, Run
from comparisons.missing_effect.systems.system import LEAST_LOST, RIVAL_SHARE
from surge_core.types import FloatArray

# Steps of a fit to a check record, for what training records cannot know.
REFIT_STEPS = 25

# A fit to all training rows, the covariance of its numbers, its metric, and the bounds in its way.
Whole = tuple[Fit, FloatArray, Metric, dict[str, str]]


def checkable(experiment: Experiment, records: Records) -> Experiment:
    """Return a check record; refuse another rate, or too few rows."""
    period_s = records.whole[0].sample_period_s
    n, own_s = experiment.n_samples, experiment.sample_period_s
    settle = first_rows(records.model, experiment)
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


def first_rows(model: Model, experiment: Experiment) -> int:
    """Return the rows that the start of a check record comes from, at least."""
    n = experiment.n_samples
    # Several rows a state; a number of the record's own shows slowly and takes a tenth of it. So
    # many readings of each output, in a third of the rows at most.
    wanted = max(10, 5 * len(model.states), n // 10 if model.per_record else 0)
    read = np.isfinite(experiment.columns(model.output_names)).cumsum(axis=0).min(axis=1)
    most = max(wanted, min(int(np.searchsorted(read, wanted)) + 1, n // 3))
    return experiment.settle or most


def standing(
    bench: Bench, plain: Whole, checks: Sequence[Experiment]
) -> tuple[Whole, tuple[CheckRun, ...], dict[Placed, str]]:
    """Return the fit to all rows with what stands there, on check records, and what does not."""
    before, gone = plain[0], dict[Placed, str]()
    while effects := bench.fit.structure.effects:
        whole = whole_fit(bench)
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
        idle = [e for e in zero if not whole_fit(less[e.key])[0].cost > fit.cost + LEAST_LOST]
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


def whole_fit(bench: Bench) -> Whole:
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


def as_good_wider(bench: Bench, before: Fit, beyond: Collection[str]) -> bool:
    """Tell whether wider bounds explain most of what the added effects do."""
    if not (beyond and bench.fit.structure.effects):
        return False
    runs = runs_of(bench.records, bench.records.whole, before.structure.between, begun=True)
    # Inputs early by a third of a row stood in for a stiffness at its bound.
    timed = replace(before, theta=with_offsets(before, bench.fit))
    wide = widened(timed, beyond).again(runs, raw_metric([run.outputs for run in runs]))
    return before.cost - wide.cost > RIVAL_SHARE * (before.cost - whole_fit(bench)[0].cost)


def _checked(records: Records, experiment: Experiment, before: Fit, after: Fit) -> CheckRun:
    """Simulate a check record; its start comes from its first rows, which are not scored.

    Beyond the noise, it is fitted as well: what that takes away no training record can know.
    """

    def begun(fit: Fit, rows: int) -> tuple[Fit, Run, Metric]:
        run = check_run(records, experiment, fit)
        raw = raw_metric([run.outputs]).with_size_of(fit.errors)
        return settled(fit, [run], raw, rows=rows), run, raw

    rows, least = experiment.n_samples // 3, first_rows(records.model, experiment)
    first, run, raw = begun(after, least)
    rows, loose = start_error(first, run, raw, least, least if experiment.settle else rows)
    was = begun(before, rows)[0].paths[0].outputs
    there, run, raw = (first, run, raw) if rows == least else begun(after, rows)
    simulated = [was, there.paths[0].outputs]
    if not there.failed and np.any(
        WORTH_SAYING * there.rms > np.asarray(metric_of(after.errors).sigma)
    ):
        simulated.append(there.again([run], raw, most=REFIT_STEPS).paths[0].outputs)
    return shown_run(experiment, "check", records.model, simulated, settle=rows, loose=loose)


def shown_run(
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
