"""Candidates of a round: each effect fitted jointly with τ and characteristic, and weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.episodes import errors_on
from comparisons.missing_effect.evidence import Evidence, Rows, evidence_of
from comparisons.missing_effect.fit import Fit, fit_structure, solved
from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.metric import Metric
from comparisons.missing_effect.noise import NoiseModel, noise_of, weights_of
from comparisons.missing_effect.open_terms import with_own_state, with_state
from comparisons.missing_effect.probes import Probe, Prober
from comparisons.missing_effect.structure import Structure
from comparisons.results import evaluate_terms
from surge_core.types import FloatArray

# A score that promises less than this many log-units is not fitted: no threshold is that low.
LEAST_PROMISE = 6.0
LEAST_PROMISE_SHARE = 0.01
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


@dataclass(frozen=True)
class Candidate:
    """A model with something added, fitted to the fitted rows and run on all.

    Parameters
    ----------
    added : tuple of Effect
        What it has that the base has not.
    fit : Fit
        The fit.
    errors : ndarray of shape (n,)
        Whitened errors on all rows.
    evidence : Evidence
        For it, against the base.
    whole : Fit, optional
        A fit to all rows, where the candidate was still in the running.
    whole_errors : ndarray of shape (n,), optional
        Whitened errors of that fit.
    rank : float
        Log-units that it wins on all rows, less half log n a number: what accepted candidates are
        ranked by. Held-out gains decide whether a name is accepted, not which one: of two right
        forms the one with more freedom would lose where few fitted rows lay.
    """

    added: tuple[Effect, ...]
    fit: Fit
    errors: FloatArray
    evidence: Evidence
    whole: Fit | None = None
    whole_errors: FloatArray | None = None
    rank: float = float("-inf")

    @property
    def name(self) -> str:
        """Identifier."""
        return " + ".join(effect.name for effect in self.added)

    @property
    def unnamed(self) -> bool:
        """Whether an open term is part of it."""
        return any(effect.unnamed for effect in self.added)


@dataclass(frozen=True)
class Bench:
    """Records, the model that stands so far, and the metric in which candidates are weighed.

    Parameters
    ----------
    data : LagData
        All records.
    fit : Fit
        Of the model so far, to the fitted rows.
    metric : Metric
        On all rows.
    block_rows : int
        Rows of a block.
    n_names : int
        Names that compete.
    """

    data: LagData
    fit: Fit
    metric: Metric
    block_rows: int
    n_names: int

    @classmethod
    def start(
        cls,
        data: LagData,
        structure: Structure,
        metric: Metric,
        nonlinear: FloatArray,
        block_rows: int,
        n_names: int,
    ) -> Bench:
        """Fit a model and set it on the bench."""
        fit = fit_structure(structure, data.train, metric.on(data.train_rows), [nonlinear])
        return cls(data, fit, metric, block_rows, n_names).with_states()

    def with_states(self) -> Bench:
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

    @property
    def rows(self) -> Rows:
        """Parts and blocks in the metric."""
        return Rows.of(self.data.part, self.metric.rows(self.data) > 0.0, self.block_rows)

    def prober(self) -> Prober:
        """Return the score tests against the model."""
        return Prober(self.fit, self.train, self.train_metric)

    def errors(self, fit: Fit) -> FloatArray:
        """Return whitened errors of a fit on all rows."""
        return errors_on(fit, with_own_state(self.data, fit), self.metric)[0]

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
        if probe.effect.unnamed:
            fit = self._with_own_state(fit)
        return fit

    def _with_own_state(self, fit: Fit) -> Fit:
        data = self.train
        for _ in range(STATE_ROUNDS):
            before = fit.cost
            data = with_state(data, fit)
            fit = fit_structure(fit.structure, data, self.train_metric, [fit.nonlinear])
            if abs(fit.cost - before) < STATE_SETTLED:
                break
        return fit

    def weighed(self, fit: Fit, added: Sequence[Effect], base: FloatArray) -> Candidate:
        """Run a fit on all rows and weigh it against the errors of the model."""
        rows, data = self.rows, with_own_state(self.data, fit)
        errors, phases = errors_on(fit, data, self.metric)
        searched = float(np.prod([effect.searched * self.n_names for effect in added]))
        evidence = evidence_of(
            rows,
            base,
            errors,
            added=fit.n_parameters - self.fit.n_parameters,
            searched=searched,
            episodes=phases,
        )
        if fit.structure.at_end(fit.nonlinear):
            evidence = replace(evidence, at_end=True)
        return Candidate(tuple(added), fit, errors, evidence)

    def everywhere(self) -> Bench:
        """Return the bench with all rows fitted."""
        part = np.zeros(self.data.n_samples, dtype=np.int8)
        data = self.data.with_parts(part).over_all_phi()
        start = self.fit.structure.adapted(data, self.fit.nonlinear)
        fit = fit_structure(self.fit.structure, data, self.metric, [start])
        return replace(self, data=data, fit=fit)

    def ranked(self, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Fit what is still in the running to all rows; return all, best first.

        Parameters
        ----------
        candidates : sequence of Candidate
            Weighed.
        """
        accepted = [c.evidence.score for c in candidates if c.evidence.accepted]
        least = RUNNING_SHARE * max(accepted, default=np.inf)
        every: Bench | None = None
        out = []
        for candidate in candidates:
            if not candidate.evidence.accepted or candidate.evidence.score < least:
                out.append(candidate)
                continue
            every = every or self.everywhere()
            out.append(every.ranked_one(candidate))
        return tuple(sorted(out, key=lambda c: (-c.rank, -c.evidence.score)))

    def ranked_one(self, candidate: Candidate) -> Candidate:
        """Return a candidate with its fit to all rows of this bench, which fits all."""
        whole = self.refitted(candidate.fit)
        price = 0.5 * float(np.log(max(self.rows.n_fitted, 2)))
        added = whole.n_parameters - self.fit.n_parameters
        rank = self.fit.cost - whole.cost - price * added
        errors = whole.errors(with_own_state(self.data, whole), self.metric)
        return replace(candidate, whole=whole, whole_errors=errors, rank=rank)

    def refitted(self, fit: Fit) -> Fit:
        """Return a model fitted again to what this bench fits.

        Parameters
        ----------
        fit : Fit
            Where to start.
        """
        metric = self.train_metric
        data = with_own_state(self.train, fit)
        start = fit.structure.adapted(data, fit.nonlinear)
        start = nudged(fit.structure, data, metric, start)
        whole = fit_structure(fit.structure, data, metric, [start])
        if not any(effect.unnamed for effect in fit.structure.effects):
            return whole
        for _ in range(STATE_ROUNDS):
            before, data = whole.cost, with_own_state(self.train, whole)
            whole = fit_structure(fit.structure, data, metric, [whole.nonlinear])
            if abs(whole.cost - before) < STATE_SETTLED:
                break
        return whole

    def noise(self, fit: Fit) -> NoiseModel:
        """Describe the noise by the errors of a fit on the fitted rows."""
        data = with_own_state(self.train, fit)
        plain = fit.errors(data, Metric())
        return noise_of(plain, data.scored(TRAIN), data, slope_of(fit, data), fit.tau_s)

    def in_metric_of(self, fit: Fit, noise: NoiseModel) -> Bench:
        """Return the bench in the metric that a noise asks for, the model fitted again."""
        plain = errors_on(fit, with_own_state(self.data, fit), Metric())[0]
        if noise.flow is not None:
            whole = replace(noise.flow, slope=slope_of(fit, self.data))
            noise = replace(noise, flow=whole)
        metric = noise.metric(weights_of(plain, noise, self.data))
        again = fit_structure(
            self.fit.structure, self.train, metric.on(self.data.train_rows), [self.fit.nonlinear]
        )
        return replace(self, metric=metric, fit=again).with_states()


