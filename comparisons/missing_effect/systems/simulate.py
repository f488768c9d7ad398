"""A run of the extended system, and how it answers to changes.

How a run answers to a change of parameters, start or structure is the linearised system along it
(`linearised`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from comparisons.missing_effect.systems.dynamics import extended_output, scratch_for
from comparisons.missing_effect.systems.integrate import integrated
from comparisons.missing_effect.systems.linearised import (
    FINE,
    along,
    forced,
    output_slopes,
    parameter_forcing,
    propagators,
)
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.types import FloatArray, IntArray

__all__ = ["Path", "answers", "filled", "output_answers", "path_of"]


RUNAWAY = 1e4
# Of the coefficients of the recording filter.
FILTER_STEP = 1e-4


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
    ints, floats = structure.ints, filled(structure.floats)
    fine_s = run.sample_period_s / FINE
    times = np.arange(FINE * (run.n_samples - 1) + 1, dtype=np.float64) * fine_s
    n_y = run.outputs.shape[1]
    bound = np.full(start.size, np.inf) if first else RUNAWAY * (scale + np.abs(start))
    pieces = run.pieces_for(structure, theta)
    states = integrated(
        times, start, bound, structure.tolerance, scale, theta, ints, floats, pieces, run.clock
    )
    if states is not None:
        outputs = _outputs(states, theta, ints, floats, pieces, run.clock, n_y)
        outputs = structure.recorded(outputs, theta)
        if np.all(np.isfinite(outputs)):
            return Path(states, outputs, False)
    empty = np.zeros((times.size, start.size))
    return Path(empty, np.full((run.n_samples, n_y), np.nan), True)


def filled(floats: FloatArray) -> FloatArray:
    """Return scales as a contiguous array that is never empty."""
    return floats if floats.size else np.zeros(1)


@njit(cache=True, error_model="numpy")
def _outputs(
    states: FloatArray,
    theta: FloatArray,
    ints: IntArray,
    floats: FloatArray,
    pieces: FloatArray,
    clock: FloatArray,
    n_y: int,
) -> FloatArray:
    n = (states.shape[0] - 1) // FINE + 1
    out, scratch = np.empty((n, n_y)), scratch_for(ints)
    given = (theta, ints, floats, pieces, clock)
    for k in range(n):
        extended_output(k * clock[1], states[FINE * k], *given, out[k], scratch)
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
    ints, floats = structure.ints, filled(structure.floats)
    given = (ints, floats, run.pieces_for(structure, theta), run.clock)
    whole, half = propagators(path.states, theta, *given, scale)
    n_X, m = structure.n_states, which.size
    forcing = np.zeros((path.states.shape[0], n_X, m + n_X))
    forcing[:, :, :m] = parameter_forcing(path.states, theta, which, steps, *given)
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
    slopes = output_slopes(path.states, moved, theta, (which, steps), *given, scale, n_y)
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
    ints, floats = structure.ints, filled(structure.floats)
    forcing, direct = along(
        path.states,
        0.0,
        False,
        (theta, ints, floats, run.pieces_for(structure, above)),
        (theta, ints, floats, run.pieces_for(structure, below)),
        run.clock,
        run.outputs.shape[1],
    )
    own = run.pieces_for(structure, theta)
    bare = _outputs(path.states, theta, ints, floats, own, run.clock, run.outputs.shape[1])
    through = structure.recorded(bare, above) - structure.recorded(bare, below)
    direct = structure.recorded(direct, theta) + through
    return forcing[:, :, 0] / (2.0 * FILTER_STEP), direct / (2.0 * FILTER_STEP)


def output_answers(
    structure: Structure,
    run: Run,
    theta: FloatArray,
    path: Path,
    scale: FloatArray,
    moved: FloatArray,
) -> FloatArray:
    """Return how the outputs answer to changes of the state, shape (n, n_y, columns).

    Parameters
    ----------
    structure, run, theta, path, scale
        As of `answers`.
    moved : ndarray of shape (n, n_X, columns)
        Changes of the state at the samples.
    """
    ints, floats = structure.ints, filled(structure.floats)
    slopes = output_slopes(
        path.states,
        moved,
        theta,
        (np.zeros(0, dtype=np.int64), np.zeros(0)),
        ints,
        floats,
        run.pieces_for(structure, theta),
        run.clock,
        scale,
        run.outputs.shape[1],
    )
    return _read(run, structure.recorded(slopes, theta))
