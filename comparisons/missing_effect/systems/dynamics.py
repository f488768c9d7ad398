"""The extended system: a user's model with effects in place, as one compiled right-hand side.

Everything that distinguishes one extension from another is data (integers and numbers), so that
the kernels are compiled once and cached, whatever the model and whatever is tried on it.

The vector θ holds the model's parameters, one timing offset an input (in samples), and four slots
an effect. The state X holds the model's states, then one a lag, a play or a hysteresis.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numba import njit

from comparisons.missing_effect.systems.compiled import call_at
from comparisons.missing_effect.systems.pointers import kernel
from comparisons.missing_effect.systems.shapes import map_value, term_value
from surge_core.types import FloatArray, IntArray

# What every kernel takes: θ; integers and floats of the layout, as `systems.structure` packs them;
# inputs between samples, shape (n_u, m, 4); and the clock of the first sample, the sample period,
# middle and half length of the records' span.
System: TypeAlias = tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]

# Numbers of an effect in θ: its amplitude or first parameter, and shape parameters.
SLOTS = 4
# Integers before the rows of effects: addresses of the right-hand side and the output; numbers of
# states, inputs, parameters, outputs, own states and effects; pieces a sample.
HEAD = 9
# Integers of an effect: kind, code, equation or channel, signal, second signal, own state, address
# of an expression of the user's own. Floats of an effect: scales of what it enters, of its signal,
# of a second signal or a time; centres of both signals.
ROW, FLOATS = 7, 5
# A spilling vessel gives off what exceeds its rim within this many samples; a play follows its
# drive within as few. Fast enough to be instantaneous at the sample rate, and no faster.
SPILL_SAMPLES = 0.25
PLAY_SAMPLES = 0.5
# Differences by a millionth are rounded at 1e-10 of themselves, or where larger terms cancel, 1e-8.
ALIKE = 1e-7
# States from which on it is asked: of fewer nothing is gained. With three, what all points gave
# alike to 1e-9 and was taken from the first led a run of a beam servo into another valley.
MANY_STATES = 8


@kernel
def _input_at(at: float, j: int, ints: IntArray, pieces: FloatArray) -> float:
    """Return input j at a time given in samples; held beyond the ends."""
    n = pieces.shape[1]
    place = at * ints[8]
    i = math.floor(place)
    if i < 0:
        i, s = 0, 0.0
    elif i >= n:
        i, s = n - 1, 1.0
    else:
        s = place - i
    c = pieces[j, i]
    value: float = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    return value


@kernel
def _inputs(t: float, X: FloatArray, system: System, u: FloatArray, dX: FloatArray) -> None:
    """Fill u with the inputs as the system sees them, and dX with what their own states do."""
    theta, ints, floats, pieces, clock = system
    n_u, n_p, n_eff = ints[3], ints[4], ints[7]
    h = clock[1]
    for j in range(n_u):
        late = theta[n_p + j]
        for e in range(n_eff):
            row = HEAD + ROW * e
            if ints[row] == 3 and ints[row + 2] == j:
                late += theta[n_p + n_u + SLOTS * e]
            elif ints[row] == 4 and ints[row + 2] == j:
                # Else what follows its drive so closely would be late: an offset of 0 read -0.44.
                late -= PLAY_SAMPLES
        u[j] = _input_at(t / h - late, j, ints, pieces)
    for e in range(n_eff):
        row = HEAD + ROW * e
        kind = ints[row]
        j, own = ints[row + 2], ints[row + 5]
        a = theta[n_p + n_u + SLOTS * e]
        if kind == 1:
            u[j] = map_value(ints[row + 1], u[j], floats[FLOATS * e + 1], a)
        elif kind == 2:
            dX[own] = (u[j] - X[own]) / (max(a, 1e-3) * h)
            u[j] = X[own]
        elif kind == 4:
            gap = a * floats[FLOATS * e + 1]
            off = u[j] - X[own]
            dX[own] = (max(off - gap, 0.0) + min(off + gap, 0.0)) / (PLAY_SAMPLES * h)
            u[j] = X[own]


@kernel
def _parameters(t: float, system: System, p: FloatArray) -> None:
    """Fill p with the model's parameters at a time of the clock, since some drift."""
    theta, ints, floats, _, clock = system
    n_u, n_p, n_eff = ints[3], ints[4], ints[7]
    for i in range(n_p):
        p[i] = theta[i]
    for e in range(n_eff):
        row = HEAD + ROW * e
        if ints[row] == 7:
            along = (t - clock[2]) / clock[3]
            p[ints[row + 2]] += theta[n_p + n_u + SLOTS * e] * floats[FLOATS * e] * along


