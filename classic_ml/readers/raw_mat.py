"""Raw records as MAT files, versions 4 to 7.3: vectors, matrices with names, structs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.readers.hdf5_claims import attributes_of
from classic_ml.readers.mat_elements import check_mat_elements
from classic_ml.readers.raw_columns import as_columns, one_line
from classic_ml.readers.raw_hdf5 import Walk, hdf5_columns
from classic_ml.readers.raw_table import RawFile, cannot_be_read
from classic_ml.readers.raw_tree import Node, Tree, Unreadable, array_leaf, vectors
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError

__all__ = ["open_mat"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
# A MAT file of version 7.3 is HDF5 behind a text of 512 bytes.
_USER_BLOCK = 512
_MOST_TEXTS = 4096
_AS_STRUCT = "an object, which only MATLAB can read; save it as a struct"


def open_mat(file: Path, layout: FileLayout) -> RawFile:
    """Open a MAT file; nothing in it is executed.

    Version 7.3 is read slice by slice. Versions up to 7.2 are compressed as a whole and come into
    memory at once, so that a larger record is saved as 7.3.

    Parameters
    ----------
    file : path
        An existing file: vectors; a matrix beside a cell array of as many names; a struct of
        vectors; structs of ``Time`` and ``Data``; Simulink's structure with time. Objects
        (``table``, ``timeseries``) are MATLAB's own and are not read.
    layout : FileLayout
        The struct to take.

    Returns
    -------
    RawFile
        The columns of one length.

    Raises
    ------
    InputError
        When the file is spoiled, holds objects only, or it is open which struct is meant.
    """
    with file.open("rb") as opened:
        head = opened.read(_USER_BLOCK + len(_HDF5))
    if head.startswith(_HDF5) or head[_USER_BLOCK:] == _HDF5:
        return hdf5_columns(file, layout, "a MAT file of version 7.3", _matlab_node)
    tree = _loaded(file)
    found, aside = vectors(tree)
    if not found:
        objects = [path[-1] for path, what in aside.items() if what == _AS_STRUCT]
        if objects:
            raise InputError(
                str(file),
                expected="vectors, matrices or structs",
                found=f"'{objects[0]}' of a class of MATLAB's own (table, timeseries)",
                remedy="save it as a struct: table2struct(T, 'ToScalar', true), or ts.Time and "
                "ts.Data",
            )
    return as_columns(str(file), found, layout, lambda: nullcontext(None), aside)


def _loaded(file: Path) -> Tree:
    """Read a file of versions 4 to 7.2."""
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    try:
        if matfile_version(str(file), appendmat=False)[0] == 1:
            check_mat_elements(file)
        content = loadmat(str(file), appendmat=False, simplify_cells=True)
    except Exception as error:
        # scipy's reader raises whatever it stumbles over in a spoiled file.
        raise cannot_be_read(file, "a MAT file", one_line(error)) from None
    return {name: _node(value) for name, value in content.items() if not name.startswith("__")}


def _node(value: Any) -> Node:
    """Return what scipy has made of a variable or field."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if isinstance(value, MatlabOpaque | MatlabFunction):
        return Unreadable(_AS_STRUCT)
    if isinstance(value, Mapping):
        return {str(name): _node(inner) for name, inner in value.items()}
    if isinstance(value, str):
        return value
    array = np.asarray(value, dtype=object) if isinstance(value, list) else np.asarray(value)
    if array.dtype.kind == "O":
        return _list(list(value) if isinstance(value, list) else list(array.ravel()))
    if array.dtype.kind in "US":
        return [str(text).strip() for text in array.ravel()]
    return array_leaf(array)


def _list(items: list[Any]) -> Node:
    """Return a cell array, or an array of structs."""
    if items and all(isinstance(item, str) for item in items):
        return items
    if items and all(isinstance(item, Mapping) for item in items):
        return [{str(name): _node(inner) for name, inner in item.items()} for item in items]
    return Unreadable("a cell array")


def _matlab_node(item: Any, walk: Walk) -> Node | None:
    """Return what MATLAB has written into HDF5: texts as numbers, cells as references."""
    import h5py

    if item.name in ("/#refs#", "/#subsystem#"):
        return Unreadable("MATLAB's own")
    if "MATLAB_object_decode" in item.attrs:
        return Unreadable(_AS_STRUCT)
    if isinstance(item, h5py.Group):
        return _struct_array(item, walk)
    return _matlab_dataset(item, walk)


def _matlab_dataset(item: Any, walk: Walk) -> Node | None:
    import h5py

    if "MATLAB_empty" in item.attrs:
        return Unreadable("nothing in it")
    if _class_of(item) == "char":
        return _text(item)
    if h5py.check_ref_dtype(item.dtype) is not None:
        return _cells(item, walk)
    return None


def _class_of(item: Any) -> str:
    kind = attributes_of(item, ("MATLAB_class",)).get("MATLAB_class", b"")
    return kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)


def _text(item: Any) -> str | Unreadable:
    if item.dtype.kind not in "iu":
        return Unreadable("a text whose letters are no codes")
    codes = np.asarray(item[()]) if item.size <= _MOST_TEXTS else np.zeros(0, dtype=np.uint16)
    if codes.size and not 0 <= codes.min() <= codes.max() <= sys.maxunicode:
        return Unreadable("a text whose letters are no codes")
    # MATLAB writes columns first, so that a row of letters is a column here, and in UTF-16, where
    # some letters take two codes.
    text = "".join(chr(int(code)) for code in codes.ravel())
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _cells(item: Any, walk: Walk) -> Node:
    if item.size > _MOST_TEXTS:
        return Unreadable("a cell array")
    walk.count(item.size)
    inner = [item.file[reference] for reference in np.ravel(item[()]) if reference]
    if all(_class_of(part) == "char" for part in inner):
        texts = [text for text in map(_text, inner) if isinstance(text, str)]
        if texts and len(texts) == len(inner):
            return texts
    return Unreadable("a cell array")


def _struct_array(group: Any, walk: Walk) -> Node | None:
    """Return an array of structs, which is written as one array of references for each field."""
    fields: dict[str, Any] = {}
    for name in group:
        field = _reference_array(group, name)
        if field is None:
            return None
        fields[name] = field
    sizes = {field.size for field in fields.values()}
    if len(sizes) != 1:
        return None
    n = sizes.pop()
    if n > _MOST_TEXTS:
        return Unreadable("an array of structs")
    references = {name: np.ravel(field[()]) for name, field in fields.items()}
    return [
        {name: walk.referred(group.file, some[number]) for name, some in references.items()}
        for number in range(n)
    ]


def _reference_array(group: Any, name: str | bytes) -> Any | None:
    """Return a member of a group if it may be a field of an array of structs."""
    import h5py

    own = isinstance(name, str) and isinstance(group.get(name, getlink=True), h5py.HardLink)
    try:
        field = group[name] if own else None
    except (KeyError, OSError, RuntimeError):
        # The walk through the group says so.
        return None
    if not isinstance(field, h5py.Dataset) or field.shape is None:
        return None
    is_reference = h5py.check_ref_dtype(field.dtype) is not None
    return field if is_reference and "MATLAB_class" not in field.attrs else None
