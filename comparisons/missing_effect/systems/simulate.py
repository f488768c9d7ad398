"""A run of the extended system, or of a black box with effects around it.

LSODA, as CyRK has it in machine code, changes between Adams and BDF formulas by itself and controls
its step, so stiff and non-smooth right-hand sides survive. Where it gives up, Radau's implicit
method tries.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import carray, cfunc, njit, types  # type: ignore[attr-defined]

from comparisons.missing_effect.kernels import lag_pass
from comparisons.missing_effect.systems.dynamics import (
    PLAY_SAMPLES,
    System,
    along,
    extended,
    scratch_for,
)
from comparisons.missing_effect.systems.places import AT_INPUTS, Placed
from comparisons.missing_effect.systems.pointers import NUMBERS
from comparisons.missing_effect.systems.shapes import Kind, map_value
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Points a sample on which a run is kept, and at which a lag or a play around a black box follows
# its signal.
FINE = 4
RUNAWAY = 1e4
# Beyond it a square is no number any more.
LARGEST = 1e150
METHODS = ("LSODA", "RADAU")
# Longest step, in points of the grid (four a sample): the integrator must not stride over a pulse
# of the input after a quiet stretch.
LONGEST_STEP = 3.0
# Steps a point, beyond which a run is given up.
MOST_STEPS = 50
MOST_MEGABYTES = 4000
# Parts of what the integrator hands on.
PARTS = 7
# Of a lag, in points of the fine grid.
LEAST_LAG = 1e-3
# What a black box that fails for some parameters may raise.
FAILURES = (ArithmeticError, np.linalg.LinAlgError, RuntimeError)


@dataclass(frozen=True)
class Path:
    """A simulated run: its states on the fine grid, and its outputs at the samples.

    A run has failed where the state ran away or the integrator gave up: its outputs are NaN.
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
    """Simulate a run from its state at the first sample.

    The scale is the size of each state, for the tolerance; at first it is not known yet, so that
    no state can be said to run away.
    """
    if structure.model.simulate is not None:
        return black_box_path(structure, run, theta, start)
    fine_s = run.sample_period_s / FINE
    times = np.arange(FINE * (run.n_samples - 1) + 1, dtype=np.float64) * fine_s
    bound = np.full(start.size, LARGEST) if first else RUNAWAY * (scale + np.abs(start))
    system = run.system(structure, theta)
    tolerances = structure.tolerance, structure.tolerance * np.asarray(scale, dtype=np.float64)
    states = None
    for method in METHODS if np.all(np.isfinite(start)) else ():
        states = _integrated(method, times, start, bound, tolerances, system)
        if states is not None:
            break
    if states is not None:
        seen = along(states[::FINE].copy(), np.zeros(0), system, 1)[1]
        outputs = structure.recorded(seen, theta)
        if np.all(np.abs(outputs) < LARGEST):
            return Path(states, outputs, False)
    empty = np.zeros((times.size, start.size))
    return Path(empty, np.full(run.outputs.shape, np.nan), True)


def black_box_path(structure: Structure, run: Run, theta: FloatArray, start: FloatArray) -> Path:
    """Return a run of a black box: its states are the parameters of its record."""
    rows = FINE * (run.n_samples - 1) + 1
    states = np.tile(start[: len(structure.model.states)], (rows, 1))
    outputs = structure.recorded(_black_box_outputs(structure, run, theta, start), theta)
    failed = not np.all(np.abs(outputs) < LARGEST)
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


