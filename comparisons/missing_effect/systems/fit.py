"""Fit of an extended system: Levenberg–Marquardt on the linearised runs, starts of runs estimated.

The size of each output's errors is fitted with the parameters (the concentrated likelihood), so
that outputs of different units weigh as their own errors ask for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.linearised import Linearised
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.places import rms
from comparisons.missing_effect.systems.shapes import Kind, Map
from comparisons.missing_effect.systems.simulate import FINE, Path, off_known, own_starts, path_of
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.types import FloatArray, IntArray

MOST_ITERATIONS = 40
# Log-units: a step that wins less ends the search.
SETTLED = 0.02
SETTLED_SHARE = 1e-5
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e9
FASTER, SLOWER = 0.2, 6.0
# Scale of a state before it has been simulated once, for the integrator's tolerance alone.
UNKNOWN_SCALE = 1e-3
# Held-out rows whose rms error is so many times that of fitted ones hold something of their own.
FORETOLD_BADLY = 2.5
# Share of the noise that the errors of a start may make of the errors of a run: 12 % more of them.
START_SHARE = 0.5


@dataclass(frozen=True)
class Fit:
    """A structure fitted to runs, which are its ``paths``.

    Theta holds parameters, timing offsets and effects; ``starts`` the state of the model and of its
    effects at the start of each run, ``scale`` the size of each state. The cost is the negative
    log-likelihood, the sizes of errors at their best, and what the starts cost. The errors of each
    run, (n, n_y), are measured minus simulated: not a number where there is no reading, infinite
    where the simulation failed.
    """

    structure: Structure
    theta: FloatArray
    starts: tuple[FloatArray, ...]
    scale: FloatArray
    cost: float
    errors: tuple[FloatArray, ...]
    paths: tuple[Path, ...]

    @property
    def failed(self) -> bool:
        """Whether a run of it could not be simulated."""
        return not np.isfinite(self.cost)

    @property
    def rms(self) -> FloatArray:
        """The rms error of each output."""
        return np.asarray(np.sqrt(np.nanmean(np.concatenate(self.errors) ** 2, axis=0)))

    @property
    def n_parameters(self) -> int:
        """Numbers fitted, among the starts of runs those of effects alone."""
        own = self.structure.started.size - len(self.structure.model.states)
        return int(self.structure.free.size) + own * len(self.starts)

    def again(
        self,
        runs: Sequence[Run],
        metric: Metric,
        starts: Sequence[FloatArray] | None = None,
        **how: Any,
    ) -> Fit:
        """Return it fitted from where it stands, as `fit_runs` does."""
        begun = self.starts if starts is None else starts
        return fit_runs(self.structure, runs, metric, self.theta, begun, self.scale, **how)

    def linearised(self, runs: Sequence[Run]) -> list[Linearised]:
        """Return its runs linearised."""
        return [
            Linearised(self.structure, run, self.theta, path, self.scale)
            for run, path in zip(runs, self.paths, strict=True)
        ]

    def signals(self, experiments: Sequence[Experiment]) -> list[FloatArray]:
        """Return states and inputs along each run, a column each."""
        n_x, names = len(self.structure.model.states), self.structure.model.input_names
        return [
            np.column_stack([path.states[::FINE, :n_x], experiment.columns(names)])
            for experiment, path in zip(experiments, self.paths, strict=True)
        ]

    def slopes(
        self, runs: Sequence[Run], metric: Metric, which: IntArray, rows: int | None, blocks: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the normal matrix of numbers of θ, and behind them the starts, and the slopes.

        Downhill: of what is known of starts, and of the errors of blocks of each run's rows.
        """
        m, k, scores = which.size, self.structure.started.size, []
        normal = np.diag(pull := np.zeros(m + k * len(runs)))
        for r, (one, errors) in enumerate(zip(self.linearised(runs), self.errors, strict=True)):
            at = np.r_[np.arange(m), m + k * r + np.arange(k)]
            J, error = (metric.whitened(e[:rows]) for e in (one.to_numbers(which), errors))
            # A number whose slope is none, as where a root begins at zero, stays where it is.
            J[:, :, ~np.isfinite(J).all(axis=(0, 1))] = 0.0
            for part in np.array_split(np.arange(len(error)), blocks):
                white, score = J[part].reshape(-1, at.size), np.zeros(pull.size)
                normal[np.ix_(at, at)] += white.T @ white
                score[at] = white.T @ error[part].ravel()
                scores.append(score)
            off, weight = off_known(self.structure, one.run, self.starts[r])
            normal[at[m:], at[m:]] += weight
            pull[at[m:]] -= off * weight
        return normal, pull, np.array(scores)


def scales_of(structure: Structure, paths: Sequence[Path]) -> FloatArray:
    """Return the rms of each state over runs, 1e-3 at least of nothing."""
    good = [path.states for path in paths if not path.failed]
    if not good:
        return np.full(structure.n_states, UNKNOWN_SCALE)
    joined = np.concatenate(good)
    return np.array([rms(joined[:, i]) for i in range(joined.shape[1])])


