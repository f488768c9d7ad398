"""Where the columns of a record lie, in memory or on disk, and how they are worked through.

Every step of the reduction is evaluated over blocks of :data:`BLOCK_ROWS` rows, wherever the
columns lie and however the file was read. So a record in memory, a file larger than memory and a
live feed give the same numbers to the last bit, and what a step needs beside its results is one
block.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["BLOCK_ROWS", "IN_MEMORY", "InMemory", "OnDisk", "Workspace", "blocks", "mapped"]

FloatArray = NDArray[np.float64]

# One block of 20 channels is 10 MB: more than the caches hold, little beside any memory. A record
# of a minute at 1 kHz is one block.
BLOCK_ROWS = 65_536


class Workspace(ABC):
    """Where the steps of a reduction put their results."""

    @abstractmethod
    def column(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a new column to be written, its content undefined."""

    @abstractmethod
    def release(self) -> None:
        """Let go of the memory of what was written or read; the columns keep their values."""


class InMemory(Workspace):
    """Columns as plain arrays."""

    def column(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return a new array."""
        return np.empty(n_rows, dtype=dtype)

    def release(self) -> None:
        """Do nothing: an array is in memory for as long as it lives."""


IN_MEMORY = InMemory()


class OnDisk(Workspace):
    """Columns as files in a temporary folder, mapped into memory block by block.

    Parameters
    ----------
    folder : path, optional
        Where the temporary folder is made; the system's choice without it. It goes with
        :meth:`close`, and the columns with it.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = tempfile.TemporaryDirectory(
            prefix="sindy-surge-", dir=folder, ignore_cleanup_errors=True
        )
        self._maps: list[weakref.ref[mmap.mmap]] = []
        self._made = 0

    def column(self, n_rows: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return an array that is mapped to a file of its own."""
        if n_rows == 0:
            return np.empty(0, dtype=dtype)
        path = Path(self._folder.name) / f"{self._made}.column"
        self._made += 1
        size = n_rows * np.dtype(dtype).itemsize
        with path.open("w+b") as file:
            file.truncate(size)
            mapped_file = mmap.mmap(file.fileno(), size)
        if os.name == "posix":
            # Without a name, the space is free again as soon as nobody holds the column.
            path.unlink()
        self._maps = [*(m for m in self._maps if m() is not None), weakref.ref(mapped_file)]
        return np.frombuffer(mapped_file, dtype=dtype)

    def release(self) -> None:
        """Give the pages back to the system, which has them in its cache or on the disk."""
        if not hasattr(mmap, "MADV_DONTNEED"):
            return
        for reference in self._maps:
            mapped_file = reference()
            if mapped_file is not None:
                mapped_file.madvise(mmap.MADV_DONTNEED)

    def close(self) -> None:
        """Remove the folder; on Windows a column that is still held keeps its file."""
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def blocks(n_rows: int) -> Iterator[slice]:
    """Yield the rows of one block after another.

    Parameters
    ----------
    n_rows : int
        Rows of the record.
    """
    for start in range(0, n_rows, BLOCK_ROWS):
        yield slice(start, min(start + BLOCK_ROWS, n_rows))


def mapped(
    workspace: Workspace,
    inputs: Sequence[NDArray[Any]],
    function: Callable[..., Sequence[FloatArray]],
    n_outputs: int,
) -> list[FloatArray]:
    """Evaluate a function of single rows, block by block.

    Parameters
    ----------
    workspace : Workspace
        Where the results lie.
    inputs : sequence of ndarray of shape (n,)
        Columns of one length.
    function : callable
        ``function(*blocks)`` returns ``n_outputs`` arrays, each row of which depends on the same
        row of the inputs alone.
    n_outputs : int
        Number of results.

    Returns
    -------
    list of ndarray of shape (n,)
        The results, read-only.
    """
    n_rows = inputs[0].size
    outputs = [workspace.column(n_rows) for _ in range(n_outputs)]
    for rows in blocks(n_rows):
        for output, values in zip(outputs, function(*(i[rows] for i in inputs)), strict=True):
            output[rows] = values
        workspace.release()
    for output in outputs:
        output.setflags(write=False)
    return outputs
