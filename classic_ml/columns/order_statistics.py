"""Exact medians, percentiles and means of a column that may be larger than memory.

The column is read block by block, a few times over. Nothing depends on where a block ends: order
statistics are exact, and sums are carried in twice the precision in an order of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import fsum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.columns import workspace as places
from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks
from surge_core.types import FloatArray, IntArray

__all__ = ["Pieces", "Rows", "lowest", "mean", "median", "percentile", "total"]

# A signal that is computed anew, piece by piece, each time that it is asked for.
Pieces = Callable[[], Iterable[FloatArray]]
Rows = slice | NDArray[np.bool_] | None

KeyArray = NDArray[np.uint64]

# One pass sorts by 16 of the 64 bits: its counts (512 KB) stay in the second-level cache.
DIGIT_BITS = 16
DIGITS = 1 << DIGIT_BITS
# A median is looked for between two values of a sample of so many blocks at most, so many standard
# deviations of its place in there apart; what lies between them is put in order.
SAMPLE_BLOCKS, BETWEEN_BLOCKS = 1, 8
SPREAD = 4.0
# Sums are carried in eight lanes, as many as a vector register takes.
LANES = 8


def median(
    values: FloatArray | Pieces, rows: Rows = None, *, workspace: Workspace = IN_MEMORY
) -> float:
    """Return the median, exactly that of numpy, in flat memory.

    Parameters
    ----------
    values : ndarray of shape (n,), or callable
        The column, or a function that returns its pieces in order each time that it is called.
    rows : slice or ndarray of bool, shape (n,), optional
        Rows that count; all of them without it. Not with a callable.
    workspace : Workspace
        Where the column lies; its memory is let go of after each block.

    Returns
    -------
    float
        NaN where a value is NaN.

    Raises
    ------
    ValueError
        When there is no value.
    """
    middle, n = _selected(values, rows, workspace, lambda n: np.array([(n - 1) // 2, n // 2]))
    return float(middle[0] if n % 2 else 0.5 * (middle[0] + middle[1]))


def percentile(
    values: FloatArray | Pieces,
    q: ArrayLike,
    rows: Rows = None,
    *,
    workspace: Workspace = IN_MEMORY,
) -> FloatArray:
    """Return percentiles as ``np.percentile`` does, with straight lines between the values.

    Parameters
    ----------
    values, rows, workspace
        See :func:`median`.
    q : float or array_like of shape (m,)
        Percentages, 0 to 100.

    Returns
    -------
    ndarray of shape (m,), or () for a single percentage
        NaN where a value is NaN.

    Raises
    ------
    ValueError
        When there is no value.
    """
    shares = np.atleast_1d(np.asarray(q, dtype=np.float64)) / 100.0

    def ranks(n: int) -> IntArray:
        below = np.floor((n - 1) * shares).astype(np.int64)
        return np.concatenate((below, np.minimum(below + 1, n - 1)))

    chosen, n = _selected(values, rows, workspace, ranks)
    low, high = np.split(chosen, 2)
    place = (n - 1) * shares
    part = place - np.floor(place)
    # Two infinities have no difference.
    gap = np.subtract(high, low, out=np.zeros_like(high), where=low != high)
    # From the nearer of both ends, as numpy does, so that neither is missed by a rounding.
    found = np.where(part >= 0.5, high - gap * (1.0 - part), low + gap * part)
    return found if np.ndim(q) else found.reshape(())


def mean(
    values: FloatArray | Pieces, rows: Rows = None, *, workspace: Workspace = IN_MEMORY
) -> float:
    """Return the arithmetic mean; parameters and errors as those of :func:`median`."""
    added, n = _added(values, rows, workspace)
    if n == 0:
        raise ValueError("the mean of no values")
    return added / n


def total(
    values: FloatArray | Pieces, rows: Rows = None, *, workspace: Workspace = IN_MEMORY
) -> float:
    """Return the sum; parameters as those of :func:`median`, 0 where there is no value."""
    return _added(values, rows, workspace)[0]


def lowest(
    values: FloatArray | Pieces, rows: Rows = None, *, workspace: Workspace = IN_MEMORY
) -> tuple[float, int]:
    """Return the least value and how many come before it; parameters as those of :func:`median`."""
    least, place, n_before = np.inf, 0, 0
    for piece in _read(values, rows, workspace):
        if piece.size:
            at = int(np.argmin(piece))
            if piece[at] < least:
                least, place = float(piece[at]), n_before + at
        n_before += piece.size
    return least, place


def _read(values: FloatArray | Pieces, rows: Rows, workspace: Workspace) -> Iterator[FloatArray]:
    """Yield the values that count, one block or piece after another."""
    if callable(values):
        pieces: Iterable[FloatArray] = values()
    elif isinstance(rows, np.ndarray):
        pieces = (values[block][rows[block]] for block in blocks(values.size))
    else:
        start, stop, _ = (rows if rows is not None else slice(None)).indices(values.size)
        pieces = (values[block] for block in blocks(stop, start))
    for piece in pieces:
        yield np.asarray(piece, dtype=np.float64)
        workspace.release()


def _added(values: FloatArray | Pieces, rows: Rows, workspace: Workspace) -> tuple[float, int]:
    sums, errors, n = np.zeros(LANES), np.zeros(LANES), 0
    for piece in _read(values, rows, workspace):
        _add(piece, n, sums, errors)
        n += piece.size
    if np.all(np.isfinite(errors)):
        return fsum((*sums, *errors)), n
    return float(np.sum(sums)), n


@as_written
def _add(values: FloatArray, n_before: int, sums: FloatArray, errors: FloatArray) -> None:
    """Add values to the lanes, and what rounding took off them to the errors (Knuth's TwoSum)."""
    n = values.size
    first = min(n, (-n_before) % LANES)
    last = first + (n - first) // LANES * LANES
    for k in range(first):
        _add_one(values[k], (n_before + k) % LANES, sums, errors)
    for row in range(first, last, LANES):
        for lane in range(LANES):
            _add_one(values[row + lane], lane, sums, errors)
    for k in range(last, n):
        _add_one(values[k], k - last, sums, errors)


@as_written
def _add_one(value: float, lane: int, sums: FloatArray, errors: FloatArray) -> None:
    before = sums[lane]
    after = before + value
    taken = after - before
    errors[lane] += (before - (after - taken)) + (value - taken)
    sums[lane] = after


def _selected(
    values: FloatArray | Pieces,
    rows: Rows,
    workspace: Workspace,
    ranks_of: Callable[[int], IntArray],
) -> tuple[FloatArray, int]:
    """Return the values at ranks that depend on their number, and that number."""
    few = _few(_read(values, rows, workspace))
    if few is not None:
        if few.size == 0:
            raise ValueError("an order statistic of no values")
        ranks = ranks_of(few.size)
        if np.isnan(few).any():
            return np.full(ranks.size, np.nan), few.size
        # -0.0 becomes 0.0: which of both comes first is no order.
        return np.partition(few, np.unique(ranks))[ranks] + 0.0, few.size
    sample, n = _sampled(_read(values, rows, workspace))
    ranks = ranks_of(n)
    if np.ptp(ranks) <= 1:
        found = _between(_read(values, rows, workspace), sample, ranks, n)
        if found is not None:
            return found, n
    counts = np.zeros((1, DIGITS), dtype=np.int64)
    heads = np.zeros(1, dtype=np.uint64)
    not_numbers = 0
    for piece in _read(values, rows, workspace):
        not_numbers += _count(piece.view(np.uint64), 64 - DIGIT_BITS, heads, counts)
    if not_numbers:
        return np.full(ranks.size, np.nan), n

    def read() -> Iterator[FloatArray]:
        return _read(values, rows, workspace)

    return _narrowed(read, ranks, heads, counts), n


def _few(pieces: Iterable[FloatArray]) -> FloatArray | None:
    """Return the values in one array, or None where they are more than one block."""
    kept: list[FloatArray] = []
    for piece in pieces:
        if sum(k.size for k in kept) + piece.size > places.BLOCK_ROWS:
            return None
        kept.append(piece)
    return np.concatenate(kept) if kept else np.zeros(0)


def _sampled(pieces: Iterable[FloatArray]) -> tuple[FloatArray, int]:
    """Return the values in every so manieth row, and how many rows there are."""
    most = SAMPLE_BLOCKS * places.BLOCK_ROWS
    sample, n_sample, stride, n = np.empty(most), 0, 1, 0
    for piece in pieces:
        while True:
            taken = piece[-n % stride :: stride]
            if n_sample + taken.size <= most:
                break
            # By three, which hardly any signal repeats itself after a multiple of.
            kept = sample[:n_sample:3].copy()
            stride, n_sample = 3 * stride, kept.size
            sample[:n_sample] = kept
        sample[n_sample : n_sample + taken.size] = taken
        n_sample += taken.size
        n += piece.size
    return sample[:n_sample], n


def _between(
    pieces: Iterable[FloatArray], sample: FloatArray, ranks: IntArray, n: int
) -> FloatArray | None:
    """Return the values at ranks next to each other, or None where the sample was not like all."""
    middle, reach = sample.size * (ranks[0] + 0.5) / n, 0.5 * SPREAD * np.sqrt(sample.size) + 1.0
    first, last = int(middle - reach), int(middle + reach)
    inner = [place for place in (first, last) if 0 <= place < sample.size]
    in_order = np.partition(sample, inner) if inner else sample
    low = in_order[first] if first >= 0 else -np.inf
    high = in_order[last] if last < sample.size else np.inf
    kept: list[FloatArray] = []
    n_below = n_above = n_kept = 0
    for piece in pieces:
        n_below += int(np.count_nonzero(piece < low))
        n_above += int(np.count_nonzero(piece > high))
        kept.append(piece[(piece >= low) & (piece <= high)])
        n_kept += kept[-1].size
        if n_kept > BETWEEN_BLOCKS * places.BLOCK_ROWS:
            return None
    inside = ranks - n_below
    # What is not a number is nowhere.
    if n_below + n_kept + n_above != n or inside.min() < 0 or inside.max() >= n_kept:
        return None
    ordered = np.partition(np.concatenate(kept), np.unique(inside))
    return np.asarray(ordered[inside] + 0.0)


def _narrowed(read: Pieces, ranks: IntArray, heads: KeyArray, counts: IntArray) -> FloatArray:
    """Return the values at some ranks, digit by digit of their keys.

    ``heads`` holds the leading bits of the keys that are looked for, in order, and ``counts`` how
    many keys with these bits have which next digit.
    """
    shift = 64 - DIGIT_BITS
    which = np.zeros(ranks.size, dtype=np.int64)
    inside = ranks.copy()
    while True:
        sizes = np.empty(ranks.size, dtype=np.int64)
        keys = np.empty(ranks.size, dtype=np.uint64)
        for i, head in enumerate(which):
            upto = np.cumsum(counts[head])
            digit = int(np.searchsorted(upto, inside[i], side="right"))
            sizes[i] = counts[head, digit]
            inside[i] -= upto[digit] - sizes[i]
            keys[i] = (heads[head] << np.uint64(DIGIT_BITS)) | np.uint64(digit)
        heads, first, which = np.unique(keys, return_index=True, return_inverse=True)
        if shift == 0:
            return _values_of(keys)
        if sizes[first].sum() <= places.BLOCK_ROWS:
            break
        shift -= DIGIT_BITS
        counts = np.zeros((heads.size, DIGITS), dtype=np.int64)
        for piece in read():
            _count(piece.view(np.uint64), shift, heads, counts)
    left = np.empty(int(sizes[first].sum()), dtype=np.uint64)
    n_left = 0
    for piece in read():
        n_left = _gather(piece.view(np.uint64), shift, heads, left, n_left)
    left.sort()
    before = np.concatenate(([0], np.cumsum(sizes[first])))
    return _values_of(left[before[which] + inside])


@as_written
def _key(bits: np.uint64) -> np.uint64:
    """Return a whole number that is in order as the float64 with these bits is."""
    sign = np.uint64(1) << np.uint64(63)
    if bits & sign:
        # -0.0 counts as 0.0.
        return ~bits if bits != sign else sign
    return bits | sign


def _values_of(keys: KeyArray) -> FloatArray:
    sign = np.uint64(1) << np.uint64(63)
    return np.where(keys & sign, keys ^ sign, ~keys).view(np.float64)


@as_written
def _count(bits: KeyArray, shift: int, heads: KeyArray, counts: IntArray) -> int:
    """Count the digit above ``shift`` of the keys that begin with one of the heads; return NaNs."""
    digits = np.uint64(0xFFFF)
    width = np.uint64(16)
    infinite = np.uint64(0x7FF0000000000000)
    magnitude = np.uint64(0x7FFFFFFFFFFFFFFF)
    not_numbers = 0
    for k in range(bits.size):
        if bits[k] & magnitude > infinite:
            not_numbers += 1
        shifted = _key(bits[k]) >> np.uint64(shift)
        for j in range(heads.size):
            if shifted >> width == heads[j]:
                counts[j, shifted & digits] += 1
    return not_numbers


@as_written
def _gather(bits: KeyArray, shift: int, heads: KeyArray, out: KeyArray, n_out: int) -> int:
    """Append the keys that begin with one of the heads; return how many there are then."""
    for k in range(bits.size):
        key = _key(bits[k])
        for j in range(heads.size):
            if key >> np.uint64(shift) == heads[j]:
                out[n_out] = key
                n_out += 1
    return n_out
