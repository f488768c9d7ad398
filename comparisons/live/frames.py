"""The binary format of a feed: frames with a number and a checksum."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from comparisons.live.rows import End, Header, Item, Rows, Tally
from surge_core.types import FloatArray

__all__ = [
    "FRAME_FORMAT",
    "LONGEST_PAYLOAD",
    "FrameDecoder",
    "columns_frame",
    "end_frame",
    "rows_frame",
]

MAGIC = b"SSLV"
VERSION = 1
COLUMNS, ROWS, END = 0, 1, 2
# magic, version, kind, zero, sequence number, rows, bytes of payload
_HEAD = struct.Struct("<4sBBHIII")
_CRC = struct.Struct("<I")
# 64 KiB are 0.4 s of twenty channels at 1 kHz as float64: no latency needs longer frames. What
# looks like the head of a frame and is none costs a checksum over so many bytes.
LONGEST_PAYLOAD = 1 << 16
# So many bytes at its beginning show whether a connection sends text.
LOOKED_AT = 64
# Letters of a name or a type of a column that are shown.
LONGEST_SHOWN = 40
_NO_FRAME = "bytes that are no frame"
_OTHER_VERSION = "a frame of another version"
_TYPES = {"f8": "<f8", "f4": "<f4", "i2": "<i2", "u2": "<u2", "i4": "<i4"}

FRAME_FORMAT = f"""\
binary: frames, all numbers little-endian. A frame is the four bytes {MAGIC.decode()}, one byte of
version ({VERSION}), one byte of kind, two bytes of zero, the number of the frame within its
connection, from 0, the number of rows and the number of bytes of payload (uint32 each), the payload
(at most {LONGEST_PAYLOAD:,} bytes), and the CRC-32 of all that precedes it (uint32).
Kind {COLUMNS} begins every connection: the payload is text, the columns as NAME:TYPE separated by
commas, the types being f8 and f4 (floats) and i2, u2 and i4 (integers). Kind {ROWS} holds that many
rows, each with its values in the order and of the types of the columns, without padding. Kind {END}
has no payload and ends the run. A frame whose checksum is wrong is left out, and the next one is
searched for from its second byte on: a length that is damaged costs no other frame."""


class FrameDecoder:
    """Decode binary frames; after a damaged one, search for the next.

    Parameters
    ----------
    tally : Tally
        Where refused frames are counted.
    """

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._buffer = bytearray()
        self._row: np.dtype[np.void] | None = None
        self._next_number = 0
        self._in_step = True
        # Bytes that went through the buffer before those in it, and heads there that are none.
        self._passed = 0
        self._no_frames: set[int] = set()

    def feed(self, data: bytes) -> list[Item]:
        """Return what is complete by now.

        Parameters
        ----------
        data : bytes
            The next bytes of the connection, cut anywhere.
        """
        self._buffer += data
        items: list[Item] = []
        while self._at_magic() and len(self._buffer) >= _HEAD.size:
            size = self._size_at(0)
            if len(self._buffer) < size:
                behind = self._whole_frame_behind()
                if not behind:
                    break
                # What is waited for is damaged: it would hold the head of that frame.
                self._count_damage()
                self._drop(behind)
            elif not size or not self._is_whole(0, size):
                self._out_of_step()
            else:
                _, version, kind, _, number, n_rows, length = _HEAD.unpack_from(self._buffer)
                payload = bytes(self._buffer[_HEAD.size : _HEAD.size + length])
                self._drop(size)
                self._in_step = True
                self._count_missing(number)
                items += self._item(version, kind, n_rows, payload)
        return items

    def close(self) -> None:
        """Count a frame that the end of the connection cut off."""
        if self._buffer:
            self._tally.refuse("a frame cut off by the end of the connection")
        self._buffer.clear()

    def _at_magic(self) -> bool:
        """Drop what stands before the next frame; False where there is none."""
        start = self._buffer.find(MAGIC)
        if start < 0:
            # The magic itself may be cut by the end of what has come so far.
            begun = (n for n in range(len(MAGIC) - 1, 0, -1) if self._buffer.endswith(MAGIC[:n]))
            start = len(self._buffer) - next(begun, 0)
        if start:
            self._count_damage()
            self._drop(start)
        return len(self._buffer) >= len(MAGIC)

    def _size_at(self, place: int) -> int:
        """Return the size of the frame that begins at a place; 0 where what is there is none."""
        _, version, kind, zero, _, _, length = _HEAD.unpack_from(self._buffer, place)
        if zero or length > LONGEST_PAYLOAD or (version == VERSION and kind > END):
            return 0
        return int(_HEAD.size + length + _CRC.size)

    def _is_whole(self, place: int, size: int) -> bool:
        """Tell whether a frame of so many bytes has the checksum it states."""
        if self._passed + place in self._no_frames:
            return False
        covered = place + size - _CRC.size
        with memoryview(self._buffer) as view:
            checksum = zlib.crc32(view[place:covered])
        return bool(_CRC.unpack_from(self._buffer, covered)[0] == checksum)

    def _whole_frame_behind(self) -> int:
        """Return where a whole frame begins behind the first one, which is not complete; else 0.

        A length that is damaged may claim whatever comes within the next minutes.
        """
        last = len(self._buffer) - _HEAD.size - _CRC.size
        place = self._buffer.find(MAGIC, 1)
        while 0 < place <= last:
            size = self._size_at(place)
            if size and place + size <= len(self._buffer):
                if self._is_whole(place, size):
                    return place
                # No checksum is taken twice, however often more bytes come.
                self._no_frames.add(self._passed + place)
            place = self._buffer.find(MAGIC, place + 1)
        return 0

    def _out_of_step(self) -> None:
        """Give up this frame, and look for the next one behind its first byte."""
        self._count_damage()
        self._drop(1)

    def _drop(self, n_bytes: int) -> None:
        del self._buffer[:n_bytes]
        self._passed += n_bytes
        if self._no_frames:
            self._no_frames = {place for place in self._no_frames if place >= self._passed}

    def _count_damage(self) -> None:
        # Whatever was passed over between two whole frames counts once.
        if self._in_step:
            begins = b"" if self._passed else bytes(self._buffer[:LOOKED_AT])
            self._tally.refuse(*_damage(begins))
        self._in_step = False

    def _count_missing(self, number: int) -> None:
        if number > self._next_number:
            self._tally.refuse("a frame missing by its number", number - self._next_number)
        self._next_number = number + 1

    def _item(self, version: int, kind: int, n_rows: int, payload: bytes) -> list[Item]:
        if version != VERSION:
            self._tally.refuse(_OTHER_VERSION, remedy=_send_version(version))
            return []
        if kind == END:
            return [End()]
        if kind == COLUMNS:
            return self._columns(payload)
        if self._row is None:
            # Where the columns were refused, the reason is known.
            told = bool(self._tally.remedies)
            remedy = "" if told else "begin every connection with a frame of columns"
            self._tally.refuse("a frame of rows before one of columns", remedy=remedy)
            return []
        if self._row.itemsize * n_rows != len(payload):
            self._tally.refuse("a frame that does not fit its columns")
            return []
        return self._rows(np.frombuffer(payload, dtype=self._row))

    def _columns(self, payload: bytes) -> list[Item]:
        columns = [
            entry.strip().rpartition(":")
            for entry in payload.decode("utf-8", errors="replace").split(",")
        ]
        names = tuple(name for name, _, _ in columns)
        remedy = _unusable(names, tuple(kind for _, _, kind in columns))
        if remedy:
            self._tally.refuse("a frame of columns that cannot be read", remedy=remedy)
            return []
        self._row = _row_type(kind for _, _, kind in columns)
        return [Header(names)]

    def _rows(self, table: NDArray[np.void]) -> list[Item]:
        values = _matrix(table)
        good = np.isfinite(values).all(axis=1)
        if not good.all():
            self._tally.refuse("a row with a value that is no number", int(np.sum(~good)))
        if not good.any():
            return []
        # repr of a float reads back to the same bits, so that the line stands for these values.
        names = table.dtype.names or ()
        cells = [map(repr, _exact(table[name][good]).tolist()) for name in names]
        lines = tuple(",".join(row).encode("ascii") for row in zip(*cells, strict=True))
        return [Rows(values[good], lines)]


def _damage(begins: bytes) -> tuple[str, int, str]:
    """Return what to count where no frame is, and the remedy where that is how a feed begins."""
    if begins.startswith(MAGIC) and begins[len(MAGIC) :][:1] not in (b"", bytes([VERSION])):
        return _OTHER_VERSION, 1, _send_version(begins[len(MAGIC)])
    if not begins or begins.startswith(MAGIC):
        return "damaged bytes between two frames", 1, ""
    if any(byte < 32 and byte not in b"\t\r\n" for byte in begins):
        return _NO_FRAME, 1, f"a frame begins with {MAGIC.decode()}: see sindy-surge live --help"
    return _NO_FRAME, 1, "they are text: if that is CSV, leave out --format binary"


def _send_version(version: int) -> str:
    return f"its version is {version}: send frames of version {VERSION}"


def _unusable(names: tuple[str, ...], kinds: tuple[str, ...]) -> str:
    """Tell why columns cannot be read, and what to write instead; empty where they can be."""
    for name, kind in zip(names, kinds, strict=True):
        if not _is_name(name):
            return "each column is NAME:TYPE, such as time_s:f8"
        if kind not in _TYPES:
            shown = [_shortened(text) for text in (name, kind)]
            known = ", ".join(_TYPES)
            return f"the type of column {shown[0]} is '{shown[1]}': write one of {known}"
    doubled = next((name for name in names if names.count(name) > 1), "")
    return f"column {_shortened(doubled)} is there twice: name each once" if doubled else ""


def _shortened(text: str) -> str:
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"


def _is_name(name: str) -> bool:
    """Tell whether a name can stand in the one line that heads the raw record."""
    return bool(name) and not any(ord(letter) < 32 or ord(letter) == 127 for letter in name)


def _row_type(kinds: Iterable[str]) -> np.dtype[np.void]:
    """Return the layout of a row, its fields by their numbers: numpy has names of its own."""
    return np.dtype([(f"{number}", _TYPES[kind]) for number, kind in enumerate(kinds)])


def _matrix(table: NDArray[np.void]) -> FloatArray:
    names = table.dtype.names or ()
    return np.column_stack([table[name].astype(np.float64) for name in names])


def _exact(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Widen what Python would print shorter than the value is."""
    return column.astype(np.float64) if column.dtype.kind == "f" else column


