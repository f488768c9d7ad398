"""The pieces of a record: kept on disk as they come, read like files, reduced like files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from classic_ml.io import read_raw
from classic_ml.records import LedgerEntry
from classic_ml.reduction import Reduction, near_stall_shifts, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from surge_core.errors import InputError


@dataclass
class Piece:
    """Rows without a gap: a number from 1, their raw record, and what is missing before them."""

    number: int
    path: Path
    gap: str = ""
    n_rows: int = 0


class Pieces:
    """Write rows to disk as they come, a file a piece; further ones than the first are numbered."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.head = b""
        self.pieces: list[Piece] = []

    @property
    def n_rows(self) -> int:
        """Rows of all pieces."""
        return sum(piece.n_rows for piece in self.pieces)

    def begin(self, gap: str) -> None:
        """Begin the next piece, behind a gap, with the header."""
        number = len(self.pieces) + 1
        path = self._path
        if number > 1:
            path = path.with_stem(f"{path.stem}-piece{number}")
        path.write_bytes(self.head)
        self.pieces.append(Piece(number, path, gap))

    def append(self, lines: Sequence[bytes]) -> None:
        """Write rows, without their line ends, to the last piece."""
        with self.pieces[-1].path.open("ab") as file:
            file.write(b"\n".join(lines) + b"\n")
        self.pieces[-1].n_rows += len(lines)

    def discard(self) -> None:
        """Remove the files of all pieces."""
        for piece in self.pieces:
            piece.path.unlink(missing_ok=True)


def reduce_longest(
    pieces: Sequence[Piece], test_path: Path, settings: ReductionSettings, entry: LedgerEntry
) -> tuple[Piece, Reduction]:
    """Reduce the longest piece of a record that can be reduced, as a file; return it too.

    A piece behind a gap has no near-stall reading: it is matched by that of the first piece, since
    the drift of amplifiers that the match makes good holds behind a gap as it does before it.
    ``entry`` is what is to be said of the feed in the ledger. When no piece can be reduced, the
    reason of the longest one is given, and the files that are kept.
    """
    reasons: list[InputError] = []
    for piece in sorted(pieces, key=lambda piece: -piece.n_rows):
        try:
            return piece, _reduced(piece, pieces[0], test_path, settings, entry)
        except InputError as error:
            reasons.append(error)
    first, kept = reasons[0], ", ".join(str(piece.path) for piece in pieces)
    remedy = "; ".join(filter(None, [first.remedy, f"the raw record is kept: {kept}"]))
    raise InputError(first.where, expected=first.expected, found=first.found, remedy=remedy)


def _reduced(
    piece: Piece, first: Piece, test_path: Path, settings: ReductionSettings, entry: LedgerEntry
) -> Reduction:
    record, test = read_raw(piece.path, test_path)
    flags = entry.flags
    if piece.number > 1 and not test.near_stall_shifts:
        shifts = near_stall_shifts(read_raw(first.path, test)[0], test)
        test = replace(test, near_stall_shifts=shifts)
        flags += (f"piece {piece.number} is matched by the near-stall reading of piece 1",)
    parameters = {**entry.parameters, "piece": piece.number}
    record = record.after(replace(entry, parameters=parameters, flags=flags))
    return reduce_record(record, test, settings)