@cfunc(types.void(NUMBERS, types.float64, NUMBERS, NUMBERS), cache=True)
def _slope(out: Any, t: float, state: Any, given: Any) -> None:
    """Fill dX/dt; not a number where the state has run away, so that the integrator gives up.

    Given are the ends of the parts behind them: bounds of the states, what makes up the system,
    and working space.
    """
    ends = carray(given, (PARTS,))
    whole = carray(given, (int(ends[PARTS - 1]),))
    bound, theta = whole[PARTS : int(ends[0])], whole[int(ends[0]) : int(ends[1])]
    ints = whole[int(ends[1]) : int(ends[2])].view(np.int64)
    floats, clock = whole[int(ends[2]) : int(ends[3])], whole[int(ends[3]) : int(ends[4])]
    pieces = whole[int(ends[4]) : int(ends[5])]
    laid = pieces.reshape((ints[3], pieces.size // max(4 * ints[3], 1), 4))
    X, dX = carray(state, (bound.size,)), carray(out, (bound.size,))
    for i in range(bound.size):
        if not abs(X[i]) <= bound[i]:
            dX[:] = np.nan
            return
    scratch = whole[int(ends[5]) :]
    extended(t, X, (theta, ints, floats, laid, clock), False, dX, scratch)


def _at(array: Any) -> tuple[int, int]:
    return array.ctypes.data, array.size


def _integrated(
    method: str,
    times: FloatArray,
    start: FloatArray,
    bound: FloatArray,
    tolerances: tuple[float, FloatArray],
    system: System,
) -> FloatArray | None:
    """Return the states at evenly spaced times, or None where a method gives up."""
    from CyRK.nb import numba_solver as cyrk

    theta, ints, floats, pieces, clock = system
    parts = [bound, theta, ints.view(np.float64), floats, clock, pieces.ravel(), scratch_for(ints)]
    ends = PARTS + np.cumsum([part.size for part in parts], dtype=np.float64)
    # The integrator takes a copy of it.
    given = np.concatenate([ends, *parts])
    begun = np.array(start, dtype=np.float64)
    relative, absolute = np.array(tolerances[:1]), tolerances[1]
    result = cyrk.c_numba_cysolve_ivp(
        _slope.address,
        float(times[0]),
        float(times[-1]),
        *_at(begun),
        cyrk.find_ode_method_int(method),
        times.size,
        0,
        *(given.ctypes.data, given.nbytes),
        MOST_STEPS * times.size,
        MOST_MEGABYTES,
        False,
        *_at(times),
        *(0, 0, 0),
        *_at(relative),
        *_at(absolute),
        LONGEST_STEP * float(times[1] - times[0]),
        0.0,
        True,
    )
    try:
        whole = bool(cyrk.c_get_success(result)) and cyrk.c_get_size(result) == times.size
        if not whole:
            return None
        shape = (times.size, start.size)
        states = np.ctypeslib.as_array(cyrk.c_get_y_ptr(result), shape).copy()
    finally:
        cyrk.c_free(result)
    return states if np.all(np.isfinite(states)) else None


def _black_box_outputs(
    structure: Structure, run: Run, theta: FloatArray, start: FloatArray
) -> FloatArray:
    """Return the outputs of a black box, not a number where it failed, from its record's start."""
    from scipy.interpolate import CubicSpline

    effects = [(placed, theta[structure.slots_of(placed)]) for placed in structure.effects]
    inputs = _inputs(structure, run, theta, effects)
    drifts = [
        (placed.place.at, float(slots[0]) * placed.scales[0])
        for placed, slots in effects
        if placed.effect.kind == Kind.DRIFT and slots[0] != 0.0
    ]
    t = run.sample_period_s * np.arange(run.n_samples, dtype=np.float64)
    # A drift is slow: at each time the outputs are those of a run with the parameters as they are
    # then, between three runs.
    outputs, nodes = np.zeros(run.outputs.shape), (-1.0, 0.0, 1.0) if drifts else (0.0,)
    along = (t + run.clock[0] - run.clock[2]) / run.clock[3]
    for node in nodes:
        p = theta[: len(structure.model.params)].copy()
        for at, rate in drifts:
            p[at] += rate * node
        between = ((along - other) / (node - other) for other in nodes if other != node)
        share = math.prod(between, start=np.ones(t.size))
        outputs += share[:, None] * _simulated(structure, t, inputs, p, start)
    rows = np.arange(t.size, dtype=np.float64)
    for placed, slots in effects:
        j = placed.place.at
        if placed.effect.kind == Kind.OUTPUT_MAP:
            outputs[:, j] = _behind(placed, slots, outputs[:, j])
        elif placed.effect.kind == Kind.OUTPUT_LAG and np.all(np.isfinite(outputs)):
            finer = CubicSpline(rows, outputs[:, j])(np.arange(FINE * (t.size - 1) + 1) / FINE)
            outputs[:, j] = _behind(placed, slots, finer)[::FINE]
    return outputs


def _simulated(
    structure: Structure, t: FloatArray, inputs: FloatArray, p: FloatArray, start: FloatArray
) -> FloatArray:
    model = structure.model
    assert model.simulate is not None
    _, u, params = model.groups(tuple(start), tuple(inputs), tuple(p))
    shape = (t.size, len(model.outputs))
    try:
        found: Any = model.simulate(t, u, params)
    except FAILURES:
        return np.full(shape, np.nan)
    if isinstance(found, tuple):
        found = np.column_stack(found)
    values = np.asarray(found, dtype=np.float64)
    if values.ndim == 1:
        values = values[:, None]
    if values.shape != shape:
        raise InputError(
            "model: simulate",
            expected=f"outputs of shape {shape}, as many rows as times",
            found=f"shape {values.shape}",
        )
    return values


def _inputs(
    structure: Structure,
    run: Run,
    theta: FloatArray,
    effects: list[tuple[Placed, FloatArray]],
) -> FloatArray:
    """Return the inputs at the samples as the system sees them, shape (n_u, n)."""
    pieces = run.pieces_for(structure, theta)
    times = np.arange(FINE * (run.n_samples - 1) + 1) / FINE
    out = np.empty((len(structure.model.inputs), times.size))
    per_sample = 4 if structure.between == "band" else 1
    for j in range(out.shape[0]):
        own = [
            (placed, slots)
            for placed, slots in effects
            if placed.effect.kind in AT_INPUTS and placed.place.at == j
        ]
        late = float(theta[structure.offsets][j]) + sum(
            float(slots[0]) for placed, slots in own if placed.effect.kind == Kind.INPUT_DELAY
        )
        at = (times - late) * per_sample
        i = np.clip(np.floor(at).astype(np.int64), 0, pieces.shape[1] - 1)
        s = np.clip(at - i, 0.0, 1.0)
        c = pieces[j, i].T
        out[j] = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
        for placed, slots in own:
            out[j] = _behind(placed, slots, out[j])
    return out[:, ::FINE]


def _behind(placed: Placed, slots: FloatArray, values: FloatArray) -> FloatArray:
    """Return what goes through an effect at a channel; lags and plays are on the fine grid."""
    kind, own, a = placed.effect.kind, placed.scales[1], float(slots[0])
    if kind in (Kind.INPUT_MAP, Kind.OUTPUT_MAP):
        return _mapped(placed.effect.code, values, own, a)
    if kind in (Kind.INPUT_LAG, Kind.OUTPUT_LAG):
        every = np.array([[0, values.size]])
        return lag_pass(values[:, None], max(FINE * a, LEAST_LAG), 1.0, every)[:, 0]
    return _followed(values, a * own) if kind == Kind.INPUT_PLAY else values


@njit(cache=True, error_model="numpy")
def _mapped(code: Any, values: FloatArray, own: float, a: float) -> FloatArray:
    out = np.empty(values.size)
    for k in range(values.size):
        out[k] = map_value(code, values[k], own, a)
    return out


@njit(cache=True, error_model="numpy")
def _followed(values: FloatArray, gap: float) -> FloatArray:
    """Return what follows a drive through a play ± gap, as fast as it does in equations."""
    out, now = np.empty(values.size), values[0]
    share = 1.0 - np.exp(-1.0 / (FINE * PLAY_SAMPLES))
    for k in range(values.size):
        off = 0.5 * (values[max(k - 1, 0)] + values[k]) - now
        now += share * (max(off - gap, 0.0) + min(off + gap, 0.0))
        out[k] = now
    return out
