"""Integration of the extended system by LSODA, as CyRK has it in machine code.

LSODA changes between Adams and BDF formulas by itself and controls its step, so stiff and
non-smooth right-hand sides survive. Where it gives up, Radau's implicit method tries.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import carray, cfunc, types  # type: ignore[attr-defined]
from numpy.typing import NDArray

from comparisons.missing_effect.systems.dynamics import SLOTS, System, extended_rhs, scratch_for
from comparisons.missing_effect.systems.pointers import INTEGERS, NUMBERS, integers_at, numbers_at
from surge_core.types import FloatArray

METHODS = ("LSODA", "RADAU")
# Longest step, in points of the grid (four a sample): the integrator must not stride over a pulse
# of the input after a quiet stretch.
LONGEST_STEP = 3.0
# Steps a point, beyond which a run is given up.
MOST_STEPS = 50
MOST_MEGABYTES = 4000


@cfunc(types.void(NUMBERS, types.float64, NUMBERS, INTEGERS), cache=True)
def _slope(out: Any, t: float, state: Any, given: Any) -> None:
    """Fill dX/dt; not a number where the state has run away, so that the integrator gives up."""
    n = given[0]
    ints = carray(integers_at(given[1]), (given[2],))
    packed = carray(numbers_at(given[3]), (given[4],))
    pieces = carray(numbers_at(given[5]), (given[6], given[7], 4))
    X = carray(state, (n,))
    gone = False
    for i in range(n):
        if not abs(X[i]) <= packed[4 + i]:
            gone = True
    if gone:
        for i in range(n):
            out[i] = np.nan
        return
    at = 4 + n
    n_theta = ints[4] + ints[3] + SLOTS * ints[7]
    theta, floats = packed[at : at + n_theta], packed[at + n_theta :]
    scratch = carray(numbers_at(given[8]), (given[9],))
    dX = carray(out, (n,))
    extended_rhs(t, X, (theta, ints, floats, pieces, packed[:4]), dX, scratch)


def integrated(
    times: FloatArray,
    start: FloatArray,
    bound: FloatArray,
    tolerance: float,
    scale: FloatArray,
    system: System,
) -> FloatArray | None:
    """Return the states at given times, or None where they cannot be had.

    Parameters
    ----------
    times : ndarray of shape (m,)
        Seconds since the run's first sample, evenly spaced.
    start : ndarray of shape (n_X,)
        State at the first.
    bound : ndarray of shape (n_X,)
        Size beyond which a state has run away.
    tolerance : float
        Relative; and absolute, over the size of each state.
    scale : ndarray of shape (n_X,)
        Size of each state.
    system : System
        θ, layout, inputs, clock.

    Returns
    -------
    ndarray of shape (m, n_X), or None
    """
    theta, ints, floats, pieces, clock = system
    packed = np.concatenate([clock, bound, theta, floats])
    if not np.all(np.isfinite(start)):
        return None
    for method in METHODS:
        found = _solved(method, times, start, tolerance, scale, packed, ints, pieces)
        if found is not None:
            return found
    return None


def _solved(
    method: str,
    times: FloatArray,
    start: FloatArray,
    tolerance: float,
    scale: FloatArray,
    packed: FloatArray,
    ints: NDArray[np.int64],
    pieces: FloatArray,
) -> FloatArray | None:
    from CyRK.nb import numba_solver as cyrk

    # The callback gets one block of bytes: the addresses of everything else.
    scratch = scratch_for(ints)
    given = np.array(
        [
            start.size,
            ints.ctypes.data,
            ints.size,
            packed.ctypes.data,
            packed.size,
            pieces.ctypes.data,
            pieces.shape[0],
            pieces.shape[1],
            scratch.ctypes.data,
            scratch.size,
        ],
        dtype=np.int64,
    )
    begun = np.array(start, dtype=np.float64)
    relative, absolute = np.array([tolerance]), tolerance * np.asarray(scale, dtype=np.float64)
    step_s = float(times[1] - times[0])
    result = cyrk.c_numba_cysolve_ivp(
        _slope.address,
        float(times[0]),
        float(times[-1]),
        begun.ctypes.data,
        begun.size,
        cyrk.find_ode_method_int(method),
        times.size,
        0,
        given.ctypes.data,
        given.nbytes,
        MOST_STEPS * times.size,
        MOST_MEGABYTES,
        False,
        times.ctypes.data,
        times.size,
        0,
        0,
        0,
        relative.ctypes.data,
        relative.size,
        absolute.ctypes.data,
        absolute.size,
        LONGEST_STEP * step_s,
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
