"""Series files as CSV: plain tables quickly, those of spreadsheets with more care."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.readers.csv_layout import LOOKED_AT, decimal_sign, separator_of
from classic_ml.series import COLUMNS
from surge_core.errors import InputError

__all__ = ["read_series_table"]


def read_series_table(file: Path) -> dict[str, NDArray[Any]]:
    """Read the columns of a CSV table.

    Parameters
    ----------
    file : path
        An existing file: commas, semicolons or tabs between its cells, and beside the latter two
        perhaps decimal commas; lines and ends of lines behind a # do not count.

    Returns
    -------
    dict of str to ndarray of shape (n_rows,)
        Numbers, or texts where they may be something else.

    Raises
    ------
    InputError
        When the file is no table, has a column twice, or writes its numbers in two ways.
    """
    separator = _separator(file)
    columns = _read_plain_csv(file) if separator == "," else None
    return _read_any_csv(file, separator) if columns is None else columns


def _separator(file: Path) -> str:
    with file.open(encoding="utf-8-sig", errors="replace", newline="") as lines:
        header = next((row for row in lines if row.strip() and not row.startswith("#")), "")
    return separator_of(header)


def _read_plain_csv(file: Path) -> dict[str, NDArray[Any]] | None:
    """Read a table of nothing but numbers under known names; None where there is more to it.

    pyarrow rounds as Python does, so that both ways give the same numbers.
    """
    import pyarrow as pa
    from pyarrow import csv

    with file.open("rb") as content:
        try:
            names = content.readline().decode("ascii").rstrip("\r\n").split(",")
        except UnicodeDecodeError:
            return None
        content.seek(0)
        # A comment is none to pyarrow.
        commented = any(b"#" in piece for piece in iter(lambda: content.read(1 << 20), b""))
    if commented or len(set(names)) < len(names) or not set(names) <= set(COLUMNS):
        return None
    try:
        table = csv.read_csv(
            file,
            read_options=csv.ReadOptions(use_threads=False, skip_rows=1, column_names=names),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()), null_values=[]
            ),
        )
    except pa.ArrowException:
        return None
    return {name: table[name].to_numpy() for name in names}


def _read_any_csv(file: Path, separator: str) -> dict[str, NDArray[Any]]:
    import pandas as pd

    try:
        # Without a header row pandas keeps doubled names apart, so that they can be refused.
        table = pd.read_csv(
            file, sep=separator, header=None, dtype=str, skipinitialspace=True, comment="#"
        )
    except (ValueError, OverflowError) as error:
        raise _no_table(file, error) from None
    names = [str(name).strip() for name in table.iloc[0]]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise InputError(
            str(file),
            expected="each column once",
            found=f"{doubled[0]} {names.count(doubled[0])} times",
        )
    rows = table.iloc[1:]
    head = [[str(cell) for cell in row] for row in rows.iloc[:LOOKED_AT].to_numpy()]
    decimal = decimal_sign(file, head, separator)
    columns = {
        name: rows.iloc[:, number].to_numpy(dtype=object, na_value=np.nan)
        for number, name in enumerate(names)
    }
    if decimal == ".":
        return columns
    return {name: _with_points(column, name, file) for name, column in columns.items()}


def _with_points(column: NDArray[Any], name: str, file: Path) -> NDArray[Any]:
    """Return numbers with decimal commas as others are written."""
    cells = [str(cell) for cell in column]
    # A point between thousands would be taken for the other sign.
    row = next((row for row, cell in enumerate(cells) if "." in cell), None)
    if row is not None and name in COLUMNS:
        raise InputError(
            f"{file}: column {name}",
            expected="numbers with a decimal comma, as in the rows before",
            found=f"'{cells[row]}' in row {row + 1}",
            remedy="save it with points in numbers and nothing between thousands",
        )
    # Of two commas none is the decimal sign: the cell is told as it is written.
    plain = [cell.replace(",", ".") if cell.count(",") < 2 else cell for cell in cells]
    return np.array(plain, dtype=object)


def _no_table(file: Path, error: Exception) -> InputError:
    """Return what is wrong with a file that pandas takes for no table, in a user's words."""
    with file.open("rb") as content:
        head = content.read(2)
    what, remedy = "a CSV table with a header", ""
    long_row = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
    if not head:
        found = "an empty file"
    elif head in (b"\xff\xfe", b"\xfe\xff"):
        found, remedy = "UTF-16 text", "save it as UTF-8"
    elif isinstance(error, UnicodeDecodeError):
        found, remedy = "bytes that are no text in UTF-8", "save it as UTF-8"
    elif long_row is not None and long_row.group(1) != "1":
        columns, line, values = (int(number) for number in long_row.groups())
        what = f"{columns} values in every row"
        found, remedy = f"{values} in row {line - 1}", "the file was edited or damaged there"
    else:
        found = "something else"
    return InputError(str(file), expected=what, found=found, remedy=remedy)
