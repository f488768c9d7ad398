"""The elements of a MAT file of versions 5 to 7.2, looked at before scipy's reader takes them.

That reader looks up in C what type of number an element holds without asking whether there is such
a type, and makes room for as many cells as a header claims: of a damaged file the process dies or
stands still. This walk goes where it will go, in the same order, and asks for that alone.
"""

from __future__ import annotations

import struct
import zlib
from math import prod
from pathlib import Path
from typing import BinaryIO, Protocol

__all__ = ["check_mat_elements"]

# After "MAT-File Format" (MathWorks): types of elements, and classes of arrays.
_MATRIX, _COMPRESSED = 14, 15
_TYPES = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18))
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE = 1, 2, 3, 4, 5
_NUMBERS = range(6, 16)
_FUNCTION, _OPAQUE = 16, 17
_COMPLEX = 0x800

_HEADER = 128
_MOST_AXES = 32
# More cells, or letters without a byte of text, than any record holds.
_MOST_PARTS = 1_000_000
# scipy compares the names of fields each with each, and calls itself for what lies within.
_MOST_FIELDS = 20_000
_DEEPEST = 1000
_BLOCK = 1 << 16
_CUT_SHORT = "could not read bytes"


def check_mat_elements(file: Path) -> None:
    """Raise unless scipy's reader can read a MAT file or refuse it and live.

    What else may be wrong with a file is left to that reader; numbers are passed over.

    Parameters
    ----------
    file : path
        A MAT file of version 5 to 7.2.

    Raises
    ------
    ValueError, zlib.error, OSError
        When an element is of no type, a header claims what nobody wrote, or the file ends.
    """
    size = file.stat().st_size
    with file.open("rb") as opened:
        order = "<" if opened.read(_HEADER)[-2:] == b"IM" else ">"
        while opened.tell() < size:
            parts = _Parts(_Plain(opened), order)
            kind, length = parts.full_tag()
            if not length:
                raise ValueError("an element of no bytes")
            after = opened.tell() + length
            if kind == _COMPRESSED:
                parts = _Parts(_Inflated(opened, length), order)
                kind, _ = parts.full_tag()
            if kind != _MATRIX:
                raise ValueError(f"an element of type {kind} in place of an array")
            parts.walk()
            opened.seek(after)


class _Stream(Protocol):
    def read(self, n: int) -> bytes: ...

    def skip(self, n: int) -> None: ...


class _Plain:
    def __init__(self, opened: BinaryIO) -> None:
        self._opened = opened

    def read(self, n: int) -> bytes:
        found = self._opened.read(n)
        if len(found) < n:
            raise ValueError(_CUT_SHORT)
        return found

    def skip(self, n: int) -> None:
        self._opened.seek(n, 1)


class _Inflated:
    """What a compressed element holds; what is skipped last is never decompressed."""

    def __init__(self, opened: BinaryIO, length: int) -> None:
        self._opened = opened
        self._left = length
        self._inflate = zlib.decompressobj()
        self._ahead = 0

    def _some(self, most: int) -> bytes:
        """Return at most so many bytes, and at least one."""
        while True:
            packed = self._inflate.unconsumed_tail
            if not packed:
                packed = self._opened.read(min(_BLOCK, self._left))
                self._left -= len(packed)
            found = self._inflate.decompress(packed, most)
            if found:
                return found
            if not packed or self._inflate.eof:
                raise ValueError(_CUT_SHORT)

    def read(self, n: int) -> bytes:
        while self._ahead:
            self._ahead -= len(self._some(min(_BLOCK, self._ahead)))
        found = b""
        while len(found) < n:
            found += self._some(n - len(found))
        return found

    def skip(self, n: int) -> None:
        self._ahead += n


