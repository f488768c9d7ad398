"""The pieces of a record: kept on disk as they come, read like files, reduced like files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from classic_ml.io import read_raw, read_test_description
from classic_ml.io.series import write_series
from classic_ml.records import LedgerEntry
from classic_ml.reduction import Reduction, ReductionSettings, near_stall_shifts, reduce_record
from surge_core.errors import InputError

__all__ = ["Piece", "Pieces", "reduce_pieces"]


@dataclass
class Piece:
    """Rows without a gap, and at the end what became of them.

    Parameters
    ----------
    number : int
        From 1.
    path : path
        Its raw record.
    gap : str
        What is missing before it.
    n_rows : int
        How many rows it has.
    test : path, optional
        A description of its own, where it is matched by the near-stall reading of another piece.
    series : path, optional
        The series file.
    reduction : Reduction, optional
        The reduction behind it.
    error : InputError, optional
        Why there is none.
    """

    number: int
    path: Path
    gap: str = ""
    n_rows: int = 0
    test: Path | None = None
    series: Path | None = None
    reduction: Reduction | None = None
    error: InputError | None = None


class Pieces:
    """Write rows to disk as they come, a file a piece.

    Parameters
    ----------
    path : path
        File of the first piece; further pieces are numbered.
    """

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
        path = _numbered(self._path, len(self.pieces) + 1)
        path.write_bytes(self.head)
        self.pieces.append(Piece(len(self.pieces) + 1, path, gap))

    def append(self, lines: Sequence[bytes]) -> None:
        """Write rows, without their line ends, to the last piece."""
        with self.pieces[-1].path.open("ab") as file:
            file.write(b"\n".join(lines) + b"\n")
        self.pieces[-1].n_rows += len(lines)

    def discard(self) -> None:
        """Remove the files of all pieces."""
        for piece in self.pieces:
            piece.path.unlink(missing_ok=True)
            if piece.test is not None:
                piece.test.unlink(missing_ok=True)


def reduce_pieces(
    pieces: Sequence[Piece],
    test_path: Path,
    out: Path,
    settings: ReductionSettings,
    entry: LedgerEntry,
) -> None:
    """Reduce the pieces of a record as files, and write down in each what became of it.

    A piece behind a gap has no near-stall reading: it is matched by that of the first piece, since
    the drift of amplifiers that the match makes good holds behind a gap as it does before it. A
    test.toml with these shifts is written beside its rows, with which ``reduce`` makes the same
    series.

    Parameters
    ----------
    pieces : sequence of Piece
        Those with rows, at least one.
    test_path : path
        Description of the test.
    out : path
        Series file of the longest piece that can be reduced; those of others are numbered.
    settings : ReductionSettings
        The switches.
    entry : LedgerEntry
        What is to be said of the feed in the ledger.

    Raises
    ------
    InputError
        When no piece can be reduced: the reason of the longest one.
    """
    _carry_match(pieces, test_path)
    longest_first = sorted(pieces, key=lambda piece: -piece.n_rows)
    for piece in longest_first:
        taken = any(other.series is not None for other in pieces)
        path = _numbered(out, piece.number) if taken else out
        try:
            piece.reduction = _reduced(piece, test_path, settings, entry)
        except InputError as error:
            piece.error = error
        else:
            write_series(piece.reduction.series, path)
            piece.series = path
    reason = longest_first[0].error
    if reason is not None and not any(piece.series for piece in pieces):
        kept = ", ".join(str(piece.path) for piece in pieces)
        remedy = "; ".join(filter(None, [reason.remedy, f"the raw record is kept: {kept}"]))
        raise InputError(reason.where, expected=reason.expected, found=reason.found, remedy=remedy)


def _reduced(
    piece: Piece, test_path: Path, settings: ReductionSettings, entry: LedgerEntry
) -> Reduction:
    record, test = read_raw(piece.path, piece.test or test_path)
    flags = entry.flags
    if piece.test is not None:
        flags += (f"piece {piece.number} is matched by the near-stall reading of piece 1",)
    parameters = {**entry.parameters, "piece": piece.number}
    record = record.after(replace(entry, parameters=parameters, flags=flags))
    return reduce_record(record, test, settings)


def _carry_match(pieces: Sequence[Piece], test_path: Path) -> None:
    """Give each piece behind a gap the near-stall match of the first one, if it has one."""
    test = read_test_description(test_path)
    if len(pieces) == 1 or test.near_stall_shifts:
        return
    try:
        shifts = near_stall_shifts(read_raw(pieces[0].path, test)[0], test)
    except InputError:
        return
    for piece in pieces[1:]:
        piece.test = piece.path.with_suffix(".test.toml")
        piece.test.write_text(_with_shifts(test_path, shifts), "utf-8", newline="\n")


def _with_shifts(test_path: Path, shifts: Mapping[str, float]) -> str:
    """Return a description of a test with the shifts in it."""
    # Python's shortest digits read back as the same number.
    table = [f"{json.dumps(name, ensure_ascii=False)} = {shifts[name]!r}" for name in shifts]
    above = "# No near-stall reading is in this piece of the record: these shifts are of piece 1."
    whole = [test_path.read_text("utf-8-sig").rstrip(), "", above, "[near_stall_shifts]", *table]
    return "\n".join(whole) + "\n"


def _numbered(path: Path, number: int) -> Path:
    return path if number == 1 else path.with_stem(f"{path.stem}-piece{number}")
