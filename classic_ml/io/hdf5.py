"""Raw records as HDF5: datasets of one length in one group."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.table import StoredTable, Vector, along, grouped

__all__ = ["open_hdf5"]

_UNIT_ATTRIBUTES = ("units", "unit", "unit_string", "engineering_units")


@contextmanager
def open_hdf5(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open an HDF5 file, or a MAT file of version 7.3; links are not followed.

    A dataset that is a vector is a column, and so is a field of a table of compound rows; the
    attribute ``units`` states a unit. Arguments as :func:`classic_ml.io.formats.open_stored` has
    them.
    """
    import h5py

    left_aside: dict[str, str] = {}
    with h5py.File(file, "r") as handle:
        yield grouped(str(file), list(_vectors(handle, (), left_aside)), layout, left_aside)


def _vectors(group: Any, path: tuple[str, ...], left_aside: dict[str, str]) -> Iterator[Vector]:
    import h5py

    for name in group:
        place = (*path, name)
        # Links lead to other files, or back into the same group; MATLAB keeps its objects and
        # cells under names that begin with #.
        is_own = isinstance(group.get(name, getlink=True), h5py.HardLink) and name[0] != "#"
        item = group[name] if is_own else None
        if isinstance(item, h5py.Group):
            yield from _vectors(item, place, left_aside)
        elif isinstance(item, h5py.Dataset) and item.dtype.names is not None:
            numeric = (field for field in item.dtype.names if item.dtype[field].kind in "iufb")
            yield from (Vector((*place, field), item.fields(field)) for field in numeric)
        elif isinstance(item, h5py.Dataset):
            # MATLAB writes the letters of a text as numbers.
            text = item.attrs.get("MATLAB_class") == b"char" or "MATLAB_empty" in item.attrs
            values = along(item) if item.shape and item.dtype.kind in "iufb" and not text else None
            if values is None:
                left_aside["/".join(place)] = "no vector of numbers"
            else:
                yield Vector(place, values, _unit(item))


def _unit(item: Any) -> str:
    stated = {str(name).lower(): name for name in item.attrs}
    for name in _UNIT_ATTRIBUTES:
        if name in stated:
            value = np.ravel(np.asarray(item.attrs[stated[name]], dtype=object))[0]
            return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return ""
