"""A run of the extended system, and how it answers to changes.

How a run answers to a change of parameters, start or structure is the linearised system along it
(`linearised`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from comparisons.missing_effect.systems.black_box import black_box_outputs
from comparisons.missing_effect.systems.dynamics import System, extended_output, scratch_for
from comparisons.missing_effect.systems.integrate import integrated
from comparisons.missing_effect.systems.linearised import (
    FINE,
    along,
    forced,
    output_slopes,
    parameter_forcing,
    propagators,
    terms_along,
)
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.types import FloatArray

RUNAWAY = 1e4
# Of the coefficients of the recording filter.
FILTER_STEP = 1e-4
# Amplitude at which an effect that is linear in it is laid along the run.
SMALL = 1e-4
# Steps of differences of a black box over those of a model that is integrated here: what runs
# within it rounds as it likes.
BLACK_BOX_STEP = 100.0


@dataclass(frozen=True)
class Path:
    """A simulated run.

    Parameters
    ----------
    states : ndarray of shape (FINE·(n − 1) + 1, n_X)
        On the fine grid.
    outputs : ndarray of shape (n, n_y)
        At the samples; NaN throughout when the run failed.
    failed : bool
        Whether the state ran away or the integrator gave up.
    """

    states: FloatArray
    outputs: FloatArray
    failed: bool


def path_of(
    structure: Structure,
    run: Run,
    theta: FloatArray,
    start: FloatArray,
    scale: FloatArray,
    *,
    first: bool = False,
) -> Path:
    """Simulate a run.

    Parameters
    ----------
    structure : Structure
        Model and effects.
    run : Run
        Inputs and clock.
    theta : ndarray
        Parameters, offsets, effects.
    start : ndarray of shape (n_X,)
        State at the first sample.
    scale : ndarray of shape (n_X,)
        Size of each state, for the tolerance.
    first : bool
        Whether the sizes are not known yet, so that no state can be said to run away.
    """
    if structure.model.simulate is not None:
        return _black_box(structure, run, theta, start)
    fine_s = run.sample_period_s / FINE
    times = np.arange(FINE * (run.n_samples - 1) + 1, dtype=np.float64) * fine_s
    n_y = run.outputs.shape[1]
    bound = np.full(start.size, np.inf) if first else RUNAWAY * (scale + np.abs(start))
    system = run.system(structure, theta)
    states = integrated(times, start, bound, structure.tolerance, scale, system)
    if states is not None:
        outputs = structure.recorded(_outputs(states, system, n_y), theta)
        if np.all(np.isfinite(outputs)):
            return Path(states, outputs, False)
    empty = np.zeros((times.size, start.size))
    return Path(empty, np.full((run.n_samples, n_y), np.nan), True)


def _black_box(structure: Structure, run: Run, theta: FloatArray, start: FloatArray) -> Path:
    """Return a run of a black box: its states are the parameters of its record."""
    rows = FINE * (run.n_samples - 1) + 1
    states = np.tile(start[: len(structure.model.states)], (rows, 1))
    outputs = structure.recorded(black_box_outputs(structure, run, theta, start), theta)
    failed = not np.all(np.isfinite(outputs))
    return Path(states, np.full(outputs.shape, np.nan) if failed else outputs, failed)


def own_starts(structure: Structure, run: Run, x0: FloatArray) -> FloatArray:
    """Return the state at the start, with the states of effects in balance."""
    n_x = len(structure.model.states)
    out = [x0[:n_x]]
    if structure.model.simulate is not None:
        return out[0]
    for placed in structure.effects:
        if not placed.effect.own_state:
            continue
        at = placed.place.at
        if placed.effect.kind in (Kind.INPUT_LAG, Kind.INPUT_PLAY):
            out.append(run.pieces[at, :1, 0])
        elif placed.effect.kind == Kind.OUTPUT_LAG:
            out.append(run.outputs[run.valid[:, at], at][:1])
        else:
            out.append(np.zeros(1))
    return np.concatenate(out)


@njit(cache=True, error_model="numpy")
def _outputs(states: FloatArray, system: System, n_y: int) -> FloatArray:
    n = (states.shape[0] - 1) // FINE + 1
    out, scratch = np.empty((n, n_y)), scratch_for(system[1])
    for k in range(n):
        extended_output(k * system[4][1], states[FINE * k], system, out[k], scratch)
    return out


def answers(
    structure: Structure,
    run: Run,
    theta: FloatArray,
    path: Path,
    scale: FloatArray,
    which: NDArray[np.int64],
    steps: FloatArray,
) -> FloatArray:
    """Return how a run's outputs answer to each parameter and to each state at the start.

    Parameters
    ----------
    structure : Structure
        Model and effects.
    run : Run
        Inputs and clock.
    theta : ndarray
        Where.
    path : Path
        The run there.
    scale : ndarray of shape (n_X,)
        Size of each state.
    which : ndarray of int, shape (m,)
        Numbers of θ.
    steps : ndarray of shape (m,)
        Steps of their differences.

    Returns
    -------
    ndarray of shape (n, n_y, m + n_X)
    """
    if structure.model.simulate is not None:
        return _read(run, _differences(structure, run, theta, path, which, steps))
    system = run.system(structure, theta)
    whole, half = propagators(path.states, system, scale)
    n_X, m = structure.n_states, which.size
    forcing = np.zeros((path.states.shape[0], n_X, m + n_X))
    forcing[:, :, :m] = parameter_forcing(path.states, system, which, steps)
    n_y = run.outputs.shape[1]
    direct = np.zeros((run.n_samples, n_y, m + n_X))
    filter_at = structure.recording
    for c in (
        [] if filter_at is None else np.flatnonzero((which >= filter_at) & (which <= filter_at + 1))
    ):
        forcing[:, :, c], direct[:, :, c] = _filter_forcing(
            structure, run, theta, path, int(which[c])
        )
    start = np.hstack([np.zeros((n_X, m)), np.eye(n_X)])
    moved = forced(whole, half, forcing, start, run.sample_period_s / FINE)
    slopes = output_slopes(path.states, moved, system, (which, steps), scale, n_y)
    return _read(run, structure.recorded(slopes, theta) + direct)


def _read(run: Run, columns: FloatArray) -> FloatArray:
    """Return columns that are not a number where the run has no reading."""
    columns[~run.valid] = np.nan
    return columns


def _filter_forcing(
    structure: Structure, run: Run, theta: FloatArray, path: Path, which: int
) -> tuple[FloatArray, FloatArray]:
    """Return ∂f/∂θ through the undone input filter, and how the outputs' filter answers."""
    above, below = theta.copy(), theta.copy()
    above[which] += FILTER_STEP
    below[which] -= FILTER_STEP
    system, n_y = run.system(structure, theta), run.outputs.shape[1]
    changed, unchanged = (
        (*system[:3], run.pieces_for(structure, side), run.clock) for side in (above, below)
    )
    forcing, direct = along(path.states, 0.0, False, changed, unchanged, n_y)
    bare = _outputs(path.states, system, n_y)
    through = structure.recorded(bare, above) - structure.recorded(bare, below)
    direct = structure.recorded(direct, theta) + through
    return forcing[:, :, 0] / (2.0 * FILTER_STEP), direct / (2.0 * FILTER_STEP)