class _Parts:
    """A walk through the elements of one variable, as scipy's reader takes them."""

    def __init__(self, stream: _Stream, order: str) -> None:
        self._stream = stream
        self._order = order
        self._parts_left = _MOST_PARTS

    def walk(self) -> None:
        """Walk through an array whose tag has been read, and the arrays in it."""
        arrays_left = [self._array()]
        while arrays_left:
            if len(arrays_left) > _DEEPEST:
                raise ValueError(f"more than {_DEEPEST} arrays within one another")
            if not arrays_left[-1]:
                arrays_left.pop()
                continue
            arrays_left[-1] -= 1
            kind, length = self.full_tag()
            if kind != _MATRIX:
                raise ValueError(f"an element of type {kind} in place of an array")
            if length:
                arrays_left.append(self._array())

    def full_tag(self) -> tuple[int, int]:
        """Return type and length of an element that is never small."""
        kind, length = struct.unpack(f"{self._order}2I", self._stream.read(8))
        return kind, length

    def _tag(self) -> tuple[int, int, bytes]:
        """Return type, length and, of a small element, the content."""
        tag = self._stream.read(8)
        kind, length = struct.unpack(f"{self._order}2I", tag)
        small = kind >> 16
        if small > 4:
            raise ValueError(f"a small element of {small} bytes")
        return (kind & 0xFFFF, small, tag[4:]) if small else (kind, length, b"")

    def _pass(self) -> tuple[int, int]:
        """Pass over an element, and return its type and length."""
        kind, length, content = self._tag()
        if not content:
            self._stream.skip(-(-length // 8) * 8)
        return kind, length

    def _whole_numbers(self, most: int) -> tuple[int, ...]:
        _, length, content = self._tag()
        if length > 4 * most:
            raise ValueError(f"{length // 4} whole numbers in place of {most} at most")
        if not content:
            content = self._stream.read(-(-length // 8) * 8)
        n = length // 4
        return struct.unpack(f"{self._order}{n}i", content[: 4 * n])

    def _array(self) -> int:
        """Pass over an array up to the arrays in it, and return how many these are."""
        self._stream.skip(8)
        flags, _ = struct.unpack(f"{self._order}2I", self._stream.read(8))
        kind = flags & 0xFF
        if kind == _OPAQUE:
            for _ in range(3):
                self._pass()
            return 1
        shape = self._whole_numbers(_MOST_AXES)
        if not shape or min(shape) < 0:
            raise ValueError("an array of no size")
        self._pass()
        if kind in _NUMBERS or kind == _SPARSE:
            n = 1 if kind in _NUMBERS else 3
            for _ in range(n + bool(flags & _COMPLEX)):
                self._numbers()
            return 0
        if kind == _TEXT:
            self._text(shape)
            return 0
        if kind in (_STRUCT, _OBJECT):
            if kind == _OBJECT:
                self._pass()
            return self._fields(shape)
        if kind == _CELL:
            return self._many(prod(shape))
        if kind == _FUNCTION:
            return 1
        raise ValueError(f"an array of class {kind}")

    def _numbers(self) -> None:
        kind, _ = self._pass()
        if kind not in _TYPES:
            raise ValueError(f"numbers of type {kind}")

    def _text(self, shape: tuple[int, ...]) -> None:
        kind, length = self._pass()
        # Some programs write no bytes for a text of blanks.
        if length and kind not in _TYPES:
            raise ValueError(f"letters of type {kind}")
        if prod(max(size, 1) for size in shape) > max(length, _MOST_PARTS):
            raise ValueError("a text of more letters than bytes")

    def _fields(self, shape: tuple[int, ...]) -> int:
        width = self._whole_numbers(1)
        if not width or width[0] < 1:
            raise ValueError("names of fields without letters")
        n = self._pass()[1] // width[0]
        if n > _MOST_FIELDS:
            raise ValueError(f"more than {_MOST_FIELDS:,} fields")
        structs = self._many(prod(shape))
        return self._many(structs * n)

    def _many(self, n: int) -> int:
        self._parts_left -= n
        if self._parts_left < 0:
            raise ValueError(f"more than {_MOST_PARTS:,} cells or structs")
        return n
