"""Raw records as CSV: a header, perhaps a row of units, then one row a sample."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from classic_ml.errors import InputError
from classic_ml.readers.raw_table import RawFile, arrow_file, check_unique, rebatched
from classic_ml.readers.test_description import FileLayout
from classic_ml.records import FloatArray
from classic_ml.units import is_unit_label, kind_of_unit, unit_in_brackets

__all__ = ["open_csv", "open_csv_leniently", "row_of_units"]

# Enough lines for pyarrow to be quick, little beside any memory.
BLOCK_BYTES = 1 << 20
# More than any table has columns for: a file without line ends is one line.
LONGEST_LINE = BLOCK_BYTES
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
        in brackets at the end of a name.
    layout : FileLayout, optional
        Of no account here: a CSV table has no groups.

    Returns
    -------
    RawFile
        Its columns.

    Raises
    ------
    InputError
        When the file is empty, not text, cut short, or holds something other than numbers.
    """
    names = _header(file)
    check_unique(str(file), names)
    return _opened(file, names, lenient=False)


def open_csv_leniently(file: Path, layout: FileLayout | None = None) -> RawFile:
    """Open a CSV table to look at it: cells that are no numbers are NaN, doubled names numbered.

    Parameters
    ----------
    file, layout
        As for :func:`open_csv`.
    """
    names: dict[str, None] = {}
    renamed: dict[str, str] = {}
    for number, name in enumerate(_header(file), start=1):
        shown = name or f"column {number}"
        if not name:
            renamed[shown] = "a column without a name"
        elif shown in names:
            shown = f"{name} (column {number})"
            renamed[shown] = f"a second column named {name}"
        names[shown] = None
    return replace(_opened(file, tuple(names), lenient=True), unusable=renamed)


def _opened(file: Path, names: tuple[str, ...], *, lenient: bool) -> RawFile:
    units, header_rows = _units(file, names)

    def pieces() -> Iterator[FloatArray]:
        n_rows = 0
        for piece in _rows(file, names, header_rows, lenient):
            n_rows += len(piece)
            yield piece
        if n_rows == 0:
            raise InputError(str(file), expected="rows below the header", found="none")

    return RawFile(str(file), names, lambda rows: rebatched(pieces(), rows), units)


def _header(file: Path) -> tuple[str, ...]:
    what = "a CSV table with a header"
    with file.open("rb") as opened:
        line = opened.readline(LONGEST_LINE + 1).removeprefix(b"\xef\xbb\xbf")
    if line.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(str(file), expected=what, found="UTF-16 text", remedy="save it as UTF-8")
    if not line.strip():
        raise InputError(str(file), expected=what, found="an empty file")
    if len(line) > LONGEST_LINE:
        raise _too_long(file)
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        # Loggers on Windows write the degree sign so. Binary data have control characters too.
        text = line.decode("cp1252", errors="replace")
    if any(ord(letter) < 32 and letter not in "\t\r\n" for letter in text):
        raise InputError(str(file), expected=what, found="binary data")
    try:
        names = tuple(name.strip() for name in next(csv.reader([text.strip("\r\n")])))
    except csv.Error:
        raise InputError(
            str(file), expected=what, found="a name of more than 131072 letters"
        ) from None
    if all(_number(name) is not None for name in names):
        raise InputError(
            str(file),
            expected="a table with a header and a column time_s",
            found="numbers in the first line",
            remedy="write the names of the columns above them",
        )
    for separator in (";", "\t"):
        if text.count(separator) > max(text.count(","), 0) and len(names) <= text.count(separator):
            raise InputError(
                str(file),
                expected="columns separated by commas",
                found=f"the separator is {separator!r}",
                remedy="save it with commas between columns and points in numbers",
            )
    return names


def _units(file: Path, names: tuple[str, ...]) -> tuple[dict[str, str], int]:
    """Return the units that the file states, and the lines above the numbers."""
    with file.open(encoding="utf-8", errors="replace", newline="") as lines:
        below = islice(_lines(file, lines), 1, None)
        second = next((line for line in below if line.strip()), "")
    cells = row_of_units(second, len(names))
    if not cells:
        bracketed = {name: unit_in_brackets(name) for name in names}
        return {name: unit for name, unit in bracketed.items() if unit}, 1
    return {name: cell for name, cell in zip(names, cells, strict=True) if cell}, 2


