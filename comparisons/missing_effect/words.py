"""What a diagnosis says, in words: the verdict in one paragraph, whatever it is."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from comparisons.missing_effect.quantities import (
    chance,
    equation_of,
    letters_of,
    numbers_of,
    open_words,
    tau_ms,
)
from comparisons.missing_effect.ranked import CandidateRow, candidate_rows, effect_of, not_fitted
from comparisons.missing_effect.results import CORRELATION, MUCH_CORRELATED, SIZE
from comparisons.missing_effect.shown import tau_before_stderr_s
from comparisons.missing_effect.uncertainty import LEAST_SIZE
from surge_core.rounding import significant

if TYPE_CHECKING:
    from comparisons.missing_effect.diagnosis import Diagnosis, MissingEffect
    from comparisons.missing_effect.effect import Effect

__all__ = [
    "doubts_of",
    "label_of",
    "noise_words",
    "opening_words",
    "untold_words",
    "untried_words",
    "verdict_sentence",
    "verdict_words",
]

_LEADS = {
    "nothing_missing": "Nothing is missing that these records show.",
    "unexplained_structure": "Something is left in the errors that nothing tried here explains.",
    "noise_model_wrong": "No effect is missing that these records show, but their noise is not "
    "white and normal.",
}
_DELAYS = "both move the phase alike, and part only in the second order of their time"
_DRIFTS = "both are slow drifts, and only a reading of temperature, speed or zero parts them"
_BRANCHES = "both change the characteristic where φ hardly ever is"
_ALIAS_REASONS = {
    frozenset(("transport_delay", "second_order_lag")): _DELAYS,
    frozenset(("sensitivity_drift", "facility_heating")): _DRIFTS,
    frozenset(("bias_drift", "facility_heating")): _DRIFTS,
    frozenset(("bias_drift", "sensitivity_drift")): _DRIFTS,
    frozenset(("speed_droop", "facility_heating")): _DRIFTS,
    frozenset(("speed_droop", "sensitivity_drift")): _DRIFTS,
    frozenset(("speed_droop", "bias_drift")): _DRIFTS,
    frozenset(("reverse_flow_branch", "characteristic_shape")): _BRANCHES,
    frozenset(("reverse_flow_branch", "hysteresis")): _BRANCHES,
    frozenset(("transport_delay", "flow_inertia")): "the slope of the characteristic hardly "
    "changes over the flow that was swept, so that both act on dφ/dt",
    frozenset(("second_order_lag", "flow_inertia")): "the slope of the characteristic hardly "
    "changes over the flow that was swept, so that both act on dφ/dt",
}
_PLACES = {
    "input": "at the input φ",
    "characteristic": "in the characteristic ψ'_QS",
    "lag": "in the lag",
    "output": "at the output ψ'",
    "noise": "on the measured φ",
}
_TAU_MEANING = {
    "amplitude_dependent_lag": "τ is that at the mean amplitude",
    "flow_dependent_lag": "τ is that above the threshold",
    "asymmetric_lag": "τ is the mean of rising and falling flow",
}


# A τ that moves by less is said to stay.
LEAST_CHANGE = 5e-4


def verdict_words(d: Diagnosis, *, limited: bool = False, separated: bool = False) -> str:
    """Say the verdict in one paragraph.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    limited, separated : bool
        Whether limits and separating measurements are reported elsewhere, so that no option that
        would find them is named.
    """
    said = [verdict_sentence(d)]
    if d.missing:
        said += [*(_effect_words(d, item) for item in d.missing), _tau_words(d), _gap_words(d)]
        said += [words for item in d.missing if (words := _alias_words(d, item))]
        said += _doubt_words(d)
        said += _base_words(d)
        said += [f"{_sentence(remark)}." for remark in d.remarks]
        said.append(_confirm_words(d, separated=separated))
    else:
        said += [_refused_words(d), _unchanged_words(d)]
        said += [noise_words(d)] if d.verdict == "noise_model_wrong" else []
        said += [_left_words(d), *(f"{_sentence(remark)}." for remark in d.remarks)]
        said.append(_limit_words(d, limited=limited))
    return " ".join(filter(None, said))


def verdict_sentence(d: Diagnosis) -> str:
    """Say the verdict in one sentence.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    return _LEADS.get(d.verdict) or _headline(d)


