"""The pieces of a record: kept on disk as they come, read like files, reduced like files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from classic_ml import write_series
from classic_ml.readers import TestDescription, read_raw, read_test_description
from classic_ml.records import LedgerEntry, Record
from classic_ml.reduction import Reduction, ReductionSettings, near_stall_shifts, reduce_record
from surge_core.errors import InputError

__all__ = ["FEED", "Piece", "Pieces", "Result", "read_rows", "reduce_pieces"]

# What the feed is called in messages.
FEED = "the feed"


@dataclass
class Piece:
    """Rows without a gap.

    Parameters
    ----------
    number : int
        From 1.
    path : path
        Its raw record.
    why : str
        Why the record was cut before it.
    n_rows : int
        How many rows it has.
    matched_by : int
        Number of the piece whose near-stall reading it is matched by; 0: its own.
    test : path, optional
        A description of its own, where it is matched by another piece.
    """

    number: int
    path: Path
    why: str = ""
    n_rows: int = 0
    matched_by: int = 0
    test: Path | None = None


class Pieces:
    """Write rows to disk as they come, a file a piece.

    Parameters
    ----------
    path : path
        File of the first piece, which must not exist; further pieces are numbered.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO | None = None
        self.head = b""
        self.pieces: list[Piece] = []

    def begin(self, why: str) -> None:
        """Begin the next piece with the header.

        Parameters
        ----------
        why : str
            Why the record is cut here.
        """
        self.close()
        number = len(self.pieces) + 1
        stem = self._path.stem if number == 1 else f"{self._path.stem}-piece{number}"
        path = self._path.with_stem(stem)
        while path.exists():
            # Left from another session, whose rows cannot be measured again.
            path = path.with_stem(f"{path.stem}-new")
        self._file = path.open("xb", buffering=0)
        self._file.write(self.head)
        self.pieces.append(Piece(number, path, why))

    def append(self, lines: Sequence[bytes]) -> None:
        """Write rows to the last piece.

        Parameters
        ----------
        lines : sequence of bytes
            Rows without their line ends.
        """
        assert self._file is not None
        self._file.write(b"\n".join(lines) + b"\n")
        self.pieces[-1].n_rows += len(lines)

    def close(self) -> None:
        """Close the file of the last piece."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def discard(self) -> None:
        """Remove the files of all pieces."""
        self.close()
        for piece in self.pieces:
            for path in (piece.path, piece.test):
                if path is not None:
                    path.unlink(missing_ok=True)


def read_rows(head: bytes, lines: Iterable[bytes], test: TestDescription, scratch: Path) -> Record:
    """Return rows of a feed as the record that the same lines in a file are read as.

    Parameters
    ----------
    head : bytes
        Header, and units where there are some, with their line ends.
    lines : iterable of bytes
        Rows without their line ends.
    test : TestDescription
        The test.
    scratch : path
        A file for them.

    Raises
    ------
    InputError
        What the reader of files refuses, said of the feed.
    """
    scratch.write_bytes(head + b"\n".join(lines) + b"\n")
    try:
        record, _ = read_raw(scratch, test)
    except InputError as error:
        raise InputError(
            error.where.replace(str(scratch), FEED),
            expected=error.expected,
            found=error.found,
            remedy=error.remedy,
        ) from None
    return replace(record, source=FEED)


@dataclass(frozen=True)
class Result:
    """What became of one piece.

    Parameters
    ----------
    piece : Piece
        The piece.
    series : path or None
        The series file; None where the piece cannot be reduced.
    reduction : Reduction or None
        The reduction behind it.
    error : InputError or None
        Why it cannot be.
    """

    piece: Piece
    series: Path | None = None
    reduction: Reduction | None = None
    error: InputError | None = None


def reduce_pieces(
    pieces: Sequence[Piece],
    test_path: Path,
    out: Path,
    settings: ReductionSettings,
    entry: LedgerEntry,
) -> list[Result]:
    """Reduce the pieces of a record as files, the longest one that can be to the series' own name.

    A piece behind a gap has no near-stall reading: it is matched by that of the piece before it,
    and a test.toml with these shifts is written beside its rows, with which ``reduce`` makes the
    same series. The match makes good the drift of amplifiers, which holds behind a gap as it does
    within a piece; where the clock was set back it is not known to be the same test.

    Parameters
    ----------
    pieces : sequence of Piece
        Those with rows, at least one.
    test_path : path
        Description of the test.
    out : path
        Series file; those of further pieces are numbered.
    settings : ReductionSettings
        The switches.
    entry : LedgerEntry
        What is to be said of the feed in the ledger.

    Returns
    -------
    list of Result
        In the order of the pieces.

    Raises
    ------
    InputError
        When no piece can be reduced: the reason of the longest one.
    """
    _carry_matches(pieces, test_path)
    results: dict[int, Result] = {}
    for piece in sorted(pieces, key=lambda piece: -piece.n_rows):
        taken = any(result.error is None for result in results.values())
        path = out.with_stem(f"{out.stem}-piece{piece.number}") if taken else out
        results[piece.number] = _reduced(piece, test_path, path, settings, entry)
    if all(result.error is not None for result in results.values()):
        error = next(iter(results.values())).error
        assert error is not None
        kept = ", ".join(str(piece.path) for piece in pieces)
        raise InputError(
            error.where,
            expected=error.expected,
            found=error.found,
            remedy="; ".join(filter(None, [error.remedy, f"the raw record is kept: {kept}"])),
        )
    return [results[piece.number] for piece in pieces]


def _reduced(
    piece: Piece, test_path: Path, out: Path, settings: ReductionSettings, entry: LedgerEntry
) -> Result:
    flags, parameters = entry.flags, {**entry.parameters, "piece": piece.number}
    if piece.matched_by:
        parameters["matched_by_piece"] = piece.matched_by
        flags += (
            f"piece {piece.number} has no near-stall reading of its own: it is matched by that of "
            f"piece {piece.matched_by}",
        )
    try:
        record, test = read_raw(piece.path, piece.test or test_path)
        if piece.number > 1 and test.file.start_s is not None:
            raise InputError(
                f"{test_path}: [file] start_s",
                expected="none, for a piece behind a gap",
                found="a clock that is set at the first row of each file",
            )
        record = record.after(replace(entry, parameters=parameters, flags=flags))
        reduction = reduce_record(record, test, settings)
    except InputError as error:
        return Result(piece, error=error)
    write_series(reduction.series, out)
    return Result(piece, out, reduction)


def _carry_matches(pieces: Sequence[Piece], test_path: Path) -> None:
    """Give each piece behind a gap the near-stall match of the piece before it that has one."""
    test = read_test_description(test_path)
    if len(pieces) < 2 or test.near_stall_shifts or test.file.start_s is not None:
        return
    origin, shifts, last_s = 0, dict[str, float](), float("-inf")
    for piece in pieces:
        try:
            record, _ = read_raw(piece.path, test)
        except InputError:
            continue
        if record.start_s <= last_s:
            shifts = {}
        last_s = record.time_at_s(record.n_samples - 1)
        if shifts and record.start_s > test.near_stall.from_s + 0.5 / record.sample_rate_hz:
            piece.matched_by = origin
            piece.test = _written(piece, shifts, origin, test_path)
            continue
        try:
            origin, shifts = piece.number, near_stall_shifts(record, test)
        except InputError:
            shifts = {}


def _written(piece: Piece, shifts: Mapping[str, float], origin: int, test_path: Path) -> Path:
    """Write the description of the test with the shifts in it beside a piece."""
    lines = [
        test_path.read_text("utf-8-sig").rstrip(),
        "",
        "# This piece of the record has no near-stall reading: the shifts are those of",
        f"# piece {origin}.",
        "[near_stall_shifts]",
        # Python's shortest digits read back as the same number.
        *(f"{json.dumps(name, ensure_ascii=False)} = {shift!r}" for name, shift in shifts.items()),
    ]
    path = piece.path.with_suffix(".test.toml")
    path.write_text("\n".join(lines) + "\n", "utf-8", newline="\n")
    return path
