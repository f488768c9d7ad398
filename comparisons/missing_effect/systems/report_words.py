"""Sentences and cells of the report on a user's model."""

from __future__ import annotations

import math

import numpy as np

from comparisons.missing_effect.systems.results import CheckRun, SystemDiagnosis
from comparisons.missing_effect.systems.search import Candidate, Round
from comparisons.missing_effect.systems.shown import (
    added,
    all_runs,
    fate_of,
    scale_of,
    split_of,
    typical,
)
from comparisons.missing_effect.systems.where import SignalRow, SystemWhere
from surge_core.rounding import log_units, round_to_error, significant

__all__ = [
    "between_words",
    "candidate_cells",
    "errors_words",
    "floor_words",
    "rounds_words",
    "stretch_words",
    "unfitted_words",
    "where_words",
]

# Records that an alternative text tells one by one.
MOST_TOLD = 6
CLEAR_Z = 3.0
FATES = {
    "added": "added",
    "alias": "cannot be separated from the best",
    "too little": "best, but too little to add",
    "accepted": "accepted, not the best",
    "refused": "not accepted",
    "not fitted": "not fitted",
}
_BETWEEN = {
    "held": "held until the next one",
    "linear": "joined by straight lines",
    "cubic": "joined by a cubic spline",
    "band": "band-limited",
}


def errors_words(d: SystemDiagnosis) -> str:
    """Return the errors of the first records, before and after.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    listed = []
    for run in all_runs(d)[:MOST_TOLD]:
        parts = []
        for j, output in enumerate(run.outputs):
            before, after = float(run.before_rms[j]), float(run.after_rms[j])
            scale = scale_of(d.model.outputs[output], [typical([before, after])])
            fell = f"{scale.text(before)} to " if d.missing else ""
            parts.append(f"{output} {fell}{scale.text(after)}")
        listed.append(f"{run.experiment.name} ({split_of(run)}) {', '.join(parts)}")
    more = len(all_runs(d)) - MOST_TOLD
    return "; ".join(listed) + (f"; and {more} more" if more > 0 else "")


def stretch_words(d: SystemDiagnosis, run: CheckRun, rows: slice) -> str:
    """Return the errors of each output over a stretch of a run, before and after.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    run : CheckRun
        One of its runs.
    rows : slice
        The stretch.
    """
    listed = []
    for j, output in enumerate(run.outputs):
        measured = run.measured[rows, j]
        before, after = (
            float(np.sqrt(np.nanmean((measured - simulated[rows, j]) ** 2)))
            for simulated in (run.before, run.after)
        )
        scale = scale_of(d.model.outputs[output], [typical([before, after])])
        fell = f"{scale.text(before)} before and " if d.missing else ""
        later = " after" if d.missing else ""
        listed.append(f"{output} rms {fell}{scale.text(after)}{later}")
    return "; ".join(listed)


def where_words(d: SystemDiagnosis, where: SystemWhere) -> tuple[str, ...]:
    """Return where the residual of one output stands out: one sentence a panel.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    where : SystemWhere
        Of one of its runs and outputs.
    """
    return _time_words(d, where), _band_words(where), _signal_words(d, where)


def _time_words(d: SystemDiagnosis, where: SystemWhere) -> str:
    known = [row for row in where.time if math.isfinite(row.before_rms)]
    if not known:
        return f"{where.output}: could not be simulated by the model before."
    worst = max(known, key=lambda row: row.before_rms)
    sizes = [row.before_rms for row in known]
    unit = d.model.outputs[where.output]
    top, median, after = (
        scale_of(unit, [size]).text(size)
        for size in (worst.before_rms, float(np.median(sizes)), worst.after_rms)
    )
    return (
        f"{where.output} in time: the residual of the model{' before' if d.missing else ''} is "
        f"largest from {worst.from_s:.4g} to {worst.to_s:.4g} s, rms {top} where the median "
        f"block has {median}{f', and {after} there after' if d.missing else ''}."
    )


def _band_words(where: SystemWhere) -> str:
    power = np.array([row.before_psd * (row.high_hz - row.low_hz) for row in where.frequency])
    if not (np.all(np.isfinite(power)) and power.sum() > 0.0):
        return f"{where.output} over frequency: no residual to tell of."
    row = where.frequency[int(np.argmax(power))]
    share = 100.0 * float(power.max() / power.sum())
    beside = ""
    if row.measured_psd > 0.0:
        part = 100.0 * row.before_psd / row.measured_psd
        listed = "more than" if part > 100.0 else f"{significant(part, 2)} % of"
        beside = f", {listed} what was measured there"
    return (
        f"{where.output} over frequency: the band from {row.low_hz:.3g} to {row.high_hz:.3g} Hz "
        f"holds {share:.0f} % of its power{beside}."
    )


def _signal_words(d: SystemDiagnosis, where: SystemWhere) -> str:
    lead = f"{where.output} over {where.signal}{' simulated' if where.simulated else ''}: "
    known = [row for row in where.flow if math.isfinite(_z(row)) and row.before_stderr > 0.0]
    if not known:
        return f"{lead}too few visits to tell a mean."
    top = max(known, key=lambda row: abs(_z(row)))
    if abs(_z(top)) < CLEAR_Z:
        return f"{lead}no mean residual beyond {CLEAR_Z:.0f} standard errors."
    size = abs(top.before_mean)
    scale = scale_of(d.model.outputs[where.output], [size])
    units = {**d.model.outputs, **d.model.inputs}
    over = scale_of(units[where.signal], [row.at for row in where.flow])
    mean = round_to_error(scale.factor * top.before_mean, scale.factor * top.before_stderr)
    if scale.unit:
        mean = f"({mean}){'·' if scale.unit.startswith('10') else ' '}{scale.unit}"
    beyond = sum(abs(_z(row)) >= CLEAR_Z for row in known)
    return (
        f"{lead}the mean residual is beyond {CLEAR_Z:.0f} standard errors in {beyond} of "
        f"{len(where.flow)} ranges, most clearly at {over.text(top.at)}: {mean}."
    )


def _z(row: SignalRow) -> float:
    return row.before_mean / row.before_stderr if row.before_stderr > 0.0 else math.nan


def rounds_words(d: SystemDiagnosis) -> str:
    """Return the best of each round and its score.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    listed = []
    for number, step in enumerate(d.rounds, start=1):
        if step.winner is None:
            listed.append(f"Round {number}: nothing accepted out of {len(step.candidates)} tried.")
            continue
        fate = "added" if added(d, step.winner) else "not added"
        beside = len(step.aliases) - 1
        same = f", {beside} more cannot be separated from it" if beside > 0 else ""
        listed.append(
            f"Round {number}: {step.winner.placed.label(d.model)} {fate}, score "
            f"{step.winner.score:.1f}{same}."
        )
    return " ".join(listed)


