"""The folder of a simulated test: tables of numbers as CSV, descriptions as TOML."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray


def write_record_folder(
    folder: Path,
    columns: Mapping[str, Mapping[str, tuple[FloatArray, str]]],
    tables: Mapping[str, Mapping[str, Any]],
) -> None:
    """Write columns and tables, by their place in a folder that is new or empty.

    The columns of each CSV file have a format each, but whole numbers are written as such; of a
    table in TOML what is None is left out.
    """
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise InputError(
            str(folder),
            expected="a new or empty folder",
            found="a file" if folder.is_file() else "a folder with files",
            remedy="choose another folder or remove it first",
        )
    for place in (*columns, *tables):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
    for place, values in columns.items():
        formats = ["%d" if np.all(v == np.rint(v)) else how for v, how in values.values()]
        table = np.column_stack([v for v, _ in values.values()])
        head = ",".join(values)
        np.savetxt(folder / place, table, fmt=formats, delimiter=",", header=head, comments="")
    for place, content in tables.items():
        (folder / place).write_text(toml_text(content), encoding="utf-8")


def toml_text(table: Mapping[str, Any]) -> str:
    """Return a table of numbers, texts, lists and tables as TOML; what is None is left out."""
    return "\n".join(_lines(table)).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Give the lines of a table, its plain entries before the tables within it."""
    # They look in TOML as in JSON.
    plain = [
        f"{name} = {json.dumps(value, ensure_ascii=False, default=np.ndarray.tolist)}"
        for name, value in table.items()
        if value is not None and not isinstance(value, Mapping)
    ]
    if path and plain:
        yield f"\n[{path}]"
    yield from plain
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _lines(value, f"{path}.{name}" if path else name)