def _headline(d: Diagnosis) -> str:
    """Return what is missing and what it does, in one sentence."""
    each = []
    for item in d.missing:
        label = label_of(effect_of(d, item.effect))
        others = " or ".join(item.alias_set[1:])
        each.append(label + (f" (or {others})" if others else ""))
    lead = {
        "provisional": "The lag model lacks something, provisionally named",
        "unnamed_term": "The lag model lacks a term that no effect of the catalogue stands for,",
    }.get(d.verdict, "The lag model lacks")
    before, after = (_floors(d, rms) for rms in (d.gap.before_rms, d.gap.after_rms))
    now = tau_ms(d.tau_after_s, d.tau_stderr_s)
    tau = f"τ goes from {tau_ms(d.tau_before_s, tau_before_stderr_s(d))} to {now}"
    if abs(d.tau_after_s / d.tau_before_s - 1.0) < LEAST_CHANGE:
        tau = f"τ stays at {now}"
    error = (
        f"the held-out error falls from {before} to {after} times the noise "
        f"({_closed(d.gap.shrink)} of the gap)"
    )
    if not d.gap.shrink:
        error = f"the held-out error stays at {after} times the noise"
    it = "them" if len(each) > 1 else "it"
    return f"{lead} {_listed(each)}: with {it} {error}, and {tau}."


def opening_words(d: Diagnosis) -> str:
    """Say what was fitted and what was held out.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    from surge_core.terms import pretty_term

    counts = [
        (int(np.count_nonzero(d.data.scored(part))), words)
        for part, words in (
            (TRAIN, "fitted"),
            (LATER, "held out as later time"),
            (OTHER, "held out as another record"),
        )
    ]
    rows = ", ".join(f"{n} {words}" for n, words in counts if n)
    if d.whole_runs:
        rows = "of one free run through each record; what is held out are cycles left out in turn"
    terms = ", ".join(pretty_term(name) for name in d.before.structure.terms)
    names = ", ".join(PurePath(source).name for source in d.data.sources)
    return f"ψ' of {names}: {sum(n for n, _ in counts)} rows, {rows}; base terms {terms}."


def noise_words(d: Diagnosis) -> str:
    """Say what the noise is like.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    if d.whole_runs:
        times = d.noise.sigma / d.gap.floor_rms
        return (
            f"The noise of the averaged ψ' is {significant(d.gap.floor_rms, 3)} rms; the model "
            f"leaves {times:.1f} times that: noise near zero flow, calibration, and what no effect "
            "here explains."
        )
    size = f"rms {significant(d.noise.sigma, 3)} in ψ'"
    if not d.noise.coloured and not d.noise.heavy_tailed:
        return f"The noise is white and about normal, {size}."
    out = [f"The noise has {size}{', outliers aside' if d.noise.heavy_tailed else ''}."]
    if d.noise.coloured:
        lags = ", ".join(f"{a:.2f}" for a in d.noise.ar)
        out.append(
            f"An error depends on those before it (autoregression {lags}), so that rows count for "
            "less than their number."
        )
    if d.noise.heavy_tailed:
        out.append(
            f"{100.0 * d.noise.heavy_share:.1f} % of the errors lie beyond three standard "
            "deviations, where the normal law has 0.3 %: they were held down."
        )
    out.append(
        "It was taken for what it is here; an estimator that takes noise for white and normal "
        "states wrong errors."
    )
    return " ".join(out)


def untried_words(d: Diagnosis) -> tuple[str, ...]:
    """Say which effects were not fitted or could not be tried, and why.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    out = []
    skipped = not_fitted(d)
    if skipped:
        out.append(
            "Tested and not worth a fit, since a score test promised too little: "
            + ", ".join(skipped)
            + "."
        )
    if d.whole_runs:
        line = f"found at {d.ripple.frequency_hz:.4g} Hz" if d.ripple else "none found"
        out.append(
            "A second pattern of cells was looked for as a line of the rake differences that no "
            f"side line of the first has for a partner: {line}."
        )
    if d.unavailable:
        why = "; ".join(f"{name} {reason}" for name, reason in d.unavailable.items())
        out.append(f"Could not be tried on these records: {why}.")
    return tuple(out)


def untold_words(d: Diagnosis) -> tuple[str, ...]:
    """Say which effects would have been seen, and of which these records cannot tell.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    from comparisons.missing_effect.limit_table import size_words

    absent = ", ".join(f"{a.effect} (from {size_words(a.size, a.unit)} on)" for a in d.absent)
    seen = (f"Not there, and would have been seen: {absent}.",) if absent else ()
    return (
        *seen,
        *(
            f"Not decided by these records: {u.effect}, {u.why}. It needs {u.what_would_tell}."
            for u in d.untold
        ),
    )


def label_of(effect: Effect) -> str:
    """Return the name of an effect with the place at which it acts.

    Parameters
    ----------
    effect : Effect
        The effect.
    """
    name = f"open_{open_words(effect.name)}" if effect.unnamed else effect.name
    return f"{name} {_PLACES[effect.port]}"


