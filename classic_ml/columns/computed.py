"""Columns that take no room: their rows are computed from other columns when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from surge_core.types import FloatArray

__all__ = ["ComputedColumn", "as_column", "as_stored", "computed", "is_computed", "widened"]


class ComputedColumn(np.lib.mixins.NDArrayOperatorsMixin):
    """A column that can be cut into rows as an array can, and is read-only.

    Whatever else is done with it is done with an array of all its rows.

    Parameters
    ----------
    n_rows : int
        Its length.
    rows : callable
        ``rows(part)`` returns the values of a slice from one row to another, a new array or one
        that nobody writes to.
    dtype : dtype
        Type of the values.
    stored : ndarray of shape (n_rows,), optional
        The same numbers as they are stored, where they are in a narrower type.
    """

    ndim = 1

    def __init__(
        self,
        n_rows: int,
        rows: Callable[[slice], NDArray[Any]],
        dtype: DTypeLike = np.float64,
        stored: NDArray[Any] | None = None,
    ) -> None:
        self.dtype = np.dtype(dtype)
        self.stored = stored
        self.size = n_rows
        self.shape = (n_rows,)
        self._rows = rows

    def __len__(self) -> int:
        return self.size

    def __repr__(self) -> str:
        return f"<column of {self.size} rows, {self.dtype}, computed when it is read>"

    def __iter__(self) -> Iterator[Any]:
        """Go through the values, as pandas does with what it takes for a list."""
        return iter(self._read_only(slice(0, self.size)))

    def __bool__(self) -> bool:
        """Return what an array does: it tells that a column is neither true nor false."""
        return bool(np.asarray(self))

    def __setitem__(self, key: Any, value: Any) -> None:
        """Refuse, as an array that is read-only does."""
        raise ValueError("assignment destination is read-only")

    def __getitem__(self, key: Any) -> Any:
        """Return one value, or those of a slice without gaps as an array."""
        if isinstance(key, slice):
            start, stop, step = key.indices(self.size)
            if step == 1:
                return self._read_only(slice(start, max(start, stop)))
        if isinstance(key, int | np.integer) and not isinstance(key, bool):
            row = range(self.size)[key]
            return self._rows(slice(row, row + 1))[0]
        return self._read_only(slice(0, self.size))[key]

    def _read_only(self, rows: slice) -> NDArray[Any]:
        values = self._rows(rows)
        # As the rows of any column of a record: compiled loops are made for one kind of array.
        values.setflags(write=False)
        return values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the whole column."""
        return np.array(self._read_only(slice(0, self.size)), dtype=dtype, copy=copy)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **given: Any) -> Any:
        """Apply a function of numpy to the whole column."""
        if any(isinstance(out, ComputedColumn) for out in given.get("out", ())):
            raise ValueError("output array is read-only")
        arrays = (np.asarray(i) if isinstance(i, ComputedColumn) else i for i in inputs)
        return getattr(ufunc, method)(*arrays, **given)

    def __getattr__(self, name: str) -> Any:
        """Lend the methods of an array, but for what numpy and copies ask under the surface."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._read_only(slice(0, self.size)), name)

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling as an array of the values."""
        return (np.asarray, (np.array(self),))


def computed(
    n_rows: int, rows: Callable[[slice], NDArray[Any]], dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """Return a column that is computed where it is asked for.

    Parameters
    ----------
    n_rows : int
        Its length.
    rows : callable
        As for :class:`ComputedColumn`.
    dtype : dtype
        Type of the values.

    Returns
    -------
    ndarray of shape (n_rows,)
        In truth a :class:`ComputedColumn`: whoever works block by block sees no difference.
    """
    return cast("NDArray[Any]", ComputedColumn(n_rows, rows, dtype))


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


def widened(column: NDArray[Any], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return a column of a narrow type as one of a wider.

    Parameters
    ----------
    column : ndarray of shape (n,)
        Whole numbers, say; a column of the type that is asked for is returned as it is.
    dtype : dtype
        That type.
    """
    if column.dtype == np.dtype(dtype):
        return column
    wide = ComputedColumn(column.size, lambda rows: column[rows].astype(dtype), dtype, column)
    return cast("NDArray[Any]", wide)


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


def is_computed(column: NDArray[Any]) -> bool:
    """Tell whether a column is computed each time that it is asked for.

    Parameters
    ----------
    column : ndarray of shape (n,)
        A column.
    """
    given: object = column
    return isinstance(given, ComputedColumn)
