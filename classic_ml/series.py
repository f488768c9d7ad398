"""CoefficientSeries: φ, ψ' and ψ over time, as the estimators take them, and its files."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml.errors import InputError
from classic_ml.records import Dropped, FloatArray, LedgerEntry

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["MINIMUM_ROWS", "CoefficientSeries", "ledger_path", "read_series", "write_series"]

MINIMUM_ROWS = 100
REQUIRED_COLUMNS = ("time_s", "phi", "psi_p")
OPTIONAL_COLUMNS = ("psi", "T25_K", "Nc_frac", "in_stall", "segment")
COLUMNS = REQUIRED_COLUMNS + OPTIONAL_COLUMNS
UNITS = {
    "time_s": "s",
    "phi": "1",
    "psi_p": "1",
    "psi": "1",
    "T25_K": "K",
    "Nc_frac": "1",
    "in_stall": "1",
    "segment": "1",
}
# Beyond these no compressor works: φ = 1 is already an axial Mach number of order one at any
# useful wheel speed, and ψ' = 100 would be a pressure ratio beyond 10^4 at 300 m/s.
POSSIBLE = {
    "phi": (-3.0, 3.0),
    "psi_p": (-100.0, 100.0),
    "psi": (-1000.0, 1000.0),
    "T25_K": (50.0, 3000.0),
    "Nc_frac": (0.01, 2.0),
}
# A clock printed with few digits jitters; half a period off the straight line is a lost sample.
CLOCK_TOLERANCE = 0.45


@dataclass(frozen=True)
class CoefficientSeries:
    """Flow and pressure coefficients of one record on a uniform clock.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Facility clock, in seconds.
    phi : ndarray of shape (n,)
        Flow coefficient C_z/U.
    psi_p : ndarray of shape (n,)
        Instantaneous pressure coefficient ψ'.
    segment : ndarray of int, shape (n,)
        1, 2, … in the intervals to be fitted, 0 elsewhere.
    psi : ndarray of shape (n,), optional
        Instantaneous work coefficient ψ.
    T25_K : ndarray of shape (n,), optional
        Inlet total temperature, in kelvin.
    Nc_frac : ndarray of shape (n,), optional
        Corrected speed as a fraction of design.
    in_stall : ndarray of bool, shape (n,), optional
        True while the machine is in stall.
    source : str
        File or record that the series came from.
    history : tuple of LedgerEntry
        What was done to get here.

    Raises
    ------
    InputError
        For anything DESIGN section 5 refuses: fewer than 100 rows, non-finite or impossible
        values, a clock that is not uniform, constant φ or ψ'.
    """

    time_s: FloatArray
    phi: FloatArray
    psi_p: FloatArray
    segment: NDArray[np.int64]
    psi: FloatArray | None = None
    T25_K: FloatArray | None = None
    Nc_frac: FloatArray | None = None
    in_stall: NDArray[np.bool_] | None = None
    source: str = "series"
    history: tuple[LedgerEntry, ...] = ()

    def __post_init__(self) -> None:
        for name in COLUMNS:
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, _frozen_column(name, values, self.source))
        _check_lengths(self)
        _check_clock(self.time_s, self.source)
        _check_values(self)

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return int(self.time_s.size)

    @property
    def sample_period_s(self) -> float:
        """Time between two rows, in seconds."""
        return float((self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1))

    @property
    def sample_rate_hz(self) -> float:
        """Rows a second."""
        return 1.0 / self.sample_period_s

    @property
    def scored(self) -> NDArray[np.bool_]:
        """Rows that lie in an interval to be fitted."""
        return np.asarray(self.segment > 0)

    @property
    def n_segments(self) -> int:
        """Number of intervals to be fitted."""
        return int(np.unique(self.segment[self.segment > 0]).size)

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Return the columns that are known, in the order of the series file."""
        present = {name: getattr(self, name) for name in COLUMNS}
        return {name: values for name, values in present.items() if values is not None}


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
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(
            str(file),
            expected="a series file ending in .csv or .nc",
            found=f"the suffix '{file.suffix}'",
        )
    if not file.is_file():
        raise InputError(
            str(file),
            expected="a series file",
            found="a folder" if file.is_dir() else "no such file",
        )
    table, history = reader(file)
    missing = [name for name in REQUIRED_COLUMNS if name not in table.columns]
    if missing:
        raise InputError(
            str(file),
            expected=f"the columns {', '.join(REQUIRED_COLUMNS)}",
            found=f"no column {', '.join(missing)}",
            remedy="a raw record goes through `sindy-surge reduce` first",
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
    if not file.parent.is_dir():
        raise InputError(str(file), expected="an existing folder", found=f"no folder {file.parent}")
    if file.suffix.lower() == ".csv":
        _write_atomically(file, lambda temporary: _write_csv(series, temporary))
        _write_atomically(
            ledger_path(file),
            lambda temporary: temporary.write_text(_ledger_json(series.history), "utf-8"),
        )
    else:
        _write_atomically(file, lambda temporary: _write_netcdf(series, temporary))


def ledger_path(path: Path) -> Path:
    """Return where the ledger of a CSV series lies."""
    return path.with_suffix(".ledger.json")


def _frozen_column(name: str, values: NDArray[np.generic], source: str) -> NDArray[np.generic]:
    column: NDArray[np.generic]
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.ndim != 1:
        raise InputError(
            f"{source}: column {name}",
            expected="one value a row",
            found=f"shape {numbers.shape}",
        )
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        raise InputError(
            f"{source}: column {name}",
            expected="a finite number in every row",
            found=f"{numbers[bad[0]]} in row {bad[0] + 1}"
            + (f" and {bad.size - 1} more" if bad.size > 1 else ""),
            remedy="cut the record there or repair the channel",
        )
    if name == "segment":
        if np.any(numbers != np.round(numbers)) or np.any(numbers < 0):
            raise InputError(
                f"{source}: column segment",
                expected="whole numbers from 0 on",
                found=f"{numbers[(numbers != np.round(numbers)) | (numbers < 0)][0]}",
            )
        column = numbers.astype(np.int64)
    elif name == "in_stall":
        if not np.all(np.isin(numbers, (0.0, 1.0))):
            raise InputError(
                f"{source}: column in_stall",
                expected="0 or 1",
                found=f"{numbers[~np.isin(numbers, (0.0, 1.0))][0]}",
            )
        column = numbers.astype(np.bool_)
    else:
        column = numbers.copy()
    column.setflags(write=False)
    return column


def _check_lengths(series: CoefficientSeries) -> None:
    lengths = {name: values.size for name, values in series.columns().items()}
    if len(set(lengths.values())) > 1:
        raise InputError(series.source, expected="columns of one length", found=str(lengths))
    if series.n_samples < MINIMUM_ROWS:
        raise InputError(
            series.source, expected=f"at least {MINIMUM_ROWS} rows", found=f"{series.n_samples}"
        )


def _check_clock(time_s: FloatArray, source: str) -> None:
    steps = np.diff(time_s)
    where = f"{source}: column time_s"
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        kind = "repeats" if steps[back[0]] == 0.0 else "runs back"
        raise InputError(
            where,
            expected="a clock that runs forward",
            found=f"that it {kind} at row {back[0] + 2} ({time_s[back[0] + 1]:g} s)",
        )
    period = float(np.median(steps))
    # The median step of a rounded clock is itself rounded; the mean of the steps near it is not.
    period = float(np.mean(steps[np.abs(steps - period) < CLOCK_TOLERANCE * period]))
    off = np.flatnonzero(np.abs(steps - period) > CLOCK_TOLERANCE * period)
    if off.size == 0:
        line = time_s[0] + np.arange(time_s.size) * (time_s[-1] - time_s[0]) / steps.size
        off = np.flatnonzero(np.abs(time_s - line)[1:] > CLOCK_TOLERANCE * period)
    if off.size:
        raise InputError(
            where,
            expected=f"a uniform step (here {period:g} s)",
            found=f"a step of {steps[off[0]]:g} s after {time_s[off[0]]:g} s",
            remedy="fill the gap at the source or write one file a record",
        )


def _check_values(series: CoefficientSeries) -> None:
    columns = series.columns()
    for name, (low, high) in POSSIBLE.items():
        if name not in columns:
            continue
        values = columns[name].astype(np.float64)
        bad = np.flatnonzero((values < low) | (values > high))
        if bad.size:
            raise InputError(
                f"{series.source}: column {name}",
                expected=f"values between {low:g} and {high:g} {UNITS[name]}".replace(" 1", ""),
                found=f"{values[bad[0]]:g} in row {bad[0] + 1}",
                remedy="check the units and the calibration",
            )
    for name in ("phi", "psi_p"):
        if np.ptp(columns[name]) == 0.0:
            raise InputError(
                f"{series.source}: column {name}",
                expected="a signal that moves",
                found=f"the constant {columns[name][0]:g}",
                remedy="a lag cannot be identified without excitation",
            )


def _as_numbers(table: pd.DataFrame, name: str, file: Path) -> FloatArray:
    column = table[name].to_numpy(dtype=object, na_value=np.nan)
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
        with xr.open_dataset(file, engine="h5netcdf") as dataset:
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
        name: values.astype(np.int64) if name in ("in_stall", "segment") else values
        for name, values in series.columns().items()
    }
    # repr-exact floats: a series survives the round trip bit for bit.
    pd.DataFrame(columns).to_csv(file, index=False)


def _write_netcdf(series: CoefficientSeries, file: Path) -> None:
    import xarray as xr

    variables = {
        name: ("time_s", values.astype(np.int8) if name == "in_stall" else values)
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


def _write_atomically(file: Path, write: Callable[[Path], object]) -> None:
    handle, name = tempfile.mkstemp(dir=file.parent, suffix=file.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        # mkstemp makes files for the owner alone; a result is as public as the folder it lies in.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(file)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


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
