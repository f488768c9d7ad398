"""Global heaps of an HDF5 file, where texts of any length lie, looked at before the library does.

The library walks through the objects of such a heap by the sizes that they state, and stands still
at one of size zero. No attribute says beforehand in which heap its text lies, so that the heaps are
looked at as the library asks for their bytes.
"""

from __future__ import annotations

import re
from io import RawIOBase
from pathlib import Path
from typing import Any

__all__ = ["GuardedFile"]

# After "HDF5 File Format Specification", III.E: signature, version 1, three bytes of nothing.
_SIGNATURE = re.compile(rb"GCOL\x01\0\0\0")
# Bytes of the head of a heap, and of an object in it, up to the length that it states.
_HEAD = 8


class GuardedFile(RawIOBase):
    """An HDF5 file for h5py's driver of Python files, in which no spoiled global heap is a heap.

    The signature of such a heap is blotted out as it is read, so that the library refuses what
    lies in it and nothing else.

    Parameters
    ----------
    file : path
        The file.
    size_of_lengths : int
        Bytes of a length in this file, as its superblock states.
    """

    def __init__(self, file: Path, size_of_lengths: int) -> None:
        self._opened = file.open("rb")
        self._size = file.stat().st_size
        self._width = size_of_lengths
        self._at = 0

    def close(self) -> None:
        """Close the file."""
        self._opened.close()
        super().close()

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def seekable(self) -> bool:
        """Return that it has places."""
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move to a place in the file, or behind it."""
        self._at = offset + (0, self._at, self._size)[whence]
        return self._at

    def tell(self) -> int:
        """Return the place in the file."""
        return self._at

    def readinto(self, target: Any) -> int:
        """Fill a buffer from the file; behind its end is zero, as the library has it."""
        buffer = memoryview(target)
        at, self._at = self._at, self._at + len(buffer)
        n = 0
        if at < self._size:
            self._opened.seek(at)
            n = self._opened.readinto(buffer)
        buffer[n:] = bytes(len(buffer) - n)
        for start in self._heaps_in(buffer, n):
            if not self._is_sound(at + start):
                buffer[start : start + 4] = bytes(len(buffer[start : start + 4]))
        return len(buffer)

    def _heaps_in(self, buffer: memoryview, n: int) -> list[int]:
        """Return where heaps begin in what was read just now."""
        inside = [found.start() for found in _SIGNATURE.finditer(buffer)]
        # One may begin in what was read and go on behind it.
        first = max(n - _HEAD + 1, 0)
        end = bytes(buffer[first:n]) + self._opened.read(_HEAD - 1) if n else b""
        return inside + [first + found.start() for found in _SIGNATURE.finditer(end)]

    def _is_sound(self, heap: int) -> bool:
        """Return whether the objects of a heap lie one behind another up to its end."""
        # That of the heap is as long as that of an object.
        head = _aligned(_HEAD + self._width)
        self._opened.seek(heap + _HEAD)
        size = self._length()
        if heap + size > self._size:
            return False
        at = head
        # Less than a head is left free without a word.
        while at + head <= size:
            self._opened.seek(heap + at)
            number = int.from_bytes(self._opened.read(_HEAD)[:2], "little")
            length = self._length()
            # The free space has the number 0, and counts its own head.
            step = head + _aligned(length) if number else length
            if step < head:
                return False
            at += step
        return at <= size

    def _length(self) -> int:
        return int.from_bytes(self._opened.read(self._width), "little")


def _aligned(n: int) -> int:
    return -(-n // 8) * 8
