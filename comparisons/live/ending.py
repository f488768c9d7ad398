"""The end of a session: each piece of the record is reduced as `sindy-surge reduce` would."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from classic_ml.readers import read_test_description
from classic_ml.readers.series_files import write_series
from classic_ml.records import Dropped, LedgerEntry
from classic_ml.reduction import Reduction, ReductionSettings
from comparisons.cli.reduce import reduce_file
from comparisons.live.carried_match import carry_matches
from comparisons.live.columns import FEED
from comparisons.live.session import Session
from comparisons.live.spool import Piece
from comparisons.live.state import counted
from surge_core.errors import InputError

__all__ = ["Result", "reduce_pieces"]


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
    session: Session, test: Path, out: Path, settings: ReductionSettings | None = None
) -> list[Result]:
    """Reduce the pieces of a record, the longest one that can be to the series' own name.

    Parameters
    ----------
    session : Session
        At its end.
    test : path
        Description of the test.
    out : path
        Series file; those of further pieces are numbered.
    settings : ReductionSettings, optional
        The switches; the defaults of the reduction without them.

    Returns
    -------
    list of Result
        In the order of the pieces.

    Raises
    ------
    InputError
        When no piece can be reduced: nothing was received, or the reason of the longest one.
    """
    pieces = [] if session.spool is None else session.spool.pieces
    received = [piece for piece in pieces if piece.n_rows]
    if session.spool is None or not received:
        if session.spool is not None:
            session.spool.discard()
        raise InputError(
            FEED,
            expected="rows",
            found=f"none{_left_out(session)}",
            remedy="; ".join(session.tally.remedies.values()),
        )
    carry_matches(received, test, read_test_description(test))
    entry = _entry(session)
    results: list[Result] = []
    for piece in sorted(received, key=lambda piece: -piece.n_rows):
        first = all(result.error is not None for result in results)
        path = out if first else out.with_stem(f"{out.stem}-piece{piece.number}")
        results.append(_reduced(piece, test, path, entry, settings or ReductionSettings()))
    longest = results[0]
    if longest.error is not None and all(result.error is not None for result in results):
        error = longest.error
        kept = f"the raw record is kept: {_paths(received)}"
        raise InputError(
            error.where,
            expected=error.expected,
            found=error.found,
            remedy=f"{error.remedy}; {kept}" if error.remedy else kept,
        )
    return sorted(results, key=lambda result: result.piece.number)


def _reduced(
    piece: Piece, test_path: Path, out: Path, entry: LedgerEntry, settings: ReductionSettings
) -> Result:
    try:
        _check_clock(piece, test_path)
        reduction = reduce_file(piece.path, piece.test or test_path, settings)
    except InputError as error:
        return Result(piece, error=error)
    reduction = _with_entry(reduction, _with_piece(entry, piece))
    write_series(reduction.series, out)
    return Result(piece, out, reduction)


def _check_clock(piece: Piece, test_path: Path) -> None:
    if piece.number > 1 and read_test_description(test_path).file.start_s is not None:
        raise InputError(
            f"{test_path}: [file] start_s",
            expected="none, for a piece behind a gap",
            found="a clock that is set at the first row of each file",
        )


def _with_entry(reduction: Reduction, entry: LedgerEntry) -> Reduction:
    """Tell of the feed behind what was read, in the record's ledger and in that of the series."""
    read, *steps = reduction.record.history
    history = (read, entry, *steps)
    return replace(
        reduction,
        record=replace(reduction.record, history=history),
        series=replace(reduction.series, history=history),
    )


def _entry(session: Session) -> LedgerEntry:
    pieces = [] if session.spool is None else session.spool.pieces
    order, tally = session.order, session.tally
    dropped = [Dropped("rows", order.repeated, "had already")] if order.repeated else []
    dropped += [
        Dropped("lines or frames", count, why) for why, count in sorted(tally.refused.items())
    ]
    gaps = tuple(f"piece {piece.number} begins: {piece.why}" for piece in pieces if piece.why)
    return LedgerEntry(
        "live feed",
        f"{sum(p.n_rows for p in pieces)} rows in {counted(len(pieces), 'piece')} over "
        f"{counted(session.silence.n_connections, 'connection')}",
        {
            "rows": sum(p.n_rows for p in pieces),
            "pieces": len(pieces),
            "connections": session.silence.n_connections,
            "silences": session.silence.n_silences,
            "rows_out_of_order": order.late,
        },
        tuple(dropped),
        gaps,
    )


def _with_piece(entry: LedgerEntry, piece: Piece) -> LedgerEntry:
    """Tell which piece it is, and whose near-stall reading it is matched by."""
    parameters, flags = {**entry.parameters, "piece": piece.number}, entry.flags
    if piece.matched_by:
        parameters["matched_by_piece"] = piece.matched_by
        flags += (
            f"piece {piece.number} has no near-stall reading of its own: it is matched by that of "
            f"piece {piece.matched_by}",
        )
    return replace(entry, parameters=parameters, flags=flags)


def _left_out(session: Session) -> str:
    refused = session.tally.refused
    if not refused:
        return ""
    left_out = counted(session.tally.total, "line or frame that was", "lines or frames that were")
    return f", and {left_out} left out: {', '.join(sorted(refused))}"


def _paths(pieces: list[Piece]) -> str:
    return ", ".join(str(path) for piece in pieces for path in (piece.path, piece.test) if path)
