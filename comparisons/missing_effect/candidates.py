"""A lag series as the search works on it: each effect fitted jointly with τ and characteristic."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.engine import Candidate, Policy, Round, System, Tried
from comparisons.missing_effect.evidence import Rows, Tie
from comparisons.missing_effect.fit import Fit, Structure, errors_on, fit_structure, solved
from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.noise import Metric, NoiseModel, noise_of, weights_of
from comparisons.missing_effect.open_terms import with_own_state, with_state
from comparisons.missing_effect.probes import LEFTOVER_P, Leftover, Probe, Prober, leftover_of
from comparisons.results import evaluate_terms
from surge_core.types import BoolArray, FloatArray

# A score that promises less than this many log-units is not fitted: no threshold is that low.
LEAST_PROMISE = 6.0
LEAST_PROMISE_SHARE = 0.01
MOST_OPEN_FITS = 3
# Second effects that are tried beside a first one.
PAIR_TAILS = 3
# A ripple brings two columns an episode, and the best of many frequencies always looks like
# something: it is fitted when it is no chance, and not a part of what another explains better.
LARGEST_CHANCE = 0.01
# Open terms follow the state that they themselves change.
STATE_ROUNDS = 8
# Steps of a threshold beside the one found, as shares of the range of φ: where φ turns back at a
# threshold the likelihood jumps, and between such places it is flat.
NUDGES = (1e-4, 5e-4, 2e-3, 7e-3, 2e-2, 4e-2)
MOST_NUDGES = 3
# A candidate whose score is below this share of the best one's is not fitted to all rows.
RUNNING_SHARE = 0.5
STATE_SETTLED = 0.1
# Rows of a series are many and their noise is white or known: a few log-units part two models.
SERIES = Policy(term=Tie(6.0, 0.0, 3.0, -1.0), stops_clean=True)

LagCandidate = Candidate[Effect, Fit]
LagRound = Round[Effect, Fit]


@dataclass(frozen=True)
class Bench(System[Effect, Fit]):
    """Records, the model that stands so far, and the metric in which candidates are weighed.

    The fit is to the fitted rows, the metric one on all rows; ``block_rows`` are the rows of a
    block, ``n_names`` the names that compete.
    """

    data: LagData
    fit: Fit
    metric: Metric
    block_rows: int
    n_names: int
    policy: Policy = SERIES

    @classmethod
    def start(
        cls,
        data: LagData,
        structure: Structure,
        metric: Metric,
        starts: Sequence[FloatArray],
        block_rows: int,
        n_names: int,
    ) -> Self:
        """Fit a model from the best of several starts, and set it on the bench."""
        fit = fit_structure(structure, data.train, metric.on(data.train_rows), starts)
        return cls(data, fit, metric, block_rows, n_names).with_states()

    def with_states(self) -> Self:
        """Return the bench with the state that open terms need, as its model simulates it."""
        return replace(self, data=with_state(self.data, self.fit))

    @property
    def train(self) -> LagData:
        """What is fitted."""
        return self.data.train

    @property
    def train_metric(self) -> Metric:
        """The metric on what is fitted."""
        return self.metric.on(self.data.train_rows)

    @cached_property
    def rows(self) -> Rows:
        """Parts and blocks in the metric."""
        return Rows.of(self.data.part, self.metric.rows(self.data) > 0.0, self.block_rows)

    def prober(self) -> Prober:
        """Return the score tests against the model."""
        return Prober(self.fit, self.train, self.train_metric)

    @cached_property
    def base_errors(self) -> FloatArray:
        """Whitened errors of the model on all rows."""
        return self.errors_of(self.fit)[0]

    def promising(self, probes: Sequence[Probe], most: int | None = None) -> list[Probe]:
        """Return the probes that are worth a fit, best first."""
        best = max((probe.gain for probe in probes), default=0.0)
        least = max(LEAST_PROMISE, LEAST_PROMISE_SHARE * best)
        kept = [
            p
            for p in probes
            if p.gain > least + 0.5 * p.degrees
            and p.starts
            and not (p.effect.episodes and (p.chance > LARGEST_CHANCE or p.gain < 0.5 * best))
        ]
        kept.sort(key=lambda p: 0.5 * p.degrees * np.log(self.train.n_samples) - p.gain)
        return kept[:most]

    def fitted(self, probe: Probe) -> Fit:
        """Fit the model with the effect of a probe, from the starts that it suggests."""
        structure = self.fit.structure.with_effect(probe.effect)
        starts = [np.concatenate([self.fit.nonlinear, start]) for start in probe.starts]
        fit = fit_structure(structure, self.train, self.train_metric, starts)
        for _ in range(MOST_NUDGES if probe.effect.switches else 0):
            beside = nudged(structure, self.train, self.train_metric, fit.nonlinear)
            if beside is fit.nonlinear:
                break
            fit = fit_structure(structure, self.train, self.train_metric, [beside])
        return self._settled(fit, carried=True) if probe.effect.unnamed else fit

    def _settled(self, fit: Fit, *, carried: bool) -> Fit:
        """Return a fit whose terms without a name follow the state that it simulates itself.

        That state is carried on from round to round, or begins at that of the model on the bench.
        """
        data = self.train
        for _ in range(STATE_ROUNDS if any(e.unnamed for e in fit.structure.effects) else 0):
            before, data = fit.cost, with_state(data if carried else self.train, fit)
            fit = fit_structure(fit.structure, data, self.train_metric, [fit.nonlinear])
            if abs(fit.cost - before) < STATE_SETTLED:
                break
        return fit

    def everywhere(self) -> Bench:
        """Return the bench with all rows fitted."""
        data = self.data.all_fitted().over_all_phi()
        start = self.fit.structure.adapted(data, self.fit.nonlinear)
        fit = fit_structure(self.fit.structure, data, self.metric, [start])
        return replace(self, data=data, fit=fit)

    def refitted(self, fit: Fit) -> Fit:
        """Return a model fitted again to what this bench fits."""
        whole = _refit(fit, self.train, self.train_metric)
        return self._settled(whole, carried=False)

    def on_all_rows(self, fit: Fit) -> Fit:
        """Return a model fitted again, to the fitted and the held-out rows alike."""
        return _refit(fit, self.data.over_all_phi(), self.metric)

    def noise(self, fit: Fit) -> NoiseModel:
        """Describe the noise by the errors of a fit on the fitted rows."""
        data = with_own_state(self.train, fit)
        plain = fit.errors(data, Metric())
        return noise_of(plain, data.scored(TRAIN), data, slope_of(fit, data), fit.tau_s)

    @property
    def own_noise(self) -> NoiseModel:
        """The noise by the errors of the model itself."""
        return self.noise(self.fit)

    @cached_property
    def left(self) -> FloatArray:
        """Plain errors of the model on all rows; held-out ones are by a fit to others."""
        return errors_on(self.fit, self.data, Metric())[0]

    @property
    def held(self) -> BoolArray:
        """Rows that were held out."""
        held: BoolArray = self.data.scored() & (self.data.part != TRAIN)
        return held

    def in_metric_of(self, fit: Fit, noise: NoiseModel) -> Self:
        """Return the bench in the metric that a noise asks for, the model fitted again."""
        plain = errors_on(fit, with_own_state(self.data, fit), Metric())[0]
        noise = over_rows(noise, fit, self.data)
        return self._in_metric(noise.metric(weights_of(plain, noise, self.data)))

    def _in_metric(self, metric: Metric) -> Self:
        """Return the bench in another metric, the model fitted again."""
        again = fit_structure(
            self.fit.structure, self.train, metric.on(self.data.train_rows), [self.fit.nonlinear]
        )
        return replace(self, metric=metric, fit=again).with_states()

    def where_known(self, fits: Sequence[Fit]) -> Self:
        """Return the bench on rows whose φ is known to all of several fits, however late it acts.

        Scored with φ held at its first value, rows of a true delay of 6 ms stood at 4 to 6 standard
        deviations, and its name was called provisional for them.
        """
        data = self.data
        for fit in fits:
            data = data.with_known(fit.structure.late_s(fit.nonlinear))
        if np.array_equal(data.weight, self.data.weight):
            return self
        return replace(self, data=data)._in_metric(self.metric)

    def without(self, effect: Effect) -> Bench:
        """Return the bench with one effect taken out of its model and the rest fitted again."""
        bare = self.fit.without(effect)
        fit = fit_structure(bare.structure, self.train, self.train_metric, [bare.nonlinear])
        return replace(self, fit=fit).with_states()

    def tried(self, effects: Sequence[Effect], library: Sequence[Effect]) -> Tried[Effect, Fit]:
        """Fit all that promises something to the end, in the metric of the best."""
        prober = self.prober()
        probes = self.promising(prober.probes(effects))
        probes += self.promising(prober.probes(library), MOST_OPEN_FITS)
        fits = [self.fitted(probe) for probe in probes]
        price = 0.5 * float(np.log(self.train.n_samples))
        best = min([*fits, self.fit], key=lambda fit: fit.cost + price * fit.n_parameters)
        known = self.where_known([*fits, self.fit])
        noise = known.noise(known._with_ripple(best, effects))
        moved = known.in_metric_of(best, noise)
        own = [(fit.nonlinear[self.fit.nonlinear.size :],) for fit in fits]
        again = [replace(p, starts=start) for p, start in zip(probes, own, strict=True)]
        fits = [moved.fitted(probe) for probe in again]
        return Tried(moved, [p.candidate(f) for p, f in zip(probes, fits, strict=True)])

    def _with_ripple(self, best: Fit, effects: Sequence[Effect]) -> Fit:
        """Return the best fit with a ripple beside it where its errors hold one.

        An autoregression would take a line of the spectrum for the colour of the noise.
        """
        ripple = next((effect for effect in effects if effect.episodes), None)
        if ripple is None or any(e.episodes or e.unnamed for e in best.structure.effects):
            return best
        moved = replace(self, fit=best)
        probe = moved.prober().probe(ripple)
        least = probe.degrees * np.log(self.train.n_samples)
        return moved.fitted(probe) if probe.chance < LEFTOVER_P and probe.gain > least else best

    def errors_of(self, fit: Fit) -> tuple[FloatArray, tuple[float, float]]:
        """Return whitened errors on all rows, and what phases fitted there cost."""
        return errors_on(fit, with_own_state(self.data, fit), self.metric)

    def searched(self, added: Sequence[Effect]) -> float:
        """Return how many trials the search for effects was worth, all names counted."""
        return float(np.prod([effect.searched * self.n_names for effect in added]))

    def judged(self, candidate: LagCandidate) -> LagCandidate:
        """Return a candidate with whether τ ran to the end of its search; not ranked yet."""
        fit = candidate.fit
        evidence = replace(candidate.evidence, at_end=fit.structure.at_end(fit.nonlinear))
        return replace(candidate, evidence=evidence, rank=-np.inf)

    def ranked(self, candidates: Sequence[LagCandidate]) -> tuple[LagCandidate, ...]:
        """Fit what is still in the running to all rows; return all, best first.

        Accepted candidates are ranked by the log-units that they win on all rows, less half log n
        a number. Held-out gains decide whether a name is accepted, not which one: of two right
        forms the one with more freedom would lose where few fitted rows lay.
        """
        accepted = [c for c in candidates if c.accepted]
        least = RUNNING_SHARE * max((c.evidence.score for c in accepted), default=np.inf)
        running = [c for c in accepted if c.evidence.score >= least]
        every = self.everywhere() if running else self
        out = [_on_all_rows(every, c) if c in running else c for c in candidates]
        return tuple(sorted(out, key=lambda c: (-c.rank, -c.evidence.score)))

    def second(
        self, head: LagCandidate, effects: Sequence[Effect], known: Collection[frozenset[Hashable]]
    ) -> list[LagCandidate]:
        """Return a candidate with each second effect that its errors ask for."""
        there = replace(self, fit=head.fit)
        return [
            Candidate((head.added[0], probe.effect), there.fitted(probe))
            for probe in there.promising(there.prober().probes(effects), PAIR_TAILS)
            if head.keys | {probe.effect.key} not in known
        ]

    def leftover(
        self, winner: LagCandidate | None, effects: Sequence[Effect], library: Sequence[Effect]
    ) -> Leftover:
        """Test the errors of the model, or of a winner, for what could still explain them."""
        every = self.everywhere()
        if winner is not None:
            every = replace(every, fit=winner.onward or every.refitted(winner.fit))
        return leftover_of(every.with_states().prober(), self.data.part, effects, library)

    def with_winner(self, step: LagRound) -> Bench:
        """Return the model with what a round found."""
        assert step.winner is not None
        return replace(self, fit=step.winner.fit).with_states().where_known([step.winner.fit])

    def without_needless(self, one: Effect) -> Bench | None:
        """Return the model without an effect that stood in for what came after."""
        return None if self.stand_ins(one, None, [one]) else self.without(one)

    def stand_ins(
        self, one: Effect, step: LagRound | None, effects: Sequence[Effect]
    ) -> tuple[LagCandidate, ...]:
        """Take one effect out of the model and see which others would do in its place."""
        without = self.without(one)
        probes = without.promising(without.prober().probes([one] if one.unnamed else effects))
        tried = [without.weighed(p.candidate(without.fitted(p))) for p in probes]
        accepted = [c for c in without.ranked(tried) if c.accepted]
        own = next((c for c in accepted if c.name == one.name), None)
        if own is None:
            return ()
        others = [c for c in accepted if c is not own and min(c.rank, own.rank) > -np.inf]
        return (own, *without.near(own, others, self.policy.alias))


def _refit(fit: Fit, data: LagData, metric: Metric) -> Fit:
    """Return a model fitted again to all of some rows, from where it is or a little beside."""
    data, structure = with_own_state(data, fit), fit.structure
    start = nudged(structure, data, metric, structure.adapted(data, fit.nonlinear))
    return fit_structure(structure, data, metric, [start])


def refitted_on(fit: Fit, data: LagData, metric: Metric) -> Fit:
    """Return a model fitted again to all of some rows, its terms without a name settled."""
    return Bench(data, fit, metric, 1, 1).refitted(fit)


def _on_all_rows(every: Bench, candidate: LagCandidate) -> LagCandidate:
    """Return a candidate with its fit to all rows of a bench that fits all, and its rank."""
    whole = every.refitted(candidate.fit)
    price = 0.5 * float(np.log(max(every.rows.n_fitted, 2)))
    rank = every.fit.cost - whole.cost - price * (whole.n_parameters - every.fit.n_parameters)
    errors = whole.errors(with_own_state(every.data, whole), every.metric)
    return replace(candidate, onward=whole, errors=errors, rank=rank)


def nudged(structure: Structure, data: LagData, metric: Metric, start: FloatArray) -> FloatArray:
    """Return the best of a start and its neighbours, for the thresholds of effects that switch.

    Where a row turns back just at a threshold, no slope leads over the jump.
    """
    trials = [start, *(moved for _, _, moved in structure.beside(data, start, NUDGES))]
    if len(trials) == 1:
        return start
    return min(trials, key=lambda trial: solved(structure, data, metric, trial).cost)


def over_rows(noise: NoiseModel, fit: Fit, data: LagData) -> NoiseModel:
    """Return a noise on φ with the slope of the characteristic over other rows."""
    if noise.flow is None:
        return noise
    return replace(noise, flow=replace(noise.flow, slope=slope_of(fit, data)))


def slope_of(fit: Fit, data: LagData) -> FloatArray:
    """Return the slope of the base characteristic at each sample, of shape (n,)."""
    phi, terms = data.sampled(data["phi"]), list(fit.structure.terms)
    step = 1e-4 * max(float(np.ptp(phi)), 1e-6)
    ahead, behind = evaluate_terms(terms, phi + step), evaluate_terms(terms, phi - step)
    return np.asarray((ahead - behind) @ fit.coefficients[: len(terms)] / (2.0 * step))
