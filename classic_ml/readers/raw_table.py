"""What every reader of raw records hands over: columns of numbers, a number of rows at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "MINIMUM_ROWS",
    "TIME_COLUMN",
    "Columns",
    "RawFile",
    "Sampling",
    "arrow_file",
    "cannot_be_read",
    "check_unique",
    "in_one_line",
    "rebatched",
]

TIME_COLUMN = "time_s"
# The same floor as a series file: less is not a record of anything.
MINIMUM_ROWS = 100
LONGEST_LABEL = 60

# Some rows of a table, one array of numbers a column.
Columns = tuple[NDArray[Any], ...]


@dataclass(frozen=True)
class Sampling:
    """When a channel was sampled, as the file states it beside the channel.

    Parameters
    ----------
    start_ns : int or None
        Date of its first row, in nanoseconds of any one epoch; None where the file has none.
    offset_s : float
        Of the first row behind that date.
    step_s : float
        From row to row.
    """

    start_ns: int | None
    offset_s: float
    step_s: float

    def later_s(self, other: Sampling) -> float:
        """Return by how much the first row is later than that of another channel."""
        dated = self.start_ns is not None and other.start_ns is not None
        # The difference first: a date in nanoseconds is no double.
        whole_ns = (self.start_ns or 0) - (other.start_ns or 0) if dated else 0
        return whole_ns * 1e-9 + (self.offset_s - other.offset_s)


@dataclass(frozen=True)
class RawFile:
    """A raw record on disk, read a number of rows at a time.

    Parameters
    ----------
    source : str
        The file.
    names : tuple of str
        Column names as the file has them, ``time_s`` or what stands for it among them.
    columns : callable
        ``columns(rows)`` yields at most so many rows at once in file order, each time anew from the
        first row: a tuple of one array a column, of the whole numbers or the float64 of the file.
    units : mapping of str to str
        Units that the file itself states, by column; a column without one is not in it.
    n_rows : int, optional
        Rows, where the file says so without being read through.
    clock : str
        What the clock is, where it is no column of times: "from the sample rate", "seconds from
        the first sample at 2024-05-01T12:00:00"; empty otherwise.
    unusable : mapping of str to str
        Columns that are none of this table, and why: text, another length, no vector. One of
        another group has the group before its name.
    stamps : mapping of str to str
        Columns that are dates in the file and seconds here, and what they count from.
    sampled : mapping of str to Sampling
        By column, when it was sampled, where the file states that for each.
    other_groups : mapping of str to str
        Groups of the file that are none of this table, and what is in them.
    selected : callable, optional
        ``selected(names)`` is as `columns`, of some of them; the others are not looked at.
    """

    source: str
    names: tuple[str, ...]
    columns: Callable[[int], Iterator[Columns]]
    units: Mapping[str, str] = field(default_factory=dict)
    n_rows: int | None = None
    clock: str = ""
    unusable: Mapping[str, str] = field(default_factory=dict)
    stamps: Mapping[str, str] = field(default_factory=dict)
    sampled: Mapping[str, Sampling] = field(default_factory=dict)
    other_groups: Mapping[str, str] = field(default_factory=dict)
    selected: Callable[[tuple[str, ...]], Callable[[int], Iterator[Columns]]] | None = None

    def chunks(self, rows: int) -> Iterator[FloatArray]:
        """Yield the rows as float64 arrays of shape (at most ``rows``, n_columns).

        Parameters
        ----------
        rows : int
            How many at once.
        """
        for columns in self.columns(rows):
            # Column by column in memory, as they are taken out again.
            yield np.array(columns, dtype=np.float64).T if columns else np.empty((0, 0))

    def only(self, names: tuple[str, ...]) -> RawFile:
        """Return the same file without the columns that nobody asks for, where it can be read so.

        Parameters
        ----------
        names : tuple of str
            Columns that are asked for.
        """
        kept = tuple(name for name in self.names if name in names)
        if self.selected is None or kept == self.names:
            return self
        return replace(self, names=kept, columns=self.selected(kept))


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


def in_one_line(label: str) -> str:
    """Return a label of a file as a sentence can hold it."""
    return " ".join(label.split())[:LONGEST_LABEL]


def cannot_be_read(file: Path, what: str, cause: str) -> InputError:
    """Return the refusal of a file over which the library that reads such files stumbles.

    Parameters
    ----------
    file : path
        The file.
    what : str
        What it should be.
    cause : str
        What the library says.
    """
    return InputError(
        str(file),
        expected=what,
        found="one that was cut short"
        if "truncated file" in cause
        else f"what cannot be read ({cause})",
        remedy="was it cut short? copy it again from where it was recorded",
    )


def arrow_file(file: Path) -> Any:
    """Open a file for pyarrow, which takes a name that is not UTF-8 as bytes alone."""
    import pyarrow as pa

    return pa.OSFile(os.fsencode(file))


def rebatched(pieces: Iterator[Columns], rows: int) -> Iterator[Columns]:
    """Yield the rows of pieces of any size ``rows`` at once, the last of fewer.

    Where the pieces end in an error, the rows before it come first.
    """
    kept: list[Columns] = []
    n_kept = 0
    fault: InputError | None = None
    while True:
        try:
            piece = next(pieces, None)
        except InputError as error:
            piece, fault = None, error
        if piece is None:
            break
        n_rows = piece[0].size if piece else 0
        if n_rows:
            kept.append(piece)
            n_kept += n_rows
        if n_kept < rows:
            continue
        joined = _joined(kept)
        whole = n_kept - n_kept % rows
        for start in range(0, whole, rows):
            yield tuple(column[start : start + rows] for column in joined)
        n_kept -= whole
        kept = [tuple(column[whole:] for column in joined)] if n_kept else []
    if n_kept:
        yield _joined(kept)
    if fault is not None:
        raise fault


def _joined(pieces: list[Columns]) -> Columns:
    """Return the rows of some pieces as one."""
    if len(pieces) == 1:
        return pieces[0]
    return tuple(np.concatenate(parts) for parts in zip(*pieces, strict=True))
