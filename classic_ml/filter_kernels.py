"""Inner loop of a filter in second-order sections, several channels at a time."""

from __future__ import annotations

import numpy as np

from classic_ml.columns.compiled_as_written import as_written
from surge_core.types import FloatArray

__all__ = ["CHANNELS", "run_sections"]

# A recursion waits for its own last value; so many of them side by side keep the processor busy.
CHANNELS = 5
# Rows that one section is done with before the next one takes them, out of the nearest cache.
CHUNK = 512


@as_written
def run_sections(
    sections: FloatArray,
    state: FloatArray,
    inputs: tuple[FloatArray, ...],
    outputs: tuple[FloatArray, ...],
    backward: bool,
) -> None:
    """Run rows of five channels through a filter, and leave its state as it is behind them.

    Parameters
    ----------
    sections : ndarray of shape (n_sections, 6)
        Coefficients as scipy has them, the fourth of each section being 1.
    state : ndarray of shape (n_sections, 2, 5)
        State before the first of the rows; of the transposed direct form, as in scipy.
    inputs, outputs : tuple of five ndarray of shape (n,)
        An output may be the array of its input.
    backward : bool
        From the last row to the first.
    """
    n = inputs[0].size
    step = -1 if backward else 1
    for done in range(0, n, CHUNK):
        first = n - 1 - done if backward else done
        count = min(CHUNK, n - done)
        for s in range(sections.shape[0]):
            sources = inputs if s == 0 else outputs
            # Of an odd order one section has a single pole and zero: half of the work.
            if sections[s, 2] == 0.0 and sections[s, 5] == 0.0:
                _run_first_order(sections[s], state[s], sources, outputs, first, count, step)
            else:
                _run_section(sections[s], state[s], sources, outputs, first, count, step)


@as_written
def _run_first_order(
    section: FloatArray,
    state: FloatArray,
    inputs: tuple[FloatArray, ...],
    outputs: tuple[FloatArray, ...],
    first: int,
    count: int,
    step: int,
) -> None:
    b0, b1, a1 = section[0], section[1], section[4]
    i0, i1, i2, i3, i4 = inputs
    o0, o1, o2, o3, o4 = outputs
    u0, u1, u2, u3, u4 = state[0, 0], state[0, 1], state[0, 2], state[0, 3], state[0, 4]
    k = np.uint64(first)
    for _ in range(count):
        x0, x1, x2, x3, x4 = i0[k], i1[k], i2[k], i3[k], i4[k]
        y0, y1, y2, y3, y4 = b0 * x0 + u0, b0 * x1 + u1, b0 * x2 + u2, b0 * x3 + u3, b0 * x4 + u4
        u0, u1, u2 = b1 * x0 - a1 * y0, b1 * x1 - a1 * y1, b1 * x2 - a1 * y2
        u3, u4 = b1 * x3 - a1 * y3, b1 * x4 - a1 * y4
        o0[k], o1[k], o2[k], o3[k], o4[k] = y0, y1, y2, y3, y4
        k += np.uint64(step)
    state[0, 0], state[0, 1], state[0, 2], state[0, 3], state[0, 4] = u0, u1, u2, u3, u4


@as_written
def _run_section(
    section: FloatArray,
    state: FloatArray,
    inputs: tuple[FloatArray, ...],
    outputs: tuple[FloatArray, ...],
    first: int,
    count: int,
    step: int,
) -> None:
    b0, b1, b2, a1, a2 = section[0], section[1], section[2], section[4], section[5]
    i0, i1, i2, i3, i4 = inputs
    o0, o1, o2, o3, o4 = outputs
    u0, u1, u2, u3, u4 = state[0, 0], state[0, 1], state[0, 2], state[0, 3], state[0, 4]
    v0, v1, v2, v3, v4 = state[1, 0], state[1, 1], state[1, 2], state[1, 3], state[1, 4]
    k = np.uint64(first)
    for _ in range(count):
        x0, x1, x2, x3, x4 = i0[k], i1[k], i2[k], i3[k], i4[k]
        y0, y1, y2, y3, y4 = b0 * x0 + u0, b0 * x1 + u1, b0 * x2 + u2, b0 * x3 + u3, b0 * x4 + u4
        u0, v0 = b1 * x0 - a1 * y0 + v0, b2 * x0 - a2 * y0
        u1, v1 = b1 * x1 - a1 * y1 + v1, b2 * x1 - a2 * y1
        u2, v2 = b1 * x2 - a1 * y2 + v2, b2 * x2 - a2 * y2
        u3, v3 = b1 * x3 - a1 * y3 + v3, b2 * x3 - a2 * y3
        u4, v4 = b1 * x4 - a1 * y4 + v4, b2 * x4 - a2 * y4
        o0[k], o1[k], o2[k], o3[k], o4[k] = y0, y1, y2, y3, y4
        k += np.uint64(step)
    state[0, 0], state[0, 1], state[0, 2], state[0, 3], state[0, 4] = u0, u1, u2, u3, u4
    state[1, 0], state[1, 1], state[1, 2], state[1, 3], state[1, 4] = v0, v1, v2, v3, v4
