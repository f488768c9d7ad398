"""Series files: φ, ψ' and ψ over time as CSV or netCDF, with the ledger of their reduction."""

from __future__ import annotations

import json
import os
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.io.csv import separator_of
from classic_ml.io.hdf5 import check_items
from classic_ml.io.table import fault_of
from classic_ml.records import Dropped, LedgerEntry
from classic_ml.series import (
    COLUMNS,
    COUNT_COLUMNS,
    LONG_NAMES,
    MINIMUM_ROWS,
    REQUIRED_COLUMNS,
    TRUTH_COLUMNS,
    UNITS,
    CoefficientSeries,
)
from surge_core.errors import InputError
from surge_core.files import replace_whole
from surge_core.types import FloatArray

__all__ = ["ledger_path", "read_series", "write_series"]

# A compressor surges a few times a second: what is sampled more slowly shows no cycle.
LONGEST_STEP_S = 0.05
SUFFIXES = (".csv", ".nc", ".nc4", ".netcdf")
# What pandas and spreadsheets write for a column of truth values.
_TRUTH = {"true": 1.0, "false": 0.0}
# No `Conventions`: those of CF want dated lines in `history`, and with a date in it the same record
# would not give the same file.
_ABOUT = {
    "title": "Flow and pressure coefficients of a compressor in surge, row by row",
    "comment": "history is the ledger of the reduction as JSON, one entry a step; it has no dates, "
    "so that the same record gives the same file",
}
# The columns of a file by name: numbers, or texts where they may be something else.
_Columns = dict[str, NDArray[Any]]
_History = tuple[LedgerEntry, ...]


def read_series(path: str | os.PathLike[str]) -> CoefficientSeries:
    """Read a series file (CSV with a header, or netCDF with the same names).

    Parameters
    ----------
    path : str or path
        File with the suffix ``.csv``, ``.nc``, ``.nc4`` or ``.netcdf``. A ledger written beside
        it by :func:`write_series` is read too.

    Returns
    -------
    CoefficientSeries
        The checked series; without a ``segment`` column all rows are one segment.

    Raises
    ------
    InputError
        Naming the file, the column and the row at fault.
    """
    file = Path(path)
    _check_suffix(file, "a series file")
    if not file.is_file():
        found = "a folder" if file.is_dir() else "no such file"
        raise InputError(str(file), expected="a series file", found=found)
    is_csv = file.suffix.lower() == ".csv"
    try:
        table, history = _read_csv(file) if is_csv else _read_netcdf(file)
    except Exception as error:
        raise fault_of(error, str(file), "a series file") from None
    missing = [name for name in REQUIRED_COLUMNS if name not in table]
    if missing:
        raise InputError(
            str(file),
            expected=f"the columns {', '.join(REQUIRED_COLUMNS)}",
            found=f"no column {', '.join(missing)}",
            remedy="rename 'time' to 'time_s', in seconds"
            if missing == ["time_s"] and "time" in table
            else "a raw record goes through `sindy-surge reduce` first",
        )
    known = {name: _as_numbers(table[name], name, file) for name in COLUMNS if name in table}
    lengths = {values.shape for values in known.values()}
    n_rows = known["time_s"].size
    if len(lengths) > 1 or known["time_s"].ndim != 1:
        raise InputError(
            str(file), expected="columns of one length", found=f"shapes {sorted(lengths)}"
        )
    if n_rows < MINIMUM_ROWS:
        raise InputError(str(file), expected=f"at least {MINIMUM_ROWS} rows", found=f"{n_rows}")
    _check_step(known["time_s"], file)
    known.setdefault("segment", np.ones(n_rows))
    history += _other_record(n_rows, history, file)
    return CoefficientSeries(**known, source=str(file), history=history)  # type: ignore[arg-type]


def write_series(series: CoefficientSeries, path: str | os.PathLike[str]) -> None:
    """Write a series file, whole or not at all, with its ledger.

    A netCDF file carries the ledger as the attribute ``history``, as JSON and without the dates
    that the CF conventions want there, so that the same record gives the same file; beside a CSV
    file it is written as ``NAME.ledger.json``.

    Parameters
    ----------
    series : CoefficientSeries
        What to write.
    path : str or path
        Target, ending in ``.csv``, ``.nc``, ``.nc4`` or ``.netcdf``.

    Raises
    ------
    InputError
        When the suffix is unknown or the folder does not exist.
    """
    file = Path(path)
    _check_suffix(file, "an output file")
    if file.suffix.lower() != ".csv":
        replace_whole(file, lambda temporary: _write_netcdf(series, temporary))
        return

    def write_ledger_and_table(temporary: Path) -> None:
        # The ledger is complete before the table is put in place, so that the two change together.
        temporary.write_text(_ledger_json(series.history), "utf-8")
        replace_whole(file, lambda table: _write_csv(series, table))

    replace_whole(ledger_path(file), write_ledger_and_table)


