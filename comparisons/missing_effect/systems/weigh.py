"""How a candidate is weighed: in the metric of its round, in plain errors, and for its growth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.engine import Candidate, Policy, Round, Weigher
from comparisons.missing_effect.evidence import Rows, Tie
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.systems.bench import Bench, growth_of, whitened_fit
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.fit import Fit, settled
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.race import FLIP_SEED
from comparisons.missing_effect.systems.score import Answers, Probe, Prober
from comparisons.missing_effect.systems.shapes import Kind
from surge_core.types import FloatArray

BLOCKS = 60
LEAST_BLOCK_ROWS = 20
# What is won in plain errors alone must be this share of the squared error, on rows fitted and
# held out, and of the latter this share of the former.
LEAST_SLOW_SHARE, HELD_OUT_SHARE = 0.25, 0.5
# By how many powers of e small changes of the state may grow beyond the model without a term.
MOST_GROWTH = 3.0
# Whitened error of a run that ran away.
RAN_AWAY = 1e3
# Effects that are nothing at the lower bound of their first number.
VANISHING = (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
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
    rival_share=0.8,
    further_share=0.05,
    further_raw=0.25,
)


@dataclass(frozen=True)
class ModelWeigher(Weigher[Placed, Fit]):
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
    policy: Policy = MODELS

    @classmethod
    def of(
        cls, bench: Bench, metric: Metric, placed: Sequence[Placed], prober: Prober, raw: Answers
    ) -> ModelWeigher:
        """Fit the model of the bench in a metric, with the chance of the best candidate."""
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

    @property
    def order(self) -> dict[str, int]:
        """Places of the names in the catalogue."""
        return {name: i for i, name in enumerate(dict.fromkeys(self.names))}

    def candidate(self, probe: Probe, fit: Fit) -> ModelCandidate:
        """Return what came out of the race, fitted in the metric of the round."""
        white = whitened_fit(self.bench, fit, self.metric)
        return Candidate(probe.added, white, promised=probe.gain, onward=fit)

    def errors_of(self, fit: Fit) -> tuple[FloatArray, tuple[float, float]]:
        """Return whitened errors of all outputs; no phase is fitted anywhere."""
        return _errors(self.bench, self.metric, fit), (0.0, 0.0)

    def searched(self, added: Sequence[Placed]) -> float:
        """Return how many places were tried."""
        return float(len(self.names))

    def weighed(self, candidate: ModelCandidate) -> ModelCandidate:
        """Return a candidate with its evidence; one that could not be simulated has none."""
        return candidate if candidate.fit.failed else super().weighed(candidate)

    def judged(self, candidate: ModelCandidate) -> ModelCandidate:
        """Say of a candidate whether it vanished or grows, and what it wins in plain errors."""
        raw = candidate.onward
        wild = raw is not None and growth_of(raw, self.bench) > self.growth + MOST_GROWTH
        ended = wild or any(_vanished(candidate, i) for i in range(len(candidate.added)))
        evidence = replace(candidate.evidence, chance=self.chance, at_end=ended)
        return replace(
            candidate, evidence=evidence, slow=self._slow(raw), outgrown=_outgrown(candidate)
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
        fair = min(shares) > LEAST_SLOW_SHARE and shares[1] > HELD_OUT_SHARE * shares[0]
        return won if fair and won > self.plain_chance else 0.0


def _vanished(candidate: ModelCandidate, which: int) -> bool:
    """Tell whether a first number ended at the bound where it is no effect any more.

    A lag or a delay of one sample is the timing offset that every model has.
    """
    effect = candidate.added[which].effect
    if not effect.numbers:
        return False
    value = float(candidate.fit.theta[SLOTS * (which - len(candidate.added))])
    if effect.linear:
        return value == 0.0
    return effect.kind in VANISHING and value <= effect.numbers[0].low * (1.0 + 1e-6)


def _outgrown(candidate: ModelCandidate) -> bool:
    """Tell whether a shape ended at its upper bound: what is there is something wider."""
    effect = candidate.added[0].effect
    if not effect.simple_form_of or len(candidate.added) > 1:
        return False
    shapes = candidate.fit.theta[-SLOTS:][1 : len(effect.numbers)]
    bounds = [number.high for number in effect.numbers[1:]]
    return any(value >= high * (1.0 - 1e-6) for value, high in zip(shapes, bounds, strict=True))


def _errors(bench: Bench, metric: Metric, fit: Fit) -> FloatArray:
    """Return whitened errors of all outputs, fitted rows and then those held out."""
    later = settled(fit, bench.later, metric)
    runs = (*fit.errors, *later.errors)
    with np.errstate(invalid="ignore"):
        white = np.concatenate([metric.whitened(e) for e in runs])
    # A run that could not be simulated loses everywhere.
    return np.asarray(np.where(np.isfinite(white), white, RAN_AWAY).T.ravel(), dtype=np.float64)


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
