"""The search: which effect, at which place, a user's model lacks.

One formulation for every system. The colour of the errors is taken from the best candidate, never
from the model that lacks it, which would whiten the effect away. In that metric all candidates
are fitted again and weighed on the rows fitted and on those held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.records import FloatArray
from comparisons.missing_effect.evidence import Evidence, Rows, alias_rows, evidence_of
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.fit import Fit, fit_runs, settled
from comparisons.missing_effect.systems.metric import Metric, metric_of, raw_metric
from comparisons.missing_effect.systems.places import Placed, SystemEffect
from comparisons.missing_effect.systems.records import Records, runs_of
from comparisons.missing_effect.systems.score import Probe, Prober, placed_effects
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import FIRST_TOLERANCE, Run, Structure

__all__ = ["Bench", "Candidate", "Round", "base_bench", "search_round"]

# Effects that are nothing at the lower bound of their first number.
VANISHING = (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
# Candidates that are fitted: the most promising of each metric, as long as they promise a
# hundredth of the best and more than chance.
MOST_FITTED = 6
# Steps of the first lap, those that go on by either count, and steps to the end.
FIRST_LAP, FINALISTS, MOST_ITERATIONS = 3, 4, 15
# Steps in a whitening metric, whose valleys are narrow and bent.
MOST_WHITENED = 20
LEAST_PROMISE, LEAST_PROMISE_SHARE = 6.0, 0.01
BLOCKS = 60
LEAST_BLOCK_ROWS = 20
INTERPOLATIONS = ("cubic", "linear", "band", "held")
# Another way between samples is taken only when the raw held-out error falls to this share, or
# when it stays within as much and the whitened one wins so many log-units.
BETTER_BETWEEN, BETTER_WHITE = 0.995, 10.0
# The integrator's tolerance as a share of what is new in each error over the output's swing.
TOLERANCE_SHARE, LEAST_TOLERANCE = 0.15, 1e-9
# Timing offsets that the whitened errors ask for may cost this much of the raw held-out error.
BETTER_TIMED = 0.95
# Rows of each record, and steps of the search, for the way between samples.
FITTED_BETWEEN, HELD_OUT_BETWEEN, STEPS_BETWEEN = 4000, 2000, 8
# An open term takes the place of a name only when it is better by this much.
UNNAMED_GAP = 12.0
UNNAMED_SHARE = 0.02
# A plain form speaks for a refined one where it wins this share of what that wins.
SIMPLE_SHARE = 0.9


@dataclass(frozen=True)
class Candidate:
    """One effect at one place, fitted and weighed.

    Parameters
    ----------
    placed : Placed
        The effect.
    probe : Probe
        What the score test promised.
    fit : Fit or None
        To the rows fitted, in the metric of the round; None where it was not promising.
    errors : ndarray or None
        Whitened errors, fitted rows before held-out ones.
    evidence : Evidence or None
        For it.
    """

    placed: Placed
    probe: Probe
    fit: Fit | None = None
    errors: FloatArray | None = None
    evidence: Evidence | None = None

    @property
    def score(self) -> float:
        """Its score; minus infinity where it was not fitted."""
        return -np.inf if self.evidence is None else self.evidence.score

    @property
    def accepted(self) -> bool:
        """Whether fitted and held-out rows both speak for it, and it did not vanish."""
        return self.evidence is not None and self.evidence.accepted and not self.vanished

    @property
    def vanished(self) -> bool:
        """Whether its first number ended at the bound where it is no effect any more.

        A lag or a delay of one sample is the timing offset that every model has.
        """
        numbers = self.placed.effect.numbers
        if self.fit is None or self.placed.effect.linear or not numbers:
            return False
        value = float(self.fit.theta[-SLOTS])
        smallest = self.placed.effect.kind in VANISHING
        return smallest and value <= numbers[0].low * (1.0 + 1e-6)

    @property
    def outgrown(self) -> bool:
        """Whether a shape ended at its upper bound: what is there is something wider."""
        if self.fit is None or not self.placed.effect.simple_form_of:
            return False
        shapes = self.fit.theta[-SLOTS:][1 : len(self.placed.effect.numbers)]
        bounds = [number.high for number in self.placed.effect.numbers[1:]]
        return any(value >= high * (1.0 - 1e-6) for value, high in zip(shapes, bounds, strict=True))


@dataclass(frozen=True)
class Bench:
    """A model that stands so far, and the records.

    Parameters
    ----------
    records : Records
        Training records.
    train, later : tuple of Run
        What is fitted and what is held out.
    fit : Fit
        The model, in the raw metric.
    white : Fit, optional
        The same model fitted in a whitening metric, where the next such fit begins.
    """

    records: Records
    train: tuple[Run, ...]
    later: tuple[Run, ...]
    fit: Fit
    white: Fit | None = None

    @property
    def raw(self) -> Metric:
        """The raw metric."""
        return raw_metric([run.outputs for run in self.train])

    def held_out_rms(self) -> FloatArray:
        """Return the rms error of each output on the held-out rows, starts estimated there."""
        errors = np.concatenate(settled(self.fit, self.later, self.raw).errors)
        return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))

    def refitted(self, structure: Structure, theta: FloatArray) -> Bench:
        """Return the bench with another model, fitted in the raw metric; its offsets are held."""
        bench = self.laid(structure.between)
        held = replace(structure, offsets_free=False)
        fit = fit_runs(held, bench.train, self.raw, theta, self.fit.starts)
        return replace(bench, fit=fit)

    def timed(self) -> Bench:
        """Return the bench with the timing offsets that whitened errors ask for."""
        if not self.records.model.inputs or self.fit.failed:
            return self
        metric = metric_of(self.fit.errors)
        white = _whitened(self, self.fit, metric)
        moved = self.refitted(self.fit.structure, _with_offsets(self.fit, white))
        better = moved.held_out_size() < self.held_out_size() / BETTER_TIMED
        return replace(moved if better else self, white=white)

    def held_out_size(self) -> float:
        """Return the held-out error, outputs joined by their geometric mean."""
        sizes = self.held_out_rms()
        return float(np.exp(np.mean(np.log(sizes)))) if np.all(np.isfinite(sizes)) else np.inf

    def laid(self, between: str, fitted: int | None = None, held_out: int | None = None) -> Bench:
        """Return the bench with inputs laid otherwise between samples, or with fewer rows."""
        if between == self.fit.structure.between and fitted is None:
            return self
        train = [e.rows(0, fitted or e.n_samples) for e in self.records.fitted]
        later = [e.rows(0, held_out or e.n_samples) for e in self.records.held_out]
        return replace(
            self,
            train=runs_of(self.records, train, between, begun=True),
            later=runs_of(self.records, later, between, begun=False),
        )

    def between_chosen(self) -> Bench:
        """Return the bench with its inputs between samples as they foretell held-out rows best.

        Another way is taken when the raw error on held-out rows falls by it; or when it stays and
        the error in the metric of the model's own colour falls, since what happens within a
        sample can be lost in the slow part of the raw error. A stretch of each record is enough.
        """
        chosen = self.records.model.input_between_samples != "auto"
        if chosen or not self.records.model.inputs or self.fit.failed:
            return self
        now = self.fit.structure.between
        short = self.laid(now, FITTED_BETWEEN, HELD_OUT_BETWEEN)
        rows = [e[: run.n_samples] for e, run in zip(self.fit.errors, short.train, strict=True)]
        metric = metric_of(rows)
        raw, white, theta = self._misfits(now, metric)
        best, least = now, (raw, white)
        for between in INTERPOLATIONS:
            if between == now:
                continue
            raw, white, timed = self._misfits(between, metric)
            falls = raw < BETTER_BETWEEN * least[0]
            stays = raw < least[0] / BETTER_BETWEEN and white < least[1] - BETTER_WHITE
            if falls or stays:
                best, least, theta = between, (raw, white), timed
        if best == now:
            return self
        moved = self.refitted(replace(self.fit.structure, between=best), theta)
        # What is better on a stretch must not be worse on the whole.
        return moved if moved.held_out_size() < self.held_out_size() / BETTER_BETWEEN else self

    def _misfits(self, between: str, metric: Metric) -> tuple[float, float, FloatArray]:
        """Return the raw error of a stretch of held-out rows, outputs joined by their geometric
        mean, and what it costs in a metric, each by a fit of its own.
        """
        structure = replace(self.fit.structure, between=between)
        short = self.laid(between, FITTED_BETWEEN, HELD_OUT_BETWEEN)
        white = _whitened(
            replace(short, fit=replace(self.fit, structure=structure)), self.fit, metric
        )
        held = replace(structure, offsets_free=False)
        theta = _with_offsets(self.fit, white)
        raw = fit_runs(
            held, short.train, self.raw, theta, white.starts, white.scale, most=STEPS_BETWEEN
        )
        if raw.failed or white.failed:
            return np.inf, np.inf, theta
        costs = [
            -own.log_likelihood(settled(fit, short.later, own).errors)
            for fit, own in ((raw, self.raw), (white, metric))
        ]
        n = sum(run.n_samples for run in short.later) * len(self.raw.sigma)
        return float(np.exp(costs[0] / n)), costs[1], theta


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
    """

    bench: Bench
    metric: Metric
    candidates: tuple[Candidate, ...]
    winner: Candidate | None
    aliases: tuple[Candidate, ...]
    refused: dict[str, str]
    rivalled: bool = False
    share: float = 0.0


