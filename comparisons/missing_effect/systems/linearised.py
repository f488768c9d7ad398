"""Kernels of the system linearised along a run: how it answers to small changes.

The transition matrices are exponentials (Magnus, fourth order) on two steps a sample; a change of
parameters, start or structure is a forcing that they carry on. No kernel makes an array within its
loops.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from comparisons.missing_effect.systems.compiled import call_at
from comparisons.missing_effect.systems.dynamics import (
    HEAD,
    ROW,
    SLOTS,
    System,
    add_effect,
    extended_output,
    extended_rhs,
    prepare,
    scratch_for,
)
from comparisons.missing_effect.systems.pointers import kernel
from surge_core.types import FloatArray, IntArray

# Points a sample on which a run is kept.
FINE = 4
RELATIVE_STEP = 1e-6


@kernel
def _jacobian(
    t: float,
    X: FloatArray,
    system: System,
    scale: FloatArray,
    room: tuple[FloatArray, FloatArray],
    out: FloatArray,
) -> None:
    """Fill out with ∂f/∂X in units of the scale, by central differences.

    Room is three rows of n_X, and scratch. In these units the exponential needs few squarings.
    """
    space, scratch = room
    moved, above, below = space[0], space[1], space[2]
    for i in range(X.size):
        moved[i] = X[i]
    for i in range(X.size):
        step = RELATIVE_STEP * (abs(X[i]) + scale[i])
        moved[i] = X[i] + step
        extended_rhs(t, moved, system, above, scratch)
        moved[i] = X[i] - step
        extended_rhs(t, moved, system, below, scratch)
        moved[i] = X[i]
        for j in range(X.size):
            out[j, i] = (above[j] - below[j]) / (2.0 * step) * (scale[i] / scale[j])


@kernel
def _multiply(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Fill out with A·B."""
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += A[i, k] * B[k, j]
            out[i, j] = total


@kernel
def _copy(A: FloatArray, out: FloatArray) -> None:
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[i, j] = A[i, j]


@kernel
def _solve(A: FloatArray, B: FloatArray) -> None:
    """Replace B by A⁻¹B and destroy A, which is so near to one that it needs no pivots."""
    n = A.shape[0]
    for k in range(n):
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= share * A[k, j]
            for j in range(n):
                B[i, j] -= share * B[k, j]
    for i in range(n - 1, -1, -1):
        for j in range(n):
            total = B[i, j]
            for k in range(i + 1, n):
                total -= A[i, k] * B[k, j]
            B[i, j] = total / A[i, i]


@kernel
def _expm(A: FloatArray, space: FloatArray, out: FloatArray) -> None:
    """Fill out with the exponential of a small matrix: scaling, Padé (3, 3), squaring.

    Space holds three matrices. A is destroyed.
    """
    n = A.shape[0]
    size = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(A[i, j])
        size = max(size, row)
    if not size < 1e12:
        out.fill(np.nan)
        return
    share, halvings = 1.0, 0
    while size * share > 0.25:
        share *= 0.5
        halvings += 1
    square, cube, below = space[0], space[1], space[2]
    for i in range(n):
        for j in range(n):
            A[i, j] *= share
    _multiply(A, A, square)
    _multiply(square, A, cube)
    for i in range(n):
        for j in range(n):
            even = square[i, j] / 10.0 + (1.0 if i == j else 0.0)
            odd = A[i, j] / 2.0 + cube[i, j] / 120.0
            out[i, j], below[i, j] = even + odd, even - odd
    _solve(below, out)
    for _ in range(halvings):
        _multiply(out, out, square)
        _copy(square, out)


