"""Raw records as HDF5: datasets of one length in one group, or a table of compound rows."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.table import RawFile
from classic_ml.io.vectors import Leaf, as_table, found_in

__all__ = ["MOST_TEXTS", "check_items", "hdf5_table", "open_hdf5"]

UNIT_ATTRIBUTES = ("units", "unit", "unit_string", "engineering_units", "engineeringunits")
_COLUMN_ATTRIBUTES = ("columns", "column_names", "channel_names", "channels", "names")
# More names than a table has columns: they are data.
MOST_TEXTS = 4096

# Takes a dataset or group and says what it is, or None where it is what it looks like.
Decoder = Callable[[Any], Any]


def open_hdf5(file: Path, layout: FileLayout, lenient: bool = False) -> RawFile:
    """Open an HDF5 file; its rows are read slice by slice, links are not followed.

    Parameters
    ----------
    file : path
        An existing file. A dataset is a column, and so is a field of a compound dataset; a matrix
        is a table where an attribute ``columns`` or a dataset of as many texts beside it names
        its columns. The attribute ``units`` states a unit.
    layout : FileLayout
        The group to take.
    lenient : bool
        Of no effect here.

    Raises
    ------
    InputError
        When it is open which group is meant.
    """
    return hdf5_table(file, layout, lambda _: None)


def hdf5_table(file: Path, layout: FileLayout, decoder: Decoder) -> RawFile:
    """Open an HDF5 file whose datasets may mean more than HDF5 says.

    Parameters
    ----------
    file : path
        The file.
    layout : FileLayout
        The group to take.
    decoder : callable
        Takes a dataset or group and returns what it is, or None where it is what it looks like.
    """
    import h5py

    opened = partial(h5py.File, file, "r")
    with opened() as handle:
        found = found_in(_tree(handle, decoder))
    return as_table(str(file), found, layout, opened)


def check_items(file: Path) -> None:
    """Look at each item of an HDF5 file, so that a damaged one is refused here.

    h5netcdf leaves a file half open over it, and complains of that on its own later.
    """
    import h5py

    with h5py.File(file, "r") as handle:
        handle.visititems(lambda _, item: len(dict(item.attrs)) and None)


def _tree(group: Any, decoder: Decoder) -> dict[str, Any]:
    import h5py

    tree: dict[str, Any] = {}
    for name in group:
        # Links lead to other files, or back into the same group.
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            tree[name] = _node(group[name], decoder)
    return tree


def _node(item: Any, decoder: Decoder) -> Any:
    import h5py

    decoded = decoder(item)
    if decoded is not None or isinstance(item, h5py.Group):
        return _tree(item, decoder) if decoded is None else decoded
    if not isinstance(item, h5py.Dataset) or not item.shape:
        return "a single value"
    path = item.name
    if item.dtype.names is not None:
        return {
            field: Leaf(item.shape, partial(_field, path, field))
            for field in item.dtype.names
            if item.dtype[field].kind in "iufb" and not item.dtype[field].shape
        }
    if h5py.check_string_dtype(item.dtype) is not None and item.size <= MOST_TEXTS:
        return list(item.asstr()[()].ravel())
    if item.dtype.kind not in "iufb":
        return "no real numbers"
    unit = "".join(_attribute(item, UNIT_ATTRIBUTES)[:1])
    columns = _attribute(item, _COLUMN_ATTRIBUTES)
    return Leaf(item.shape, lambda handle, index: handle[path][index], unit, columns)


def _field(path: str, field: str, handle: Any, index: Any) -> Any:
    return handle[path].fields(field)[index]


def _attribute(item: Any, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the texts of the first attribute of one of some names, in any case of letters."""
    found = {str(key).lower(): key for key in item.attrs}
    key = next((found[name] for name in names if name in found), None)
    values = () if key is None else np.ravel(np.asarray(item.attrs[key], dtype=object))
    return tuple(v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in values)
