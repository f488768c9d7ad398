"""A run of the extended system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from comparisons.missing_effect.systems.black_box import black_box_outputs
from comparisons.missing_effect.systems.dynamics import System, extended_output, scratch_for
from comparisons.missing_effect.systems.integrate import integrated
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.types import FloatArray

# Points a sample on which a run is kept.
FINE = 4
RUNAWAY = 1e4


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
        return black_box_path(structure, run, theta, start)
    fine_s = run.sample_period_s / FINE
    times = np.arange(FINE * (run.n_samples - 1) + 1, dtype=np.float64) * fine_s
    bound = np.full(start.size, np.inf) if first else RUNAWAY * (scale + np.abs(start))
    system = run.system(structure, theta)
    states = integrated(times, start, bound, structure.tolerance, scale, system)
    if states is not None:
        outputs = structure.recorded(outputs_along(states, system), theta)
        if np.all(np.isfinite(outputs)):
            return Path(states, outputs, False)
    empty = np.zeros((times.size, start.size))
    return Path(empty, np.full(run.outputs.shape, np.nan), True)


def black_box_path(structure: Structure, run: Run, theta: FloatArray, start: FloatArray) -> Path:
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
def outputs_along(states: FloatArray, system: System) -> FloatArray:
    """Return the outputs at the samples of a run on the fine grid, shape (n, n_y)."""
    n = (states.shape[0] - 1) // FINE + 1
    out, scratch = np.empty((n, system[1][5])), scratch_for(system[1])
    for k in range(n):
        extended_output(k * system[4][1], states[FINE * k], system, out[k], scratch)
    return out
