"""A model that stands so far, on its records: its inputs between samples, its timing offsets.

Parameters are fitted in the raw metric, which is what a simulation is judged by; timing offsets in
a whitening one, since what happens within a sample is lost in the slow part of the raw errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self, TypeAlias

import numpy as np
from scipy.stats.qmc import Sobol

from comparisons.missing_effect.systems.experiments import FEWEST_ROWS
from comparisons.missing_effect.systems.fit import Fit, fit_runs, settled
from comparisons.missing_effect.systems.metric import Metric, metric_of, raw_metric
from comparisons.missing_effect.systems.records import Records, rows_together, runs_of
from comparisons.missing_effect.systems.simulate import FINE, why_failed
from comparisons.missing_effect.systems.structure import (
    FIRST_TOLERANCE,
    HALF_SAMPLE,
    MOST_OFFSET,
    Between,
    Run,
    Structure,
)
from surge_core.errors import require
from surge_core.types import FloatArray

# Steps in a whitening metric, whose valleys are narrow and bent.
MOST_WHITENED = 20
INTERPOLATIONS = ("cubic", "linear", "band", "held")
# Another way between samples is taken only when the raw held-out error falls to this share, or
# when it stays within as much and the whitened one wins so many log-units.
BETTER_BETWEEN, BETTER_WHITE = 0.995, 10.0
# The integrator's tolerance as a share of what is new in each error over the output's swing.
TOLERANCE_SHARE, LEAST_TOLERANCE = 0.15, 1e-9
# Timing offsets that whitened errors ask for may cost this much of the raw held-out error. They are
# asked for again where they win as much: an arm stood at 12.6, and then at 7.5, where 7.0 is best.
BETTER_TIMED = 0.95
# Rows on which candidates race, in windows of so many.
MOST_RACED, WINDOW_ROWS = 3000, 500
# Starts of the user's model that are simulated beside the one given, a tenth to ten times of each
# number; how many of them are fitted, and for how many steps.
DRAWN, SEARCHED, STEPS_SEARCHED = 64, 8, 8
# The first rows of a record that are fitted before twice as many are, as a share of one, and from
# how many starts: one more start, kept where the whole record is likelier by it. Four chains in
# place of one brought nothing to 24 oscillators.
FIRST_ROWS_SHARE, FIRST_STARTS = 16, 4
# Log-units that another optimum must win: 1 % by chance, one-sided.
OTHER_OPTIMUM = 0.5 * 2.33**2
# Rows of each record, and steps of the search, for the way between samples.
FITTED_BETWEEN, HELD_OUT_BETWEEN, STEPS_BETWEEN = 2000, 1000, 8
# Raw error and cost in a metric of a stretch of held-out rows, and θ in between.
Misfit: TypeAlias = tuple[float, float, FloatArray]


@dataclass(frozen=True)
class Bench:
    """A model that stands so far, in the raw metric, and the records.

    Of the records ``train`` is fitted and ``later`` held out; ``white`` is the same model fitted in
    a whitening metric, where the next such fit begins.
    """

    records: Records
    train: tuple[Run, ...]
    later: tuple[Run, ...]
    fit: Fit
    white: Fit | None = None

    @classmethod
    def of(cls, records: Records) -> Self:
        """Fit the user's model as it is, and choose how its inputs run between samples."""
        between = _ways(records, "cubic")
        structure = Structure(records.model, (), between, offsets_free=False)
        train, later = _runs(records, between)
        raw = raw_metric([run.outputs for run in train])
        fit = _best_start(structure, train, raw, records)
        _require_simulated(fit, train)
        # The whitened errors of the model as it is bound the noise from above.
        noise = np.array(metric_of(fit.errors).sigma)
        least = TOLERANCE_SHARE * np.min(noise / np.array(raw.sigma))
        tolerance = float(np.clip(least, LEAST_TOLERANCE, FIRST_TOLERANCE))
        finer = replace(structure, tolerance=tolerance)
        return cls(records, train, later, fit).refitted(finer, fit.theta).timed().between_chosen()

    @property
    def failed(self) -> bool:
        """Whether the model could not be simulated."""
        return self.fit.failed

    @property
    def raw(self) -> Metric:
        """The raw metric."""
        return raw_metric([run.outputs for run in self.train])

    @property
    def late(self) -> list[int]:
        """Inputs whose timing offset ends at its limit, in either metric."""
        ends = [f.theta[f.structure.offsets] for f in (self.fit, self.white) if f is not None]
        return np.flatnonzero(np.max(ends, axis=0) >= MOST_OFFSET).tolist()

    def raced(self) -> Self:
        """Return the bench with windows spread over the fitted rows, where those are many.

        A race tells candidates apart on a few thousand rows; what acts in episodes is met in a
        window somewhere. Each window begins from what is measured, else from where the model is.
        """
        total = sum(run.n_samples for run in self.train)
        if total <= MOST_RACED or self.records.model.per_record:
            return self
        stretches, starts = [], []
        for record, path in zip(self.records.fitted, self.fit.paths, strict=True):
            count = max(1, round(MOST_RACED * record.n_samples / total / WINDOW_ROWS))
            for first in np.linspace(0, record.n_samples - WINDOW_ROWS, count).astype(int):
                stretches.append(record.rows(int(first), int(first) + WINDOW_ROWS))
                starts.append(path.states[FINE * int(first)])
        train = runs_of(self.records, stretches, self.fit.structure.between, begun=False)
        begun = [
            np.where(np.isfinite(run.x0_sd), run.x0_mean, start[: run.x0_mean.size])
            for run, start in zip(train, starts, strict=True)
        ]
        fit = self.fit.again(train, raw_metric([run.outputs for run in train]), begun)
        return self if fit.failed else replace(self, train=train, fit=fit)

    def held_out_rms(self) -> FloatArray:
        """Return the rms error of each output on the held-out rows, starts estimated there."""
        return settled(self.fit, self.later, self.raw).rms

    def refitted(self, structure: Structure, theta: FloatArray) -> Self:
        """Return the bench with another model, fitted in the raw metric; its offsets are held."""
        bench = self.laid(structure.between)
        held = replace(structure, offsets_free=False)
        # Where effects are gone, their states are as well.
        known = self.fit.structure.effects
        kept = None if structure.effects[: len(known)] == known else len(structure.model.states)
        starts = [start[:kept] for start in self.fit.starts]
        fit = fit_runs(held, bench.train, self.raw, theta, starts)
        return replace(bench, fit=fit)

    def with_better(self, white: Fit, raw: Fit | None) -> Self:
        """Return the bench with what a round found, from the better of two ends of its race.

        The whitened fit and the raw race may end in different valleys of the raw error.
        """
        moved = [self.refitted(white.structure, white.theta)]
        if raw is not None and not raw.failed:
            moved.append(self.refitted(raw.structure, with_offsets(raw, white)))
        return replace(min(moved, key=lambda bench: bench.fit.cost), white=white)

    def over_whole_records(self) -> Self:
        """Return the bench with all rows of its records fitted or held out, and the model refitted.

        What changes slowly shows over a whole record, and not over its first seconds.
        """
        structure, records = self.fit.structure, self.records.cut()
        train, later = _runs(records, structure.between)
        whole = replace(self, records=records, train=train, later=later, white=None)
        return whole.refitted(structure, self.fit.theta)

    def timed(self) -> Self:
        """Return the bench with the timing offsets that whitened errors ask for, while they pay.

        A wrong one whitens itself away in part: of 0.95 samples once found 0.88. With room for more
        than a row before the record from the start, offsets stood in for what was missing.
        """
        if not self.records.model.inputs or self.fit.failed:
            return self
        white = self.whitened(self.fit, metric_of(self.fit.errors))
        moved = self.refitted(self.fit.structure, with_offsets(self.fit, white))
        share = moved.held_out_size() / self.held_out_size()
        if not share < BETTER_TIMED:
            return replace(moved if share < 1.0 / BETTER_TIMED else self, white=white)
        fit, earliest = moved.fit, moved.fit.structure.earliest
        if min(fit.theta[fit.structure.offsets]) <= -earliest:
            fit = replace(fit, structure=replace(fit.structure, earliest=earliest + MOST_OFFSET))
        return replace(moved, fit=fit, white=white).timed()

    def held_out_size(self) -> float:
        """Return the held-out error, outputs joined by their geometric mean."""
        sizes = self.held_out_rms()
        return float(np.exp(np.mean(np.log(sizes)))) if np.all(np.isfinite(sizes)) else np.inf

    def laid(
        self, between: Between, fitted: int | None = None, held_out: int | None = None
    ) -> Self:
        """Return the bench with inputs laid otherwise between samples, or with fewer rows."""
        if between == self.fit.structure.ways and fitted is None:
            return self
        train, later = _runs(self.records, between, fitted, held_out)
        return replace(self, train=train, later=later)

    def between_chosen(self) -> Self:
        """Return the bench with its inputs between samples as they foretell held-out rows best.

        Another way is taken when the raw error on held-out rows falls by it; or when it stays and
        the error in the metric of the model's own colour falls, since what happens within a
        sample can be lost in the slow part of the raw error. A stretch of each record is enough.
        """
        opened = [j for j, way in enumerate(self.records.between) if way == "auto"]
        if not opened or self.fit.failed:
            return self
        now = self.fit.structure.ways
        short = self.laid(now, FITTED_BETWEEN, HELD_OUT_BETWEEN)
        rows = [e[: run.n_samples] for e, run in zip(self.fit.errors, short.train, strict=True)]
        metric = metric_of(rows)
        # Not where the model stands, which may have come from what it lacked, but the first of the
        # ways has the advantage.
        best, *others = (_ways(self.records, how) for how in INTERPOLATIONS)
        least = self._misfits(best, metric)

        def better(between: tuple[str, ...], ahead: float) -> tuple[tuple[str, ...], Misfit]:
            own = self._misfits(between, metric)
            falls = own[0] < BETTER_BETWEEN * least[0]
            stays = own[0] < least[0] / BETTER_BETWEEN and own[1] < least[1] - ahead
            return (between, own) if falls or stays else (best, least)

        for between in others:
            best, least = better(between, BETTER_WHITE)
        # What is late by half a sample where it runs smoothly is held, and the other way about,
        # unless the errors speak against it: few records are half a sample late.
        for j in opened if len(now) > 1 else ():
            late, held = least[2][self.fit.structure.offsets][j], best[j] == "held"
            if (-late if held else late) > HALF_SAMPLE / 2.0:
                smooth = next((best[i] for i in opened if best[i] != "held"), INTERPOLATIONS[0])
                other = (*best[:j], smooth if held else "held", *best[j + 1 :])
                best, least = better(other, -BETTER_WHITE)
        if best == now:
            return self
        moved = self.refitted(replace(self.fit.structure, between=best), least[2])
        # What is better on a stretch must not be worse on the whole.
        return moved if moved.held_out_size() < self.held_out_size() / BETTER_BETWEEN else self

    def _misfits(self, between: tuple[str, ...], metric: Metric) -> Misfit:
        """Return raw error and cost in a metric of a stretch of held-out rows, and θ in between."""
        structure = replace(self.fit.structure, between=between)
        short = self.laid(between, FITTED_BETWEEN, HELD_OUT_BETWEEN)
        laid = replace(short, fit=replace(self.fit, structure=structure))
        white = laid.whitened(self.fit, metric)
        theta = with_offsets(self.fit, white)
        # What is held is late by half a sample itself: beyond one sample in all it is a delay.
        late = theta[structure.offsets] > MOST_OFFSET - HALF_SAMPLE
        opened = np.array([way == "auto" for way in self.records.between])
        if np.any(late & opened & (np.array(between) == "held")):
            return np.inf, np.inf, theta
        begun = replace(white, structure=replace(structure, offsets_free=False), theta=theta)
        raw = begun.again(short.train, self.raw, most=STEPS_BETWEEN)
        if raw.failed or white.failed:
            return np.inf, np.inf, theta
        costs = [
            -own.log_likelihood(settled(fit, short.later, own).errors)
            for fit, own in ((raw, self.raw), (white, metric))
        ]
        n = sum(run.n_samples for run in short.later) * len(self.raw.sigma)
        return float(np.exp(costs[0] / n)), costs[1], theta

    def whitened(self, fit: Fit, metric: Metric) -> Fit:
        """Fit a model in a whitening metric, timing offsets free.

        The search begins where it costs least: at the raw fit, or at the model as it was last
        whitened, with what the raw fit has in addition.
        """
        free = replace(self.fit.structure, effects=fit.structure.effects, offsets_free=True)
        begun = [replace(fit, structure=free)]
        if self.white is not None:
            known = self.white.theta
            theta = np.concatenate([known, fit.theta[known.size :]])
            begun.append(replace(begun[0], theta=theta, starts=self.white.starts))
            begun.sort(key=lambda one: one.again(self.train, metric, most=0).cost)
        return begun[0].again(self.train, metric, most=MOST_WHITENED)

    def growth_of(self, fit: Fit) -> float:
        """Return by how many powers of e changes of the state grow along the runs, at most."""
        return max(one.growth() for one in fit.linearised(self.train))