def ledger_path(path: Path) -> Path:
    """Return where the ledger of a CSV series lies."""
    return path.with_suffix(".ledger.json")


def _check_suffix(file: Path, what: str) -> None:
    if file.suffix.lower() not in SUFFIXES and not file.is_dir():
        raise InputError(
            str(file), expected=f"{what} ending in .csv or .nc", found=f"the suffix '{file.suffix}'"
        )


def _check_step(time_s: FloatArray, file: Path) -> None:
    """Refuse a clock in whose steps no surge could be seen: it is in another unit."""
    # A time that is no number is refused when the series is made.
    with np.errstate(invalid="ignore"):
        step = float(np.median(np.diff(time_s)))
    if step > LONGEST_STEP_S:
        raise InputError(
            f"{file}: column time_s",
            expected=f"seconds, with steps of at most {LONGEST_STEP_S:g} s",
            found=f"steps of {step:g}",
            remedy="is time_s in ms? then divide it by 1000",
        )


def _other_record(n_rows: int, history: _History, file: Path) -> _History:
    """Return a note where the ledger is that of a record of another length."""
    read = next((entry.parameters for entry in history if entry.step == "read"), {})
    # What was not reduced from a raw record says nothing of rows.
    if read.get("rows", n_rows) == n_rows or not {"raw", "test"} <= set(read):
        return ()
    ledger = ledger_path(file).name if file.suffix.lower() == ".csv" else "its ledger"
    flag = (
        f"{ledger} is of {read['rows']} rows, the series has {n_rows}: it is that of another "
        "record, or the series was cut"
    )
    return (LedgerEntry("read series", f"{n_rows} rows", flags=(flag,)),)


def _as_numbers(column: NDArray[Any], name: str, file: Path) -> FloatArray:
    if column.dtype.kind in "fiub":
        return column.astype(np.float64, copy=False)
    if name in TRUTH_COLUMNS:
        column = np.array([_TRUTH.get(str(v).strip().lower(), v) for v in column], dtype=object)
    try:
        # Python's own conversion is exact, so that a file survives the round trip bit for bit.
        return column.astype(np.float64)
    except (TypeError, ValueError):
        row, text = next((i, v) for i, v in enumerate(column) if not _is_number(v))
        raise InputError(
            f"{file}: column {name}", expected="numbers", found=f"'{text}' in row {row + 1}"
        ) from None


def _is_number(value: object) -> bool:
    try:
        float(str(value))
    except ValueError:
        return False
    return True


def _read_csv(file: Path) -> tuple[_Columns, _History]:
    with file.open(encoding="utf-8-sig", newline=None) as lines:
        header = next((row for row in lines if row.strip() and not row.startswith("#")), "")
    if not header:
        raise InputError(str(file), expected="a CSV table with a header", found="an empty file")
    columns = _read_plain_csv(file, header)
    if columns is None:
        columns = _read_any_csv(file, separator_of(header))
    return columns, _read_ledger(ledger_path(file))


def _read_plain_csv(file: Path, header: str) -> _Columns | None:
    """Read a table of nothing but numbers under known names; None where there is more to it.

    pyarrow rounds as Python does, so that both ways give the same numbers.
    """
    import pyarrow as pa
    from pyarrow import csv

    names = header.rstrip("\n").split(",")
    if len(set(names)) < len(names) or not set(names) <= set(COLUMNS):
        return None
    try:
        table = csv.read_csv(
            file,
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()), null_values=[]
            ),
        )
    except pa.ArrowException:
        return None
    return {name: table[name].to_numpy() for name in names if name in table.column_names}