def row_of_units(line: str, n_columns: int) -> tuple[str, ...]:
    """Return the cells of a line that holds units alone; empty for another line.

    Parameters
    ----------
    line : str
        The line below the header.
    n_columns : int
        Columns of the table.
    """
    cells = tuple(cell.strip() for cell in line.rstrip("\r\n").replace('"', "").split(","))
    if len(cells) != n_columns:
        return ()
    are_units = any(map(kind_of_unit, cells)) and all(map(is_unit_label, cells))
    return cells if are_units else ()


def _rows(
    file: Path, names: tuple[str, ...], header_rows: int, lenient: bool
) -> Iterator[FloatArray]:
    """Yield the rows; where one is met that is not as it should be, a second look says why."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    n_rows = 0
    read = arrow_csv.ReadOptions(
        use_threads=False,
        block_size=BLOCK_BYTES,
        column_names=list(names),
        skip_rows=header_rows,
    )
    convert = arrow_csv.ConvertOptions(
        column_types={name: pa.float64() for name in names}, null_values=[]
    )
    try:
        with (
            arrow_file(file) as opened,
            arrow_csv.open_csv(opened, read_options=read, convert_options=convert) as reader,
        ):
            for batch in reader:
                n_rows += batch.num_rows
                yield _block(batch)
        return
    except (pa.ArrowException, UnicodeDecodeError):
        pass
    yield from _slow(file, names, header_rows, n_rows, lenient)


def _block(batch: Any) -> FloatArray:
    # Column by column in memory, as they are taken out again.
    columns = [column.to_numpy(zero_copy_only=not column.null_count) for column in batch.columns]
    return np.array(columns).T if columns else np.empty((0, 0))


def _slow(
    file: Path, names: tuple[str, ...], header_rows: int, skipped: int, lenient: bool
) -> Iterator[FloatArray]:
    """Yield the rows after the first ``skipped`` ones, as far as they are rows of numbers."""
    with file.open(encoding="utf-8", errors="replace", newline="") as lines:
        filled = (line for line in _lines(file, lines) if line.strip("\r\n"))
        below = islice(filled, header_rows, None)
        rows = (line.rstrip("\r\n") for line in below if line.strip())
        found: list[list[float]] = []
        for number, text in enumerate(rows, start=1):
            if number <= skipped:
                continue
            row, fault = _row(file, names, number, text, lenient)
            if fault is not None:
                yield np.array(found).reshape(-1, len(names))
                raise fault
            found.append(row)
            if len(found) == SLOW_ROWS:
                yield np.array(found)
                found = []
        yield np.array(found).reshape(-1, len(names))


def _lines(file: Path, opened: TextIO) -> Iterator[str]:
    """Yield the lines of a text, none of which is read beyond the longest that may be."""
    while line := opened.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise _too_long(file)
        yield line


def _too_long(file: Path) -> InputError:
    return InputError(
        str(file),
        expected="a CSV table with a header",
        found=f"a line of more than {LONGEST_LINE:,} letters",
        remedy="does each row end with a line feed?",
    )


def _row(
    file: Path, names: tuple[str, ...], number: int, text: str, lenient: bool
) -> tuple[list[float], InputError | None]:
    """Return the numbers of one row, or what is wrong with it."""
    if "\ufffd" in text or "\0" in text:
        fault = InputError(str(file), expected="a CSV table", found=f"binary data in row {number}")
        return [], fault
    cells = [cell.strip().strip('"') for cell in text.split(",")]
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
    for name, cell in zip(names, cells, strict=True):
        value = _number(cell)
        if value is None and not lenient:
            return [], InputError(
                f"{file}: channel {name}",
                expected="a finite number in every row",
                found=f"'{cell}' in row {number}" if cell else f"an empty cell in row {number}",
                remedy="cut the record there or repair the channel",
            )
        row.append(np.nan if value is None else value)
    return row, None


def _number(cell: str) -> float | None:
    try:
        # Python takes 1_000 for a number.
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
