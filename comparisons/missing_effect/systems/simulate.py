"""A run of the extended system, and how it answers to changes.

How a run answers to a change of parameters, start or structure is the linearised system along it:
matrix exponentials (Magnus, fourth order) on two steps a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from classic_ml.records import FloatArray
from comparisons.missing_effect.systems.dynamics import (
    extended_output,
    extended_rhs,
)
from comparisons.missing_effect.systems.integrate import integrated
from comparisons.missing_effect.systems.structure import Run, Structure

__all__ = [
    "FINE",
    "Path",
    "along",
    "answers",
    "filled",
    "forced",
    "output_answers",
    "path_of",
    "propagators",
]

IntArray = NDArray[np.int64]

# Points a sample on which a run is kept.
FINE = 4
RUNAWAY = 1e4
RELATIVE_STEP = 1e-6
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
    return floats if floats.size else np.zeros(3)


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
    out = np.empty((n, n_y))
    for k in range(n):
        extended_output(k * clock[1], states[FINE * k], theta, ints, floats, pieces, clock, out[k])
    return out


@njit(cache=True, error_model="numpy")
def _jacobian(
    t: float,
    X: FloatArray,
    theta: FloatArray,
    ints: IntArray,
    floats: FloatArray,
    pieces: FloatArray,
    clock: FloatArray,
    scale: FloatArray,
    out: FloatArray,
) -> None:
    """Fill out with ∂f/∂X by central differences."""
    moved = X.copy()
    for i in range(X.size):
        step = RELATIVE_STEP * (abs(X[i]) + scale[i])
        moved[i] = X[i] + step
        above = extended_rhs(t, moved, theta, ints, floats, pieces, clock)
        moved[i] = X[i] - step
        below = extended_rhs(t, moved, theta, ints, floats, pieces, clock)
        moved[i] = X[i]
        for j in range(X.size):
            out[j, i] = (above[j] - below[j]) / (2.0 * step)


@njit(cache=True, error_model="numpy")
def _expm(A: FloatArray) -> FloatArray:
    """Return the exponential of a small matrix: scaling, Padé (3, 3), squaring."""
    n = A.shape[0]
    size = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(A[i, j])
        size = max(size, row)
    if not size < 1e12:
        return np.full((n, n), np.nan)
    halvings = 0
    while size > 0.25:
        size *= 0.5
        halvings += 1
    B = np.asarray(A * 0.5**halvings)
    B2 = _product(B, B)
    B3 = _product(B2, B)
    above, below = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            even = B2[i, j] / 10.0 + (1.0 if i == j else 0.0)
            odd = B[i, j] / 2.0 + B3[i, j] / 120.0
            above[i, j], below[i, j] = even + odd, even - odd
    E = np.asarray(np.linalg.solve(below, above), dtype=np.float64)
    for _ in range(halvings):
        E = _product(E, E)
    return E


@njit(cache=True, error_model="numpy")
def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    n, m = A.shape[0], B.shape[1]
    out = np.zeros((n, m))
    for i in range(n):
        for k in range(A.shape[1]):
            a = A[i, k]
            for j in range(m):
                out[i, j] += a * B[k, j]
    return out


@njit(cache=True, error_model="numpy")
def propagators(
    states: FloatArray,
    theta: FloatArray,
    ints: IntArray,
    floats: FloatArray,
    pieces: FloatArray,
    clock: FloatArray,
    scale: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the transition matrices over whole and second half steps, two steps a sample.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    theta, ints, floats, pieces, clock : ndarray
        As of `dynamics.extended_rhs`.
    scale : ndarray of shape (n_X,)
        Size of each state, for the differences.
    """
    steps, n = (states.shape[0] - 1) // 2, states.shape[1]
    whole, half = np.empty((steps, n, n)), np.empty((steps, n, n))
    fine_s = clock[1] / FINE
    first, middle, last = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    _jacobian(0.0, states[0], theta, ints, floats, pieces, clock, scale, first)
    for k in range(steps):
        t = 2 * k * fine_s
        _jacobian(t + fine_s, states[2 * k + 1], theta, ints, floats, pieces, clock, scale, middle)
        _jacobian(
            t + 2 * fine_s, states[2 * k + 2], theta, ints, floats, pieces, clock, scale, last
        )
        step_s = 2 * fine_s
        mean = (first + 4.0 * middle + last) / 6.0
        twist = (_product(last, first) - _product(first, last)) / 12.0
        whole[k] = _expm(mean * step_s + twist * step_s**2)
        half[k] = _expm((middle + last) * (0.5 * fine_s))
        first, last = last, first
    return whole, half