def base_bench(records: Records) -> Bench:
    """Fit the user's model as it is, and choose how its inputs run between samples.

    Parameters
    ----------
    records : Records
        Training records.
    """
    wanted = records.model.input_between_samples
    between = "cubic" if wanted == "auto" else wanted
    structure = Structure(records.model, (), between, offsets_free=False)
    train = runs_of(records, records.fitted, between, begun=True)
    later = runs_of(records, records.held_out, between, begun=False)
    raw = raw_metric([run.outputs for run in train])
    fit = fit_runs(structure, train, raw, structure.start(), [run.x0_mean for run in train])
    bench = Bench(records, train, later, fit)
    finer = replace(structure, tolerance=tolerance_for(fit, bench.raw))
    return bench.refitted(finer, fit.theta).timed().between_chosen()


def tolerance_for(fit: Fit, raw: Metric) -> float:
    """Return a tolerance of the integrator well below what is new in the errors.

    Parameters
    ----------
    fit : Fit
        Of the model as it is; its whitened errors bound the noise from above.
    raw : Metric
        Swing of each output.
    """
    if fit.failed:
        return FIRST_TOLERANCE
    noise = metric_of(fit.errors).sigma
    least = min(new / swing for new, swing in zip(noise, raw.sigma, strict=True))
    return float(np.clip(TOLERANCE_SHARE * least, LEAST_TOLERANCE, FIRST_TOLERANCE))


