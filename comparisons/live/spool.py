"""The rows of a session on disk, piece by piece, as raw CSV that `sindy-surge reduce` takes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from surge_core.errors import InputError

__all__ = ["Piece", "RawSpool", "numbered"]


@dataclass
class Piece:
    """A stretch of the record without a gap.

    Parameters
    ----------
    number : int
        From 1.
    path : path
        Its rows, as CSV.
    why : str
        Why it begins here; empty for the first.
    n_rows : int
        Rows so far.
    from_s, to_s : float
        Facility clock of its first and last row.
    test : path, optional
        A description of the test for this piece alone, beside it.
    matched_by : int
        Number of the piece whose near-stall reading it is matched by; 0 for its own.
    """

    number: int
    path: Path
    why: str
    n_rows: int = 0
    from_s: float = 0.0
    to_s: float = 0.0
    test: Path | None = None
    matched_by: int = 0


class RawSpool:
    """Write rows to disk as they come.

    Every batch of whole lines is handed to the system in one write without a buffer in between: a
    killed process loses the batch it was about to write, and leaves a file that can be reduced.

    Parameters
    ----------
    path : path
        File of the first piece; it must not exist yet, since it may hold what cannot be measured
        again. Further pieces are numbered.
    names : tuple of str
        Names of the columns.
    """

    def __init__(self, path: Path, names: tuple[str, ...]) -> None:
        self._path = path
        self._header = ",".join(names).encode("utf-8") + b"\n"
        self._handle: int | None = None
        self.pieces: list[Piece] = []

    def state_units(self, line: bytes) -> None:
        """Write the line of units below the header, in this piece and those to come.

        Parameters
        ----------
        line : bytes
            Without its end; nothing but the header may have been written.
        """
        self._header += line + b"\n"
        self._write(line + b"\n")

    def begin(self, why: str = "") -> None:
        """Begin the next piece.

        Parameters
        ----------
        why : str
            Why the record is cut here.
        """
        self.close()
        number = len(self.pieces) + 1
        path = numbered(self._path, number)
        while path.exists() and number > 1:
            # Left over from another session: it stays as it is.
            path = path.with_stem(f"{path.stem}-new")
        self._handle = _created(path)
        self.pieces.append(Piece(number, path, why))
        self._write(self._header)

    def append(self, lines: Iterable[bytes], n_rows: int, from_s: float, to_s: float) -> None:
        """Write rows to the last piece.

        Parameters
        ----------
        lines : iterable of bytes
            Lines of CSV without their ends.
        n_rows : int
            How many.
        from_s, to_s : float
            Facility clock of the first and the last of them.
        """
        piece = self.pieces[-1]
        self._write(b"\n".join(lines) + b"\n")
        if not piece.n_rows:
            piece.from_s = from_s
        piece.n_rows += n_rows
        piece.to_s = to_s

    def close(self) -> None:
        """Bring what was written to the disk itself, and close the file."""
        if self._handle is not None:
            handle, self._handle = self._handle, None
            with suppress(OSError):
                os.fsync(handle)
            os.close(handle)

    def discard(self) -> None:
        """Remove the files of all pieces, and the descriptions beside them."""
        for piece in self.pieces:
            piece.path.unlink(missing_ok=True)
            if piece.test is not None:
                piece.test.unlink(missing_ok=True)

    def _write(self, data: bytes) -> None:
        if self._handle is None:
            raise ValueError("no piece was begun")
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._handle, rest) :]
        except OSError as error:
            raise InputError(
                str(self.pieces[-1].path),
                expected="room for the raw record",
                found=error.strerror or str(error),
                remedy="what was written until then can be reduced",
            ) from None


def numbered(path: Path, number: int) -> Path:
    """Return the file of a piece: the first has the plain name.

    Parameters
    ----------
    path : path
        Plain name.
    number : int
        Number of the piece, from 1.
    """
    return path if number == 1 else path.with_stem(f"{path.stem}-piece{number}")


def _created(path: Path) -> int:
    try:
        # Without O_BINARY, where there is such a thing, line ends would be written as others.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        return os.open(path, flags, 0o666)
    except FileExistsError:
        raise InputError(
            str(path),
            expected="a new file for the raw record",
            found="one that exists",
            remedy="it may be the record of a session that was cut off: reduce it, or move it away",
        ) from None
