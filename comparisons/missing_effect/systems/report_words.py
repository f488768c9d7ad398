"""Sentences and cells of the report on a user's model."""

from __future__ import annotations

import numpy as np

from comparisons.missing_effect.scales import scale_of, typical
from comparisons.missing_effect.systems.results import CheckRun, SystemDiagnosis
from comparisons.missing_effect.systems.search import Candidate, Round
from comparisons.missing_effect.systems.shown import added, all_runs, fate_of, split_of
from surge_core.rounding import log_units, significant

__all__ = [
    "between_words",
    "candidate_cells",
    "errors_words",
    "floor_words",
    "rounds_words",
    "stretch_words",
    "unfitted_words",
]

# Records that an alternative text tells one by one.
MOST_TOLD = 6
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