def search_round(
    bench: Bench, effects: Sequence[SystemEffect], open_terms: Sequence[SystemEffect]
) -> Round:
    """Try every effect at every place.

    Parameters
    ----------
    bench : Bench
        The model and the records.
    effects, open_terms : sequence of SystemEffect
        Names, and terms without one.
    """
    placed, refused = placed_effects(bench.fit, bench.train, [*effects, *open_terms])
    prober = Prober(bench.fit, bench.train)
    raw = prober.probes(placed, bench.raw)
    white = prober.probes(placed, metric_of(bench.fit.errors))
    promising = _promising(raw, white)
    raw_fits = _raced(bench, promising)
    metric = _metric_of_best([bench.fit, *raw_fits.values()])
    weigher = _Weigher.of(bench, metric, len(placed))
    tried = [
        weigher.weighed(Candidate(probe.placed, probe), _whitened(bench, raw_fits[probe], metric))
        for probe in promising
        if probe in raw_fits
    ]
    keys = {c.placed.key for c in tried}
    rest = [Candidate(p.placed, p) for p in white if p.placed.key not in keys]
    ranked = tuple(sorted(tried, key=lambda c: -c.score)) + tuple(rest)
    winner, aliases, rivalled = _winner(weigher, [c for c in ranked if c.accepted])
    share = 0.0
    if winner is not None and winner.errors is not None:
        valid = weigher.rows.valid
        base = float(np.sum(weigher.base_errors[valid] ** 2))
        share = 1.0 - float(np.sum(winner.errors[valid] ** 2)) / base
    return Round(bench, metric, ranked, winner, aliases, refused, rivalled, share)


