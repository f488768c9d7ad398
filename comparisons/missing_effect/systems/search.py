"""The search: which effect, at which place, or which two, a model lacks.

One formulation for every system. All places are laid along the run once; singles and pairs are
read off their products. Promising ones, and all shapes with a threshold, race in the raw metric.
The colour of the errors is taken from the candidate that held-out rows favour, never from the
model that lacks it, which would whiten the effect away. In that metric all candidates are fitted
again and weighed on the rows fitted and on those held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.evidence import alias_rows
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.systems.bench import Bench, whitened_fit
from comparisons.missing_effect.systems.candidates import UNNAMED_GAP, Candidate, Round
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.metric import metric_of
from comparisons.missing_effect.systems.places import SystemEffect
from comparisons.missing_effect.systems.placing import placed_effects
from comparisons.missing_effect.systems.race import FLIP_SEED, favoured_metric, promising, raced
from comparisons.missing_effect.systems.rivals import rejected
from comparisons.missing_effect.systems.score import Prober
from comparisons.missing_effect.systems.weigh import Weigher

UNNAMED_SHARE = 0.02
# A plain form speaks for a refined one, and provisionally a name for a term without one that
# corrects the same (cosine of the corrections), where it wins this share of what that wins.
SIMPLE_SHARE, SAME_COSINE = 0.9, 0.98
# What explains this share of what the winner explains, elsewhere, is a rival.
RIVAL_SHARE = 0.8


def search_round(
    bench: Bench, effects: Sequence[SystemEffect], open_terms: Sequence[SystemEffect]
) -> Round:
    """Try every effect at every place, alone and in pairs.

    Parameters
    ----------
    bench : Bench
        The model and the records.
    effects, open_terms : sequence of SystemEffect
        Names, and terms without one.
    """
    placed, refused = placed_effects(bench.fit, bench.train, [*effects, *open_terms])
    prober = Prober(bench.fit, bench.train)
    raw = prober.laid(placed, bench.raw)
    white = prober.laid(placed, metric_of(bench.fit.errors))
    chosen = promising(raw, white)
    raw_fits = raced(bench, chosen)
    metric = favoured_metric(bench, raw_fits)
    weigher = Weigher.of(bench, metric, placed, prober, raw)
    tried = [
        weigher.weighed(
            Candidate(probe.placed, probe, raw=raw_fits[probe]),
            whitened_fit(bench, raw_fits[probe], metric),
        )
        for probe in chosen
        if probe in raw_fits
    ]
    keys = {c.probe.key for c in tried}
    rest = [Candidate(p.placed, p) for p in white.best() if p.key not in keys]
    ranked = tuple(sorted(tried, key=lambda c: -c.score)) + tuple(rest)
    winner, aliases, rivalled = _winner(weigher, [c for c in ranked if c.stands])
    slow = [c for c in ranked if c.accepted_slow]
    if winner is None and slow:
        winner = max(slow, key=lambda c: c.slow)
        aliases = (winner,)
    share, rates = 0.0, (0.0, 0.0)
    if winner is not None and winner.errors is not None and winner.evidence is not None:
        valid = weigher.rows.valid
        base = float(np.sum(weigher.base_errors[valid] ** 2))
        share = 1.0 - float(np.sum(winner.errors[valid] ** 2)) / base
        rates = (
            winner.evidence.train / np.count_nonzero(weigher.rows.of_part(TRAIN)),
            winner.evidence.later / np.count_nonzero(weigher.rows.of_part(LATER)),
        )
    rival, p = _rival(weigher, winner, aliases, ranked), 0.0
    if winner is not None and rival is not None:
        assert winner.fit is not None
        assert rival.fit is not None
        rng = np.random.default_rng(FLIP_SEED)
        p = rejected(winner.fit, rival.fit, bench.raced(), metric, rng)
    return Round(bench, metric, ranked, winner, aliases, refused, rivalled, share, rates, rival, p)


def _rival(
    weigher: Weigher,
    winner: Candidate | None,
    aliases: Sequence[Candidate],
    ranked: Sequence[Candidate],
) -> Candidate | None:
    """Return the best that shares no effect with the winner and explains nearly as much.

    A term without a name counts, unless it corrects the same: it is the name, without it.
    """
    if winner is None or winner.unnamed:
        return None
    listed = {placed.key for c in aliases for placed in c.added}
    for c in ranked:
        apart = not listed & {placed.key for placed in c.added}
        near = c.accepted and apart and c.score > RIVAL_SHARE * winner.score
        if near and not (c.unnamed and _corrects_the_same(weigher, c, winner)):
            return c
    return None


def _winner(
    weigher: Weigher, standing: Sequence[Candidate]
) -> tuple[Candidate | None, tuple[Candidate, ...], bool]:
    """Return what is added, its alias set, and whether a term without a name does as well.

    The best must win more than chance; which of those beside it is meant is another question. Of
    the set the one with fewest numbers speaks.
    """
    best = max((c for c in standing if c.accepted), key=lambda c: c.score, default=None)
    if best is None:
        return None, (), False
    pool = [best, *[c for c in standing if c is not best]]
    near = _near(weigher, pool)
    margin = max(UNNAMED_GAP, UNNAMED_SHARE * abs(best.score))
    named = [
        c
        for c, same in zip(pool, near, strict=True)
        if not c.unnamed
        and (same or best.score - c.score < margin or _corrects_the_same(weigher, c, best))
    ]
    rivalled = False
    if best.unnamed and named:
        # A name speaks wherever the records cannot tell it from a term without one.
        name = max(named, key=lambda c: c.score)
        best, rivalled = name, best.score - name.score > UNNAMED_GAP
        pool = [best, *[c for c in standing if c is not best and not c.unnamed]]
        near = _near(weigher, pool)
    simple = _simple_form(best, pool)
    aliases = [c for c, same in zip(pool, near, strict=True) if same or c is simple or c is best]
    if not best.unnamed:
        aliases = [c for c in aliases if not c.unnamed]
        aliases = [c for c in aliases if c is best or not c.outgrown]
    # Names that rounding alone parts stand in the order of the catalogue.
    order = {name: i for i, name in enumerate(dict.fromkeys(weigher.names))}
    top = max(c.score for c in aliases)
    aliases.sort(
        key=lambda c: (
            c is not simple,
            _numbers(c),
            int((top - c.score) / UNNAMED_GAP),
            order.get(c.placed.name, len(order)),
        )
    )
    return aliases[0], tuple(aliases), rivalled


def _near(weigher: Weigher, pool: Sequence[Candidate]) -> list[bool]:
    """Tell which of a pool the records cannot tell from its best."""
    errors = [c.errors for c in pool if c.errors is not None]
    return alias_rows(weigher.rows, weigher.base_errors, errors, [c.score for c in pool])


def _corrects_the_same(weigher: Weigher, candidate: Candidate, best: Candidate) -> bool:
    """Tell whether a candidate wins nearly as much as the best, by nearly the same correction.

    Where the shape of a term is wrong for both, long records part them by many log-units without
    a word on which of them is nearer to the physics.
    """
    if candidate.errors is None or best.errors is None:
        return False
    valid = weigher.rows.valid
    one = (weigher.base_errors - candidate.errors)[valid]
    two = (weigher.base_errors - best.errors)[valid]
    size = float(np.linalg.norm(one) * np.linalg.norm(two))
    fair = candidate.score > SIMPLE_SHARE * best.score
    return fair and size > 0.0 and float(one @ two) > SAME_COSINE * size


def still_aliases(bench: Bench, step: Round) -> tuple[Candidate, ...]:
    """Return the alias set of a round that stands beside all that was found later.

    What stood in for two effects at once is no rival of either once both are there.

    Parameters
    ----------
    bench : Bench
        With everything that was found.
    step : Round
        A round whose winner is part of it.
    """
    winner = step.winner
    keys = [placed.key for placed in bench.fit.structure.effects]
    if winner is None or len(step.aliases) < 2 or len(keys) < 2 or winner.placed.key not in keys:
        return step.aliases
    metric = metric_of(bench.fit.errors)
    best = whitened_fit(bench, bench.fit, metric).cost
    first = len(bench.fit.theta) - SLOTS * len(keys)
    at = first + SLOTS * keys.index(winner.placed.key)
    kept = [winner]
    for c in step.aliases[1:]:
        if len(c.added) > 1 or c.fit is None or c.placed.key in keys:
            continue
        effects = [
            c.placed if e.key == winner.placed.key else e for e in bench.fit.structure.effects
        ]
        structure = replace(bench.fit.structure, effects=tuple(effects))
        theta = bench.fit.theta.copy()
        theta[at : at + SLOTS] = c.fit.theta[-SLOTS:]
        swapped = bench.refitted(structure, theta)
        if whitened_fit(replace(bench, white=None), swapped.fit, metric).cost < best + UNNAMED_GAP:
            kept.append(c)
    return tuple(kept)


def _simple_form(best: Candidate, pool: Sequence[Candidate]) -> Candidate | None:
    """Return the plain form of the best where that wins nearly as much.

    A refinement that wins a few per cent more is no other effect: the plain form speaks, and the
    refinement may be found in the next round.
    """
    for candidate in pool:
        if len(candidate.added) > 1 or len(best.added) > 1:
            continue
        same = candidate.placed.place == best.placed.place
        plain = best.placed.name in candidate.placed.effect.simple_form_of
        fair = candidate.score > SIMPLE_SHARE * best.score and not candidate.outgrown
        if same and plain and fair:
            return candidate
    return None


def _numbers(candidate: Candidate) -> int:
    """Return how much an effect brings: its numbers, and its own state."""
    return sum(
        sum(not held for held in placed.held) + placed.effect.own_state
        for placed in candidate.added
    )