def _effect_words(d: Diagnosis, item: MissingEffect) -> str:
    effect = effect_of(d, item.effect)
    numbers = numbers_of(item.effect, item.parameters)
    if effect.unnamed:
        letters = letters_of(effect)
        return (
            f"The open term {equation_of(effect).removeprefix('+ ')} at the port “{effect.port}”, "
            f"{numbers}, explains it better than any name does"
            f"{f' ({letters})' if letters else ''}."
        )
    return (
        f"{effect.name}: {effect.equation}. {_sentence(effect.says)}; "
        f"{numbers}{_together_words(item)}."
    )


def _tau_words(d: Diagnosis) -> str:
    known = [item for item in d.missing if not effect_of(d, item.effect).unnamed]
    meaning = [_TAU_MEANING[i.effect] for i in known if i.effect in _TAU_MEANING]
    words = f"{_sentence(', '.join(meaning))}. " if meaning else ""
    listed = "; ".join(
        (f"{i.effect}: " if len(known) > 1 else "") + effect_of(d, i.effect).on_tau for i in known
    )
    return f"{words}What leaving it out does to τ: {listed}." if listed else words.rstrip()


def _gap_words(d: Diagnosis) -> str:
    gap = d.gap
    ripple = not d.whole_runs and any(effect_of(d, item.effect).episodes for item in d.missing)
    where = "on cycles left out" if d.whole_runs else "on rows held out"
    again = ", the phase of the ripple fitted again in each episode" if ripple else ""
    before, after, noise = (
        significant(rms, 3) for rms in (gap.before_rms, gap.after_rms, gap.floor_rms)
    )
    return (
        f"In ψ' the rms error {where} is {before} before and {after} after{again}, noise {noise}."
    )


def _alias_words(d: Diagnosis, item: MissingEffect) -> str:
    if len(item.alias_set) < 2:
        return ""
    names = _listed(item.alias_set)
    tau = ", ".join(
        f"{name} {tau_ms(d.tau_by_alias_s[name])}"
        for name in item.alias_set
        if name in d.tau_by_alias_s
    )
    known = {
        pair: reason
        for pair in combinations(item.alias_set, 2)
        if (reason := _ALIAS_REASONS.get(frozenset(pair)))
    }
    whose = len(item.alias_set) > 2
    reasons = [f"{_listed(pair)}: {why}" if whose else why for pair, why in known.items()]
    reasons += _distance_words(d, item)
    why = "; ".join(reasons) or "each explains the rows, held-out ones too, as well as the other"
    return f"These records cannot tell {names} apart: {why}. τ under each name: {tau}."


def _distance_words(d: Diagnosis, item: MissingEffect) -> list[str]:
    """Say how near the names of an alias set come, where all were weighed in one round."""
    rows = [row for row in candidate_rows(d) if row.name in item.alias_set]
    rows = [row for row in rows if row.round == min(r.round for r in rows)]
    if len(d.missing) > 1 or len(rows) != len(item.alias_set):
        return []
    if d.whole_runs:
        each = _listed([f"{100.0 * row.share:.0f} %" for row in rows])
        return [f"they explain {each} of the squared errors"]
    scores = [row.score for row in rows]
    apart = f"{max(scores) - min(scores):.1f}"
    return [f"with the held-out rows counted, their scores lie {apart} log-units apart"]


def doubts_of(d: Diagnosis, item: MissingEffect) -> tuple[str, ...]:
    """Return why the name of an effect is not firm; empty where it is.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    item : MissingEffect
        What it found.
    """
    if not item.provisional:
        return ()
    size = item.evidence.get(SIZE, np.inf)
    if item.doubts:
        return item.doubts
    if size < LEAST_SIZE:
        why = (
            f"what it does to ψ' is not distinguished from nothing ({size:.1f} standard errors, "
            "all its numbers together)"
        )
    elif d.whole_runs:
        why = "twins of these records, measured or not, are no measure of it"
    elif d.leftover.structured:
        why = (
            "the model with it still leaves structure in its errors (what else was tested would "
            f"win {d.leftover.gain:.0f} log-units together, p {chance(d.leftover.p_value)})"
        )
    elif d.gap.shrink <= 0.0:
        why = "it makes the error on held-out rows no smaller"
    else:
        why = "a term without a name had to stand beside it"
    return (why,)


def _doubt_words(d: Diagnosis) -> list[str]:
    each = [(item.effect, "; ".join(doubts_of(d, item))) for item in d.missing if item.provisional]
    if not each:
        return []
    why = "; ".join(f"{name}, since {words}" for name, words in each)
    names, them = ("Provisional names are", "each") if len(each) > 1 else ("Provisional is", "it")
    return [f"{names} {why}: {them} may stand for another effect, and the numbers with it."]


