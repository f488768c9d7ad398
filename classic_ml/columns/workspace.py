"""Where the columns of a record lie, in memory or on disk, and how they are worked through.

Every step of the reduction is evaluated over blocks of :data:`BLOCK_ROWS` rows, wherever the
columns lie and however the file was read. So a record in memory, a file larger than memory and a
live feed give the same numbers to the last bit, and what a step needs beside its results is one
block.
"""

from __future__ import annotations

import mmap
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from classic_ml.columns.computed import computed, is_computed, widened
from classic_ml.columns.nameless_files import MappedMemory, NamelessFile, few_files

__all__ = [
    "BLOCK_ROWS",
    "IN_MEMORY",
    "ColumnWriter",
    "InMemory",
    "OnDisk",
    "Workspace",
    "blocks",
    "evaluated",
]


# One block of 20 channels is 10 MB: more than the caches hold, little beside any memory. A record
# of a minute at 1 kHz is one block.
BLOCK_ROWS = 65_536
# Mapped pages are let go of when there are so many of them: it takes one call a column.
MAPPED_BYTES = 12 << 20
# The system is asked how many there are in one of so many calls.
CALLS_BETWEEN = 2
# More than the arrays of one block take.
BLOCK_BYTES = 16 << 20


class ColumnWriter(ABC):
    """A column that is written from its first row to its last."""

    @abstractmethod
    def append(self, values: NDArray[Any]) -> None:
        """Take up further rows."""

    @abstractmethod
    def finished(self) -> NDArray[Any]:
        """Return the whole column, read-only; nothing may be appended afterwards."""


