"""Where the codes of a record end, if not where test.toml has it.

Pressures come from ratios of codes, whatever the number of bits; but a code counts as clipped at
the ends of the range alone. Where that is stated too wide, clipped readings would pass for sound
ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.columns.workspace import blocks
from classic_ml.description import TestDescription
from classic_ml.faults.plateaus import End, cut_off_ends
from classic_ml.faults.standstill import Tally
from classic_ml.records import Record

__all__ = ["CodeRange", "codes_seen"]

# A converter of less bits is no more in use.
FEWEST_BITS = 6
# Codes that are written to the left in a wider word go by such steps.
UNUSED_BITS = frozenset(2.0**n for n in range(17))
# Readings at the largest code of all that a smaller converter can give: the largest one of a wider
# range is that by chance in one case of some thousands, and is not there again and again.
FEWEST_READINGS = 3
# Two channels end at one code by chance; but not where both are cut off.
FEWEST_CHANNELS = 2


@dataclass(frozen=True)
class CodeRange:
    """What the codes of a record show of their converter.

    Parameters
    ----------
    test : TestDescription
        With the number of bits by which its codes are to be judged.
    ends : mapping of str to tuple of End
        By channel, codes within the range at which its readings are cut off.
    flags : tuple of str
        What is not as test.toml has it.
    """

    test: TestDescription
    ends: Mapping[str, tuple[End, ...]]
    flags: tuple[str, ...]


def codes_seen(record: Record, test: TestDescription, found: Mapping[str, Tally]) -> CodeRange:
    """Compare the codes of a record with the range of its converter.

    Parameters
    ----------
    record : Record
        As read.
    test : TestDescription
        Its converter.
    found : mapping of str to Tally
        Of all channels.
    """
    names = [p.name for p in test.pressures if p.record_unit == "count"]
    if test.converter is None or not names:
        return CodeRange(test, {}, ())
    stated, top = test.converter.bits, max(found[name].high for name in names)
    step = min(found[name].least_step for name in names)
    there = [name for name in names if found[name].high == top]
    ends_at = [n for n in range(FEWEST_BITS, stated + 1) if top == 2.0**n - step]
    bits = ends_at[0] if ends_at and step in UNUSED_BITS else None
    # Nothing is to be said where codes end as stated.
    known = top == test.adc.top_code or bits is None
    n_there = 0 if known else _readings(record, there, top)
    # The steady level of one channel may be any code.
    alone = len(there) < FEWEST_CHANNELS
    if alone and n_there and _end(record, there[0], found[there[0]], upper=True) is None:
        n_there = 0
    if bits is None or n_there < FEWEST_READINGS:
        return CodeRange(test, *_common_ends(record, test, names, found))
    by = "" if step == 1.0 else f", and all go by {step:.0f}"
    flag = (
        f"no code is above {top:.0f}, at which {n_there} readings of {_named(there)} stand{by}: is "
        f"the converter one of {bits - round(np.log2(step))} bits? [adc] of {test.source} has "
        f"{stated}; they count as clipped"
    )
    if step == 1.0:
        judged = replace(test, converter=replace(test.converter, bits=bits))
        return CodeRange(judged, {}, (flag,))
    return CodeRange(test, {name: (End(top, True, n_there, 1),) for name in there}, (flag,))


def _readings(record: Record, names: list[str], code: float) -> int:
    """Return how many readings of some channels are one code."""
    n = 0
    for rows in blocks(record.n_samples):
        n += sum(int(np.count_nonzero(record[name][rows] == code)) for name in names)
        record.workspace.release()
    return n


def _common_ends(
    record: Record, test: TestDescription, names: list[str], found: Mapping[str, Tally]
) -> tuple[dict[str, tuple[End, ...]], tuple[str, ...]]:
    """Return the codes within the range at which several channels are cut off, and flags."""
    ends: dict[str, tuple[End, ...]] = {}
    flags = []
    for upper in (False, True):
        by_code: dict[float, list[str]] = {}
        for name in names:
            code = found[name].high if upper else found[name].low
            if 0.0 < code < test.adc.top_code:
                by_code.setdefault(code, []).append(name)
        for code, alike in by_code.items():
            if len(alike) < FEWEST_CHANNELS:
                continue
            here = {name: _end(record, name, found[name], upper=upper) for name in alike}
            cut = {name: end for name, end in here.items() if end is not None}
            if len(cut) >= FEWEST_CHANNELS:
                ends |= {name: (*ends.get(name, ()), end) for name, end in cut.items()}
                flags.append(
                    f"{_named(list(cut))} are cut off at code {code:.0f} alike, within the range "
                    f"of 0 to {test.adc.top_code} that [adc] of {test.source} has: do its codes "
                    "end there? they count as clipped"
                )
    return ends, tuple(flags)


def _end(record: Record, name: str, tally: Tally, *, upper: bool) -> End | None:
    ends = cut_off_ends(
        record[name], tally.low, tally.high, tally.least_step, workspace=record.workspace
    )
    return next((end for end in ends if end.upper == upper), None)


def _named(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
