"""Raw records as HDF5: datasets of one length in one group."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from classic_ml.description import FileLayout
from classic_ml.io.table import StoredTable, Vector, along, grouped, stated_unit


@contextmanager
def open_hdf5(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open an HDF5 file, or a MAT file of version 7.3; links are not followed.

    A dataset that is a vector is a column, and so is a field of a table of compound rows; the
    attribute ``units`` states a unit. Arguments as :func:`classic_ml.io.formats.open_stored` has
    them.
    """
    import h5py

    vectors, left_aside = list[Vector](), dict[str, str]()

    def visit(name: str, item: Any) -> None:
        path = tuple(name.split("/"))
        # MATLAB keeps its objects and cells under names that begin with #.
        if not isinstance(item, h5py.Dataset) or any(part.startswith("#") for part in path):
            return
        if item.dtype.names is not None:
            numeric = (field for field in item.dtype.names if item.dtype[field].kind in "iufb")
            vectors.extend(Vector((*path, field), item.fields(field)) for field in numeric)
            return
        # MATLAB writes the letters of a text as numbers.
        text = item.attrs.get("MATLAB_class") == b"char"
        values = along(item) if item.shape and item.dtype.kind in "iufb" and not text else None
        if values is None:
            left_aside[name] = "no vector of numbers"
        else:
            vectors.append(Vector(path, values, stated_unit(item.attrs)))

    with h5py.File(file, "r") as handle:
        handle.visititems(visit)
        yield grouped(str(file), vectors, layout, left_aside)
