"""What the diagnosis of a user's model says, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.scales import scale_of
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.results import (
        CheckRun,
        FittedNumber,
        FoundEffect,
        SystemDiagnosis,
    )

__all__ = ["doubt_words", "number_words", "plain_name", "system_words", "worse_words"]

_LEADS = {
    "nothing_missing": "Nothing is missing that these records show: no effect tried explains more "
    "of the errors than chance does.",
    "unexplained_structure": "These records do not let say what is missing; the remarks tell why.",
}
# From this correlation on two numbers of an effect say little one by one.
MUCH_CORRELATED = 0.9
# Alias labels beyond these are given in the table and in the JSON.
MOST_ALIASES = 4


def system_words(d: SystemDiagnosis) -> str:
    """Say the verdict in two to five sentences.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    if not d.missing:
        said = [_LEADS.get(d.verdict, "No effect was added.")]
        if d.verdict == "nothing_missing":
            said.append(_left_words(d))
        return " ".join(filter(None, said))
    said = [worse_words(d), _missing_words(d), _fall_words(d), _alias_words(d)]
    return " ".join(filter(None, [*said, *doubt_words(d), _bound_words(d)]))


def plain_name(name: str) -> str:
    """Return the name of an effect as it is read: without underscores."""
    return name.replace("_", " ")


def number_words(number: FittedNumber) -> str:
    """Return a number of an effect, rounded to its error, with its unit."""
    text = round_to_error(number.value, number.stderr)
    if number.stderr <= 0.0:
        text = f"{significant(number.value)} (held)"
    if number.unit == "1":
        return text
    return f"({text}) {number.unit}" if "±" in text and "e" not in text else f"{text} {number.unit}"


def _missing_words(d: SystemDiagnosis) -> str:
    noted = [_effect_words(item) for item in d.missing]
    listed = noted[0] if len(noted) == 1 else "; ".join(noted[:-1]) + f"; and {noted[-1]}"
    return f"The model '{d.model.name}' lacks {listed}."


def _effect_words(item: FoundEffect) -> str:
    name = "a term without a name" if item.unnamed else plain_name(item.effect)
    place = _place_words(item)
    first = f", {item.numbers[0].name} {number_words(item.numbers[0])}" if item.numbers else ""
    rho = item.evidence.get("largest_correlation", 0.0)
    together = f" (numbers that go together, correlation {rho:.2f})"
    return f"{name}{place}{first}{together if abs(rho) > MUCH_CORRELATED else ''}"


def _place_words(item: FoundEffect) -> str:
    place = item.place
    where = next(
        (
            words.format(place[key])
            for key, words in (
                ("equation", " in the equation of {}"),
                ("input", " at the input {}"),
                ("sensor", " at the sensor of {}"),
                ("parameter", " in the parameter {}"),
                ("state", " of the state {}"),
                ("channels", " in the recording of {}"),
            )
            if key in place
        ),
        "",
    )
    acts = "·".join(place[key] for key in ("signal", "times") if key in place)
    # An input or a state that acts on itself needs no second name.
    on = f", acting on {acts}" if acts and "equation" in place else ""
    into = f", spilling into {place['into']}" if "into" in place else ""
    return f"{where}{on}{into}"


def _fall_words(d: SystemDiagnosis) -> str:
    """Say how the error falls on records that were not fitted, or on the fitted ones."""
    runs = d.checks or d.training
    noted = []
    for j, output in enumerate(d.model.outputs):
        before, after = (_pooled(runs, j, before=which) for which in (True, False))
        if not (np.isfinite(before) and np.isfinite(after)):
            return f"The simulation of {output} failed on these records."
        scale = scale_of(d.model.outputs[output], (before, after))
        noted.append(
            f"{output} from {scale.text(before)} to {scale.text(after)} ({_times(before, after)})"
        )
    kind = "the check records, of which nothing was fitted," if d.checks else "the fitted records"
    return f"With it the rms error on {kind} goes: {'; '.join(noted)}."


def _pooled(runs: tuple[CheckRun, ...], j: int, *, before: bool) -> float:
    errors = [(r.measured - (r.before if before else r.after))[r.settle :, j] for r in runs]
    joined = np.concatenate(errors)
    kept = joined[np.isfinite(joined)]
    return float(np.sqrt(np.mean(kept**2))) if kept.size else np.nan


def _times(before: float, after: float) -> str:
    if after <= 0.0 or before <= 0.0:
        return "no error left" if after <= 0.0 else "more"
    ratio = before / after
    return f"{significant(ratio, 3)} times smaller" if ratio >= 1.0 else "not smaller"


def _alias_words(d: SystemDiagnosis) -> str:
    noted = []
    for item in d.missing:
        others = [label for label in item.alias_labels if label != item.label]
        if not others:
            continue
        shown = ", ".join(others[:MOST_ALIASES])
        more = len(others) - MOST_ALIASES
        noted.append(
            f"these records cannot tell {item.label} from {shown}"
            + (f" and {more} more" if more > 0 else "")
        )
    if not noted:
        return ""
    text = "; ".join(noted)
    confirm = next(item.confirm for item in d.missing if len(item.alias_labels) > 1)
    what = f"; what would: {confirm}" if confirm else ""
    return f"{text[0].upper()}{text[1:]}{what}."


def doubt_words(d: SystemDiagnosis) -> tuple[str, ...]:
    """Say of each provisional name why it is not firm."""
    return tuple(
        f"{item.label} is provisional: {'; '.join(item.doubts) or 'it may be another effect'}."
        for item in d.missing
        if item.provisional
    )


def worse_words(d: SystemDiagnosis) -> str:
    """Say which check records are simulated worse with what was added; empty where none is."""
    worse = []
    for run in d.checks if d.missing else ():
        for j in np.flatnonzero(run.worse):
            output, sizes = run.outputs[j], (float(run.before_rms[j]), float(run.after_rms[j]))
            scale = scale_of(d.model.outputs[output], sizes)
            fell = " to ".join(map(scale.text, sizes))
            worse.append(f"{output} of {run.experiment.name} from {fell}")
    if not worse:
        return ""
    return f"What was added makes the error on check records larger: {', '.join(worse)}."


def _bound_words(d: SystemDiagnosis) -> str:
    names = [row.name for row in d.parameters if row.at_bound]
    if not names:
        return ""
    verb = "sits at its bound" if len(names) == 1 else "sit at their bounds"
    return f"{', '.join(names)} {verb}: widen them or doubt the fit."


def _left_words(d: SystemDiagnosis) -> str:
    runs = d.checks or d.training
    noted, new = [], []
    for j, (output, unit) in enumerate(d.model.outputs.items()):
        left = _pooled(runs, j, before=True)
        scale = scale_of(unit, (left,))
        noted.append(f"{scale.text(left)} in {output}")
        new += [scale.text(v) for v in d.floor[j : j + 1]]
    kind = "check" if d.checks else "fitted"
    noise = f"; what is new in each sample is {', '.join(new)}" if new else ""
    return f"The rms error on the {kind} records is {', '.join(noted)}{noise}."
