"""Pages of the general catalogue: what a name stands for, a system that has it, its mimics."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np
from blocks import bounds_of, table
from system_truths_of_pages import CASES, NOISE, Found, found

from comparisons.missing_effect import SYSTEM_CATALOGUE, SystemEffect
from comparisons.missing_effect.systems.catalogue import find_system_effect
from comparisons.missing_effect.systems.search import Candidate
from comparisons.missing_effect.systems.shapes import Kind

__all__ = [
    "NAMES",
    "SEEDS",
    "index_block",
    "measured_blocks",
    "picture_seed",
    "picture_words",
    "plain_blocks",
    "worst_output",
]

NAMES = tuple(dict.fromkeys(effect.name for effect in SYSTEM_CATALOGUE))
SEEDS = (200, 201, 202, 203, 204)
RIVALS_SHOWN = 4
NEAR_NOISE = 2.0
PLACES = {
    Kind.TERM: "an equation that is not exact",
    Kind.HYSTERESIS: "an equation that is not exact",
    Kind.INPUT_MAP: "an input",
    Kind.INPUT_DELAY: "an input",
    Kind.INPUT_LAG: "an input",
    Kind.INPUT_PLAY: "an input",
    Kind.STATE_LIMIT: "a state, where it acts on the others",
    Kind.OUTPUT_MAP: "a sensor",
    Kind.OUTPUT_LAG: "a sensor",
    Kind.OVERFLOW: "a state that is a level, lost or into another of its unit",
    Kind.RECORDING: "all channels alike",
    Kind.DRIFT: "a parameter",
}
SYSTEMS = {
    "thermal": "heater",
    "tanks": "two tanks",
    "pipe": "pipe",
    "circuit": "circuit",
    "body": "body on a spring",
}
# What the bounds of a number are in units of, by kind and slot; the scales of `Placed`.
RMS = "the rms of its signal"
EQUATION = "the rms of the derivative"
SCALES: dict[Kind, tuple[str, ...]] = {
    Kind.TERM: (EQUATION, RMS, "1"),
    Kind.HYSTERESIS: (EQUATION, "rms × a time of the signal"),
    Kind.INPUT_MAP: (RMS,),
    Kind.INPUT_PLAY: (RMS,),
    Kind.INPUT_DELAY: ("samples",),
    Kind.INPUT_LAG: ("samples",),
    Kind.STATE_LIMIT: (RMS,),
    Kind.OUTPUT_MAP: (RMS,),
    Kind.OUTPUT_LAG: ("samples",),
    Kind.OVERFLOW: (RMS, "1"),
    Kind.RECORDING: ("samples", "samples²"),
    Kind.DRIFT: ("the start of the parameter, over half the records' span",),
}


def plain_blocks(name: str) -> dict[str, str]:
    """Return the blocks that the code gives: forms, numbers, what would confirm each.

    Parameters
    ----------
    name : str
        Of the effect.
    """
    forms = find_system_effect(name)
    rows = [(_equation(form), PLACES[form.kind], form.says) for form in forms]
    numbers = [
        (
            f"`{n.name}`",
            _equation(form) + f" ({PLACES[form.kind].partition(',')[0]})" * (len(forms) > 1),
            bounds_of(n.low, n.high),
            SCALES[form.kind][slot],
        )
        for form in forms
        for slot, n in enumerate(form.numbers)
    ]
    listed = table(("number", "of", "bounds", "in units of"), numbers) if numbers else ""
    simple = dict.fromkeys(other for form in forms for other in form.simple_form_of)
    plain = ", ".join(f"[`{other}`]({other}.md)" for other in simple)
    return {
        "forms": table(("it adds", "it may sit at", "what happens"), rows),
        "numbers": listed or "It has no numbers.",
        "confirm": "\n".join(f"- {words[0].upper()}{words[1:]}." for words in _confirm(forms))
        + (f"\n\nIt is the plain form of {plain}." if plain else ""),
    }


def _equation(form: SystemEffect) -> str:
    return form.equation.format(s="s", o="o", p="p")


def _confirm(forms: Sequence[SystemEffect]) -> list[str]:
    return list(dict.fromkeys(form.confirm for form in forms))


def measured_blocks(name: str, seeds: Sequence[int] = SEEDS) -> dict[str, str]:
    """Return the blocks with numbers: what was found in the picture's record, and in all.

    Parameters
    ----------
    name : str
        Of the effect.
    seeds : sequence of int
        Of the records; the first is the picture's.
    """
    tests = [found(name, seed) for seed in seeds]
    return {
        "picture": picture_words(name, found(name, picture_seed(name, seeds))),
        "mimics": _mimics(name, tests),
    }


def picture_seed(name: str, seeds: Sequence[int] = SEEDS) -> int:
    """Return the first record on which the effect is named and the error falls near the noise.

    Parameters
    ----------
    name : str
        Of the effect.
    seeds : sequence of int
        Of the records; the first of all where there is none.
    """
    good = (s for s in seeds if _named(name, found(name, s)) and _mended(found(name, s)))
    return next(good, seeds[0])


def _named(name: str, one: Found) -> bool:
    return any(name in item.alias_set for item in one.diagnosis.missing)


def _mended(one: Found) -> bool:
    return _over_noise(one)[1] <= NEAR_NOISE


def _over_noise(one: Found) -> tuple[float, float]:
    """Return the check error of the worst output without and with what was found, in noise."""
    run = one.diagnosis.checks[0]
    shown = worst_output(one)
    noise = NOISE * float(np.std(run.measured[:, shown]))
    return float(run.before_rms[shown] / noise), float(run.after_rms[shown] / noise)


def picture_words(name: str, one: Found) -> str:
    """Say what was hidden in a record, what was found, and how the check error fell.

    Parameters
    ----------
    name : str
        Of the effect.
    one : Found
        The record.
    """
    d = one.diagnosis
    before, after = _over_noise(one)
    output = d.checks[0].outputs[worst_output(one)]
    numbers = [
        f"`{item.label}`"
        + (f" ({', '.join(f'{n.name} = {n.value:.3g} {n.unit}' for n in item.numbers)})")
        * bool(item.numbers)
        for item in d.missing
    ]
    said = ", then ".join(numbers) if numbers else "nothing"
    return (
        f"Hidden in the {SYSTEMS[CASES[name].system]}: {CASES[name].told}. Found: {said}; verdict "
        f"`{d.verdict}`. On the check record the error of `{output}` falls from "
        f"{before:.1f} to {after:.1f} times the noise."
    )


def worst_output(one: Found) -> int:
    """Return the output in which the model without the effect errs most, over its spread.

    Parameters
    ----------
    one : Found
        A record with its diagnosis.
    """
    run = one.diagnosis.checks[0]
    return int(np.argmax(run.before_rms / np.std(run.measured, axis=0)))


def _mimics(name: str, tests: Sequence[Found]) -> str:
    sets = [[set(item.alias_set) for item in one.diagnosis.missing] for one in tests]
    inside = sum(any(name in s for s in own) for own in sets)
    alone = sum(any(s == {name} for s in own) for own in sets)
    further = [{min(s) for s in own if name not in s} for own in sets]
    head = (
        f"Of {len(tests)} records it was in the set named on {inside}, alone in it on {alone}; "
        f"the check error fell to {NEAR_NOISE:g} times the noise or less on "
        f"{sum(map(_mended, tests))}, and a further name came on {sum(map(bool, further))}."
    )
    gains: dict[str, list[float]] = {}
    for one in tests:
        for rival, share in _rivals(name, one).items():
            gains.setdefault(rival, []).append(share)
    partner = {n for own in sets for s in own if name in s for n in s} - {name}
    order = sorted(gains, key=lambda n: (n not in partner, -len(gains[n]) * median(gains[n])))
    rows = [
        (
            f"[`{rival}`]({rival}.md)",
            f"{100.0 * median(gains[rival]):.0f} %",
            f"{len(gains[rival])} of {len(tests)}",
            f"{sum(any({rival, name} <= s for s in own) for own in sets)} of {len(tests)}",
        )
        for rival in order[:RIVALS_SHOWN]
    ]
    if not rows:
        return f"{head} No other effect was worth a fit."
    heads = ("rival in its place", "gain, of the truth's", "worth a fit in", "in the set in")
    return f"{head}\n\n{table(heads, rows)}"


def _rivals(name: str, one: Found) -> dict[str, float]:
    """Return what each other name gained in the first round, over what the truth gained."""
    best: dict[str, float] = {}
    for candidate in one.diagnosis.rounds[0].candidates:
        if candidate.evidence is not None and not candidate.placed.effect.unnamed:
            own = candidate.placed.name
            best[own] = max(best.get(own, 0.0), _gain(candidate))
    truth = best.pop(name, 0.0)
    return {rival: gain / truth for rival, gain in best.items()} if truth > 0.0 else {}


def _gain(candidate: Candidate) -> float:
    assert candidate.evidence is not None
    return float(candidate.evidence.train)


def index_block() -> str:
    """Return the table of the catalogue: name, what it adds, where it may sit."""
    rows = [
        (f"[`{name}`]({name}.md)", form.equation.format(s="s", o="o", p="p"), PLACES[form.kind])
        for name in NAMES
        for form in find_system_effect(name)
    ]
    return table(("effect", "it adds", "it may sit at"), rows)
