"""A run of the extended system, or of a black box with effects around it.

LSODA, as CyRK has it in machine code, changes between Adams and BDF formulas by itself and controls
its step, so stiff and non-smooth right-hand sides survive. Where it gives up, Radau's implicit
method tries.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import carray, cfunc, types  # type: ignore[attr-defined]

from comparisons.missing_effect.systems.dynamics import System, along, extended, scratch_for
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import AT_INPUTS, AT_OUTPUTS, Placed, rms
from comparisons.missing_effect.systems.pointers import NUMBERS
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import LAGS, Run, Structure, laid
from surge_core.errors import InputError, require
from surge_core.types import FloatArray

# Points a sample on which a run is kept.
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
# What a black box that fails for some parameters may raise.
FAILURES = (ArithmeticError, np.linalg.LinAlgError, RuntimeError, ValueError)


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
    states = np.tile(start[: len(structure.model.states)], (FINE * (run.n_samples - 1) + 1, 1))
    whole = _black_box_outputs(structure, run.from_record_start(structure), theta, start)
    outputs = structure.recorded(whole, theta)[-run.n_samples :]
    failed = not np.all(np.abs(outputs) < LARGEST)
    return Path(states, np.full(outputs.shape, np.nan) if failed else outputs, failed)


def reads_at_once(structure: Structure, run: Run, theta: FloatArray, j: int) -> bool:
    """Tell whether a black box reads what input j, which is held, is at a row out in that row."""
    if structure.model.simulate is None or structure.ways[j] != "held":
        return False
    plain, moved = replace(structure, effects=()), run.pieces.copy()
    moved[j, -1, 1] += rms(run.pieces[j, :, 0])
    params = np.r_[theta[: plain.offsets.start], np.zeros(len(structure.model.inputs))]
    pairs = [replace(run, pieces=pieces) for pieces in (run.pieces, moved)]
    one, other = (black_box_path(plain, each, params, run.x0_mean).outputs[-1] for each in pairs)
    return bool(np.any(one != other))


def why_failed(structure: Structure, run: Run, theta: FloatArray, start: FloatArray) -> str:
    """Return what a run that cannot be simulated comes upon."""
    model, n = structure.model, run.n_samples
    inputs, p = run.experiment.columns(model.input_names), tuple(theta[: len(model.params)])
    try:
        if model.simulate is not None:
            _, u, params = model.groups(tuple(start), tuple(inputs.T), p)
            model.simulate(run.sample_period_s * np.arange(n, dtype=np.float64), u, params)
            return "outputs that are no finite numbers"
        slopes, _ = model.evaluate(run.clock[0], tuple(start), tuple(inputs[0]), p)
    except FAILURES as error:
        return f"{type(error).__name__}: {error}"
    bad = [name for name, slope in zip(model.states, slopes, strict=True) if not np.isfinite(slope)]
    given = zip((*model.states, *model.inputs), (*start, *inputs[0]), strict=True)
    at = ", ".join(f"{name} = {value:.3g}" for name, value in given)
    return f"no finite d{bad[0]}/dt at {at}" if bad else "a run that grows beyond all bounds"


def own_starts(structure: Structure, run: Run, x0: FloatArray) -> FloatArray:
    """Return the state at the start; effects are in balance, but for lags that x0 holds."""
    out = x0[: len(structure.model.states)]
    for placed in structure.own:
        at, begun = placed.place.at, x0[out.size : out.size + 1]
        if placed.effect.kind not in LAGS or not begun.size:
            begun = np.zeros(1)
            if placed.effect.kind in AT_INPUTS:
                begun = run.pieces[at, :1, 0]
            elif placed.effect.kind in AT_OUTPUTS:
                begun = run.outputs[run.valid[:, at], at][:1]
        out = np.append(out, begun)
    return out


def off_known(structure: Structure, run: Run, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far estimated starts are off what is known of them, and the weight of that.

    A lag begins off its balance by as much as its channel swings over the record. In balance at the
    first row, a lag of 100 ms that a record begins amid was wrong there by 25 times the noise.
    """
    known, sd = own_starts(structure, run, run.x0_mean), [*run.x0_sd]
    whole, model = run.experiment.record or run.experiment, structure.model
    for placed in (one for one in structure.own if one.effect.kind in LAGS):
        names = model.input_names if placed.effect.kind in AT_INPUTS else model.output_names
        values = whole.channels[names[placed.place.at]]
        sd.append(np.nanstd(values - np.nanmin(values)) or placed.scales[1])
    return (start - known)[structure.started], 1.0 / np.square(sd)


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
        if not (cyrk.c_get_success(result) and cyrk.c_get_size(result) == times.size):
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
    model, effects = structure.model, structure.effects
    slots = {placed: theta[structure.slots_of(placed)] for placed in effects}
    at_inputs = {p: slots[p] for p in effects if p.effect.kind in AT_INPUTS}
    given = replace(run, pieces=run.pieces_for(structure, theta))
    inputs = _behind(model.input_names, given, structure, theta[structure.offsets], at_inputs).T
    drifts = [
        (placed.place.at, float(own[0]) * placed.scales[0])
        for placed, own in slots.items()
        if placed.effect.kind == Kind.DRIFT and own[0] != 0.0
    ]
    t = run.sample_period_s * np.arange(run.n_samples, dtype=np.float64)
    # A drift is slow: at each time the outputs are those of a run with the parameters as they are
    # then, between three runs.
    outputs, nodes = np.zeros(run.outputs.shape), (-1.0, 0.0, 1.0) if drifts else (0.0,)
    along_span = (t + run.clock[0] - run.clock[2]) / run.clock[3]
    for node in nodes:
        p = theta[: len(model.params)].copy()
        for at, rate in drifts:
            p[at] += rate * node
        between = ((along_span - other) / (node - other) for other in nodes if other != node)
        share = math.prod(between, start=np.ones(t.size))
        outputs += share[:, None] * _simulated(structure, t, inputs, p, start)
    at_outputs = {p: slots[p] for p in effects if p.effect.kind in AT_OUTPUTS}
    if not at_outputs or not np.all(np.isfinite(outputs)):
        return outputs
    read = replace(run, outputs=outputs, pieces=laid(outputs, "cubic"))
    cubic = replace(structure, between="cubic")
    return _behind(model.output_names, read, cubic, np.zeros(len(model.outputs)), at_outputs)


