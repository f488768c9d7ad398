"""What every reader of raw records hands over: a checked table of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from classic_ml.errors import InputError
from classic_ml.records import FloatArray

__all__ = ["MINIMUM_ROWS", "TIME_COLUMN", "ColumnCheck", "RawFile", "RawTable"]

# Takes the name of the file and its column names, and raises InputError for a wrong column.
ColumnCheck = Callable[[str, tuple[str, ...]], None]

TIME_COLUMN = "time_s"
# The same floor as a series file: less is not a record of anything.
MINIMUM_ROWS = 100


@dataclass(frozen=True)
class RawFile:
    """A raw record on disk, read a number of rows at a time.

    Parameters
    ----------
    source : str
        The file.
    names : tuple of str
        Column names as the file has them, ``time_s`` or what stands for it among them.
    chunks : callable
        ``chunks(rows)`` yields float64 arrays of shape (at most ``rows``, n_columns) in file
        order, each time anew from the first row.
    units : mapping of str to str
        Units that the file itself states, by column; a column without one is not in it.
    n_rows : int, optional
        Rows, where the file says so without being read through.
    """

    source: str
    names: tuple[str, ...]
    chunks: Callable[[int], Iterator[FloatArray]]
    units: Mapping[str, str] = field(default_factory=dict)
    n_rows: int | None = None


@dataclass(frozen=True)
class RawTable:
    """Columns of one raw record, in file order.

    Parameters
    ----------
    source : str
        The file.
    names : tuple of str
        Column names; ``time_s`` among them.
    values : ndarray of shape (n_rows, n_columns)
        The numbers, as float64 whatever the file stored: arithmetic on 16-bit counts overflows.

    Raises
    ------
    InputError
        When a name is doubled or missing, rows are too few, or a value is not finite.
    """

    source: str
    names: tuple[str, ...]
    values: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", np.asarray(self.values, dtype=np.float64))
        check_names(self.source, self.names)
        if self.values.shape[0] < MINIMUM_ROWS:
            raise InputError(
                self.source,
                expected=f"at least {MINIMUM_ROWS} rows",
                found=f"{self.values.shape[0]}",
            )
        bad = np.argwhere(~np.isfinite(self.values))
        if bad.size:
            row, column = bad[0]
            raise InputError(
                f"{self.source}: channel {self.names[column]}",
                expected="a finite number in every row",
                found=f"{self.values[row, column]} in row {row + 1}"
                + (f" and {len(bad) - 1} more" if len(bad) > 1 else ""),
                remedy="cut the record there or repair the channel",
            )

    def column(self, name: str) -> FloatArray:
        """Return one column."""
        values: FloatArray = self.values[:, self.names.index(name)]
        return values


def check_names(source: str, names: tuple[str, ...]) -> None:
    """Refuse doubled or empty column names and a table without a clock."""
    for name in names:
        if not name:
            raise InputError(source, expected="a name for every column", found="an empty one")
        if names.count(name) > 1:
            raise InputError(
                f"{source}: channel {name}",
                expected="each column once",
                found=f"it {names.count(name)} times",
            )
    if TIME_COLUMN not in names:
        raise InputError(
            source,
            expected=f"a table with a header and a column {TIME_COLUMN}",
            found="the columns " + _shortened(names),
        )


def _shortened(names: tuple[str, ...]) -> str:
    text = ", ".join(names)
    return text if len(text) <= 120 else text[:117] + "..."
