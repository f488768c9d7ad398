"""Raw records as CSV: a header, perhaps a row of units, then one row a sample."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.table import Columns, RawFile, check_unique
from classic_ml.units import is_unit_label, kind_of_unit, unit_in_brackets
from surge_core.errors import InputError

__all__ = ["open_csv", "row_of_units", "separator_of"]

SEPARATORS = (",", ";", "\t")
# Rows in which the decimal sign is looked for.
LOOKED_AT = 100
LONGEST_LINE = 1 << 20
BLOCK_BYTES = 8 << 20
_WHAT = "a CSV table with a header"


@dataclass(frozen=True)
class _Layout:
    """How a table is written: its columns, signs, units, rows above the numbers, and its dates."""

    names: tuple[str, ...]
    separator: str
    decimal: str
    units: Mapping[str, str]
    header_rows: int
    # By column of dates, the first of them.
    stamps: Mapping[str, datetime]


def open_csv(file: Path, layout: FileLayout, lenient: bool = False) -> RawFile:
    """Open a CSV table of numbers, which pyarrow parses block by block.

    Parameters
    ----------
    file : path
        An existing file. A second line that holds units alone is taken as such, and so is a unit
        in brackets at the end of a name. Between the cells stand commas, semicolons or tabs; beside
        the latter two a comma may be the decimal sign. A column of dates (ISO 8601) counts from
        its first row.
    layout : FileLayout
        Which column is the clock.
    lenient : bool
        Cells that are no numbers are NaN, and doubled names are numbered.

    Raises
    ------
    InputError
        When the file is empty, not text, cut short, or holds something other than numbers.
    """
    found, renamed = _layout_of(file, lenient)

    def read(names: tuple[str, ...], rows: int) -> Iterator[Columns]:
        n_rows = 0
        for block in _blocks(file, found, names, lenient):
            n_rows += block[0].size if block else 0
            yield block
        if n_rows == 0:
            raise InputError(str(file), expected="rows below the header", found="none")

    stamps = {
        name: f"seconds from the first sample at {first.isoformat()}"
        for name, first in found.stamps.items()
    }
    return RawFile(
        str(file),
        found.names,
        read,
        {**found.units, **dict.fromkeys(stamps, "s")},
        clock=stamps.get(layout.time, ""),
        unusable=renamed,
        stamps=stamps,
    )


def separator_of(header: str) -> str:
    """Return what stands between the names: of comma, semicolon and tab what makes most of them."""
    return max(SEPARATORS, key=lambda separator: len(_cells(header, separator)))


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
    cells = tuple(_cells(line, separator))
    if len(cells) != n_columns:
        return ()
    are_units = any(map(kind_of_unit, cells)) and all(map(is_unit_label, cells))
    return cells if are_units else ()


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a row, without the spaces and quotes around them."""
    rows = csv.reader([line.rstrip("\r\n")], delimiter=separator)
    return [cell.strip() for cell in next(rows, [])]


def _layout_of(file: Path, lenient: bool) -> tuple[_Layout, dict[str, str]]:
    """Return how a table is written, and the columns that had to be renamed."""
    head = _head(file)
    separator = separator_of(head[0])
    names, renamed = tuple(_cells(head[0], separator)), dict[str, str]()
    if all(_number(name, ",") is not None for name in names):
        raise InputError(
            str(file),
            expected="a table with a header and a column time_s",
            found="numbers in the first line",
            remedy="write the names of the columns above them",
        )
    if lenient:
        names, renamed = _distinct(names)
    check_unique(str(file), names)
    unit_cells = row_of_units(head[1] if len(head) > 1 else "", len(names), separator)
    rows = [_cells(line, separator) for line in head[2 if unit_cells else 1 :]]
    labels = unit_cells or tuple(map(unit_in_brackets, names))
    stamps = {
        name: stamp
        for name, cell in zip(names, rows[0] if rows else (), strict=False)
        if (stamp := _stamp(cell)) is not None
    }
    layout = _Layout(
        names,
        separator,
        _decimal_sign(file, rows, separator),
        {name: label for name, label in zip(names, labels, strict=True) if label},
        2 if unit_cells else 1,
        stamps,
    )
    return layout, renamed


def _head(file: Path) -> list[str]:
    """Return the header and the first rows, or refuse what is no text."""
    with file.open("rb") as opened:
        start = opened.read(LONGEST_LINE)
    found = ""
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(str(file), expected=_WHAT, found="UTF-16 text", remedy="save it as UTF-8")
    if not start.strip():
        found = "an empty file"
    elif b"\0" in start or not any(end in start for end in (b"\n", b"\r")):
        found = "binary data, or a text without ends of lines"
    if found:
        raise InputError(str(file), expected=_WHAT, found=found)
    # Loggers on Windows write the degree sign in their own code page.
    with file.open(encoding="utf-8-sig", errors="replace", newline=None) as lines:
        return list(islice((line for line in lines if line.strip()), LOOKED_AT + 2))


