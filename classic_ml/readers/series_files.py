"""Series files: φ, ψ' and ψ over time as CSV or netCDF, with the ledger of their reduction."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from classic_ml.errors import InputError
from classic_ml.files import replace_whole
from classic_ml.records import Dropped, FloatArray, LedgerEntry
from classic_ml.series import (
    COLUMNS,
    COUNT_COLUMNS,
    MINIMUM_ROWS,
    REQUIRED_COLUMNS,
    TRUTH_COLUMNS,
    UNITS,
    CoefficientSeries,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["ledger_path", "read_series", "write_series"]


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
    missing = [name for name in REQUIRED_COLUMNS if name not in table.columns]
    if missing:
        raise InputError(
            str(file),
            expected=f"the columns {', '.join(REQUIRED_COLUMNS)}",
            found=f"no column {', '.join(missing)}",
            remedy="rename 'time' to 'time_s', in seconds"
            if missing == ["time_s"] and "time" in table.columns
            else "a raw record goes through `sindy-surge reduce` first",
        )
    known = {name: _as_numbers(table, name, file) for name in COLUMNS if name in table.columns}
    if known["time_s"].size < MINIMUM_ROWS:
        raise InputError(
            str(file),
            expected=f"at least {MINIMUM_ROWS} rows",
            found=f"{known['time_s'].size}",
        )
    known.setdefault("segment", np.ones(known["time_s"].size))
    return CoefficientSeries(**known, source=str(file), history=history)  # type: ignore[arg-type]


def write_series(series: CoefficientSeries, path: str | os.PathLike[str]) -> None:
    """Write a series file, whole or not at all, with its ledger.

    A netCDF file carries the ledger as the attribute ``history``; beside a CSV file it is
    written as ``NAME.ledger.json``.

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
    if file.suffix.lower() not in _READERS:
        raise InputError(
            str(file),
            expected="an output file ending in .csv or .nc",
            found=f"the suffix '{file.suffix}'",
        )
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


# What pandas and spreadsheets write for a column of truth values.
_TRUTH = {"true": 1.0, "false": 0.0}


def _as_numbers(table: pd.DataFrame, name: str, file: Path) -> FloatArray:
    column = table[name].to_numpy(dtype=object, na_value=np.nan)
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


def _read_csv(file: Path) -> tuple[pd.DataFrame, tuple[LedgerEntry, ...]]:
    import pandas as pd

    _check_separator(file)
    try:
        # Without a header row pandas keeps doubled names apart, so that they can be refused.
        table = pd.read_csv(file, header=None, dtype=str, skipinitialspace=True, comment="#")
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise InputError(
            str(file),
            expected="a CSV table with a header",
            found=str(error).strip().splitlines()[0],
        ) from None
    names = [str(name).strip() for name in table.iloc[0]]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise InputError(
            str(file),
            expected="each column once",
            found=f"{doubled[0]} {names.count(doubled[0])} times",
        )
    table = table.iloc[1:].reset_index(drop=True)
    table.columns = pd.Index(names)
    return table, _read_ledger(ledger_path(file))


def _check_separator(file: Path) -> None:
    """Refuse a header that another character than a comma takes apart."""
    with file.open(encoding="utf-8-sig", errors="replace", newline="") as lines:
        header = next((row for row in lines if row.strip() and not row.startswith("#")), "")
    for separator in (";", "\t"):
        names = {name.strip().strip('"') for name in header.split(separator)}
        if len(names) > 1 and names & {*COLUMNS, "time"}:
            raise InputError(
                str(file),
                expected="columns separated by commas",
                found=f"the separator is {separator!r}",
                remedy="save with commas and decimal points",
            )


def _read_ledger(file: Path) -> tuple[LedgerEntry, ...]:
    if not file.is_file():
        return ()
    try:
        return _ledger_from_json(file.read_text("utf-8"))
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            str(file),
            expected="the ledger that `sindy-surge reduce` wrote",
            found=f"something else ({error})",
            remedy="delete it or reduce the record again",
        ) from None


def _read_netcdf(file: Path) -> tuple[pd.DataFrame, tuple[LedgerEntry, ...]]:
    import pandas as pd
    import xarray as xr

    try:
        with xr.open_dataset(
            file, engine="h5netcdf", decode_times=False, decode_timedelta=False
        ) as dataset:
            columns = {
                str(name): np.atleast_1d(variable.values)
                for name, variable in dataset.variables.items()
                if variable.ndim == 1
            }
            text = str(dataset.attrs.get("history", "[]"))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            str(file),
            expected="a netCDF-4 file",
            found=str(error).strip().splitlines()[0],
        ) from None
    lengths = {values.size for values in columns.values()}
    if len(lengths) > 1:
        raise InputError(
            str(file), expected="columns of one length", found=f"lengths {sorted(lengths)}"
        )
    try:
        history = _ledger_from_json(text)
    except (ValueError, TypeError, KeyError):
        # Other programs write free text into this conventional attribute.
        history = (LedgerEntry("read", f"history attribute of {file.name}: {text}"),)
    return pd.DataFrame(columns), history


_Reader = Callable[[Path], "tuple[pd.DataFrame, tuple[LedgerEntry, ...]]"]
_READERS: dict[str, _Reader] = {
    ".csv": _read_csv,
    ".nc": _read_netcdf,
    ".nc4": _read_netcdf,
    ".netcdf": _read_netcdf,
}


def _write_csv(series: CoefficientSeries, file: Path) -> None:
    import pandas as pd

    columns = {
        name: values.astype(np.int64) if name in TRUTH_COLUMNS + COUNT_COLUMNS else values
        for name, values in series.columns().items()
    }
    # repr-exact floats: a series survives the round trip bit for bit.
    pd.DataFrame(columns).to_csv(file, index=False)


def _write_netcdf(series: CoefficientSeries, file: Path) -> None:
    import xarray as xr

    variables = {
        name: ("time_s", values.astype(np.int8) if name in TRUTH_COLUMNS else values)
        for name, values in series.columns().items()
        if name != "time_s"
    }
    dataset = xr.Dataset(
        variables,
        coords={"time_s": series.time_s},
        attrs={"history": _ledger_json(series.history), "source": series.source},
    )
    for name in dataset.variables:
        dataset[name].attrs["units"] = UNITS[str(name)]
    dataset.to_netcdf(file, engine="h5netcdf")


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
