"""Raw records as CSV: a header, then one row a sample."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from classic_ml.errors import InputError
from classic_ml.readers.raw_table import ColumnCheck, RawTable, check_names
from classic_ml.records import FloatArray

__all__ = ["read_raw_csv"]


def read_raw_csv(file: Path, check_columns: ColumnCheck | None = None) -> RawTable:
    """Read a CSV table of counts and temperatures.

    Parameters
    ----------
    file : path
        An existing file.
    check_columns : callable, optional
        Called with the file's name and its column names before the rows are read, so that a
        column too many is refused as such, whatever is in it.

    Returns
    -------
    RawTable
        Its columns.

    Raises
    ------
    InputError
        When the file is empty, not text, cut short, or holds something other than numbers.
    """
    names = _header(file)
    check_names(str(file), names)
    if check_columns is not None:
        check_columns(str(file), names)
    return RawTable(str(file), names, _body(file, names))


def _header(file: Path) -> tuple[str, ...]:
    try:
        with file.open(encoding="utf-8", newline="") as lines:
            first = lines.readline()
    except UnicodeDecodeError:
        first = "\0"
    if not first.strip():
        raise InputError(str(file), expected="a CSV table with a header", found="an empty file")
    if "\0" in first:
        raise InputError(str(file), expected="a CSV table with a header", found="binary data")
    return tuple(name.strip().strip('"') for name in first.removeprefix("\ufeff").split(","))


def _body(file: Path, names: tuple[str, ...]) -> FloatArray:
    try:
        with file.open(encoding="utf-8", newline="") as lines, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data", UserWarning)
            next(lines)
            values = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2, dtype=np.float64)
    except ValueError:
        # The quick path does not name the channel where it failed; a second, slow look does.
        raise _first_fault(file, names) from None
    if values.size == 0:
        raise InputError(str(file), expected="rows below the header", found="none")
    if values.shape[1] != len(names) or not np.isfinite(values).all():
        raise _first_fault(file, names)
    return np.asarray(values, dtype=np.float64)


def _first_fault(file: Path, names: tuple[str, ...]) -> InputError:
    with file.open(encoding="utf-8", errors="replace", newline="") as lines:
        next(lines)
        rows = (line.rstrip("\r\n") for line in lines)
        for number, text in enumerate((row for row in rows if row.strip()), start=1):
            fault = _fault_in_row(file, names, number, text)
            if fault is not None:
                return fault
    return InputError(str(file), expected="a table of numbers", found="something else")


def _fault_in_row(file: Path, names: tuple[str, ...], number: int, text: str) -> InputError | None:
    if "\ufffd" in text or "\0" in text:
        return InputError(str(file), expected="a CSV table", found=f"binary data in row {number}")
    cells = [cell.strip().strip('"') for cell in text.split(",")]
    if len(cells) != len(names):
        return InputError(
            str(file),
            expected=f"{len(names)} values in every row",
            found=f"{len(cells)} in row {number}",
            remedy="the file was cut short or edited there",
        )
    for name, cell in zip(names, cells, strict=True):
        try:
            finite = np.isfinite(float(cell))
        except ValueError:
            finite = np.False_
        if not finite:
            return InputError(
                f"{file}: channel {name}",
                expected="a finite number in every row",
                found=f"'{cell}' in row {number}" if cell else f"an empty cell in row {number}",
                remedy="cut the record there or repair the channel",
            )
    return None
