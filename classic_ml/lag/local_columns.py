"""Elimination of what only a few rows see: starts, knots of the drift, ripple of one segment.

The unknowns are the global ones (log τ, C, β), few and dense, and local ones in time order. The
normal equations of the local ones are banded within a run (a hat meets its neighbours; a start,
or what the recursion of C keeps of a hat, meets those behind it until it has decayed) with a dense
border for the ripple. Band and border are eliminated run by run; what is left is small.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from classic_ml.lag.cells import Cells
from classic_ml.lag.compiled import compiled
from surge_core.types import FloatArray, IntArray

__all__ = ["Columns", "Eliminated", "eliminate"]

# Below this a start, or what is left of a hat, adds less than a rounding error.
FORGOTTEN = 1e-17
# Of a pivot against its own diagonal: less is rounding, and the unknown is not seen by any row.
NO_PIVOT = 1e-12


@dataclass(frozen=True)
class Columns:
    """Which columns the cells of a pass have.

    Parameters
    ----------
    n_global : int
        Columns of log τ, C and β.
    n_hats : int
        Hats that a row can see: 0, 2 (output error) or 3 (equation error, which looks back).
    n_states : int
        Free decays: one for output error, the order of C for equation error.
    n_starts : int
        Starts of a piece, if they are fitted.
    n_waves : int
        Columns of the ripple.
    sign : float
        Sign with which a start enters its column.
    all_hats, n_runs : int
        Hats and runs of the whole record.
    """

    n_global: int
    n_hats: int
    n_states: int
    n_starts: int
    n_waves: int
    sign: float
    all_hats: int
    n_runs: int


@dataclass(frozen=True)
class Eliminated:
    """Normal equations after the local unknowns are gone, and what brings them back.

    Parameters
    ----------
    reduced : ndarray of shape (g + 2, g + 2)
        Gram matrix of [globals, e, mean] less what the local columns explain.
    local : ndarray of shape (n_band, g + 2)
        Solutions of the local normal equations for each of these columns.
    wave : ndarray of shape (n_runs, n_waves, g + 2)
        The same for the ripple.
    hat_number, start_number : ndarray of int
        Place of each hat and start among the band's unknowns, -1 where no row sees it.
    run_ptr : ndarray of int
        First unknown of each run.
    band : ndarray of shape (n_band, bandwidth + 1)
        Cholesky factor, its diagonals as columns; a zero diagonal marks an unknown not seen.
    inverse_wave, through_wave : ndarray
        Inverse of the ripple's part per run, and what the band makes of the ripple's columns.
    maps, map_ptr, low, width : ndarray
        How the unknowns make each cell's columns.
    band_before, cross_before : ndarray
        The local normal equations before they were factorised.
    """

    reduced: FloatArray
    local: FloatArray
    wave: FloatArray
    hat_number: IntArray
    start_number: IntArray
    run_ptr: IntArray
    band: FloatArray
    inverse_wave: FloatArray
    through_wave: FloatArray
    maps: FloatArray
    map_ptr: IntArray
    low: IntArray
    width: IntArray
    band_before: FloatArray
    cross_before: FloatArray


def eliminate(
    cells: Cells,
    columns: Columns,
    grams: FloatArray,
    ends: FloatArray,
    start_weight: FloatArray,
    starts: FloatArray,
    mean: FloatArray,
) -> Eliminated:
    """Eliminate the local unknowns from the inner products of a pass.

    Parameters
    ----------
    cells : Cells
        The cells of the pass.
    columns : Columns
        What the columns are.
    grams : ndarray of shape (n_cells, p, p)
        Lower triangles of the inner products.
    ends : ndarray of shape (n_cells, n_states, n_hats + n_states)
        What the recursion keeps of each local column at the end of a cell.
    start_weight : ndarray of shape (n_pieces,)
        Weight of the errors ahead of each piece.
    starts : ndarray of shape (n_pieces * n_starts,)
        Values of those errors.
    mean : ndarray of shape (all_hats,)
        Weighted sum of each hat.
    """
    hat_number, start_number, run_ptr = _number(
        cells.rows, cells.knots, columns.all_hats, columns.n_hats, columns.n_starts, columns.n_runs
    )
    maps, map_ptr, low, width = _map(
        cells.rows,
        ends,
        hat_number,
        start_number,
        run_ptr,
        cells.knots,
        columns.n_hats,
        columns.n_starts,
        columns.n_states,
        columns.sign,
    )
    bandwidth = max(int(width.max()) - 1, 0)
    band, cross, dense = _gather(
        cells.rows,
        grams,
        maps,
        map_ptr,
        low,
        width,
        columns.n_global,
        columns.n_hats + columns.n_states,
        columns.n_waves,
        bandwidth,
        int(run_ptr[-1]),
        columns.n_runs,
    )
    if cells.ahead > 0:
        # The errors ahead of a piece are innovations themselves: so many rows more.
        weight = np.repeat(start_weight, columns.n_starts)
        run_of = np.repeat(cells.rows[cells.rows[:, 3] == 1, 5], columns.n_starts)
        band[start_number, 0] += weight
        cross[start_number, -2] -= weight * starts
        np.add.at(dense[:, -2, -2], run_of, weight * starts**2)
    seen = hat_number >= 0
    cross[hat_number[seen], -1] = mean[seen]
    before = band.copy(), cross.copy()
    reduced, wave, inverse_wave = _factorise(band, cross, dense, run_ptr, columns.n_waves)
    through = cross[:, : columns.n_waves].copy()
    local = cross[:, columns.n_waves :].copy()
    if columns.n_waves:
        run_of = np.repeat(np.arange(columns.n_runs), np.diff(run_ptr))
        local -= np.einsum("ij,ijk->ik", through, wave[run_of])
    return Eliminated(
        reduced,
        local,
        wave,
        hat_number,
        start_number,
        run_ptr,
        band,
        inverse_wave,
        through,
        maps,
        map_ptr,
        low,
        width,
        *before,
    )


@compiled
def _column(i: int, n_waves: int, n_global: int, n_local: int) -> int:
    """Return where waves, globals and e (in this order) stand in a Gram matrix."""
    if i < n_waves:
        return 1 + n_global + n_local + i
    return 1 + i - n_waves if i < n_waves + n_global else 0


@compiled
def _gather(
    rows: IntArray,
    grams: FloatArray,
    maps: FloatArray,
    map_ptr: IntArray,
    low: IntArray,
    width: IntArray,
    n_global: int,
    n_local: int,
    n_waves: int,
    bandwidth: int,
    n_band: int,
    n_runs: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Add up the normal equations of all cells."""
    n_dense = n_waves + n_global + 1
    band = np.zeros((n_band, bandwidth + 1))
    cross = np.zeros((n_band, n_dense + 1))
    dense = np.zeros((n_runs, n_dense + 1, n_dense + 1))
    part = np.zeros((n_local, bandwidth + 1))
    for cell in range(rows.shape[0]):
        gram, run = grams[cell], rows[cell, 5]
        w, at = width[cell], low[cell]
        view = maps[map_ptr[cell] : map_ptr[cell + 1]].reshape(n_local, w)
        for i in range(n_dense):
            c = _column(i, n_waves, n_global, n_local)
            for j in range(i + 1):
                d = _column(j, n_waves, n_global, n_local)
                dense[run, i, j] += gram[max(c, d), min(c, d)]
            for j in range(w):
                total = 0.0
                for m in range(n_local):
                    b = 1 + n_global + m
                    total += view[m, j] * gram[max(b, c), min(b, c)]
                cross[at + j, i] += total
        for m in range(n_local):
            for j in range(w):
                total = 0.0
                for k in range(n_local):
                    b, c = 1 + n_global + m, 1 + n_global + k
                    total += gram[max(b, c), min(b, c)] * view[k, j]
                part[m, j] = total
        for i in range(w):
            for j in range(i + 1):
                total = 0.0
                for m in range(n_local):
                    total += view[m, i] * part[m, j]
                band[at + i, i - j] += total
    return band, cross, dense


