"""Which further measurement, simulated, would separate the effects that these records cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from comparisons.missing_effect.candidates import refitted_on
from comparisons.missing_effect.catalogue.workings import ripple_waves
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.evidence import LEAST_GAP, LEAST_GAP_SHARE
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import TRAIN, LagData, Run, laid_out
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.noise import Metric
from comparisons.missing_effect.probes import Prober
from surge_core.types import FloatArray

# Mean and swing of three throttle settings, as shares of the range and of the swing recorded.
SETTINGS = ((0.0, 1.0), (-0.12, 0.7), (0.12, 0.4))
# Share of a setting over which the throttle moves to the next.
RAMP_SHARE = 0.15
CHANNELS = ("T25_K", "Nc_frac")
STATES = ("in_stall", "stalled")


@dataclass(frozen=True)
class Change:
    """What is done otherwise in an experiment.

    φ passes at so many times its speed for so many times the length, its swing about its mean is
    scaled, and it is lowered by a share of its range; or each record passes through three throttle
    settings.
    """

    name: str
    says: str
    speed: float = 1.0
    length: float = 1.0
    swing: float = 1.0
    lower: float = 0.0
    settings: bool = False


AS_RECORDED = Change("as_recorded", "the records as they are")
CHANGES = (
    Change("longer_2", "records twice as long", length=2.0),
    Change("longer_4", "records four times as long", length=4.0),
    Change("slower_2", "the same cycles at half the pace", speed=0.5, length=2.0),
    Change("slower_4", "the same cycles at a quarter of the pace", speed=0.25, length=4.0),
    Change("faster_2", "cycles at twice the pace", speed=2.0),
    Change("deeper_reversal", "mean flow lower by a quarter of its range", lower=0.25),
    Change("larger_swing", "a swing half as large again", swing=1.5),
    Change(
        "faster_larger",
        "cycles at twice the pace and a swing half as large again",
        speed=2.0,
        swing=1.5,
    ),
    Change("throttle_settings", "three throttle settings in each record", settings=True),
)

# Two models that leave less than this many standard deviations between them, all rows together,
# are not separated: a gain of 12.5 log-units. Of strong effects the workflow asks for more.
TOLD_APART = 5.0
# What happens in the transducer of one tap, or at its place on the circumference.
OF_ONE_TAP = ("sensitivity_drift", "bias_drift", "rotating_stall_ripple")
SECOND_TAP = Change("second_tap", "a second tap with a transducer of its own")


@dataclass(frozen=True)
class Distance:
    """How far the best of a rival stays from the truth.

    Parameters
    ----------
    truth, rival : str
        Which effect is there, and which is fitted in its place.
    sigma : float
        Root of the sum of squared errors left, in standard deviations of the noise.
    asked : float
        From where on the workflow would tell them apart.
    """

    truth: str
    rival: str
    sigma: float
    asked: float = TOLD_APART


@dataclass(frozen=True)
class Measurement:
    """One experiment, and what it would tell.

    Parameters
    ----------
    name, says : str
        What it is called, and what is done.
    distances : tuple of Distance
        One for each truth and each rival.
    sigma, asked_sigma : float
        The least of the distances, whichever of the effects is there; from where on it would tell.
    tells_apart : bool
        Whether it tells every member from every other.
    """

    name: str
    says: str
    distances: tuple[Distance, ...]
    sigma: float
    asked_sigma: float
    tells_apart: bool

    @classmethod
    def of(cls, change: Change, distances: tuple[Distance, ...]) -> Measurement:
        """Return the measurement that a change makes, by its distances."""
        least, most = min(d.sigma for d in distances), max(d.asked for d in distances)
        apart = all(d.sigma >= d.asked for d in distances)
        return cls(change.name, change.says, distances, least, most, apart)


@dataclass(frozen=True)
class SetSeparation:
    """What would tell the members of one alias set apart.

    Parameters
    ----------
    alias_set : tuple of str
        The names.
    as_recorded : Measurement
        The distances on the records themselves.
    measurements : tuple of Measurement
        Experiments, in the order in which they are easily done.
    confirm : mapping of str to str
        What would confirm each member by itself.
    """

    alias_set: tuple[str, ...]
    as_recorded: Measurement
    measurements: tuple[Measurement, ...]
    confirm: Mapping[str, str]

    @property
    def best(self) -> Measurement | None:
        """The measurement that tells them apart most clearly; None where none does."""
        telling = [m for m in self.measurements if m.tells_apart]
        return max(telling, key=lambda m: m.sigma, default=None)

    @property
    def lines(self) -> tuple[str, ...]:
        """What the experiments would tell, a line each."""
        width = max(len(m.says) for m in self.measurements)
        rows = [
            f"  {m.says:<{width}}  {m.sigma:6.1f} σ of {m.asked_sigma:4.1f}"
            f"{'' if m.tells_apart else '  not enough'}"
            for m in self.measurements
        ]
        names = " | ".join(self.alias_set)
        head = (
            f"{names}: {self.as_recorded.sigma:.1f} σ apart on these records, all rows together; "
            f"from {self.as_recorded.asked_sigma:.1f} σ on they would be separated"
        )
        best = self.best
        if best is not None:
            advice = [f"  best: {best.says}, which leaves {best.sigma:.1f} σ between them"]
        else:
            advice = ["  none of these tells them apart; what would confirm each:"]
            advice += [f"  {name}: {words}" for name, words in self.confirm.items()]
        return (head, *rows, *advice)


@dataclass(frozen=True)
class Separation:
    """What would separate the members of every alias set of a diagnosis.

    Parameters
    ----------
    sets : tuple of SetSeparation
        One for each set of two or more.
    """

    sets: tuple[SetSeparation, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """What the experiments would tell; one line where there is nothing to separate."""
        if not self.sets:
            return ("No two names stand for the same: there is nothing to separate.",)
        return tuple(line for one in self.sets for line in one.lines)

    def to_json(self) -> dict[str, Any]:
        """Return the separation as plain JSON types."""
        sets = [{**asdict(one), "best": one.best and one.best.name} for one in self.sets]
        return {"told_apart_at_sigma": TOLD_APART, "sets": sets}


def separating_measurements(
    diagnosis: LagDiagnosis, *, changes: Sequence[Change] = CHANGES
) -> Separation:
    """Simulate further experiments and see which would tell aliases apart.

    Each member of an alias set, with the numbers that it has on these records, is simulated
    without noise on experiments derived from them; every other member is then fitted to that, and
    what it leaves is the distance, D = √(2 · gain).

    Parameters
    ----------
    diagnosis : LagDiagnosis
        With its alias sets.
    changes : sequence of Change
        The experiments.
    """
    sets, known = [], {effect.name: effect for effect in diagnosis.catalogue}
    for item in diagnosis.missing:
        names = tuple(name for name in item.alias_set if name in known)
        # A name that the workflow took from rows beside the model stands for nothing else.
        if len(names) < 2 or item.effect not in diagnosis.after.structure.names:
            continue
        rivals = _Rivals.of(diagnosis, item.effect, [known[name] for name in names])
        rng = np.random.default_rng(0)
        before, *made = (
            Measurement.of(change, rivals.distances(change, rng))
            for change in (AS_RECORDED, *changes)
        )
        if len({name in OF_ONE_TAP for name in names}) > 1:
            tap = rivals.with_second_tap(before.distances)
            made.append(Measurement.of(SECOND_TAP, tap))
        confirm = {name: known[name].confirm for name in names}
        sets.append(SetSeparation(names, before, tuple(made), confirm))
    return Separation(tuple(sets))


@dataclass(frozen=True)
class _Rivals:
    """The members of one alias set, each fitted to all rows in the place of the others."""

    effects: tuple[Effect, ...]
    fits: Mapping[str, Fit]
    without: Fit
    data: LagData
    metric: Metric

    @classmethod
    def of(cls, diagnosis: LagDiagnosis, winner: str, members: Sequence[Effect]) -> _Rivals:
        metric, after = diagnosis.rounds[-1].bench.metric, diagnosis.after
        data = diagnosis.data.all_fitted()
        effect = next(e for e in after.structure.effects if e.name == winner)
        without = refitted_on(after.without(effect), data, metric)
        prober = Prober(without, data, metric)
        fits = {
            member.name: after if member.name == winner else prober.fitted(member) or without
            for member in members
        }
        plain = Metric(diagnosis.noise.innovation, np.array(diagnosis.noise.ar))
        return cls(tuple(members), fits, without, data, plain)

    def distances(self, change: Change, rng: np.random.Generator) -> tuple[Distance, ...]:
        """Return how far each rival stays from each truth in an experiment."""
        there = changed(self.data, change)
        out: list[Distance] = []
        for truth in self.fits:
            data = there.with_measured(self._simulated(self.fits[truth], there, rng))
            base = self._base(data)
            prober = Prober(base, data, self.metric)
            # From here on the workflow tells two names apart that both gain so much.
            gap = max(LEAST_GAP, LEAST_GAP_SHARE * base.cost)
            asked = float(max(TOLD_APART, np.sqrt(2.0 * gap)))
            for rival in self.effects:
                if rival.name != truth:
                    own = self.fits[rival.name].values_of(rival)
                    begun = own if rival.adapted is None else rival.adapted(data, own)
                    fit = prober.fitted(rival, [begun]) or base
                    out.append(Distance(truth, rival.name, _sigma(fit), asked))
        return tuple(out)

    def with_second_tap(self, recorded: Sequence[Distance]) -> tuple[Distance, ...]:
        """Return the distances once a second transducer reads the same pressure.

        Where one effect is the transducer's own and the other is not, the second tap shows the
        one and not the other: either the two taps differ, or the second needs what it cannot have.
        """
        rng = np.random.default_rng(0)
        out = []
        for d in recorded:
            truth_of_tap, rival_of_tap = d.truth in OF_ONE_TAP, d.rival in OF_ONE_TAP
            clean = self._simulated(self.fits[d.truth], self.data, rng)
            sigma = d.sigma
            if truth_of_tap and not rival_of_tap:
                sigma = self._between_taps(d.truth, clean)
            elif rival_of_tap and not truth_of_tap:
                sigma = _sigma(self._base(self.data.with_measured(clean)))
            out.append(Distance(d.truth, d.rival, max(sigma, d.sigma), d.asked))
        return tuple(out)

    def _between_taps(self, name: str, clean: FloatArray) -> float:
        """Return how far two taps differ that both are noisy, one with an effect of its own."""
        fit = self.fits[name]
        bare = fit.without(next(effect for effect in self.effects if effect.name == name))
        groups = fit.groups(self.data)
        without = Fit.assembled(bare.structure, self.data, bare.nonlinear, groups)
        decay = fit.structure.respond_decay(self.data, fit.nonlinear)
        seen = self.metric.seen(clean - without.output(self.data), decay, self.data)
        return float(np.linalg.norm(seen) / np.sqrt(2.0))

    def _base(self, data: LagData) -> Fit:
        return refitted_on(self.without, data, self.metric)

    def _simulated(self, fit: Fit, there: LagData, rng: np.random.Generator) -> FloatArray:
        """Return ψ' of a model in an experiment, each effect measured from where it was fitted."""
        data = replace(there, references=self.data.references)
        groups = fit.groups(self.data)
        for effect in fit.structure.effects:
            if effect.episodes:
                gate = float(fit.values_of(effect)[1])
                size = float(np.sqrt(2.0 * np.mean(groups[effect.name] ** 2)))
                groups[effect.name] = ripple_waves(data, gate, size, rng)
        return Fit.assembled(fit.structure, data, fit.nonlinear, groups).output(data)


