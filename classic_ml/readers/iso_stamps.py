"""Dates with a time of day (ISO 8601) as whole nanoseconds: a date in seconds is no double."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

__all__ = ["Stamps", "stamp_of", "stamps_like"]

_STAMP = re.compile(
    r"(?P<date>[0-9]{4}-[0-9]{2}-[0-9]{2})"
    r"(?:[T ](?P<time>[0-9]{2}(?::[0-9]{2}(?::[0-9]{2}(?:\.(?P<part>[0-9]{1,9}))?)?)?)"
    r"(?P<zone>Z|[+-][0-9]{2}(?::?[0-9]{2})?)?)?"
)
_PER_SECOND = 10**9
_MOST = 2**63 - 1


@dataclass(frozen=True)
class Stamps:
    """A column of dates.

    Parameters
    ----------
    origin_ns : int
        Its first row, in nanoseconds since 1970.
    zoned : bool
        Whether a zone stands behind each date.
    words : str
        What the seconds count from.
    """

    origin_ns: int
    zoned: bool
    words: str

    def seconds(self, cell: str) -> float | None:
        """Return a cell in seconds from the first row; None where it is no such date."""
        found = stamp_of(cell)
        if found is None or found[1] != self.zoned:
            return None
        return (found[0] - self.origin_ns) / _PER_SECOND

    @property
    def arrow_type(self) -> Any:
        """The type as which pyarrow reads the column."""
        import pyarrow as pa

        return pa.timestamp("ns", "UTC") if self.zoned else pa.timestamp("ns")

    def arrow_seconds(self, column: Any) -> Any:
        """Return a column that pyarrow has read in seconds from the first row."""
        import pyarrow as pa

        ticks = column.cast(pa.int64()).to_numpy(zero_copy_only=False)
        return (ticks - self.origin_ns) / _PER_SECOND


def stamp_of(cell: str) -> tuple[int, bool] | None:
    """Return a date as nanoseconds since 1970, and whether it names its zone.

    Parameters
    ----------
    cell : str
        A text.

    Returns
    -------
    tuple of int and bool, or None
        None where the text is no date, or one that 64 bits do not hold.
    """
    match = _STAMP.fullmatch(cell)
    if match is None:
        return None
    part = match["part"] or ""
    whole = (match["time"] or "00").removesuffix(f".{part}" if part else "")
    try:
        moment = datetime.fromisoformat(f"{match['date']}T{whole}{match['zone'] or ''}")
    except ValueError:
        return None
    zoned = moment.tzinfo is not None
    epoch = datetime(1970, 1, 1, tzinfo=UTC if zoned else None)
    ticks = (moment - epoch) // timedelta(seconds=1) * _PER_SECOND + int(part.ljust(9, "0"))
    return (ticks, zoned) if abs(ticks) <= _MOST else None


def stamps_like(cell: str) -> Stamps | None:
    """Return the column of dates whose first cell this is; None where it is no date and time.

    Parameters
    ----------
    cell : str
        The first cell of a column.
    """
    found = stamp_of(cell)
    # A day alone is no clock.
    if found is None or ":" not in cell:
        return None
    return Stamps(*found, f"seconds from the first sample at {cell}")
