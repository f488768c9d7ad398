"""Raw records as HDF5: datasets of one length in one group, or a table of compound rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.errors import InputError
from classic_ml.readers.raw_columns import as_columns, one_line
from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.raw_tree import Leaf, Node, Tree, Unreadable, vectors
from classic_ml.readers.test_description import FileLayout

__all__ = [
    "attribute_texts",
    "hdf5_columns",
    "hdf5_node",
    "hdf5_tree",
    "open_hdf5",
    "opened_hdf5",
    "unit_of",
]

_UNIT_ATTRIBUTES = ("units", "unit", "unit_string", "engineering_units", "engineeringunits")
_COLUMN_ATTRIBUTES = ("columns", "column_names", "channel_names", "channels", "names")
# More texts than this are no names of columns.
_MOST_TEXTS = 4096
# Deflate reaches 1032 to 1.
_MOST_COMPRESSED = 100_000

# Takes a dataset and says what it is, or None where it is what it looks like.
Decoder = Callable[[Any], "Node | None"]


def open_hdf5(file: Path, layout: FileLayout) -> RawFile:
    """Open an HDF5 file; its rows are read slice by slice, links to other files are not followed.

    Parameters
    ----------
    file : path
        An existing file. A dataset is a column, and so is a field of a compound dataset; a matrix
        is a table where an attribute ``columns`` or a dataset of as many texts beside it names
        its columns. The attribute ``units`` states a unit.
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
    return hdf5_columns(file, layout, "an HDF5 file")


def hdf5_columns(
    file: Path, layout: FileLayout, what: str, decoder: Decoder = lambda _: None
) -> RawFile:
    """Open an HDF5 file whose datasets may mean more than HDF5 says.

    Parameters
    ----------
    file : path
        The file.
    layout : FileLayout
        The group to take.
    what : str
        What the file is called in an error.
    decoder : callable
        Takes a dataset or group; returns what it is, or None where it is what it looks like.
    """
    with opened_hdf5(file, what) as handle:
        try:
            found, aside = vectors(hdf5_tree(handle, decoder))
        except (OSError, RuntimeError, KeyError, ValueError) as error:
            raise InputError(str(file), expected=what, found=one_line(error)) from None
    return as_columns(str(file), found, layout, lambda: opened_hdf5(file, what), aside)


@contextmanager
def opened_hdf5(file: Path, what: str) -> Iterator[Any]:
    """Open an HDF5 file for reading, or refuse it in one sentence."""
    import h5py

    try:
        handle = h5py.File(file, "r")
    except OSError as error:
        raise InputError(
            str(file), expected=what, found=f"what cannot be read ({one_line(error)})"
        ) from None
    with handle:
        yield handle


def hdf5_tree(group: Any, decoder: Decoder, above: tuple[Any, ...] = ()) -> Tree:
    """Return a group of an open HDF5 file as a tree, without reading the numbers."""
    import h5py

    tree: Tree = {}
    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
            tree[name] = Unreadable("a link to another file")
            continue
        try:
            item = group[name]
        except KeyError:
            tree[name] = Unreadable("a link that leads nowhere")
            continue
        # A group may hold itself.
        address = h5py.h5o.get_info(item.id).addr
        if address not in above:
            tree[name] = hdf5_node(item, decoder, (*above, address))
    return tree


def hdf5_node(item: Any, decoder: Decoder, above: tuple[Any, ...] = ()) -> Node:
    """Return one item of an open HDF5 file."""
    import h5py

    if _is_unwritten(item):
        return Unreadable("rows that were never written")
    decoded = decoder(item)
    if decoded is not None:
        return decoded
    if isinstance(item, h5py.Group):
        return hdf5_tree(item, decoder, above)
    if not isinstance(item, h5py.Dataset) or item.shape is None:
        return Unreadable("nothing in it")
    return _dataset(item)


def _is_unwritten(item: Any) -> bool:
    """Tell whether a dataset claims far more rows than anybody wrote: they would all be read."""
    import h5py

    if not isinstance(item, h5py.Dataset) or not item.size:
        return False
    return bool(item.nbytes > _MOST_COMPRESSED * item.id.get_storage_size())


def _dataset(item: Any) -> Node:
    import h5py

    path = item.name
    if item.dtype.names is not None:
        return {field: _field(item, field) for field in item.dtype.names}
    if h5py.check_string_dtype(item.dtype) is not None:
        return _texts(item)
    if item.dtype.kind not in "iufb" or h5py.check_ref_dtype(item.dtype) is not None:
        return Unreadable("no real numbers")
    return Leaf(
        item.shape,
        lambda handle, index: np.asarray(handle[path][index]),
        unit_of(item.attrs),
        attribute_texts(item.attrs, _COLUMN_ATTRIBUTES),
    )


def _field(table: Any, field: str) -> Leaf | Unreadable:
    """Return one field of a compound dataset."""
    path, dtype = table.name, table.dtype[field]
    if dtype.kind not in "iufb" or dtype.shape:
        return Unreadable("no real number in each row")
    return Leaf(table.shape, lambda handle, index: np.asarray(handle[path].fields(field)[index]))


def _texts(item: Any) -> str | list[str] | Unreadable:
    if item.size > _MOST_TEXTS:
        return Unreadable("texts")
    values = np.atleast_1d(item.asstr(errors="replace")[()]).ravel()
    return [str(value) for value in values] if item.shape else str(values[0])


def unit_of(attributes: Mapping[str, Any]) -> str:
    """Return the unit among the attributes of a dataset; empty without."""
    return next(iter(attribute_texts(attributes, _UNIT_ATTRIBUTES)), "")


def attribute_texts(attributes: Mapping[str, Any], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the texts of the first attribute of one of some names, in any case of letters."""
    by_name = {str(key).lower(): key for key in attributes}
    for name in names:
        if name in by_name:
            values = np.atleast_1d(np.asarray(attributes[by_name[name]], dtype=object)).ravel()
            return tuple(
                value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
                for value in values
            )
    return ()
