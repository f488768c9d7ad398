"""Files of one run: ``raw.csv`` and ``test.toml``, and apart from them the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.records import Record
from comparisons.rig.simulation import RigRun
from surge_core.errors import InputError

__all__ = ["write_run"]


def write_run(run: RigRun, folder: str | Path) -> None:
    """Write a run: the raw record as a test would leave it, and the truth in a folder of its own.

    ``folder/raw.csv`` and ``folder/test.toml`` are all that a reduction needs; ``folder/truth``
    holds ``truth.csv`` and ``truth.toml``.

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
        (target / "truth").mkdir(parents=True)
        for place, record, name, table in (
            (target, run.raw, "raw.csv", {"test.toml": run.test}),
            (target / "truth", run.truth, "truth.csv", {"truth.toml": run.truth_parameters}),
        ):
            _write_table(record, place / name)
            for file, values in table.items():
                (place / file).write_text(_toml(values), encoding="utf-8")
    except OSError as error:
        raise InputError(
            str(target), expected="a folder that can be written", found=error.strerror or str(error)
        ) from error


def _write_table(record: Record, path: Path) -> None:
    """Write a record as CSV: whole counts as integers, kelvin to 1 mK, the rest to 9 digits."""
    columns, formats = [record.time_s], ["%.3f"]
    for channel in record.channels.values():
        columns.append(channel.values)
        if np.all(channel.values == np.round(channel.values)):
            formats.append("%d")
        else:
            formats.append("%.3f" if channel.unit == "K" else "%.9g")
    header = ",".join(["time_s", *record.channels])
    np.savetxt(
        path, np.column_stack(columns), fmt=formats, delimiter=",", header=header, comments=""
    )


def _toml(table: Mapping[str, Any]) -> str:
    return "\n".join(_toml_lines(table)).lstrip("\n") + "\n"


def _toml_lines(table: Mapping[str, Any], path: str = "") -> list[str]:
    """Return the lines of a table and of the tables within it; scalar entries come first."""
    # Numbers, texts, truth values and lists look in TOML as in JSON.
    plain = [
        f"{name} = {json.dumps(value, ensure_ascii=False)}"
        for name, value in table.items()
        if not isinstance(value, Mapping)
    ]
    lines = ["", f"[{path}]", *plain] if plain and path else plain
    for name, entry in table.items():
        if isinstance(entry, Mapping):
            lines += _toml_lines(entry, f"{path}.{name}" if path else name)
    return lines