@njit(cache=True, error_model="numpy")
def propagators(
    states: FloatArray, system: System, scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the transition matrices over whole and second half steps, two steps a sample.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    system : System
        As of `dynamics.extended_rhs`.
    scale : ndarray of shape (n_X,)
        Size of each state, for the differences.
    """
    steps, n = (states.shape[0] - 1) // 2, states.shape[1]
    whole, half = np.empty((steps, n, n)), np.empty((steps, n, n))
    step_s = 2.0 * system[4][1] / FINE
    scratch, rows, space = scratch_for(system[1]), np.empty((3, n)), np.empty((4, n, n))
    first, middle, last = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    ahead, back, power = np.empty((n, n)), np.empty((n, n)), space[3]
    given = (system, scale, (rows, scratch))
    _jacobian(0.0, states[0], *given, first)
    for k in range(steps):
        _jacobian((k + 0.5) * step_s, states[2 * k + 1], *given, middle)
        _jacobian((k + 1.0) * step_s, states[2 * k + 2], *given, last)
        _multiply(last, first, ahead)
        _multiply(first, last, back)
        for i in range(n):
            for j in range(n):
                mean = (first[i, j] + 4.0 * middle[i, j] + last[i, j]) / 6.0
                twist = (ahead[i, j] - back[i, j]) / 12.0
                power[i, j] = mean * step_s + twist * step_s**2
        _expm(power, space[:3], whole[k])
        for i in range(n):
            for j in range(n):
                power[i, j] = (middle[i, j] + last[i, j]) * (0.25 * step_s)
        _expm(power, space[:3], half[k])
        first, last = last, first
    units = scale.reshape((n, 1)) / scale.reshape((1, n))
    return whole * units, half * units


@njit(cache=True, error_model="numpy")
def _alone(i: int, ints: IntArray) -> bool:
    """Tell whether number i of θ acts in one place, so that nothing else need be worked out.

    A parameter of the model acts in its equations, unless an output of it drives a further lag; a
    number of a term, an overflow or a hysteresis in what that adds.
    """
    n_p, first = ints[4], ints[4] + ints[3]
    if i < n_p:
        return not np.any(ints[HEAD::ROW] == 6)
    kind = ints[HEAD + ROW * ((i - first) // SLOTS)] if i >= first else -1
    return kind in (0, 9, 10)


@kernel
def _moved_alone(
    i: int, t: float, X: FloatArray, by: float, system: System, out: FloatArray, scratch: FloatArray
) -> None:
    """Fill out with what number i of θ, moved already by so much, has a hand in."""
    ints = system[1]
    n_x, n_u, n_p = ints[2], ints[3], ints[4]
    for j in range(out.size):
        out[j] = 0.0
    if i >= n_p:
        e = (i - n_p - n_u) // SLOTS
        add_effect(e, t, X, system, out, scratch)
        return
    x, u, p = scratch[:n_x], scratch[n_x : n_x + n_u], scratch[n_x + n_u : n_x + n_u + n_p]
    value = p[i]
    p[i] = value + by
    call_at(ints[0], t, x, u, p, out)
    p[i] = value


@njit(cache=True, error_model="numpy")
def parameter_forcing(
    states: FloatArray, system: System, which: IntArray, steps: FloatArray
) -> FloatArray:
    """Return ∂f/∂θ along a run, by central differences.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    system : System
        As of `dynamics.extended_rhs`.
    which : ndarray of int, shape (m,)
        Numbers of θ.
    steps : ndarray of shape (m,)
        Steps of their differences.

    Returns
    -------
    ndarray of shape (4(n − 1) + 1, n_X, m)
    """
    theta, ints, floats, pieces, clock = system
    m, n = states.shape
    out = np.zeros((m, n, which.size))
    space, dX = np.empty((2, n)), np.empty(n)
    moved, scratch, spare = theta.copy(), scratch_for(ints), scratch_for(ints)
    alone = np.array([_alone(i, ints) for i in which])
    changed = (moved, ints, floats, pieces, clock)
    for k in range(m):
        t, X = k * clock[1] / FINE, states[k]
        prepare(t, X, system, dX, scratch)
        for c in range(which.size):
            i = which[c]
            for side in range(2):
                by = steps[c] if side == 0 else -steps[c]
                moved[i] = theta[i] + by
                if alone[c]:
                    _moved_alone(i, t, X, by, changed, space[side], scratch)
                else:
                    extended_rhs(t, X, changed, space[side], spare)
            moved[i] = theta[i]
            for j in range(n):
                out[k, j, c] = (space[0, j] - space[1, j]) / (2.0 * steps[c])
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
def terms_along(states: FloatArray, system: System, extended: System, first: int) -> FloatArray:
    """Return what terms add to dX/dt along a run that lacks them, one column a term.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    system, extended : System
        The run's own, and the same with the terms behind its own effects.
    first : int
        Number of the first term among the effects.

    Returns
    -------
    ndarray of shape (4(n − 1) + 1, n_X, terms)
    """
    m, n = states.shape
    count = extended[1][7] - first
    out, dX, scratch = np.zeros((m, n, count)), np.empty(n), scratch_for(system[1])
    for k in range(m):
        t, X = k * system[4][1] / FINE, states[k]
        prepare(t, X, system, dX, scratch)
        for c in range(count):
            for i in range(n):
                dX[i] = 0.0
            add_effect(first + c, t, X, extended, dX, scratch)
            for i in range(n):
                out[k, i, c] = dX[i]
    return out


@njit(cache=True, error_model="numpy")
def along(
    states: FloatArray, own: float, has_own: bool, changed: System, unchanged: System, n_y: int
) -> tuple[FloatArray, FloatArray]:
    """Return what a change adds to dX/dt and to the outputs along a run that lacks it.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    own : float
        Where the state of a new effect begins, if it has one (``has_own``).
    changed, unchanged : System
        The changed system and the run's own.
    n_y : int
        Number of outputs.

    Returns
    -------
    forcing : ndarray of shape (4(n − 1) + 1, n_X, 1)
    direct : ndarray of shape (n, n_y)
    """
    theta, ints = changed[0], changed[1]
    m, n = states.shape
    forcing = np.empty((m, n, 1))
    direct = np.empty(((m - 1) // FINE + 1, n_y))
    X = np.empty(n + 1 if has_own else n)
    y, y_base = np.empty(n_y), np.empty(n_y)
    dX, base = np.empty(X.size), np.empty(n)
    scratch, own_scratch = scratch_for(unchanged[1]), scratch_for(ints)
    fine_s = unchanged[4][1] / FINE
    for k in range(m):
        t = k * fine_s
        X[:n] = states[k]
        if has_own:
            X[n] = own
        extended_rhs(t, X, changed, dX, own_scratch)
        extended_rhs(t, states[k], unchanged, base, scratch)
        for i in range(n):
            forcing[k, i, 0] = dX[i] - base[i]
        if k % FINE == 0:
            extended_output(t, X, changed, y, own_scratch)
            extended_output(t, states[k], unchanged, y_base, scratch)
            direct[k // FINE] = y - y_base
        if has_own:
            own += fine_s * dX[n]
            # A hysteresis stays within its bounds; other states of effects are readings.
            if ints[HEAD + ROW * (ints[7] - 1)] == 10:
                most = 2.0 / max(1.0 + theta[theta.size - SLOTS + 2], 0.1)
                own = min(max(own, -most), most)
    return forcing, direct


@njit(cache=True, error_model="numpy")
def output_slopes(
    states: FloatArray,
    moved_states: FloatArray,
    system: System,
    differences: tuple[IntArray, FloatArray],
    scale: FloatArray,
    n_y: int,
) -> FloatArray:
    """Return how the outputs answer: through the state, and directly.

    Parameters
    ----------
    states : ndarray of shape (4(n − 1) + 1, n_X)
        The run.
    moved_states : ndarray of shape (n, n_X, columns)
        How the state answers.
    system : System
        As of `dynamics.extended_rhs`.
    differences : (ndarray of int, shape (m,), ndarray of shape (m,))
        Numbers of θ that the first columns stand for, and the steps of their differences.
    scale : ndarray of shape (n_X,)
        Size of each state, for the differences.
    n_y : int
        Number of outputs.

    Returns
    -------
    ndarray of shape (n, n_y, columns)
    """
    which, steps = differences
    theta, ints, floats, pieces, clock = system
    n, n_x, n_c = moved_states.shape
    out = np.zeros((n, n_y, n_c))
    above, below = np.empty(n_y), np.empty(n_y)
    X, moved, scratch = np.empty(n_x), theta.copy(), scratch_for(ints)
    changed = (moved, ints, floats, pieces, clock)
    for k in range(n):
        t = k * clock[1]
        X[:] = states[FINE * k]
        for i in range(n_x):
            value = X[i]
            step = RELATIVE_STEP * (abs(value) + scale[i])
            X[i] = value + step
            extended_output(t, X, system, above, scratch)
            X[i] = value - step
            extended_output(t, X, system, below, scratch)
            X[i] = value
            for j in range(n_y):
                slope = (above[j] - below[j]) / (2.0 * step)
                for c in range(n_c):
                    out[k, j, c] += slope * moved_states[k, i, c]
        for c in range(which.size):
            i = which[c]
            moved[i] = theta[i] + steps[c]
            extended_output(t, X, changed, above, scratch)
            moved[i] = theta[i] - steps[c]
            extended_output(t, X, changed, below, scratch)
            moved[i] = theta[i]
            for j in range(n_y):
                out[k, j, c] += (above[j] - below[j]) / (2.0 * steps[c])
    return out
