"""Raw records as CSV: a header, perhaps a row of units, then one row a sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.readers.csv_layout import (
    LONGEST_LINE,
    CsvLayout,
    cells_of,
    csv_layout,
    lines_of,
    row_of_units,
)
from classic_ml.readers.raw_table import Columns, RawFile, arrow_file, check_unique, rebatched
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError

__all__ = ["LONGEST_LINE", "open_csv", "open_csv_leniently", "row_of_units"]

# Enough lines for pyarrow to be quick, little beside any memory.
BLOCK_BYTES = 1 << 20
# Rows that the slow look takes at once.
SLOW_ROWS = 1024


def open_csv(file: Path, layout: FileLayout | None = None) -> RawFile:
    """Open a CSV table of numbers.

    The rows are parsed block by block by pyarrow, which rounds as Python does. Where it stumbles,
    a second, slow look goes on from there: it names the row and the channel at fault.

    Parameters
    ----------
    file : path
        An existing file. A second line that holds units alone is taken as such, and so is a unit
        in brackets at the end of a name. Between the cells stand commas, semicolons or tabs; beside
        the latter two a comma may be the decimal sign. A column of dates (ISO 8601) counts from
        its first row.
    layout : FileLayout, optional
        Which column is the clock.

    Returns
    -------
    RawFile
        Its columns.

    Raises
    ------
    InputError
        When the file is empty, not text, cut short, or holds something other than numbers.
    """
    found = csv_layout(file)
    check_unique(str(file), found.names)
    return _opened(file, found, layout, lenient=False)


def open_csv_leniently(file: Path, layout: FileLayout | None = None) -> RawFile:
    """Open a CSV table to look at it: cells that are no numbers are NaN, doubled names numbered.

    Parameters
    ----------
    file, layout
        As for :func:`open_csv`.
    """
    names: dict[str, None] = {}
    renamed: dict[str, str] = {}
    for number, name in enumerate(csv_layout(file).names, start=1):
        shown = name or f"column {number}"
        if not name:
            renamed[shown] = "a column without a name"
        elif shown in names:
            shown = f"{name} (column {number})"
            renamed[shown] = f"a second column named {name}"
        names[shown] = None
    found = csv_layout(file, tuple(names))
    return replace(_opened(file, found, layout, lenient=True), unusable=renamed)


def _opened(file: Path, found: CsvLayout, layout: FileLayout | None, *, lenient: bool) -> RawFile:
    def pieces(kept: tuple[str, ...]) -> Iterator[Columns]:
        n_rows = 0
        for piece in _rows(file, found, kept, lenient):
            n_rows += piece[0].size if piece else 0
            yield piece
        if n_rows == 0:
            raise InputError(str(file), expected="rows below the header", found="none")

    def selected(kept: tuple[str, ...]) -> Callable[[int], Iterator[Columns]]:
        return lambda rows: rebatched(pieces(kept), rows)

    stamps = {name: column.words for name, column in found.stamps.items()}
    return RawFile(
        str(file),
        found.names,
        selected(found.names),
        found.units,
        clock=stamps.get((layout or FileLayout()).time, ""),
        stamps=stamps,
        selected=selected,
    )


def _rows(file: Path, found: CsvLayout, kept: tuple[str, ...], lenient: bool) -> Iterator[Columns]:
    """Yield the rows; where one is met that is not as it should be, a second look says why."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    n_rows = 0
    read = arrow_csv.ReadOptions(
        use_threads=False,
        block_size=BLOCK_BYTES,
        column_names=list(found.names),
        skip_rows=found.header_rows,
    )
    numbers = {name: pa.float64() for name in kept}
    dates = {name: found.stamps[name].arrow_type for name in kept if name in found.stamps}
    convert = arrow_csv.ConvertOptions(
        column_types={**numbers, **dates},
        null_values=[],
        include_columns=list(kept),
        decimal_point=found.decimal,
    )
    parse = arrow_csv.ParseOptions(delimiter=found.separator)
    try:
        with (
            arrow_file(file) as opened,
            arrow_csv.open_csv(
                opened, read_options=read, convert_options=convert, parse_options=parse
            ) as reader,
        ):
            for batch in reader:
                n_rows += batch.num_rows
                yield _columns(batch, found)
        return
    except (pa.ArrowException, UnicodeDecodeError):
        pass
    yield from _slow(file, found, kept, n_rows, lenient)


def _columns(batch: Any, found: CsvLayout) -> Columns:
    return tuple(
        found.stamps[name].arrow_seconds(column)
        if name in found.stamps
        else column.to_numpy(zero_copy_only=not column.null_count)
        for name, column in zip(batch.schema.names, batch.columns, strict=True)
    )


def _slow(
    file: Path, found: CsvLayout, kept: tuple[str, ...], skipped: int, lenient: bool
) -> Iterator[Columns]:
    """Yield the rows after the first ``skipped`` ones, as far as they are rows of numbers."""
    with file.open(encoding="utf-8", errors="replace", newline="") as lines:
        filled = (line for line in lines_of(file, lines) if line.strip("\r\n"))
        below = islice(filled, found.header_rows, None)
        rows = (line.rstrip("\r\n") for line in below if line.strip())
        block: list[list[float]] = []
        for number, text in enumerate(rows, start=1):
            if number <= skipped:
                continue
            row, fault = _row(file, found, kept, number, text, lenient)
            if fault is not None:
                yield _transposed(block, kept)
                raise fault
            block.append(row)
            if len(block) == SLOW_ROWS:
                yield _transposed(block, kept)
                block = []
        yield _transposed(block, kept)


def _transposed(rows: list[list[float]], names: tuple[str, ...]) -> Columns:
    return tuple(np.array(rows, dtype=np.float64).reshape(-1, len(names)).T)


def _row(
    file: Path, found: CsvLayout, kept: tuple[str, ...], number: int, text: str, lenient: bool
) -> tuple[list[float], InputError | None]:
    """Return the numbers of one row, or what is wrong with it."""
    names = found.names
    cells = cells_of(text, found.separator)
    by_name = dict(zip(names, cells, strict=False))
    looked_at = text if len(cells) != len(names) else "".join(by_name[name] for name in kept)
    if "\ufffd" in looked_at or "\0" in looked_at:
        fault = InputError(str(file), expected="a CSV table", found=f"binary data in row {number}")
        return [], fault
    if len(cells) != len(names):
        decimal = len(names) < len(cells) and number == 1
        return [], InputError(
            str(file),
            expected=f"{len(names)} values in every row",
            found=f"{len(cells)} in row {number}",
            remedy="are numbers written with a comma? write them with a point"
            if decimal
            else "the file was cut short or edited there",
        )
    row = []
    for name in kept:
        value = found.number(name, by_name[name])
        if value is None and not lenient:
            return [], _no_number(file, found, name, by_name[name], number)
        row.append(np.nan if value is None else value)
    return row, None


def _no_number(file: Path, found: CsvLayout, name: str, cell: str, row: int) -> InputError:
    stamps = found.stamps.get(name)
    return InputError(
        f"{file}: channel {name}",
        expected="a finite number in every row"
        if stamps is None
        else f"a date and time in every row, {'with' if stamps.zoned else 'without'} a zone as in "
        "row 1",
        found=f"'{cell}' in row {row}" if cell else f"an empty cell in row {row}",
        remedy="cut the record there or repair the channel",
    )
