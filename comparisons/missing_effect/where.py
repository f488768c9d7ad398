"""Where a simulation and its measurement part: over time, over frequency, over a signal.

One way for lag series and for users' models. Every mean has a standard error from the sums of
blocks of time, since errors of neighbouring rows go together; powers are held against the noise
where its law is known; and one bound that counts how many numbers were looked at holds for all.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from comparisons.missing_effect.runs import rms
from comparisons.missing_effect.where_rows import (
    BandRow,
    Cell,
    Residuals,
    SignalRow,
    TimeRow,
    Where,
)
from comparisons.missing_effect.where_spectrum import (
    Power,
    floor_density,
    log_bands,
    power_z,
    tapered_power,
)
from surge_core.types import BoolArray, FloatArray, IntArray

# Chance that anything at all is said to stand out of pure noise.
FALSE_ALARM = 0.005
TIME_BLOCKS, FEWEST_BLOCKS = 40, 12
SIGNAL_BINS = 20
# A bin with fewer rows has no mean to speak of; it is joined to its neighbour.
FEWEST_IN_BIN, FEWEST_SHARE = 8, 0.002
# An outlier is held at so many scales where the noise is known: heavy tails are no structure.
OUTLIER_SCALES, MAD_TO_SIGMA = 4.0, 1.4826
# Rows to both sides over which the signal is differenced, as a share of its main period.
DIFFERENCE_SHARE = 0.02


def where_of(given: Residuals) -> Where:
    """Return where the residual of one output with rows enough stands out, before and after.

    z of a mean is that of a t whose standard error comes from the sums of blocks of time; z of a
    power that of a χ² about the floor's. The bound on all z is Bonferroni's, at a false alarm of
    0.5 % for the whole.
    """
    from scipy.special import ndtri

    scored = np.isfinite(given.measured)
    before, after = given.measured - given.before, given.measured - given.after
    held = _held_back(before, scored, given.floor_rms)
    # What is judged against a floor is not made up: rows without a reading are none.
    bridged = not math.isfinite(given.floor_rms)
    powers = [
        tapered_power(values, scored, given.runs, given.period_s, bridged=bridged)
        for values in (held, after, given.measured)
    ]
    background, frequency = _over_frequency(given, powers)
    blocks = _blocks(given)
    time = tuple(_time_row(given, b, before, after, held, max(background, 1.0)) for b in blocks)
    block = np.full(scored.size, -1)
    for number, rows in enumerate(blocks):
        block[rows] = number
    flow, direction = _over_signal(given, scored, block, (before, after, held))
    looked = [z for row in time for z in (row.z_mean, row.z_variance)]
    looked += [row.z for row in frequency] + [direction.z]
    looked += [cell.z for row in flow for cell in row.before.values()]
    looks = int(np.count_nonzero(np.isfinite(looked)))
    bound = -float(ndtri(0.5 * FALSE_ALARM / max(looks, 1)))
    return Where(given, time, frequency, flow, direction, background, looks, bound)


def _held_back(values: FloatArray, scored: BoolArray, floor_rms: float) -> FloatArray:
    """Return a residual whose outliers are held at four scales where its noise is known."""
    if not math.isfinite(floor_rms):
        return values
    own = MAD_TO_SIGMA * float(np.median(np.abs(values[scored])))
    limit = OUTLIER_SCALES * max(floor_rms, own)
    return np.clip(values, -limit, limit)


def _blocks(given: Residuals) -> list[IntArray]:
    """Return the rows of each block, some forty in all, those of one record together."""
    n_records = len(given.record_names)
    each = max(FEWEST_BLOCKS, TIME_BLOCKS // n_records)
    out = []
    for number in range(n_records):
        rows = np.flatnonzero(given.record == number)
        out += [b for b in np.array_split(rows, min(each, max(rows.size, 1))) if b.size]
    return out


def _time_row(
    given: Residuals,
    rows: IntArray,
    before: FloatArray,
    after: FloatArray,
    held: FloatArray,
    background: float,
) -> TimeRow:
    own = rows[np.isfinite(given.measured[rows])]
    name = given.record_names[int(given.record[rows[0]])]
    edges = float(given.time_s[rows[0]]), float(given.time_s[rows[-1]]) + given.period_s
    was, left = float(rms(before[own])), float(rms(after[own]))
    mean = float(np.mean(before[own])) if own.size else math.nan
    excess = z_mean = z_variance = math.nan
    if math.isfinite(given.floor_rms) and own.size >= FEWEST_IN_BIN:
        innovations, size = _innovations(given, held, own)
        size *= background
        # Of many rows the mean of an autoregression has the variance σ²/(1 − Σa)² over their
        # number.
        stderr = size / (1.0 - float(np.sum(given.ar))) / math.sqrt(own.size)
        if innovations.size >= FEWEST_IN_BIN:
            squares = (innovations / size) ** 2
            spread = max(float(np.var(squares)) / max(float(np.mean(squares)) ** 2, 1e-300), 2.0)
            z_variance = power_z(float(np.mean(squares)), squares.size * 2.0 / spread)
        excess = math.sqrt(max(was**2 - given.floor_rms**2, 0.0))
        z_mean = float(np.mean(held[own])) / stderr
    return TimeRow(name, *edges, own.size, was, left, mean, excess, z_mean, z_variance)


def _innovations(given: Residuals, held: FloatArray, rows: IntArray) -> tuple[FloatArray, float]:
    """Return what the floor's autoregression leaves of some rows, and its rms by that law."""
    from scipy.signal import lfilter

    impulse = np.zeros(2000)
    impulse[0] = 1.0
    response = lfilter([1.0], np.r_[1.0, -given.ar], impulse)
    size = given.floor_rms / math.sqrt(float(response @ response))
    p = given.ar.size
    left = held[rows[p:]].copy()
    whole = rows[p:] - rows[: rows.size - p] == p
    for lag, a in enumerate(given.ar.tolist(), start=1):
        left -= a * held[rows[p - lag : rows.size - lag]]
    starts = [run.start for run in given.runs]
    whole &= np.searchsorted(starts, rows[p:], "right") == np.searchsorted(
        starts, rows[: rows.size - p], "right"
    )
    left = left[whole]
    return left - (left.mean() if left.size else 0.0), size


