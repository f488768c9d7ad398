"""Raw records as netCDF, classic or 4: variables of one dimension, units and fill values heeded."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.readers.hdf5_claims import attributes_of
from classic_ml.readers.netcdf_classic import ClassicVariable, read_header
from classic_ml.readers.raw_columns import as_columns, one_line
from classic_ml.readers.raw_hdf5 import UNIT_ATTRIBUTES, Walk, hdf5_columns, unit_of
from classic_ml.readers.raw_table import RawFile, cannot_be_read
from classic_ml.readers.raw_tree import Leaf, Node, Tree, Unreadable, vectors
from classic_ml.readers.test_description import FileLayout
from classic_ml.units import kind_of_unit, time_conversion
from surge_core.types import FloatArray

__all__ = ["open_netcdf"]

# What the netCDF library fills a variable with that nobody has written, for float and double.
_UNWRITTEN = 9.969209968386869e36
_SINCE = re.compile(r"^\s*(?P<unit>\w+)\s+since\s+(?P<date>.+?)\s*$", re.IGNORECASE)
_CLASSIC = b"CDF"
_PACKING = ("_FillValue", "missing_value", "scale_factor", "add_offset")
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"

Read = Callable[[Any, tuple[Any, ...]], NDArray[Any]]


def open_netcdf(file: Path, layout: FileLayout) -> RawFile:
    """Open a netCDF file; its rows are read slice by slice.

    Parameters
    ----------
    file : path
        An existing file, netCDF-3 or netCDF-4. Values that are ``_FillValue`` or
        ``missing_value`` are read as NaN, ``scale_factor`` and ``add_offset`` are applied. A
        time "since" a date counts from the first sample.
    layout : FileLayout
        The group to take.

    Returns
    -------
    RawFile
        The columns of one length.

    Raises
    ------
    InputError
        When the file is spoiled, or it is open which group is meant.
    """
    with file.open("rb") as opened:
        classic = opened.read(len(_CLASSIC)) == _CLASSIC
    if not classic:
        return hdf5_columns(file, layout, "a netCDF file", _decoded)
    try:
        found, aside = vectors(_classic_tree(file))
    except (ValueError, OSError) as error:
        raise cannot_be_read(file, "a netCDF file", one_line(error)) from None
    return as_columns(str(file), found, layout, lambda: file.open("rb"), aside)


def _decoded(item: Any, _: Walk) -> Node | None:
    """Return a variable of a netCDF-4 file with its attributes heeded."""
    import h5py

    if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "iuf":
        return None
    attributes = attributes_of(item, (*UNIT_ATTRIBUTES, *_PACKING, "NAME"))
    title = attributes.get("NAME", b"")
    title = title.decode("utf-8", "replace") if isinstance(title, bytes) else str(title)
    if title.startswith(_NO_VARIABLE):
        return Unreadable("a dimension without values")
    path = item.name
    return _leaf(item.shape, item.dtype, attributes, lambda h, i: np.asarray(h[path][i]), item.file)


def _classic_tree(file: Path) -> Tree:
    tree: Tree = {}
    with file.open("rb") as handle:
        for variable in read_header(file):
            if variable.dtype.kind not in "iuf" or 0 in variable.shape:
                tree[variable.name] = Unreadable(
                    "a text" if variable.dtype.kind == "S" else "nothing in it"
                )
                continue

            def read(
                opened: Any, index: tuple[Any, ...], variable: ClassicVariable = variable
            ) -> NDArray[Any]:
                return np.array(variable.values(opened)[index])

            tree[variable.name] = _leaf(
                variable.shape, variable.dtype, variable.attributes, read, handle
            )
    return tree


@dataclass(frozen=True)
class _Packing:
    """What stands for nothing, and how a packed number is unpacked."""

    missing: tuple[float, ...]
    factor: float
    offset: float

    def __call__(self, values: NDArray[Any]) -> FloatArray:
        unpacked = values.astype(np.float64)
        if self.factor != 1.0 or self.offset != 0.0:
            unpacked = unpacked * self.factor + self.offset
        for number in self.missing:
            unpacked[values == number] = np.nan
        return unpacked


def _leaf(
    shape: tuple[int, ...], dtype: Any, attributes: Mapping[str, Any], read: Read, handle: Any
) -> Leaf | Unreadable:
    unit = unit_of(attributes)
    since = _SINCE.match(unit)
    is_date = since is not None and kind_of_unit(since["unit"].lower()) == "time"
    if since is not None and is_date and sum(size > 1 for size in shape) == 1:
        return _dated(shape, since, read, handle)
    packing = _packing(dtype, attributes)
    if isinstance(packing, Unreadable):
        return packing
    return Leaf(shape, lambda h, index: packing(np.asarray(read(h, index))), unit)


def _packing(dtype: Any, attributes: Mapping[str, Any]) -> _Packing | Unreadable:
    """Return how the numbers of a variable are to be taken, as its attributes say."""
    stated: dict[str, list[float]] = {}
    for key in _PACKING:
        try:
            stated[key] = _numbers(attributes[key]) if key in attributes else []
        except (TypeError, ValueError, OverflowError):
            return Unreadable(f"a variable whose {key} is no number")
    for key in ("scale_factor", "add_offset"):
        if key in attributes and not stated[key]:
            return Unreadable(f"a variable whose {key} is empty")
    missing = stated["_FillValue"] + stated["missing_value"]
    if dtype.kind == "f":
        # The fill value of a float is no double's, and is compared as the float that it is.
        missing.append(float(np.asarray(_UNWRITTEN).astype(dtype)))
    factor, offset = [*stated["scale_factor"], 1.0][0], [*stated["add_offset"], 0.0][0]
    return _Packing(tuple(missing), factor, offset)


def _numbers(attribute: Any) -> list[float]:
    """Return the numbers of an attribute; none where it is empty."""
    import h5py

    if isinstance(attribute, h5py.Empty):
        return []
    return [float(number) for number in np.ravel(attribute)]


def _dated(shape: tuple[int, ...], since: re.Match[str], read: Read, handle: Any) -> Leaf:
    """Return times since a date as seconds from the first of them."""
    factor = time_conversion(since["unit"].lower(), "").factor
    first = np.ravel(read(handle, tuple(slice(0, 1) for _ in shape)))[0]
    text = f"{first} {since['unit']} since {since['date']}"
    try:
        origin = datetime.fromisoformat(since["date"].strip())
        text = (origin + timedelta(seconds=float(first) * factor)).isoformat()
    except (ValueError, OverflowError):
        pass

    def seconds(opened: Any, index: tuple[Any, ...]) -> FloatArray:
        # The difference first: a date in nanoseconds is no double.
        return np.asarray((read(opened, index) - first) * factor, dtype=np.float64)

    return Leaf(shape, seconds, "s", clock=f"seconds from the first sample at {text}")