@compiled
def _forward(band: FloatArray, cross: FloatArray, first: int, stop: int) -> None:
    """Factorise one run of the band in place, L L', and turn its right sides x into L⁻¹ x."""
    b, n_dense = band.shape[1] - 1, cross.shape[1]
    for i in range(first, stop):
        whole = band[i, 0]
        for j in range(max(first, i - b), i + 1):
            total = band[i, i - j]
            for k in range(max(first, i - b), j):
                if j - k <= b:
                    total -= band[i, i - k] * band[j, j - k]
            if j < i:
                band[i, i - j] = total / band[j, 0] if band[j, 0] > 0.0 else 0.0
            elif total > NO_PIVOT * whole and total > 1e-280:
                band[i, 0] = sqrt(total)
            else:
                band[i, 0] = 0.0
        for c in range(n_dense):
            total = cross[i, c]
            for k in range(max(first, i - b), i):
                total -= band[i, i - k] * cross[k, c]
            cross[i, c] = total / band[i, 0] if band[i, 0] > 0.0 else 0.0


@compiled
def _backward(band: FloatArray, cross: FloatArray, first: int, stop: int) -> None:
    """Turn the right sides x of one run into L'⁻¹ x."""
    b, n_dense = band.shape[1] - 1, cross.shape[1]
    for i in range(stop - 1, first - 1, -1):
        for c in range(n_dense):
            total = cross[i, c]
            for k in range(i + 1, min(i + b + 1, stop)):
                total -= band[k, k - i] * cross[k, c]
            cross[i, c] = total / band[i, 0] if band[i, 0] > 0.0 else 0.0