def _promising(raw: Sequence[Probe], white: Sequence[Probe]) -> list[Probe]:
    """Return the most promising of both metrics, each place once."""
    kept: dict[object, Probe] = {}
    for probes in (white, raw):
        best = probes[0].gain if probes else 0.0
        least = max(LEAST_PROMISE, LEAST_PROMISE_SHARE * best)
        named = [p for p in probes if p.gain > least and not p.placed.effect.unnamed]
        terms = [p for p in probes if p.gain > least and p.placed.effect.unnamed]
        bare = [p for p in probes if not p.placed.effect.numbers]
        for probe in (*named[:MOST_FITTED], *terms[: MOST_FITTED // 3], *bare):
            kept.setdefault((probe.placed.key, probe.placed.effect.code), probe)
    # The plain form of whatever is promising races beside it.
    wanted = {(p.placed.name, p.placed.place) for p in kept.values()}
    for probe in white:
        forms = {(name, probe.placed.place) for name in probe.placed.effect.simple_form_of}
        if forms & wanted:
            kept.setdefault((probe.placed.key, probe.placed.effect.code), probe)
    return list(kept.values())


def _raced(bench: Bench, probes: Sequence[Probe]) -> dict[Probe, Fit]:
    """Fit a few steps each in the raw metric, and to the end those that are ahead by then.

    Ahead by either count: errors as they are, and the likelihood in the metric of their own.
    """
    begun = {probe: _begun(bench, probe) for probe in probes}
    begun = {probe: fit for probe, fit in begun.items() if not fit.failed}
    if not begun:
        return {}
    own = {p: metric_of(f.errors).log_likelihood(f.errors) for p, f in begun.items()}
    by_size = sorted(begun, key=lambda p: begun[p].cost)[:FINALISTS]
    by_own = sorted(begun, key=lambda p: -own[p])[:FINALISTS]
    ahead = [p for p in begun if p in by_size or p in by_own]
    forms = {(p.placed.name, p.placed.place) for p in ahead}
    plain = [
        p
        for p in begun
        if p not in ahead
        and {(name, p.placed.place) for name in p.placed.effect.simple_form_of} & forms
    ]
    ahead += plain
    return {
        p: fit_runs(
            begun[p].structure,
            bench.train,
            bench.raw,
            begun[p].theta,
            begun[p].starts,
            begun[p].scale,
            most=MOST_ITERATIONS,
        )
        for p in ahead
    }


def _begun(bench: Bench, probe: Probe) -> Fit:
    """Fit a few steps from where the score test points."""
    structure = bench.fit.structure.with_effect(probe.placed)
    effect = probe.placed.effect
    slots = structure.slots((0.0, *probe.start[1:]) if effect.linear else probe.start)
    begun = [bench.fit.theta]
    if not effect.numbers:
        # What makes another reading of everything: the model without it may be far off.
        begun.append(np.concatenate([structure.start(), bench.fit.theta[structure.start().size :]]))
    fits = [
        fit_runs(
            structure,
            bench.train,
            bench.raw,
            np.concatenate([theta, slots]),
            bench.fit.starts,
            most=FIRST_LAP if effect.numbers else MOST_ITERATIONS,
        )
        for theta in begun
    ]
    return min(fits, key=lambda fit: fit.cost)


def _whitened(bench: Bench, fit: Fit, metric: Metric) -> Fit:
    """Fit a model in a whitening metric, timing offsets free.

    The search begins where it costs least: at the raw fit, or at the model of the bench as it was
    last whitened, with what the raw fit has in addition.
    """
    free = replace(bench.fit.structure, effects=fit.structure.effects, offsets_free=True)
    starts = [(fit.theta, fit.starts)]
    if bench.white is not None:
        known = bench.white.theta
        starts.append((np.concatenate([known, fit.theta[known.size :]]), bench.white.starts))
    if len(starts) > 1:
        costs = [
            fit_runs(free, bench.train, metric, theta, x0, fit.scale, most=0).cost
            for theta, x0 in starts
        ]
        starts = [starts[int(np.argmin(costs))]]
    theta, x0 = starts[0]
    return fit_runs(free, bench.train, metric, theta, x0, fit.scale, most=MOST_WHITENED)


def _with_offsets(fit: Fit, timed: Fit) -> FloatArray:
    """Return θ of a fit with the timing offsets of another."""
    first = len(fit.structure.model.params)
    theta = fit.theta.copy()
    theta[first : first + len(fit.structure.model.inputs)] = timed.theta[
        first : first + len(fit.structure.model.inputs)
    ]
    return theta


def _metric_of_best(fits: Sequence[Fit]) -> Metric:
    """Return the metric of the errors that are likeliest in their own."""
    good = [fit for fit in fits if not fit.failed]
    n = sum(e.size for e in good[0].errors)
    found = [(metric_of(fit.errors), fit) for fit in good]
    price = 0.5 * np.log(n)
    best = max(
        found,
        key=lambda pair: pair[0].log_likelihood(pair[1].errors) - price * pair[1].n_parameters,
    )
    return best[0]


@dataclass(frozen=True)
class _Weigher:
    """The model without the candidates in the metric of a round, and the rows."""

    bench: Bench
    metric: Metric
    base: Fit
    base_errors: FloatArray
    rows: Rows
    n_places: int

    @classmethod
    def of(cls, bench: Bench, metric: Metric, n_places: int) -> _Weigher:
        base = _whitened(bench, bench.fit, metric)
        errors = _errors(bench, metric, base)
        return cls(bench, metric, base, errors, _rows(bench, metric), n_places)

    def weighed(self, candidate: Candidate, fit: Fit) -> Candidate:
        """Return a candidate with its evidence."""
        if fit.failed:
            return candidate
        errors = _errors(self.bench, self.metric, fit)
        added = fit.n_parameters - self.base.n_parameters
        evidence = evidence_of(
            self.rows, self.base_errors, errors, added=added, searched=float(self.n_places)
        )
        return replace(candidate, fit=fit, errors=errors, evidence=evidence)


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
            valid.append(np.arange(run.n_samples) >= metric.lost)
    n_y = len(metric.sigma)
    total = sum(p.size for p in part)
    block = max(LEAST_BLOCK_ROWS, total // BLOCKS)
    return Rows.of(np.tile(np.concatenate(part), n_y), np.tile(np.concatenate(valid), n_y), block)


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
        if not c.placed.effect.unnamed and (same or best.score - c.score < margin)
    ]
    rivalled = False
    if best.placed.effect.unnamed and named:
        # A name speaks wherever the records cannot tell it from a term without one.
        name = max(named, key=lambda c: c.score)
        best, rivalled = name, best.score - name.score > UNNAMED_GAP
        pool = [best, *[c for c in accepted if c is not best and not c.placed.effect.unnamed]]
        near = _near(weigher, pool)
    simple = _simple_form(best, pool)
    aliases = [c for c, same in zip(pool, near, strict=True) if same or c is simple or c is best]
    if not best.placed.effect.unnamed:
        aliases = [c for c in aliases if not c.placed.effect.unnamed]
        aliases = [c for c in aliases if c is best or not c.outgrown]
    aliases.sort(key=lambda c: (c is not simple, _numbers(c), -c.score))
    return aliases[0], tuple(aliases), rivalled


def _near(weigher: _Weigher, pool: Sequence[Candidate]) -> list[bool]:
    """Tell which of a pool the records cannot tell from its best."""
    errors = [c.errors for c in pool if c.errors is not None]
    return alias_rows(weigher.rows, weigher.base_errors, errors, [c.score for c in pool])


def _simple_form(best: Candidate, pool: Sequence[Candidate]) -> Candidate | None:
    """Return the plain form of the best where that wins nearly as much.

    A refinement that wins a few per cent more is no other effect: the plain form speaks, and the
    refinement may be found in the next round.
    """
    for candidate in pool:
        same = candidate.placed.place == best.placed.place
        plain = best.placed.name in candidate.placed.effect.simple_form_of
        fair = candidate.score > SIMPLE_SHARE * best.score and not candidate.outgrown
        if same and plain and fair:
            return candidate
    return None


def _numbers(candidate: Candidate) -> int:
    """Return how much an effect brings: its numbers, and its own state."""
    effect = candidate.placed.effect
    return sum(not number.held for number in effect.numbers) + effect.own_state
