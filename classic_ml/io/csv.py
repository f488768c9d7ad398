"""CSV tables, raw records and series alike: a header, perhaps a row of units, then the rows."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from classic_ml.description import FileLayout
from classic_ml.io.table import NOT_FINITE_REMEDY, Columns, StoredTable
from classic_ml.units import kind_of_unit
from surge_core.errors import InputError

SEPARATORS = (",", ";", "\t", "|")
TRUTHS = ("true", "false")
# Lines in which the decimal sign is looked for, and characters that hold them.
LOOKED_AT, HEAD = 100, 1 << 20
BLOCK_BYTES = 8 << 20
_DATE_REMEDY = 'write seconds, or clock = "from rate" in [file] of test.toml'
_BRACKETED = re.compile(r"[(\[{](?P<unit>[^()\[\]{}]+(?:\([a-z]+\))?)[)\]}]\s*$", re.IGNORECASE)


@dataclass(frozen=True)
class _Layout:
    """How a table is written: names, signs, lines above the numbers, units, columns of text."""

    names: tuple[str, ...]
    separator: str
    decimal: str
    skipped: int
    units: Mapping[str, str]
    truths: tuple[str, ...]
    text: tuple[str, ...]


@contextmanager
def open_csv(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open a CSV table of numbers, which pyarrow parses block by block.

    A second line that holds units is taken as such, and so is a unit in brackets at the end of a
    name. Between the cells stand commas, semicolons, tabs or bars; beside all but the first a comma
    may be the decimal sign. Arguments as :func:`classic_ml.io.formats.open_stored` has them.
    """
    found = _layout_of(file)
    left_aside = dict.fromkeys(found.text, "text")
    yield StoredTable(
        str(file), found.names, partial(_blocks, file, found), found.units, left_aside
    )


def _layout_of(file: Path) -> _Layout:
    """Return how a table is written, by its first lines."""
    with _text(file) as lines:
        start = lines.read(HEAD)
    numbered = [(n, line) for n, line in enumerate(start.split("\n")) if line.strip()][:LOOKED_AT]
    if not numbered or "\0" in start:
        raise InputError(
            str(file),
            expected="a CSV table with a header, in UTF-8",
            found="binary data, or UTF-16 text" if numbered else "an empty file",
        )
    lines = [line for _, line in numbered]
    separator = max(SEPARATORS, key=lambda sign: len(_cells(lines[0], sign)))
    names = _cells(lines[0], separator)
    if all(map(_is_number, names)):
        expected = "a table with a header and a column time_s"
        raise InputError(str(file), expected=expected, found="numbers in the first line")
    numbers = lines[-1].split()
    if len(names) == 1 < len(numbers) and all(map(_is_number, numbers)):
        expected, found = "cells between commas, semicolons, tabs or bars", "spaces between numbers"
        raise InputError(str(file), expected=expected, found=found)
    cells = [_cells(line, separator) for line in lines[1:]]
    labels = [_unit_in_brackets(name) for name in names]
    skipped = numbered[0][0] + 1
    if cells and _are_units(cells[0], len(names)):
        labels, skipped = cells.pop(0), numbered[1][0] + 1
    first = dict(zip(names, cells[0] if cells else (), strict=False))
    commas = separator != "," and any(
        "," in cell and _number(cell, ",") is not None for row in cells for cell in row
    )
    truths = tuple(name for name, cell in first.items() if cell.lower() in TRUTHS)
    return _Layout(
        tuple(names),
        separator,
        "," if commas else ".",
        skipped,
        {name: unit for name, unit in zip(names, labels, strict=True) if unit},
        truths,
        tuple(n for n, cell in first.items() if n not in truths and not _is_number(cell)),
    )


def _text(file: Path) -> Any:
    # Loggers on Windows write the degree sign in their own code page.
    with file.open("rb") as stream:
        is_utf8 = "\ufffd" not in stream.read(HEAD).decode("utf-8", "replace")[:-1]
    encoding = "utf-8-sig" if is_utf8 else "cp1252"
    return file.open(encoding=encoding, errors="replace", newline=None)


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a row, without the spaces and quotes around them."""
    rows = csv.reader([line.rstrip("\r\n")], delimiter=separator)
    return [cell.strip() for cell in next(rows, [])]


def _are_units(cells: list[str], n_columns: int) -> bool:
    has_units = len(cells) == n_columns and any(map(kind_of_unit, cells))
    return has_units and not any(map(_is_number, cells))


def _unit_in_brackets(name: str) -> str:
    """Return the unit that ends the name of a column: P25 (C) names a rake, T25 (C) a unit."""
    match = _BRACKETED.search(name)
    unit = match["unit"].strip() if match is not None else ""
    is_rake = len(unit) == 1 and unit != "s" and not name.lower().startswith("t")
    return unit if unit and not is_rake and kind_of_unit(unit) else ""


def _is_number(cell: str) -> bool:
    return _number(cell, ".") is not None or _number(cell, ",") is not None


def _number(cell: str, decimal: str) -> float | None:
    if "_" in cell or (decimal == "," and "." in cell):
        # Python takes 1_000 for a number; a point between thousands is no decimal sign.
        return None
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return None


def _is_date(cell: str) -> bool:
    """Return whether a cell is a date, or a time of the day."""
    return re.match(r"\d+([-/.:])\d+\1\d+", cell) is not None


def _blocks(file: Path, found: _Layout, names: tuple[str, ...]) -> Iterator[Columns]:
    """Yield the rows as pyarrow reads them; where it stumbles, say why."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    n_rows = 0
    try:
        with arrow_csv.open_csv(
            file,
            read_options=arrow_csv.ReadOptions(
                block_size=BLOCK_BYTES, column_names=list(found.names), skip_rows=found.skipped
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=found.separator),
            convert_options=arrow_csv.ConvertOptions(
                column_types={n: pa.bool_() if n in found.truths else pa.float64() for n in names},
                null_values=[],
                include_columns=list(names),
                decimal_point=found.decimal,
            ),
        ) as reader:
            for batch in reader:
                n_rows += batch.num_rows
                yield tuple(column.to_numpy(zero_copy_only=False) for column in batch.columns)
    except pa.ArrowException as error:
        raise _first_fault(file, found, names) or error from None
    if n_rows == 0:
        raise InputError(str(file), expected="rows below the header", found="none")


def _first_fault(file: Path, found: _Layout, names: tuple[str, ...]) -> InputError | None:
    """Return what is wrong with the first row of another length, or the first cell of a column."""
    with _text(file) as lines:
        filled = (line for line in islice(lines, found.skipped, None) if line.strip())
        for row, line in enumerate(filled, start=1):
            cells = _cells(line, found.separator)
            if len(cells) != len(found.names):
                return InputError(
                    str(file),
                    expected=f"{len(found.names)} values in every row",
                    found=f"{len(cells)} in row {row}",
                    remedy="the file was cut short or edited there, has decimal commas between "
                    "commas, or lines above its header: take these away",
                )
            for name, cell in zip(found.names, cells, strict=True):
                is_truth = name in found.truths and cell.lower() in TRUTHS
                flag = cell.lower() in ("yes", "no", "on", "off")
                if name in names and not is_truth and _number(cell, found.decimal) is None:
                    return InputError(
                        f"{file}: column {name}",
                        expected="0 or 1" if flag else "a finite number in every row",
                        found=f"{cell!r} in row {row}" if cell else f"an empty cell in row {row}",
                        remedy="write 0 or 1 in every row"
                        if flag
                        else _DATE_REMEDY
                        if _is_date(cell)
                        else NOT_FINITE_REMEDY,
                    )
    return None
