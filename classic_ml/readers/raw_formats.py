"""Which reader a file of raw records goes to: by its suffix, checked against its first bytes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.test_description import FileLayout
from classic_ml.readers.toml_file import no_file
from surge_core.errors import InputError

__all__ = ["open_stored"]


@dataclass(frozen=True)
class _Format:
    what: str
    module: str
    reader: str
    suffixes: tuple[str, ...]
    # What the first bytes may say; "" is text, or what has no mark.
    marks: tuple[str, ...]
    # Reads more than a record may hold, for one who only looks.
    lenient_reader: str = ""


_HDF5, _MAT, _MAT73, _CLASSIC = "an HDF5 file", "a MAT file", "a MAT file (7.3)", "a netCDF-3 file"
_TEXT = "a table of text"
_TDMS, _PARQUET, _SEALED = "a TDMS file", "a Parquet file", "an encrypted Parquet file"
_FORMATS = (
    _Format("a CSV table", "raw_csv", "open_csv", (".csv",), ("",), "open_csv_leniently"),
    _Format("a MAT file", "raw_mat", "open_mat", (".mat",), (_MAT, _MAT73, _HDF5, "")),
    _Format(
        "a netCDF file", "raw_netcdf", "open_netcdf", (".nc", ".nc4", ".netcdf"), (_HDF5, _CLASSIC)
    ),
    _Format("an HDF5 file", "raw_hdf5", "open_hdf5", (".h5", ".hdf5", ".hdf"), (_HDF5, _MAT73)),
    _Format("a TDMS file", "raw_tdms", "open_tdms", (".tdms",), (_TDMS,), "open_tdms_leniently"),
    _Format(
        "a Parquet file", "raw_parquet", "open_parquet", (".parquet", ".pq"), (_PARQUET, _SEALED)
    ),
)
# A signature of HDF5 may stand behind a block of the user's, whose length is 512 times a power of
# two (HDF5 file format specification, II.A).
_HDF5_MARK = b"\x89HDF\r\n\x1a\n"
_HDF5_PLACES = (0, 512, 1024, 2048, 4096)
_MARKS = (
    (b"MATLAB 7.3", _MAT73),
    (b"MATLAB 5.0", _MAT),
    (b"CDF\x01", _CLASSIC),
    (b"CDF\x02", _CLASSIC),
    (b"CDF\x05", _CLASSIC),
    (b"TDSm", _TDMS),
    (b"TDSh", "the index of a TDMS file"),
    (b"PAR1", _PARQUET),
    (b"PARE", _SEALED),
    (b"PK\x03\x04", "a zip archive or a workbook of Excel"),
    (b"\xd0\xcf\x11\xe0", "an old workbook of Excel"),
    (b"\x1f\x8b", "a gzip archive"),
)
# What a file of each kind is to end in; a netCDF-4 or MAT 7.3 file is an HDF5 file too.
_ENDINGS = {
    _TEXT: ".csv",
    _HDF5: ".h5 (.nc, if a program for netCDF wrote it)",
    _MAT: ".mat",
    _MAT73: ".mat",
    _CLASSIC: ".nc",
    _TDMS: ".tdms",
    _PARQUET: ".parquet",
    _SEALED: ".parquet",
}
# Controls that are in no text: all but the tabulator and ends of lines.
_NOT_TEXT = frozenset(range(32)) - frozenset(b"\t\n\r\f\v")
_SUFFIXES = tuple(suffix for known in _FORMATS for suffix in known.suffixes)


def open_stored(
    raw_path: str | os.PathLike[str], layout: FileLayout | None = None, *, lenient: bool = False
) -> RawFile:
    """Open a raw record as it is: columns, names and units of the file.

    Parameters
    ----------
    raw_path : str or path
        A file whose suffix names its format.
    layout : FileLayout, optional
        Where in the file the channels are, and which of its columns is the clock.
    lenient : bool
        Take what is no number as NaN and a doubled name as another, for one who only looks.

    Returns
    -------
    RawFile
        Every column of numbers of the record's length.

    Raises
    ------
    InputError
        When there is no such file, the suffix is unknown, its content is another format's or
        spoiled, or the package that reads it is missing.
    """
    file = Path(raw_path)
    if not file.is_file():
        raise InputError(
            str(file),
            expected="a raw record",
            found=no_file(file),
        )
    known = next((f for f in _FORMATS if file.suffix.lower() in f.suffixes), None)
    if known is None:
        raise InputError(
            str(file),
            expected="a raw record ending in " + " or ".join(_SUFFIXES),
            found=f"the suffix '{file.suffix}'",
        )
    _check_mark(file, known)
    name = known.lenient_reader if lenient and known.lenient_reader else known.reader
    reader: Callable[[Path, FileLayout], RawFile] = getattr(
        import_module(f"classic_ml.readers.{known.module}"), name
    )
    return reader(file, layout if layout is not None else FileLayout())


def _check_mark(file: Path, known: _Format) -> None:
    """Refuse a file whose first bytes are those of another format than its suffix says."""
    with file.open("rb") as opened:
        head = opened.read(_HDF5_PLACES[-1] + len(_HDF5_MARK))
    mark = next((name for start, name in _MARKS if head.startswith(start)), "")
    if not mark and any(head[place:].startswith(_HDF5_MARK) for place in _HDF5_PLACES):
        mark = _HDF5
    if not head and known.marks != ("",):
        raise InputError(str(file), expected=known.what, found="an empty file")
    if not mark and "" not in known.marks[:1] and _is_text(head):
        mark = _TEXT
    if mark in known.marks:
        return
    raise InputError(
        str(file),
        expected=f"{known.what}, as the suffix '{file.suffix}' says",
        found=mark or "bytes that begin like no such file",
        remedy=f"rename it, so that it ends in {_ENDINGS[mark]}" if mark in _ENDINGS else "",
    )


def _is_text(head: bytes) -> bool:
    """Tell whether the first bytes of a file are lines of text."""
    return not _NOT_TEXT & set(head) and any(separator in head for separator in b",;\t")