@njit(cache=True, error_model="numpy")
def scratch_for(ints: IntArray) -> FloatArray:
    """Return working space for these kernels: states, inputs, parameters, and last the outputs."""
    return np.zeros(ints[2] + ints[3] + ints[4] + ints[5])


@kernel
def _views(
    ints: IntArray, scratch: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return states, inputs, parameters and outputs in the scratch."""
    u, p = ints[2], ints[2] + ints[3]
    y = p + ints[4]
    return scratch[:u], scratch[u:p], scratch[p:y], scratch[y : y + ints[5]]


@kernel
def _add_effect(
    e: int, t: float, X: FloatArray, system: System, dX: FloatArray, scratch: FloatArray
) -> None:
    """Add to dX what effect e does, if it is a term, an overflow or a hysteresis."""
    theta, ints, floats, _, clock = system
    n_x, row, at = ints[2], HEAD + ROW * e, ints[4] + ints[3] + SLOTS * e
    kind, i, k = ints[row], ints[row + 2], ints[row + 3]
    amount, a, b = theta[at], theta[at + 1], theta[at + 2]
    if kind == 0:
        # Inputs follow the states in the scratch as they do in the numbers of signals.
        scale = FLOATS * e
        m, value = ints[row + 4], 0.0
        if ints[row + 1] == 12:
            x, u, p, given = _views(ints, scratch)
            call_at(ints[row + 6], t, x, u, p, given)
            value = given[0] / floats[scale + 1]
        else:
            s = ((X[k] if k < n_x else scratch[k]) - floats[scale + 3]) / floats[scale + 1]
            other = 0.0
            if m >= 0:
                other = (X[m] if m < n_x else scratch[m]) - floats[scale + 4]
                other /= floats[scale + 2]
            value = term_value(ints[row + 1], s, other, a, b)
        dX[i] += amount * floats[scale] * value
    elif kind == 9:
        spilt = max(X[i] - amount * floats[FLOATS * e + 1], 0.0) / (SPILL_SAMPLES * clock[1])
        dX[i] -= spilt
        if ints[row + 4] >= 0:
            dX[ints[row + 4]] += a * spilt
    elif kind == 10:
        own = ints[row + 5]
        s = X[k] / floats[FLOATS * e + 1]
        z = X[own]
        # Bouc and Wen with n = 1, z in units of 2β; where γ = β (b = 1) it is Dahl's model.
        dX[own] = (s - 0.5 * abs(s) * z - 0.5 * b * s * abs(z)) / (a * floats[FLOATS * e + 2])
        dX[i] += amount * floats[FLOATS * e] * z


@kernel
def extended(
    t: float, X: FloatArray, system: System, reads: bool, dX: FloatArray, scratch: FloatArray
) -> None:
    """Fill dX with dX/dt of the extended system and, where asked, its outputs in the scratch.

    The time counts from the run's first sample; what the user wrote goes by the record's clock. The
    scratch comes from `scratch_for`: called millions of times, this must make no arrays.
    """
    theta, ints, floats, _, clock = system
    n_eff, at = ints[7], ints[4] + ints[3]
    x, u, p, y = _views(ints, scratch)
    # Loops, since numba takes ten times as long to copy a few numbers from slice to slice.
    for i in range(X.size):
        dX[i] = 0.0
    for i in range(x.size):
        x[i] = X[i]
    _inputs(t, X, system, u, dX)
    t += clock[0]
    _parameters(t, system, p)
    for e in range(n_eff):
        row = HEAD + ROW * e
        reads = reads or ints[row] == 6
        if ints[row] == 8:
            i = ints[row + 2]
            x[i] = map_value(ints[row + 1], x[i], floats[FLOATS * e + 1], theta[at + SLOTS * e])
    call_at(ints[0], t, x, u, p, dX)
    for e in range(n_eff):
        _add_effect(e, t, X, system, dX, scratch)
    if not reads:
        return
    # A sensor reads the state itself.
    for i in range(x.size):
        x[i] = X[i]
    call_at(ints[1], t, x, u, p, y)
    for e in range(n_eff):
        row = HEAD + ROW * e
        j, own, a = ints[row + 2], ints[row + 5], theta[at + SLOTS * e]
        if ints[row] == 5:
            y[j] = map_value(ints[row + 1], y[j], floats[FLOATS * e + 1], a)
        elif ints[row] == 6:
            dX[own] = (y[j] - X[own]) / (max(a, 1e-3) * clock[1])
            y[j] = X[own]


@njit(cache=True, error_model="numpy")
def along(
    states: FloatArray, begun: FloatArray, system: System, fine: int
) -> tuple[FloatArray, FloatArray]:
    """Return the slopes of a system along a run, and its outputs at the samples.

    The run has as many points a sample as ``fine`` says. Begun holds where the state of an effect
    begins that the run has not, if any: it goes on beside the run.
    """
    theta, ints, clock = system[0], system[1], system[4]
    (m, n), n_y, step_s = states.shape, ints[5], clock[1] / fine
    slopes, outputs = np.empty((m, n)), np.empty(((m - 1) // fine + 1, n_y))
    X, dX, scratch = np.empty(n + begun.size), np.empty(n + begun.size), scratch_for(ints)
    X[n:] = begun
    for k in range(m):
        X[:n] = states[k]
        extended(k * step_s, X, system, k % fine == 0, dX, scratch)
        slopes[k] = dX[:n]
        if k % fine == 0:
            outputs[k // fine] = scratch[scratch.size - n_y :]
        if begun.size:
            X[n] += step_s * dX[n]
            # A hysteresis stays within its bounds; other states of effects are readings.
            if ints[HEAD + ROW * (ints[7] - 1)] == 10:
                most = 2.0 / max(1.0 + theta[theta.size - SLOTS + 2], 0.1)
                X[n] = min(max(X[n], -most), most)
    return slopes, outputs


@njit(cache=True, error_model="numpy")
def answers(
    states: FloatArray, steps: FloatArray, shares: FloatArray, system: System, fine: int
) -> tuple[FloatArray, FloatArray]:
    """Return how slopes and outputs answer to each state, by central differences of these steps.

    Where those of many states at the first point foretell at all others what all states do
    together, each moved by a share of its step, they are returned alone.
    """
    (m, n), n_y = states.shape, system[1][5]
    made = np.empty((m, n + n_y, n))
    X, dX, by, change = np.empty(n), np.empty(n), np.empty(n), np.empty(n + n_y)
    scratch, alike = scratch_for(system[1]), False
    for k in range(m):
        seen = n + n_y if k % fine == 0 else n
        for i in range(-1 if alike else 0, n):
            for side in (1.0, -1.0):
                for j in range(n):
                    by[j] = steps[k, j] * (shares[j] if i < 0 else 1.0 if i == j else 0.0)
                    X[j] = states[k, j] + side * by[j]
                extended(k * (system[4][1] / fine), X, system, seen > n, dX, scratch)
                for j in range(seen):
                    value = dX[j] if j < n else scratch[scratch.size - n_y + j - n]
                    change[j] = value if side > 0.0 else change[j] - value
            for j in range(seen):
                if i >= 0:
                    made[k, j, i] = change[j] / (2.0 * by[i])
                    continue
                most = 0.0
                for c in range(n):
                    change[j] -= 2.0 * made[0, j, c] * by[c]
                    most += abs(2.0 * made[0, j, c] * by[c])
                alike = alike and abs(change[j]) <= ALIKE * most
            if i < 0 and alike:
                break
            if i < 0:
                made[1:k] = made[0]
        alike = alike or (k == 0 and n >= MANY_STATES)
    made = made[:1] if alike else made
    return made[:, :n], made[::fine, n:]
