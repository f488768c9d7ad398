"""What leaving out one block at a time does to the estimates, exactly and in linear time."""

from __future__ import annotations

from math import sqrt

import numpy as np

from classic_ml.lag.cells import Cells
from classic_ml.lag.compiled import compiled, inlined
from classic_ml.lag.local_columns import Columns, Eliminated
from surge_core.types import FloatArray, IntArray

__all__ = ["leave_out_moves"]

# A block that alone determines a direction (its leverage within this of one) says nothing about it.
FULL_LEVERAGE = 1e-3


def leave_out_moves(
    cells: Cells,
    columns: Columns,
    grams: FloatArray,
    eliminated: Eliminated,
    bread: FloatArray,
    start_weight: FloatArray,
    starts: FloatArray,
    constrained: bool,
    row_weight: FloatArray,
    hats: FloatArray,
    mean: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return by how much each block moves the global unknowns and the level of the drift.

    Parameters
    ----------
    cells, columns, grams, eliminated, start_weight, starts
        As in :func:`classic_ml.lag.local_columns.eliminate`.
    bread : ndarray of shape (g, g)
        Inverse of the reduced normal equations.
    constrained : bool
        The drift has zero mean (else it carries the constant).
    row_weight : ndarray of shape (n,)
        Weight of each row of the record.
    hats : ndarray of shape (all_hats,)
        Values of the drift at its knots.
    mean : ndarray of shape (all_hats,)
        Weighted sum of each hat.

    Returns
    -------
    moves : ndarray of shape (n_blocks, g)
        The whole fit less the fit without the block.
    levels : ndarray of shape (n_blocks,)
        The same for the weighted mean of the drift, that of the fit without the block taken over
        the rows outside it: within the block its drift is extrapolated.

    Notes
    -----
    With N the normal matrix, B its inverse, A_g and s_g the part and the score of block g, the
    linearised fit without it moves by -B (I - A_g B)⁻¹ s_g (Bell and McCaffrey 2002). A_g is not
    zero only where the block's own unknowns are, so that B is wanted only there.
    """
    g = columns.n_global
    local, wave, reduced = eliminated.local.copy(), eliminated.wave.copy(), eliminated.reduced
    seen = eliminated.local[:, g + 1]
    weight = -float(reduced[g + 1, g + 1])
    mean_local, mean_wave = seen.copy(), wave[:, :, g + 1].copy()
    tilt = np.zeros(g)
    if constrained and weight > 0.0:
        local[:, :g] += np.outer(seen, reduced[g + 1, :g]) / weight
        wave[:, :, :g] += mean_wave[:, :, None] * reduced[g + 1, :g] / weight
    elif weight > 0.0:
        tilt = bread @ reduced[:g, g + 1]
        mean_local = seen - local[:, :g] @ tilt
        mean_wave = mean_wave - wave[:, :, :g] @ tilt
    first = np.searchsorted(cells.block, np.arange(cells.n_blocks + 1)).astype(np.int64)
    shares = _shares_of_hats(cells.rows, cells.knots, row_weight)
    moves, means = _moves(
        cells.rows,
        first,
        grams,
        eliminated.band,
        eliminated.run_ptr,
        eliminated.maps,
        eliminated.map_ptr,
        eliminated.low,
        eliminated.width,
        eliminated.inverse_wave,
        eliminated.through_wave,
        np.ascontiguousarray(local[:, :g]),
        np.ascontiguousarray(wave[:, :, :g]),
        seen,
        np.ascontiguousarray(eliminated.wave[:, :, g + 1]),
        weight if constrained else 0.0,
        mean_local,
        mean_wave,
        tilt,
        bread,
        eliminated.band_before,
        eliminated.cross_before,
        eliminated.start_number,
        start_weight,
        starts,
        columns.n_starts,
        cells.ahead > 0,
        columns.n_hats + columns.n_states,
        columns.n_waves,
        eliminated.hat_number,
        shares,
    )
    return moves, _levels(cells, shares, means, hats, mean)


def _levels(
    cells: Cells, shares: FloatArray, means: FloatArray, hats: FloatArray, mean: FloatArray
) -> FloatArray:
    """Turn moves of the sum over the rows outside each block into moves of the level."""
    weight = float(mean.sum())
    if weight <= 0.0:
        return np.zeros(cells.n_blocks)
    left = cells.rows[:, 4]
    of_cells = shares[:, 0] * hats[left] + shares[:, 1] * hats[left + 1]
    inside = np.bincount(cells.block, of_cells, cells.n_blocks)
    others = weight - np.bincount(cells.block, shares.sum(axis=1), cells.n_blocks)
    level = float(mean @ hats) / weight
    known = others > FULL_LEVERAGE * weight
    sums = weight * level - inside - means
    return np.where(known, level - sums / np.where(known, others, 1.0), 0.0)


@compiled
def _shares_of_hats(rows: IntArray, knots: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the weighted sums, over the rows of each cell, of the hats to its left and right."""
    shares = np.zeros((rows.shape[0], 2))
    for cell in range(rows.shape[0]):
        if rows[cell, 4] < 0:
            continue
        for row in range(rows[cell, 0], rows[cell, 1]):
            place = knots[cell, 0] + knots[cell, 1] * (row - rows[cell, 0])
            shares[cell, 0] += weight[row] * (1.0 - place)
            shares[cell, 1] += weight[row] * place
    return shares


@inlined
def _band_inverse(band: FloatArray, run_ptr: IntArray) -> FloatArray:
    """Return the inverse within the band, from the Cholesky factor (Takahashi et al. 1973)."""
    n, b = band.shape[0], band.shape[1] - 1
    inverse = np.zeros((n, b + 1))
    for run in range(run_ptr.size - 1):
        first, stop = run_ptr[run], run_ptr[run + 1]
        for i in range(stop - 1, first - 1, -1):
            if band[i, 0] == 0.0:
                continue
            last = min(i + b, stop - 1)
            for j in range(last, i - 1, -1):
                total = 1.0 / band[i, 0] if j == i else 0.0
                for k in range(i + 1, last + 1):
                    high, small = max(k, j), min(k, j)
                    total -= band[k, k - i] * inverse[high, high - small]
                inverse[j, j - i] = total / band[i, 0]
    return inverse


@compiled
def _window_inverse(
    band: FloatArray, inverse: FloatArray, low: int, stop: int, run_stop: int, out: FloatArray
) -> None:
    """Fill the inverse for unknowns low … stop - 1, also outside the band."""
    b = band.shape[1] - 1
    for i in range(stop - 1, low - 1, -1):
        for j in range(i, stop):
            if j - i <= b:
                value = inverse[j, j - i]
            else:
                value = 0.0
                if band[i, 0] > 0.0:
                    for k in range(i + 1, min(i + b, run_stop - 1) + 1):
                        value -= band[k, k - i] * out[k - low, j - low]
                    value /= band[i, 0]
            out[i - low, j - low] = value
            out[j - low, i - low] = value


@compiled
def _block_products(
    rows: IntArray,
    grams: FloatArray,
    maps: FloatArray,
    map_ptr: IntArray,
    low: IntArray,
    width: IntArray,
    begin: int,
    end: int,
    lo: int,
    w: int,
    n_waves: int,
    g: int,
    n_local: int,
) -> tuple[FloatArray, FloatArray]:
    """Add up J'J and J'e of one block over [band window | ripple | globals]."""
    n = w + n_waves + g
    p = 1 + g + n_local + n_waves
    whole = np.zeros((n, n))
    score = np.zeros(n)
    for cell in range(begin, end):
        view = maps[map_ptr[cell] : map_ptr[cell + 1]].reshape(n_local, width[cell])
        at = low[cell] - lo
        gram = np.zeros((p, p))
        for i in range(p):
            for j in range(i + 1):
                gram[i, j] = gram[j, i] = grams[cell, i, j]
        spread = np.zeros((p, n))
        for m in range(n_local):
            for j in range(width[cell]):
                spread[1 + g + m, at + j] = view[m, j]
        for j in range(n_waves):
            spread[1 + g + n_local + j, w + j] = 1.0
        for j in range(g):
            spread[1 + j, w + n_waves + j] = 1.0
        half = gram @ spread
        whole += spread.T @ half
        score += half[0]
    return whole, score


@compiled
def _without_starts(
    band: FloatArray, cross: FloatArray, at: int, n_starts: int, lo: int, hi: int, n: int
) -> FloatArray:
    """Return what projects a piece's starts out of all other columns.

    The start is not fitted anew without a block: it stays out of the way, as it does in the fit.
    """
    keep = np.eye(n)
    corner = np.zeros((n_starts, n_starts))
    across = np.zeros((n_starts, n))
    for o in range(n_starts):
        i = at + o
        for j in range(lo, hi):
            high, low = max(i, j), min(i, j)
            value = band[high, high - low] if high - low < band.shape[1] else 0.0
            if at <= j < at + n_starts:
                corner[o, j - at] = value
            else:
                across[o, j - lo] = value
        across[o, hi - lo :] = cross[i, : n - (hi - lo)]
    keep[at - lo : at - lo + n_starts] = -np.linalg.pinv(corner) @ across
    return keep


@compiled
def _pseudo_solve(inverse: FloatArray, part: FloatArray, score: FloatArray) -> FloatArray:
    """Return B (I - A B)⁻¹ s, symmetrically, with B = L L'."""
    n = score.size
    scale = np.zeros(n)
    for i in range(n):
        scale[i] = sqrt(inverse[i, i]) if inverse[i, i] > 0.0 else 1.0
    scaled = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            scaled[i, j] = 0.5 * (inverse[i, j] + inverse[j, i]) / scale[i] / scale[j]
    values, vectors = np.linalg.eigh(scaled)
    root = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            if values[j] > 1e-14:
                root[i, j] = scale[i] * vectors[i, j] * sqrt(values[j])
    left = np.eye(n) - root.T @ (part @ root)
    values, vectors = np.linalg.eigh(0.5 * (left + left.T))
    projected = vectors.T @ (root.T @ score)
    for i in range(n):
        projected[i] = projected[i] / values[i] if values[i] > FULL_LEVERAGE else 0.0
    return root @ (vectors @ projected)


@compiled
def _with_waves(inner: FloatArray, through: FloatArray, inverse_wave: FloatArray) -> None:
    """Widen the inverse of the band by the ripple of its run."""
    w = through.shape[0]
    back = through @ inverse_wave
    inner[:w, :w] += back @ through.T
    inner[:w, w:] = -back
    inner[w:, :w] = -back.T
    inner[w:, w:] = inverse_wave


@compiled
def _moves(
    rows: IntArray,
    first: IntArray,
    grams: FloatArray,
    band: FloatArray,
    run_ptr: IntArray,
    maps: FloatArray,
    map_ptr: IntArray,
    low: IntArray,
    width: IntArray,
    inverse_wave: FloatArray,
    through: FloatArray,
    local: FloatArray,
    wave: FloatArray,
    seen: FloatArray,
    seen_wave: FloatArray,
    held: float,
    mean_local: FloatArray,
    mean_wave: FloatArray,
    mean_global: FloatArray,
    bread: FloatArray,
    band_before: FloatArray,
    cross_before: FloatArray,
    start_number: IntArray,
    start_weight: FloatArray,
    starts: FloatArray,
    n_starts: int,
    scored_starts: bool,
    n_local: int,
    n_waves: int,
    hat_number: IntArray,
    shares: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the moves, and those of the drift's weighted sum over the rows of the others."""
    n_blocks, g = first.size - 1, bread.shape[0]
    moves, means = np.zeros((n_blocks, g)), np.zeros(n_blocks)
    selected = _band_inverse(band, run_ptr)
    piece = -1
    for block in range(n_blocks):
        begin, end = first[block], first[block + 1]
        run = rows[begin, 5]
        lo, hi = low[begin], low[begin]
        for cell in range(begin, end):
            lo = min(lo, low[cell])
            hi = max(hi, low[cell] + width[cell])
        w = hi - lo
        part, score = _block_products(
            rows, grams, maps, map_ptr, low, width, begin, end, lo, w, n_waves, g, n_local
        )
        for cell in range(begin, end):
            if rows[cell, 3]:
                piece += 1
                for o in range(n_starts if scored_starts else 0):
                    at = start_number[piece * n_starts + o] - lo
                    part[at, at] += start_weight[piece]
                    score[at] -= start_weight[piece] * starts[piece * n_starts + o]
        if n_starts > 0:
            at = start_number[piece * n_starts]
            if lo <= at and at + n_starts <= hi:
                keep = _without_starts(band_before, cross_before, at, n_starts, lo, hi, score.size)
                part = keep.T @ part @ keep
                score = keep.T @ score
        m = w + n_waves
        inner = np.zeros((m, m))
        _window_inverse(band, selected, lo, hi, run_ptr[run + 1], inner[:w, :w])
        if n_waves > 0:
            _with_waves(inner, np.ascontiguousarray(through[lo:hi]), inverse_wave[run])
        u = np.zeros((m, g))
        u[:w] = local[lo:hi]
        u[w:] = wave[run]
        if held > 0.0:
            one = np.concatenate((seen[lo:hi], seen_wave[run]))
            inner -= np.outer(one, one) / held
        inverse = np.zeros((m + g, m + g))
        across = u @ bread
        inverse[:m, :m] = inner + across @ u.T
        inverse[:m, m:] = -across
        inverse[m:, :m] = -across.T
        inverse[m:, m:] = bread
        move = _pseudo_solve(inverse, part, score)
        moves[block] = move[m:]
        rest = score + part @ move
        means[block] = np.sum(mean_local[lo:hi] * rest[:w]) + np.sum(mean_wave[run] * rest[w:m])
        means[block] += np.sum(mean_global * rest[m:])
        for cell in range(begin, end):
            for i in range(2 if rows[cell, 4] >= 0 else 0):
                at = hat_number[rows[cell, 4] + i]
                if at >= 0:
                    means[block] -= shares[cell, i] * move[at - lo]
    return moves, means
