"""What is said beside an answer: of bounds, clocks, starts, and of what stays open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.nulls import COLOURED, Leftover
from comparisons.missing_effect.quantities import plain_name
from comparisons.missing_effect.results import MissingEffect, ParameterRow
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.doubts import FIRM_ERRORS
from comparisons.missing_effect.systems.fit import START_SHARE, Fit
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.structure import HALF_SAMPLE, MOST_OFFSET
from surge_core.rounding import round_to_error, significant

# The rest of an error on a check record that a fit to the record itself takes is said below this.
WORTH_SAYING = 0.8
# An error this many times what is new in each sample is hardly more than that.
BARELY = 1.1


def beyond_words(beyond: Mapping[str, str]) -> list[str]:
    """Say which bounds of parameters are in the way."""
    return [
        f"The records ask for {' and '.join(beyond.values())}: widen the bound, if the quantity "
        "allows it. What is missing cannot be parted from what the bound brings about."
    ] * bool(beyond)


def clock_words(offsets: Sequence[FittedParameter], fit: Fit) -> list[str]:
    """Say of which inputs the clock is off: early by more than a hold explains, or at an end."""
    out, end = [], f"against {', '.join(fit.structure.model.outputs)}: check the clocks."
    for one in offsets:
        at_end = one.value in (-fit.structure.earliest, MOST_OFFSET)
        least = abs(one.value) - FIRM_ERRORS * one.stderr
        if least > HALF_SAMPLE * (not at_end) and (at_end or one.value < 0.0):
            rows = f"{round_to_error(abs(one.value), one.stderr)} rows"
            if at_end:
                rows = f"at least {abs(one.value):g} row{'s' * (abs(one.value) > 1.0)}"
            late = "is recorded late" if one.value < 0.0 else "acts late"
            out.append(f"The input {one.name} {late} by {rows} {end}")
    return out


def unknown_words(parameters: Sequence[ParameterRow]) -> list[str]:
    """Say which parameters the records do not fix."""
    unknown = [row.name for row in parameters if np.isinf(row.after_stderr)]
    return [
        f"These records do not fix {' and '.join(unknown)}: the outputs do not answer to "
        "such a change, or another number makes up for it. The value is where the search stood."
    ] * bool(unknown)


def start_words(least: Sequence[int], runs: Sequence[CheckRun]) -> list[str]:
    """Say of which check records the first rows do not fix the start."""
    return [
        f"The first {rows} rows of {run.name} do not fix its start: it is "
        f"estimated from {run.settle} rows, which are not scored. What is known of the model's own "
        "states may be given as x0=."
        for rows, run in zip(least, runs, strict=True)
        if run.settle > rows or np.any(run.loose > START_SHARE * run.after_rms)
    ]


def refitted_words(runs: Sequence[CheckRun]) -> list[str]:
    """Say what of the error on check records no fit to other records can know."""
    left = [
        f"{name} of {run.name} {100.0 * own / after:.0f} %"
        for run in runs
        for name, after, own in zip(run.outputs, run.after_rms, run.refitted_rms, strict=True)
        if own < WORTH_SAYING * after
    ]
    return [
        "With start and parameters fitted to a check record itself the same model leaves less of "
        f"its error: {', '.join(left)}. The rest is its start, which its first rows do not show "
        "well, what differs between the records, or what the model still lacks: these figures "
        "do not separate the three."
    ] * bool(left)


def open_words(
    model: Model,
    missing: Sequence[MissingEffect],
    left: Leftover,
    gone: Mapping[Placed, str],
    badly: str,
    halved: str,
) -> tuple[str, ...]:
    """Say what stays open: what held-out rows do not decide, what was taken off, what is left."""
    out = []
    if halved:
        out.append(
            f"{halved} takes more than half of the error on the rows fitted, and the rows held out "
            "do not decide on it: give records that move to their end."
        )
    for placed, why in gone.items():
        label = plain_name(placed.label(model))
        out.append(f"{label} is not added: {why}. What is missing may resemble it.")
    if not gone and not halved and (left.structured or left.late or left.disturbed):
        out.append(_left_words(left, bool(missing)))
    elif not missing and not halved and left.ratio > COLOURED:
        out.append(
            f"The error is {significant(left.ratio, 3)} times what is new in each sample. Noise "
            "that goes on from sample to sample does that, and so does a disturbance that was not "
            "measured: these records do not separate the two."
        )
    if badly and not gone:
        out.append(
            f"{badly} goes wrong more than twice as far as the rows fitted, or by more than it "
            "moves, or cannot be simulated, and nothing fitted explains it: what is missing acts "
            "there alone, or a parameter has another value there. Give training records in which "
            "that is so."
        )
    return tuple(out)


def _left_words(left: Leftover, named: bool) -> str:
    """Say that something is missing that nothing here fits: its size, and what it follows."""
    if named and left.ratio < BARELY:
        follows = f": it follows {left.follows} most" if left.follows else ""
        return f"A small part of the error that is left is no chance{follows}."
    lead = "Beyond what was found s" if named else "S"
    if left.structured or left.late:
        facts = []
        if left.structured and left.foretold_share > 0.01:
            share = f"{100.0 * left.foretold_share:.0f} % of the squared held-out error"
            most = f", {left.follows} most" * bool(left.follows)
            facts.append(f"inputs and states foretell {share}{most}")
        if left.late:
            facts.append("what is new in each error follows what the inputs did in earlier rows")
        if left.ratio >= BARELY or not facts:
            size = f"{significant(left.ratio, 3)} times what is new in each sample"
            facts.insert(0, f"the error on the rows fitted for naming is {size}")
        late = " Dynamics that are missing do that: a mode, a further lag, a pipe." * left.late
        return f"{lead}omething is missing that nothing here fits: {', and '.join(facts)}.{late}"
    if left.mute:
        return (
            f"The model explains no more of {left.mute} than a constant does: the inputs have no "
            "visible effect on it in these records."
        )
    return (
        f"{lead}omething is left that goes on from sample to sample: the error is "
        f"{left.ratio:.0f} times what is new in each. A disturbance does that, and so does "
        "something missing that inputs and states do not foretell."
    )
