"""Which reader a file of raw records goes to, and the one place where its errors become ours."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from classic_ml.description import FileLayout
from classic_ml.io.csv import open_csv
from classic_ml.io.hdf5 import open_hdf5
from classic_ml.io.mat import open_mat
from classic_ml.io.netcdf import open_netcdf
from classic_ml.io.parquet import open_parquet
from classic_ml.io.table import StoredTable, fault_of
from classic_ml.io.tdms import open_tdms
from surge_core.errors import InputError

_FORMATS = {
    "a CSV table": (open_csv, (".csv",)),
    "a MAT file": (open_mat, (".mat",)),
    "a netCDF file": (open_netcdf, (".nc", ".nc4", ".netcdf")),
    "an HDF5 file": (open_hdf5, (".h5", ".hdf5", ".hdf")),
    "a TDMS file": (open_tdms, (".tdms",)),
    "a Parquet file": (open_parquet, (".parquet", ".pq")),
}


@contextmanager
def open_stored(
    raw_path: str | os.PathLike[str], layout: FileLayout | None = None
) -> Iterator[StoredTable]:
    """Open a raw record, by the suffix of its name, as it is.

    Given are the columns of numbers of the record's length, as the layout says where in the file
    they are and which is the clock; the table is open within the ``with`` alone.
    """
    file = Path(raw_path)
    if not file.is_file():
        found = "a folder" if file.is_dir() else "no such file"
        raise InputError(str(file), expected="a raw record", found=found)
    suffix = file.suffix.lower()
    for what, (reader, suffixes) in _FORMATS.items():
        if suffix in suffixes:
            with ExitStack() as stack:
                try:
                    table = stack.enter_context(reader(file, layout or FileLayout()))
                except Exception as error:
                    raise fault_of(error, str(file), what) from None
                yield table
            return
    known = " or ".join(suffix for _, suffixes in _FORMATS.values() for suffix in suffixes)
    raise InputError(
        str(file),
        expected=f"a raw record ending in {known}",
        found=f"the suffix '{file.suffix}'",
        remedy="export it as .csv; a table of text with a header needs that name alone",
    )
