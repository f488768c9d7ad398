"""The one table: a line for each way of doing a thing, and a note for every number that is not."""

from __future__ import annotations

from dataclasses import dataclass
from string import ascii_lowercase
from textwrap import fill
from typing import Any

import numpy as np
from efficiency import middle_half
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
# A number, a number with its standard error, or why there is none.
Cell = float | tuple[float, float] | str

SAYS_NOTHING = "too few records, or a system that does not tell its memory, to say anything"
NAME_WIDTH, NOTE_WIDTH = 37, 116


@dataclass(frozen=True)
class Column:
    """One column.

    Parameters
    ----------
    key : str
        Of the cells.
    title : str
        As printed.
    width : int
        In characters, the letter of a note included.
    form : str
        Format of a number.
    """

    key: str
    title: str
    width: int
    form: str


COLUMNS = (
    Column("right_percent", "right %", 8, ".1f"),
    Column("false_percent", "false %", 8, ".1f"),
    Column("tau_error_percent", "tau err %", 10, ".3g"),
    Column("error_over_bound", "/ bound", 8, ".2f"),
    Column("efficiency", "efficiency", 13, ".2f"),
    Column("differs", "differs", 9, ".1e"),
    Column("times_own", "time x own", 11, ".3g"),
    Column("megabytes", "MB", 8, ".2f"),
    Column("floats", "floats", 7, ".0f"),
    Column("times_real_time", "x real time", 12, ".3g"),
)
LEGEND = (
    "n: records or tests. right: exact supports found, or truth within the set named. false:",
    "records with nothing missing on which something is named. tau err: rms relative error of tau;",
    "/ bound: rms of error over the Cramer-Rao bound of each record; efficiency:",
    "1 / mean((error / bound)^2), paired with an estimate that attains the bound. differs: largest",
    "difference of phi or psi' over its range. time x own: processor time, one thread, by that of",
    "the first line of the block at the same length, in turns in one run; mean of the middle half.",
    "MB, floats: growth of resident memory at its peak (VmHWM less VmRSS before), median of the",
    "calls, and the same in float64 a sample. x real time: length of the record by processor time.",
)


@dataclass(frozen=True)
class Line:
    """One line of the table.

    Parameters
    ----------
    block : str
        "ml", "sparse", "diagnosis" or "reduction".
    what : str
        Who did it.
    n : int
        Records or tests behind it.
    cells : dict
        By key of a column.
    note : str
        What a reader should know of this line.
    """

    block: str
    what: str
    n: int
    cells: dict[str, Cell]
    note: str = ""

    @classmethod
    def of(cls, values: dict[str, Any]) -> Line:
        """Return the line that was written as JSON."""
        cells = {k: tuple(v) if isinstance(v, list) else v for k, v in values["cells"].items()}
        return cls(**{**values, "cells": cells})

    def numbers(self) -> dict[str, Any]:
        """Return what is known as one flat row, with None and a reason for the rest."""
        row: dict[str, Any] = {"block": self.block, "what": self.what, "n": self.n}
        why: dict[str, str] = {}
        for column in COLUMNS:
            cell = cell_of(self, column.key)
            value, error = cell if isinstance(cell, tuple) else (cell, None)
            row[column.key] = None if isinstance(value, str) else value
            if error is not None:
                row[f"{column.key}_stderr"] = error if np.isfinite(error) else None
            if isinstance(value, str):
                why[column.key] = value
        return {**row, "why_not": why, "note": self.note}


def cell_of(line: Line, key: str) -> Cell:
    """Return a cell; one that is no number is given a reason.

    Raises
    ------
    KeyError
        When a line neither fills a column nor says why not.
    """
    cell = line.cells[key]
    value = cell[0] if isinstance(cell, tuple) else cell
    if isinstance(value, str) or np.isfinite(value):
        return cell
    return SAYS_NOTHING


def absent(why: str, *keys: str) -> dict[str, Cell]:
    """Return one reason for several columns; for all of them without keys."""
    return dict.fromkeys(keys or [column.key for column in COLUMNS], why)


def costs(
    seconds: FloatArray,
    own_seconds: FloatArray,
    peak_bytes: FloatArray,
    n_samples: FloatArray,
    period_s: float,
) -> dict[str, Cell]:
    """Return the four cells of time and memory.

    Parameters
    ----------
    seconds, own_seconds : ndarray of shape (n,)
        Of the same records, taken in turn.
    peak_bytes : ndarray of shape (m,)
        Growth of memory; empty where the system does not tell.
    n_samples : ndarray of shape (n,)
        Lengths of the records.
    period_s : float
        Sample period.
    """
    return {
        "times_own": middle_half(seconds / own_seconds),
        "times_real_time": times_real_time(period_s * n_samples, seconds),
        **memory(peak_bytes, float(np.median(n_samples))),
    }


def times_real_time(record_s: FloatArray, seconds: FloatArray) -> float:
    """Return the length of records by the time that was spent; nan where no clock moved."""
    spent = middle_half(seconds)
    return middle_half(record_s) / spent if spent > 0.0 else float("nan")


def memory(peak_bytes: FloatArray, n_samples: float) -> dict[str, Cell]:
    """Return the two cells of memory."""
    grown = _median(peak_bytes)
    return {"megabytes": grown / 1e6, "floats": grown / 8.0 / n_samples}


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else float("nan")


def root_mean_square(values: FloatArray) -> float:
    """Return the rms of the finite values, nan without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def header() -> str:
    """Return the two lines above the table."""
    text = f"{'':<10}{'':<{NAME_WIDTH}}{'n':>5}"
    text += "".join(f"{c.title:>{c.width}}" for c in COLUMNS)
    return f"{text}\n{'-' * len(text)}"


class Notes:
    """Reasons and remarks, each with one letter."""

    def __init__(self) -> None:
        self._letters: dict[str, str] = {}

    def letter(self, text: str) -> str:
        """Return the letter of a note, a new one for a new note."""
        if text not in self._letters:
            number = len(self._letters)
            first, second = divmod(number, len(ascii_lowercase))
            prefix = ascii_lowercase[first - 1] if first else ""
            self._letters[text] = prefix + ascii_lowercase[second]
        return self._letters[text]

    def text(self) -> str:
        """Return all notes, each from a line of its own on."""
        return "\n".join(
            fill(text, NOTE_WIDTH, initial_indent=f"  {letter:<2} ", subsequent_indent=" " * 5)
            for text, letter in self._letters.items()
        )


def printed(line: Line, notes: Notes) -> str:
    """Return one line of the table, and file its notes."""
    name = f"{line.what} [{notes.letter(line.note)}]" if line.note else line.what
    text = f"{line.block:<10}{name:<{NAME_WIDTH}}{line.n or '-':>5}"
    for column in COLUMNS:
        text += f"{_shown(cell_of(line, column.key), column.form, notes):>{column.width}}"
    return text


def _shown(cell: Cell, form: str, notes: Notes) -> str:
    if isinstance(cell, str):
        return f"- {notes.letter(cell)}"
    value, error = cell if isinstance(cell, tuple) else (cell, float("nan"))
    text = f"{value:{form}}"
    if "e+" in text:
        # A ratio in the thousands has four digits; no power of ten for that.
        text = f"{value:.0f}"
    return f"{text} ± {error:{form}}" if np.isfinite(error) else text
