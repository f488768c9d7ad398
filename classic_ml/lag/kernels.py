"""One pass over a record: errors, their derivatives and all inner products, in constant memory.

A record is cut into cells (stretches of rows in which the same few local columns live: two hats of
the drift, one start, the ripple of one segment). A pass computes for each cell the Gram matrix of

    e | log τ, dead time, ρ | β | hats | starts | ripple

where every column c is -∂e/∂θ, so that a step δ makes the errors e - Σ c δ. Rows go through a
small buffer; nothing of the length of the record is made but the errors themselves.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np

from classic_ml.lag.compiled import compiled
from surge_core.types import FloatArray, IntArray

__all__ = ["equation_error_pass", "output_error_pass", "sum_hats"]


# Rows of one chunk: eight columns of it stay in the first-level cache.
CHUNK = 512


@compiled
def _recurse_once(
    buf: FloatArray, first: int, last: int, n: int, c1: float, s1: FloatArray
) -> None:
    """Run x[k] = d[k] - c1 x[k-1] in place on rows first … last - 1 of the buffer."""
    row = first
    # Several recursions at a time: one alone waits on its own last value.
    while row + 3 <= last:
        b0, b1, b2 = buf[row], buf[row + 1], buf[row + 2]
        p, q, r = s1[row], s1[row + 1], s1[row + 2]
        for k in range(n):
            p = b0[k] - c1 * p
            q = b1[k] - c1 * q
            r = b2[k] - c1 * r
            b0[k] = p
            b1[k] = q
            b2[k] = r
        s1[row], s1[row + 1], s1[row + 2] = p, q, r
        row += 3
    if row + 2 == last:
        b0, b1 = buf[row], buf[row + 1]
        p, q = s1[row], s1[row + 1]
        for k in range(n):
            p = b0[k] - c1 * p
            q = b1[k] - c1 * q
            b0[k] = p
            b1[k] = q
        s1[row], s1[row + 1] = p, q
    elif row + 1 == last:
        b0, p = buf[row], s1[row]
        for k in range(n):
            p = b0[k] - c1 * p
            b0[k] = p
        s1[row] = p


@compiled
def _recurse(
    buf: FloatArray,
    first: int,
    last: int,
    n: int,
    c1: float,
    c2: float,
    s1: FloatArray,
    s2: FloatArray,
) -> None:
    """Run x[k] = d[k] - c1 x[k-1] - c2 x[k-2] in place on rows first … last - 1 of the buffer."""
    if c2 == 0.0:
        for row in range(first, last):
            s2[row] = buf[row, n - 2] if n > 1 else s1[row]
        _recurse_once(buf, first, last, n, c1, s1)
        for row in range(first, last):
            s2[row] = buf[row, n - 2] if n > 1 else s2[row]
        return
    for row in range(first, last):
        values = buf[row]
        p, pp = s1[row], s2[row]
        for k in range(n):
            u = (values[k] - c2 * pp) - c1 * p
            pp = p
            p = u
            values[k] = u
        s1[row], s2[row] = p, pp


@compiled
def _add_products(buf: FloatArray, p: int, n: int, gram: FloatArray) -> None:
    """Add the inner products of the first p rows of the buffer to the lower triangle."""
    for i in range(p):
        one = buf[i]
        j = 0
        while j + 3 <= i + 1:
            b0, b1, b2 = buf[j], buf[j + 1], buf[j + 2]
            t0 = t1 = t2 = 0.0
            for k in range(n):
                value = one[k]
                t0 += value * b0[k]
                t1 += value * b1[k]
                t2 += value * b2[k]
            gram[i, j] += t0
            gram[i, j + 1] += t1
            gram[i, j + 2] += t2
            j += 3
        while j <= i:
            b0 = buf[j]
            t0 = 0.0
            for k in range(n):
                t0 += one[k] * b0[k]
            gram[i, j] += t0
            j += 1


@compiled
def _window(terms: FloatArray, i: int, low: int, n: int, origin: int, out: FloatArray) -> None:
    """Copy n samples of a term from row ``low`` on; before the origin it stood at its first."""
    k = 0
    while k < n and low + k < origin:
        out[k] = terms[i, origin]
        k += 1
    out[k:n] = terms[i, low + k : low + n]


@compiled
def _tap(source: FloatArray, taps: FloatArray, scale: float, n: int, out: FloatArray) -> None:
    """Add the weighted sum of a sample and the two before it."""
    t0, t1, t2 = scale * taps[0], scale * taps[1], scale * taps[2]
    now, before, old = source[2:], source[1:], source
    if t0 == 0.0 and t2 == 0.0:
        for k in range(n):
            out[k] += t1 * before[k]
    elif t2 == 0.0:
        for k in range(n):
            out[k] += t0 * now[k] + t1 * before[k]
    else:
        for k in range(n):
            out[k] += t0 * now[k] + t1 * before[k] + t2 * old[k]


@compiled
def _add(values: FloatArray, scale: float, n: int, out: FloatArray) -> None:
    for k in range(n):
        out[k] += scale * values[k]


@compiled
def _line(level: float, slope: float, n: int, out: FloatArray) -> None:
    for k in range(n):
        out[k] = level + slope * k


@compiled
def _turning(omega: FloatArray, at: int, n: int, waves: FloatArray) -> None:
    """Fill sine and cosine rows for samples at … at + n - 1 of a segment."""
    for f in range(omega.size):
        c, s = cos(omega[f]), sin(omega[f])
        # Started anew in every chunk, the rotation keeps its fifteen digits.
        x, y = cos(omega[f] * at), sin(omega[f] * at)
        for k in range(n):
            waves[2 * f, k] = y
            waves[2 * f + 1, k] = x
            x, y = c * x - s * y, s * x + c * y


@compiled
def _term_columns(
    terms: FloatArray,
    beta: FloatArray,
    taps: FloatArray,
    low: int,
    n: int,
    origin: int,
    n_dead: int,
    at_beta: int,
    source: FloatArray,
    buf: FloatArray,
) -> None:
    """Fill the drives of the terms, and add what they give to the rows of log τ and dead time."""
    buf[1 : 1 + n_dead + 1, :n] = 0.0
    buf[at_beta : at_beta + terms.shape[0], :n] = 0.0
    for i in range(terms.shape[0]):
        _window(terms, i, low, n + 2, origin, source)
        _tap(source, taps[0], 1.0, n, buf[at_beta + i])
        _tap(source, taps[1], beta[i], n, buf[1])
        if n_dead:
            _tap(source, taps[2], beta[i], n, buf[2])


@compiled
def _store(
    buf: FloatArray, p: int, n: int, root: FloatArray, k0: int, slot: int, errors: FloatArray
) -> int:
    """Weigh the columns, keep the scored errors, and return where the next ones go."""
    if root.size == 0:
        errors[slot : slot + n] = buf[0, :n]
        return slot + n
    weights = root[k0 : k0 + n]
    for i in range(p):
        values = buf[i]
        for k in range(n):
            values[k] *= weights[k]
    for k in range(n):
        if weights[k] > 0.0:
            errors[slot] = buf[0, k]
            slot += 1
    return slot


@compiled
def _decay(first: float, a: float, n: int, out: FloatArray) -> float:
    """Fill first · a^k, and return the value that comes next."""
    value = first
    for k in range(n):
        out[k] = value
        value *= a
    # Products of denormal numbers cost a hundred times as much as others.
    return value if value > 1e-200 else 0.0


@compiled
def output_error_pass(
    y: FloatArray,
    terms: FloatArray,
    root: FloatArray,
    rows: IntArray,
    knots: FloatArray,
    shift: int,
    taps: FloatArray,
    a: float,
    d_a: float,
    n_dead: int,
    beta: FloatArray,
    starts: FloatArray,
    hats: FloatArray,
    omega: FloatArray,
    ripple: FloatArray,
    slots: IntArray,
    errors: FloatArray,
    grams: FloatArray,
    ends: FloatArray,
) -> None:
    """Errors of the free run and all inner products, cell by cell."""
    q, n_waves = terms.shape[0], 2 * omega.size
    n_hats = 2 if hats.size > 0 else 0
    at_beta = 2 + n_dead
    at_hats = at_beta + q
    at_start = at_hats + n_hats
    at_waves = at_start + 1
    p = at_waves + n_waves
    buf = np.zeros((p, CHUNK))
    source = np.zeros(CHUNK + 2)
    state = np.zeros(CHUNK + 1)
    s1 = np.zeros(p)
    piece, coefficient = -1, 0.0
    for cell in range(rows.shape[0]):
        start, stop, origin, first, left, run = rows[cell]
        if first:
            piece += 1
            coefficient = starts[piece]
            s1[:] = 0.0
            s1[at_beta:at_hats] = terms[:, origin]
            state[0] = np.sum(beta * terms[:, origin])
        decay = 1.0
        slot = slots[cell]
        k0 = start
        while k0 < stop:
            n = min(CHUNK, stop - k0)
            low = k0 - shift - 2
            _term_columns(terms, beta, taps, low, n, origin, n_dead, at_beta, source, buf)
            _recurse_once(buf, at_beta, at_hats, n, -a, s1)
            decay = _decay(decay, a, n, buf[at_start])
            state[1 : n + 1] = coefficient * buf[at_start, :n]
            for i in range(q):
                _add(buf[at_beta + i], beta[i], n, state[1:])
            _add(state, d_a, n, buf[1])
            buf[0, :n] = y[k0 : k0 + n] - state[1 : n + 1]
            _recurse_once(buf, 1, at_beta, n, -a, s1)
            state[0] = state[n]
            if n_hats:
                u0, du = knots[cell, 0] + (k0 - start) * knots[cell, 1], knots[cell, 1]
                _line(1.0 - u0, -du, n, buf[at_hats])
                _line(u0, du, n, buf[at_hats + 1])
                _add(buf[at_hats], -hats[left], n, buf[0])
                _add(buf[at_hats + 1], -hats[left + 1], n, buf[0])
            if n_waves:
                _turning(omega, k0 - origin, n, buf[at_waves:])
                for j in range(n_waves):
                    _add(buf[at_waves + j], -ripple[run, j], n, buf[0])
            slot = _store(buf, p, n, root, k0, slot, errors)
            _add_products(buf, p, n, grams[cell])
            k0 += n
        coefficient *= decay
        ends[cell, 0, n_hats] = decay


@compiled
def _undrifted(
    y: FloatArray,
    low: int,
    n: int,
    cell_start: int,
    knot: FloatArray,
    left: int,
    hats: FloatArray,
    waves: FloatArray,
    amplitudes: FloatArray,
    out: FloatArray,
) -> None:
    """Return ψ' less drift and ripple for n rows from ``low`` on."""
    out[:n] = y[low : low + n]
    if hats.size > 0:
        u0 = knot[0] + (low - cell_start) * knot[1]
        g, slope = hats[left], hats[left + 1] - hats[left]
        for k in range(n):
            out[k] -= g + slope * (u0 + k * knot[1])
        if u0 < 0.0:
            # The one row before the cell's first lies on the piece before.
            out[0] += (slope - (hats[left] - hats[left - 1])) * u0
    for j in range(amplitudes.size):
        _add(waves[j], -amplitudes[j], n, out)


