"""Score tests: how much each effect at each place would win, from one simulation of the model.

An effect is laid along the run that the model gives; how the outputs would answer to it, to first
order, is one column. What is left of the column beside those of everything that is fitted already
is held against the errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.systems.fit import Fit, own_starts, parameter_steps
from comparisons.missing_effect.systems.linearised import FINE, along, forced, propagators
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import answers, filled, output_answers
from comparisons.missing_effect.systems.structure import Run
from surge_core.types import FloatArray

__all__ = ["Probe", "Prober"]

# Amplitude at which an effect that is linear in it is laid along the run.
SMALL = 1e-4
# A column that keeps less than this share of itself beside what is fitted already says nothing.
LEAST_OWN_SHARE = 1e-6


@dataclass(frozen=True)
class Probe:
    """What one effect at one place promises.

    Parameters
    ----------
    placed : Placed
        The effect.
    start : tuple of float
        The start that promises most.
    amplitude : float
        How much of it the errors ask for, by first order.
    gain : float
        Log-units that it would win.
    """

    placed: Placed
    start: tuple[float, ...]
    amplitude: float
    gain: float


class Prober:
    """Score tests against a fitted model.

    Parameters
    ----------
    fit : Fit
        The model, fitted to the runs.
    runs : sequence of Run
        The runs.
    """

    def __init__(self, fit: Fit, runs: Sequence[Run]) -> None:
        self.fit = fit
        self.runs = tuple(runs)
        structure = fit.structure
        which = structure.free
        steps = parameter_steps(structure, fit.theta)[which]
        n_x = len(structure.model.states)
        self._nuisance = []
        self._steps = []
        for run, path in zip(self.runs, fit.paths, strict=True):
            J = answers(structure, run, fit.theta, path, fit.scale, which, steps)
            self._nuisance.append(J[:, :, : which.size + n_x])
            pieces = run.pieces_for(structure, fit.theta)
            given = (structure.ints, filled(structure.floats), pieces, run.clock)
            self._steps.append(propagators(path.states, fit.theta, *given, fit.scale))

    def columns(self, placed: Placed, start: tuple[float, ...]) -> list[FloatArray]:
        """Return how the outputs would answer, one array of shape (n, n_y) a run.

        Parameters
        ----------
        placed : Placed
            The effect at its place.
        start : tuple of float
            Its numbers; an amplitude is replaced by a small one.
        """
        structure = self.fit.structure
        extended = structure.with_effect(placed)
        slots = extended.slots((SMALL, *start[1:]) if placed.effect.linear else start)
        theta = np.concatenate([self.fit.theta, slots])
        out = []
        for run, path, (whole, half) in zip(self.runs, self.fit.paths, self._steps, strict=True):
            first = own_starts(extended, run, path.states[0])
            forcing, direct = along(
                path.states,
                float(first[-1]),
                placed.effect.own_state,
                (theta, extended.ints, filled(extended.floats), run.pieces_for(extended, theta)),
                (
                    self.fit.theta,
                    structure.ints,
                    filled(structure.floats),
                    run.pieces_for(structure, self.fit.theta),
                ),
                run.clock,
                run.outputs.shape[1],
            )
            # The answer through the recording filter, and what a new one does to the run itself.
            direct = structure.recorded(direct, self.fit.theta)
            if placed.effect.kind == Kind.RECORDING:
                direct += extended.recorded(path.outputs, theta) - path.outputs
            if placed.effect.linear:
                forcing, direct = forcing / SMALL, direct / SMALL
            moved = forced(
                whole, half, forcing, np.zeros((structure.n_states, 1)), run.clock[1] / FINE
            )
            slopes = output_answers(structure, run, self.fit.theta, path, self.fit.scale, moved)
            out.append(slopes[:, :, 0] + direct)
        return out

    def probes(self, effects: Sequence[Placed], metric: Metric) -> list[Probe]:
        """Return what each effect promises in a metric, best first.

        Parameters
        ----------
        effects : sequence of Placed
            The effects at their places.
        metric : Metric
            Colour of the errors.
        """
        own = metric.with_size_of(self.fit.errors)
        error = _joined([own.whitened(e) for e in self.fit.errors])
        basis = self._basis(own)
        error = error - basis @ (basis.T @ error)
        found = []
        for placed in effects:
            best: Probe | None = None
            for start in placed.starts:
                column = _joined([own.whitened(c) for c in self._kept(placed, start)])
                if not np.all(np.isfinite(column)):
                    continue
                whole = float(column @ column)
                column = column - basis @ (basis.T @ column)
                size = float(column @ column)
                if not size > LEAST_OWN_SHARE * whole:
                    continue
                amount = float(column @ error) / size
                gain = 0.5 * amount**2 * size
                if not placed.effect.allows(amount):
                    gain = 0.0
                if best is None or gain > best.gain:
                    best = Probe(placed, start, amount, gain)
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda probe: -probe.gain)

    def _kept(self, placed: Placed, start: tuple[float, ...]) -> list[FloatArray]:
        """Return the columns, made once for all metrics."""
        key = (placed.key, start)
        if not hasattr(self, "_made"):
            self._made: dict[object, list[FloatArray]] = {}
        if key not in self._made:
            self._made[key] = self.columns(placed, start)
        return self._made[key]

    def _basis(self, metric: Metric) -> FloatArray:
        """Return an orthonormal basis of what is fitted already, starts of runs among it."""
        n_x = len(self.fit.structure.model.states)
        m = self._nuisance[0].shape[2] - n_x
        blocks = []
        for r, J in enumerate(self._nuisance):
            white = metric.whitened(J).reshape(-1, m + n_x)
            row = np.zeros((white.shape[0], m + n_x * len(self.runs)))
            row[:, :m] = white[:, :m]
            row[:, m + n_x * r : m + n_x * (r + 1)] = white[:, m:]
            blocks.append(row)
        joined = np.concatenate(blocks)
        size = np.linalg.norm(joined, axis=0)
        kept = joined[:, size > 0.0] / size[size > 0.0]
        left, values, _ = np.linalg.svd(kept, full_matrices=False)
        return np.asarray(left[:, values > 1e-9 * values[0]])


def _joined(arrays: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate([a.ravel() for a in arrays])