def _over_frequency(given: Residuals, powers: list[Power]) -> tuple[float, tuple[BandRow, ...]]:
    before, rows = powers[0], []
    known = math.isfinite(given.floor_rms)
    floor = floor_density(before.frequency_hz, given.floor_rms, given.ar, given.period_s)
    ratio = before.density / floor if known else np.full(floor.size, math.nan)
    background = before.background(ratio) if known else math.nan
    level = max(background, 1.0) ** 2
    total = float(np.sum(before.density))
    for low, high, inside in log_bands(before.frequency_hz, before.resolution_hz):
        was, now, measured = (float(np.mean(power.density[inside])) for power in powers)
        share = float(np.sum(before.density[inside])) / total if total > 0.0 else math.nan
        own = float(np.mean(ratio[inside])) if known else math.nan
        freedom = max(before.per_hz * (high - low), before.bin_freedom)
        z = power_z(own / level, freedom) if known else math.nan
        rows.append(BandRow(low, high, was, now, measured, share, own, z))
    return background, tuple(rows)


def _over_signal(
    given: Residuals, scored: BoolArray, block: IntArray, values: tuple[FloatArray, ...]
) -> tuple[tuple[SignalRow, ...], Cell]:
    before, after, held = values
    falling = _falls(given)
    scored = scored & np.isfinite(given.over)
    ways = {"any": scored, "falling": scored & falling, "rising": scored & ~falling}
    rows = []
    for low, high, inside in _ranges(given.over, scored):
        cells = [
            {way: _cell(v, h, inside & cut, block) for way, cut in ways.items()}
            for v, h in ((before, held), (after, after))
        ]
        rows.append(SignalRow(low, high, float(np.mean(given.over[inside & scored])), *cells))
    weights = np.zeros(scored.size)
    for way, sign in (("falling", 1.0), ("rising", -1.0)):
        rows_of = ways[way]
        if not rows_of.any():
            return tuple(rows), Cell(math.nan, math.nan, math.nan, 0)
        weights[rows_of] = sign / np.count_nonzero(rows_of)
    parted = held - np.where(falling, *(_mean(held[ways[w]]) for w in ("falling", "rising")))
    cell = _judged(float(weights @ np.nan_to_num(held)), (parted * weights)[scored], block[scored])
    difference = _mean(before[ways["falling"]]) - _mean(before[ways["rising"]])
    return tuple(rows), replace(cell, mean=difference)


