"""Readings cut off at an end of a channel's own range, whatever its unit, and readings held.

A transducer, an amplifier or the software behind it holds what is beyond its range at the last
value that it can give. In a channel of a physical unit nothing states where that is, but it shows:
readings pile up bit-equal at the extreme, many times more than just short of it, and the channel
arrives there and leaves at full speed, each time in another way. A slow or coarse signal does not
leave its own peak like that, the tail of a noisy one has fewer readings at its extreme than beside
it, and one that repeats itself exactly, as a simulation may, does so in one way.

A channel that was recorded at a lower rate and held stands still too: where the columns of two
loggers were merged on the clock of the faster one, every value of the slower repeats until the next
one comes, and is late by half of that on average. Where it moves by many steps of its resolution at
once, it stands still right behind such a step again and again.
"""

from __future__ import annotations

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record
from surge_core.errors import InputError
from surge_core.segments import intervals_where
from surge_core.types import BoolArray, FloatArray, IntArray

# In steps of the resolution, and half a one, so that no rounding decides. Two readings of a noise
# that makes such a step are alike by chance in one case of fourteen at most.
LARGE_STEPS = 8.5
FEWEST_VALUES = 50
# A channel is held where nearly all values stand for a multiple of so many rows.
WHOLE_SHARE = 0.9
# Where plane 31 is later than plane 25 by 0.5, 1 and 1.5 ms, τ of 18 ms comes out 3 to 4, 6 to 9
# and 9 to 14 ms too large on three records; where all pressures are late alike it moves by its
# standard error at most. This much moves it by a twentieth.
LATE_S = 0.15e-3


def held_rows(values: FloatArray) -> int:
    """Return how many rows each value of a channel stands for: 1 where it moves too little."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    # Of a channel that is held hardly more than half of the rows bring a new value.
    if not FEWEST_VALUES < changes.size <= 0.55 * values.size:
        return 1
    sizes, lengths = np.abs(values[changes] - values[changes - 1]), np.diff(changes)
    common = int(np.gcd.reduce(lengths))
    if common > 1:
        return common
    large = sizes > LARGE_STEPS * sizes.min()
    lengths = lengths[large[:-1] & large[1:]]
    if lengths.size < FEWEST_VALUES:
        return 1
    usual = int(np.argmax(np.bincount(lengths)))
    return usual if np.mean(lengths % usual == 0) >= WHOLE_SHARE else 1


def check_held(record: Record, test: TestDescription) -> None:
    """Refuse a record in which held pressures are late against others, which makes τ wrong."""
    rows = {probe.name: held_rows(record[probe.name]) for probe in test.pressures}
    late, early = max(rows, key=rows.__getitem__), min(rows, key=rows.__getitem__)
    if rows[late] - rows[early] > 2.0 * LATE_S * record.sample_rate_hz:
        raise InputError(
            f"{record.source}: channel {late}",
            expected="pressures that were recorded at one rate",
            found=f"each value {rows[late]} times there, {rows[early]} in {early}: recorded at a "
            "lower rate and held",
            remedy="what is held is late, which makes τ wrong: keep the rows alone in which it "
            "has a new value, or leave its pair out of test.toml",
        )


# Rows at which a channel must be seen to be cut off.
LEAST_ROWS = 6
# Bit-equal readings at the extreme for each of the eight steps short of it, in steps of the
# resolution and half a one, so that no rounding decides.
PILE, NEAR_STEPS = 4.0, 8.5
# So many ways in which the signal gets there and leaves, more if it never stands still there, or a
# plateau of so many rows: an overload at the inception of surge.
WAYS, WAYS_OF_SINGLE_ROWS, LONG_ROWS = 5, 12, 8
# Steps of the resolution by which the first row and the second beside a plateau are off it, and the
# same where the second difference is usually less than so many: a slow or coarse signal stays near
# its peak.
RISES, SLOW_RISES, NOISY_STEPS = (1.5, -1.0), (5.5, 5.5), 2.5
# A jump of so many times what the four rows before it moved is a dropout.
REACH, LEAP = 4, 2.0


def range_ends(values: FloatArray) -> tuple[float, ...]:
    """Return the readings at which a channel is cut off: the least, the largest, both or none.

    None of a channel that is held, which stands still everywhere.
    """
    reached = {level: values == level for level in (float(values.min()), float(values.max()))}
    reached = {level: at for level, at in reached.items() if np.count_nonzero(at) >= LEAST_ROWS}
    steps = np.diff(values)
    if not reached or not steps.any() or held_rows(values) > 1:
        return ()
    step = float(np.min(np.abs(steps[steps != 0.0])))
    # Counted, which takes a third of the time of a median.
    small = np.count_nonzero(np.abs(np.diff(steps)) <= NOISY_STEPS * step)
    rises = step * np.array(SLOW_RISES if 2 * small >= steps.size else RISES)
    found = []
    for level, at in reached.items():
        off = np.abs(values - level)
        beside = np.count_nonzero((off > 0.0) & (off <= NEAR_STEPS * step))
        runs = intervals_where(at)
        runs = runs[_left_at_speed(values, runs, rises)]
        lengths = runs[:, 1] - runs[:, 0]
        if lengths.sum() < max(LEAST_ROWS, PILE * beside / NEAR_STEPS):
            continue
        ways = np.unique(values[runs[:, 0] - 1] + 1j * values[runs[:, 1]]).size
        needed = WAYS if np.any(lengths > 1) else WAYS_OF_SINGLE_ROWS
        if ways >= needed or np.any(lengths >= LONG_ROWS):
            found.append(level)
    return tuple(found)


def _left_at_speed(values: FloatArray, runs: IntArray, rises: FloatArray) -> BoolArray:
    """Return which runs of equal readings are arrived at and left by some rises, by no leap."""
    good = (runs[:, 0] >= REACH) & (runs[:, 1] + REACH <= values.size)
    for first, way in ((runs[:, 0] - 1, -1), (runs[:, 1], 1)):
        beside = values[np.clip(first[:, None] + way * np.arange(REACH), 0, values.size - 1)]
        off = np.abs(beside - values[runs[:, :1]])
        good &= np.all(off[:, :2] > rises, axis=1) & (off[:, 0] <= LEAP * np.ptp(beside, axis=1))
    return np.asarray(good)
