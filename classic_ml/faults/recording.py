"""What a whole record shows of how it was recorded: converter, rates, rows written twice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from classic_ml.description import TestDescription
from classic_ml.faults.converter_range import CodeRange, codes_seen
from classic_ml.faults.held import check_held
from classic_ml.faults.repeated_rows import repeated_rows
from classic_ml.faults.standstill import Tally
from classic_ml.records import Record

__all__ = ["how_recorded"]


def how_recorded(record: Record, test: TestDescription, found: Mapping[str, Tally]) -> CodeRange:
    """Look for what is wrong with all readings of a channel, or with all channels at once.

    Parameters
    ----------
    record : Record
        As read, the whole of it.
    test : TestDescription
        Its channels.
    found : mapping of str to Tally
        Of all channels.

    Returns
    -------
    CodeRange
        By what converter its codes are to be judged, and all flags.

    Raises
    ------
    InputError
        When some pressures were recorded at a lower rate than others.
    """
    held = check_held(record, test, found)
    codes = codes_seen(record, test, found)
    return replace(codes, flags=(*codes.flags, *held, *repeated_rows(record, test)))
