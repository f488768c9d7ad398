"""A user's model and its records as the search works on them: places, race, metric, rivals."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from comparisons.missing_effect.engine import Candidate, Policy, Round, System, Tried
from comparisons.missing_effect.evidence import LARGEST_P, Rows, Tie
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.nulls import COLOURED
from comparisons.missing_effect.systems.bench import BETTER_BETWEEN, Bench
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.fit import Fit, settled
from comparisons.missing_effect.systems.metric import Metric, metric_of
from comparisons.missing_effect.systems.places import Placed, SystemEffect
from comparisons.missing_effect.systems.quantities import covariance
from comparisons.missing_effect.systems.race import (
    FLIP_SEED,
    favoured_metric,
    promising,
    raced,
    rejected,
)
from comparisons.missing_effect.systems.score import Prober, placed_effects
from comparisons.missing_effect.systems.shapes import Kind, Map
from comparisons.missing_effect.systems.structure import LAGS, Run, Structure
from surge_core.types import FloatArray

BLOCKS = 60
LEAST_BLOCK_ROWS = 20
# What is won in plain errors alone must be this share of the squared error, on rows fitted and
# held out, and of the latter this share of the former.
LEAST_SLOW_SHARE, HELD_OUT_SHARE = 0.25, 0.5
# What explains this share of what an effect explains, by something else, is its rival.
RIVAL_SHARE = 0.8
# By how many powers of e small changes of the state may grow beyond the model without a term.
MOST_GROWTH = 3.0
# Where what speaks for an effect falls short, if it does by the scatter of its blocks alone.
HELD_OUT_BLOCKS = ("held-out blocks",)
# Names behind which a second is looked for: each costs a race.
MOST_HEADS = 2
# Whitened error of a run that ran away.
RAN_AWAY = 1e3
# Effects that are nothing at the lower bound of their first number.
VANISHING = (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
# Limits of a sensor, and on which side of them readings cannot be.
ENDS = {Map.UPPER: 1.0, Map.LOWER: -1.0}
ModelCandidate = Candidate[Placed, Fit]
ModelRound = Round[Placed, Fit]

# A user's model: model error, and not noise, may rule the errors; a fit costs a second.
MODELS = Policy(
    term=Tie(12.0, 0.02, 2.33, 0.7),
    same_share=0.9,
    same_cosine=0.98,
    one_sided=0.1,
    plain_speaks=True,
    terms_stand=True,
    rival_share=RIVAL_SHARE,
    further_share=0.05,
    further_raw=0.25,
    aliases_refitted=True,
)
# Log-units by which an alias in the place of what was found may cost more than that.
LEAST_LOST = 12.0


@dataclass(frozen=True, eq=False)
class ModelSystem(Bench, System[Placed, Fit]):
    """A user's model on its bench, in the metric of a round or in that of its own errors.

    Of the places that are searched the best wins ``chances`` log-units by chance, in the metric and
    in plain errors.
    """

    metric: Metric | None = None
    n_places: int = 1
    chances: tuple[float, float] = (0.0, 0.0)
    policy: Policy = MODELS

    @property
    def colour(self) -> Metric:
        """The metric."""
        return metric_of(self.fit.errors) if self.metric is None else self.metric

    @cached_property
    def base(self) -> Fit:
        """The model, fitted in the metric."""
        return self.whitened(self.fit, self.colour)

    @cached_property
    def base_errors(self) -> FloatArray:
        """Its whitened errors: all outputs, fitted rows and then those held out."""
        return self._errors(self.colour, self.base)

    @cached_property
    def rows(self) -> Rows:
        """Which rows are fitted and held out, and their blocks."""
        return self._rows(self.colour)

    @cached_property
    def growth(self) -> float:
        """By how many powers of e small changes of the state grow."""
        return self.growth_of(self.fit)

    def tried(
        self, effects: Sequence[SystemEffect], library: Sequence[SystemEffect]
    ) -> Tried[Placed, Fit]:
        """Race what is promising, and fit in the metric of whom the held-out rows favour."""
        fit = self.fit
        placed, refused = placed_effects(fit, self.train, [*effects, *library])
        prober = Prober(fit, self.train, placed)
        raw, white = prober.in_metric(self.raw), prober.in_metric(metric_of(fit.errors))
        fits = raced(self, promising(raw, white, self.late))
        metric, rng = favoured_metric(self, list(fits.values())), np.random.default_rng(FLIP_SEED)
        chances = prober.in_metric(metric).chance(rng), raw.chance(rng)
        tried = [
            Candidate(p.added, self.whitened(first, metric), promised=p.gain, onward=first)
            for p, first in fits.items()
        ]
        keys = {candidate.keys for candidate in tried}
        others = [
            Candidate(p.added, fit, promised=p.gain) for p in white.best() if p.key not in keys
        ]
        system = replace(self, metric=metric, n_places=len(placed), chances=chances)
        return Tried(system, tried, others, refused)

    def heads(self, ranked: Sequence[ModelCandidate]) -> list[ModelCandidate]:
        """Return the names beside which a second may be looked for, best first.

        The held-out blocks alone part on them, or they win a good share of the plain error of the
        rows fitted: what else is missing acts in the others. By itself the rim that the tanks
        spill over won in half of the blocks, and rounding decided on its name.
        """
        least = 0.5 * self._plain[1].n_fitted * float(np.log(1.0 - LEAST_SLOW_SHARE))
        costs = {}
        for c in ranked:
            alone = len(c.added) == 1 and not c.unnamed and not c.evidence.at_end
            cost = np.inf if c.onward is None else c.onward.cost - self.fit.cost
            if alone and (c.evidence.refused_on == HELD_OUT_BLOCKS or cost < least):
                costs[c] = cost
        return sorted(costs, key=costs.__getitem__)[:MOST_HEADS]

    def second(
        self,
        head: ModelCandidate,
        effects: Sequence[SystemEffect],
        known: Collection[frozenset[Hashable]],
    ) -> list[ModelCandidate]:
        """Return a candidate with each second effect that races beside the first."""
        out = []
        for c in self.with_better(head.fit, head.onward).tried(effects, ()).candidates:
            both = Candidate((*head.added, *c.added), c.fit, onward=c.onward)
            if c.onward is not None and len(c.added) == 1 and both.keys not in known:
                out.append(replace(both, fit=self.whitened(c.onward, self.colour)))
        return out

    def errors_of(self, fit: Fit) -> tuple[FloatArray, tuple[float, float]]:
        """Return whitened errors of all outputs; no phase is fitted anywhere."""
        return self._errors(self.colour, fit), (0.0, 0.0)

    def searched(self, added: Sequence[Placed]) -> float:
        """Return how many places were tried."""
        return float(self.n_places)

    def weighed(self, candidate: ModelCandidate) -> ModelCandidate:
        """Return a candidate with its evidence; one that could not be simulated has none."""
        return candidate if candidate.fit.failed else super().weighed(candidate)

    def leaves_nothing(self, candidate: ModelCandidate) -> bool:
        """Tell whether the errors of a candidate are white."""
        return not candidate.fit.failed and not metric_of(candidate.fit.errors).lost

    def judged(self, candidate: ModelCandidate) -> ModelCandidate:
        """Say of a candidate whether it vanished or grows, and what it wins in plain errors."""
        raw = candidate.onward
        wild = raw is not None and self.growth_of(raw) > self.growth + MOST_GROWTH
        ended = wild or any(self._vanished(candidate, i) for i in range(len(candidate.added)))
        ended |= any(is_exceeded(candidate.fit, one, self.train) for one in candidate.added)
        evidence = replace(candidate.evidence, chance=self.chances[0], at_end=ended)
        return replace(
            candidate,
            evidence=evidence,
            slow=self._slow(raw, len(candidate.added)),
            outgrown=_outgrown(candidate),
        )

    def _vanished(self, candidate: ModelCandidate, which: int) -> bool:
        """Tell whether a first number ended at the bound where it is no effect any more.

        A lag or a delay of one sample is the timing offset that every model has, and so is a play
        within its error of nothing, which follows its input late.
        """
        effect, fit = candidate.added[which].effect, candidate.fit
        at = fit.theta.size + SLOTS * (which - len(candidate.added))
        value = float(fit.theta[at])
        if effect.kind not in VANISHING:
            return bool(effect.numbers) and effect.linear and value == 0.0
        least = effect.numbers[0].low * (1.0 + 1e-6)
        if effect.kind == Kind.INPUT_PLAY and value > least:
            least = float(np.sqrt(covariance(fit, self.train, self.colour)[at, at]))
        return value <= least

    def with_winner(self, step: ModelRound) -> Self:
        """Return the model with what a round found, its inputs laid between samples again.

        Or the model alone, where from the winner's numbers it does as well: another optimum.
        """
        assert step.winner is not None
        moved = self.with_better(step.winner.fit, step.winner.onward).between_chosen()
        bare = None if self.found or moved.failed else moved.without_needless(step.winner.added[0])
        other = bare is not None and bare.fit.cost < self.fit.cost - LEAST_LOST
        return bare if bare is not None and other and not bare.found else moved

    def refitted(self, structure: Structure, theta: FloatArray) -> Self:
        """Return it with another model, in the metric of its own errors again."""
        moved = super().refitted(structure, theta)
        return replace(moved, metric=None, n_places=1, chances=(0.0, 0.0))

    def without_needless(self, one: Placed) -> Self | None:
        """Return the model without an effect that those found later made needless.

        One that stood in for what came after wins less than its numbers cost, and its absence
        makes the plain held-out error no larger.
        """
        structure, n = self.fit.structure, sum(np.isfinite(e).sum() for e in self.fit.errors)
        theta = np.delete(self.fit.theta, structure.slots_of(one))
        moved = replace(self.refitted(structure.without(one), theta), white=None)
        lost = self._cost(moved.fit) - self._own_cost
        same = moved.held_out_size() < self.held_out_size() / BETTER_BETWEEN
        needless = same and lost < 0.5 * one.brings * np.log(n)
        return moved if needless else None

    def with_refined(self, plain: Placed, refined: ModelCandidate) -> Self | None:
        """Return it with a refined form for its plain form and all that acts beside that, if alike.

        Alike by the tie of the search, and no worse on held-out rows.
        """
        beside = [one for one in self.found if one is not plain and one.place == plain.place]
        if not beside:
            return None
        moved = self._swapped(plain, refined, beside)
        tie = self.policy.alias
        lost = self._cost(moved.fit) - self._own_cost
        alike = lost < max(tie.gap, tie.share * refined.rank)
        return moved if alike and moved.held_out_size() <= self.held_out_size() else None

    def stand_ins(
        self, one: Placed, step: ModelRound | None, effects: Sequence[SystemEffect]
    ) -> tuple[ModelCandidate, ...]:
        """Return those of a round's alias set that stand in its place beside all else found.

        A rival is rejected where it costs more on the rows fitted and foretells held-out rows
        worse. Fits in the metric of the race do not tell: there a pendulum's gravity and a cubic
        stiffness were 16 log-units apart, and 181 in that of the model's own errors.
        """
        if step is None or step.winner is None or step.winner.added[0].key != one.key:
            return ()
        found = [placed.key for placed in self.found]
        others = [c for c in step.aliases[1:] if len(c.added) == 1 and c.added[0].key not in found]
        return (step.winner, *(c for c in others if self._stands_for(one, c)))

    def _stands_for(self, one: Placed, other: ModelCandidate) -> bool:
        """Tell whether a candidate does as well as what was found, on either part of the rows.

        Around a black box lags begin in balance, of the input or the reading: that decides nothing.
        """
        kinds = {one.effect.kind, other.added[0].effect.kind}
        if self.fit.structure.model.simulate and kinds == {*LAGS}:
            return True
        moved = self._swapped(one, other)
        close = self._cost(moved.fit) < self._own_cost + LEAST_LOST
        return close or moved.held_out_size() < self.held_out_size()

    def _swapped(self, one: Placed, other: ModelCandidate, less: Sequence[Placed] = ()) -> Self:
        """Return the model with a candidate in the place of what was found, and without others."""
        structure, theta = self.fit.structure, self.fit.theta.copy()
        theta[structure.slots_of(one)] = other.fit.theta[-SLOTS:]
        for gone in less:
            theta = np.delete(theta, structure.slots_of(gone))
            structure = structure.without(gone)
        effects = tuple(other.added[0] if e.key == one.key else e for e in structure.effects)
        there = replace(structure, effects=effects)
        # What was fitted beside others, which later became needless, has their numbers, too.
        beside = len(effects) > 1 or len(other.fit.structure.effects) > 1
        if beside or other.onward is None:
            return replace(self.refitted(there, theta), white=None)
        ends = (replace(fit, structure=there) for fit in (other.fit, other.onward))
        return self.with_better(*ends)

    def rejected(self, winner: ModelCandidate, rival: ModelCandidate) -> float:
        """Return the chance of a winner's advantage if its rival were the truth (Cox)."""
        rng = np.random.default_rng(FLIP_SEED)
        return rejected(winner.fit, rival.fit, self.raced(), self.colour, rng)

    def _cost(self, fit: Fit) -> float:
        """Return what a raw fit costs in the metric of the model's own errors."""
        return replace(self, white=None).whitened(fit, metric_of(self.fit.errors)).cost

    @cached_property
    def _own_cost(self) -> float:
        """What the model itself costs there."""
        return self._cost(self.fit)

    @cached_property
    def _plain(self) -> tuple[Metric, Rows, FloatArray]:
        """The raw metric with the size of the model's errors, its rows, and those errors."""
        plain = self.raw.with_size_of(self.fit.errors)
        return plain, self._rows(plain), self._errors(plain, self.fit)

    def _slow(self, raw: Fit | None, effects: int) -> float:
        """Return the log-units that effects win in plain errors; 0 where chance wins as much.

        Chance is that of the best of single effects, once for each.

        Slow errors weigh next to nothing once they are whitened, and yet they are what a
        simulation is judged by.
        """
        if raw is None or raw.failed:
            return 0.0
        plain, rows, before = self._plain
        gain = 0.5 * (before**2 - self._errors(plain, raw) ** 2)
        shares = []
        for part in (TRAIN, LATER):
            here = rows.of_part(part)
            base = 0.5 * float(np.sum(before[here] ** 2))
            shares.append(float(gain[here].sum()) / base)
        won = float(gain[rows.valid].sum())
        fair = min(shares) > LEAST_SLOW_SHARE and shares[1] > HELD_OUT_SHARE * shares[0]
        return won if fair and won > effects * self.chances[1] else 0.0

    def _errors(self, metric: Metric, fit: Fit) -> FloatArray:
        """Return whitened errors of all outputs, fitted rows and then those held out."""
        later = settled(fit, self.later, metric)
        runs = (*fit.errors, *later.errors)
        with np.errstate(invalid="ignore"):
            white = np.concatenate([metric.whitened(e) for e in runs])
        # A run that could not be simulated loses everywhere.
        return np.asarray(np.where(np.isfinite(white), white, RAN_AWAY).T.ravel(), dtype=np.float64)

    def _rows(self, metric: Metric) -> Rows:
        part, valid = [], []
        for value, runs in ((TRAIN, self.train), (LATER, self.later)):
            for run in runs:
                part.append(np.full(run.n_samples, value, dtype=np.int8))
                valid.append(metric.scored(run.outputs))
        n_y = len(metric.sigma)
        total = sum(p.size for p in part)
        block = max(LEAST_BLOCK_ROWS, total // BLOCKS)
        return Rows.of(np.tile(np.concatenate(part), n_y), np.concatenate(valid).T.ravel(), block)


def is_exceeded(fit: Fit, placed: Placed, runs: Sequence[Run]) -> bool:
    """Tell whether readings lie beyond a sensor's limit by more than the noise behind it.

    That is no more than what is new in each sample, or twice as much where it is coloured. Of an
    actuator 86 of 512 readings were above a "limit", the largest by 24 times the noise.
    """
    from scipy.stats import chi2

    if placed.effect.kind != Kind.OUTPUT_MAP or placed.effect.code not in ENDS or fit.failed:
        return False
    limit = float(fit.theta[fit.structure.slots_of(placed)[0]]) * placed.scales[1]
    read = np.concatenate([run.outputs[:, placed.place.at] for run in runs])
    beyond = ENDS[Map(placed.effect.code)] * (read - limit)
    noise = COLOURED * metric_of(fit.errors).sigma[placed.place.at]
    over = beyond[beyond > 0.0] / noise
    return bool(chi2.sf(np.sum(over**2), over.size) < LARGEST_P)


def _outgrown(candidate: ModelCandidate) -> bool:
    """Tell whether a shape ended at its upper bound: what is there is something wider."""
    effect = candidate.added[0].effect
    if not effect.simple_form_of or len(candidate.added) > 1:
        return False
    shapes = candidate.fit.theta[-SLOTS:][1 : len(effect.numbers)]
    bounds = [number.high for number in effect.numbers[1:]]
    return any(value >= high * (1.0 - 1e-6) for value, high in zip(shapes, bounds, strict=True))