def _cell(values: FloatArray, held: FloatArray, inside: BoolArray, block: IntArray) -> Cell:
    own = values[inside]
    if own.size < FEWEST_IN_BIN // 2:
        return Cell(math.nan, math.nan, math.nan, own.size)
    level = _mean(held[inside])
    cell = _judged(level, (held[inside] - level) / own.size, block[inside])
    return replace(cell, mean=_mean(own))


def _judged(mean: float, parts: FloatArray, block: IntArray) -> Cell:
    """Return a mean with the standard error that the sums of its blocks show."""
    from scipy.special import ndtri, stdtr

    n = parts.size
    own, at = np.unique(block, return_inverse=True)
    if own.size < 3 or not math.isfinite(mean):
        return Cell(mean, math.nan, math.nan, n)
    sums = np.bincount(at, parts)
    # Blocks that are seldom visited tell little of the scatter.
    rows = np.bincount(at).astype(np.float64)
    blocks = float(rows.sum() ** 2 / (rows @ rows))
    freedom = max(blocks - 1.0, 1.0)
    stderr = math.sqrt(float(sums @ sums) * blocks / freedom)
    if not stderr > 0.0:
        return Cell(mean, math.nan, math.nan, n)
    tail = max(float(stdtr(freedom, -abs(mean) / stderr)), 1e-300)
    return Cell(mean, stderr, math.copysign(-float(ndtri(tail)), mean), n)


def _falls(given: Residuals) -> BoolArray:
    """Return in which rows the signal falls, by its difference over a little of its period."""
    reach = DIFFERENCE_SHARE / (given.cycle_hz * given.period_s) if given.cycle_hz > 0.0 else 1.0
    step = max(1, round(reach))
    falling = np.zeros(given.over.size, dtype=np.bool_)
    for run in given.runs:
        own = given.over[run]
        row = np.arange(own.size)
        ahead, behind = np.minimum(row + step, own.size - 1), np.maximum(row - step, 0)
        falling[run] = own[ahead] < own[behind]
    return falling


def _ranges(signal: FloatArray, scored: BoolArray) -> list[tuple[float, float, BoolArray]]:
    """Return ranges of one width over the signal's own, joined where there are few rows."""
    own = signal[scored]
    low, high = float(own.min()), float(own.max())
    if not high > low:
        return [(low, high, scored)]
    edges = np.linspace(low, high, SIGNAL_BINS + 1)
    fewest = max(FEWEST_IN_BIN, FEWEST_SHARE * own.size)
    kept, waiting = [low], 0
    for edge, n in zip(edges[1:].tolist(), np.histogram(own, edges)[0].tolist(), strict=True):
        waiting += n
        if waiting >= fewest:
            kept.append(edge)
            waiting = 0
    # What is left at the upper end goes to the last range.
    kept = [*kept[:-1], high] if len(kept) > 1 else [low, high]
    which = np.clip(np.searchsorted(kept, signal, side="right") - 1, 0, len(kept) - 2)
    return [(a, b, (which == i) & scored) for i, (a, b) in enumerate(pairwise(kept))]


def _mean(values: FloatArray) -> float:
    return float(np.mean(values))
