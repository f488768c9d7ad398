"""What an HDF5 file claims of its texts, looked at before the library makes room for them.

A text of any length is stored as its length and where it lies. Where neither is guarded by a sum,
as in files of the library's earliest format, one byte makes it four gigabytes long.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_TEXTS", "attributes_of", "check_texts"]

# More texts than this are no names of columns, and are never read.
MOST_TEXTS = 4096

# After "HDF5 File Format Specification", IV.A: object headers, which have no sum in version 1 only.
_VERSION_1 = b"\x01"
_HEAD = 16
_CONTINUED, _ATTRIBUTE = 0x10, 0x0C
_ELSEWHERE = 2
_OF_ANY_LENGTH = 9
# An element of any length: its length in 4 bytes, an address in 8, a number in 4.
_ELEMENT = 16
# Rows that are looked at in one go.
_AT_ONCE = 1 << 16


def attributes_of(item: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """Return attributes of an HDF5 item; None for one that is neither a text nor a number.

    Such a one is not read: the library dies of some that a damaged file takes for a type.

    Parameters
    ----------
    item : h5py.Group or h5py.Dataset
        The item.
    names : tuple of str
        What is asked for, in any case of letters.
    """
    import h5py

    plain = (h5py.h5t.STRING, h5py.h5t.INTEGER, h5py.h5t.FLOAT)
    asked = {name.lower() for name in names}
    found: dict[str, Any] = {}
    for name in item.attrs:
        if str(name).lower() in asked:
            is_plain = item.attrs.get_id(name).get_type().get_class() in plain
            found[name] = item.attrs[name] if is_plain else None
    return found


def check_texts(file: Path, dataset: Any) -> None:
    """Raise unless the texts of an HDF5 dataset and its attributes fit into the file.

    Parameters
    ----------
    file : path
        The file.
    dataset : h5py.Dataset
        The dataset; its values are looked at where texts are in them and are not compressed.

    Raises
    ------
    ValueError
        When a text is longer than the file, a row holds sequences of any length, or the header of
        the dataset does not end.
    """
    import h5py

    if dataset.file.id.get_create_plist().get_sizes() != (8, 8):
        return
    start = dataset.file.userblock_size
    header = h5py.h5o.get_info(dataset.id).addr
    longest = file.stat().st_size
    with file.open("rb") as opened:
        for message in _attribute_messages(opened, start, header, longest):
            _check_lengths(_elements(message)[:, :4], longest)
        row, texts = _layout(dataset.id.get_type())
        if texts:
            for rows in _stored_rows(opened, dataset, row):
                for place in texts:
                    _check_lengths(rows[:, place : place + 4], longest)


def _check_lengths(stored: NDArray[np.uint8], longest: int) -> None:
    lengths = np.ascontiguousarray(stored).view("<u4")
    if lengths.size and lengths.max() > longest:
        raise ValueError(f"a text of {lengths.max():,} bytes")


def _attribute_messages(opened: BinaryIO, start: int, header: int, most: int) -> Iterator[bytes]:
    """Yield the attributes in an object header without a sum, as they are stored."""
    opened.seek(start + header)
    head = opened.read(_HEAD)
    if len(head) < _HEAD or not head.startswith(_VERSION_1):
        return
    blocks = [(header + len(head), struct.unpack_from("<I", head, 8)[0])]
    for at, size in blocks:
        opened.seek(start + at)
        block = opened.read(min(size, most))
        here = 0
        while here + 8 <= len(block):
            kind, length, flags = struct.unpack_from("<2HB", block, here)
            message = block[here + 8 : here + 8 + length]
            here += 8 + length
            if kind == _ATTRIBUTE and not flags & _ELSEWHERE:
                yield message
            elif kind == _CONTINUED and len(message) >= 16:
                blocks.append(struct.unpack_from("<2Q", message))
        if sum(size for _, size in blocks) > most:
            raise ValueError("a header that does not end")


def _elements(message: bytes) -> NDArray[np.uint8]:
    """Return the elements of an attribute, one a row; none unless they are of any length."""
    found = b""
    if len(message) >= 10:
        version, _, *sizes = struct.unpack_from("<2B3H", message)
        at = 9 if version == 3 else 8
        # Name, type and shape; in the first version, each is filled up.
        name, kind, shape = (-(-n // 8) * 8 if version == 1 else n for n in sizes)
        if message[at + name : at + name + 1] and message[at + name] & 15 == _OF_ANY_LENGTH:
            found = message[at + name + kind + shape :]
    return _rows(found, _ELEMENT)


def _rows(stored: bytes, row: int) -> NDArray[np.uint8]:
    whole = len(stored) // row * row
    return np.frombuffer(stored[:whole], np.uint8).reshape(-1, row)


def _layout(kind: Any) -> tuple[int, list[int]]:
    """Return how long a value is in the file, and where in it texts of any length are.

    The library says how long it is in memory, where such a text takes 8 bytes.
    """
    import h5py

    size, texts = kind.get_size(), []
    if kind.get_class() == h5py.h5t.VLEN or (
        kind.get_class() == h5py.h5t.ARRAY and _layout(kind.get_super())[1]
    ):
        # The library reads whole rows, and dies of some that a damaged file takes for a type.
        raise ValueError("rows with sequences of any length")
    if kind.get_class() == h5py.h5t.STRING and kind.is_variable_str():
        return _ELEMENT, [0]
    if kind.get_class() == h5py.h5t.COMPOUND:
        for n in range(kind.get_nmembers()):
            member = kind.get_member_type(n)
            longer, inner = _layout(member)
            start = kind.get_member_offset(n) + size - kind.get_size()
            texts += [start + place for place in inner]
            size += longer - member.get_size()
    return size, texts


def _stored_rows(opened: BinaryIO, dataset: Any, row: int) -> Iterator[NDArray[np.uint8]]:
    """Yield the values of a dataset as they are stored, unless they are compressed."""
    pure = dataset.dtype.names is None
    offset = dataset.id.get_offset()
    blocks: list[tuple[int, int]] = []
    if pure and dataset.size > MOST_TEXTS:
        return
    if offset is not None:
        blocks = [(offset, dataset.id.get_storage_size())]
    elif dataset.chunks and not dataset.id.get_create_plist().get_nfilters():
        chunks = (dataset.id.get_chunk_info(n) for n in range(dataset.id.get_num_chunks()))
        blocks = [(chunk.byte_offset, chunk.size) for chunk in chunks]
    for start, size in blocks:
        for at in range(start, start + size, _AT_ONCE * row):
            opened.seek(at)
            yield _rows(opened.read(min(_AT_ONCE * row, start + size - at)), row)
