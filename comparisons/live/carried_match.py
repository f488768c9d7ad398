"""The near-stall match of one piece of a record for the pieces behind it, which have none."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from classic_ml.calibration import MINIMUM_NEAR_STALL_ROWS
from classic_ml.readers.test_description import TestDescription
from classic_ml.reduction import near_stall_shifts
from comparisons.cli.one_sentence import printable
from comparisons.cli.reduce import read_file
from comparisons.live.spool import Piece
from surge_core.errors import InputError

__all__ = ["carry_matches"]


def carry_matches(pieces: Sequence[Piece], test_path: Path, test: TestDescription) -> None:
    """Give each piece behind a gap the near-stall match of the piece before it that has one.

    Such a piece gets a test.toml of its own beside its rows, with the shifts in it, so that
    ``sindy-surge reduce`` makes of the two what is made of them here. The match mends the drift of
    amplifiers, which holds behind a gap as it does within a piece of any length; where the clock
    was set back, nobody knows whether it is still the same test.

    Parameters
    ----------
    pieces : sequence of Piece
        Those with rows, in their order.
    test_path : path
        The description of the test.
    test : TestDescription
        What it says.
    """
    if test.near_stall_shifts or test.file.start_s is not None:
        return
    found: tuple[Piece, dict[str, float]] | None = None
    last_s = float("-inf")
    for number, piece in enumerate(pieces):
        if piece.from_s <= last_s:
            found = None
        last_s = piece.to_s
        if _has_reading(piece, test):
            # The last piece has nobody behind it who could ask.
            wanted = any(not _has_reading(other, test) for other in pieces[number + 1 :])
            shifts = _shifts(piece, test_path) if wanted else {}
            found = (piece, shifts) if shifts else None
        elif found is not None:
            piece.matched_by = found[0].number
            piece.test = _written(piece, *found, test_path)


def _has_reading(piece: Piece, test: TestDescription) -> bool:
    reading = test.near_stall
    begins_s, ends_s = max(piece.from_s, reading.from_s), min(piece.to_s, reading.to_s)
    return round((ends_s - begins_s) * test.sample_rate_hz) + 1 >= MINIMUM_NEAR_STALL_ROWS


def _shifts(piece: Piece, test_path: Path) -> dict[str, float]:
    """Return the shifts of a piece; none where its reading would be refused."""
    try:
        return near_stall_shifts(*read_file(piece.path, test_path))
    except InputError:
        return {}


def _written(piece: Piece, origin: Piece, shifts: Mapping[str, float], test_path: Path) -> Path:
    """Write the description of the test anew, with the shifts, beside a piece."""
    text = test_path.read_text("utf-8-sig").rstrip()
    lines = [
        text,
        "",
        "# This piece of the record has no near-stall reading: the shifts are those of",
        f"# {printable(origin.path.name)}.",
        "[near_stall_shifts]",
        # Python's shortest digits read back as the same number.
        *(f"{json.dumps(name, ensure_ascii=False)} = {shift!r}" for name, shift in shifts.items()),
    ]
    path = piece.path.with_suffix(".test.toml")
    while path.exists():
        path = path.with_name(f"new-{path.name}")
    path.write_text("\n".join(lines) + "\n", "utf-8", newline="\n")
    return path
