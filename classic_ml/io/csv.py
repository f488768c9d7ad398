"""CSV tables, raw records and series alike: a header, perhaps a row of units, then the rows."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.table import Columns, StoredTable
from classic_ml.units import kind_of_unit
from surge_core.errors import InputError

__all__ = ["open_csv"]

SEPARATORS = (",", ";", "\t")
# Lines in which the decimal sign is looked for.
LOOKED_AT = 100
LONGEST_LINE = 1 << 20
BLOCK_BYTES = 8 << 20
_BRACKETED = re.compile(r"[(\[{](?P<unit>[^()\[\]{}]+(?:\([a-z]+\))?)[)\]}]\s*$", re.IGNORECASE)


@dataclass(frozen=True)
class _Layout:
    """How a table is written: names, signs, lines above the numbers, dates, true and false."""

    names: tuple[str, ...]
    separator: str
    decimal: str
    skipped: int
    units: Mapping[str, str]
    dates: Mapping[str, np.datetime64]
    truths: tuple[str, ...]


@contextmanager
def open_csv(file: Path, layout: FileLayout, lenient: bool = False) -> Iterator[StoredTable]:
    """Open a CSV table of numbers, which pyarrow parses block by block.

    A second line that holds units is taken as such, and so is a unit in brackets at the end of a
    name. Between the cells stand commas, semicolons or tabs; beside the latter two a comma may be
    the decimal sign. A column of dates (ISO 8601) counts from its first row. Arguments as
    :func:`classic_ml.io.formats.open_stored` has them.
    """
    found = _layout_of(file, lenient)
    read = partial(_blocks, file, found, lenient)
    yield StoredTable(str(file), found.names, read, found.units, dates=found.dates)


def _layout_of(file: Path, lenient: bool) -> _Layout:
    """Return how a table is written, by its first lines."""
    numbered = _head(file)
    lines = [line for _, line in numbered]
    separator = max(SEPARATORS, key=lambda sign: len(_cells(lines[0], sign)))
    names = _cells(lines[0], separator)
    if all(map(_is_number, names)):
        raise InputError(
            str(file),
            expected="a table with a header and a column time_s",
            found="numbers in the first line",
            remedy="write the names of the columns above them",
        )
    if lenient:
        names = [
            name if name and name not in names[:k] else f"{name} (column {k + 1})".strip()
            for k, name in enumerate(names)
        ]
    cells = [_cells(line, separator) for line in lines[1:]]
    labels = [_unit_in_brackets(name) for name in names]
    skipped = numbered[0][0] + 1
    if cells and _are_units(cells[0], len(names)):
        labels, skipped = cells.pop(0), numbered[1][0] + 1
    first = dict(zip(names, cells[0] if cells else (), strict=False))
    commas = separator != "," and any(
        "," in cell and _number(cell, ",") is not None for row in cells for cell in row
    )
    dates = {name: date for name, cell in first.items() if (date := _date(cell)) is not None}
    return _Layout(
        tuple(names),
        separator,
        "," if commas else ".",
        skipped,
        {name: unit for name, unit in zip(names, labels, strict=True) if unit},
        dates,
        tuple(name for name, cell in first.items() if cell.lower() in ("true", "false")),
    )


def _head(file: Path) -> list[tuple[int, str]]:
    """Return the first lines that are not empty with their numbers, or refuse what is no text."""
    with file.open("rb") as opened:
        start = opened.read(LONGEST_LINE)
    found = ""
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        found = "UTF-16 text, which is to be saved as UTF-8"
    elif not start.strip():
        found = "an empty file"
    elif b"\0" in start or not any(end in start for end in (b"\n", b"\r")):
        found = "binary data, or a text without ends of lines"
    if found:
        raise InputError(str(file), expected="a CSV table with a header", found=found)
    with _text(file) as lines:
        numbered = ((number, line) for number, line in enumerate(lines) if line.strip())
        return list(islice(numbered, LOOKED_AT))


def _text(file: Path) -> Any:
    # Loggers on Windows write the degree sign in their own code page.
    return file.open(encoding="utf-8-sig", errors="replace", newline=None)


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


def _date(cell: str) -> np.datetime64 | None:
    """Return a date with a time of day, in UTC if it has a zone. A day alone is no clock."""
    try:
        date = datetime.fromisoformat(cell) if ":" in cell else None
    except ValueError:
        return None
    if date is not None and date.tzinfo is not None:
        date = date.astimezone(UTC).replace(tzinfo=None)
    return None if date is None else np.datetime64(date)


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


def _blocks(file: Path, found: _Layout, lenient: bool, names: tuple[str, ...]) -> Iterator[Columns]:
    """Yield the rows as pyarrow reads them; where it stumbles, say why."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    plain = pa.string() if lenient else pa.float64()
    types = {name: pa.bool_() if name in found.truths else plain for name in names}
    if not lenient:
        types |= {name: pa.timestamp("ns") for name in found.dates if name in names}
    short: list[Any] = []

    def row_of_another_length(row: Any) -> str:
        short.append(row)
        return "skip"

    n_rows = 0
    try:
        with arrow_csv.open_csv(
            file,
            read_options=arrow_csv.ReadOptions(
                block_size=BLOCK_BYTES,
                column_names=list(found.names),
                skip_rows=found.skipped,
                # The handler below is given text, and bytes that are none must not stop it.
                encoding="latin-1" if lenient else "utf8",
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=found.separator,
                invalid_row_handler=row_of_another_length if lenient else None,
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types,
                null_values=[],
                include_columns=list(names),
                decimal_point=found.decimal,
            ),
        ) as reader:
            for batch in reader:
                n_rows += batch.num_rows
                columns = zip(names, batch.columns, strict=True)
                yield tuple(_values(found, name, column) for name, column in columns)
    except pa.ArrowException as error:
        raise _first_fault(file, found, names) or error from None
    if short:
        raise _first_fault(file, found, ()) or InputError(str(file), expected="rows", found="none")
    if n_rows == 0:
        raise InputError(str(file), expected="rows below the header", found="none")


def _values(found: _Layout, name: str, column: Any) -> Any:
    """Return a column as numbers or dates; of text, NaN for what is none."""
    import pandas as pd
    import pyarrow as pa

    if not pa.types.is_string(column.type):
        return column.to_numpy(zero_copy_only=False)
    text = column.to_pandas()
    if name in found.dates:
        dates = pd.to_datetime(text, errors="coerce", format="ISO8601", utc=True)
        return dates.dt.tz_localize(None).to_numpy()
    plain = text.str.replace(found.decimal, ".", regex=False)
    return pd.to_numeric(plain, errors="coerce").to_numpy(dtype=np.float64)


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
                    remedy="the file was cut short or edited there, or has decimal commas between "
                    "commas",
                )
            for name, cell in zip(found.names, cells, strict=True):
                good = _date(cell) if name in found.dates else _number(cell, found.decimal)
                if name in names and good is None and name not in found.truths:
                    what = "date and time" if name in found.dates else "finite number"
                    return InputError(
                        f"{file}: column {name}",
                        expected=f"a {what} in every row",
                        found=f"{cell!r} in row {row}" if cell else f"an empty cell in row {row}",
                        remedy="cut the record there or repair the channel; save it with points "
                        "in all numbers and nothing between thousands",
                    )
    return None