@njit(cache=True, error_model="numpy")
def _parameter_forcing(
    states: FloatArray,
    theta: FloatArray,
    which: IntArray,
    steps: FloatArray,
    ints: IntArray,
    floats: FloatArray,
    pieces: FloatArray,
    clock: FloatArray,
) -> FloatArray:
    """Return ∂f/∂θ along a run, shape (fine points, n_X, number of parameters)."""
    m, n = states.shape
    out = np.empty((m, n, which.size))
    moved = theta.copy()
    for k in range(m):
        t = k * clock[1] / FINE
        for c in range(which.size):
            i = which[c]
            moved[i] = theta[i] + steps[c]
            above = extended_rhs(t, states[k], moved, ints, floats, pieces, clock)
            moved[i] = theta[i] - steps[c]
            below = extended_rhs(t, states[k], moved, ints, floats, pieces, clock)
            moved[i] = theta[i]
            for j in range(n):
                out[k, j, c] = (above[j] - below[j]) / (2.0 * steps[c])
    return out


@njit(cache=True, error_model="numpy")
def forced(
    whole: FloatArray, half: FloatArray, forcing: FloatArray, start: FloatArray, fine_s: float
) -> FloatArray:
    """Return the linearised answer of the state, at the samples.

    Parameters
    ----------
    whole, half : ndarray of shape (2(n − 1), n_X, n_X)
        Transition matrices of `propagators`.
    forcing : ndarray of shape (4(n − 1) + 1, n_X, c)
        What is added to dX/dt, one column a change.
    start : ndarray of shape (n_X, c)
        Change of the start.
    fine_s : float
        A quarter of the sample period, in seconds.

    Returns
    -------
    ndarray of shape (n, n_X, c)
    """
    steps, n = whole.shape[0], whole.shape[1]
    n_c = start.shape[1]
    out = np.empty((steps // 2 + 1, n, n_c))
    now, after = start.copy(), np.empty((n, n_c))
    out[0] = now
    third = 2.0 * fine_s / 6.0
    for k in range(steps):
        for i in range(n):
            for c in range(n_c):
                total = third * forcing[2 * k + 2, i, c]
                for j in range(n):
                    total += whole[k, i, j] * (now[j, c] + third * forcing[2 * k, j, c])
                    total += half[k, i, j] * 4.0 * third * forcing[2 * k + 1, j, c]
                after[i, c] = total
        now, after = after, now
        if k % 2 == 1:
            out[k // 2 + 1] = now
    return out


@njit(cache=True, error_model="numpy")
def along(
    states: FloatArray,
    own: float,
    has_own: bool,
    theta: FloatArray,
    theta_base: FloatArray,
    ints: IntArray,
    ints_base: IntArray,
    floats: FloatArray,
    floats_base: FloatArray,
    pieces: FloatArray,
    pieces_base: FloatArray,
    clock: FloatArray,
    n_y: int,
) -> tuple[FloatArray, FloatArray]:
    """Return what a change adds to dX/dt and to the outputs along a run that lacks it.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    own : float
        Where the state of a new effect begins, if it has one (``has_own``).
    theta, theta_base, ints, ints_base, floats, floats_base, pieces, pieces_base : ndarray
        Of the changed system and of the run's own.
    clock : ndarray of shape (4,)
        As of `dynamics.extended_rhs`.
    n_y : int
        Number of outputs.

    Returns
    -------
    forcing : ndarray of shape (4(n − 1) + 1, n_X, 1)
    direct : ndarray of shape (n, n_y)
    """
    m, n = states.shape
    forcing = np.empty((m, n, 1))
    direct = np.empty(((m - 1) // FINE + 1, n_y))
    X = np.empty(n + 1 if has_own else n)
    y, y_base = np.empty(n_y), np.empty(n_y)
    fine_s = clock[1] / FINE
    for k in range(m):
        t = k * fine_s
        X[:n] = states[k]
        if has_own:
            X[n] = own
        dX = extended_rhs(t, X, theta, ints, floats, pieces, clock)
        base = extended_rhs(t, states[k], theta_base, ints_base, floats_base, pieces_base, clock)
        for i in range(n):
            forcing[k, i, 0] = dX[i] - base[i]
        if k % FINE == 0:
            extended_output(t, X, theta, ints, floats, pieces, clock, y)
            extended_output(
                t, states[k], theta_base, ints_base, floats_base, pieces_base, clock, y_base
            )
            direct[k // FINE] = y - y_base
        if has_own:
            own += fine_s * dX[n]
            # A hysteresis stays within its bounds; other states of effects are readings.
            if ints[9 + 6 * (ints[7] - 1)] == 10:
                own = min(max(own, -1.0), 1.0)
    return forcing, direct


@njit(cache=True, error_model="numpy")
def _output_slopes(
    states: FloatArray,
    answers_: FloatArray,
    theta: FloatArray,
    which: IntArray,
    steps: FloatArray,
    ints: IntArray,
    floats: FloatArray,
    pieces: FloatArray,
    clock: FloatArray,
    scale: FloatArray,
    n_y: int,
) -> FloatArray:
    """Return how the outputs answer: through the state, and directly; (n, n_y, columns)."""
    n, n_x, n_c = answers_.shape
    out = np.zeros((n, n_y, n_c))
    above, below = np.empty(n_y), np.empty(n_y)
    moved_X, moved = np.empty(n_x), theta.copy()
    for k in range(n):
        t = k * clock[1]
        moved_X[:] = states[FINE * k]
        for i in range(n_x):
            value = moved_X[i]
            step = RELATIVE_STEP * (abs(value) + scale[i])
            moved_X[i] = value + step
            extended_output(t, moved_X, theta, ints, floats, pieces, clock, above)
            moved_X[i] = value - step
            extended_output(t, moved_X, theta, ints, floats, pieces, clock, below)
            moved_X[i] = value
            for j in range(n_y):
                slope = (above[j] - below[j]) / (2.0 * step)
                for c in range(n_c):
                    out[k, j, c] += slope * answers_[k, i, c]
        for c in range(which.size):
            i = which[c]
            moved[i] = theta[i] + steps[c]
            extended_output(t, moved_X, moved, ints, floats, pieces, clock, above)
            moved[i] = theta[i] - steps[c]
            extended_output(t, moved_X, moved, ints, floats, pieces, clock, below)
            moved[i] = theta[i]
            for j in range(n_y):
                out[k, j, c] += (above[j] - below[j]) / (2.0 * steps[c])
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
    forcing[:, :, :m] = _parameter_forcing(path.states, theta, which, steps, *given)
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
    slopes = _output_slopes(path.states, moved, theta, which, steps, *given, scale, n_y)
    return structure.recorded(slopes, theta) + direct


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
        theta,
        theta,
        ints,
        ints,
        floats,
        floats,
        run.pieces_for(structure, above),
        run.pieces_for(structure, below),
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
    slopes = _output_slopes(
        path.states,
        moved,
        theta,
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        ints,
        floats,
        run.pieces_for(structure, theta),
        run.clock,
        scale,
        run.outputs.shape[1],
    )
    return structure.recorded(slopes, theta)
