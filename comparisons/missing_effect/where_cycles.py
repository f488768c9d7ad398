"""What the flow says about a row: its surge cycle, its phase, its direction, its block of time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks

from classic_ml.cycles import deep_ones
from comparisons.missing_effect.where_rows import ResidualRuns
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray

__all__ = ["Blocks", "Cycles", "blocks_of", "cycles_of", "falls"]

# A swing counts where φ passes a quarter of its rms to both sides of its mean.
SWING = 0.25
REGULAR = (0.7, 1.4)
REGULAR_SHARE = 0.7
FEWEST_CYCLES = 3
# Rows to both sides over which φ is differenced, as a share of a cycle.
DIFFERENCE_CYCLES = 0.02
MOST_BLOCKS = 12
CYCLES_A_BLOCK = 2.0
FEWEST_ROWS = 10


@dataclass(frozen=True)
class Cycles:
    """The surge cycles of one record.

    Parameters
    ----------
    frequency_hz : float
        One over the median period; NaN where no regular cycle is found.
    phase : ndarray of shape (n,)
        Phase of every row of the data from where φ rises through its mean, in cycles; NaN
        outside the record and outside regular cycles.
    """

    frequency_hz: float
    phase: FloatArray


@dataclass(frozen=True)
class Blocks:
    """Blocks of time, in order, and whose rows are in which.

    Parameters
    ----------
    rows, block : ndarray of int, shape (m,)
        The scored rows and the block of each.
    record : ndarray of int, shape (n_blocks,)
        Record of each block.
    from_s, to_s : ndarray of shape (n_blocks,)
        Edges.
    """

    rows: IntArray
    block: IntArray
    record: IntArray
    from_s: FloatArray
    to_s: FloatArray


def cycles_of(data: ResidualRuns, inside: BoolArray, record: int) -> Cycles:
    """Return the surge cycles of a record, from one rise of φ through its mean to the next.

    Parameters
    ----------
    data : ResidualRuns
        The data.
    inside : ndarray of bool, shape (n,)
        Rows that belong to a run.
    record : int
        Number of the record.
    """
    phase = np.full(data.phi.size, np.nan)
    rows = np.flatnonzero(inside & (data.record == record))
    run = np.zeros(data.phi.size, dtype=np.int64)
    run[[r.start for r in data.runs]] = 1
    run = np.cumsum(run)[rows]
    last, starts = _rises(data.phi[rows], data.time_s[rows])
    # What φ did in a gap is not known: a cycle lies within one run.
    unbroken = run[last[:-1]] == run[np.minimum(last[1:] + 1, rows.size - 1)]
    periods = np.diff(starts)
    if np.count_nonzero(unbroken) < FEWEST_CYCLES:
        return Cycles(math.nan, phase)
    typical = float(np.median(periods[unbroken]))
    alike = (periods > REGULAR[0] * typical) & (periods < REGULAR[1] * typical)
    if np.mean(alike[unbroken]) < REGULAR_SHARE:
        return Cycles(math.nan, phase)
    regular = unbroken & alike
    cycle = np.searchsorted(starts, data.time_s[rows], side="right") - 1
    whole = (cycle >= 0) & (cycle < periods.size)
    whole[whole] &= regular[cycle[whole]]
    cycle, rows = cycle[whole], rows[whole]
    phase[rows] = (data.time_s[rows] - starts[cycle]) / periods[cycle]
    return Cycles(1.0 / typical, phase)


def falls(data: ResidualRuns, cycles: tuple[Cycles, ...]) -> BoolArray:
    """Tell in which rows φ falls, by its difference over some hundredths of a cycle.

    Parameters
    ----------
    data : ResidualRuns
        The data.
    cycles : tuple of Cycles
        Of each record.
    """
    falling = np.zeros(data.phi.size, dtype=bool)
    for run in data.runs:
        frequency_hz = cycles[int(data.record[run.start])].frequency_hz
        reach = DIFFERENCE_CYCLES * data.sample_rate_hz / frequency_hz
        step = max(1, round(reach)) if math.isfinite(reach) else 1
        own = data.phi[run]
        row = np.arange(own.size)
        ahead = own[np.minimum(row + step, own.size - 1)]
        falling[run] = ahead < own[np.maximum(row - step, 0)]
    return falling


def blocks_of(
    data: ResidualRuns, scored: BoolArray, cycles: tuple[Cycles, ...], block_s: float | None
) -> Blocks:
    """Return each record cut into blocks of time, those with few scored rows joined to the next.

    Parameters
    ----------
    data : ResidualRuns
        The data.
    scored : ndarray of bool, shape (n,)
        Rows that are scored and belong to a run.
    cycles : tuple of Cycles
        Of each record.
    block_s : float, optional
        Length, in seconds; else two cycles or a twelfth of the longest record.

    Raises
    ------
    InputError
        When every record is shorter than a block.
    """
    own = [np.flatnonzero(scored & (data.record == r)) for r in range(len(data.record_names))]
    step_s = 1.0 / data.sample_rate_hz
    spans = [
        (float(data.time_s[rows[0]]), float(data.time_s[rows[-1]]) + step_s)
        for rows in own
        if rows.size
    ]
    longest = max(high - low for low, high in spans)
    if block_s is not None and block_s > longest + 0.5 * step_s:
        raise InputError(
            "block_s",
            expected=f"at most the longest record, {longest:.4g} s",
            found=f"{block_s:g} s",
            remedy="give a shorter block or leave it out",
        )
    slowest = min((c.frequency_hz for c in cycles if math.isfinite(c.frequency_hz)), default=0.0)
    two_cycles = CYCLES_A_BLOCK / slowest if slowest > 0.0 else 0.0
    width = max(two_cycles, longest / MOST_BLOCKS) if block_s is None else block_s
    parts: list[tuple[IntArray, IntArray, FloatArray]] = []
    numbers = [number for number, rows in enumerate(own) if rows.size]
    for number, (low, high) in zip(numbers, spans, strict=True):
        rows = own[number]
        count = max(1, round((high - low) / width))
        edges = np.linspace(low, high, count + 1)
        if block_s is not None:
            edges = np.append(low + width * np.arange(count), high)
        block, edges = _joined(data.time_s[rows], edges)
        parts.append((rows, block, edges))
    sizes = [edges.size - 1 for _, _, edges in parts]
    offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    return Blocks(
        np.concatenate([rows for rows, _, _ in parts]),
        np.concatenate([block + o for (_, block, _), o in zip(parts, offsets, strict=True)]),
        np.repeat(numbers, sizes),
        np.concatenate([edges[:-1] for _, _, edges in parts]),
        np.concatenate([edges[1:] for _, _, edges in parts]),
    )


def _rises(phi: FloatArray, time_s: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the row before φ rises through its mean into a cycle, and when.

    Neither small wiggles nor the mild oscillations in stall between deep cycles count: a cycle is
    what the reduction takes for one in P31.
    """
    level = phi - np.mean(phi) if phi.size else phi
    swing = SWING * float(np.std(level)) if phi.size else 0.0
    side = np.where(level > swing, 1, np.where(level < -swing, -1, 0))
    clear = np.flatnonzero(side)
    arrived = clear[1:][(side[clear[1:]] == 1) & (side[clear[:-1]] == -1)]
    arrived = _into_cycles(arrived, phi, swing)
    through = np.flatnonzero((level[:-1] < 0.0) & (level[1:] >= 0.0))
    last = through[np.searchsorted(through, arrived) - 1] if arrived.size else arrived
    share = -level[last] / (level[last + 1] - level[last])
    return last, np.asarray(time_s[last] + share * (time_s[last + 1] - time_s[last]))


def _into_cycles(arrived: IntArray, phi: FloatArray, swing: float) -> IntArray:
    """Return the arrivals above the mean that a deep peak follows before the next."""
    peaks, found = find_peaks(phi, prominence=swing)
    rises = found["prominences"]
    if not arrived.size or not peaks.size:
        return arrived[:0]
    before = np.searchsorted(arrived, peaks[deep_ones(rises)], side="right") - 1
    return arrived[np.unique(before[before >= 0])]


def _joined(time_s: FloatArray, edges: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the block of each time, and the edges that remain, no block with too few rows."""
    counts = np.bincount(
        np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, edges.size - 2),
        minlength=edges.size - 1,
    )
    kept, waiting = [float(edges[0])], 0
    for count, edge in zip(counts.tolist(), edges[1:].tolist(), strict=True):
        waiting += count
        if waiting >= FEWEST_ROWS:
            kept.append(edge)
            waiting = 0
    if len(kept) == 1:
        kept.append(float(edges[-1]))
    kept[-1] = float(edges[-1])
    remaining = np.asarray(kept)
    block = np.searchsorted(remaining, time_s, side="right") - 1
    return np.clip(block, 0, remaining.size - 2).astype(np.int64), remaining
