"""Series files: φ, ψ' and ψ over time as CSV or netCDF, with the ledger of their reduction."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.readers.raw_columns import one_line
from classic_ml.readers.raw_hdf5 import opened_hdf5
from classic_ml.readers.series_csv import read_series_table
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
# So many rows of a column go to HDF5 at once, whose calls take as long as to write a block.
WRITTEN_ROWS = 1 << 18
# Types for whole numbers up to so many.
COUNT_TYPES = ((2**7 - 1, np.int8), (2**31 - 1, np.int32))
# The columns of a file by name: numbers, or texts where they may be something else.
_Columns = dict[str, NDArray[Any]]


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
    if file.is_dir():
        raise InputError(str(file), expected="a series file", found="a folder")
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(
            str(file),
            expected="a series file ending in .csv or .nc",
            found=f"the suffix '{file.suffix}'",
        )
    if not file.is_file():
        raise InputError(str(file), expected="a series file", found="no such file")
    table, history = reader(file)
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
    if known["time_s"].size < MINIMUM_ROWS:
        raise InputError(
            str(file),
            expected=f"at least {MINIMUM_ROWS} rows",
            found=f"{known['time_s'].size}",
        )
    _check_step(known["time_s"], file)
    known.setdefault("segment", np.ones(known["time_s"].size))
    history += _other_record(known["time_s"], history, file)
    return CoefficientSeries(**known, source=str(file), history=history)  # type: ignore[arg-type]


def _check_step(time_s: FloatArray, file: Path) -> None:
    """Refuse a clock in whose steps no surge could be seen: it is in another unit."""
    # A time that is none is told of when the series is made.
    with np.errstate(invalid="ignore"):
        step = float(np.median(np.diff(time_s)))
    if step > LONGEST_STEP_S:
        raise InputError(
            f"{file}: column time_s",
            expected=f"seconds, with steps of at most {LONGEST_STEP_S:g} s",
            found=f"steps of {step:g}",
            remedy="is time_s in ms? then divide it by 1000",
        )


def _other_record(
    time_s: FloatArray, history: tuple[LedgerEntry, ...], file: Path
) -> tuple[LedgerEntry, ...]:
    """Return a note where the ledger tells of a record of another length."""
    read = next((entry.parameters for entry in history if entry.step == "read"), {})
    rows = read.get("rows", time_s.size)
    # What was not reduced from a raw record tells nothing of rows.
    if rows == time_s.size or not {"raw", "test"} <= set(read):
        return ()
    ledger = ledger_path(file).name if file.suffix.lower() == ".csv" else "its ledger"
    flag = (
        f"{ledger} tells of {rows} rows, the series has {time_s.size}: it is that of another "
        "record, or the series was cut"
    )
    return (LedgerEntry("read series", f"{time_s.size} rows", flags=(flag,)),)


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
    _write(series, Path(path))


def _write(series: CoefficientSeries, file: Path) -> None:
    if file.suffix.lower() not in _READERS:
        raise InputError(
            str(file),
            expected="an output file ending in .csv or .nc",
            found=f"the suffix '{file.suffix}'",
        )
    if file.suffix.lower() != ".csv":
        replace_whole(file, lambda temporary: _write_netcdf_or_tell(series, temporary))
        return

    def write_ledger_and_table(temporary: Path) -> None:
        # The ledger is complete before the table is put in place, so that the two change together.
        temporary.write_text(_ledger_json(series.history), "utf-8")
        replace_whole(file, lambda table: _write_csv(series, table))

    replace_whole(ledger_path(file), write_ledger_and_table)


def ledger_path(path: Path) -> Path:
    """Return where the ledger of a CSV series lies."""
    return path.with_suffix(".ledger.json")


# What pandas and spreadsheets write for a column of truth values.
_TRUTH = {"true": 1.0, "false": 0.0}


def _as_numbers(column: NDArray[Any], name: str, file: Path) -> FloatArray:
    if column.dtype.kind in "fiub":
        return column.astype(np.float64, copy=False)
    if column.dtype.kind not in "OUST":
        raise InputError(
            f"{file}: column {name}", expected="real numbers", found=f"{column.dtype.name} values"
        )
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


def _read_csv(file: Path) -> tuple[_Columns, tuple[LedgerEntry, ...]]:
    return read_series_table(file), _read_ledger(ledger_path(file))


def _read_ledger(file: Path) -> tuple[LedgerEntry, ...]:
    if not file.is_file():
        return ()
    try:
        return _ledger_from_json(file.read_text("utf-8"))
    except UnicodeDecodeError:
        found = "bytes that are no text in UTF-8"
    except json.JSONDecodeError as error:
        found = f"no JSON: {error.msg} in line {error.lineno}"
    except RecursionError:
        found = "values nested too deeply"
    except (ValueError, TypeError, KeyError, AttributeError):
        found = "JSON of another kind"
    raise InputError(
        str(file),
        expected="the ledger that `sindy-surge reduce` wrote",
        found=found,
        remedy="delete it or reduce the record again",
    )


def _read_attributes(_: str, item: Any) -> None:
    """Open an item of an HDF5 file with all that hangs on it."""
    dict(item.attrs)


def _read_netcdf(file: Path) -> tuple[_Columns, tuple[LedgerEntry, ...]]:
    import xarray as xr

    try:
        with opened_hdf5(file, "a netCDF-4 file") as content:
            # What h5py stumbles over leaves a file of h5netcdf half open, which then complains of
            # that on its own.
            content.visititems(_read_attributes)
        with xr.open_dataset(
            file, engine="h5netcdf", decode_times=False, decode_timedelta=False
        ) as dataset:
            columns = {
                str(name): np.atleast_1d(variable.values)
                for name, variable in dataset.variables.items()
                if variable.ndim == 1
            }
            others = {str(n): v.shape for n, v in dataset.variables.items() if v.ndim > 1}
            text = str(dataset.attrs.get("history", "[]"))
    except (InputError, MemoryError):
        raise
    except Exception as error:
        # The libraries below raise whatever they stumble over in a damaged file.
        raise InputError(
            str(file),
            expected="a netCDF-4 file",
            found=f"what cannot be read ({one_line(error)})",
        ) from None
    for name in (name for name in REQUIRED_COLUMNS if name in others):
        raise InputError(
            f"{file}: column {name}", expected="one value a row", found=f"shape {others[name]}"
        )
    lengths = {values.size for values in columns.values()}
    if len(lengths) > 1:
        raise InputError(
            str(file), expected="columns of one length", found=f"lengths {sorted(lengths)}"
        )
    try:
        history = _ledger_from_json(text)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        # Other programs write free text into this conventional attribute.
        history = (LedgerEntry("read", f"history attribute of {file.name}: {text}"),)
    return columns, history


# No `Conventions`: those of CF want dated lines in `history`, and with a date in it the same record
# would not give the same file.
_ABOUT = {
    "title": "Flow and pressure coefficients of a compressor in surge, row by row",
    "comment": "history is the ledger of the reduction as JSON, one entry a step; it has no dates, "
    "so that the same record gives the same file",
}
_Reader = Callable[[Path], tuple[_Columns, tuple[LedgerEntry, ...]]]
_READERS: dict[str, _Reader] = {
    ".csv": _read_csv,
    ".nc": _read_netcdf,
    ".nc4": _read_netcdf,
    ".netcdf": _read_netcdf,
}


def _write_csv(series: CoefficientSeries, file: Path) -> None:
    import pyarrow as pa
    from pyarrow import csv

    columns = series.columns()
    whole = TRUTH_COLUMNS + COUNT_COLUMNS
    types = {name: pa.int64() if name in whole else pa.float64() for name in columns}
    # The shortest digits that read back as the same number: a series survives the round trip bit
    # for bit. The header is written by hand, since pyarrow puts it into quotes.
    options = csv.WriteOptions(include_header=False)
    with file.open("wb") as out:
        out.write((",".join(columns) + "\n").encode())
        with csv.CSVWriter(out, pa.schema(types), write_options=options) as writer:
            arrays = [pa.array(values, types[name]) for name, values in columns.items()]
            writer.write_batch(pa.record_batch(arrays, schema=pa.schema(types)))


def _write_netcdf_or_tell(series: CoefficientSeries, file: Path) -> None:
    try:
        _write_netcdf(series, file)
    except (RuntimeError, OSError) as error:
        # HDF5 tells in its own words of a full disk, perhaps not before it closes the file.
        cause = re.search(r"errno = (\d+), error message = '([^']*)'", str(error))
        if cause is None:
            raise
        raise OSError(int(cause[1]), cause[2]) from error


def _write_netcdf(series: CoefficientSeries, file: Path) -> None:
    import h5netcdf
    import h5py

    columns = series.columns()
    types = {name: _stored_type(name, values) for name, values in columns.items()}
    with h5netcdf.File(file, "w") as out:
        for name, text in _ABOUT.items():
            out.attrs[name] = text
        out.attrs["history"] = _ledger_json(series.history)
        out.attrs["source"] = series.source
        out.dimensions = {"time_s": series.n_samples}
        for name, kind in types.items():
            variable = out.create_variable(name, ("time_s",), kind)
            variable.attrs["units"] = UNITS[name]
            variable.attrs["long_name"] = LONG_NAMES[name]
    # The rows are no matter of netCDF any more, whose own way takes twice the time.
    with h5py.File(file, "r+") as out:
        for name, values in columns.items():
            variable = out[name]
            for first in range(0, series.n_samples, WRITTEN_ROWS):
                rows = slice(first, min(first + WRITTEN_ROWS, series.n_samples))
                part = values[rows].astype(types[name], copy=False)
                variable.write_direct(part, None, rows)


def _stored_type(name: str, values: NDArray[Any]) -> np.dtype[Any]:
    """Return the narrowest type that holds a column: a series of hours is large."""
    if name in TRUTH_COLUMNS:
        return np.dtype(np.int8)
    if name not in COUNT_COLUMNS:
        return np.dtype(values.dtype)
    most = int(values.max())
    return np.dtype(next((kind for largest, kind in COUNT_TYPES if most <= largest), np.int64))


def _ledger_json(history: tuple[LedgerEntry, ...]) -> str:
    return json.dumps([asdict(entry) for entry in history], indent=1, ensure_ascii=False)


def _ledger_from_json(text: str) -> tuple[LedgerEntry, ...]:
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
