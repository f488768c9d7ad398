"""Whole runs from raw counts: what effects explain of them, and what they explain of their twins.

A record that passed the whole sensor chain leaves errors that come back cycle after cycle: no test
of chance can tell a missing effect from that. What can is the record itself, measured again from
its own fitted model with nothing hidden in it, reduced and fitted alike: how much an effect
explains there, and which number it takes, is its null, with its scatter. Numbers scatter also with
what a fit takes for granted (the blend of the branches, guards, averages), which is varied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from classic_ml.record_reading import RecordReading
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record.branches import TAUS_S
from classic_ml.whole_run_rows import is_blowdown, whole_run_rows
from comparisons.missing_effect.candidates import Bench, LagCandidate, LagRound
from comparisons.missing_effect.catalogue.workings import clock_s
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.engine import Policy, System, Tried
from comparisons.missing_effect.evidence import (
    ALIAS,
    Tie,
    block_sums,
    paired_z,
    speak_for_themselves,
)
from comparisons.missing_effect.fit import Fit, Structure, fit_structure
from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.loading import whole_data
from comparisons.missing_effect.noise import Metric, NoiseModel
from comparisons.missing_effect.probes import Leftover, Probe
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray

N_TWINS, FEWEST_TWINS = 20, 6
# Standard deviations of the null beyond which an effect is there: three, a dozen names paid for.
# With two more one of a size that matters is seen but in one record of fifty.
FIRM, MORE = 3.7, 2.0
# What matters: a clock skew, a wrong duct, a drift that moves τ by as much as its interval.
MATTERS = {
    "transport_delay": 0.005,
    "facility_heating": 0.1,
    "speed_droop": 1.0,
    "second_order_lag": 1e-4,
    "amplitude_dependent_lag": 0.5,
    "asymmetric_lag": 0.3,
    "thermocouple_lag": 0.1,
    "sensitivity_drift": 0.02,
    "bias_drift": 0.05,
}
# Of the mean ψ', for effects whose numbers mean little one by one.
MATTERS_OF_PSI_P = 0.03
# What a ∫dx/A that is stated too large by this factor does to its number is seen on twins: τ and
# the curve make up for a part of it.
INERTIA, INERTIA_FACTOR, INERTIA_TWINS = "flow_inertia", 1.5, 4
SHAPED = ("characteristic_shape", "hysteresis", "flow_dependent_lag")
# Far from its reference a transducer loses an offset with its sensitivity.
SENSITIVITY = "sensitivity_drift"
# Cycles are left out every so many at a time.
FOLDS = 4
# A drift draws τ far away, as log τ: a search then begins at the τ by both branches, too.
FAR = 0.7

# Explaining four fifths of what the best explains is as good, whatever decides about it alone.
WHOLE_RUNS = Policy(term=ALIAS, alias=Tie(0.0, 0.2), refused_stand=True)
NOTHING_LEFT = Leftover(0.0, 0, 1.0)

Progress = Callable[[Iterable[int]], Iterable[int]]


@dataclass(frozen=True)
class Null:
    """What an effect reads where it is not there, with the deviation over twins.

    ``share`` is what it explains of the squared errors, ``number`` what it takes (over
    specifications, too); ``matters`` is the size of that number from which on the effect matters,
    ``by_inertia`` how far a wrong ∫dx/A moves it, and ``shared`` what all cycles share of the
    errors of that number and of log τ beside it; ``open_tau`` is that of log τ without the distance
    of two readings, which withholds no τ.
    """

    share: float
    share_sd: float
    number: float
    number_sd: float
    matters: float
    unit: str
    by_inertia: float = 0.0
    shared: tuple[float, float] = (0.0, 0.0)
    open_tau: float = 0.0

    @property
    def seen_from(self) -> float:
        """Size that is beyond the null."""
        return FIRM * self.number_sd

    @property
    def decided_from(self) -> float:
        """Size from which on the effect would hardly go unseen on this record."""
        return max((FIRM + MORE) * self.number_sd, 0.5 * self.matters)

    @property
    def can_be_told(self) -> bool:
        """Whether an effect of a size that matters is seen."""
        return self.decided_from <= self.matters

    def beyond(self, share: float, number: float) -> bool:
        """Whether what an effect reads is beyond the null, and of a size that matters."""
        apart = abs(number - self.number)
        far = apart >= max(self.seen_from, 0.5 * self.matters)
        return far and share >= self.least_share

    def is_sure(self, number: float) -> bool:
        """Whether a number stands beyond its null on a record that sees what matters."""
        return self.seen_from <= max(self.matters, 0.5 * abs(number - self.number))

    def is_of_inertia(self, number: float) -> bool:
        """Whether a wrong ∫dx/A takes this number, too, or half as much."""
        apart = number - self.number
        return self.by_inertia * apart >= 0.5 * apart**2 and abs(self.by_inertia) >= self.seen_from

    @property
    def least_share(self) -> float:
        """Share that an effect must explain."""
        return self.share + FIRM * self.share_sd


@dataclass(frozen=True)
class Nulls:
    """What each effect reads of twins (empty without twins), and their mean rms error.

    ``log_tau`` is what all cycles share of the error of log τ without any of them.
    """

    by_effect: Mapping[str, Null]
    rms: float
    log_tau: float = 0.0


@dataclass(frozen=True)
class WholeRuns(Bench):
    """Whole runs as the search works on them: all rows fitted, all errors weighed alike.

    Without nulls of twins chance decides; ``named`` is what was found, and all that these records
    do not tell from it; ``log_tau`` is that of the fit to both branches, in which each has a curve
    of its own.
    """

    policy: Policy = WHOLE_RUNS
    nulls: Nulls = Nulls({}, np.nan)
    named: frozenset[str] = frozenset()
    log_tau: float = float("nan")

    # By what is explained beyond a null, and by the alias set of the round that found it.
    ranked, stand_ins = System.ranked, System.stand_ins

    def fitted(self, probe: Probe) -> Fit:
        """Fit the model with the effect of a probe, from several starts of τ."""
        log_tau, *others = self.fit.nonlinear
        far = abs(log_tau - self.log_tau) > FAR
        # The best of many shapes by its score is all that twins can be asked for.
        most = 1 if probe.effect.name in SHAPED else None
        starts = [
            np.concatenate([[first], others, own])
            for own in probe.starts[:most]
            for first in ([log_tau, self.log_tau] if far else [log_tau])
        ]
        structure = self.fit.structure.with_effect(probe.effect)
        return fit_structure(structure, self.train, self.train_metric, starts)

    def tried(
        self, effects: Sequence[Effect], library: Sequence[Effect] = ()
    ) -> Tried[Effect, Fit]:
        """Fit all that these runs can show, in the plain metric."""
        probes = self.prober().probes(e for e in effects if e.name not in self.named)
        return Tried(self, [p.candidate(self.fitted(p)) for p in probes if p.starts])

    def leftover(
        self, winner: LagCandidate | None, effects: Sequence[Effect], library: Sequence[Effect]
    ) -> Leftover:
        """Return that nothing is said of what is left: twins of it were not measured."""
        return NOTHING_LEFT

    def with_winner(self, step: LagRound) -> WholeRuns:
        """Return the model with what a round found."""
        assert step.winner is not None
        named = self.named | {candidate.name for candidate in step.aliases}
        return replace(self, fit=step.winner.fit, named=named)

    def without_needless(self, one: Effect) -> None:
        """Keep all that was found."""

    @property
    def own_noise(self) -> NoiseModel:
        """All that the model leaves: it hides the law of the noise."""
        return NoiseModel(rms_left(self), rms_left(self), (), 0.0)

    @property
    def left(self) -> FloatArray:
        """Plain errors of the model on all rows, by fits to other cycles."""
        return self.left_out * self.metric.sigma

    @property
    def held(self) -> BoolArray:
        """Rows that were held out: each of them, with its cycle."""
        return self.rows.valid

    @cached_property
    def left_out(self) -> FloatArray:
        """Errors of the model by fits to other cycles."""
        return cycles_left_out(self.fit, self)

    def judged(self, candidate: LagCandidate) -> LagCandidate:
        """Return a candidate weighed against its null, ranked by what it explains beyond that."""
        fit, evidence = candidate.fit, candidate.evidence
        null = self.nulls.by_effect.get(candidate.name)
        share = 1.0 - fit.cost / self.fit.cost
        beyond = null is None or null.beyond(share, number_of(candidate.added[0], fit, self))
        # At an end of what is searched for τ it is no lag that was fitted.
        beyond &= bool(TAUS_S[0] < fit.tau_s < TAUS_S[-1])
        later, other, z, many_blocks = 0.0, float("nan"), 0.0, False
        # Cycles left out cost four fits more: only for what may be named at all.
        if beyond:
            gain = 0.5 * (self.left_out**2 - cycles_left_out(fit, self) ** 2)
            later, z = float(gain.sum()), paired_z(gain, self.rows, TRAIN)
            many_blocks = speak_for_themselves(block_sums(gain, self.rows, TRAIN))
            last = self.data.record == self.data.record.max()
            other = float("nan") if last.all() else float(gain[last].sum())
        least = float("nan") if null is None else null.least_share
        evidence = replace(
            evidence,
            later=later,
            other=other,
            z=z,
            many_blocks=many_blocks,
            score=evidence.score + later,
            share=share,
            least_share=np.inf if not beyond and share >= least else least,
        )
        of_twins = null.share if null and np.isfinite(null.share) else 0.0
        return replace(candidate, evidence=evidence, rank=share - of_twins)

    def near(
        self, best: LagCandidate, others: Sequence[LagCandidate], tie: Tie
    ) -> list[LagCandidate]:
        """Return those that explain nearly as much beyond their null, and what reads the same."""
        null = self.nulls.by_effect.get(best.name)
        alike = {SENSITIVITY} if best.name == "bias_drift" else set()
        number = number_of(best.added[0], best.fit, self)
        if null is not None and null.is_of_inertia(number):
            alike.add(INERTIA)
        least = (1.0 - tie.share) * best.rank
        return [c for c in others if c.rank >= least or c.name in alike]


def plain_bench(
    data: LagData,
    readings: Sequence[RecordReading],
    terms: tuple[str, ...],
    n_names: int,
    block: int,
) -> WholeRuns:
    """Fit the base model with all errors weighed alike, from the τ of the readings on.

    Weighing them by their colour would fit what is fast, where the model of the lag is worst.
    """
    everything = data.all_fitted()
    structure, metric = Structure(terms), Metric(float(np.std(data.measured)) / 30.0)
    log_tau = float(np.mean([np.log(one.fit().tau_s) for one in readings]))
    start = np.array([log_tau])
    first = WholeRuns.start(everything, structure, metric, [start], block, n_names)
    # Neighbours of an average say the same: a row counts for less than one.
    metric = Metric(rms_left(first) * float(np.sqrt(_error_memory(first))))
    bench = WholeRuns.start(everything, structure, metric, [first.fit.nonlinear], block, n_names)
    return replace(bench, log_tau=log_tau)


def number_of(effect: Effect, fit: Fit, bench: Bench) -> float:
    """Return the one number by which an effect is judged."""
    if effect.name in SHAPED:
        return float(np.sqrt(max(1.0 - fit.cost / bench.fit.cost, 0.0))) * rms_left(bench)
    if effect.linear:
        return float(fit.groups(bench.data)[effect.name][0])
    values = fit.values_of(effect)
    if effect.name == "facility_heating":
        # Size and time are known together alone: what is lost by the end of the record.
        return float(values[0] * -np.expm1(-np.max(clock_s(bench.data)) / values[1]))
    return float(values[0])


def rms_left(bench: Bench) -> float:
    """Return the rms error of a model on the scored rows."""
    return bench.metric.sigma * float(np.sqrt(2.0 * bench.fit.cost / bench.rows.n_fitted))


def nulls_of(
    records: Sequence[CoefficientSeries],
    readings: Sequence[RecordReading],
    bench: WholeRuns,
    effects: Sequence[Effect],
    without: FloatArray,
    *,
    n_twins: int,
    progress: Progress = iter,
) -> Nulls:
    """Measure twins of the records, and fit every effect to them.

    ``bench`` is the model without any of them; ``without`` is, on the fine rows, what ψ' has of an
    effect that is not to be in the twins.
    """
    twins = []
    for number, reading in enumerate(readings):
        psi_p = reading.passes.psi_p.copy()
        rows = bench.data.record[bench.data.runs[:, 0]] == number
        for run, (start, stop) in zip(
            reading.passes.pieces, bench.data.fine_runs[rows], strict=True
        ):
            psi_p[run.start : run.start + stop - start] -= without[start:stop]
        twins.append(reading.twin(psi_p))
    rng = np.random.default_rng(0)
    rms = []

    def read(
        others: Sequence[RecordReading], tried: Sequence[Effect], in_stall: bool = False
    ) -> Read:
        data = whole_data(records, others)
        if in_stall:
            data = replace(data, weight=data.weight * (data.sampled(data["stalled"]) > 0.5))
        own = plain_bench(data, others, bench.fit.structure.terms, bench.n_names, bench.block_rows)
        rms.append(rms_left(own))
        found = {PLAIN: (0.0, 0.0, float(own.fit.nonlinear[0]))}
        for c in own.tried(tried).candidates:
            share, log_tau = 1.0 - c.fit.cost / own.fit.cost, float(c.fit.nonlinear[0])
            found[c.name] = share, number_of(c.added[0], c.fit, own), log_tau
        return found

    measured, over_twins = [], []
    for _ in progress(range(n_twins)):
        # A twin that no longer surges is none of the record's; where most are, nothing is known.
        with suppress(InputError):
            again = [one.again(twin, rng) for one, twin in zip(readings, twins, strict=True)]
            over_twins.append(read(again, effects))
            measured.append(again)
    left_rms = float(np.mean(rms)) if rms else float("nan")
    varied = zip(*(one.varied() for one in readings), strict=True)
    over_specs = [read(others, effects) for others in varied]
    wrong: list[tuple[Read, Read]] = []
    for others, right in zip(measured[:INERTIA_TWINS], over_twins, strict=False):
        with suppress(InputError):
            again = [one.with_inertia(INERTIA_FACTOR) for one in others]
            wrong.append((right, read(again, effects)))
    apart: list[Read] = []
    # A plenum that blows down holds no τ of its own.
    if not is_blowdown([whole_run_rows(record, 2) for record in records]):
        apart = [read(readings, effects, alone) for alone in (False, True)]
    reads = over_twins, over_specs, apart
    by_effect = {e.name: _null(e, bench.data, *reads, wrong) for e in effects}
    return Nulls(by_effect, left_rms, _shared(*(_read_of(PLAIN, each) for each in reads))[1])


# Of each effect its share, its number and log τ; of the model without any log τ alone.
Read = Mapping[str, tuple[float, float, float]]
PLAIN = ""


def _read_of(name: str, reads: Sequence[Read]) -> FloatArray:
    return np.array([one[name] for one in reads if name in one]).reshape(-1, 3)


def _shared(twins: FloatArray, specs: FloatArray, rows: FloatArray) -> tuple[float, float]:
    """Return what all cycles share of the errors of a number and of log τ, as deviations.

    It is the scatter over twins and over specifications, and that of two equal readings: of all
    rows and of those in stall alone, which parted by 3 to 10 of the errors over cycles on machines
    of another rig, where the mix of the branches is not as a blend has it.
    """
    parts = [
        each[:, 1:].std(axis=0, ddof=ddof)
        for each, ddof in ((twins, 1), (specs, 0), (rows, 1))
        if len(each) > 1
    ]
    number, log_tau = np.sqrt(np.sum(np.square(parts), axis=0)) if parts else (0.0, 0.0)
    return float(number), float(log_tau)


def _null(
    effect: Effect,
    data: LagData,
    twins: Sequence[Read],
    specs: Sequence[Read],
    rows: Sequence[Read],
    wrong: Sequence[tuple[Read, Read]],
) -> Null:
    read, varied, apart = (_read_of(effect.name, each) for each in (twins, specs, rows))
    mean_psi_p = float(np.mean(np.abs(data.measured[data.scored()])))
    matters, unit = MATTERS.get(effect.name, np.inf), effect.parameters[0].unit
    if effect.name in SHAPED:
        matters, unit = MATTERS_OF_PSI_P * mean_psi_p, "1"
    if effect.name == "bias_drift":
        matters *= mean_psi_p
    if len(read) < FEWEST_TWINS:
        return Null(np.inf, 0.0, 0.0, np.inf, matters, unit)
    mean, sd = read.mean(axis=0), read.std(axis=0, ddof=1)
    name = effect.name
    moved = [b[name][1] - a[name][1] for a, b in wrong if name in a and name in b]
    by_inertia = float(np.mean(moved)) if moved else 0.0
    matters = abs(by_inertia) if effect.name == INERTIA else matters
    both = float(np.hypot(sd[1], np.std(varied[:, 1]) if len(varied) else 0.0))
    shared = _shared(read, varied, apart)
    open_tau = _shared(read, varied, apart[:0])[1]
    return Null(mean[0], sd[0], mean[1], both, matters, unit, by_inertia, shared, open_tau)


def cycles_left_out(fit: Fit, bench: Bench) -> FloatArray:
    """Return the whitened error of each row by a fit that did not see its cycle.

    Every fourth cycle is left out at a time: later time alone would be a handful of cycles of one
    record, and what one of them does would decide.
    """
    data, rows = bench.data, bench.rows
    out = np.zeros(data.n_samples)
    for fold in range(FOLDS):
        held = rows.valid & (rows.block % FOLDS == fold)
        kept = replace(data, weight=np.where(held, 0.0, data.weight))
        again = fit_structure(fit.structure, kept, bench.metric, [fit.nonlinear])
        out[held] = again.errors(data, bench.metric)[held]
    return out


def _error_memory(bench: Bench) -> float:
    """Return how many neighbouring errors of a model say the same: (1 + ρ)/(1 − ρ)."""
    errors, valid = bench.base_errors, bench.rows.valid
    both = valid[1:] & valid[:-1]
    one, two = errors[:-1][both], errors[1:][both]
    rho = float(one @ two) / max(float(np.sqrt((one @ one) * (two @ two))), 1e-300)
    rho = min(max(rho, 0.0), 0.98)
    return (1.0 + rho) / (1.0 - rho)
