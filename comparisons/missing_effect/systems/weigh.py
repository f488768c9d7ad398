"""How a candidate is weighed: in the metric of its round, in plain errors, and for its growth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.evidence import Rows, block_sums, evidence_of
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.systems.bench import Bench, growth_of, whitened_fit
from comparisons.missing_effect.systems.candidates import Candidate
from comparisons.missing_effect.systems.fit import Fit, settled
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.race import FLIP_SEED
from comparisons.missing_effect.systems.score import Answers, Prober
from surge_core.types import FloatArray

BLOCKS = 60
LEAST_BLOCK_ROWS = 20
# Held-out blocks that lose no more than this share of what the others win speak with one voice.
ONE_SIDED_SHARE = 0.1
# What is won in plain errors alone must be this share of the squared error, on rows fitted and
# held out, and of the latter this share of the former.
LEAST_SLOW_SHARE, HELD_OUT_SHARE = 0.25, 0.5
# By how many powers of e small changes of the state may grow beyond the model without a term.
MOST_GROWTH = 3.0
# Whitened error of a run that ran away.
RAN_AWAY = 1e3


@dataclass(frozen=True)
class Weigher:
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
    ) -> Weigher:
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
        fair = min(shares) > LEAST_SLOW_SHARE and shares[1] > HELD_OUT_SHARE * shares[0]
        return won if fair and won > self.plain_chance else 0.0


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
