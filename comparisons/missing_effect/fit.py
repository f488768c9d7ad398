"""A lag model and its joint fit: terms and effects, linear parameters solved, others stepped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product, starmap

import numpy as np
from scipy.linalg import qr

from comparisons.missing_effect.catalogue.workings import stall_episodes
from comparisons.missing_effect.effect import PORT_ORDER, Effect
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData
from comparisons.missing_effect.noise import Metric
from comparisons.missing_effect.ports import Ports, decay_of, respond
from surge_core.types import FloatArray

MOST_STEPS = 25
# A step that would win less than this many log-units ends the search: beside a threshold of
# evidence of ten it is nothing.
LEAST_GAIN = 1e-3
# log τ nearer than this to a bound is at it: a hundredth of τ, less than any fit states.
AT_END = 0.01
# Linear coefficients that belong to no effect.
TERMS, NUISANCE = "terms", "nuisance"


@dataclass(frozen=True)
class Structure:
    """Names of the terms s_i(φ) and the effects that are added to the lag, without numbers.

    The parameters that are not linear stand in one vector: log τ first, then those of each effect.
    """

    terms: tuple[str, ...]
    effects: tuple[Effect, ...] = ()

    def with_effect(self, effect: Effect) -> Structure:
        """Return the structure with one effect more."""
        return Structure(self.terms, (*self.effects, effect))

    @property
    def names(self) -> tuple[str, ...]:
        """Identifiers of the effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def bounds(self) -> FloatArray:
        """Bounds of the parameters that are not linear, of shape (p, 2)."""
        rows = [(np.log(1e-5), np.log(1e3))]
        rows += [(p.low, p.high) for effect in self.effects for p in effect.nonlinear]
        return np.array(rows)

    def at_end(self, nonlinear: FloatArray) -> bool:
        """Whether τ lies at the end of its search."""
        low, high = self.bounds[0]
        return not low + AT_END < nonlinear[0] < high - AT_END

    @property
    def steps(self) -> FloatArray:
        """Small steps of the parameters that are not linear, of shape (p,)."""
        return np.array([1e-4, *(p.step for effect in self.effects for p in effect.nonlinear)])

    @cached_property
    def slots(self) -> dict[str, range]:
        """Where in the vector the parameters of each effect stand, by its name."""
        ends = np.cumsum([1, *(len(effect.nonlinear) for effect in self.effects)]).tolist()
        return dict(zip(self.names, starmap(range, pairwise(ends)), strict=True))

    @property
    def free(self) -> tuple[int, ...]:
        """Which of the parameters that are not linear are fitted."""
        return (0, *(self.slots[e.name][i] for e in self.effects for i in e.free))

    @property
    def switching(self) -> tuple[int, ...]:
        """Which of them are thresholds at which the answer may change at once."""
        return tuple(self.slots[e.name][i] for e in self.effects if e.switches for i in e.free)

    def ports(self, data: LagData, nonlinear: FloatArray) -> Ports:
        """Return what stands at each port for log τ and the parameters of the effects."""
        ports = self.bare_ports(data, nonlinear)
        for effect in self.in_order:
            if effect.port != "input":
                ports = effect.acts(ports, data, self.values_of(effect, nonlinear))
        return ports

    def bare_ports(self, data: LagData, nonlinear: FloatArray) -> Ports:
        """Return the ports once the effects at the input have acted, and no others."""
        ports = Ports.of(data, data["phi"], ())
        for effect in self.in_order:
            if effect.port == "input":
                ports = effect.acts(ports, data, self.values_of(effect, nonlinear))
        return replace(Ports.of(data, ports.phi, self.terms), known=ports.known)

    @property
    def in_order(self) -> tuple[Effect, ...]:
        """The effects in the order in which a signal meets them; a ripple last."""
        return tuple(sorted(self.effects, key=lambda e: (PORT_ORDER.index(e.port), e.episodes)))

    def beside(
        self, data: LagData, start: FloatArray, shares: Sequence[float]
    ) -> Iterator[tuple[int, float, FloatArray]]:
        """Yield starts beside one: a threshold, how far it is moved either way, and the start.

        The steps are shares of the range of φ.
        """
        low, high = data.references.phi_range
        for at, share, sign in product(self.switching, shares, (-1.0, 1.0)):
            moved = start.copy()
            moved[at] += sign * share * (high - low)
            yield at, share * (high - low), moved

    def late_s(self, nonlinear: FloatArray) -> float:
        """Return how late φ acts: all amplitudes of effects at the input that are times."""
        late = [e for e in self.effects if e.port == "input" and e.parameters[0].unit == "s"]
        return float(sum(self.values_of(e, nonlinear)[0] for e in late))

    def values_of(self, effect: Effect, nonlinear: FloatArray) -> FloatArray:
        """Return the values of one effect out of the vector."""
        own = self.slots[effect.name]
        return nonlinear[own.start : own.stop]

    def layout(self, data: LagData, nonlinear: FloatArray) -> dict[str, slice]:
        """Return where the linear coefficients of the terms, nuisances and effects stand."""
        bare, n = self.bare_ports(data, nonlinear), len(self.terms)
        widths, behind = {TERMS: n}, dict[str, int]()
        for effect in self.in_order:
            if effect.linear:
                alone = effect.acts(bare, data, self.values_of(effect, nonlinear))
                driven = alone.driven.shape[1] - n
                home = widths if driven else behind
                home[effect.name] = driven or alone.added.shape[1]
        widths |= {NUISANCE: data.nuisance.shape[1], **behind}
        ends = np.cumsum([0, *widths.values()]).tolist()
        return dict(zip(widths, starmap(slice, pairwise(ends)), strict=True))

    def adapted(self, data: LagData, nonlinear: FloatArray) -> FloatArray:
        """Return the vector with held values as other rows ask for them."""
        out = nonlinear.copy()
        for effect in self.effects:
            if effect.adapted is not None:
                own = self.values_of(effect, nonlinear)
                out[list(self.slots[effect.name])] = effect.adapted(data, own)
        return out

    def respond_decay(self, data: LagData, nonlinear: FloatArray) -> FloatArray:
        """Return what is left, at each sample, of a start of its run that is off by one."""
        return decay_of(self.ports(data, nonlinear), data, float(np.exp(nonlinear[0])))

    def output(self, data: LagData, nonlinear: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return the model's answer for given coefficients, of shape (n,)."""
        return self.answer(data, self.ports(data, nonlinear), nonlinear, coefficients)

    def answer(
        self, data: LagData, ports: Ports, nonlinear: FloatArray, coefficients: FloatArray
    ) -> FloatArray:
        """Return the model's answer with something of one's own at the ports, of shape (n,)."""
        q, k = ports.driven.shape[1], data.nuisance.shape[1]
        nuisance = data.nuisance @ coefficients[q : q + k, None] if k else data.nuisance
        tau_s = float(np.exp(nonlinear[0]))
        columns = respond(ports.contracted(coefficients), data, tau_s, nuisance)
        return np.asarray(columns.sum(axis=1) + ports.known)


@dataclass(frozen=True)
class Fit:
    """A structure with its numbers: log τ and those of the effects, and the linear coefficients.

    The linear ones stand in the order of the terms, inputs that effects add, nuisances and added
    columns; ``cost`` is half the sum of squared errors in the metric of the fit.
    """

    structure: Structure
    nonlinear: FloatArray
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    cost: float = 0.0

    @property
    def tau_s(self) -> float:
        """Time constant, in seconds."""
        return float(np.exp(self.nonlinear[0]))

    @property
    def n_parameters(self) -> int:
        """Numbers that were fitted."""
        return len(self.structure.free) + self.coefficients.size

    @classmethod
    def assembled(
        cls,
        structure: Structure,
        data: LagData,
        nonlinear: FloatArray,
        groups: Mapping[str, FloatArray],
    ) -> Fit:
        """Put a model together from linear coefficients by group, to be run on some rows.

        What is not among the groups, or of another number on these rows, is zero.
        """
        layout = structure.layout(data, nonlinear)
        coefficients = np.zeros(max(rows.stop for rows in layout.values()))
        for name, rows in layout.items():
            if name in groups and len(groups[name]) == rows.stop - rows.start:
                coefficients[rows] = groups[name]
        return cls(structure, nonlinear, coefficients)

    def groups(self, data: LagData) -> dict[str, FloatArray]:
        """Return the linear coefficients by what they belong to, as `Structure.layout` names it."""
        layout = self.structure.layout(data, self.nonlinear)
        return {name: self.coefficients[rows] for name, rows in layout.items()}

    def values_of(self, effect: Effect) -> FloatArray:
        """Return the parameters of one effect that are not linear."""
        return self.structure.values_of(effect, self.nonlinear)

    def without(self, effect: Effect) -> Fit:
        """Return the model without an effect, to be fitted again."""
        kept = tuple(e for e in self.structure.effects if e.name != effect.name)
        others = np.delete(self.nonlinear, self.structure.slots[effect.name])
        return Fit(Structure(self.structure.terms, kept), others)

    def without_amplitude(self, effect: Effect, data: LagData) -> Fit:
        """Return the model with the amplitude of one effect at zero, everything else as it is."""
        nonlinear, coefficients = self.nonlinear.copy(), self.coefficients.copy()
        if effect.linear:
            coefficients[self.structure.layout(data, nonlinear)[effect.name]] = 0.0
        else:
            nonlinear[self.structure.slots[effect.name][0]] = 0.0
        return replace(self, nonlinear=nonlinear, coefficients=coefficients)

    def output(self, data: LagData) -> FloatArray:
        """Return the free run, each run from rest."""
        return self.structure.output(data, self.nonlinear, self.coefficients)

    def errors(self, data: LagData, metric: Metric) -> FloatArray:
        """Return the errors in a metric, with each run's start projected out."""
        decay = self.structure.respond_decay(data, self.nonlinear)
        return metric.seen(data.measured - self.output(data), decay, data)


@dataclass(frozen=True, eq=False)
class Solution:
    """The linear parameters at given others, and the errors that they leave in the metric.

    ``columns`` is the answer to each of them; ``basis`` spans it in the metric, orthonormally;
    ``decay`` is what a start leaves.
    """

    structure: Structure
    data: LagData
    metric: Metric
    nonlinear: FloatArray
    coefficients: FloatArray
    errors: FloatArray
    basis: FloatArray
    decay: FloatArray
    ports: Ports
    columns: FloatArray

    @cached_property
    def output(self) -> FloatArray:
        """The free run, each run from rest."""
        return np.asarray(self.columns @ self.coefficients + self.ports.known)

    @property
    def cost(self) -> float:
        """Half the sum of squared errors."""
        return 0.5 * float(self.errors @ self.errors)

    def slopes(self, which: Sequence[int]) -> FloatArray:
        """Return the derivative of the free run with respect to some parameters not linear.

        ``which`` are their places in ``nonlinear``, a column each.
        """
        structure, base = self.structure, self.output
        out = np.empty((base.size, len(which)))
        for column, i in enumerate(which):
            step = structure.steps[i]
            if self.nonlinear[i] + step > structure.bounds[i, 1]:
                step = -step
            moved = self.nonlinear.copy()
            moved[i] += step
            ports = self.ports if i == 0 else structure.ports(self.data, moved)
            there = structure.answer(self.data, ports, moved, self.coefficients)
            out[:, column] = (there - base) / step
        return out

    def free_slopes(self) -> FloatArray:
        """Return how the errors move with the searched parameters beyond what the others do."""
        slopes = self.slopes(self.structure.free)
        slopes[:, 0] += self._slope_of_starts()
        seen = self.metric.seen(slopes, self.decay, self.data)
        return np.asarray(seen - self.basis @ (self.basis.T @ seen))

    def _slope_of_starts(self) -> FloatArray:
        """Return how what is left of the starts of the runs moves with log τ.

        A short run, or one that begins in a reversal, ends at another τ without it.
        """
        left = self.data.measured - self.output
        seen, decay = (self.metric.whitened(v, self.data) for v in (left, self.decay))
        moved = -self.decay * np.log(np.maximum(self.decay, 1e-300))
        for run in self.data.slices:
            norm = float(decay[run] @ decay[run])
            moved[run] *= float(decay[run] @ seen[run]) / norm if norm > 1e-12 else 0.0
        return moved

    def stepped(self, damping: float) -> tuple[Solution, float]:
        """Return where a step that gains leads, and the next damping; itself where none gains."""
        free = list(self.structure.free)
        low, high = self.structure.bounds.T
        seen = self.free_slopes()
        normal, gradient = seen.T @ seen, seen.T @ self.errors
        size = np.diag(normal).copy()
        size[size <= 0.0] = 1.0
        while damping < 1e8:
            step = np.linalg.solve(normal + damping * np.diag(size), gradient)
            if float(gradient @ step) - 0.5 * float(step @ normal @ step) < LEAST_GAIN:
                break
            there = self.nonlinear.copy()
            there[free] += step
            there = np.clip(there, low, high)
            # log τ never moves by more than a factor of three at once.
            there[0] = np.clip(there[0], self.nonlinear[0] - 1.1, self.nonlinear[0] + 1.1)
            moved = solved(self.structure, self.data, self.metric, there)
            if np.isfinite(moved.cost) and moved.cost < self.cost:
                return moved, max(damping / 10.0, 1e-9)
            damping = max(10.0 * damping, 1e-3)
        return self, damping


def solved(structure: Structure, data: LagData, metric: Metric, nonlinear: FloatArray) -> Solution:
    """Solve for the linear parameters at given others."""
    ports = structure.ports(data, nonlinear)
    tau_s = float(np.exp(nonlinear[0]))
    columns, decay = respond(ports, data, tau_s), decay_of(ports, data, tau_s)
    joint = metric.seen(np.column_stack([columns, data.measured - ports.known]), decay, data)
    seen, target = joint[:, :-1], joint[:, -1]
    scale = np.sqrt(np.einsum("ij,ij->j", seen, seen))
    scale[scale == 0.0] = 1.0
    basis, triangle = qr(seen / scale, mode="economic", check_finite=False)
    diagonal = np.abs(np.diag(triangle))
    if diagonal.min(initial=1.0) > 1e-9:
        along = basis.T @ target
        coefficients = np.linalg.solve(triangle, along) / scale
    else:
        # Terms that the rows cannot separate: the least of all equally good answers.
        left, size, right = np.linalg.svd(seen / scale, full_matrices=False)
        kept = size > 1e-9 * size[0]
        basis = left[:, kept]
        along = basis.T @ target
        coefficients = (right[kept].T @ (along / size[kept])) / scale
    errors = target - basis @ along
    return Solution(
        structure, data, metric, nonlinear, coefficients, errors, basis, decay, ports, columns
    )


def fit_structure(
    structure: Structure, data: LagData, metric: Metric, starts: Sequence[FloatArray]
) -> Fit:
    """Fit τ, terms and effects jointly to all scored rows, from the best of several starts.

    Gauss-Newton on log τ and the other parameters that are not linear, with the linear ones solved
    at each step (variable projection, Kaufman's slopes) and a trust factor; stays within the
    bounds.
    """
    fits = [_descend(structure, data, metric, start) for start in starts]
    # Starts may differ in how many columns they bring. Half a log-unit for each, what noise alone
    # would win, and not half log n: too coarse a spline leaves structure behind, one too fine
    # costs little.
    return min(fits, key=lambda fit: fit.cost + 0.5 * fit.n_parameters)


def _descend(structure: Structure, data: LagData, metric: Metric, start: FloatArray) -> Fit:
    here = np.clip(np.asarray(start, dtype=np.float64), *structure.bounds.T)
    found = solved(structure, data, metric, here)
    damping = 1e-4
    for _ in range(MOST_STEPS):
        before = found.cost
        found, damping = found.stepped(damping)
        if before - found.cost < LEAST_GAIN:
            break
    return Fit(structure, found.nonlinear, found.coefficients, found.cost)


def errors_on(fit: Fit, data: LagData, metric: Metric) -> tuple[FloatArray, tuple[float, float]]:
    """Return the errors on all rows of a fit to the fitted ones, and what phases cost.

    The phase of a ripple means nothing in another episode: where it was not fitted it is fitted
    again, at the amplitude of the rest, and costs one log-unit, in later time or another record.
    """
    ripple = next((effect for effect in fit.structure.effects if effect.episodes), None)
    if ripple is None:
        return fit.errors(data, metric), (0.0, 0.0)
    frequency_hz, gate = fit.values_of(ripple)
    # The ripple stands last behind the lag, so its columns are the last ones.
    n_bare = fit.coefficients.size - 2 * len(stall_episodes(data.train, float(gate)))
    bare = replace(fit.without(ripple), coefficients=fit.coefficients[:n_bare])
    errors = bare.errors(data, metric)
    amplitudes = fit.coefficients[n_bare:]
    size = float(np.sqrt(2.0 * np.mean(amplitudes**2))) if amplitudes.size else 0.0
    phase = 2.0 * np.pi * frequency_hz * data.sampled(data["time_s"])
    costs = {TRAIN: 0.0, LATER: 0.0, OTHER: 0.0}
    for rows in stall_episodes(data, float(gate)):
        near = slice(rows.start, min(rows.stop + metric.ar.size, data.n_samples))
        columns = np.zeros((data.n_samples, 2))
        columns[rows, 0], columns[rows, 1] = np.sin(phase[rows]), np.cos(phase[rows])
        seen = metric.whitened(columns, data)[near]
        along = np.linalg.lstsq(seen, errors[near], rcond=None)[0]
        part, norm = int(data.part[rows].max()), float(np.hypot(*along))
        if part != TRAIN and norm > 0.0:
            along = along * (size / norm)
            costs[part] += 1.0
        errors[near] -= seen @ along
    return errors, (costs[LATER], costs[OTHER])
