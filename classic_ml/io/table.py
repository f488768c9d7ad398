"""What every reader of raw records returns: named columns of numbers, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from surge_core.errors import InputError

__all__ = [
    "BLOCK_ROWS",
    "MINIMUM_ROWS",
    "TIME_COLUMN",
    "Columns",
    "RawFile",
    "Sampling",
    "check_unique",
    "fault_of",
]

TIME_COLUMN = "time_s"
# The same floor as a series file: less is not a record of anything.
MINIMUM_ROWS = 100
# Rows that a reader takes at once: 40 MB of 20 channels.
BLOCK_ROWS = 1 << 18
LONGEST_CAUSE = 160

# Some rows of a table, one array of numbers a column.
Columns = tuple[NDArray[Any], ...]


@dataclass(frozen=True)
class Sampling:
    """When a channel was sampled, where the file states that beside it (TDMS).

    Parameters
    ----------
    start_s : float
        Time of its first row, from the date of the file's first channel.
    step_s : float
        From row to row.
    """

    start_s: float
    step_s: float


@dataclass(frozen=True)
class RawFile:
    """A raw record on disk.

    Parameters
    ----------
    source : str
        The file.
    names : tuple of str
        Column names as the file has them, that of the clock among them.
    read : callable
        ``read(names, rows)`` yields some of the columns in file order, at most about so many rows
        at once, each time from the first row on: a tuple of one array a column.
    units : mapping of str to str
        Units that the file itself states, by column.
    n_rows : int, optional
        Rows, where the file says so without being read through.
    clock : str
        What the clock is, where it is no column of times: "seconds from the first sample at
        2024-05-01T12:00:00"; empty otherwise.
    unusable : mapping of str to str
        Columns that are none of this table, and why: text, another length, no vector.
    stamps : mapping of str to str
        Columns that are dates in the file and seconds here, and what they count from.
    sampled : mapping of str to Sampling
        By column, when it was sampled, where the file states that for each.
    other_groups : mapping of str to str
        Groups of the file that are none of this table, and what is in them.
    """

    source: str
    names: tuple[str, ...]
    read: Callable[[tuple[str, ...], int], Iterator[Columns]]
    units: Mapping[str, str] = field(default_factory=dict)
    n_rows: int | None = None
    clock: str = ""
    unusable: Mapping[str, str] = field(default_factory=dict)
    stamps: Mapping[str, str] = field(default_factory=dict)
    sampled: Mapping[str, Sampling] = field(default_factory=dict)
    other_groups: Mapping[str, str] = field(default_factory=dict)

    def blocks(
        self, names: tuple[str, ...] | None = None, rows: int = BLOCK_ROWS
    ) -> Iterator[Columns]:
        """Yield columns of the file block by block.

        Parameters
        ----------
        names : tuple of str, optional
            Which; all of them without.
        rows : int
            About how many rows at once.

        Raises
        ------
        InputError
            Where the file cannot be read further.
        """
        try:
            yield from self.read(self.names if names is None else names, rows)
        except Exception as error:
            raise fault_of(error, self.source, "rows that can be read") from None


def fault_of(error: Exception, source: str, what: str) -> Exception:
    """Return the refusal of a file over which the library that reads such files stumbles.

    Parameters
    ----------
    error : Exception
        What the library raised; an InputError says already what is wrong.
    source : str
        The file.
    what : str
        What it should be.
    """
    if isinstance(error, InputError | MemoryError):
        return error
    cause = " ".join(str(error).split()) or type(error).__name__
    return InputError(
        source,
        expected=what,
        found=f"what cannot be read ({cause[:LONGEST_CAUSE]})",
        remedy="was it cut short? copy it again from where it was recorded",
    )


def check_unique(source: str, names: tuple[str, ...]) -> None:
    """Refuse doubled or empty column names."""
    seen: set[str] = set()
    for number, name in enumerate(names, start=1):
        if not name:
            raise InputError(
                source,
                expected="a name for every column",
                found=f"an empty one, that of column {number} of {len(names)}",
                remedy="does every row end with a comma?",
            )
        if name in seen:
            raise InputError(
                f"{source}: channel {name}",
                expected="each column once",
                found=f"it {names.count(name)} times",
            )
        seen.add(name)
