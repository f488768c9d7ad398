"""The clean raw record in every binary format that is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

__all__ = ["WRITERS", "columns_of", "write_stored"]

Columns = dict[str, np.ndarray]


def columns_of(folder: Path) -> Columns:
    """Return the columns of the raw record of a folder, codes as 16-bit integers."""
    read = pd.read_csv(folder / "raw.csv")
    return {
        name: read[name].to_numpy(np.uint16 if name.startswith("P") else np.float64)
        for name in read.columns
    }


def _mat(path: Path, columns: Columns) -> None:
    from scipy.io import savemat

    savemat(path, columns)


def _hdf5(path: Path, columns: Columns) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values


def _netcdf(path: Path, columns: Columns) -> None:
    import xarray as xr

    data = {name: ("row", values) for name, values in columns.items()}
    xr.Dataset(data).to_netcdf(path, engine="h5netcdf")


def _tdms(path: Path, columns: Columns) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as file:
        file.write_segment([ChannelObject("run", name, v) for name, v in columns.items()])


def _parquet(path: Path, columns: Columns) -> None:
    pd.DataFrame(columns).to_parquet(path)


WRITERS: dict[str, Callable[[Path, Columns], None]] = {
    ".mat": _mat,
    ".h5": _hdf5,
    ".nc": _netcdf,
    ".tdms": _tdms,
    ".parquet": _parquet,
}


def write_stored(folder: Path, suffix: str) -> Path:
    """Write the record of a folder in another format beside it."""
    path = folder / f"raw{suffix}"
    WRITERS[suffix](path, columns_of(folder))
    return path
