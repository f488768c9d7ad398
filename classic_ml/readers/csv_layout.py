"""What stands above the numbers of a CSV table, and how its cells are separated."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

from classic_ml.readers.iso_stamps import Stamps, stamp_of, stamps_like
from classic_ml.units import is_unit_label, kind_of_unit, unit_in_brackets
from surge_core.errors import InputError

__all__ = [
    "LOOKED_AT",
    "CsvLayout",
    "cells_of",
    "csv_layout",
    "decimal_sign",
    "lines_of",
    "number_of",
    "row_of_units",
    "separator_of",
]

# More than any table has columns for: a file without line ends is one line.
LONGEST_LINE = 1 << 20
SEPARATORS = (",", ";", "\t")
# Rows in which the decimal sign is looked for.
LOOKED_AT = 100
_WHAT = "a CSV table with a header"
_LINE_END = re.compile(rb"[\r\n]")
_WITH_COMMA = re.compile(r"[+-]?(?:[0-9]+,[0-9]*|,[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WITH_POINT = re.compile(r"[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class CsvLayout:
    """How a CSV table is written.

    Parameters
    ----------
    names : tuple of str
        The columns as the header has them.
    separator, decimal : str
        Between cells, and in numbers.
    units : mapping of str to str
        Units that the file states.
    header_rows : int
        Lines above the numbers.
    stamps : mapping of str to Stamps
        Columns of dates.
    """

    names: tuple[str, ...]
    separator: str
    decimal: str
    units: Mapping[str, str]
    header_rows: int
    stamps: Mapping[str, Stamps]

    def number(self, name: str, cell: str) -> float | None:
        """Return the number in a cell of a column; None where there is none."""
        if name in self.stamps:
            return self.stamps[name].seconds(cell)
        if self.decimal == ".":
            return number_of(cell)
        # A point between thousands would be taken for the other sign.
        return None if "." in cell else number_of(cell.replace(",", "."))


def csv_layout(file: Path, names: tuple[str, ...] | None = None) -> CsvLayout:
    """Look at the head of a CSV table.

    Parameters
    ----------
    file : path
        An existing file.
    names : tuple of str, optional
        What to call the columns, where the header will not do.

    Raises
    ------
    InputError
        When the file is empty, not text, has no header, or writes its numbers in two ways.
    """
    header = _header_line(file)
    separator = separator_of(header)
    written = _names(file, header, separator)
    names = written if names is None else names
    with file.open(encoding="utf-8", errors="replace", newline="") as opened:
        below = (line for line in islice(lines_of(file, opened), 1, None) if line.strip())
        head = list(islice(below, LOOKED_AT + 1))
    unit_cells = row_of_units(head[0] if head else "", len(names), separator)
    rows = [cells_of(line, separator) for line in head[1 if unit_cells else 0 :]]
    if unit_cells:
        units = {name: cell for name, cell in zip(names, unit_cells, strict=True) if cell}
    else:
        bracketed = {name: unit_in_brackets(name) for name in names}
        units = {name: unit for name, unit in bracketed.items() if unit}
    first = rows[0] if rows and len(rows[0]) == len(names) else []
    stamps = {
        name: found
        for name, cell in zip(names, first, strict=False)
        if (found := stamps_like(cell)) is not None
    }
    return CsvLayout(
        names,
        separator,
        decimal_sign(file, rows, separator),
        {**units, **dict.fromkeys(stamps, "s")},
        2 if unit_cells else 1,
        stamps,
    )


def lines_of(file: Path, opened: TextIO) -> Iterator[str]:
    """Yield the lines of a text, none of which is read beyond the longest that may be."""
    while line := opened.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise _too_long(file)
        yield line


def cells_of(line: str, separator: str = ",") -> list[str]:
    """Return the cells of a row, without the spaces and quotes around them."""
    line = line.rstrip("\r\n")
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
        except (csv.Error, StopIteration):
            pass
    return [cell.strip().strip('"') for cell in line.split(separator)]


def number_of(cell: str) -> float | None:
    """Return the number that a text is; None where it is none."""
    try:
        # Python takes 1_000 for a number.
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def row_of_units(line: str, n_columns: int, separator: str = ",") -> tuple[str, ...]:
    """Return the cells of a line that holds units alone; empty for another line.

    Parameters
    ----------
    line : str
        The line below the header.
    n_columns : int
        Columns of the table.
    separator : str
        Between its cells.
    """
    cells = tuple(cell.strip() for cell in line.rstrip("\r\n").replace('"', "").split(separator))
    if len(cells) != n_columns:
        return ()
    are_units = any(map(kind_of_unit, cells)) and all(map(is_unit_label, cells))
    return cells if are_units else ()


def _header_line(file: Path) -> str:
    with file.open("rb") as opened:
        head = opened.read(LONGEST_LINE + 1).removeprefix(b"\xef\xbb\xbf")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(str(file), expected=_WHAT, found="UTF-16 text", remedy="save it as UTF-8")
    line = _LINE_END.split(head, maxsplit=1)[0]
    if not line.strip():
        raise InputError(str(file), expected=_WHAT, found="an empty file")
    if len(line) > LONGEST_LINE:
        raise _too_long(file)
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        # Loggers on Windows write the degree sign so. Binary data have control characters too.
        text = line.decode("cp1252", errors="replace")
    if any(ord(letter) < 32 and letter != "\t" for letter in text):
        raise InputError(str(file), expected=_WHAT, found="binary data")
    return text


def separator_of(header: str) -> str:
    """Return what stands between the names: of a comma and another, whichever makes more of them.

    A line that quotes spoil is left to whoever reads the names.

    Parameters
    ----------
    header : str
        The line of the names.
    """
    return max(SEPARATORS, key=lambda separator: len(cells_of(header, separator)))


def _names(file: Path, header: str, separator: str) -> tuple[str, ...]:
    try:
        names = tuple(name.strip() for name in next(csv.reader([header], delimiter=separator)))
    except csv.Error:
        raise InputError(
            str(file), expected=_WHAT, found="a name of more than 131072 letters"
        ) from None
    if any(_all_numbers(header, sign) for sign in SEPARATORS):
        raise InputError(
            str(file),
            expected="a table with a header and a column time_s",
            found="numbers in the first line",
            remedy="write the names of the columns above them",
        )
    return names


def _all_numbers(line: str, separator: str) -> bool:
    """Tell whether a line holds numbers alone, of whichever country."""
    cells = cells_of(line, separator)
    plain = cells if separator == "," else [cell.replace(",", ".") for cell in cells]
    return all(number_of(cell) is not None for cell in plain)


def decimal_sign(file: Path, rows: list[list[str]], separator: str) -> str:
    """Return the sign in the numbers of the first rows; between commas it can be a point alone.

    Parameters
    ----------
    file : path
        What to call the file.
    rows : list of list of str
        Cells of the first rows.
    separator : str
        What stands between them.

    Raises
    ------
    InputError
        When some numbers have one and some the other.
    """
    if separator == ",":
        return "."
    cells = [cell for row in rows for cell in row if stamp_of(cell) is None]
    comma = next((cell for cell in cells if _WITH_COMMA.fullmatch(cell)), "")
    point = next((cell for cell in cells if _WITH_POINT.fullmatch(cell)), "")
    if comma and point:
        raise InputError(
            str(file),
            expected="one decimal sign in all numbers",
            found=f"'{comma}' and '{point}'",
            remedy="save it with points in numbers and nothing between thousands",
        )
    return "," if comma else "."


def _too_long(file: Path) -> InputError:
    return InputError(
        str(file),
        expected=_WHAT,
        found=f"a line of more than {LONGEST_LINE:,} letters",
        remedy="does each row end with a line feed?",
    )