def fit_runs(
    structure: Structure,
    runs: Sequence[Run],
    metric: Metric,
    theta: FloatArray,
    starts: Sequence[FloatArray],
    scale: FloatArray | None = None,
    *,
    only_starts: bool = False,
    rows: int | None = None,
    most: int = MOST_ITERATIONS,
) -> Fit:
    """Fit a structure to runs, from numbers and from the state of the model at each run's start.

    The metric gives the colour of the errors, whose sizes are fitted; ``scale`` is the size of
    each state, where it is known. With ``only_starts`` the numbers stay as they are; ``rows`` of
    each run are scored, all without it; ``most`` counts the iterations.
    """
    which = np.zeros(0, dtype=np.int64) if only_starts else structure.free
    search = _Search(structure, tuple(runs), metric, which, rows)
    begun = tuple(own_starts(structure, run, x0) for run, x0 in zip(runs, starts, strict=True))
    known = scale is not None and scale.size == structure.n_states
    size = scale if known and scale is not None else np.full(structure.n_states, UNKNOWN_SCALE)
    low, high = structure.bounds
    point = search.at(np.clip(theta, low, high), begun, size, first=not known)
    if not known:
        size = scales_of(structure, point.paths)
        point = search.at(point.theta, begun, size)
    # The linearised run of a model on the brink of running away overflows.
    with np.errstate(invalid="ignore", over="ignore"):
        point = search.run(point, most)
    return replace(point, scale=scales_of(structure, point.paths))