def _sigma(fit: Fit) -> float:
    return float(np.sqrt(2.0 * max(fit.cost, 0.0)))


def changed(data: LagData, change: Change) -> LagData:
    """Return rows as an experiment would leave them that differs by a change, ψ' unknown (zero).

    φ passes through the recorded values at another pace; where a record ends it goes back the way
    it came. Temperature and speed keep their slow trend with the clock, and their swing with φ. All
    scored rows are to be fitted.
    """
    scored = data.scored()
    phi = data.sampled(data["phi"])[scored]
    mean, span = float(phi.mean()), float(np.ptp(phi))
    runs, later_s = [], 0.0
    for number, fine in enumerate(data.fine_runs):
        run = _changed_run(data, number, change, mean, span)
        # Each run begins as much later as those before it have become longer.
        signals = {**run.signals, "time_s": run.signals["time_s"] + later_s}
        later_s += (run.nuisance.shape[0] - int(np.diff(fine)[0])) * data.step_s
        runs.append(replace(run, signals=signals))
    made = laid_out(runs, data.every)
    out = replace(
        data,
        **made,
        part=np.full(made["weight"].size, TRAIN, dtype=np.int8),
        record=np.repeat(data.record[data.runs[:, 0]], np.diff(made["runs"])[:, 0]),
    )
    # τ at another amplitude or a curve at another speed is the same model in other numbers: of the
    # references the range of φ alone is the experiment's own.
    return out.over_all_phi()


