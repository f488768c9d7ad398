"""Series files: φ, ψ' and ψ over time as CSV or netCDF, with the ledger of their reduction."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from classic_ml.description import FileLayout
from classic_ml.io.csv import open_csv
from classic_ml.io.netcdf import check_items
from classic_ml.io.table import fault_of
from classic_ml.records import LedgerEntry
from classic_ml.series import COLUMNS, KNOWN, RAKE_COLUMN, REQUIRED_COLUMNS, CoefficientSeries
from surge_core.errors import InputError
from surge_core.files import replace_whole
from surge_core.types import FloatArray

# A compressor surges a few times a second: what is sampled more slowly shows no cycle.
LONGEST_STEP_S = 0.05
SUFFIXES = (".csv", ".nc", ".nc4", ".netcdf")
# No `Conventions`: those of CF want dated lines in `history`, and with a date in it the same record
# would not give the same file.
_ABOUT = {
    "title": "Flow and pressure coefficients of a compressor in surge, row by row",
    "comment": "history is the ledger of the reduction as JSON, one entry a step; it has no dates, "
    "so that the same record gives the same file",
}
_Columns = dict[str, NDArray[Any]]
_History = tuple[LedgerEntry, ...]
_LEDGER = TypeAdapter(_History)


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
        columns, history = _read_csv(file) if is_csv else _read_netcdf(file)
    except Exception as error:
        raise fault_of(error, str(file), "a series file") from None
    _check_step(columns["time_s"], file)
    columns.setdefault("segment", np.ones(columns["time_s"].size))
    rakes = {name: columns.pop(name) for name in list(columns) if name not in COLUMNS}
    return CoefficientSeries(**columns, rakes=rakes, source=str(file), history=history)


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


def _check_names(file: Path, names: tuple[str, ...]) -> list[str]:
    """Return which columns of a file are those of a series, or refuse a file that lacks some."""
    missing = [name for name in REQUIRED_COLUMNS if name not in names]
    if missing:
        raise InputError(
            str(file),
            expected=f"the columns {', '.join(REQUIRED_COLUMNS)}",
            found=f"no column {', '.join(missing)}",
            remedy="rename 'time' to 'time_s', in seconds"
            if missing == ["time_s"] and "time" in names
            else "a raw record goes through `sindy-surge reduce` first",
        )
    known = [name for name in COLUMNS if name in names]
    return [*known, *(name for name in names if RAKE_COLUMN.fullmatch(name))]


def _check_step(time_s: FloatArray, file: Path) -> None:
    """Refuse a clock in whose steps no surge could be seen: it is in another unit."""
    # A time that is no number is refused when the series is made.
    step = float(np.median(np.diff(time_s))) if np.isfinite(time_s).all() and time_s.ndim else 0.0
    if step > LONGEST_STEP_S:
        raise InputError(
            f"{file}: column time_s",
            expected=f"seconds, with steps of at most {LONGEST_STEP_S:g} s",
            found=f"steps of {step:g}",
            remedy="is time_s in ms? then divide it by 1000",
        )


def _read_csv(file: Path) -> tuple[_Columns, _History]:
    with open_csv(file, FileLayout()) as table:
        names = _check_names(file, table.names)
        blocks = list(table.blocks(tuple(names)))
    columns = {name: np.concatenate([b[k] for b in blocks]) for k, name in enumerate(names)}
    ledger = ledger_path(file)
    if not ledger.is_file():
        return columns, ()
    try:
        return columns, _LEDGER.validate_json(ledger.read_bytes())
    except ValueError as error:
        raise InputError(
            str(ledger),
            expected="the ledger that `sindy-surge reduce` wrote",
            found=f"something else ({' '.join(str(error).split())[:160]})",
            remedy="delete it or reduce the record again",
        ) from None


def _read_netcdf(file: Path) -> tuple[_Columns, _History]:
    import xarray as xr

    check_items(file)
    with xr.open_dataset(
        file, engine="h5netcdf", decode_times=False, decode_timedelta=False
    ) as dataset:
        names = _check_names(file, tuple(map(str, dataset.variables)))
        columns = {name: dataset[name].values for name in names}
        text = str(dataset.attrs.get("history", "[]"))
    try:
        return columns, _LEDGER.validate_json(text)
    except ValueError:
        # Other programs write free text into this conventional attribute.
        return columns, (LedgerEntry("read", f"history attribute of {file.name}: {text}"),)


def _write_csv(series: CoefficientSeries, file: Path) -> None:
    import pyarrow as pa
    from pyarrow import csv

    columns = series.columns()
    table = pa.table(
        {n: v.astype(np.int64) if v.dtype == np.bool_ else v for n, v in columns.items()}
    )
    # The shortest digits that read back as the same number. The header is written by hand, since
    # pyarrow puts it into quotes.
    with file.open("wb") as out:
        out.write((",".join(columns) + "\n").encode())
        csv.write_csv(table, out, csv.WriteOptions(include_header=False))


def _write_netcdf(series: CoefficientSeries, file: Path) -> None:
    import h5netcdf

    # Truths and counts are small: a series of hours is large.
    small = {np.bool_: np.int8, np.int64: np.int32}
    origin = {"history": _ledger_json(series.history), "source": series.source}
    try:
        with h5netcdf.File(file, "w") as opened:
            opened.attrs.update(_ABOUT | origin)
            opened.dimensions["time_s"] = series.n_samples
            for name, values in series.columns().items():
                data = values.astype(small.get(values.dtype.type, values.dtype), copy=False)
                column = opened.create_variable(name, ("time_s",), data.dtype, data)
                if name in KNOWN:
                    about = {"units": KNOWN[name].unit, "long_name": KNOWN[name].long_name}
                    column.attrs.update(about)
    except RuntimeError as error:
        # HDF5 says in its own words that a disk is full, perhaps not before it closes the file.
        raise OSError(str(error)) from error


def _ledger_json(history: _History) -> str:
    return json.dumps([asdict(entry) for entry in history], indent=1, ensure_ascii=False)
