"""Raw records as netCDF, 3 or 4: variables of one dimension, as xarray unpacks them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from classic_ml.description import FileLayout
from classic_ml.io.table import StoredTable, Vector, grouped, stated_unit


@contextmanager
def open_netcdf(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open a netCDF file, version 3 or 4; its rows are read slice by slice.

    Values that are ``_FillValue`` or ``missing_value`` are NaN, ``scale_factor`` and
    ``add_offset`` are applied, a time "since" a date is a number. Arguments as
    :func:`classic_ml.io.formats.open_stored` has them.
    """
    import xarray as xr

    plain: Any = {"decode_times": False, "decode_timedelta": False}
    with ExitStack() as stack:
        opened = stack.enter_context(file.open("rb"))
        is_classic = opened.read(3) == b"CDF"
        opened.seek(0)
        if is_classic:
            # By its name, scipy would map it into memory, and complain when it is closed.
            groups = {"/": xr.open_dataset(opened, engine="scipy", **plain)}
        else:
            check_items(file)
            groups = dict(xr.open_groups(file, engine="h5netcdf", **plain))
        for dataset in groups.values():
            stack.callback(dataset.close)
        vectors, left_aside = [], {}
        for group, dataset in groups.items():
            above = tuple(part for part in group.split("/") if part)
            for name, variable in dataset.variables.items():
                path = (*above, str(name))
                if variable.ndim == 1 and variable.size and variable.dtype.kind in "iufb":
                    unit = stated_unit(variable.attrs).partition(" since ")[0]
                    vectors.append(Vector(path, variable, unit))
                else:
                    left_aside["/".join(path)] = "no vector of numbers"
        yield grouped(str(file), vectors, layout, left_aside)


def check_items(file: Path) -> None:
    """Look at each item of an HDF5 file, so that a damaged one is refused here.

    h5netcdf leaves a file half open over it, and complains of that on its own later.
    """
    import h5py

    with h5py.File(file, "r") as handle:
        handle.visititems(lambda _, item: len(dict(item.attrs)) and None)
