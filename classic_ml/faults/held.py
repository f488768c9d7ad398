"""Channels that were recorded at a lower rate and held: each value stands for several rows.

Where the columns of two loggers were merged on the clock of the faster one, every value of the
slower repeats until the next one comes, and is late by half of that on average. A channel that
moves by many steps of its resolution at once stands still right behind such a step again and again;
one that is slow or coarse stands still too, but not like that.
"""

from __future__ import annotations

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.faults.findings import Finding
from classic_ml.records import Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["check_held", "held_rows", "times_held"]

# In steps of the resolution, and half a one, so that no rounding decides. Two readings of a noise
# that makes such a step are alike by chance in one case of fourteen at most.
LARGE_STEPS = 8.5
# A value that is arrived at and left like that stands for two rows or more in so many cases: in 7 %
# at most on 28 records of three rigs, in 16 % and more where 800 values a second make 1000 rows.
HELD_SHARE = 0.15
FEWEST_VALUES = 50
# A factor is a whole number where nearly all values stand for so many rows.
WHOLE_SHARE = 0.9
# Where plane 31 is later than plane 25 by 0.5, 1 and 1.5 ms, τ of 18 ms comes out 3 to 4, 6 to 9
# and 9 to 14 ms too large on three records; where all pressures are late alike it moves by its
# standard error at most. This much moves it by a twentieth.
LATE_S = 0.15e-3
# Averages of one logger differ by nearly as much, where few values move by large steps.
LATE_ROWS = 0.48


def held_rows(values: FloatArray) -> float:
    """Return how many rows each value of a channel stands for.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The channel, as read.

    Returns
    -------
    float
        1 for one that is not held or that moves too little to say; an average where the rates of
        the two recorders have no whole ratio.
    """
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    # Less than that share of rows without a change is in no channel that is held.
    if changes.size < FEWEST_VALUES or changes.size > (1.0 - 0.5 * HELD_SHARE) * values.size:
        return 1.0
    sizes, lengths = np.abs(values[changes] - values[changes - 1]), np.diff(changes)
    common = int(np.gcd.reduce(lengths))
    if common > 1:
        return float(common)
    large = sizes > LARGE_STEPS * sizes.min()
    lengths = lengths[large[:-1] & large[1:]]
    if lengths.size < FEWEST_VALUES or np.mean(lengths > 1) < HELD_SHARE:
        return 1.0
    usual = int(np.argmax(np.bincount(lengths)))
    if usual > 1 and np.mean(lengths % usual == 0) >= WHOLE_SHARE:
        return float(usual)
    return float(np.mean(lengths))


def check_held(record: Record, test: TestDescription) -> list[Finding]:
    """Return the pressures that are held alike, and the thermocouples that are held.

    Raises
    ------
    InputError
        When one pressure is later than another by so much that τ would be wrong.
    """
    pressures = {p.name: held_rows(record[p.name]) for p in test.pressures}
    couples = {c.name: held_rows(record[c.name]) for c in test.temperatures}
    late, early = (
        max(pressures, key=pressures.__getitem__),
        min(pressures, key=pressures.__getitem__),
    )
    later = pressures[late] - pressures[early]
    # A value that is followed by the same one counts as one that stands longer, on average.
    averages = not any(rows.is_integer() for rows in pressures.values())
    one_logger = averages and pressures[late] < 1.3 * pressures[early]
    if later > max(LATE_ROWS, 2.0 * LATE_S * record.sample_rate_hz) and not one_logger:
        raise InputError(
            f"{record.source}: channel {late}",
            expected="pressures that were recorded at one rate",
            found=f"each value {times_held(pressures[late])} there, "
            f"{times_held(pressures[early])} in {early}: recorded at a lower rate and held",
            remedy="what is held is late, which makes τ wrong: keep the rows alone in which it "
            "has a new value, or leave its pair out of test.toml",
        )
    found = []
    for held, effect in (
        (pressures, "every row counts as a reading of its own"),
        (couples, "the temperatures are late by half of that"),
    ):
        name = max(held, key=held.__getitem__, default="")
        if name and held[name] > 1.0:
            words = (
                f"channel {name}: each value is there {times_held(held[name])}: recorded at "
                f"{record.sample_rate_hz / held[name]:.3g} samples a second and held? {effect}: "
                "keep the rows alone in which there is a new value"
            )
            found.append(Finding("held", words, name))
    return found


def times_held(rows: float) -> str:
    """Return in words how often each value is there, of :func:`held_rows`."""
    if rows.is_integer():
        return "once" if rows == 1.0 else f"{rows:.0f} times"
    return f"{rows:.3g} times on average"