@compiled
def _hats_differenced(u0: float, du: float, a: float, n: int, out: FloatArray) -> None:
    """Fill hat[k] - a hat[k-1] of the hats before, left and right of a cell."""
    out[0, :n] = 0.0
    _line(1.0 - u0 - a * (1.0 - u0 + du), (a - 1.0) * du, n, out[1])
    _line(u0 - a * (u0 - du), (1.0 - a) * du, n, out[2])
    before = u0 - du
    if before < 0.0:
        out[0, 0] = a * before
        out[1, 0] = 1.0 - u0 - a * (1.0 + before)
        out[2, 0] = u0


@compiled
def _whiten(
    buf: FloatArray,
    at_c: int,
    at_hats: int,
    at_waves: int,
    p: int,
    n: int,
    c: FloatArray,
    d_c: FloatArray,
    history: FloatArray,
    s1: FloatArray,
    s2: FloatArray,
) -> None:
    """Send all columns through 1/C, and make those of ρ from the whitened errors."""
    order = c.size
    c1, c2 = c[0], (c[1] if order > 1 else 0.0)
    _recurse(buf, 0, at_c, n, c1, c2, s1, s2)
    history[2 : n + 2] = buf[0, :n]
    for j in range(order):
        _add(history[1:], d_c[0, j], n, buf[at_c + j])
        if order > 1:
            _add(history, d_c[1, j], n, buf[at_c + j])
    history[0], history[1] = history[n], history[n + 1]
    _recurse(buf, at_c, p, n, c1, c2, s1, s2)
    for i in range(at_hats, at_waves):
        if abs(s1[i]) < 1e-200 and abs(s2[i]) < 1e-200:
            s1[i] = s2[i] = 0.0


