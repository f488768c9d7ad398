"""Files of one run: ``raw.csv`` and ``test.toml``, and apart from them the truth."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.records import Record
from comparisons.rig.simulation import RigRun
from surge_core.errors import InputError

__all__ = ["toml_text", "write_run"]


def write_run(run: RigRun, folder: str | Path) -> None:
    """Write a run: the raw record as a test would leave it, and the truth in a folder of its own.

    ``folder/raw.csv`` and ``folder/test.toml`` are all that a reduction needs; ``folder/truth``
    holds ``truth.csv`` and ``truth.toml``. The folder appears whole or not at all.

    Parameters
    ----------
    run : RigRun
        The run.
    folder : str or Path
        A folder that does not exist yet, or an empty one.

    Raises
    ------
    InputError
        When the folder holds something already, is a file, or cannot be written.
    """
    target = Path(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(
            str(target),
            expected="a new or empty folder",
            found="a folder with files" if target.is_dir() else "a file",
            remedy="choose another folder or remove it first",
        )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise _cannot_write(target, error) from error
    try:
        _fill(run, partial)
        # mkdtemp makes a private folder; a record is as public as any other file of its owner.
        partial.chmod(0o755)
        partial.replace(target)
    except OSError as error:
        raise _cannot_write(target, error) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _cannot_write(target: Path, error: OSError) -> InputError:
    return InputError(
        str(target), expected="a folder that can be written", found=error.strerror or str(error)
    )


def _fill(run: RigRun, folder: Path) -> None:
    (folder / "test.toml").write_text(toml_text(run.test), encoding="utf-8")
    _write_table(run.raw, folder / "raw.csv")
    (folder / "truth").mkdir()
    (folder / "truth" / "truth.toml").write_text(toml_text(run.truth_parameters), encoding="utf-8")
    _write_table(run.truth, folder / "truth" / "truth.csv")


def _write_table(record: Record, path: Path) -> None:
    """Write a record as CSV: whole counts as integers, kelvin to 1 mK, the rest to 9 digits."""
    columns = [record.time_s]
    formats = ["%.3f"]
    for channel in record.channels.values():
        whole = bool(np.all(channel.values == np.round(channel.values)))
        columns.append(channel.values)
        if whole:
            formats.append("%d")
        else:
            formats.append("%.3f" if channel.unit == "K" else "%.9g")
    header = ",".join(["time_s", *record.channels])
    np.savetxt(
        path, np.column_stack(columns), fmt=formats, delimiter=",", header=header, comments=""
    )


def toml_text(table: Mapping[str, Any]) -> str:
    """Return nested mappings of numbers, strings, truth values and lists as TOML.

    Parameters
    ----------
    table : mapping
        Tables by name; scalar entries of the top level come first.

    Returns
    -------
    str
        The text, which `tomllib` reads back to equal values.
    """
    lines = [f"{name} = {_value(v)}" for name, v in table.items() if not isinstance(v, Mapping)]
    for name, entry in table.items():
        if isinstance(entry, Mapping):
            lines += _section(name, entry)
    return "\n".join(lines).lstrip("\n") + "\n"


def _section(path: str, table: Mapping[str, Any]) -> list[str]:
    """Return the lines of one table and of the tables within it."""
    plain = [f"{name} = {_value(v)}" for name, v in table.items() if not isinstance(v, Mapping)]
    lines = ["", f"[{path}]", *plain] if plain else []
    for name, entry in table.items():
        if isinstance(entry, Mapping):
            lines += _section(f"{path}.{name}", entry)
    return lines


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    return "[" + ", ".join(_value(v) for v in value) + "]"
