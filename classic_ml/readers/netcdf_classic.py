"""The header of a classic netCDF file (CDF-1, -2, -5), and slices of its variables.

After the NetCDF Classic Format Specification (Unidata). scipy's reader either takes the whole file
into memory or leaves a map open where the file is spoiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

__all__ = ["ClassicVariable", "read_header"]

# Numbers of the external types; those from 7 on are of CDF-5 alone.
_TYPES = ("i1", "S1", ">i2", ">i4", ">f4", ">f8", "u1", ">u2", ">u4", ">i8", ">u8")
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
_STREAMING = {4: 2**32 - 1, 8: 2**64 - 1}
# More names than this and the header is none.
_MOST = 1 << 20


@dataclass(frozen=True)
class ClassicVariable:
    """A variable of a classic file.

    Parameters
    ----------
    name : str
        Its name.
    shape : tuple of int
        Its shape, the record dimension first.
    dtype : numpy dtype
        Big-endian, as stored.
    attributes : dict
        Texts as str, numbers as arrays.
    begin : int
        Where it begins, in bytes.
    record_bytes : int
        Bytes from one record to the next; 0 for a variable without the record dimension.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: dict[str, Any]
    begin: int
    record_bytes: int

    def values(self, file: BinaryIO) -> NDArray[Any]:
        """Return the variable as an array that is mapped to the open file."""
        if not self.record_bytes:
            return np.memmap(file, self.dtype, "r", self.begin, self.shape)
        inner = prod(self.shape[1:]) * self.dtype.itemsize
        size = (self.shape[0] - 1) * self.record_bytes + inner
        raw = np.memmap(file, np.uint8, "r", self.begin, (size,))
        strides = [self.record_bytes]
        for axis in range(1, len(self.shape)):
            strides.append(prod(self.shape[axis + 1 :]) * self.dtype.itemsize)
        return np.ndarray(self.shape, self.dtype, raw, 0, tuple(strides))


def read_header(file: Path) -> list[ClassicVariable]:
    """Return the variables of a classic netCDF file.

    Parameters
    ----------
    file : path
        The file.

    Raises
    ------
    ValueError
        When the header is none, or the file ends before its variables do.
    """
    size = file.stat().st_size
    with file.open("rb") as opened:
        header = _Header(opened)
        records, dimensions = header.count(), header.dimensions()
        header.attributes()
        found = header.variables()
    names = [name for name, _ in dimensions]
    record_dimension = next((n for n, (_, length) in enumerate(dimensions) if length == 0), None)
    if any(axis >= len(names) for variable in found for axis in variable.axes):
        raise ValueError("a variable has a dimension that is not there")
    runs_along = [bool(v.axes) and v.axes[0] == record_dimension for v in found]
    with_records = [v for v, is_record in zip(found, runs_along, strict=True) if is_record]
    # One record variable alone is not padded to four bytes.
    sizes = [v.record_size([length for _, length in dimensions]) for v in with_records]
    record_bytes = sizes[0] if len(sizes) == 1 else sum(-(-n // 4) * 4 for n in sizes)
    if records == _STREAMING[header.width]:
        begin = min((v.begin for v in with_records), default=size)
        records = (size - begin) // record_bytes if record_bytes else 0
    variables = []
    for v, is_record in zip(found, runs_along, strict=True):
        lengths = [dimensions[axis][1] for axis in v.axes]
        shape = (records, *lengths[1:]) if is_record else tuple(lengths)
        step = record_bytes if is_record else 0
        variables.append(ClassicVariable(v.name, shape, v.dtype, v.attributes, v.begin, step))
        _check_end(variables[-1], size)
    return variables


def _check_end(variable: ClassicVariable, size: int) -> None:
    inner = prod(variable.shape) * variable.dtype.itemsize
    if variable.record_bytes and variable.shape[0]:
        inner = inner // variable.shape[0]
        inner += (variable.shape[0] - 1) * variable.record_bytes
    if variable.begin + inner > size:
        raise ValueError(f"the file ends before its variable {variable.name} does")


@dataclass(frozen=True)
class _Stored:
    name: str
    axes: tuple[int, ...]
    attributes: dict[str, Any]
    dtype: np.dtype[Any]
    begin: int

    def record_size(self, lengths: list[int]) -> int:
        return prod(lengths[axis] for axis in self.axes[1:]) * self.dtype.itemsize


class _Header:
    """Reads the header from its first byte on."""

    def __init__(self, opened: BinaryIO) -> None:
        self._opened = opened
        version = self._bytes(4)[3]
        if version not in (1, 2, 5):
            raise ValueError(f"version {version} of the classic format")
        self.width = 8 if version == 5 else 4
        self._offset_width = 4 if version == 1 else 8

    def _bytes(self, n: int) -> bytes:
        found = self._opened.read(n)
        if len(found) < n:
            raise ValueError("the file ends in its header")
        return found

    def _whole(self, width: int) -> int:
        return int.from_bytes(self._bytes(width), "big")

    def count(self) -> int:
        """Return a count, of 4 bytes or, in CDF-5, 8."""
        return self._whole(self.width)

    def _entries(self, tag: int) -> range:
        found, n = self._whole(4), self.count()
        if n > _MOST or found not in (0, tag) or (found == 0 and n):
            raise ValueError("a header that is none")
        return range(n)

    def _padded(self, n: int) -> bytes:
        if n > _MOST:
            raise ValueError("a header that is none")
        return self._bytes(-(-n // 4) * 4)[:n]

    def _name(self) -> str:
        return self._padded(self.count()).decode("utf-8", "replace")

    def _dtype(self) -> np.dtype[Any]:
        number = self._whole(4)
        if not 1 <= number <= len(_TYPES):
            raise ValueError(f"the type {number}")
        return np.dtype(_TYPES[number - 1])

    def dimensions(self) -> list[tuple[str, int]]:
        """Return names and lengths, that of the record dimension 0."""
        return [(self._name(), self.count()) for _ in self._entries(_DIMENSIONS)]

    def attributes(self) -> dict[str, Any]:
        """Return attributes of the file or of a variable."""
        found: dict[str, Any] = {}
        for _ in self._entries(_ATTRIBUTES):
            name, dtype = self._name(), self._dtype()
            content = self._padded(self.count() * dtype.itemsize)
            text = dtype.kind == "S"
            found[name] = (
                content.decode("utf-8", "replace") if text else np.frombuffer(content, dtype)
            )
        return found

    def variables(self) -> list[_Stored]:
        """Return the variables with the numbers of their dimensions."""
        found = []
        for _ in self._entries(_VARIABLES):
            name = self._name()
            n_axes = self.count()
            if n_axes > _MOST:
                raise ValueError("a header that is none")
            axes = tuple(self.count() for _ in range(n_axes))
            attributes, dtype = self.attributes(), self._dtype()
            # The stored size is of no use: it overflows for what is larger than 4 GiB.
            self.count()
            found.append(_Stored(name, axes, attributes, dtype, self._whole(self._offset_width)))
        return found