@dataclass(frozen=True)
class _Search:
    structure: Structure
    runs: tuple[Run, ...]
    metric: Metric
    which: IntArray
    rows: int | None

    def at(
        self,
        theta: FloatArray,
        starts: tuple[FloatArray, ...],
        scale: FloatArray,
        *,
        first: bool = False,
    ) -> Fit:
        paths = tuple(
            path_of(self.structure, run, theta, start, scale, first=first)
            for run, start in zip(self.runs, starts, strict=True)
        )
        errors = tuple(
            np.where(run.valid, np.inf, np.nan) if path.failed else run.outputs - path.outputs
            for run, path in zip(self.runs, paths, strict=True)
        )
        cost = np.inf
        if not any(path.failed for path in paths):
            both = (off_known(self.structure, *one) for one in zip(self.runs, starts, strict=True))
            prior = sum(float(off**2 @ weight) for off, weight in both)
            # A few rows do not know how large their errors may be.
            few, scored = self.rows is not None, [e[: self.rows] for e in errors]
            cost = 0.5 * prior - self.metric.log_likelihood(scored, known=few)
        return Fit(self.structure, theta, starts, scale, float(cost), errors, paths)

    def run(self, point: Fit, most: int) -> Fit:
        """Search from a point."""
        unknowns = self.which.size + len(self.runs) * self.structure.started.size
        if not np.isfinite(point.cost) or not unknowns:
            return point
        damping, first = FIRST_DAMPING, point.cost
        damped = self.structure.model.simulate is not None
        for _ in range(most):
            normal, slope = self._normal(point)
            better = None
            while damping < MOST_DAMPING:
                step = self._step(point, normal, slope, damping)
                trial = self.at(*self._moved(point, step), point.scale)
                if trial.cost < point.cost:
                    better = trial
                    break
                damping *= SLOWER
                if np.max(np.abs(step) * np.sqrt(np.diag(normal))) < np.sqrt(SETTLED) / 10.0:
                    break
            if better is None:
                return point
            won, point = point.cost - better.cost, better
            damping = max(damping * FASTER, LEAST_DAMPING)
            if won < max(SETTLED, SETTLED_SHARE * (first - point.cost)):
                if not damped:
                    return point
                # Where numbers make up for each other it is the damping that makes steps short: a
                # lag of 30 s stayed at 25.2 ± 1.2 s, 10 log-units above the best.
                damped, damping = False, min(damping, FIRST_DAMPING**2)
        return point

    def _normal(self, point: Fit) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and the downhill slope, the starts of runs behind θ."""
        metric = self.metric.with_size_of([e[: self.rows] for e in point.errors])
        if self.rows is not None:
            known = zip(metric.sigma, self.metric.sigma, strict=True)
            metric = replace(metric, sigma=tuple(map(min, known)))
        normal, pull, scores = point.slopes(self.runs, metric, self.which, self.rows, 1)
        return normal, pull + scores.sum(axis=0)

    def _step(
        self, point: Fit, normal: FloatArray, slope: FloatArray, damping: float
    ) -> FloatArray:
        """Return a damped step within reach; what would leave its reach stops there.

        The others are solved for again beside what stops, or they would make up for a step that
        is not taken.
        """
        m = self.which.size
        low, high = self._reach(point.theta)
        step = np.zeros(slope.size)
        diagonal = np.diag(normal)
        free = np.isfinite(diagonal) & (diagonal > 0.0)
        for _ in range(m + 1):
            moving = np.flatnonzero(free)
            if moving.size == 0:
                return step
            unit = 1.0 / np.sqrt(diagonal[moving])
            matrix = normal[np.ix_(moving, moving)] * np.outer(unit, unit)
            matrix[np.diag_indices(moving.size)] += damping
            held = np.flatnonzero(~free)
            pull = slope[moving] - normal[np.ix_(moving, held)] @ step[held]
            step[moving] = np.linalg.lstsq(matrix, pull * unit, rcond=1e-14)[0] * unit
            at = moving[moving < m]
            at = at[(step[at] < low[at]) | (step[at] > high[at])]
            if not at.size:
                return step
            step[at] = np.clip(step[at], low[at], high[at])
            free[at] = False
        return step

    def _reach(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far each number may step: to its bounds, and shapes by a half of themselves.

        Over a threshold or a width the linearised run holds for a short way only.
        """
        which, structure = self.which, self.structure
        low, high = (bound[which] - theta[which] for bound in structure.bounds)
        for placed in structure.effects:
            own = structure.slots_of(placed)
            for slot in range(int(placed.effect.linear), len(placed.effect.numbers)):
                number = placed.effect.numbers[slot]
                # What may change its sign must not creep about zero.
                least = 0.1 * (number.high - number.low) if slot and number.low < 0.0 else 0.02
                for c in np.flatnonzero(which == own[slot]):
                    size = 0.5 * abs(float(theta[which[c]])) + least
                    low[c], high[c] = max(low[c], -size), min(high[c], size)
        return low, high

    def _moved(self, point: Fit, step: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        m, model = self.which.size, self.structure.model
        low, high = self.structure.bounds
        theta = point.theta.copy()
        theta[self.which] += step[:m]
        theta = np.clip(theta, low, high)
        starts = []
        for start, own in zip(point.starts, step[m:].reshape(len(point.starts), -1), strict=True):
            moved = start.copy()
            moved[self.structure.started] += own
            for i, p in enumerate(model.per_record.values(), start=model.own_states):
                moved[i] = np.clip(moved[i], p.low, p.high)
            starts.append(moved)
        return theta, tuple(starts)


def settled(fit: Fit, runs: Sequence[Run], metric: Metric, rows: int | None = None) -> Fit:
    """Return a fit on other runs: only their starts are estimated.

    Where they go far more wrong than the fitted runs, what nothing is known of begins again where
    those began or ended: a charge that began at nothing stayed beyond the end of its table.
    """
    how: dict[str, Any] = {"only_starts": True, "rows": rows}
    seen = [*fit.starts, *(path.states[-1] for path in fit.paths)]

    def begun(given: Sequence[Run]) -> Fit:
        first, starts = fit.again(given, metric, [run.x0_mean for run in given], **how), []
        if np.all(first.rms <= FORETOLD_BADLY * fit.rms):
            return first
        for run, start in zip(given, first.starts, strict=True):
            known = np.isfinite(run.x0_sd)
            others = [np.where(known, run.x0_mean, x[: known.size]) for x in seen]
            tried = [start, *(() if known.all() else others)]
            costs = [fit.again([run], metric, [x], **how, most=0).cost for x in tried]
            starts.append(tried[int(np.argmin(costs))])
        return fit.again(given, metric, starts, **how)

    blind = any(
        placed.effect.kind == Kind.OUTPUT_MAP and placed.effect.code == Map.ABSOLUTE
        for placed in fit.structure.effects
    )
    if not blind:
        return begun(runs)
    # A reading without a sign says nothing of which way a run begins: either, by what follows.
    either = [(run, replace(run, x0_mean=-run.x0_mean)) for run in runs]
    return begun([min(pair, key=lambda run: begun([run]).cost) for pair in either])


def start_error(
    fit: Fit, run: Run, metric: Metric, least: int, most: int
) -> tuple[int, FloatArray]:
    """Return how many rows fix a run's start, and the rms errors that its errors alone make.

    As many as it takes until those are half of the noise: the height of a drone from 15 rows at
    20 mm went wrong by 86 mm. The metric has the size of the noise.
    """
    if fit.failed:
        return least, np.zeros(run.outputs.shape[1])
    white = metric.whitened(fit.linearised([run])[0].to_numbers(np.zeros(0, dtype=np.int64)))
    scale = fit.scale[fit.structure.started]
    J = np.where(run.valid[:, :, None], white, 0.0) * scale
    known = np.cumsum(np.einsum("nyi,nyj->nij", J, J), axis=0)
    known += np.diag(scale**2 * off_known(fit.structure, run, fit.starts[0])[1])
    rows = least
    while True:
        spread = np.einsum("nyi,ij,nyj->y", J[rows:], np.linalg.pinv(known[rows - 1]), J[rows:])
        share = np.sqrt(spread / np.maximum(run.valid[rows:].sum(axis=0), 1))
        if np.all(share <= START_SHARE) or rows >= most:
            return rows, share * np.asarray(metric.sigma)
        rows = min(most, rows + max(1, rows // 5))
