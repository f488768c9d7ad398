"""The search: which effect, at which place, or which two, a model lacks.

One formulation for every system. All places are laid along the run once; singles and pairs are
read off their products. Promising ones, and all shapes with a threshold, race in the raw metric.
The colour of the errors is taken from the candidate that held-out rows favour, never from the
model that lacks it, which would whiten the effect away. In that metric all candidates are fitted
again and weighed on the rows fitted and on those held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.evidence import (
    LARGEST_P,
    Evidence,
    Rows,
    alias_rows,
    block_sums,
    evidence_of,
)
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.systems.bench import Bench, growth_of, whitened_fit
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.fit import Fit, fit_runs, settled
from comparisons.missing_effect.systems.metric import Metric, metric_of
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed, SystemEffect
from comparisons.missing_effect.systems.placing import placed_effects
from comparisons.missing_effect.systems.rivals import rejected
from comparisons.missing_effect.systems.score import Answers, Probe, Prober
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Structure
from surge_core.types import FloatArray

__all__ = ["Candidate", "Round", "search_round", "still_aliases"]

# Effects that are nothing at the lower bound of their first number.
VANISHING = (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
# Effects that make an input or a reading come late.
LATE = (Kind.INPUT_LAG, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
# Effects that promise nothing to first order where the model without them went elsewhere: a wall
# or a rim that the run of a wrong model never meets. They always race.
BENT = (Kind.INPUT_MAP, Kind.STATE_LIMIT, Kind.OVERFLOW, Kind.OUTPUT_MAP, Kind.INPUT_PLAY)
# Candidates that are fitted: the most promising of each metric, as long as they promise a
# hundredth of the best and more than chance; and pairs.
MOST_FITTED, MOST_PAIRS, LEAST_PROMISE_SHARE = 6, 3, 0.01
# Steps from each of several starts, steps of the first lap, those that go on by either count, and
# steps to the end.
HEAT, FIRST_LAP, FINALISTS, MOST_ITERATIONS = 1, 4, 4, 15
BLOCKS = 60
LEAST_BLOCK_ROWS = 20
# Held-out blocks that lose no more than this share of what the others win speak with one voice.
ONE_SIDED_SHARE = 0.1
# An open term takes the place of a name only when it is better by this much.
UNNAMED_GAP = 12.0
UNNAMED_SHARE = 0.02
# A plain form speaks for a refined one, and provisionally a name for a term without one that
# corrects the same (cosine of the corrections), where it wins this share of what that wins.
SIMPLE_SHARE, SAME_COSINE = 0.9, 0.98
FLIP_SEED = 0
# A term without a name that wins this share more on the rows fitted says that more is there.
OUTFITTED_SHARE = 0.5
# A name elsewhere that explains this share of what the winner explains is a rival.
RIVAL_SHARE = 0.8
# What is won in plain errors alone must be this share of the squared held-out error, and this
# share of what it is on the rows fitted.
LEAST_SLOW_SHARE, HELD_OUT_SHARE = 0.25, 0.5
# By how many powers of e small changes of the state may grow beyond the model without a term.
MOST_GROWTH = 3.0


@dataclass(frozen=True)
class Candidate:
    """One effect at one place, or two, fitted and weighed.

    Parameters
    ----------
    placed : Placed
        The effect, the first of two.
    probe : Probe
        What the score test promised.
    fit : Fit or None
        To the rows fitted, in the metric of the round; None where it was not promising.
    errors : ndarray or None
        Whitened errors, fitted rows before held-out ones.
    evidence : Evidence or None
        For it.
    raw : Fit or None
        The same in the raw metric.
    one_sided : bool
        Whether held-out blocks speak for it with hardly one against it, where it acts in episodes.
    wild : bool
        Whether small changes of the state grow much more with it than without.
    chance : float
        Log-units that the best of all candidates wins by chance.
    slow : float
        Log-units that it wins in plain errors, where those are more than chance.
    """

    placed: Placed
    probe: Probe
    fit: Fit | None = None
    errors: FloatArray | None = None
    evidence: Evidence | None = None
    raw: Fit | None = None
    one_sided: bool = False
    wild: bool = False
    chance: float = 0.0
    slow: float = 0.0

    @property
    def added(self) -> tuple[Placed, ...]:
        """The effects."""
        return self.probe.added

    @property
    def unnamed(self) -> bool:
        """Whether a term without a name is part of it."""
        return self.probe.unnamed

    def label(self, model: Model) -> str:
        """Return names and places in one line."""
        return " + ".join(placed.label(model) for placed in self.added)

    @property
    def score(self) -> float:
        """Its score; minus infinity where it was not fitted."""
        return -np.inf if self.evidence is None else self.evidence.score

    @property
    def accepted(self) -> bool:
        """Whether fitted and held-out rows both speak for it, and it did not vanish."""
        e = self.evidence
        if e is None or self.vanished or self.wild:
            return False
        if e.train + e.later <= self.chance:
            return False
        alone = e.later > 0.0 and e.p_value < LARGEST_P and self.one_sided
        return e.accepted or alone

    @property
    def accepted_slow(self) -> bool:
        """Whether it wins in plain errors what chance does not, here and on held-out rows.

        Chance is that of single effects: pairs are too many for it.
        """
        return self.slow > 0.0 and len(self.added) == 1 and not self.vanished and not self.wild

    @property
    def vanished(self) -> bool:
        """Whether a first number ended at the bound where it is no effect any more.

        A lag or a delay of one sample is the timing offset that every model has.
        """
        return any(self._vanished(i) for i in range(len(self.added)))

    def _vanished(self, which: int) -> bool:
        placed = self.added[which]
        numbers = placed.effect.numbers
        if self.fit is None or not numbers:
            return False
        value = float(self.fit.theta[SLOTS * (which - len(self.added))])
        if placed.effect.linear:
            return value == 0.0
        smallest = placed.effect.kind in VANISHING
        return smallest and value <= numbers[0].low * (1.0 + 1e-6)

    @property
    def outgrown(self) -> bool:
        """Whether a shape ended at its upper bound: what is there is something wider."""
        if self.fit is None or not self.placed.effect.simple_form_of or len(self.added) > 1:
            return False
        shapes = self.fit.theta[-SLOTS:][1 : len(self.placed.effect.numbers)]
        bounds = [number.high for number in self.placed.effect.numbers[1:]]
        return any(value >= high * (1.0 - 1e-6) for value, high in zip(shapes, bounds, strict=True))


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Parameters
    ----------
    bench : Bench
        The model of the round.
    metric : Metric
        In which candidates were weighed.
    candidates : tuple of Candidate
        All places tried, best first.
    winner : Candidate or None
        What is added.
    aliases : tuple of Candidate
        Those that the records cannot tell from the winner, the winner first.
    refused : mapping of str to str
        Effects that no signal can show, and why.
    rivalled : bool
        Whether a term without a name does as well as the winner.
    share : float
        Share of the squared whitened errors that the winner explains.
    rates : (float, float)
        Log-units that the winner gains a row, on rows fitted and held out.
    rival : Candidate or None
        The best name elsewhere that explains nearly as much as the winner.
    rival_p : float
        Chance of the winner's advantage if the rival were the truth.
    """

    bench: Bench
    metric: Metric
    candidates: tuple[Candidate, ...]
    winner: Candidate | None
    aliases: tuple[Candidate, ...]
    refused: dict[str, str]
    rivalled: bool = False
    share: float = 0.0
    rates: tuple[float, float] = (0.0, 0.0)
    rival: Candidate | None = None
    rival_p: float = 0.0

    @property
    def outfitted(self) -> bool:
        """Whether something without a name fits the rows fitted far better than the winner."""
        if self.winner is None or self.winner.evidence is None:
            return False
        won = self.winner.evidence.train
        return any(
            c.evidence.train > won + max(UNNAMED_GAP, OUTFITTED_SHARE * won)
            for c in self.candidates
            if c.evidence is not None and c.unnamed and not c.wild
        )


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
    promising = _promising(raw, white)
    raw_fits = _raced(bench, promising)
    metric = _favoured_metric(bench, raw_fits)
    weigher = _Weigher.of(bench, metric, placed, prober, raw)
    tried = [
        weigher.weighed(
            Candidate(probe.placed, probe, raw=raw_fits[probe]),
            whitened_fit(bench, raw_fits[probe], metric),
        )
        for probe in promising
        if probe in raw_fits
    ]
    keys = {c.probe.key for c in tried}
    rest = [Candidate(p.placed, p) for p in white.best() if p.key not in keys]
    ranked = tuple(sorted(tried, key=lambda c: -c.score)) + tuple(rest)
    winner, aliases, rivalled = _winner(weigher, [c for c in ranked if c.accepted])
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
        p = rejected(winner.fit, rival.fit, bench.train, metric, rng)
    return Round(bench, metric, ranked, winner, aliases, refused, rivalled, share, rates, rival, p)