def _require_simulated(fit: Fit, train: Sequence[Run]) -> None:
    """Refuse a model that cannot be simulated from its starts, with what it comes upon."""
    model = fit.structure.model
    at = ", ".join(f"{name} = {p.start:g}" for name, p in model.params.items())
    for run, path, start in zip(train, fit.paths, fit.starts, strict=True):
        require(
            not path.failed,
            f"model: {'rhs' if model.simulate is None else 'simulate'}",
            f"a simulation of {run.experiment.name} from the starts ({at})",
            why_failed(fit.structure, run, fit.theta, start) if path.failed else "",
            "correct it, or give other starts or bounds",
        )


def _best_start(structure: Structure, train: Sequence[Run], raw: Metric, records: Records) -> Fit:
    """Fit a model from the user's start, and from others where those end far better.

    A resonance that starts beside the measured one ends in a model that answers nothing, and what
    is left of it would be looked for among the names.
    """
    params, first = structure.model.params.values(), structure.start()
    starts = [run.x0_mean for run in train]
    fit = fit_runs(structure, train, raw, first, starts)
    if not params:
        return fit

    def begun(theta: FloatArray, most: int) -> Fit:
        return fit_runs(structure, train, raw, theta, starts, fit.scale, most=most)

    low, high, start = np.array([(p.low, p.high, p.start) for p in params]).T
    drawn = Sobol(start.size, scramble=False).random(DRAWN)
    size = np.where(start == 0.0, low + (high - low) * drawn, start * 10.0 ** (2.0 * drawn - 1.0))
    others = [np.r_[own, first[start.size :]] for own in np.clip(size, low, high)]
    near = sorted(others, key=lambda theta: begun(theta, 0).cost)[:SEARCHED]
    near += _from_first_rows(structure, raw, records, (first, *others))
    best = min((begun(theta, STEPS_SEARCHED) for theta in near), key=lambda f: f.cost)
    if best.failed:
        return fit
    best = best.again(train, raw)
    # Errors that go together count once.
    won = (fit.cost - best.cost) / rows_together(best)
    return best if won > OTHER_OPTIMUM else fit


