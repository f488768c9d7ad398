"""Runs of a black box, with effects before it, behind it and in its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from comparisons.missing_effect.systems.dynamics import PLAY_SAMPLES
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind, map_value
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Points a sample at which a lag or a play follows its signal.
FINER = 4
# What a simulation that fails for some parameters may raise.
FAILURES = (ArithmeticError, np.linalg.LinAlgError, RuntimeError)


def black_box_outputs(
    structure: Structure, run: Run, theta: FloatArray, start: FloatArray
) -> FloatArray:
    """Return the outputs of a run, shape (n, n_y); not a number where the simulation failed.

    Parameters
    ----------
    structure : Structure
        The model and its effects.
    run : Run
        Inputs and clock.
    theta : ndarray
        Parameters, offsets, effects.
    start : ndarray
        Parameters of the record.
    """
    from scipy.interpolate import CubicSpline

    model = structure.model
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
    outputs = np.zeros(run.outputs.shape)
    along: FloatArray = (t + run.clock[0] - run.clock[2]) / run.clock[3]
    for node in (-1.0, 0.0, 1.0) if drifts else (0.0,):
        p = theta[: len(model.params)].copy()
        for at, rate in drifts:
            p[at] += rate * node
        share: FloatArray = np.ones(t.size)
        for other in (-1.0, 0.0, 1.0) if drifts else ():
            if other != node:
                share = share * (along - other) / (node - other)
        outputs += share[:, None] * _simulated(structure, t, inputs, p, start)
    for placed, slots in effects:
        j = placed.place.at
        if placed.effect.kind == Kind.OUTPUT_MAP:
            outputs[:, j] = _mapped(placed, outputs[:, j], slots)
        elif placed.effect.kind == Kind.OUTPUT_LAG and np.all(np.isfinite(outputs)):
            rows = np.arange(t.size, dtype=np.float64)
            finer = CubicSpline(rows, outputs[:, j])(np.arange(FINER * (t.size - 1) + 1) / FINER)
            outputs[:, j] = _lagged(finer, FINER * float(slots[0]))[::FINER]
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
    times = np.arange(FINER * (run.n_samples - 1) + 1) / FINER
    out = np.empty((len(structure.model.inputs), times.size))
    per_sample = 4 if structure.between == "band" else 1
    for j in range(out.shape[0]):
        late = float(theta[len(structure.model.params) + j]) + sum(
            float(slots[0])
            for placed, slots in effects
            if placed.effect.kind == Kind.INPUT_DELAY and placed.place.at == j
        )
        at = (times - late) * per_sample
        i = np.clip(np.floor(at).astype(np.int64), 0, pieces.shape[1] - 1)
        s = np.clip(at - i, 0.0, 1.0)
        c = pieces[j, i].T
        out[j] = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    for placed, slots in effects:
        j, kind = placed.place.at, placed.effect.kind
        if kind == Kind.INPUT_MAP:
            out[j] = _mapped(placed, out[j], slots)
        elif kind == Kind.INPUT_LAG:
            out[j] = _lagged(out[j], FINER * float(slots[0]))
        elif kind == Kind.INPUT_PLAY:
            out[j] = _followed(out[j], float(slots[0]) * placed.scales[1])
    return out[:, ::FINER]


def _mapped(placed: Placed, values: FloatArray, slots: FloatArray) -> FloatArray:
    return _all_mapped(placed.effect.code, values, placed.scales[1], float(slots[0]))


@njit(cache=True, error_model="numpy")
def _all_mapped(code: int, values: FloatArray, scale: float, a: float) -> FloatArray:
    out = np.empty(values.size)
    for k in range(values.size):
        out[k] = map_value(code, values[k], scale, a)
    return out


@njit(cache=True, error_model="numpy")
def _followed(values: FloatArray, gap: float) -> FloatArray:
    """Return what follows a drive through a play ± gap, as fast as it does in equations."""
    out, now = np.empty(values.size), values[0]
    share = 1.0 - np.exp(-1.0 / (FINER * PLAY_SAMPLES))
    for k in range(values.size):
        off = 0.5 * (values[max(k - 1, 0)] + values[k]) - now
        now += share * (max(off - gap, 0.0) + min(off + gap, 0.0))
        out[k] = now
    return out


def _lagged(values: FloatArray, tau: float) -> FloatArray:
    """Return values behind a first-order lag of τ samples, straight between samples."""
    from scipy.signal import lfilter

    kept = float(np.exp(-1.0 / max(tau, 1e-3)))
    share = max(tau, 1e-3) * (1.0 - kept)
    taps = [1.0 - share, share - kept]
    # At rest at the first value.
    return np.asarray(lfilter(taps, [1.0, -kept], values, zi=share * values[:1])[0])