def candidate_cells(d: SystemDiagnosis, step: Round, candidate: Candidate) -> tuple[str, ...]:
    """Return the cells of a fitted candidate.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    step : Round
        The round.
    candidate : Candidate
        Fitted in it.
    """
    evidence = candidate.evidence
    assert evidence is not None
    numbers = (candidate.probe.gain, evidence.train, evidence.later)
    return (
        candidate.placed.label(d.model),
        _equation(d, candidate),
        *(log_units(value) for value in numbers),
        f"{evidence.z:.1f}",
        log_units(candidate.score),
        FATES[fate_of(d, step, candidate)] + (" (vanished)" if candidate.vanished else ""),
    )


def _equation(d: SystemDiagnosis, candidate: Candidate) -> str:
    place = candidate.placed.where(d.model)
    return (
        candidate.placed.effect.equation.replace("{s}", place.get("signal", place.get("input", "")))
        .replace("{o}", place.get("times", ""))
        .replace("{p}", place.get("parameter", ""))
    )


def unfitted_words(d: SystemDiagnosis, step: Round, number: int) -> str:
    """Return how many places were not worth a fit, and the best of those.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    step : Round
        The round.
    number : int
        Counted from 1.
    """
    rest = [c for c in step.candidates if c.evidence is None]
    tried = len(step.candidates)
    lead = f"Round {number}: {tried} {'place' if tried == 1 else 'places'} tried, "
    if not rest:
        return f"{lead}none of them left unfitted."
    best = max(rest, key=lambda c: c.probe.gain)
    return (
        f"{lead}{len(rest)} not fitted to the end: they promised less, fell behind, or could not "
        f"be simulated. Of these {best.placed.label(d.model)} promised most, "
        f"{best.probe.gain:.1f} log-units."
    )


def between_words(d: SystemDiagnosis) -> str:
    """Return how inputs run between samples, and who said so.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    own, before = d.after.structure.between, d.before.structure.between
    chosen = d.model.input_between_samples == "auto"
    who = "as the held-out rows ask for" if chosen else "as the model says"
    changed = f"; before, {_BETWEEN[before]}" if before != own else ""
    return f"Between samples the inputs are {_BETWEEN[own]}, {who}{changed}."


def floor_words(d: SystemDiagnosis) -> tuple[tuple[str, ...], ...]:
    """Return a row an output: what is new in each sample, and what share of the error that is.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    rows = []
    for j, (output, unit) in enumerate(d.model.outputs.items()):
        if j >= len(d.floor):
            continue
        floor = d.floor[j]
        measured = np.concatenate([run.measured[run.settle :, j] for run in d.training])
        errors = np.concatenate([(run.measured - run.after)[run.settle :, j] for run in d.training])
        swing, size = float(np.nanstd(measured)), float(np.sqrt(np.nanmean(errors**2)))
        rows.append(
            (
                output,
                scale_of(unit, [floor]).text(floor),
                f"{significant(100.0 * floor / swing, 3)} %" if swing > 0.0 else "",
                f"{100.0 * (floor / size) ** 2:.0f} %" if size > 0.0 else "",
            )
        )
    return tuple(rows)