@compiled
def _factorise(
    band: FloatArray, cross: FloatArray, dense: FloatArray, run_ptr: IntArray, n_waves: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Factorise the band in place, turn ``cross`` into its solution, and reduce what is left."""
    n_runs, n_dense = dense.shape[0], dense.shape[1]
    n_rest = n_dense - n_waves
    reduced = np.zeros((n_rest, n_rest))
    wave = np.zeros((n_runs, n_waves, n_rest))
    inverse_wave = np.zeros((n_runs, n_waves, n_waves))
    for run in range(n_runs):
        first, stop = run_ptr[run], run_ptr[run + 1]
        _forward(band, cross, first, stop)
        block = dense[run]
        for i in range(first, stop):
            for c in range(n_dense):
                for d in range(c + 1):
                    block[c, d] -= cross[i, c] * cross[i, d]
        _backward(band, cross, first, stop)
        if n_waves > 0:
            _remove_waves(block, n_waves, wave[run], inverse_wave[run])
        for c in range(n_rest):
            for d in range(c + 1):
                reduced[c, d] += block[n_waves + c, n_waves + d]
    for c in range(n_rest):
        for d in range(c):
            reduced[d, c] = reduced[c, d]
    return reduced, wave, inverse_wave


@compiled
def _remove_waves(block: FloatArray, n: int, wave: FloatArray, inverse: FloatArray) -> None:
    """Eliminate the ripple of one run from the lower triangle of its dense block."""
    scale = np.ones(n)
    for i in range(n):
        if block[i, i] > 0.0:
            scale[i] = sqrt(block[i, i])
    corner = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            corner[i, j] = corner[j, i] = block[i, j] / scale[i] / scale[j]
    values, vectors = np.linalg.eigh(corner)
    for k in range(n):
        values[k] = 1.0 / values[k] if values[k] > NO_PIVOT else 0.0
    for i in range(n):
        inverse[i] = ((vectors[i] * values) @ vectors.T) / scale[i] / scale
    n_rest = block.shape[0] - n
    for i in range(n):
        for c in range(n_rest):
            total = 0.0
            for j in range(n):
                total += inverse[i, j] * block[n + c, j]
            wave[i, c] = total
    for c in range(n_rest):
        for d in range(c + 1):
            for i in range(n):
                block[n + c, n + d] -= block[n + c, i] * wave[i, d]


@compiled
def _looks_back(knots: FloatArray, cell: int) -> bool:
    """Tell whether the row before the cell's first lies on the interval before."""
    return bool(knots[cell, 0] < 0.999999 * knots[cell, 1])


@compiled
def _number(
    rows: IntArray, knots: FloatArray, all_hats: int, n_hats: int, n_starts: int, n_runs: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Count the unknowns of the band in the order in which the rows first see them."""
    hat_number = np.full(all_hats, -1)
    n_pieces = 0
    for cell in range(rows.shape[0]):
        n_pieces += rows[cell, 3]
    start_number = np.full(n_pieces * n_starts, -1)
    run_ptr = np.zeros(n_runs + 1, np.int64)
    count = 0
    piece = -1
    done = 0
    for cell in range(rows.shape[0]):
        run = rows[cell, 5]
        while done <= run:
            run_ptr[done] = count
            done += 1
        if rows[cell, 3]:
            piece += 1
            for o in range(n_starts):
                start_number[piece * n_starts + o] = count
                count += 1
        first_hat = 1 if n_hats == 3 and not _looks_back(knots, cell) else 0
        for i in range(first_hat, n_hats):
            hat = rows[cell, 4] + i - (n_hats - 2)
            if hat_number[hat] < 0:
                hat_number[hat] = count
                count += 1
    while done <= n_runs:
        run_ptr[done] = count
        done += 1
    return hat_number, start_number, run_ptr


@compiled
def _carry(ends: FloatArray, view: FloatArray, lo: int, state: FloatArray) -> tuple[int, int]:
    """Carry the free decays over to the next cell, and say which unknowns they still hold."""
    n_states, w = state.shape[0], view.shape[1]
    keep, top = -1, -2
    fresh = np.zeros(n_states)
    for j in range(w):
        size = 0.0
        for o in range(n_states):
            fresh[o] = np.sum(ends[o] * view[:, j])
            size = max(size, abs(fresh[o]))
        for o in range(n_states):
            state[o, lo + j] = fresh[o] if size > FORGOTTEN else 0.0
        if size > FORGOTTEN:
            keep = lo + j if keep < 0 else keep
            top = lo + j
    return keep, top


@compiled
def _map(
    rows: IntArray,
    ends: FloatArray,
    hat_number: IntArray,
    start_number: IntArray,
    run_ptr: IntArray,
    knots: FloatArray,
    n_hats: int,
    n_starts: int,
    n_states: int,
    sign: float,
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Say how the unknowns of the band make the local columns of each cell.

    A cell's columns are its hats, and free decays that begin with it. What decays is the start
    of the piece and what earlier hats left in the recursion.
    """
    n_cells = rows.shape[0]
    n_local = n_hats + n_states
    low = np.zeros(n_cells, np.int64)
    width = np.zeros(n_cells, np.int64)
    ptr = np.zeros(n_cells + 1, np.int64)
    maps = np.zeros(max(64, n_cells * n_local * 4))
    state = np.zeros((n_states, max(1, np.max(run_ptr[1:] - run_ptr[:-1]))))
    piece, keep, top = -1, 0, 0
    for cell in range(n_cells):
        base = run_ptr[rows[cell, 5]]
        if rows[cell, 3]:
            piece += 1
            state[:] = 0.0
            for o in range(n_starts):
                state[o, start_number[piece * n_starts + o] - base] = sign
            keep = start_number[piece * n_starts] - base if n_starts else -1
            top = keep + n_starts - 1 if n_starts else -2
        lo, hi = keep, top
        first_hat = 1 if n_hats == 3 and not _looks_back(knots, cell) else 0
        for i in range(first_hat, n_hats):
            at = hat_number[rows[cell, 4] + i - (n_hats - 2)] - base
            lo = at if lo < 0 else min(lo, at)
            hi = max(hi, at)
        if lo < 0:
            lo, hi = 0, -1
        w = hi - lo + 1
        need = ptr[cell] + n_local * w
        if need > maps.size:
            bigger = np.zeros(2 * need)
            bigger[: ptr[cell]] = maps[: ptr[cell]]
            maps = bigger
        view = maps[ptr[cell] : need].reshape(n_local, w)
        for i in range(first_hat, n_hats):
            view[i, hat_number[rows[cell, 4] + i - (n_hats - 2)] - base - lo] += 1.0
        view[n_hats:] = state[:, lo : lo + w]
        low[cell], width[cell], ptr[cell + 1] = base + lo, w, need
        keep, top = _carry(ends[cell], view, lo, state)
    return maps, ptr, low, width
