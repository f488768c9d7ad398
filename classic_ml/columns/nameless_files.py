"""Files that nobody can name, and nothing is left of however a process ends."""

from __future__ import annotations

import errno
import mmap
import os
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surge_core.errors import InputError

__all__ = ["MappedMemory", "NamelessFile", "few_files"]


class NamelessFile:
    """A file without a name, closed when nobody holds it.

    Parameters
    ----------
    folder : path
        Where it lies.
    size : int
        Its bytes, whose room is taken at once; 0 where they are not known.

    Raises
    ------
    InputError
        When the disk is full, or too many files are open.
    """

    def __init__(self, folder: Path, size: int = 0) -> None:
        self._folder, self.size = folder, size
        with few_files(), tempfile.TemporaryFile(prefix="sindy-surge-", dir=folder) as opened:
            self.number = os.dup(opened.fileno())
        weakref.finalize(self, os.close, self.number).atexit = False
        if size:
            self._reserve()

    def _reserve(self) -> None:
        """Give it its length and room: a full disk is told here, not when a page is written."""
        if hasattr(os, "posix_fallocate"):
            try:
                with self._room(self.size):
                    os.posix_fallocate(self.number, 0, self.size)
                return
            except OSError:
                # Not every file system can.
                pass
        os.ftruncate(self.number, self.size)

    def write(self, values: NDArray[Any], place: int) -> None:
        """Write values at a place, in bytes from the beginning."""
        part = values.view(np.uint8).data
        os.lseek(self.number, place, os.SEEK_SET)
        with self._room(part.nbytes):
            while part.nbytes:
                # A call may take up less than it is given.
                part = part[os.write(self.number, part) :]

    @contextmanager
    def _room(self, size: int) -> Iterator[None]:
        """Say where the room was short."""
        try:
            yield
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise InputError(
                str(self._folder),
                expected=f"room for {size / 1e6:.1f} MB more of temporary files",
                found="a full disk",
                remedy="free some, or let TMPDIR name a folder on another disk",
            ) from None


@contextmanager
def few_files() -> Iterator[None]:
    """Say how to have more files open where there are too many."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.EMFILE:
            raise
        raise InputError(
            "columns on disk",
            expected="two open files for each column",
            found="more than this process may have",
            remedy="raise the limit (ulimit -n 8192), or reduce fewer channels at once",
        ) from None


class MappedMemory:
    """What the system tells of the memory of this process."""

    def __init__(self) -> None:
        self._number: int | None = None
        # Opened once: the path takes the longer part of the time.
        with suppress(OSError):
            self._number = os.open("/proc/self/statm", os.O_RDONLY)
            weakref.finalize(self, os.close, self._number).atexit = False

    def mapped_bytes(self) -> int:
        """Return how much of files the process has in memory; -1 where the system does not tell."""
        if self._number is None:
            return -1
        return int(os.pread(self._number, 256, 0).split()[2]) * mmap.PAGESIZE