def _differences(
    structure: Structure,
    run: Run,
    theta: FloatArray,
    path: Path,
    which: NDArray[np.int64],
    steps: FloatArray,
) -> FloatArray:
    """Return how a black box answers to each parameter, and to those of its record."""
    start, out = path.states[0], []
    ranges = [p.high - p.low for p in structure.model.per_record.values()]
    moved = [*(BLACK_BOX_STEP * steps), *(SMALL * size for size in ranges)]
    for c, step in enumerate(moved):
        sides = []
        for side in (step, -step):
            at, begun = theta.copy(), start.copy()
            if c < which.size:
                at[which[c]] += side
            else:
                begun[c - which.size] += side
            sides.append(_black_box(structure, run, at, begun).outputs)
        out.append((sides[0] - sides[1]) / (2.0 * step))
    return np.stack(out, axis=2) if out else np.zeros((*run.outputs.shape, 0))


def transitions(
    structure: Structure, run: Run, theta: FloatArray, path: Path, scale: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the transition matrices along a run; None for a black box, which has none.

    Parameters
    ----------
    structure, run, theta, path, scale
        As of `answers`.
    """
    if structure.model.simulate is not None:
        return None
    return propagators(path.states, run.system(structure, theta), scale)


def effect_answers(
    structure: Structure,
    run: Run,
    theta: FloatArray,
    path: Path,
    scale: FloatArray,
    steps: tuple[FloatArray, FloatArray] | None,
    laid: Sequence[tuple[Placed, tuple[float, ...]]],
) -> FloatArray:
    """Return how the outputs of a run would answer to each of some effects, to first order.

    Parameters
    ----------
    structure, run, theta, path, scale
        As of `answers`.
    steps : tuple of ndarray, or None
        Of `transitions`.
    laid : sequence of (Placed, tuple of float)
        Effects at their places and their numbers; an amplitude is replaced by a small one.

    Returns
    -------
    ndarray of shape (n, n_y, effects)
    """
    direct = np.zeros((*run.outputs.shape, len(laid)))
    forcing = np.zeros((*path.states.shape, len(laid)))
    terms = [c for c, (placed, _) in enumerate(laid) if placed.effect.kind == Kind.TERM]
    if terms and steps is not None:
        added = tuple(laid[c][0] for c in terms)
        extended = replace(structure, effects=(*structure.effects, *added))
        slots = [structure.slots((1.0, *laid[c][1][1:])) for c in terms]
        forcing[:, :, terms] = terms_along(
            path.states,
            run.system(structure, theta),
            run.system(extended, np.concatenate([theta, *slots])),
            len(structure.effects),
        )
    for c, (placed, start) in enumerate(laid):
        if c in terms:
            continue
        extended = structure.with_effect(placed)
        size = SMALL if placed.effect.linear else 1.0
        slots_of = (SMALL, *start[1:]) if placed.effect.linear else start
        theta_new = np.concatenate([theta, extended.slots(slots_of)])
        if steps is None:
            with_it = _black_box(extended, run, theta_new, path.states[0]).outputs
            direct[:, :, c] = (with_it - path.outputs) / size
            continue
        forced_by, seen = along(
            path.states,
            float(own_starts(extended, run, path.states[0])[-1]),
            placed.effect.own_state,
            run.system(extended, theta_new),
            run.system(structure, theta),
            run.outputs.shape[1],
        )
        # The answer through the recording filter, and what a new one does to the run itself.
        seen = structure.recorded(seen, theta)
        if placed.effect.kind == Kind.RECORDING:
            seen += extended.recorded(path.outputs, theta_new) - path.outputs
        forcing[:, :, c], direct[:, :, c] = forced_by[:, :, 0] / size, seen / size
    if steps is None:
        return _read(run, direct)
    begun = np.zeros((structure.n_states, len(laid)))
    moved = forced(*steps, forcing, begun, run.sample_period_s / FINE)
    nothing = (np.zeros(0, dtype=np.int64), np.zeros(0))
    system, n_y = run.system(structure, theta), run.outputs.shape[1]
    slopes = output_slopes(path.states, moved, system, nothing, scale, n_y)
    return _read(run, structure.recorded(slopes, theta) + direct)