def _rival(
    weigher: _Weigher,
    winner: Candidate | None,
    aliases: Sequence[Candidate],
    ranked: Sequence[Candidate],
) -> Candidate | None:
    """Return the best name that shares no effect with the winner and explains nearly as much."""
    if winner is None or winner.unnamed:
        return None
    listed = {placed.key for c in aliases for placed in c.added}
    for c in ranked:
        apart = not listed & {placed.key for placed in c.added}
        if c.accepted and not c.unnamed and apart and c.score > RIVAL_SHARE * winner.score:
            return c
    return None


def _promising(raw: Answers, white: Answers) -> list[Probe]:
    """Return the most promising of both metrics, each place once, and every bent shape."""
    kept: dict[object, Probe] = {}
    for answers in (white, raw):
        probes = answers.best()
        best = probes[0].gain if probes else 0.0
        chance = answers.chance(np.random.default_rng(FLIP_SEED))
        least = max(chance, LEAST_PROMISE_SHARE * best)
        named = [p for p in probes if p.gain > least and not p.unnamed]
        terms = [p for p in probes if p.gain > least and p.unnamed]
        pairs = answers.pairs(MOST_PAIRS, least)
        for probe in (*named[:MOST_FITTED], *terms[: MOST_FITTED // 2], *pairs):
            kept.setdefault(probe.key, probe)
    for probe in white.best():
        if probe.placed.effect.kind in BENT and not probe.placed.effect.linear:
            kept.setdefault(probe.key, probe)
    # The plain form of whatever is promising races beside it, and each half of a pair alone.
    wanted = {(e.name, e.place) for p in kept.values() for e in p.added}
    for probe in white.best():
        placed = probe.placed
        forms = {(name, placed.place) for name in placed.effect.simple_form_of}
        half = any(p.second is not None and placed.key in p.key for p in kept.values())
        if forms & wanted or half:
            kept.setdefault(probe.key, probe)
    return list(kept.values())


def _raced(bench: Bench, probes: Sequence[Probe]) -> dict[Probe, Fit]:
    """Fit a few steps each in the raw metric, and to the end those that are ahead by then.

    Ahead by either count: errors as they are, and the likelihood in the metric of their own.
    """
    lane = bench.raced()
    white = metric_of(lane.fit.errors)
    begun = {probe: _begun(lane, probe, white) for probe in probes}
    begun = {probe: fit for probe, fit in begun.items() if not fit.failed}
    if not begun:
        return {}
    own = {p: metric_of(f.errors).log_likelihood(f.errors) for p, f in begun.items()}
    ahead: list[Probe] = []
    for unnamed in (False, True):
        group = [p for p in begun if p.unnamed == unnamed]
        by_size = sorted(group, key=lambda p: begun[p].cost)[:FINALISTS]
        by_own = sorted(group, key=lambda p: -own[p])[:FINALISTS]
        ahead += [p for p in group if p in by_size or p in by_own]
    forms = {(p.placed.name, p.placed.place) for p in ahead}
    ahead += [
        p
        for p in begun
        if p not in ahead
        and {(name, p.placed.place) for name in p.placed.effect.simple_form_of} & forms
    ]
    return {
        p: fit_runs(
            begun[p].structure,
            bench.train,
            bench.raw,
            begun[p].theta,
            begun[p].starts if lane is bench else bench.fit.starts,
            begun[p].scale,
            most=MOST_ITERATIONS,
        )
        for p in ahead
    }


def _begun(bench: Bench, probe: Probe, white: Metric) -> Fit:
    """Fit a few steps from where the score test points, or from the best of several starts."""
    structure = bench.fit.structure
    for placed in probe.added:
        structure = structure.with_effect(placed)

    def lap(theta: FloatArray, starts: Sequence[FloatArray], most: int) -> Fit:
        return fit_runs(structure, bench.train, bench.raw, theta, starts, most=most)

    begun = _beginnings(bench, probe, structure)
    most = MOST_ITERATIONS if probe.placed.effect.begins_afresh else FIRST_LAP
    if len(begun) == 1:
        return lap(begun[0], bench.fit.starts, most)
    heats = [lap(theta, bench.fit.starts, HEAT) for theta in begun]
    best = min(heats, key=lambda fit: fit.cost)
    return best if best.failed else lap(best.theta, best.starts, most)


def _beginnings(bench: Bench, probe: Probe, structure: Structure) -> list[FloatArray]:
    """Return where a fit of one more effect, or of two, may begin."""
    effect, theta = probe.placed.effect, bench.fit.theta
    first = len(structure.model.params)
    end = first + len(structure.model.inputs)
    slots = _slots(structure, probe)
    if probe.second is not None:
        return [np.concatenate([theta, slots, _slots(structure, probe.second)])]
    out = [np.concatenate([theta, slots])]
    if effect.begins_afresh:
        # What makes another reading of everything: the model without it may be far off.
        begun = structure.start()
        out.append(np.concatenate([begun[:end], theta[end:], slots]))
    elif effect.kind in LATE:
        # What comes late through it, the model without it has put down to a timing offset.
        out.append(np.concatenate([theta[:first], 0.0 * theta[first:end], theta[end:], slots]))
    if effect.numbers and not effect.linear:
        # A threshold in the run of a model that lacks it may be nowhere near the true one.
        others = [start for start in probe.placed.starts if start != probe.start]
        out += [np.concatenate([theta, structure.slots(start)]) for start in others]
    return out


def _slots(structure: Structure, probe: Probe) -> FloatArray:
    linear = probe.placed.effect.linear and bool(probe.placed.effect.numbers)
    return structure.slots((0.0, *probe.start[1:]) if linear else probe.start)


def _favoured_metric(bench: Bench, raw_fits: dict[Probe, Fit]) -> Metric:
    """Return the metric of the errors of the candidate that held-out rows favour.

    By its own likelihood on the rows fitted, the most flexible wins, whatever comes after.
    """
    good = [bench.fit, *[fit for fit in raw_fits.values() if not fit.failed]]

    def held_out(fit: Fit) -> float:
        own = metric_of(fit.errors)
        later = settled(fit, bench.later, own)
        return -np.inf if later.failed else own.log_likelihood(later.errors)

    return metric_of(max(good, key=held_out).errors)


@dataclass(frozen=True)
class _Weigher:
    """The model without the candidates in the metric of a round, and the rows."""

    bench: Bench
    metric: Metric
    base: Fit
    base_errors: FloatArray
    rows: Rows
    names: tuple[str, ...]
    chance: float
    growth: float
    plain: Metric
    plain_errors: FloatArray
    plain_chance: float

    @classmethod
    def of(
        cls, bench: Bench, metric: Metric, placed: Sequence[Placed], prober: Prober, raw: Answers
    ) -> _Weigher:
        base = whitened_fit(bench, bench.fit, metric)
        rng = np.random.default_rng(FLIP_SEED)
        plain = bench.raw.with_size_of(bench.fit.errors)
        return cls(
            bench,
            metric,
            base,
            _errors(bench, metric, base),
            _rows(bench, metric),
            tuple(one.name for one in placed),
            prober.laid(placed, metric).chance(rng),
            growth_of(bench.fit, bench),
            plain,
            _errors(bench, plain, bench.fit),
            raw.chance(rng),
        )

    def weighed(self, candidate: Candidate, fit: Fit) -> Candidate:
        """Return a candidate with its evidence."""
        if fit.failed:
            return candidate
        errors = _errors(self.bench, self.metric, fit)
        added = fit.n_parameters - self.base.n_parameters
        evidence = evidence_of(
            self.rows, self.base_errors, errors, added=added, searched=float(len(self.names))
        )
        sums = block_sums(0.5 * (self.base_errors**2 - errors**2), self.rows, LATER)
        against = -float(sums[sums < 0.0].sum())
        one_sided = against < ONE_SIDED_SHARE * float(sums[sums > 0.0].sum())
        raw = candidate.raw
        wild = raw is not None and growth_of(raw, self.bench) > self.growth + MOST_GROWTH
        return replace(
            candidate,
            fit=fit,
            errors=errors,
            evidence=evidence,
            one_sided=one_sided,
            wild=wild,
            chance=self.chance,
            slow=self._slow(raw),
        )

    def _slow(self, raw: Fit | None) -> float:
        """Return the log-units that a candidate wins in plain errors; 0 where chance does.

        Slow errors weigh next to nothing once they are whitened, and yet they are what a
        simulation is judged by.
        """
        if raw is None or raw.failed:
            return 0.0
        errors = _errors(self.bench, self.plain, raw)
        rows = _rows(self.bench, self.plain)
        gain = 0.5 * (self.plain_errors**2 - errors**2)
        shares = []
        for part in (TRAIN, LATER):
            here = rows.of_part(part)
            base = 0.5 * float(np.sum(self.plain_errors[here] ** 2))
            shares.append(float(gain[here].sum()) / base)
        won = float(gain[rows.valid].sum())
        fair = shares[1] > max(LEAST_SLOW_SHARE, HELD_OUT_SHARE * shares[0])
        return won if fair and won > self.plain_chance else 0.0


def _errors(bench: Bench, metric: Metric, fit: Fit) -> FloatArray:
    """Return whitened errors of all outputs, fitted rows and then those held out."""
    later = settled(fit, bench.later, metric)
    runs = (*fit.errors, *later.errors)
    white = np.concatenate([metric.whitened(e) for e in runs])
    # A start that could not be simulated loses everywhere.
    return np.asarray(np.nan_to_num(white.T.ravel(), nan=1e3), dtype=np.float64)


def _rows(bench: Bench, metric: Metric) -> Rows:
    part, valid = [], []
    for value, runs in ((TRAIN, bench.train), (LATER, bench.later)):
        for run in runs:
            part.append(np.full(run.n_samples, value, dtype=np.int8))
            valid.append(metric.scored(run.outputs))
    n_y = len(metric.sigma)
    total = sum(p.size for p in part)
    block = max(LEAST_BLOCK_ROWS, total // BLOCKS)
    return Rows.of(np.tile(np.concatenate(part), n_y), np.concatenate(valid).T.ravel(), block)


def _winner(
    weigher: _Weigher, accepted: Sequence[Candidate]
) -> tuple[Candidate | None, tuple[Candidate, ...], bool]:
    """Return what is added, its alias set, and whether a term without a name does as well.

    Of the set the one with fewest numbers speaks.
    """
    if not accepted:
        return None, (), False
    best = max(accepted, key=lambda c: c.score)
    pool = [best, *[c for c in accepted if c is not best]]
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
        pool = [best, *[c for c in accepted if c is not best and not c.unnamed]]
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


def _near(weigher: _Weigher, pool: Sequence[Candidate]) -> list[bool]:
    """Tell which of a pool the records cannot tell from its best."""
    errors = [c.errors for c in pool if c.errors is not None]
    return alias_rows(weigher.rows, weigher.base_errors, errors, [c.score for c in pool])


def _corrects_the_same(weigher: _Weigher, candidate: Candidate, best: Candidate) -> bool:
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
        effects = [c.placed if e.key == winner.placed.key else e for e in bench.fit.structure.effects]
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
