"""One raw record in every format that is read, each written by its own library."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from raw_data import write_csv
from scipy.io import savemat

Columns = dict[str, np.ndarray]


def _csv_with(separator: str, decimal: str) -> Callable[[Path, Columns], None]:
    def write(path: Path, columns: Columns) -> None:
        pd.DataFrame(columns).to_csv(path, sep=separator, decimal=decimal, index=False)

    return write


def _mat(path: Path, columns: Columns) -> None:
    savemat(path, columns, do_compression=True, long_field_names=True)


def _mat_struct(path: Path, columns: Columns) -> None:
    upright = {name: values[:, np.newaxis] for name, values in columns.items()}
    savemat(path, {"run": upright, "note": "a text"}, long_field_names=True)


def _mat_73(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file[f"run/{name}"] = values[np.newaxis, :]
            file[f"run/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        letters = file.create_dataset("note", data=np.frombuffer("µm".encode("utf-16-le"), "<u2"))
        letters.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def _netcdf(path: Path, columns: Columns, engine: str = "h5netcdf") -> None:
    variables = {name: ("row", values) for name, values in columns.items()}
    xr.Dataset(variables).to_netcdf(path, engine=engine)


def _hdf5(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"daq/{name}", data=values, compression="gzip", chunks=True)


def _hdf5_compound(path: Path, columns: Columns) -> None:
    kinds = [(name, values.dtype) for name, values in columns.items()]
    rows = np.zeros(columns["time_s"].size, dtype=kinds)
    for name, values in columns.items():
        rows[name] = values
    with h5py.File(path, "w") as file:
        file["table"] = rows


def _tdms(path: Path, columns: Columns) -> None:
    with TdmsWriter(path) as file:
        file.write_segment([ChannelObject("daq", name, v) for name, v in columns.items()])


def _parquet(path: Path, columns: Columns) -> None:
    pq.write_table(pa.table(columns), path, row_group_size=100)


FORMS: dict[str, tuple[str, Callable[[Path, Columns], None]]] = {
    "CSV": (".csv", write_csv),
    "CSV of semicolons and decimal commas": (".csv", _csv_with(";", ",")),
    "CSV of tabs": (".csv", _csv_with("\t", ".")),
    "MAT": (".mat", _mat),
    "MAT struct": (".mat", _mat_struct),
    "MAT 7.3": (".mat", _mat_73),
    "netCDF": (".nc", _netcdf),
    "netCDF-3": (".nc", lambda path, columns: _netcdf(path, columns, "scipy")),
    "HDF5": (".h5", _hdf5),
    "HDF5 compound": (".h5", _hdf5_compound),
    "TDMS": (".tdms", _tdms),
    "Parquet": (".parquet", _parquet),
}


def write_stored(folder: Path, suffix: str) -> Path:
    """Write the raw record of a folder in another format beside it, codes as 16-bit integers."""
    read = pd.read_csv(folder / "raw.csv")
    columns = {
        name: read[name].to_numpy(np.uint16 if name.startswith("P") else np.float64)
        for name in read.columns
    }
    path = folder / f"raw{suffix}"
    next(write for ending, write in FORMS.values() if ending == suffix)(path, columns)
    return path
