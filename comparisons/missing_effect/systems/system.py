"""A user's model and its records as the search works on them: places, race, metric, rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from comparisons.missing_effect.engine import Laid, Policy, System
from comparisons.missing_effect.systems.bench import BETTER_BETWEEN, Bench, whitened_fit
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import Metric, metric_of
from comparisons.missing_effect.systems.places import Placed, SystemEffect
from comparisons.missing_effect.systems.placing import placed_effects
from comparisons.missing_effect.systems.race import FLIP_SEED, favoured_metric, promising, raced
from comparisons.missing_effect.systems.rivals import rejected
from comparisons.missing_effect.systems.score import Answers, Probe, Prober
from comparisons.missing_effect.systems.weigh import (
    MODELS,
    ModelCandidate,
    ModelRound,
    ModelWeigher,
)
from surge_core.types import IntArray

# Log-units by which an alias in the place of what was found may cost more than that.
LEAST_LOST = 12.0


@dataclass(frozen=True, eq=False, kw_only=True)
class LaidPlaces(Laid):
    """Effects at all their places, and their columns."""

    placed: Sequence[Placed]
    prober: Prober
    raw: Answers


@dataclass(frozen=True, eq=False)
class ModelSystem(System[Placed, Fit]):
    """A user's model.

    Parameters
    ----------
    bench : Bench
        The model that stands so far, and the records.
    """

    bench: Bench
    policy: Policy = MODELS

    @property
    def fit(self) -> Fit:
        """The model, in the raw metric."""
        return self.bench.fit

    @property
    def failed(self) -> bool:
        """Whether the model could not be simulated."""
        return self.bench.fit.failed

    def laid(self, effects: Sequence[SystemEffect], library: Sequence[SystemEffect]) -> LaidPlaces:
        """Lay effects at all their places along the run, once for all metrics."""
        fit, train = self.bench.fit, self.bench.train
        placed, refused = placed_effects(fit, train, [*effects, *library])
        prober = Prober(fit, train)
        raw = prober.laid(placed, self.bench.raw)
        white = prober.laid(placed, metric_of(fit.errors))
        return LaidPlaces(
            effects,
            promising(raw, white),
            white.best(),
            refused,
            placed=placed,
            prober=prober,
            raw=raw,
        )

    def raced(self, laid: Laid) -> list[tuple[Probe, Fit]]:
        """Fit what is promising in the raw metric: a few steps, and the finalists to the end."""
        return raced(self.bench, laid.promising)

    def weigher(
        self, laid: Laid, fits: Sequence[tuple[Probe, Fit]]
    ) -> tuple[ModelSystem, ModelWeigher]:
        """Take the metric of the candidate that held-out rows favour."""
        assert isinstance(laid, LaidPlaces)
        metric = favoured_metric(self.bench, [fit for _, fit in fits])
        of = ModelWeigher.of(self.bench, metric, laid.placed, laid.prober, laid.raw)
        return self, of

    def with_winner(self, step: ModelRound) -> ModelSystem:
        """Return the model with what a round found, its inputs laid anew between samples."""
        assert step.winner is not None
        moved = self.bench.with_winner(step.winner.fit, step.winner.onward)
        return replace(self, bench=moved.between_chosen())

    def without_needless(self, one: Placed) -> ModelSystem | None:
        """Return the model without an effect that those found later made needless.

        One that stood in for what came after wins less than its numbers cost, and its absence
        makes the plain held-out error no larger.
        """
        bench, structure = self.bench, self.bench.fit.structure
        moved = bench.refitted(structure.without(one), np.delete(bench.fit.theta, self._slots(one)))
        moved = replace(moved, white=None)
        lost = whitened_fit(moved, moved.fit, self._metric).cost - self._cost
        n = sum(np.count_nonzero(np.isfinite(errors)) for errors in bench.fit.errors)
        same = moved.held_out_size() < self.held_out_size() / BETTER_BETWEEN
        needless = same and lost < 0.5 * one.brings * np.log(n)
        return replace(self, bench=moved) if needless else None

    def stand_ins(
        self, one: Placed, step: ModelRound | None, effects: Sequence[SystemEffect]
    ) -> tuple[ModelCandidate, ...]:
        """Return those of a round's alias set that stand beside all that was found later."""
        found = [placed.key for placed in self.found]
        if step is None or step.winner is None or step.winner.added[0].key != one.key:
            return ()
        kept = [step.winner]
        for c in step.aliases[1:]:
            if len(c.added) > 1 or c.added[0].key in found:
                continue
            effects_then = [c.added[0] if e.key == one.key else e for e in self.found]
            structure = replace(self.fit.structure, effects=tuple(effects_then))
            theta = self.fit.theta.copy()
            theta[self._slots(one)] = c.fit.theta[-SLOTS:]
            swapped = self.bench.refitted(structure, theta)
            there = whitened_fit(replace(self.bench, white=None), swapped.fit, self._metric)
            if there.cost < self._cost + LEAST_LOST:
                kept.append(c)
        return tuple(kept)

    def rejected(
        self, winner: ModelCandidate, rival: ModelCandidate, weigher: ModelWeigher
    ) -> float:
        """Return the chance of a winner's advantage if its rival were the truth (Cox)."""
        rng = np.random.default_rng(FLIP_SEED)
        return rejected(winner.fit, rival.fit, self.bench.raced(), weigher.metric, rng)

    def held_out_size(self) -> float:
        """Return the plain error on held-out rows."""
        return self.bench.held_out_size()

    def _slots(self, one: Placed) -> IntArray:
        """Return where in θ the numbers of an effect are."""
        keys = [placed.key for placed in self.found]
        first = self.fit.theta.size - SLOTS * len(keys)
        return first + SLOTS * keys.index(one.key) + np.arange(SLOTS)

    @cached_property
    def _metric(self) -> Metric:
        return metric_of(self.fit.errors)

    @cached_property
    def _cost(self) -> float:
        """Cost of the model in the metric of its own errors, from its raw fit."""
        return whitened_fit(replace(self.bench, white=None), self.fit, self._metric).cost
