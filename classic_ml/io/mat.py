"""Raw records as MAT files, versions 4 to 7.3: vectors, matrices with names, structs."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.hdf5 import MOST_TEXTS, hdf5_table
from classic_ml.io.table import RawFile
from classic_ml.io.vectors import Leaf, as_table, found_in
from surge_core.errors import InputError

__all__ = ["open_mat"]

_OBJECT = "an object, which only MATLAB can read; save it as a struct"


def open_mat(file: Path, layout: FileLayout, lenient: bool = False) -> RawFile:
    """Open a MAT file.

    Version 7.3 is read slice by slice. Versions up to 7.2 are compressed as a whole and come into
    memory at once, so that a larger record is saved as 7.3.

    Parameters
    ----------
    file : path
        An existing file: vectors, a matrix beside a cell array of as many names, or structs of
        them. Objects (``table``, ``timeseries``) are MATLAB's own and are not read.
    layout : FileLayout
        The struct to take.
    lenient : bool
        Of no effect here.

    Raises
    ------
    InputError
        When the file holds objects only, or it is open which struct is meant.
    """
    import h5py
    from scipy.io import loadmat

    if h5py.is_hdf5(file):
        return hdf5_table(file, layout, _matlab_node)
    content = loadmat(str(file), appendmat=False, simplify_cells=True)
    found = found_in({name: _node(v) for name, v in content.items() if not name.startswith("__")})
    objects = [path[-1] for path, what in found.aside.items() if what == _OBJECT]
    if objects and not found.vectors:
        raise InputError(
            str(file),
            expected="vectors, matrices or structs",
            found=f"'{objects[0]}' of a class of MATLAB's own (table, timeseries)",
            remedy="save it as a struct: table2struct(T, 'ToScalar', true), or ts.Time and ts.Data",
        )
    return as_table(str(file), found, layout, nullcontext)


def _node(value: Any) -> Any:
    """Return what scipy has made of a variable or field."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if isinstance(value, MatlabOpaque | MatlabFunction):
        return _OBJECT
    if isinstance(value, Mapping):
        return {str(name): _node(inner) for name, inner in value.items()}
    array = np.asarray(value, dtype=object if isinstance(value, list) else None)
    if array.dtype.kind in "iufb":
        return Leaf(array.shape, lambda _, index: array[index])
    texts = [str(text).strip() for text in array.ravel() if isinstance(text, str)]
    return texts if texts and len(texts) == array.size and array.ndim else _what(value)


def _what(value: Any) -> str:
    return value if isinstance(value, str) else "neither numbers nor texts"


def _matlab_node(item: Any) -> Any:
    """Return what MATLAB 7.3 has written into HDF5: texts as numbers, cells as references."""
    import h5py

    kind = item.attrs.get("MATLAB_class", b"")
    if item.name in ("/#refs#", "/#subsystem#") or "MATLAB_object_decode" in item.attrs:
        return _OBJECT
    if "MATLAB_empty" in item.attrs:
        return "nothing in it"
    if isinstance(item, h5py.Group):
        return None
    if kind == b"char":
        return _text(item)
    if h5py.check_ref_dtype(item.dtype) is None:
        return None
    cells = [item.file[ref] for ref in np.ravel(item[()])] if item.size <= MOST_TEXTS else []
    texts = all(cell.attrs.get("MATLAB_class") == b"char" for cell in cells)
    return [_text(cell) for cell in cells] if cells and texts else "a cell array"


def _text(item: Any) -> str:
    # MATLAB writes columns first, so that a row of letters is a column here, in UTF-16.
    codes = np.ravel(item[()]) if item.size <= MOST_TEXTS else np.zeros(0)
    return codes.astype("<u2").tobytes().decode("utf-16-le", "replace")