def nudged(structure: Structure, data: LagData, metric: Metric, start: FloatArray) -> FloatArray:
    """Return the best of a start and its neighbours, for the thresholds of effects that switch.

    Parameters
    ----------
    structure : Structure
        The model.
    data : LagData
        Rows; where one turns back just at a threshold, no slope leads over the jump.
    metric : Metric
        On these rows.
    start : ndarray of shape (p,)
        log τ and the parameters of the effects.
    """
    trials, at = [start], 1
    reach = data.phi_range[1] - data.phi_range[0]
    for effect in structure.effects:
        for i in effect.free if effect.switches else ():
            for step in NUDGES:
                for sign in (-1.0, 1.0):
                    trial = start.copy()
                    trial[at + i] += sign * step * reach
                    trials.append(trial)
        at += len(effect.nonlinear)
    if len(trials) == 1:
        return start
    return min(trials, key=lambda trial: solved(structure, data, metric, trial).cost)


def slope_of(fit: Fit, data: LagData) -> FloatArray:
    """Return the slope of the base characteristic at each sample, of shape (n,).

    Parameters
    ----------
    fit : Fit
        A fitted model.
    data : LagData
        The rows.
    """
    phi, terms = data.sampled(data["phi"]), list(fit.structure.terms)
    step = 1e-4 * max(float(np.ptp(phi)), 1e-6)
    ahead, behind = evaluate_terms(terms, phi + step), evaluate_terms(terms, phi - step)
    return np.asarray((ahead - behind) @ fit.coefficients[: len(terms)] / (2.0 * step))