def _together_words(item: MissingEffect) -> str:
    """Say what is known of an effect whose numbers are not known one by one."""
    rho = item.evidence.get(CORRELATION, 0.0)
    if abs(rho) > MUCH_CORRELATED:
        return f", numbers that go together (correlation {rho:.2f}): one by one they are uncertain"
    free = [p for p in item.parameters if p.stderr > 0.0]
    size = item.evidence.get(SIZE, 0.0)
    if len(free) < 2 or size < LEAST_SIZE:
        return ""
    if all(abs(p.value) >= LEAST_SIZE * p.stderr for p in free):
        return ""
    return (
        ", which are not reported one by one; what they do together is "
        f"{size:.0f} standard errors large"
    )


def _base_words(d: Diagnosis) -> list[str]:
    if "characteristic_shape" not in d.names:
        return []
    return [
        "The base terms are too stiff for these records: a higher --degree, or --base sindy, takes "
        "the bend into the characteristic itself."
    ]


def _confirm_words(d: Diagnosis, *, separated: bool) -> str:
    named = [item for item in d.missing if not effect_of(d, item.effect).unnamed]
    names = dict.fromkeys(name for item in named for name in item.alias_set)
    if not names:
        return (
            "A name needs a measurement made for it: cycles at other amplitudes and other speeds "
            "of φ tell what the term stands for."
        )
    each = [(name, effect_of(d, name).confirm) for name in names]
    what = "; ".join(f"{name}: {words}" for name, words in each) if len(each) > 1 else each[0][1]
    several = any(len(item.alias_set) > 1 for item in named)
    lead = "To confirm or separate" if several else "To confirm"
    hint = " --separate says which further measurement would, from simulation."
    return f"{lead}: {what}." + (hint if several and not separated else "")


def _refused_words(d: Diagnosis) -> str:
    rows = [row for row in candidate_rows(d) if row.round == len(d.rounds)]
    n_names = len({row.name for row in rows if row.kind == "name"} | set(not_fitted(d)))
    best = next((row for row in rows if row.refused_on), None)
    if best is None:
        return f"None of {n_names} effects was worth adding."
    if d.whole_runs:
        return f"None of {n_names} effects was accepted; the best, {best.name}, {_too_small(best)}."
    rows_of = {
        "fitted rows": "on the fitted rows",
        "later time": "on later time",
        "other record": "on the other record",
        "held-out blocks": "in most held-out blocks",
    }
    on = _listed([rows_of[name] for name in best.refused_on])
    name = open_words(best.name) if best.kind == "unnamed_term" else best.name
    return (
        f"None of {n_names} effects was accepted; the best, {name}, gains no more than chance {on}."
    )


def _too_small(row: CandidateRow) -> str:
    explains = f"explains {100.0 * row.share:.0f} % of the squared errors"
    if np.isinf(row.least_share):
        return f"{explains}, by a number that is small or that twins take, too"
    if "share" in row.refused_on:
        return f"{explains}, where twins of these records give {100.0 * row.least_share:.0f} %"
    return f"{explains}, but not of cycles left out"


def _unchanged_words(d: Diagnosis) -> str:
    tau = tau_ms(d.tau_before_s, d.tau_stderr_s)
    where = "cycles left out" if d.whole_runs else "rows held out"
    return (
        f"τ = {tau}. On {where} the rms error is {_floors(d, d.gap.before_rms)} times the "
        f"noise ({significant(d.gap.before_rms, 3)}, noise {significant(d.gap.floor_rms, 3)})."
    )


def _left_words(d: Diagnosis) -> str:
    left = d.leftover
    if not left.degrees:
        return ""
    tested = f"{left.degrees} columns of effects and open terms together"
    if left.structured:
        return (
            f"Yet {tested} would win {left.gain:.0f} log-units (p {chance(left.p_value)}): this is "
            "not “nothing missing”, it is something without a name."
        )
    return f"What {tested} could still win is chance (p {chance(left.p_value)})."


def _limit_words(d: Diagnosis, *, limited: bool) -> str:
    if d.verdict == "unexplained_structure":
        return (
            "Look at where it stands out; a further channel (T25_K, Nc_frac, in_stall), another "
            "base (--degree, --base sindy) or a longer record may give it a name."
        )
    listed = (
        "the limits below say how small."
        if limited
        else "--limits plants each into these records and says how small."
    )
    return f"That has a limit: an effect that is small enough goes unseen, and {listed}"


def _floors(d: Diagnosis, rms: float) -> str:
    return f"{rms / d.gap.floor_rms:.2f}"


def _closed(share: float) -> str:
    return f"{100.0 * share:.1f} %" if share < 0.9995 else "all"


def _sentence(words: str) -> str:
    # ψ has no capital in this field.
    return words[0].upper() + words[1:] if words[0].isascii() else words


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