class Workspace(ABC):
    """Where the steps of a reduction put their results.

    ``computes_anew`` tells whether to keep a column takes longer than to compute it again.
    """

    computes_anew: bool

    @abstractmethod
    def column(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a new column to be written in any order, its content undefined."""

    @abstractmethod
    def zeros(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a new column of zeros, to be written in any order; no row costs anything yet."""

    @abstractmethod
    def put(self, column: NDArray[Any], rows: slice, values: NDArray[Any]) -> None:
        """Write some rows of a column of this place, as an assignment does but quicker on disk."""

    @abstractmethod
    def overwrite(self, column: NDArray[Any], rows: slice, values: NDArray[Any]) -> None:
        """Write some rows of a finished column anew, which nobody else may hold."""

    @abstractmethod
    def writer(self, n_rows: int | None = None, dtype: DTypeLike = np.float64) -> ColumnWriter:
        """Return a new column to be written in order, of about ``n_rows`` rows if that is known."""

    @abstractmethod
    def readings_writer(self, n_rows: int | None = None) -> ColumnWriter:
        """Return a new column of readings, which are whole numbers more often than not."""

    @abstractmethod
    def derived(
        self, n_rows: int, rows: Callable[[slice], NDArray[Any]], dtype: DTypeLike = np.float64
    ) -> NDArray[Any]:
        """Return a column that follows from others at once, row by row, as ``rows(part)`` has it.

        In memory it is evaluated; on disk, where reading takes longer than computing, each time
        that it is asked for.
        """

    @abstractmethod
    def widened(self, column: NDArray[Any], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a column of a narrow type as one of a wider, evaluated or not as `derived`."""

    @abstractmethod
    def tidy(self, *, but_rows: int = 0) -> None:
        """Give back the room that is kept for columns to come, but for float64 of so many rows."""

    @abstractmethod
    def discard(self, column: NDArray[Any]) -> None:
        """Give back the room of a whole column, which nobody may read any more."""

    @abstractmethod
    def is_discarded(self, column: NDArray[Any]) -> bool:
        """Tell whether a column has been discarded."""

    @abstractmethod
    def release(self) -> None:
        """Let go of the memory of what was written or read; the columns keep their values."""


class InMemory(Workspace):
    """Columns as plain arrays."""

    computes_anew = False

    def column(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a new array."""
        return np.empty(n_rows, dtype=dtype)

    def zeros(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a new array, which the system has in memory only as far as it is used."""
        return np.zeros(n_rows, dtype=dtype)

    def put(self, column: NDArray[Any], rows: slice, values: NDArray[Any]) -> None:
        """Assign the values."""
        column[rows] = values

    def overwrite(self, column: NDArray[Any], rows: slice, values: NDArray[Any]) -> None:
        """Assign the values to what was read-only."""
        column.setflags(write=True)
        column[rows] = values
        column.setflags(write=False)

    def writer(self, n_rows: int | None = None, dtype: DTypeLike = np.float64) -> ColumnWriter:
        """Return an array that is filled, or pieces that become one array."""
        return _Pieces(dtype) if n_rows is None else _Filled(np.empty(n_rows, dtype))

    def readings_writer(self, n_rows: int | None = None) -> ColumnWriter:
        """Return a column as any other."""
        return self.writer(n_rows)

    def derived(
        self, n_rows: int, rows: Callable[[slice], NDArray[Any]], dtype: DTypeLike = np.float64
    ) -> NDArray[Any]:
        """Evaluate the column."""
        return evaluated(self, n_rows, rows, dtype)

    def widened(self, column: NDArray[Any], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Evaluate the column."""
        wide = column.astype(dtype)
        wide.setflags(write=False)
        return wide

    def tidy(self, *, but_rows: int = 0) -> None:
        """Do nothing: no room is kept."""

    def discard(self, column: NDArray[Any]) -> None:
        """Do nothing: an array is in memory for as long as it lives."""

    def is_discarded(self, column: NDArray[Any]) -> bool:
        """Return False."""
        return False

    def release(self) -> None:
        """Do nothing: an array is in memory for as long as it lives."""


class _Filled(ColumnWriter):
    def __init__(self, column: NDArray[Any]) -> None:
        self._column, self._n_rows = column, 0

    def append(self, values: NDArray[Any]) -> None:
        stop = self._n_rows + values.size
        if stop > self._column.size:
            further = np.empty(stop - self._column.size, self._column.dtype)
            self._column = np.concatenate((self._column, further))
        self._column[self._n_rows : stop] = values
        self._n_rows = stop

    def finished(self) -> NDArray[Any]:
        column = self._column[: self._n_rows]
        column.setflags(write=False)
        return column


class _Pieces(ColumnWriter):
    def __init__(self, dtype: DTypeLike) -> None:
        self._dtype = dtype
        self._pieces: list[NDArray[Any]] = []

    def append(self, values: NDArray[Any]) -> None:
        self._pieces.append(np.array(values, dtype=self._dtype))

    def finished(self) -> NDArray[Any]:
        pieces, self._pieces = self._pieces, []
        column: NDArray[Any] = np.concatenate(pieces) if pieces else np.empty(0, self._dtype)
        column.setflags(write=False)
        return column


IN_MEMORY = InMemory()


class OnDisk(Workspace):
    """Columns as nameless files, mapped into memory block by block.

    A column goes as soon as nobody holds it, and the next one of its size takes its room, which
    the system has at hand; nothing is left behind however the process ends.

    Parameters
    ----------
    folder : path, optional
        Where the files lie; the system's choice (``TMPDIR``) without it.
    """

    computes_anew = True

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = Path(tempfile.gettempdir()) if folder is None else folder
        self._columns: weakref.WeakValueDictionary[int, _Mapped] = weakref.WeakValueDictionary()
        self._spare: dict[int, list[NamelessFile]] = {}
        self._told, self._n_calls = MappedMemory(), 0
        # The C library of Linux learns from what it is given back how much comes and goes; without
        # this it has the pages of each block cleared by the system anew, a seventh of the time.
        np.empty(BLOCK_BYTES, dtype=np.uint8)
        self._mapped_before = self._told.mapped_bytes()

    def column(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return an array that is mapped to a file of its own."""
        size = n_rows * np.dtype(dtype).itemsize
        return self.mapped(self.file_of(size), size, dtype)

    def zeros(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return an array that is mapped to a file of its own, which has nothing in it yet."""
        size = n_rows * np.dtype(dtype).itemsize
        return self.mapped(NamelessFile(self.folder, size), size, dtype)

    def put(self, column: NDArray[Any], rows: slice, values: NDArray[Any]) -> None:
        """Write to the file, which is thrice as quick as through the mapping."""
        mapped_file = self._columns.get(_address(column))
        if mapped_file is None:
            column[rows] = values
        else:
            part = np.ascontiguousarray(values, dtype=column.dtype)
            mapped_file.file.write(part, rows.start * column.itemsize)

    def overwrite(self, column: NDArray[Any], rows: slice, values: NDArray[Any]) -> None:
        """Write to the file, whatever may be done through the mapping."""
        self.put(column, rows, values)

    def writer(self, n_rows: int | None = None, dtype: DTypeLike = np.float64) -> ColumnWriter:
        """Return a file that is mapped when it is finished."""
        return _Written(self, n_rows, dtype)

    def readings_writer(self, n_rows: int | None = None) -> ColumnWriter:
        """Return a file of 16 bits a reading, for as long as all are whole numbers of so many."""
        return _Narrowing(self, n_rows)

    def derived(
        self, n_rows: int, rows: Callable[[slice], NDArray[Any]], dtype: DTypeLike = np.float64
    ) -> NDArray[Any]:
        """Return a column that is computed each time."""
        return computed(n_rows, rows, dtype)

    def widened(self, column: NDArray[Any], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a column that is computed each time."""
        return widened(column, dtype)

    def tidy(self, *, but_rows: int = 0) -> None:
        """Close the files that are kept for columns to come, but for those of one size."""
        size = but_rows * np.dtype(np.float64).itemsize
        self._spare = {size: self._spare[size]} if size in self._spare else {}

    def discard(self, column: NDArray[Any]) -> None:
        """Have the system forget what is in the file, as far as it can."""
        mapped_file = self._file_behind(column)
        # A part of a column that begins with it is not the column.
        whole = mapped_file is not None and column.nbytes == len(mapped_file)
        if mapped_file is not None and whole and hasattr(mmap, "MADV_REMOVE"):
            with suppress(OSError):
                mapped_file.madvise(mmap.MADV_REMOVE)
                mapped_file.discarded = True
                # Without its room it is no file for a column to come.
                mapped_file.file.size = 0

    def is_discarded(self, column: NDArray[Any]) -> bool:
        """Tell whether the file behind it was made empty."""
        mapped_file = self._file_behind(column)
        return mapped_file is not None and mapped_file.discarded

    def _file_behind(self, column: NDArray[Any]) -> _Mapped | None:
        return None if is_computed(column) else self._columns.get(_address(column))

    def release(self) -> None:
        """Give the pages back to the system, which has them in its cache or on the disk."""
        self._n_calls += 1
        if self._n_calls % CALLS_BETWEEN or not hasattr(mmap, "MADV_DONTNEED"):
            return
        if 0 <= self._told.mapped_bytes() - self._mapped_before < MAPPED_BYTES:
            return
        for mapped_file in self._columns.values():
            mapped_file.madvise(mmap.MADV_DONTNEED)
        self._mapped_before = self._told.mapped_bytes()

    def file_of(self, size: int) -> NamelessFile:
        """Return a file of so many bytes, whatever is in it."""
        spare = self._spare.get(size)
        return spare.pop() if spare else NamelessFile(self.folder, size)

    def mapped(self, file: NamelessFile, size: int, dtype: DTypeLike) -> NDArray[Any]:
        """Return a file of this place as an array."""
        if size == 0:
            return np.empty(0, dtype=dtype)
        with few_files():
            mapped_file = _Mapped(file.number, size)
        mapped_file.file = file
        # Every view of the column holds the mapping.
        weakref.finalize(mapped_file, _put_aside, weakref.ref(self), file).atexit = False
        column: NDArray[Any] = np.frombuffer(mapped_file, dtype=dtype)
        self._columns[_address(column)] = mapped_file
        return column

    def put_aside(self, file: NamelessFile) -> None:
        """Keep a file that nobody needs for a column to come."""
        if file.size:
            self._spare.setdefault(file.size, []).append(file)


def _put_aside(place: weakref.ref[OnDisk], file: NamelessFile) -> None:
    holder = place()
    if holder is not None:
        holder.put_aside(file)


class _Mapped(mmap.mmap):
    """A mapping, which goes when nobody holds the column."""

    file: NamelessFile
    discarded = False


def _address(column: NDArray[Any]) -> int:
    return int(column.__array_interface__["data"][0])


class _Written(ColumnWriter):
    """A file that is mapped when it is complete."""

    def __init__(self, place: OnDisk, n_rows: int | None, dtype: DTypeLike) -> None:
        self._place, self._dtype, self._size = place, np.dtype(dtype), 0
        self._file = place.file_of((n_rows or 0) * self._dtype.itemsize)

    def append(self, values: NDArray[Any]) -> None:
        part = np.ascontiguousarray(values, dtype=self._dtype)
        self._file.write(part, self._size)
        self._size += part.nbytes

    def finished(self) -> NDArray[Any]:
        self._file.size = self._file.size and self._size
        column = self._place.mapped(self._file, self._size, self._dtype)
        column.setflags(write=False)
        return column


class _Narrowing(ColumnWriter):
    """Whole numbers of 16 bits, and numbers as they are from the first other one on."""

    def __init__(self, place: OnDisk, n_rows: int | None) -> None:
        self._place, self._n_rows = place, n_rows
        self._writer, self._narrow = place.writer(n_rows, np.uint16), True

    def append(self, values: NDArray[Any]) -> None:
        # A compiler is loaded with it, which nobody who asks for help should wait for.
        from classic_ml.columns.codes import as_codes

        if not self._narrow:
            self._writer.append(values)
            return
        if values.dtype.kind in "iu" and values.size and 0 <= values.min() <= values.max() < 65536:
            self._writer.append(values.astype(np.uint16, copy=False))
            return
        readings = np.ascontiguousarray(values, dtype=np.float64)
        codes = np.empty(readings.size, dtype=np.uint16)
        if as_codes(readings, codes):
            self._writer.append(codes)
            return
        before = self._writer.finished()
        self._writer, self._narrow = self._place.writer(self._n_rows), False
        for rows in blocks(before.size):
            self._writer.append(before[rows])
        self._writer.append(readings)

    def finished(self) -> NDArray[Any]:
        return widened(self._writer.finished())


def blocks(stop: int, start: int = 0) -> Iterator[slice]:
    """Yield the rows of one block after another.

    Parameters
    ----------
    stop : int
        Rows of the record, or the row behind the last that is wanted.
    start : int
        First row that is wanted.
    """
    for first in range(start, stop, BLOCK_ROWS):
        yield slice(first, min(first + BLOCK_ROWS, stop))


def evaluated(
    workspace: Workspace,
    n_rows: int,
    function: Callable[[slice], ArrayLike],
    dtype: DTypeLike = np.float64,
) -> NDArray[Any]:
    """Evaluate a function of the row numbers, block by block.

    Parameters
    ----------
    workspace : Workspace
        Where the result lies.
    n_rows : int
        Rows of the record.
    function : callable
        ``function(rows)`` returns one value for each row of the slice.
    dtype : dtype
        Type of the column.

    Returns
    -------
    ndarray of shape (n_rows,)
        The column, read-only.
    """
    column = workspace.writer(n_rows, dtype)
    for rows in blocks(n_rows):
        column.append(np.asarray(function(rows)))
        workspace.release()
    return column.finished()