def _distinct(names: tuple[str, ...]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return names of which none is empty or there twice, and what is wrong with the new ones."""
    unique: list[str] = []
    renamed: dict[str, str] = {}
    for number, name in enumerate(names, start=1):
        shown = name or f"column {number}"
        if not name:
            renamed[shown] = "a column without a name"
        elif name in unique:
            shown = f"{name} (column {number})"
            renamed[shown] = f"a second column named {name}"
        unique.append(shown)
    return tuple(unique), renamed


def _stamp(cell: str) -> datetime | None:
    """Return a date with a time of day; None for another text. A day alone is no clock."""
    try:
        return datetime.fromisoformat(cell) if ":" in cell else None
    except ValueError:
        return None


def _decimal_sign(file: Path, rows: list[list[str]], separator: str) -> str:
    """Return the sign in the numbers of the first rows; between commas it can be a point alone."""
    if separator == ",":
        return "."
    cells = [c for row in rows for c in row if _stamp(c) is None and _number(c, ",") is not None]
    comma = next((cell for cell in cells if "," in cell), "")
    point = next((cell for cell in cells if "." in cell), "")
    if comma and point:
        raise InputError(
            str(file),
            expected="one decimal sign in all numbers",
            found=f"'{comma}' and '{point}'",
            remedy="save it with points in numbers and nothing between thousands",
        )
    return "," if comma else "."


def _number(cell: str, decimal: str) -> float | None:
    try:
        # Python takes 1_000 for a number.
        return None if "_" in cell else float(cell.replace(decimal, "."))
    except ValueError:
        return None


def _blocks(file: Path, found: _Layout, names: tuple[str, ...], lenient: bool) -> Iterator[Columns]:
    """Yield the rows as pyarrow reads them; where it stumbles, cell by cell from there on."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    zones = {name: "UTC" if first.tzinfo else None for name, first in found.stamps.items()}
    types = {
        name: pa.timestamp("ns", zones[name]) if name in zones else pa.float64() for name in names
    }
    n_rows = 0
    try:
        with arrow_csv.open_csv(
            file,
            read_options=arrow_csv.ReadOptions(
                block_size=BLOCK_BYTES,
                column_names=list(found.names),
                skip_rows=found.header_rows,
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=found.separator),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types,
                null_values=[],
                include_columns=list(names),
                decimal_point=found.decimal,
            ),
        ) as reader:
            for batch in reader:
                n_rows += batch.num_rows
                yield tuple(
                    _seconds(column, found.stamps[name]) if name in zones else column.to_numpy()
                    for name, column in zip(names, batch.columns, strict=True)
                )
        return
    except pa.ArrowException:
        pass
    yield from _cell_by_cell(file, found, names, n_rows, lenient)


def _seconds(column: Any, first: datetime) -> Any:
    import pandas as pd
    import pyarrow as pa

    # The difference first: a date in nanoseconds is no double.
    return (column.cast(pa.int64()).to_numpy() - pd.Timestamp(first).value) / 1e9


def _cell_by_cell(
    file: Path, found: _Layout, names: tuple[str, ...], skipped: int, lenient: bool
) -> Iterator[Columns]:
    """Yield the rows behind the first ``skipped`` as far as they are numbers, then say why not."""
    places = [found.names.index(name) for name in names]
    kept: list[list[float]] = []
    fault: InputError | None = None
    with file.open(encoding="utf-8-sig", errors="replace", newline=None) as lines:
        filled = (line for line in lines if line.strip())
        below = islice(filled, found.header_rows + skipped, None)
        for row, line in enumerate(below, start=skipped + 1):
            cells = _cells(line, found.separator)
            if len(cells) != len(found.names):
                fault = InputError(
                    str(file),
                    expected=f"{len(found.names)} values in every row",
                    found=f"{len(cells)} in row {row}",
                    remedy="the file was cut short or edited there, or has decimal commas between "
                    "commas",
                )
                break
            values = [_value(found, found.names[place], cells[place]) for place in places]
            if not lenient and None in values:
                place = places[values.index(None)]
                fault = InputError(
                    f"{file}: channel {found.names[place]}",
                    expected="a date and time in every row"
                    if found.names[place] in found.stamps
                    else "a finite number in every row",
                    found=f"{cells[place]!r} in row {row}"
                    if cells[place]
                    else f"an empty cell in row {row}",
                    remedy="cut the record there or repair the channel",
                )
                break
            kept.append([np.nan if value is None else value for value in values])
    yield tuple(np.array(kept, dtype=np.float64).reshape(-1, len(names)).T)
    if fault is not None:
        raise fault


def _value(found: _Layout, name: str, cell: str) -> float | None:
    if name not in found.stamps:
        # A point between thousands would be taken for the other sign.
        return None if found.decimal == "," and "." in cell else _number(cell, found.decimal)
    first, stamp = found.stamps[name], _stamp(cell)
    if stamp is None or (stamp.tzinfo is None) != (first.tzinfo is None):
        return None
    return (stamp - first).total_seconds()