def _from_first_rows(
    structure: Structure, raw: Metric, records: Records, begun: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return numbers fitted to the first rows of each record, then to twice as many, up to all.

    Where a model swings freely, a whole run whose period is a little off answers nothing: of 12
    pairs of predator and prey, over up to 25 periods, 6 ended there from all other starts.
    """
    fits: list[Fit] = []
    longest = max(e.n_samples for e in records.fitted)
    rows = max(longest // FIRST_ROWS_SHARE, FEWEST_ROWS)
    while rows < longest:
        runs = _runs(records, structure.ways, rows)[0]
        rows *= 2
        if min(np.min(run.valid.sum(axis=0)) for run in runs) < structure.free.size:
            continue
        fit = partial(fit_runs, structure, runs, raw)
        starts = [run.x0_mean for run in runs]
        if not fits:
            near = sorted(begun, key=lambda theta: fit(theta, starts, most=0).cost)
            fits = [
                fit(theta, starts, most=STEPS_SEARCHED)
                for theta in (begun[0], *near[:FIRST_STARTS])
            ]
        else:
            starts = [s[: x0.size] for s, x0 in zip(fits[0].starts, starts, strict=True)]
            fits = [fit(fits[0].theta, starts, most=STEPS_SEARCHED)]
        fits = [min(fits, key=lambda one: one.cost)]
    return [one.theta for one in fits if not one.failed]


def _runs(
    records: Records, between: Between, fitted: int | None = None, held_out: int | None = None
) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """Return what is fitted and what is held out, or so many rows of each record."""
    train = [e.rows(0, fitted or e.n_samples) for e in records.fitted]
    later = [e.rows(0, held_out or e.n_samples) for e in records.held_out]
    first = runs_of(records, train, between, begun=True)
    return first, runs_of(records, later, between, begun=False)


def _ways(records: Records, how: str) -> tuple[str, ...]:
    """Return how each input runs between samples, the open ones in this way."""
    return tuple(how if way == "auto" else way for way in records.between)


def with_offsets(fit: Fit, timed: Fit) -> FloatArray:
    """Return θ of a fit with the timing offsets of another."""
    theta, at = fit.theta.copy(), fit.structure.offsets
    theta[at] = timed.theta[at]
    return theta
