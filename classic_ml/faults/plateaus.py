"""Readings cut off at an end of a channel's own range, whatever its unit.

A transducer, an amplifier or the software behind it holds what is beyond its range at the last
value that it can give. In a channel of a physical unit nothing states where that is, but it shows.

Where the noise is larger than the resolution, readings pile up bit-equal at the extreme: the tail
of a noisy signal has fewer readings there than just short of it, not many times more.

Where it is smaller, a slow signal stands still at its own peak too. One that is cut off stands
there two rows or more, and

- arrives and leaves at full speed, many steps of the resolution away, as readings around the peak
  of a smooth signal do not: one that stays within a step of its peak for L rows is no more than
  five steps below it another (L - 1)/2 rows away;
- has hardly any readings a few steps short of the extreme, where a slow signal has most;
- and stands still like that nowhere else, as one does that is held, interpolated or coarse.

A channel without any noise, as a simulation writes it, may rest at its extreme to the last bit:
nothing tells such a rest from a range that ends, and none is found there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.intervals import equal_runs, intervals_where
from surge_core.types import BoolArray, FloatArray, IntArray

__all__ = ["RangeEnd", "range_ends"]

# Rows at which a channel must be seen to be cut off, in how many separate plateaus: two readings on
# either side of a peak may be alike by chance, and again and again in a signal that repeats itself.
LEAST_ROWS, LEAST_PLATEAUS, LONG_ROWS = 6, 2, 3
# A single plateau as long as that is one, too: an overload at the inception of surge.
LONG_PLATEAU_ROWS = 8
# Bit-equal readings at the extreme for each of the eight steps short of it; and how differently the
# signal gets there, which one that repeats itself exactly does not.
PILE, WAYS, WAYS_OF_SINGLE_ROWS = 4.0, 6, 12
# On either side of a plateau so many rows are looked at.
REACH = 4
# In steps of the resolution, and half a one, so that no rounding decides: readings within the
# first are near the extreme, within the second next to it; by the third a plateau is arrived at
# and left.
NEAR_STEPS, NEXT_STEPS, RISE_STEPS = 8.5, 2.5, 5.5
# Steps of the resolution that the second difference usually has, beyond which a channel is noisy.
NOISY_STEPS = 2.5
# A jump of so many times what the four rows before it moved is a dropout, or the step of a channel
# that is held.
LEAP = 2.0
# Of its slope, a line between two readings of a slower recorder is as straight as that.
STRAIGHT = 1e-6
# So many plateaus elsewhere for each at the extreme, and they say nothing.
ELSEWHERE = 0.5
# Differences of this order leave next to nothing of surge and stall cells. One order more doubles
# white noise nearly, and makes less of all that is below a sixth of the sample rate.
NOISE_ORDER = 8
# Pieces of a record in which noise is looked for.
MOST_PIECES = 1000


@dataclass(frozen=True)
class RangeEnd:
    """An end of the range, at which the readings of a channel are cut off.

    Parameters
    ----------
    reading : float
        The channel's largest or least reading.
    upper : bool
        Whether it is the largest.
    rows : int
        How many readings stand there.
    """

    reading: float
    upper: bool
    rows: int

    def beyond(self, readings: FloatArray) -> BoolArray:
        """Return which readings stand there."""
        return readings >= self.reading if self.upper else readings <= self.reading


def range_ends(values: FloatArray) -> tuple[RangeEnd, ...]:
    """Return the ends of its range at which a channel is cut off.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The channel, as read.

    Returns
    -------
    tuple of RangeEnd
        None, one or two.
    """
    low, high = float(values.min()), float(values.max())
    if low == high:
        return ()
    found = []
    for level, upper in ((low, False), (high, True)):
        at = values == level
        rows = int(np.count_nonzero(at))
        if rows < LEAST_ROWS:
            continue
        steps = np.abs(np.diff(values))
        step = float(np.min(steps[steps > 0.0]))
        off = np.abs(values - level)
        beside = off[(off > 0.0) & (off <= NEAR_STEPS * step)] / step
        pieces = _pieces(values)
        coarse = float(np.median(np.abs(np.diff(pieces, n=2)))) <= NOISY_STEPS * step
        is_cut_off = _plateaus if coarse else _piled_up
        elsewhere = pieces[np.all(pieces != level, axis=1)]
        if is_cut_off(values, intervals_where(at), beside, step) and _is_noisy(elsewhere):
            found.append(RangeEnd(level, upper, rows))
    return tuple(found)


def _pieces(values: FloatArray) -> FloatArray:
    """Return some short pieces of a signal, one a row, spread evenly."""
    reach = NOISE_ORDER + 2
    starts = np.arange(0, values.size - reach + 1, 1 + values.size // MOST_PIECES)
    return np.asarray(values[starts[:, None] + np.arange(reach)])


def _is_noisy(pieces: FloatArray) -> bool:
    """Return whether a signal has noise, be it of rounding; so has one of which nothing is left."""
    less = np.diff(pieces, n=NOISE_ORDER, axis=1)
    more = np.diff(less, axis=1)
    return not less.size or float(np.median(np.abs(more))) > float(np.median(np.abs(less)))


def _piled_up(values: FloatArray, runs: IntArray, beside: FloatArray, step: float) -> bool:
    """Return whether so many readings stand at the extreme of a noisy signal by no chance.

    ``runs`` are the runs of rows at the extreme, ``beside`` is how far those are from it that are
    near, in steps of the resolution.
    """
    long = runs[:, 1] - runs[:, 0] >= LONG_PLATEAU_ROWS
    if np.any(_goes_on(values, runs, step) & long):
        return True
    runs = runs[_led_to(values, runs)]
    lengths = runs[:, 1] - runs[:, 0]
    next_to_it = np.count_nonzero(beside <= NEXT_STEPS)
    if lengths.sum() < PILE * max(beside.size / NEAR_STEPS, next_to_it / NEXT_STEPS):
        return False
    ways = np.unique(values[runs[:, 0] - 1] + 1j * values[runs[:, 1]]).size
    return ways >= (WAYS if np.any(lengths > 1) else WAYS_OF_SINGLE_ROWS)


def _plateaus(values: FloatArray, runs: IntArray, beside: FloatArray, step: float) -> bool:
    """Return whether a signal of little noise is cut off where it stands at its extreme."""
    if beside.size >= np.sum(runs[:, 1] - runs[:, 0]):
        return False
    runs = runs[runs[:, 1] - runs[:, 0] >= 2]
    runs = runs[_goes_on(values, runs, step)]
    lengths = runs[:, 1] - runs[:, 0]
    several = len(runs) >= LEAST_PLATEAUS and np.any(lengths >= LONG_ROWS)
    if lengths.sum() < LEAST_ROWS or not (several or np.any(lengths >= LONG_PLATEAU_ROWS)):
        return False
    still = equal_runs(values, LONG_ROWS)
    level = values[still[:, 0]]
    still = still[(level > values.min()) & (level < values.max())]
    return int(np.count_nonzero(_goes_on(values, still, step))) <= ELSEWHERE * len(runs)


def _led_to(values: FloatArray, runs: IntArray) -> BoolArray:
    """Return which runs no leap leads to or from, as it does where a channel drops out."""
    inside, both_sides = _beside(values, runs)
    led = inside.copy()
    for beside in both_sides:
        jump = np.abs(beside[:, 0] - values[runs[inside, 0]])
        led[inside] &= jump <= LEAP * np.ptp(beside, axis=1)
    return led


def _goes_on(values: FloatArray, runs: IntArray, step: float) -> BoolArray:
    """Return at which runs of equal readings the signal would go on, on either side."""
    inside, both_sides = _beside(values, runs)
    level, lengths = values[runs[inside, 0]], runs[inside, 1] - runs[inside, 0]
    away = np.clip((lengths - 1) // 2, 1, REACH) - 1
    good = np.ones(level.size, dtype=np.bool_)
    straight = np.ones(level.size, dtype=np.bool_)
    for beside in both_sides:
        off = beside - level[:, None]
        good &= np.abs(off[np.arange(level.size), away]) > RISE_STEPS * step
        limit = STRAIGHT * np.abs(off[:, :1])
        straight &= np.all(np.abs(np.diff(beside, axis=1) - off[:, :1]) <= limit, axis=1)
    goes_on = _led_to(values, runs)
    goes_on[inside] &= good & ~straight
    return goes_on


def _beside(values: FloatArray, runs: IntArray) -> tuple[BoolArray, tuple[FloatArray, FloatArray]]:
    """Return which runs have rows enough on either side, and their readings, the nearest first."""
    inside = (runs[:, 0] >= REACH) & (runs[:, 1] + REACH <= values.size)
    start, stop = runs[inside].T
    reach = np.arange(REACH)
    return inside, (values[start[:, None] - 1 - reach], values[stop[:, None] + reach])
