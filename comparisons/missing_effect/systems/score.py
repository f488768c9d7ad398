"""Score tests: how much each effect at each place would win, from one simulation of the model.

An effect is laid along the run that the model gives; how the outputs would answer to it, to first
order, is one column. What is left of the column beside those of everything that is fitted already
is held against the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.covariance import orthonormal
from comparisons.missing_effect.nulls import chance_of
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import Metric, correlations
from comparisons.missing_effect.systems.places import AT_OUTPUTS, Place, Placed, SystemEffect, rms
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Run
from surge_core.types import FloatArray

# Effects whose columns are made together.
LAID_TOGETHER = 16
# A column that keeps less than this share of itself beside what is fitted already says nothing.
LEAST_OWN_SHARE = 1e-6
# Directions of what is fitted already that are no rounding.
LEAST_BASIS = 1e-9
# Flips of sign, the quantile of the largest gain that counts as chance, rows of a block, and
# fewest blocks of a run.
FLIPS, CHANCE, FLIPPED_ROWS, FEWEST_FLIPPED = 1000, 0.99, 20, 12
# Share of its power below which an autocorrelation remembers nothing.
REMEMBERED = 0.1
# Columns that are paired, and the cosine from which on two say the same.
MOST_PAIRED, LARGEST_COSINE = 250, 0.98
# Rows of a run on which a term of the user's own is sized.
SIZED_ROWS = 500
# What acts within a model, where a black box lets nothing in.
INSIDE = (Kind.TERM, Kind.HYSTERESIS, Kind.STATE_LIMIT, Kind.OVERFLOW)


@dataclass(frozen=True)
class Probe:
    """What one effect at one place promises, from the start that promises most.

    The errors ask for so much of it, the amplitude, by first order, and it would win its gain in
    log-units; together with a second effect, if there is one.
    """

    placed: Placed
    start: tuple[float, ...]
    amplitude: float
    gain: float
    second: Probe | None = None

    @property
    def added(self) -> tuple[Placed, ...]:
        """The effects."""
        return (self.placed,) if self.second is None else (self.placed, self.second.placed)

    @property
    def key(self) -> frozenset[object]:
        """What makes it the same as another, whatever the order."""
        return frozenset(placed.key for placed in self.added)

    @property
    def unnamed(self) -> bool:
        """Whether a term without a name is part of it."""
        return any(placed.effect.unnamed for placed in self.added)


@dataclass(frozen=True)
class Answers:
    """First-order answers to effects in a metric, free of what is fitted already.

    Columns, (n, K), are of unit length, one a probe; n counts the rows of all outputs of all runs.
    Errors are whitened; each row is in a block, for flips of sign.
    """

    probes: tuple[Probe, ...]
    columns: FloatArray
    error: FloatArray
    block: NDArray[np.int64]

    def of(self, wanted: Sequence[Placed]) -> Answers:
        """Return the answers to some of the effects."""
        keys = {placed.key for placed in wanted}
        kept = [k for k, probe in enumerate(self.probes) if probe.placed.key in keys]
        probes = tuple(self.probes[k] for k in kept)
        return replace(self, probes=probes, columns=self.columns[:, kept])

    def best(self) -> list[Probe]:
        """Return the best start of each effect at each place, best first."""
        kept: dict[object, Probe] = {}
        for probe in sorted(self.probes, key=lambda p: -p.gain):
            kept.setdefault(probe.key, probe)
        return list(kept.values())

    def pairs(self, most: int, least: float) -> list[Probe]:
        """Return the pairs that win clearly more together than either alone, best first.

        Effects that hide each other lose one at a time: a pair is found from one matrix of
        products of all columns.
        """
        index = {id(p): k for k, p in enumerate(self.probes)}
        pool = [index[id(p)] for p in self.best()[:MOST_PAIRED]]
        if len(pool) < 2:
            return []
        columns = self.columns[:, pool]
        gram, along = columns.T @ columns, columns.T @ self.error
        below = 1.0 - gram**2
        np.fill_diagonal(below, 1.0)
        below = np.where(below < 1.0 - LARGEST_COSINE**2, np.inf, below)
        first = (along[:, None] - gram * along[None, :]) / below
        both = 0.5 * (along[:, None] * first + along[None, :] * first.T)
        effects = [self.probes[k].placed.effect for k in pool]
        signs = np.array([(e.allows(-1.0), e.allows(1.0)) for e in effects])
        fits = np.where(first < 0.0, signs[:, :1], signs[:, 1:])
        # A coefficient whose sign is no physics of the effect is none.
        both = np.where(fits & fits.T, both, 0.0)
        # A name beside a term without one is no answer: names pair with names.
        open_ = np.array([self.probes[k].unnamed for k in pool])
        both = np.where(open_[:, None] == open_[None, :], both, 0.0)
        alone = np.array([self.probes[k].gain for k in pool])
        extra = both - np.maximum(alone[:, None], alone[None, :])
        ranked = np.argsort(-np.triu(np.where(extra > least, both, 0.0), 1), axis=None)
        out: list[Probe] = []
        for i, j in (divmod(int(at), len(pool)) for at in ranked[: 4 * most]):
            if i >= j or not extra[i, j] > least or len(out) == most:
                continue
            first_two = sorted((i, j), key=lambda k: -alone[k])
            # What has a name in the same form goes by it.
            one, two = (
                self._named(self.probes[pool[k]], float(first[k, i + j - k])) for k in first_two
            )
            out.append(replace(one, gain=float(both[i, j]), second=two))
        return out

    def _named(self, probe: Probe, amount: float) -> Probe:
        """Return the probe of a name that is the same term with this sign, or the one given."""

        def form(one: Probe) -> tuple[object, ...]:
            effect = one.placed.effect
            return one.placed.place, one.placed.floats, effect.kind, effect.code, effect.expression

        named = (p for p in self.probes if not p.unnamed and form(p) == form(probe))
        return next((p for p in named if p.placed.effect.allows(amount)), probe)

    def chance(self, rng: np.random.Generator) -> float:
        """Return what the best of all columns wins by chance: signs of blocks of errors flipped.

        Flips leave each block its size and its colour; what is not tied to the inputs wins as much
        with them as without. A constant would be too low where errors are large in a few places.
        """
        return float(np.quantile(self.flipped(rng), CHANCE)) if self.probes else 0.0

    def p_value(self, flips: int) -> float:
        """Return the chance of the largest first-order gain, by so many flips."""
        gain = max((probe.gain for probe in self.probes), default=0.0)
        return chance_of(gain, self.flipped(np.random.default_rng(0), flips))

    def flipped(self, rng: np.random.Generator, flips: int = FLIPS) -> FloatArray:
        """Return the largest first-order gain under each of many flips of sign."""
        n_blocks = int(self.block.max()) + 1
        sums = np.zeros((n_blocks, len(self.probes)))
        np.add.at(sums, self.block, self.columns * self.error[:, None])
        along = rng.choice([-1.0, 1.0], size=(flips, n_blocks)) @ sums
        return np.asarray(0.5 * np.max(along**2, axis=1, initial=0.0))


class Prober:
    """Score tests of effects against a model, fitted to runs; laid once for all metrics."""

    def __init__(self, fit: Fit, runs: Sequence[Run], effects: Sequence[Placed]) -> None:
        self.fit, self.runs = fit, tuple(runs)
        along, free = fit.linearised(self.runs), fit.structure.free
        self._nuisance = [one.to_numbers(free) for one in along]
        self._laid = [(placed, start) for placed in effects for start in placed.starts]
        self._columns: list[list[FloatArray]] = []
        for first in range(0, len(self._laid), LAID_TOGETHER):
            some = self._laid[first : first + LAID_TOGETHER]
            each = [one.to_effects(some) for one in along]
            self._columns += [[columns[:, :, c] for columns in each] for c in range(len(some))]

    def in_metric(self, metric: Metric) -> Answers:
        """Return the first-order answers to the effects in a metric."""
        own = metric.with_size_of(self.fit.errors)
        error = _joined([own.whitened(e) for e in self.fit.errors])
        basis = self._basis(own)
        error = error - basis @ (basis.T @ error)
        probes, columns = [], []
        for (placed, start), runs in zip(self._laid, self._columns, strict=True):
            with np.errstate(invalid="ignore"):
                column = _joined([own.whitened(c) for c in runs])
            if not np.all(np.isfinite(column)):
                continue
            whole = float(column @ column)
            column = column - basis @ (basis.T @ column)
            size = float(column @ column)
            if not size > LEAST_OWN_SHARE * whole:
                continue
            along = float(column @ error)
            gain = 0.5 * along**2 / size if placed.effect.allows(along) else 0.0
            probes.append(Probe(placed, start, along / size, gain))
            columns.append(column / np.sqrt(size))
        joined = np.column_stack(columns) if columns else np.zeros((error.size, 0))
        return Answers(tuple(probes), joined, error, self._blocks(own))

    def _blocks(self, metric: Metric) -> NDArray[np.int64]:
        """Return a block of each row: twenty rows, or twice as many as the errors remember."""
        remembered = _memory(metric.whitened(max(self.fit.errors, key=len)))
        out, first = [], 0
        for e in self.fit.errors:
            rows = max(FLIPPED_ROWS, min(2 * remembered, e.shape[0] // FEWEST_FLIPPED))
            own = first + np.arange(e.shape[0]) // rows
            out.append(np.repeat(own, e.shape[1]))
            first = int(own[-1]) + 1
        return np.concatenate(out)

    def _basis(self, metric: Metric) -> FloatArray:
        """Return an orthonormal basis of what is fitted already, starts of runs among it."""
        from scipy.linalg import block_diag

        m = self.fit.structure.free.size
        white = [metric.whitened(J).reshape(-1, J.shape[2]) for J in self._nuisance]
        starts = block_diag(*(J[:, m:] for J in white))
        return orthonormal(np.hstack([np.concatenate(white)[:, :m], starts]), LEAST_BASIS, 0.0)


def placed_effects(
    fit: Fit, runs: Sequence[Run], effects: Sequence[SystemEffect]
) -> tuple[list[Placed], dict[str, str]]:
    """Return all effects at all their places, scaled by the model's runs.

    Placed are those that the signals can show and that the model has not; the others are effects
    that cannot be shown at any place, and why.
    """
    signals = _Signals(fit, runs)
    present = {e.key for e in fit.structure.effects}
    placed: list[Placed] = []
    refused: dict[str, str] = {}
    for effect in effects:
        if fit.structure.model.simulate is not None and effect.kind in INSIDE:
            refused.setdefault(effect.name, "acts inside the simulation, which is out of reach")
        # What went through the filter has no steps.
        held = "held" in fit.structure.ways
        if effect.kind is Kind.RECORDING and held:
            refused[effect.name] = "needs inputs that are not held between rows"
            continue
        for place in effect.places(fit.structure.model):
            own, measured = signals.of(effect, place)
            scaled = measured / rms(measured)
            why = "needs a signal that changes"
            if float(np.ptp(measured)) > 0.0:
                why = effect.refused(own / rms(own), scaled)
            if why:
                refused.setdefault(effect.name, why)
                continue
            one = signals.placed(effect, place, effect.starts(scaled))
            if one is not None and one.key not in present:
                placed.append(one)
    for one in placed:
        refused.pop(one.name, None)
    return placed, refused


class _Signals:
    """Signals and equations along the runs of a model, for scales."""

    def __init__(self, fit: Fit, runs: Sequence[Run]) -> None:
        self.model, self.theta = fit.structure.model, fit.theta
        self.n_x = len(self.model.states)
        every = fit.signals([run.experiment for run in runs])
        self.signals = np.concatenate(every)
        self.outputs = np.concatenate([run.outputs for run in runs])
        self.simulated = np.concatenate([path.outputs for path in fit.paths])
        h = runs[0].sample_period_s
        self.times = np.concatenate([r.clock[0] + h * np.arange(r.n_samples) for r in runs])
        self.slopes = np.concatenate([np.gradient(s[:, : self.n_x], h, axis=0) for s in every])

    def of(self, effect: SystemEffect, place: Place) -> tuple[FloatArray, FloatArray]:
        """Return the signal that an effect acts on in the model, and as it was measured."""
        if effect.kind in AT_OUTPUTS:
            measured = self.outputs[:, place.at]
            return self.simulated[:, place.at], measured[np.isfinite(measured)]
        # Constants, drifts and the recorder act on no signal that could be at fault.
        values = np.array([1.0, -1.0])
        if effect.expression is not None:
            values = self._term(effect.expression(self.model))
        elif place.signal >= 0:
            values = self.signals[:, place.signal]
        return values, values

    def _term(self, function: Callable[..., float]) -> FloatArray:
        p = tuple(self.theta[: len(self.model.params)].tolist())
        n, every = self.n_x, max(1, len(self.signals) // SIZED_ROWS)
        rows = zip(self.times[::every], self.signals[::every], strict=True)
        given = [(t, *self.model.groups(tuple(r[:n]), tuple(r[n:]), p)) for t, r in rows]
        return np.array([function(*values) for values in given], dtype=np.float64)

    def placed(
        self, effect: SystemEffect, place: Place, starts: tuple[tuple[float, ...], ...]
    ) -> Placed | None:
        """Return an effect with its scales; None for a centred form that is the plain one."""
        one = Placed(effect, place, self._scales(effect, place), starts)
        if not effect.centred:
            return one
        indices = (place.signal, place.other)
        signals = [self.signals[:, i] if i >= 0 else np.zeros(1) for i in indices]
        centres = [float(np.mean(s)) if np.min(s) * np.max(s) > 0.0 else 0.0 for s in signals]
        if not any(centres):
            return None
        own, other = (rms(s - c) for s, c in zip(signals, centres, strict=True))
        return replace(one, scales=(one.scales[0], own, other), centres=(centres[0], centres[1]))

    def _scales(self, effect: SystemEffect, place: Place) -> tuple[float, float, float]:
        """Return the scales of what it enters, of its signal, and of a second one or a time."""
        if effect.kind == Kind.DRIFT:
            p = list(self.model.params.values())[place.at]
            # One of either sign is no smaller near zero: of one fitted as 0.00 a drift was missed.
            return max(abs(float(self.theta[place.at])), min(p.high, -p.low)), 1.0, 1.0
        own = rms(self.of(effect, place)[1])
        if effect.kind not in (Kind.TERM, Kind.HYSTERESIS):
            return 1.0, own, 1.0
        into = rms(self.slopes[:, place.at])
        if effect.name == "gravity" and place.signal >= 0:
            own = 1.0
        if effect.kind == Kind.HYSTERESIS:
            return into, own, own / rms(self.slopes[:, place.signal])
        other = rms(self.signals[:, place.other]) if place.other >= 0 else 1.0
        return into, own, other


def _memory(white: FloatArray) -> int:
    """Return the rows over which whitened errors go together, of the output where they do most."""
    correlation = correlations(white)[: len(white) // FEWEST_FLIPPED]
    # The last lag that still remembers, not the first zero: errors of a resonance swing about it.
    large = np.flatnonzero(np.any(np.abs(correlation) > REMEMBERED, axis=1))
    return int(large[-1]) + 1 if large.size else 1


def _joined(arrays: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate([a.ravel() for a in arrays])
