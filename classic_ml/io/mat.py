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
    for name, value in content.items():
        place = (*path, str(name))
        if isinstance(value, Mapping):
            yield from _vectors(value, place, left_aside)
            continue
        is_vector = isinstance(value, np.ndarray) and value.dtype.kind in "iufb"
        values = along(value) if is_vector else None
        if values is not None:
            yield Vector(place, values)
        else:
            left_aside["/".join(place)] = (
                "no vector of numbers; a table or a timeseries of MATLAB is saved as a struct, "
                "table2struct(T, 'ToScalar', true)"
            )