def _changed_run(data: LagData, index: int, change: Change, mean: float, span: float) -> Run:
    """Return one run of the experiment, its clock starting where it was."""
    first, stop = (int(edge) for edge in data.fine_runs[index])
    n_samples = int(np.diff(data.runs[index])[0])
    n_new = max(round((n_samples - 1) * change.length), 1) + 1
    size = stop - first
    passed = change.speed * np.arange((n_new - 1) * data.every + 1)
    turned = np.mod(passed, 2 * (size - 1))
    at = np.minimum(turned, 2 * (size - 1) - turned)
    swing, lower = _throttle(change, passed.size)
    signals: dict[str, FloatArray] = {}
    for name, values in data.signals.items():
        own = values[first:stop]
        if name.startswith("phi"):
            signals[name] = mean + swing * (_between(own, at) - mean) - lower * span
        elif name.startswith("amplitude"):
            signals[name] = swing * _between(own, at)
        elif name in CHANNELS:
            signals[name] = _channel(own, at)
        elif name in STATES:
            signals[name] = own[np.rint(at).astype(np.int64)]
    signals["time_s"] = data["time_s"][first] + data.step_s * np.arange(passed.size)
    slow = signals.get("phi_smooth", signals["phi"])
    signals["dphi_s"] = np.gradient(slow, data.step_s)
    if "T25_K" in signals:
        signals["dT25_K_s"] = np.gradient(signals["T25_K"], data.step_s)
    nearest = np.rint(at).astype(np.int64)
    samples = np.rint(at[:: data.every] / data.every).astype(np.int64)
    weight = data.weight[data.runs[index][0] + samples]
    return Run(signals, data.nuisance[first:stop][nearest], np.zeros(weight.size), weight)


def _throttle(change: Change, size: int) -> tuple[FloatArray, FloatArray]:
    """Return the swing and by how much φ is lowered, at every row of a run."""
    if not change.settings:
        return np.full(size, change.swing), np.full(size, change.lower)
    place = np.linspace(0.0, len(SETTINGS), size)
    centres = np.arange(len(SETTINGS)) + 0.5
    held = 0.5 - RAMP_SHARE
    edges = np.column_stack([centres - held, centres + held]).ravel()
    shift, swing = (np.repeat([s[i] for s in SETTINGS], 2) for i in range(2))
    return np.interp(place, edges, swing), -np.interp(place, edges, shift)


def _between(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a signal between its rows, by cubics."""
    from scipy.interpolate import CubicSpline

    if np.array_equal(at, np.arange(values.size)):
        return values
    return np.asarray(CubicSpline(np.arange(values.size), values)(at))


def _channel(values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a channel whose trend goes on with the clock while its swing follows φ."""
    rows = np.arange(values.size, dtype=np.float64)
    trend = np.polynomial.Polynomial.fit(rows, values, 1)
    left = values - trend(rows)
    return np.asarray(trend(np.arange(at.size, dtype=np.float64)) + _between(left, at))