def _read_any_csv(file: Path, separator: str) -> _Columns:
    """Read a table as a spreadsheet writes it: decimal commas, comments, other columns."""
    import pandas as pd

    # Without a header row pandas keeps doubled names apart, so that they can be refused.
    table = pd.read_csv(
        file, sep=separator, header=None, dtype=str, skipinitialspace=True, comment="#"
    )
    names = [str(name).strip() for name in table.iloc[0]]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise InputError(
            str(file),
            expected="each column once",
            found=f"{doubled[0]} {names.count(doubled[0])} times",
        )
    columns = {
        name: table.iloc[1:, number].to_numpy(dtype=object, na_value=np.nan)
        for number, name in enumerate(names)
    }
    cells = {n: [str(cell) for cell in columns[n]] for n in names if n in COLUMNS}
    if separator == "," or not any("," in cell for some in cells.values() for cell in some):
        return columns
    for name, some in cells.items():
        row = next((row for row, cell in enumerate(some) if "." in cell), None)
        if row is not None:
            raise InputError(
                f"{file}: column {name}",
                expected="numbers with a decimal comma, as in other rows",
                found=f"'{some[row]}' in row {row + 1}",
                remedy="save it with points in numbers and nothing between thousands",
            )
        # Of two commas none is the decimal sign: the cell is shown as it is written.
        plain = [cell.replace(",", ".") if cell.count(",") < 2 else cell for cell in some]
        columns[name] = np.array(plain, dtype=object)
    return columns


def _read_ledger(file: Path) -> _History:
    if not file.is_file():
        return ()
    try:
        return _ledger_from_json(file.read_text("utf-8"))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            str(file),
            expected="the ledger that `sindy-surge reduce` wrote",
            found=f"something else ({error})",
            remedy="delete it or reduce the record again",
        ) from None


def _read_netcdf(file: Path) -> tuple[_Columns, _History]:
    import xarray as xr

    check_items(file)
    with xr.open_dataset(
        file, engine="h5netcdf", decode_times=False, decode_timedelta=False
    ) as dataset:
        columns = {str(name): variable.values for name, variable in dataset.variables.items()}
        text = str(dataset.attrs.get("history", "[]"))
    try:
        return columns, _ledger_from_json(text)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        # Other programs write free text into this conventional attribute.
        return columns, (LedgerEntry("read", f"history attribute of {file.name}: {text}"),)


def _write_csv(series: CoefficientSeries, file: Path) -> None:
    import pyarrow as pa
    from pyarrow import csv

    columns = series.columns()
    whole = TRUTH_COLUMNS + COUNT_COLUMNS
    types = {name: pa.int64() if name in whole else pa.float64() for name in columns}
    table = pa.table({name: pa.array(v).cast(types[name]) for name, v in columns.items()})
    # The shortest digits that read back as the same number: a series survives the round trip bit
    # for bit. The header is written by hand, since pyarrow puts it into quotes.
    with file.open("wb") as out:
        out.write((",".join(columns) + "\n").encode())
        csv.write_csv(table, out, csv.WriteOptions(include_header=False))


def _write_netcdf(series: CoefficientSeries, file: Path) -> None:
    import xarray as xr

    variables = {
        name: (
            "time_s",
            _narrow(name, values),
            {"units": UNITS[name], "long_name": LONG_NAMES[name]},
        )
        for name, values in series.columns().items()
    }
    about = {**_ABOUT, "history": _ledger_json(series.history), "source": series.source}
    encoding = {name: {"_FillValue": None} for name in variables}
    try:
        xr.Dataset(variables, attrs=about).to_netcdf(file, engine="h5netcdf", encoding=encoding)
    except (RuntimeError, OSError) as error:
        # HDF5 says in its own words that a disk is full, perhaps not before it closes the file.
        cause = re.search(r"errno = (\d+), error message = '([^']*)'", str(error))
        if cause is None:
            raise
        raise OSError(int(cause[1]), cause[2]) from error


def _narrow(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return truths and counts in one byte where that holds them: a series of hours is large."""
    if name in TRUTH_COLUMNS:
        return values.astype(np.int8)
    if name in COUNT_COLUMNS:
        most = int(values.max(initial=0))
        kinds = (np.int8, np.int32, np.int64)
        return values.astype(next(kind for kind in kinds if most <= np.iinfo(kind).max))
    return values


def _ledger_json(history: _History) -> str:
    return json.dumps([asdict(entry) for entry in history], indent=1, ensure_ascii=False)


def _ledger_from_json(text: str) -> _History:
    return tuple(
        LedgerEntry(
            step=str(entry["step"]),
            did=str(entry["did"]),
            parameters=dict(entry["parameters"]),
            dropped=tuple(Dropped(**drop) for drop in entry["dropped"]),
            flags=tuple(str(flag) for flag in entry["flags"]),
        )
        for entry in json.loads(text)
    )
