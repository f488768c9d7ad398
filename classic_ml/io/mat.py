"""Raw records as MAT files, versions 4 to 7.3: vectors, or structs of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.hdf5 import open_hdf5
from classic_ml.io.table import StoredTable, Vector, along, grouped

__all__ = ["open_mat"]


@contextmanager
def open_mat(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open a MAT file.

    Version 7.3 is read slice by slice. Versions up to 7.2 are compressed as a whole and come into
    memory at once, so that a larger record is saved as 7.3. Arguments as
    :func:`classic_ml.io.formats.open_stored` has them.
    """
    import h5py
    from scipy.io import loadmat

    if h5py.is_hdf5(file):
        with open_hdf5(file, layout) as table:
            yield table
        return
    content = loadmat(str(file), appendmat=False, simplify_cells=True)
    own = {name: value for name, value in content.items() if not name.startswith("__")}
    left_aside: dict[str, str] = {}
    yield grouped(str(file), list(_vectors(own, (), left_aside)), layout, left_aside)


def _vectors(
    content: Mapping[str, Any], path: tuple[str, ...], left_aside: dict[str, str]
) -> Iterator[Vector]:
    from scipy.io.matlab import MatlabOpaque

    for name, value in content.items():
        place = (*path, str(name))
        if isinstance(value, Mapping):
            yield from _vectors(value, place, left_aside)
            continue
        is_object = isinstance(value, MatlabOpaque)
        array = np.asarray(None if is_object else value, dtype=None if np.ndim(value) else object)
        values = along(array) if array.dtype.kind in "iufb" else None
        if values is not None:
            yield Vector(place, values)
        else:
            left_aside["/".join(place)] = (
                "an object of MATLAB's own (table, timeseries): save it as a struct, "
                "table2struct(T, 'ToScalar', true)"
                if is_object
                else "no vector of numbers"
            )
