"""The search: what a model lacks, round by round. One for every kind of system.

Effects are laid along the run of the model; what is promising races; the metric comes from the
best of the race, never from the model that lacks it, which would whiten the effect away. In that
metric candidates are weighed on rows fitted and held out. What wins is added, with all that the
rows cannot tell from it beside it; in the end what later effects made needless is taken out.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.missing_effect.engine import A, Candidate, F, Policy, Round, System
from comparisons.missing_effect.evidence import cosine_of, paired_z
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from comparisons.missing_effect.results import MissingEffect

# Log-units by which a term without a name must be ahead to be more than a rival of a name; what
# is closer than that stands in the order of the catalogue.
RIVALLED = 12.0
# A plain form speaks for a refined one where it wins this share of what that wins.
SIMPLE_SHARE = 0.9
# Two effects at once must beat one by so much.
PAIR_GAP, PAIR_Z = 6.0, 3.0
# Or leave this share of what the single one leaves.
PAIR_LEFT = 0.5

Report = Callable[[str], None]


def search(
    system: System[A, F],
    effects: Sequence[Any],
    library: Sequence[Any],
    most: int,
    report: Report = lambda _: None,
) -> tuple[Any, list[Round[A, F]]]:
    """Add to a model what it lacks, one or two effects a round, until it has ``most``.

    ``effects`` have names, the terms of the ``library`` have none; ``report`` hears in a few words
    what begins.
    """
    here: System[A, F] = system
    rounds: list[Round[A, F]] = []
    while len(here.found) < most and not here.failed:
        report(f"round {len(rounds) + 1}")
        step = search_round(here, effects, library, most - len(here.found))
        rounds.append(step)
        if step.winner is None:
            here = step.bench
            break
        moved = step.bench.with_winner(step)
        if moved.failed:
            break
        if here.found and not is_worth_adding(step, here, moved):
            break
        here = moved
        if not here.found:
            # The model alone explains as much, from the winner's numbers: it begins there again.
            rounds.clear()
            continue
        if here.policy.stops_clean and (step.winner.unnamed or not step.leftover.structured):
            break
    return _refined(_pruned(here), rounds)


def search_round(
    system: System[A, F], effects: Sequence[Any], library: Sequence[Any], room: int = 2
) -> Round[A, F]:
    """Try everything that may be added to a model, at most ``room`` effects at once."""
    race = system.tried(effects, library)
    bench: System[A, F] = race.system
    ranked = bench.ranked([bench.weighed(c) for c in race.candidates if len(c.added) <= room])
    order = [effect.name for effect in (*effects, *library)]
    winner, aliases, rivalled = _winner(bench, ranked, order)
    left = bench.leftover(winner, effects, library)
    pairs: tuple[Candidate[A, F], ...] = ()
    # Two effects may hide each other: at the start, where what is left is tested at the end.
    alone = winner is None and not system.found
    if room > 1 and (alone if left is None else left.structured):
        pairs = bench.ranked(_pairs(bench, ranked, effects))
        best = next((pair for pair in pairs if pair.accepted), None)
        if best is None and winner is None:
            slows = [pair for pair in pairs if pair.accepted_slow]
            best = max(slows, key=lambda c: c.slow, default=None)
        if best is not None and _is_better(bench, best, winner, ranked):
            after = bench.leftover(best, effects, library)
            if after is None or after.gain < PAIR_LEFT * left.gain or not after.structured:
                winner, aliases, left = best, (best,), after
    every = (*ranked, *pairs, *race.others)
    step = Round(bench, every, winner, aliases, race.refused, left, rivalled)
    return step if winner is None else _held_against(step, winner, bench)


def _winner(
    system: System[A, F], ranked: Sequence[Candidate[A, F]], order: Sequence[str]
) -> tuple[Candidate[A, F] | None, tuple[Candidate[A, F], ...], bool]:
    """Return what is added, its alias set, and whether a term without a name does better.

    The best must win more than chance; which of those beside it is meant is another question.
    """
    policy = system.policy
    standing = [c for c in ranked if c.evidence.stands]
    best = max((c for c in standing if c.accepted), key=lambda c: c.rank, default=None)
    if best is None:
        slow = _best_slow([c for c in ranked if c.accepted_slow and len(c.added) == 1], policy)
        return slow, () if slow is None else (slow,), False
    names = [c for c in standing if not c.unnamed]
    rivalled = False
    if best.unnamed:
        # A name speaks wherever the records cannot tell it from a term without one.
        beside = system.near(best, names, policy.term)
        beside += [c for c in names if _corrects_the_same(system, c, best)]
        name = max(beside, key=lambda c: c.rank, default=best)
        rivalled = best.rank - name.rank > RIVALLED
        # Where a term leaves nothing they can: a rudder's cubic damping was called a softening one.
        if rivalled and system.leaves_nothing(best):
            rivalled = False
        else:
            best = name
    pool = standing if best.unnamed and policy.terms_stand else names
    if policy.refused_stand:
        pool = list(ranked)
    pool = [c for c in pool if c is not best and c.rank > -np.inf]
    simple = _simple_form(best, [*pool, *standing])
    near = system.near(best, pool, policy.alias) if best.rank > -np.inf else []
    # A plain form without a name stands beside the name where rounding alone parts them.
    beside = [c for c in standing if c.unnamed > best.unnamed and _is_plain(c, best)]
    plain = [c for c in beside if c.rank > best.rank - RIVALLED]
    others = [*pool, *(c for c in plain if c not in pool)]
    alike = [*near, *plain, simple]
    aliases = [best, *(c for c in others if c in alike and not c.outgrown)]
    if policy.plain_speaks:
        top = max(c.rank for c in aliases)
        # Names that rounding alone parts stand in the order of the catalogue.
        aliases.sort(
            key=lambda c: (
                c is not simple,
                sum(one.brings for one in c.added),
                int((top - c.rank) / RIVALLED),
                order.index(c.added[0].name) if c.added[0].name in order else len(order),
            )
        )
    return aliases[0], tuple(aliases), rivalled


def _best_slow(slows: Sequence[Candidate[A, F]], policy: Policy) -> Candidate[A, F] | None:
    """Return what wins most in plain errors; a name that wins nearly as much as a term speaks."""
    if not slows:
        return None
    best = max(slows, key=lambda c: c.slow)
    if best.unnamed:
        names = [c for c in slows if not c.unnamed and c.slow > policy.same_share * best.slow]
        best = max(names, key=lambda c: c.slow, default=best)
    plain = [c for c in slows if c.added[0].is_plain_form_of(best.added[0])]
    return next((c for c in plain if c.slow > best.slow - RIVALLED), best)


def _simple_form(best: Candidate[A, F], pool: Sequence[Candidate[A, F]]) -> Candidate[A, F] | None:
    """Return the plain form of the best where that wins nearly as much.

    A refinement that wins a few per cent more is no other effect: the plain form speaks, and the
    refinement may be found in the next round. A plain form without a name speaks for a name that
    wins no more, or by rounding alone for each further number: a leak in proportion to a level was
    a threshold that was never met.
    """
    for c in pool:
        least = SIMPLE_SHARE * best.rank
        if c.unnamed > best.unnamed:
            least = best.rank - RIVALLED * (best.added[0].brings - c.added[0].brings)
        if c.rank > least and not c.outgrown and _is_plain(c, best):
            return c
    return None


def _is_plain(candidate: Candidate[A, F], best: Candidate[A, F]) -> bool:
    """Tell whether a candidate is the plain form of the best."""
    alone = len(candidate.added) == len(best.added) == 1
    return alone and candidate.added[0].is_plain_form_of(best.added[0])


def _corrects_the_same(
    system: System[A, F], candidate: Candidate[A, F], best: Candidate[A, F]
) -> bool:
    """Tell whether a candidate wins nearly as much as the best, by nearly the same correction.

    Where the shape of a term is wrong for both, long records part them by many log-units without
    a word on which of them is nearer to the physics.
    """
    policy = system.policy
    if not candidate.rank > policy.same_share * best.rank:
        return False
    alike = cosine_of(system.rows, system.base_errors, candidate.errors, best.errors)
    return alike > policy.same_cosine


def _pairs(
    bench: System[A, F], ranked: Sequence[Candidate[A, F]], effects: Sequence[Any]
) -> list[Candidate[A, F]]:
    """Fit the best names together with each second one that its errors ask for."""
    out: dict[frozenset[Hashable], Candidate[A, F]] = {}
    for head in bench.heads(ranked):
        for pair in bench.second(head, effects, out):
            out[pair.keys] = bench.weighed(pair)
    return list(out.values())


def _is_better(
    system: System[A, F],
    pair: Candidate[A, F],
    single: Candidate[A, F] | None,
    ranked: Sequence[Candidate[A, F]],
) -> bool:
    """Tell whether two effects explain clearly more than one, and than each of the two."""
    alone = [c for c in ranked if c.keys < pair.keys]
    if any(pair.evidence.score - c.evidence.score < PAIR_GAP for c in alone):
        return False
    if single is None:
        return True
    gain = 0.5 * (single.errors**2 - pair.errors**2)
    clear = pair.rank - single.rank > PAIR_GAP
    return clear and paired_z(gain, system.rows, TRAIN, LATER, OTHER) > PAIR_Z


def _held_against(step: Round[A, F], winner: Candidate[A, F], system: System[A, F]) -> Round[A, F]:
    """Return a round with what its winner explains, and with its rival elsewhere."""
    rows = system.rows
    base, left = (float(np.sum(e[rows.valid] ** 2)) for e in (system.base_errors, winner.errors))
    fitted, later = (max(int(np.count_nonzero(rows.of_part(p))), 1) for p in (TRAIN, LATER))
    rates = winner.evidence.train / fitted, winner.evidence.later / later
    rival = _rival(step, winner, system)
    p = 0.0 if rival is None else step.bench.rejected(winner, rival)
    return replace(step, share=1.0 - left / base, rates=rates, rival=rival, rival_p=p)


def _rival(
    step: Round[A, F], winner: Candidate[A, F], system: System[A, F]
) -> Candidate[A, F] | None:
    """Return the best that shares no effect with the winner and explains nearly as much.

    Or more of the plain errors. A term without a name counts, unless it corrects the same: it is
    the name, without it.
    """
    share = system.policy.rival_share
    if winner.unnamed or share is None:
        return None
    listed = frozenset(key for c in step.aliases for key in c.keys)
    for c in step.candidates:
        near = c.accepted and (c.rank > share * winner.rank or c.slow > winner.slow)
        same = near and c.unnamed and _corrects_the_same(system, c, winner)
        if near and not same and not listed & c.keys:
            return c
    return None


def is_worth_adding(step: Round[A, F], here: System[A, F], moved: System[A, F]) -> bool:
    """Tell whether an effect beyond the first is: a fair share of what is left.

    Where model error rules, and not noise, every term of some flexibility wins something. A term
    without a name follows a name only where it takes a good part of the plain held-out error.
    """
    policy, winner = moved.policy, step.winner
    if winner is None or not policy.further_share:
        return winner is not None
    raw = 1.0 - (moved.held_out_size() / here.held_out_size()) ** 2
    if raw >= policy.further_raw:
        return True
    follows = any(one.unnamed for one in here.found) or not winner.unnamed
    return step.share >= policy.further_share and follows


def _pruned(system: System[A, F]) -> System[A, F]:
    """Return a model without effects that those found later made needless."""
    for one in system.found if len(system.found) > 1 else ():
        less = system.without_needless(one)
        if less is not None:
            return _pruned(less)
    return system


def _refined(
    system: System[A, F], rounds: Sequence[Round[A, F]]
) -> tuple[System[A, F], list[Round[A, F]]]:
    """Let one refined form speak for its plain form and for what was found beside that.

    What a plain form leaves of the refined one is no effect of its own: a motor with Stribeck
    friction read Coulomb friction and a softening damping.
    """
    for step in rounds:
        for refined in sorted(step.aliases[1:], key=lambda c: -c.rank):
            plain = step.aliases[0].added[0]
            more = len(refined.added) == 1 and plain.is_plain_form_of(refined.added[0])
            less = system.with_refined(plain, refined) if more and plain in system.found else None
            if less is not None:
                others = [c for c in step.aliases if c is not refined]
                spoken = replace(step, winner=refined, aliases=(refined, *others))
                own = _held_against(spoken, refined, step.bench)
                gone = {e.key for e in system.found} - {e.key for e in less.found} | refined.keys
                # Rounds whose winner is gone, or found again, go with it.
                kept = [s for s in rounds if s is step or not s.winner or not s.winner.keys <= gone]
                return less, [own if s is step else s for s in kept]
    return system, list(rounds)


def alias_sets(
    system: System[A, F], rounds: Sequence[Round[A, F]], effects: Sequence[Any]
) -> dict[Hashable, tuple[Candidate[A, F], ...]]:
    """Return, by its key, what could stand in the place of each effect found, it first.

    What stood in for two effects at once is no rival of either once both are there.
    """
    out: dict[Hashable, tuple[Candidate[A, F], ...]] = {}
    for one in system.found:
        step = next((s for s in rounds if s.winner is not None and one.key in s.winner.keys), None)
        single = step is not None and len(system.found) == len(step.aliases[0].added) == 1
        if step is not None and single and not system.policy.aliases_refitted:
            out[one.key] = step.aliases
        else:
            out[one.key] = system.stand_ins(one, step, effects)
    return out


def verdict_of(missing: Sequence[MissingEffect], otherwise: str) -> str:
    """Return the verdict on what was found."""
    if not missing:
        return otherwise
    if missing[0].unnamed:
        return "unnamed_term"
    if any(item.provisional for item in missing if not item.unnamed):
        return "provisional"
    return "alias_set" if any(len(item.alias_set) > 1 for item in missing) else "named"
