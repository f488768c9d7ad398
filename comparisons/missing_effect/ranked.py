"""Who was tried: one row for each effect, term or pair that competed, and why it was refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

from comparisons.missing_effect.candidates import Candidate
from comparisons.missing_effect.catalogue import FLOW_NOISE
from comparisons.missing_effect.diagnosis import Diagnosis
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.evidence import LARGEST_P, LEAST_Z, Evidence
from comparisons.missing_effect.search import Round

__all__ = ["CandidateRow", "candidate_rows", "effect_of", "not_fitted"]


@dataclass(frozen=True)
class CandidateRow:
    """One that competed.

    Parameters
    ----------
    round : int
        Round of the search, from 1 on.
    name : str
        Effect, open term, or pair joined by " + ".
    kind : {"name", "pair", "unnamed_term"}
        Which of these.
    accepted : bool
        Whether likelihood, later time and the other record all speak for it.
    chosen : bool
        Whether it was added.
    alias : bool
        Whether it could stand for what was added in its round, or was added and has such.
    score : float
        Fitted gain less half log n a number, plus the held-out gain, in log-units.
    train_gain, later_gain, other_record_gain : float
        Gains in log-units; NaN without another record.
    held_out_z : float
        Mean gain of the held-out blocks over its standard error.
    p_value : float
        Chance of the fitted gain without it, times all that was searched.
    time_constant_s : float
        τ with it, by a fit to the fitted rows.
    parameters_added : int
        Numbers that it brings.
    refused_on : tuple of str
        Rows on which it gains no more than chance: "fitted rows", "later time", "other record", or
        "held-out blocks" where too few of these gain; "share" where it explains too little of whole
        runs; empty where it was accepted.
    share, least_share : float
        Share of the squared errors that it explains and what it had to explain, on whole runs;
        NaN elsewhere. Infinite where its number is within reach of the sensor chain itself.
    """

    round: int
    name: str
    kind: str
    accepted: bool
    chosen: bool
    alias: bool
    score: float
    train_gain: float
    later_gain: float
    other_record_gain: float
    held_out_z: float
    p_value: float
    time_constant_s: float
    parameters_added: int
    refused_on: tuple[str, ...]
    share: float = math.nan
    least_share: float = math.nan


def candidate_rows(d: Diagnosis) -> tuple[CandidateRow, ...]:
    """Return all that were fitted, round by round, best first.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    added = {effect.name for effect in d.after.structure.effects}
    rows = []
    for number, step in enumerate(d.rounds, start=1):
        stand_ins = _stand_ins(d, step)
        tried = [*step.candidates, *step.unnamed, *step.pairs]
        for candidate in sorted(tried, key=_rank):
            names = frozenset(effect.name for effect in candidate.added)
            chosen = _is(candidate, step.winner) and names <= added
            rows.append(_row(number, step, candidate, chosen, names in stand_ins))
    return tuple(rows)


def not_fitted(d: Diagnosis) -> tuple[str, ...]:
    """Return the effects that were tested and promised too little to be worth a fit.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    fitted = {e.name for step in d.rounds for c in (*step.candidates, *step.pairs) for e in c.added}
    return tuple(
        effect.name
        for effect in d.catalogue
        if effect.name not in fitted
        and effect.name not in d.unavailable
        and effect.name not in {row.effect for row in d.untold}
        # On whole runs a ripple is a line of the spectrum, and reversed rows are not scored.
        and not (d.whole_runs and (effect.episodes or effect.name == "reverse_flow_branch"))
    )


def effect_of(d: Diagnosis, name: str) -> Effect:
    """Return the effect behind a name of a diagnosis.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    name : str
        Of an effect that it found, or of an alias.
    """
    candidates = [c for step in d.rounds for c in (*step.candidates, *step.unnamed, *step.pairs)]
    found = [*d.after.structure.effects, *(e for c in candidates for e in c.added)]
    known = [*found, *d.catalogue, FLOW_NOISE]
    return next(effect for effect in known if effect.name == name)


def _stand_ins(d: Diagnosis, step: Round) -> set[frozenset[str]]:
    """Return what could stand for the winner of a round, it among them, if there is a choice."""
    if step.winner is None:
        return set()
    names = [effect.name for effect in step.winner.added]
    sets = {item.effect: item.alias_set for item in d.missing}
    choices = [sets.get(name, (name,)) for name in names]
    found = {frozenset(chosen) for chosen in product(*choices)}
    return found if len(found) > 1 else set()


def _rank(candidate: Candidate) -> float:
    e = candidate.evidence
    return -float(e.score if math.isnan(e.share) else e.share)


def _is(candidate: Candidate, winner: Candidate | None) -> bool:
    return winner is not None and candidate.name == winner.name


def _row(number: int, step: Round, c: Candidate, chosen: bool, alias: bool) -> CandidateRow:
    e = c.evidence
    kind = "pair" if len(c.added) > 1 else "unnamed_term" if c.unnamed else "name"
    return CandidateRow(
        number,
        c.name,
        kind,
        bool(e.accepted),
        chosen,
        alias,
        float(e.score),
        float(e.train),
        float(e.later),
        float(e.other),
        float(e.z),
        float(e.p_value),
        float(c.fit.tau_s),
        int(c.fit.n_parameters - step.bench.fit.n_parameters),
        () if e.accepted else _refused_on(e),
        float(e.share),
        float(e.least_share),
    )


def _refused_on(e: Evidence) -> tuple[str, ...]:
    by_share = not math.isnan(e.least_share)
    rows = []
    if by_share and not e.share >= e.least_share:
        rows.append("share")
    if not by_share and not e.p_value < LARGEST_P:
        rows.append("fitted rows")
    if not e.later > 0.0:
        rows.append("later time")
    if not math.isnan(e.other) and e.other <= 0.0:
        rows.append("other record")
    if not rows and not by_share and not e.z > LEAST_Z:
        rows.append("held-out blocks")
    return tuple(rows)