@compiled
def _begin_piece(
    starts: FloatArray,
    piece: int,
    order: int,
    history: FloatArray,
    s1: FloatArray,
    s2: FloatArray,
) -> None:
    """Forget the piece before; the errors ahead of this one are as given, or zero."""
    s1[:] = 0.0
    s2[:] = 0.0
    history[:] = 0.0
    if starts.size > 0 and order > 0:
        s1[0] = history[1] = starts[piece * order]
    if starts.size > 0 and order > 1:
        s2[0] = history[0] = starts[piece * order + 1]


@compiled
def equation_error_pass(
    y: FloatArray,
    terms: FloatArray,
    root: FloatArray,
    rows: IntArray,
    knots: FloatArray,
    shift: int,
    taps: FloatArray,
    a: float,
    d_a: float,
    n_dead: int,
    beta: FloatArray,
    starts: FloatArray,
    hats: FloatArray,
    omega: FloatArray,
    ripple: FloatArray,
    slots: IntArray,
    errors: FloatArray,
    grams: FloatArray,
    ends: FloatArray,
    c: FloatArray,
    d_c: FloatArray,
    n_starts: int,
) -> None:
    """Whitened equation errors and all inner products, cell by cell."""
    q, n_waves, order = terms.shape[0], 2 * omega.size, c.size
    n_hats = 3 if hats.size > 0 else 0
    at_c = 2 + n_dead
    at_beta = at_c + order
    at_hats = at_beta + q
    at_start = at_hats + n_hats
    at_waves = at_start + n_starts
    p = at_waves + n_waves
    buf = np.zeros((p, CHUNK))
    source, clean = np.zeros(CHUNK + 2), np.zeros(CHUNK + 1)
    waves = np.zeros((n_waves, CHUNK + 1))
    history = np.zeros(CHUNK + 2)
    s1, s2 = np.zeros(p), np.zeros(p)
    piece = -1
    for cell in range(rows.shape[0]):
        start, stop, origin, first, left, run = rows[cell]
        if first:
            piece += 1
            _begin_piece(starts, piece, order, history, s1, s2)
        s1[at_hats:at_waves] = 0.0
        s2[at_hats:at_waves] = 0.0
        s1[at_start : at_start + min(n_starts, 1)] = 1.0
        s2[at_start + 1 : at_start + n_starts] = 1.0
        slot = slots[cell]
        k0 = start
        while k0 < stop:
            n = min(CHUNK, stop - k0)
            if n_waves:
                _turning(omega, k0 - 1 - origin, n + 1, waves)
            _undrifted(y, k0 - 1, n + 1, start, knots[cell], left, hats, waves, ripple[run], clean)
            low = k0 - shift - 2
            _term_columns(terms, beta, taps, low, n, origin, n_dead, at_beta, source, buf)
            buf[0, :n] = clean[1 : n + 1]
            _add(clean, -a, n, buf[0])
            _add(clean, d_a, n, buf[1])
            for i in range(q):
                _add(buf[at_beta + i], -beta[i], n, buf[0])
            if n_hats:
                _hats_differenced(
                    knots[cell, 0] + (k0 - start) * knots[cell, 1],
                    knots[cell, 1],
                    a,
                    n,
                    buf[at_hats:],
                )
            for j in range(n_waves):
                buf[at_waves + j, :n] = waves[j, 1 : n + 1]
                _add(waves[j], -a, n, buf[at_waves + j])
            if order > 0:
                buf[at_c:at_beta, :n] = 0.0
                buf[at_start:at_waves, :n] = 0.0
                _whiten(buf, at_c, at_hats, at_waves, p, n, c, d_c, history, s1, s2)
            slot = _store(buf, p, n, root, k0, slot, errors)
            _add_products(buf, p, n, grams[cell])
            k0 += n
        if n_starts > 0:
            ends[cell, 0] = s1[at_hats:at_waves]
            ends[cell, 1:] = s2[at_hats:at_waves]


@compiled
def sum_hats(n: int, step: float, intervals: int, weight: FloatArray, sums: FloatArray) -> None:
    """Add up the weights under each hat of one run."""
    for k in range(n):
        place = k * step
        left = max(min(int(place + 1e-9), intervals - 1), 0)
        share = weight[k] if weight.size > 0 else 1.0
        sums[left] += share * (1.0 - (place - left))
        sums[left + 1] += share * (place - left)
