"""The model with its effects as data for the kernels, and the vector of all that is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from comparisons.missing_effect.systems.compiled import compiled, compiled_term
from comparisons.missing_effect.systems.dynamics import SLOTS, System
from comparisons.missing_effect.systems.experiments import (
    BAND_FACTOR,
    Experiment,
    all_pass,
    input_pieces,
)
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind
from surge_core.types import BoolArray, FloatArray, IntArray

# One way between samples for all inputs, or one an input.
Between: TypeAlias = str | tuple[str, ...]
LAGS = (Kind.INPUT_LAG, Kind.OUTPUT_LAG)
# A timing offset of an input beyond one sample is a delay, and has to be named.
MOST_OFFSET, HALF_SAMPLE = 1.0, 0.5
# Tolerance before the noise is known. On a resonance at nine samples a period the runs are then
# off by 2e-4 of their swing.
FIRST_TOLERANCE = 1e-5
# Of differences: a share of a number's size, or of its range; of a shift of a held input, which
# within a sample does not change: it shows over half a sample; of the recording filter.
RELATIVE_STEP, HELD_STEP, FILTER_STEP = 1e-5, 0.5, 1e-4


@dataclass(frozen=True)
class Structure:
    """A model as the user wrote it, the effects in it in order, its inputs between samples.

    The relative tolerance of the integrator is well below the noise of the outputs. The timing
    offsets of the inputs show in the fast part of the errors alone: they come from fits in a
    whitening metric, where they are free, and are held in raw ones. They go back to ``earliest``.
    """

    model: Model
    effects: tuple[Placed, ...] = ()
    between: Between = "cubic"
    tolerance: float = FIRST_TOLERANCE
    offsets_free: bool = True
    earliest: float = MOST_OFFSET

    def with_effect(self, effect: Placed) -> Structure:
        """Return the model with one more effect."""
        return replace(self, effects=(*self.effects, effect))

    def without(self, effect: Placed) -> Structure:
        """Return the model with one effect less."""
        return replace(self, effects=tuple(e for e in self.effects if e.key != effect.key))

    @property
    def ways(self) -> tuple[str, ...]:
        """How each input runs between samples."""
        return ways_of(self.between, len(self.model.inputs))

    @property
    def own(self) -> tuple[Placed, ...]:
        """Effects with a state of their own behind the model's; a black box keeps those."""
        return tuple(e for e in self.effects if e.effect.own_state and not self.model.simulate)

    @property
    def n_states(self) -> int:
        """States of the model and of the effects."""
        return len(self.model.states) + len(self.own)

    @property
    def started(self) -> IntArray:
        """States whose start is estimated: all of the model, and those of lags.

        Others of effects begin in balance: a play and a hysteresis are off by their width at most.
        """
        lags = [placed.effect.kind in LAGS for placed in self.own]
        return np.flatnonzero([*(True for _ in self.model.states), *lags])

    @property
    def ints(self) -> IntArray:
        """Layout for the kernels."""
        model = self.model
        head = [
            *(int(function.address) for function in compiled(model)),
            len(model.states),
            len(model.inputs),
            len(model.params),
            len(model.outputs),
            len(self.own),
            len(self.effects),
            BAND_FACTOR if "band" in self.ways else 1,
        ]
        rows, own = [], len(model.states)
        for placed in self.effects:
            effect, place = placed.effect, placed.place
            term = effect.expression
            address = int(compiled_term(model, term).address) if term else 0
            rows += [effect.kind, effect.code, place.at, place.signal, place.other, own, address]
            own += effect.own_state
        return np.array([*head, *rows], dtype=np.int64)

    @property
    def floats(self) -> FloatArray:
        """Scales and centres for the kernels, five numbers an effect."""
        return np.array([value for e in self.effects for value in e.floats], dtype=np.float64)

    @property
    def _numbers(self) -> list[tuple[float, float, bool]]:
        """Return the bounds of each number of θ, and whether it is held; an empty slot is."""
        rows = [(p.low, p.high, False) for p in self.model.params.values()]
        # Beside a delay of the same input an offset says the same once more.
        late = {e.place.at for e in self.effects if e.effect.kind == Kind.INPUT_DELAY}
        for j in range(len(self.model.inputs)):
            low, high = (0.0, 0.0) if j in late else (-self.earliest, MOST_OFFSET)
            rows.append((low, high, not self.offsets_free or j in late))
        for placed in self.effects:
            numbers = placed.effect.numbers
            rows += [(n.low, n.high, held) for n, held in zip(numbers, placed.held, strict=True)]
            rows += [(0.0, 0.0, True)] * (SLOTS - len(numbers))
        return rows

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of θ."""
        low, high = np.array([row[:2] for row in self._numbers]).reshape(-1, 2).T
        return low, high

    @property
    def free(self) -> IntArray:
        """Which numbers of θ are fitted."""
        return np.flatnonzero([not held for *_, held in self._numbers])

    def steps(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return steps of θ up and down for differences: a small share of its size, or its range.

        Numbers of effects need both: a rim that the run just touches does nothing above it. Others
        go up alone: runs along a run took a third of the time that a robot's joint took.
        """
        low, high = self.bounds
        reach = np.minimum(high - low, 1e3 * np.maximum(np.abs(low), np.abs(high)))
        up = RELATIVE_STEP * np.maximum(np.maximum(np.abs(theta), 1e-3 * reach), 1e-12)
        held = np.array([w == "held" and not self.model.simulate for w in self.ways], dtype=bool)
        up[self.offsets][held] = HELD_STEP
        for placed in self.effects:
            if placed.effect.kind == Kind.INPUT_DELAY and held[placed.place.at]:
                up[self.slots_of(placed)[0]] = HELD_STEP
            elif placed.effect.kind == Kind.RECORDING:
                up[self.slots_of(placed)[:2]] = FILTER_STEP
        alone = np.arange(up.size) < self.offsets.stop
        alone[self.offsets] &= ~held
        return up, np.where(alone, 0.0, up)

    @property
    def offsets(self) -> slice:
        """Where in θ the timing offsets of the inputs are."""
        first = len(self.model.params)
        return slice(first, first + len(self.model.inputs))

    def slots_of(self, placed: Placed) -> IntArray:
        """Return where in θ the numbers of one of its effects are."""
        index = [e.key for e in self.effects].index(placed.key)
        first = self.offsets.stop + SLOTS * index
        return np.arange(first, first + SLOTS)

    @property
    def recording(self) -> int | None:
        """Where in θ the recording filter's α and β are; None without one."""
        filters = [e for e in self.effects if e.effect.kind == Kind.RECORDING]
        return int(self.slots_of(filters[0])[0]) if filters else None

    def recorded(self, outputs: FloatArray, theta: FloatArray) -> FloatArray:
        """Return outputs, or columns of them, behind the recording filter."""
        at = self.recording
        return outputs if at is None else all_pass(outputs, theta[at], theta[at + 1])

    def start(self) -> FloatArray:
        """Return θ at the user's starts, without effects."""
        values = [parameter.start for parameter in self.model.params.values()]
        return np.array([*values, *[0.0] * len(self.model.inputs)], dtype=np.float64)

    def slots(self, start: tuple[float, ...]) -> FloatArray:
        """Return the slots of one effect, filled from a start."""
        return np.array([*start, *[0.0] * (SLOTS - len(start))], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Run:
    """One stretch of an experiment as the kernels take it.

    Measured outputs, (n, n_y), are not a number where there is no reading; pieces, (n_u, m, 4), are
    the inputs between samples; the clock holds that of the first sample, the sample period, middle
    and half length of all records' span. Of the states at the start mean and error are known.
    """

    experiment: Experiment
    outputs: FloatArray
    pieces: FloatArray
    clock: FloatArray
    x0_mean: FloatArray
    x0_sd: FloatArray

    @classmethod
    def of(
        cls,
        model: Model,
        experiment: Experiment,
        between: Between,
        span: tuple[float, float],
        x0: tuple[FloatArray, FloatArray],
    ) -> Run:
        """Return a run with its inputs laid between samples."""
        if model.simulate is not None:
            # The mean over a row of what is held, and of its delay or lag, is that of straight
            # lines. By whole rows of 2 s a delay of 12 s was 10.99 ± 0.11 s.
            ways = ways_of(between, len(model.inputs))
            between = tuple("linear" if way == "held" else way for way in ways)
        pieces = laid(experiment.columns(model.input_names), between)
        middle, half = 0.5 * (span[0] + span[1]), max(0.5 * (span[1] - span[0]), 1e-12)
        clock = np.array([experiment.first_s, experiment.sample_period_s, middle, half])
        outputs = np.ascontiguousarray(experiment.columns(model.output_names))
        return cls(experiment, outputs, pieces, clock, *x0)

    def from_record_start(self, structure: Structure) -> Run:
        """Return the run with the rows of its record before it: a black box begins there."""
        e = self.experiment
        if e.record is None or not e.skipped:
            return self
        whole = e.record.rows(0, e.skipped + e.n_samples)
        span = self.clock[2] - self.clock[3], self.clock[2] + self.clock[3]
        return Run.of(structure.model, whole, structure.between, span, (self.x0_mean, self.x0_sd))

    def pieces_for(self, structure: Structure, theta: FloatArray) -> FloatArray:
        """Return the inputs between samples as the system had them, the recording filter undone."""
        at = structure.recording
        if at is None or theta[at] == 0.0 or not self.pieces.shape[0]:
            return self.pieces
        inputs = self.experiment.columns(structure.model.input_names)
        true = all_pass(inputs, theta[at], theta[at + 1], inverse=True)
        return laid(true, structure.between)

    def system(self, structure: Structure, theta: FloatArray) -> System:
        """Return what kernels take of a structure with its θ on this run."""
        floats = structure.floats if structure.effects else np.zeros(1)
        return theta, structure.ints, floats, self.pieces_for(structure, theta), self.clock

    @property
    def valid(self) -> BoolArray:
        """Which readings there are, shape (n, n_y)."""
        return ~np.isnan(self.outputs)

    @property
    def n_samples(self) -> int:
        """Rows."""
        return int(self.outputs.shape[0])

    @property
    def sample_period_s(self) -> float:
        """In seconds."""
        return self.experiment.sample_period_s


def ways_of(between: Between, n: int) -> tuple[str, ...]:
    """Return how each of n inputs runs between samples."""
    return (between,) * n if isinstance(between, str) else between


def laid(inputs: FloatArray, between: Between) -> FloatArray:
    """Return inputs, side by side, between their samples, shape (n_u, m, 4).

    Ways that run smoothly are alike; what is held beside them has as many pieces, one more at last.
    """
    ways = ways_of(between, inputs.shape[1])
    made = [input_pieces(values, way) for values, way in zip(inputs.T, ways, strict=True)]
    if len(set(ways)) > 1 and "band" in ways:
        finer = [np.repeat(p, BAND_FACTOR, axis=0) for p in made]
        for p in finer:
            p[:, 0] += p[:, 1] * (np.arange(len(p)) % BAND_FACTOR) / BAND_FACTOR
            p[:, 1] /= BAND_FACTOR
        made = [p if w == "band" else f for p, f, w in zip(made, finer, ways, strict=True)]
    out = np.zeros((len(made), max(map(len, made), default=1), 4))
    for pieces, whole in zip(made, out, strict=True):
        whole[: len(pieces)], whole[len(pieces) :, 0] = pieces, pieces[-1].sum()
    return out
