"""Channels that were recorded at a lower rate and held: each value stands for several rows.

Where the columns of two loggers were merged on the clock of the faster one, every value of the
slower repeats until the next one comes, and is late by half of that on average. A channel that
moves by many steps of its resolution at once stands still right behind such a step again and again;
one that is slow or coarse stands still too, but not like that.
"""

from __future__ import annotations

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

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