@lru_cache(maxsize=16)
def _wire(names: tuple[str, ...]) -> Model:
    """Return a model whose outputs are its inputs: effects around it are those of equations."""
    return Model(
        {"at_rest": "1"},
        dict.fromkeys(names, "1"),
        {f"seen_{name}": "1" for name in names},
        {},
        lambda t, x, u, p: 0.0,
        lambda t, x, u, p: tuple(u),
    )


def _behind(
    names: tuple[str, ...],
    run: Run,
    like: Structure,
    late: FloatArray,
    effects: Mapping[Placed, FloatArray],
) -> FloatArray:
    """Return the inputs of a run, each late by so many samples, once effects have acted on them."""
    if not names:
        return np.zeros((run.n_samples, 0))
    structure = replace(like, model=_wire(names), effects=tuple(effects))
    theta = np.concatenate([late, *effects.values()])
    start = own_starts(structure, run, np.zeros(1))
    if start.size > 1:
        scale = np.full(start.size, rms(run.pieces[:, :, 0]))
        return path_of(structure, run, theta, start, scale).outputs
    still = np.zeros((run.n_samples, 1))
    return along(still, np.zeros(0), run.system(structure, theta), 1)[1]


def _simulated(
    structure: Structure, t: FloatArray, inputs: FloatArray, p: FloatArray, start: FloatArray
) -> FloatArray:
    model = structure.model
    assert model.simulate is not None
    _, u, params = model.groups(tuple(start), tuple(inputs), tuple(p))
    shape = (t.size, len(model.outputs))
    if not np.all(np.isfinite(inputs)):
        return np.full(shape, np.nan)
    try:
        found: Any = model.simulate(t, u, params)
    except FAILURES:
        return np.full(shape, np.nan)
    except Exception as error:
        raise InputError(
            "model: simulate",
            expected="outputs for (t, u, p)",
            found=f"{type(error).__name__}: {error}",
        ) from error
    if isinstance(found, tuple):
        found = np.column_stack(found)
    values = np.asarray(found, dtype=np.float64)
    if values.ndim == 1:
        values = values[:, None]
    expected = f"outputs of shape {shape}, as many rows as times"
    require(values.shape == shape, "model: simulate", expected, f"shape {values.shape}")
    return values