def _frame(kind: int, number: int, n_rows: int, payload: bytes) -> bytes:
    body = _HEAD.pack(MAGIC, VERSION, kind, 0, number, n_rows, len(payload)) + payload
    return body + _CRC.pack(zlib.crc32(body))


def columns_frame(columns: Mapping[str, str], number: int = 0) -> bytes:
    """Return the frame that begins a connection.

    Parameters
    ----------
    columns : mapping of str to str
        Type of each column: ``"f8"``, ``"f4"``, ``"i2"``, ``"u2"`` or ``"i4"``.
    number : int
        Number of the frame.
    """
    text = ",".join(f"{name}:{kind}" for name, kind in columns.items())
    return _frame(COLUMNS, number, 0, text.encode("utf-8"))


def rows_frame(columns: Mapping[str, str], values: FloatArray, number: int) -> bytes:
    """Return a frame of rows.

    Parameters
    ----------
    columns : mapping of str to str
        As in :func:`columns_frame`.
    values : ndarray of shape (n, n_columns)
        The rows, in the order of the columns; as many as a frame can hold.
    number : int
        Number of the frame.

    Raises
    ------
    ValueError
        When they are more.
    """
    table = np.empty(len(values), dtype=_row_type(columns.values()))
    if table.nbytes > LONGEST_PAYLOAD:
        most = LONGEST_PAYLOAD // table.dtype.itemsize
        raise ValueError(f"a frame holds {most} rows of these columns at most, not {len(values)}")
    for name, column in zip(table.dtype.names or (), values.T, strict=True):
        table[name] = column
    return _frame(ROWS, number, len(values), table.tobytes())


def end_frame(number: int) -> bytes:
    """Return the frame that ends a run."""
    return _frame(END, number, 0, b"")
