"""Raw records as netCDF, 3 or 4: variables of one dimension, units and fill values heeded."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import FileLayout
from classic_ml.io.hdf5 import check_items
from classic_ml.io.table import RawFile
from classic_ml.io.vectors import Found, Vector, as_table
from classic_ml.units import kind_of_unit, time_conversion
from surge_core.types import FloatArray

__all__ = ["open_netcdf"]

_SINCE = re.compile(r"^\s*(?P<unit>\w+)\s+since\s+(?P<date>.+?)\s*$", re.IGNORECASE)
# What the netCDF library fills a float or double with that was never written.
_UNWRITTEN = 9.969209968386869e36


def open_netcdf(file: Path, layout: FileLayout, lenient: bool = False) -> RawFile:
    """Open a netCDF file; its rows are read slice by slice.

    Parameters
    ----------
    file : path
        An existing file, netCDF-3 or netCDF-4. Values that are ``_FillValue`` or
        ``missing_value`` are read as NaN, ``scale_factor`` and ``add_offset`` are applied. A
        time "since" a date counts from the first sample.
    layout : FileLayout
        The group to take.
    lenient : bool
        Of no effect here.

    Raises
    ------
    InputError
        When it is open which group is meant.
    """
    found = Found()
    with _opened(file) as groups:
        for group, dataset in groups.items():
            above = tuple(part for part in group.split("/") if part)
            for name, variable in dataset.variables.items():
                path = (*above, str(name))
                if variable.ndim != 1 or variable.dtype.kind not in "iufb":
                    found.aside[path] = "no vector of numbers"
                else:
                    found.vectors.append(_vector(path, group, variable))
    return as_table(str(file), found, layout, lambda: _opened(file))


@contextmanager
def _opened(file: Path) -> Iterator[Mapping[str, Any]]:
    """Open a file as one dataset a group, with its numbers as they are stored."""
    import xarray as xr

    # xarray would decode packed numbers to float32.
    plain: dict[str, Any] = {"decode_times": False, "mask_and_scale": False, "decode_coords": False}
    groups: dict[str, Any] = {}
    with file.open("rb") as opened:
        classic = opened.read(3) == b"CDF"
        opened.seek(0)
        if not classic:
            check_items(file)
        try:
            groups = (
                {"/": xr.open_dataset(opened, engine="scipy", **plain)}
                if classic
                else dict(xr.open_groups(file, engine="h5netcdf", **plain))
            )
            yield groups
        finally:
            for dataset in groups.values():
                dataset.close()


def _vector(path: tuple[str, ...], group: str, variable: Any) -> Vector:
    attributes = {str(key): value for key, value in variable.attrs.items()}
    unit = str(attributes.get("units", attributes.get("unit", "")))
    since = _SINCE.match(unit)
    dated = since is not None and kind_of_unit(since["unit"].lower()) == "time"
    factor = float(np.ravel(attributes.get("scale_factor", 1.0))[0])
    offset = float(np.ravel(attributes.get("add_offset", 0.0))[0])
    missing = [
        value
        for key in ("_FillValue", "missing_value")
        for value in np.ravel(attributes.get(key, ()))
    ]
    if variable.dtype.kind == "f":
        missing.append(np.asarray(_UNWRITTEN).astype(variable.dtype))
    plain = (factor, offset) == (1.0, 0.0) and not missing

    def read(handle: Any, start: int, stop: int) -> NDArray[Any]:
        stored = handle[group].variables[path[-1]][start:stop].values
        if plain:
            return np.asarray(stored)
        numbers: FloatArray = stored.astype(np.float64) * factor + offset
        for value in missing:
            numbers[stored == value] = np.nan
        return numbers

    if since is None or not dated:
        return Vector(path, variable.size, read, unit)
    first = float(variable[0].values) if variable.size else 0.0
    step_s = time_conversion(since["unit"].lower(), "").factor

    def seconds(handle: Any, start: int, stop: int) -> NDArray[Any]:
        # The difference first: a date in nanoseconds is no double.
        return np.asarray((handle[group].variables[path[-1]][start:stop].values - first) * step_s)

    stamp = f"seconds from the first sample at {_date(since['date'], first * step_s)}"
    return Vector(path, variable.size, seconds, "s", stamp)


def _date(origin: str, later_s: float) -> str:
    """Return the date so many seconds after another, in words where it is in no calendar here."""
    import pandas as pd

    try:
        return (pd.Timestamp(origin) + pd.Timedelta(later_s, "s")).isoformat()
    except (ValueError, OverflowError):
        return f"{later_s:g} s since {origin}"
