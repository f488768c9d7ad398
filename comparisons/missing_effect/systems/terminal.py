"""The diagnosis of a user's model on the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.scales import scale_of
from comparisons.missing_effect.systems.shown import fate_of, telling_run
from comparisons.missing_effect.systems.where import where_of
from comparisons.missing_effect.systems.words import (
    number_words,
    plain_name,
    system_words,
)
from comparisons.missing_effect.text import ROWS_PRINTED, aligned, wrapped
from comparisons.missing_effect.where_words import describe
from surge_core.rounding import bracketed, log_units, significant

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.results import SystemDiagnosis

__all__ = ["system_text"]

_LEFT = ("effect", "where it acts", "candidate", "fate", "parameter", "unit", "record", "output")


def system_text(d: SystemDiagnosis) -> str:
    """Return all that is known as text; tables may be wider than 100 columns.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    parts = [
        [f"VERDICT: {d.verdict}", *wrapped(system_words(d))],
        _effects(d),
        _parameters(d),
        _errors(d),
        _where(d),
        _candidates(d),
        _untried(d),
        [line for remark in d.remarks for line in wrapped(remark)],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _effects(d: SystemDiagnosis) -> list[str]:
    if not d.missing:
        return []
    rows = [("effect", "where it acts", "number", "value")]
    for item in d.missing:
        first = ("a term without a name" if item.unnamed else plain_name(item.effect), item.label)
        numbers = [(n.name, number_words(n)) for n in item.numbers] or [("", "")]
        rows += [(*(first if i == 0 else ("", "")), *pair) for i, pair in enumerate(numbers)]
    lines = ["What is missing", aligned(rows, _LEFT, "  ")]
    for item in d.missing:
        lines += wrapped(f"{item.label}: {item.equation}. {item.says}", "  ")
        if item.confirm:
            lines += wrapped(f"  It would be confirmed by {item.confirm}.", "  ")
    return lines


def _parameters(d: SystemDiagnosis) -> list[str]:
    if not d.parameters and not d.offsets:
        return []
    rows = [("parameter", "before", "after", "unit", "")]
    for row in d.parameters:
        note = "at its bound" if row.at_bound else ""
        before, after = (
            bracketed(row.before, row.before_stderr),
            bracketed(row.after, row.after_stderr),
        )
        rows.append((row.name, before, after, row.unit, note))
    lines = (
        ["Parameters; errors in the last digits", aligned(rows, _LEFT, "  ")]
        if d.parameters
        else []
    )
    if d.offsets:
        listed = ", ".join(f"{o.name} {bracketed(o.value, o.stderr)} samples" for o in d.offsets)
        lines += wrapped(
            f"Inputs between samples: {d.after.structure.between}; timing offsets: {listed}."
        )
    return lines


def _errors(d: SystemDiagnosis) -> list[str]:
    rows = [("record", "output", "before", "after", "smaller", "")]
    for run in (*d.training, *d.checks):
        for j, output in enumerate(run.outputs):
            before, after = float(run.before_rms[j]), float(run.after_rms[j])
            scale = scale_of(d.model.outputs[output], (before, after))
            ratio = f"{significant(before / after, 3)}×" if after > 0.0 else "n/a"
            rows.append(
                (
                    run.experiment.name,
                    output,
                    scale.text(before, 4),
                    scale.text(after, 4),
                    ratio if math.isfinite(before) else "n/a",
                    "check" if run.held_out else "fitted",
                )
            )
    return ["rms errors of simulations", aligned(rows, _LEFT, "  ")]


def _where(d: SystemDiagnosis) -> list[str]:
    run = telling_run(d)
    if not np.all(np.isfinite(run.before)):
        return []
    lines = [f"Where the model and the measurement part, on {run.experiment.name}"]
    for output in run.outputs:
        where = where_of(run, d.missing, output=output, model=d.model)
        for words in describe(where, two=bool(d.missing)):
            lines += wrapped(f"  {words}", "    ")
    return lines


def _candidates(d: SystemDiagnosis) -> list[str]:
    heads = ("round", "candidate", "promised", "score", "fitted", "held out", "z", "fate")
    rows: list[tuple[str, ...]] = [heads]
    more = 0
    for number, step in enumerate(d.rounds, start=1):
        for c in step.candidates[:ROWS_PRINTED]:
            e = c.evidence
            gains = [math.nan] * 4 if e is None else [e.score, e.train, e.later, e.z]
            cells = (str(number), c.placed.label(d.model), _gain(c.probe.gain))
            rows.append((*cells, *map(_gain, gains), fate_of(d, step, c)))
        more += max(len(step.candidates) - ROWS_PRINTED, 0)
    if len(rows) == 1:
        return []
    lines = ["Who was tried", aligned(rows, _LEFT, "  ")]
    if more:
        lines.append(f"and {more} more (--json holds all)")
    lines += wrapped(
        "Promised: what a first-order test of the errors foretells; score, fitted, held out: gains "
        "in log-units of the fitted candidate; z of the held-out gain."
    )
    return lines


def _untried(d: SystemDiagnosis) -> list[str]:
    if not d.unavailable:
        return []
    listed = [
        line
        for name, why in d.unavailable.items()
        for line in wrapped(f"  {plain_name(name)}: {why}", "    ")
    ]
    return ["What these records cannot show", *listed]


def _gain(gain: float) -> str:
    return log_units(gain, "–")
