"""The files of a record: tables of numbers as CSV, descriptions as TOML."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["write_tables"]


def write_tables(
    folder: Path,
    columns: Mapping[str, Mapping[str, FloatArray]],
    tables: Mapping[str, Mapping[str, Any]],
    rate_hz: float,
) -> None:
    """Write columns over time and tables, by their place in a folder that is new or empty.

    Raises
    ------
    InputError
        When the folder holds something already, is a file, or cannot be written.
    """
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise InputError(
            str(folder),
            expected="a new or empty folder",
            found="a file" if folder.is_file() else "a folder with files",
            remedy="choose another folder or remove it first",
        )
    try:
        for place in (*columns, *tables):
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
        for place, values in columns.items():
            _write_csv(values, rate_hz, folder / place)
        for place, table in tables.items():
            text = "\n".join(_lines(table)).lstrip() + "\n"
            (folder / place).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            str(folder), expected="a folder that can be written", found=error.strerror or str(error)
        ) from error


def _write_csv(columns: Mapping[str, FloatArray], rate_hz: float, path: Path) -> None:
    """Write columns over time: whole numbers as such, everything else to 9 digits."""
    values = list(columns.values())
    table = np.column_stack([np.arange(values[0].size) / rate_hz, *values])
    formats = ["%.4f", *("%d" if np.all(v == np.rint(v)) else "%.9g" for v in values)]
    head = ",".join(["time_s", *columns])
    np.savetxt(path, table, fmt=formats, delimiter=",", header=head, comments="")


def _lines(table: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Give the lines of a table, its plain entries before the tables within it."""
    plain = {name: value for name, value in table.items() if not isinstance(value, Mapping)}
    if path and plain:
        yield f"\n[{path}]"
    for name, value in plain.items():
        yield f"{name} = {json.dumps(value.tolist() if isinstance(value, np.ndarray) else value)}"
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _lines(value, f"{path}.{name}" if path else name)
