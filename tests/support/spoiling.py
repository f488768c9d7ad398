"""Ways to spoil the files of a folder: each returns a function of the folder."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mistake import Spoil
from raw_data import to_toml

Values = np.ndarray


def written(file: str, content: bytes | str) -> Spoil:
    """Put another content in place of a file's."""
    data = content.encode() if isinstance(content, str) else content

    def spoil(folder: Path) -> None:
        (folder / file).write_bytes(data)

    return spoil


def as_bytes(change: Callable[[bytes], bytes], file: str = "raw.csv") -> Spoil:
    """Change the bytes of a file."""

    def spoil(folder: Path) -> None:
        path = folder / file
        path.write_bytes(change(path.read_bytes()))

    return spoil


def as_text(change: Callable[[str], str], file: str = "raw.csv") -> Spoil:
    """Change the text of a file."""
    return as_bytes(lambda data: change(data.decode()).encode(), file)


def as_lines(change: Callable[[list[str]], list[str]], file: str = "raw.csv") -> Spoil:
    """Change the lines of a file; the first is the header."""
    return as_text(lambda text: "\n".join(change(text.splitlines())) + "\n", file)


def lines(change: Callable[[str], str], file: str = "raw.csv") -> Spoil:
    """Change each line below the header."""
    return as_lines(lambda rows: [rows[0], *map(change, rows[1:])], file)


def replaced(old: str, new: str, file: str) -> Spoil:
    """Replace the first place of a text that must be there."""

    def change(text: str) -> str:
        assert old in text, f"{old} is not in {file}"
        return text.replace(old, new, 1)

    return as_text(change, file)


def table(change: Callable[[pd.DataFrame], pd.DataFrame], file: str = "raw.csv") -> Spoil:
    """Change the columns of a file, all read as numbers."""

    def spoil(folder: Path) -> None:
        path = folder / file
        read = pd.read_csv(path)
        change(read).to_csv(path, index=False)

    return spoil


def channel(
    names: str | tuple[str, ...], change: Callable[[Values], Values], file: str = "raw.csv"
) -> Spoil:
    """Change one column or some, as floats."""

    def spoil(read: pd.DataFrame) -> pd.DataFrame:
        for name in (names,) if isinstance(names, str) else names:
            read[name] = change(read[name].to_numpy(dtype=np.float64).copy())
        return read

    return table(spoil, file)


def every(start: str, change: Callable[[Values], Values], file: str = "raw.csv") -> Spoil:
    """Change all columns whose name begins so."""

    def spoil(read: pd.DataFrame) -> pd.DataFrame:
        for name in read.columns:
            if name.startswith(start):
                read[name] = change(read[name].to_numpy(dtype=np.float64).copy())
        return read

    return table(spoil, file)


def at_rows(rows: slice, value: float | Callable[[Values], Values]) -> Callable[[Values], Values]:
    """Return a change of some rows of a column alone."""

    def change(values: Values) -> Values:
        values[rows] = value(values[rows]) if callable(value) else value
        return values

    return change


def cell(name: str, row: int, text: str, file: str = "raw.csv") -> Spoil:
    """Write a text into one cell; rows count from 1 below the header."""

    def change(rows: list[str]) -> list[str]:
        at = rows[0].split(",").index(name)
        cells = rows[row].split(",")
        cells[at] = text
        return [*rows[:row], ",".join(cells), *rows[row + 1 :]]

    return as_lines(change, file)


def named(names: Mapping[str, str], file: str = "raw.csv") -> Spoil:
    """Write other names into the header; the readings stay where they are."""
    return as_lines(
        lambda rows: [",".join(names.get(n, n) for n in rows[0].split(",")), *rows[1:]], file
    )


def exchanged(*pairs: tuple[str, str], file: str = "raw.csv") -> Spoil:
    """Exchange the names of columns in pairs."""
    names = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    return named(names, file)


def toml(*changes: tuple[str, Any], file: str = "test.toml") -> Spoil:
    """Set keys (``table/key``) of a TOML file, or delete one where the value is ``...``."""

    def spoil(folder: Path) -> None:
        path = folder / file
        tables = tomllib.loads(path.read_text("utf-8"))
        for where, value in changes:
            _set(tables, where.split("/"), value)
        path.write_text(to_toml(tables), "utf-8")

    return spoil


def _set(tables: dict[str, Any], keys: list[str], value: Any) -> None:
    for key in keys[:-1]:
        tables = tables.setdefault(key, {})
    if value is ...:
        del tables[keys[-1]]
    elif callable(value):
        tables[keys[-1]] = value(tables[keys[-1]])
    else:
        tables[keys[-1]] = value
