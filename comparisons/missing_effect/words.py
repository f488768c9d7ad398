"""What a diagnosis says: the verdict in one paragraph, and what stands beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from comparisons.missing_effect.quantities import (
    PORT_WORDS,
    number_rows,
    plain_name,
    scale_of,
    size_words,
)
from comparisons.missing_effect.results import (
    CORRELATION,
    LEAST_SIZE,
    MUCH_CORRELATED,
    SIZE,
    Diagnosis,
    MissingEffect,
)
from comparisons.missing_effect.runs import CheckRun, rms
from comparisons.missing_effect.where_rows import SYMBOLS
from surge_core.rounding import significant

_LEADS = {
    "nothing_missing": "Nothing is missing that these records show.",
    "unexplained_structure": "Something is left in the errors, and nothing tried here is shown to "
    "explain it.",
    "noise_model_wrong": "No effect is missing that these records show, but their noise is not "
    "white and normal.",
}
_SEPARATE = "--separate says which further measurement would, from simulation."
_LIMIT = (
    "That has a limit: an effect that is small enough goes unseen, and --limits, which plants each "
    "into these records, says how small."
)
_STIFF = (
    "The base terms are too stiff for these records: a higher --degree, or --base sindy, takes the "
    "bend into the characteristic itself."
)
_LEFT_BESIDE = (
    "Something else is left in the errors, and nothing tried here is shown to explain it."
)
_FURTHER = (
    "Look at where it stands out; a further channel (T25_K, Nc_frac, in_stall), another base "
    "(--degree, --base sindy) or a longer record may give it a name."
)
_NO_LAG = "These records do not hold τ, so that they cannot show what the lag model lacks."
_NOT_SIMULATED = "These records do not let say what is missing."
_LACKS = {
    "provisional": "lacks something, provisionally named",
    "unnamed_term": "lacks something that no effect of the catalogue stands for,",
}
# On which rows an error was taken, by the kind of a run.
_ON = {
    "check": "on the check records, of which nothing was fitted,",
    "left out": "on cycles left out",
    "held out": "on rows held out",
    "fitted": "on the fitted records",
}
# Where an effect of a user's model acts, the most telling first.
_PLACES = {
    "equation": " in the equation of {}",
    "input": " at the input {}",
    "sensor": " at the sensor of {}",
    "parameter": " in the parameter {}",
    "state": " of the state {}",
    "channels": " in the recording of {}",
}
# Alias labels beyond these are given in the table and in the JSON.
MOST_ALIASES = 4
# An error that falls by a smaller share is said to stay.
LEAST_FALL = 1e-3


def verdict_words(d: Diagnosis) -> str:
    """Say the verdict in one paragraph."""
    if d.missing:
        several = any(len(item.alias_set) > 1 for item in d.missing)
        said = [
            _worse_words(d),
            verdict_sentence(d),
            *beside_words(d),
            _SEPARATE if d.of_series and several else "",
            _STIFF if "characteristic_shape" in d.names else "",
            _bound_words(d),
            *map(_sentence, d.remarks),
        ]
    else:
        known = np.isfinite(d.gap.before_rms)
        said = [
            verdict_sentence(d) if known else _NOT_SIMULATED,
            _refused_words(d),
            _left_words(d),
            d.noise_said if d.verdict == "noise_model_wrong" else "",
            d.structure_said,
            _bound_words(d),
            *map(_sentence, d.remarks),
        ]
        if d.of_series:
            said.append(_FURTHER if d.verdict == "unexplained_structure" else _LIMIT)
    return " ".join(filter(None, said))


def verdict_sentence(d: Diagnosis) -> str:
    """Say the verdict in one sentence: what is missing and what it does, or that nothing is."""
    if not d.missing:
        lost = d.verdict == "nothing_missing" and not d.lag_known
        return _NO_LAG if lost else _LEADS[d.verdict]
    each = []
    for item in d.missing:
        # A number whose error is not known is no answer; the table has it.
        known = all(np.isfinite(p.stderr) for p in item.parameters[:1])
        numbers = number_rows(item.effect, item.parameters)[:1] if known else ()
        first = "".join(f" ({n} = {text})" if n else f" ({text})" for n, text in numbers)
        plain = "port" in item.place and not item.unnamed and d.verdict not in _LACKS
        each.append(f"{'the ' * plain}{_named(item)}{first}{_together(item)}")
    lacks = _LACKS.get(d.verdict, "lacks")
    if all(np.all(run.worse) for run in d.proof):
        lacks = "asks on the rows fitted, and on no others, for"
    lead = f"{d.subject} {lacks} {_listed(each)}"
    if d.acts_unscored:
        return f"{lead}."
    it, (_, tau) = "them" if len(each) > 1 else "it", d.tau_said
    return f"{lead}: with {it} {_fall_words(d)}{f', and {tau}' if tau else ''}."


def beside_words(d: Diagnosis) -> tuple[str, ...]:
    """Say what else a name may stand for, why one is provisional, and whether something is left."""
    left = bool(d.missing) and d.verdict == "unexplained_structure"
    return (
        *filter(None, (_alias_words(d, item) for item in d.missing)),
        *filter(None, (_doubt_words(d), _LEFT_BESIDE if left else "")),
    )


def effect_words(item: MissingEffect) -> tuple[str, ...]:
    """Say what happens, what a lag suffers without it, and what would confirm each name."""
    on_tau = f"What leaving it out does to τ: {item.on_tau}." if item.on_tau else ""
    says = f"{plain_name(item.label)}: {_sentence(item.says)}" if item.says else ""
    confirm = {plain_name(name): words for name, words in item.confirm.items() if words}
    said = [" ".join(filter(None, (says, on_tau)))]
    if len(item.confirm) == 1:
        said += [f"To confirm: {words}." for words in confirm.values()]
    else:
        said += [f"To confirm {name}: {words}." for name, words in confirm.items()]
    return tuple(filter(None, said))


def ledger_words(d: Diagnosis) -> tuple[str, ...]:
    """Say what would have been seen, what is not decided, and what could not be tried."""
    absent = ", ".join(f"{plain_name(a.effect)} ({size_words(a.size, a.unit)})" for a in d.absent)
    lead = "These effects are absent; each would have been seen from the size in brackets on"
    out = [f"{lead}: {absent}."] if absent else []
    alike: dict[tuple[str, str], list[str]] = {}
    for u in d.untold:
        alike.setdefault((u.why, u.what_would_tell), []).append(plain_name(u.effect))
    out += [
        f"These records cannot decide about {_listed(names)}: {why}. What would decide: {tells}."
        for (why, tells), names in alike.items()
    ]
    out += d.ledger_said
    reasons: dict[str, list[str]] = {}
    for name, why in d.unavailable.items():
        reasons.setdefault(why, []).append(plain_name(name))
    out += [f"The rows fitted cannot show {_listed(n)}: {why}." for why, n in reasons.items()]
    return tuple(out)


def _named(item: MissingEffect) -> str:
    """Return what is missing and where, as part of a sentence."""
    place = item.place
    own = "port" in place or item.label.startswith(item.effect)
    called = item.effect if own else re.split(r"[( ]", item.label)[0]
    name = "a term without a name" if item.unnamed else plain_name(called)
    if "port" in place:
        term = item.label.removesuffix(f" {PORT_WORDS[place['port']]}").removeprefix("open_")
        return f"{name}{f', {term},' * item.unnamed} {PORT_WORDS[place['port']]}"
    where = next((words.format(place[key]) for key, words in _PLACES.items() if key in place), "")
    acts = "·".join(place[key] for key in ("signal", "times") if key in place)
    # With its powers: a term without a name is q³, or q²·v.
    powers = re.search(r"\((.+)\)", item.label) if item.unnamed else None
    acts = powers[1] if powers else acts
    # An input or a state that acts on itself needs no second name.
    on = f", acting on {acts}" if acts and "equation" in place else ""
    into = f", spilling into {place['into']}" if "into" in place else ""
    return f"{name}{where}{on}{into}"


def _pooled_rms(runs: Sequence[CheckRun], j: int, *, before: bool) -> float:
    """Return the rms error of one output over all rows of several runs."""
    return float(rms(np.concatenate([run.errors(before=before)[:, [j]] for run in runs]))[0])


def _together(item: MissingEffect) -> str:
    """Say what is known of an effect whose numbers are not known one by one."""
    rho = item.evidence.get(CORRELATION, 0.0)
    if abs(rho) > MUCH_CORRELATED:
        return f", its numbers going together (correlation {rho:.2f})"
    free = [p for p in item.parameters if p.stderr > 0.0]
    size = item.evidence.get(SIZE, 0.0)
    sure = all(abs(p.value) >= LEAST_SIZE * p.stderr for p in free)
    if len(free) < 2 or size < LEAST_SIZE or sure:
        return ""
    return f", its numbers {size:.0f} standard errors large together and uncertain one by one"


def _fall_words(d: Diagnosis) -> str:
    """Say how the error falls on rows that were not fitted, or on the fitted ones."""
    runs, listed = d.proof, []
    for j, (name, unit) in enumerate(d.outputs.items()):
        before, after = (_pooled_rms(runs, j, before=which) for which in (True, False))
        if not (np.isfinite(before) and np.isfinite(after)):
            return f"the simulation of {name} fails on these records"
        scale = scale_of(unit, (before, after))
        of = SYMBOLS.get(name, name)
        if abs(after - before) < LEAST_FALL * before:
            listed.append(f"stays at {scale.text(after)} in {of}")
            continue
        times = f"{significant(before / after, 3)} times smaller" if after else "no error left"
        larger = f"{100.0 * (after / before - 1.0):.0f} % larger"
        verb = "" if listed and listed[-1].endswith(")") else "goes "
        fell = f"{verb}from {scale.text(before)} to {scale.text(after)} in {of}"
        listed.append(f"{fell} ({times if after < before else larger})")
    share = ""
    if d.gap.shrink > 0.0:
        closed = f"{100.0 * d.gap.shrink:.1f} %" if d.gap.shrink < 0.9995 else "all"
        noise = [
            scale_of(unit, [size]).text(size)
            for unit, size in zip(d.outputs.values(), d.floor, strict=False)
        ]
        floor = "the noise" if d.of_series else "what is new in each sample"
        share = f", which closes {closed} of the gap to {floor} ({', '.join(noise)})"
    return f"the rms error {_ON[runs[0].kind]} {', '.join(listed)}{share}"


def _alias_words(d: Diagnosis, item: MissingEffect) -> str:
    others = [plain_name(label) for label in item.alias_labels if label != item.label]
    if not others:
        return ""
    more = len(others) - MOST_ALIASES
    listed = ", ".join(others[:MOST_ALIASES]) + (f" and {more} more" if more > 0 else "")
    words = f"These records cannot separate {plain_name(item.label)} from {listed}"
    return f"{words}{d.alias_said(item)}."


def _doubt_words(d: Diagnosis) -> str:
    why: dict[tuple[str, ...], list[str]] = {}
    for item in d.missing:
        if item.provisional:
            why.setdefault(item.doubts, []).append(plain_name(item.label))
    return " ".join(
        f"{_listed(labels)} {'are' if len(labels) > 1 else 'is'} provisional: {'; '.join(doubts)}."
        for doubts, labels in why.items()
    )


def _worse_words(d: Diagnosis) -> str:
    """Say which check records are simulated worse with what was added; empty where none is."""
    worse = []
    for run in d.runs:
        for j in np.flatnonzero(run.worse) if run.kind == "check" else ():
            name, unit = list(run.outputs.items())[j]
            sizes = (float(run.before_rms[j]), float(run.after_rms[j]))
            fell = " to ".join(map(scale_of(unit, sizes).text, sizes))
            worse.append(f"{name} of {run.name} from {fell}")
    if not worse:
        return ""
    return f"What was added makes the error on check records larger: {', '.join(worse)}."


def _bound_words(d: Diagnosis) -> str:
    names = [row.name for row in d.parameters if row.at_bound]
    if not names:
        return ""
    said = "sits at its bound: widen it" if len(names) == 1 else "sit at their bounds: widen them"
    return f"{', '.join(names)} {said} or doubt the fit."


def _refused_words(d: Diagnosis) -> str:
    last = max((row.round for row in d.candidates), default=0)
    rows = [row for row in d.candidates if row.round == last or not row.fitted]
    best = next((row for row in rows if row.fate == "refused"), None)
    n = len({row.label for row in rows if row.kind == "name"})
    if best is None or any(row.fate == "too little" for row in d.candidates):
        return f"None of {n} effects tried was worth adding." if n else ""
    return f"None of {n} effects tried was accepted; the best was {plain_name(best.label)}."


def _left_words(d: Diagnosis) -> str:
    """Say what error is left where nothing was added, beside the noise."""
    runs, listed = d.proof, []
    for j, (name, unit) in enumerate(d.outputs.items()):
        left = _pooled_rms(runs, j, before=True)
        if not np.isfinite(left):
            return f"The simulation of {name} fails on these records."
        scale, of = scale_of(unit, (left,)), SYMBOLS.get(name, name)
        # Of a model of one's own the floor is that of the fitted records.
        floor = " for a noise of {}" if d.of_series else " ({} is new in each fitted sample)"
        noise = floor.format(scale.text(d.floor[j])) if j < len(d.floor) else ""
        listed.append(f"{scale.text(left)} in {of}{noise}")
    tau = f" τ = {d.tau_said[0]}." if d.tau_said[0] and d.lag_known else ""
    return f"The rms error {_ON[runs[0].kind]} is {'; '.join(listed)}.{tau}"


def _sentence(words: str) -> str:
    # ψ has no capital in this field, nor has the name of an effect.
    first = words.partition(" ")[0]
    words = words[:1].upper() + words[1:] if first.isalpha() and first.isascii() else words
    return words if not words or words.endswith(".") else f"{words}."


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
