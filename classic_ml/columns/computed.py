"""Columns that take no room: their rows are computed from other columns when they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ComputedColumn", "as_column", "as_stored", "computed", "widened"]

FloatArray = NDArray[np.float64]


class ComputedColumn:
    """A column of float64 that can be cut into rows as an array can, and is read-only.

    Parameters
    ----------
    n_rows : int
        Its length.
    rows : callable
        ``rows(part)`` returns the values of a slice from one row to another, a new array or one
        that nobody writes to.
    stored : ndarray of shape (n_rows,), optional
        The same numbers as they are stored, where they are in a narrower type.
    """

    ndim = 1
    dtype = np.dtype(np.float64)

    def __init__(
        self,
        n_rows: int,
        rows: Callable[[slice], FloatArray],
        stored: NDArray[Any] | None = None,
    ) -> None:
        self.stored = stored
        self.size = n_rows
        self.shape = (n_rows,)
        self._rows = rows

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, key: int | slice) -> Any:
        """Return one value, or those of a slice without gaps as an array."""
        if isinstance(key, slice):
            start, stop, step = key.indices(self.size)
            if step == 1:
                return self._read_only(slice(start, max(start, stop)))
            return self._read_only(slice(0, self.size))[key]
        row = range(self.size)[key]
        return self._rows(slice(row, row + 1))[0]

    def _read_only(self, rows: slice) -> FloatArray:
        values = self._rows(rows)
        # As the rows of any column of a record: compiled loops are made for one kind of array.
        values.setflags(write=False)
        return values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the whole column."""
        values = self._rows(slice(0, self.size))
        return np.array(values, dtype=dtype, copy=copy)


def computed(n_rows: int, rows: Callable[[slice], FloatArray]) -> FloatArray:
    """Return a column that is computed where it is asked for.

    Parameters
    ----------
    n_rows : int
        Its length.
    rows : callable
        As for :class:`ComputedColumn`.

    Returns
    -------
    ndarray of shape (n_rows,)
        In truth a :class:`ComputedColumn`: whoever works block by block sees no difference.
    """
    return cast("FloatArray", ComputedColumn(n_rows, rows))


def as_column(values: ArrayLike) -> FloatArray:
    """Return values as a column of float64, without computing one that is computed.

    Parameters
    ----------
    values : array_like of shape (n,)
        The values.
    """
    given: object = values
    if isinstance(given, ComputedColumn):
        return cast("FloatArray", given)
    return np.asarray(values, dtype=np.float64)


def widened(column: NDArray[Any]) -> FloatArray:
    """Return a column of a narrow type as one of float64.

    Parameters
    ----------
    column : ndarray of shape (n,)
        Whole numbers, say; a column of float64 is returned as it is.
    """
    if column.dtype == np.float64:
        return column
    wide = ComputedColumn(column.size, lambda rows: column[rows].astype(np.float64), column)
    return cast("FloatArray", wide)


def as_stored(column: NDArray[Any]) -> NDArray[Any]:
    """Return a column in the type in which its numbers are stored, for what gives the same in any.

    Parameters
    ----------
    column : ndarray of shape (n,)
        A column, one of :func:`widened` say.
    """
    given: object = column
    if isinstance(given, ComputedColumn) and given.stored is not None:
        return given.stored
    return column
