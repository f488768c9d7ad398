"""Files of a general diagnosis: measured records, and the program that a user's model is."""

from __future__ import annotations

import os
import runpy
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.formats import open_stored
from classic_ml.io.table import StoredTable, Vector, along, fault_of, grouped
from classic_ml.series import uniform_period_s
from comparisons.missing_effect.systems.experiments import FEWEST_ROWS, Experiment
from comparisons.missing_effect.systems.model import Model
from surge_core.errors import InputError, require
from surge_core.types import FloatArray

TIMES = ("time_s", "t")
# How far a clock may be off a uniform one, in sample periods.
LARGEST_JITTER = 1e-3
# A period is as round as the jitter of its clock leaves open; a float's own noise at least.
LEAST_JITTER, MOST_DIGITS = 1e-6, 12
LONGEST_CAUSE = 200
UNEVEN = "interpolate the inputs onto an even clock; an output may be empty where it was not read"

Names: TypeAlias = tuple[str, ...] | None
Columns: TypeAlias = dict[str, FloatArray]


def read_experiment(
    path: str | os.PathLike[str],
    model: Model | None = None,
    *,
    settle: int = 0,
    name: str | None = None,
) -> Experiment:
    """Read one measured run of a system; a record is data and is never executed.

    Parameters
    ----------
    path : str or path
        ``.csv`` with a header, ``.mat``, ``.npz``, or ``.nc``. A column
        ``time_s`` or ``t`` is the clock, in seconds; the others are called as in the model, in its
        units. In files of arrays a vector may lie either way; scalars and other shapes are left
        alone.
    model : Model, optional
        Whose inputs and outputs must be there, and which alone are read then.
    settle : int
        Rows at the start of a check record that are not scored; 0 takes what the model needs.
    name : str, optional
        Of the run; the file's without it.

    Returns
    -------
    Experiment

    Raises
    ------
    InputError
        Naming the file, the column and the row at fault.
    """
    file = Path(path)
    expected = "a record ending in .csv, .mat, .npz or .nc"
    _require_file(file, expected)
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(str(file), expected=expected, found=f"the suffix '{file.suffix}'")
    wanted = None if model is None else (*model.input_names, *model.output_names)
    columns = reader(file, wanted)
    clocks = [name for name in TIMES if name in columns]
    found = "both" if clocks else f"columns {', '.join(columns) or 'of other names'}"
    expected = "one column of time in seconds, 'time_s' or 't'"
    require(len(clocks) == 1, str(file), expected, found)
    time_s = columns.pop(clocks[0])
    n = time_s.size
    require(n >= FEWEST_ROWS, f"{file}: rows", f"at least {FEWEST_ROWS}", f"{n}")
    period_s = _period(f"{file}: {clocks[0]}", time_s)
    run = Experiment(
        name or file.stem, period_s, columns, float(time_s[0]), settle=settle, origin=str(file)
    )
    return run if model is None else run.of(model)


def load_model(path: str | os.PathLike[str]) -> Model:
    """Return the model of a Python file, its variable ``model`` or the only `Model` in it.

    A model file is a program: it is executed with all rights of the calling user. Only files
    that one would run as ``python model.py`` may be given. Records, in contrast, are only read.

    Parameters
    ----------
    path : str or path
        A Python file.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        When the file is missing, fails (with the line), or holds no model or several.
    """
    file = Path(path)
    _require_file(file, "a Python file with a model")
    try:
        with _folder_on_path(file.parent):
            space = runpy.run_path(str(file), run_name="sindy_surge_model")
    except InputError as error:
        at = f"{file}, line {_line_of(error, file)}: {error.where}"
        raise InputError(
            at, expected=error.expected, found=error.found, remedy=error.remedy
        ) from error
    except (Exception, SystemExit) as error:
        # A program of the user's raises whatever it likes.
        line, said = _line_of(error, file), _cause(error)
        if isinstance(error, SyntaxError):
            line, said = error.lineno or 1, error.msg
        found = f"{type(error).__name__}: {said}"
        raise InputError(
            f"{file}, line {line}", expected="Python that runs", found=found
        ) from error
    models = {id(value): name for name, value in space.items() if isinstance(value, Model)}
    name = "model" if isinstance(space.get("model"), Model) else next(iter(models.values()), "")
    found = f"several models: {', '.join(models.values())}" if models else "no Model in it"
    good = name == "model" or len(models) == 1
    expected, remedy = "a variable 'model' that is a Model", "write model = Model(...)"
    require(good, str(file), expected, found, remedy)
    return space[name]  # type: ignore[no-any-return]


def _require_file(file: Path, expected: str) -> None:
    """Refuse a folder, a file that is not there, and an empty one."""
    found = "a folder" if file.is_dir() else "" if file.is_file() else "no such file"
    if not found and file.stat().st_size == 0:
        found = "an empty file"
    require(not found, str(file), expected, found)


@contextmanager
def _folder_on_path(folder: Path) -> Iterator[None]:
    """Let a model import what lies beside it, as a program does that is run by name."""
    entry = str(folder.resolve())
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        if entry in sys.path:
            sys.path.remove(entry)


def _line_of(error: BaseException, file: Path) -> int:
    """Return the last line of a file that an error came through."""
    lines = [
        frame.lineno or 1
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename == str(file)
    ]
    return lines[-1] if lines else 1


def _cause(error: BaseException) -> str:
    """Return what an exception says, on one line."""
    return (" ".join(str(error).split()) or type(error).__name__)[:LONGEST_CAUSE]


@contextmanager
def _parsed(file: Path, what: str) -> Iterator[None]:
    """Say any failure of a reader in one sentence: they raise whatever they stumble over."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise InputError(str(file), expected=what, found="bytes that are no text") from error
    except Exception as error:
        raise fault_of(error, str(file), what) from None


def _read_csv(file: Path, wanted: Names) -> Columns:
    import pandas as pd

    how: Any = {"header": None, "encoding": "utf-8-sig", "skipinitialspace": True}
    with _parsed(file, "a table as UTF-8 text"):
        names = [str(name).strip() for name in pd.read_csv(file, nrows=1, **how).iloc[0]]
    require(
        len(names) == len(set(names)) > 1,
        f"{file}: header",
        "names of columns separated by commas, each once",
        ", ".join(names)[:60],
        "write it with commas between columns and points in numbers",
    )
    expected = f"a table of {len(names)} columns separated by commas"
    with _parsed(file, expected), warnings.catch_warnings():
        # A row that is longer than the header is a warning there, and would be cut.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        table = pd.read_csv(file, names=names, skiprows=1, index_col=False, low_memory=False, **how)
    out = {}
    for name in names if wanted is None else (n for n in names if n in (*TIMES, *wanted)):
        numbers = pd.to_numeric(table[name], errors="coerce")
        words = np.flatnonzero(numbers.isna() & table[name].notna())
        for row in words[:1]:
            found = f"'{str(table[name][row])[:40]}' in row {row + 1}"
            require(False, f"{file}: {name}", "numbers", found)
        out[name] = numbers.to_numpy(dtype=np.float64)
    return out


@contextmanager
def _open_npz(file: Path) -> Iterator[StoredTable]:
    """Open an archive of arrays; objects would be executed as they are loaded, and are refused."""
    vectors, aside = [], {}
    with (
        _parsed(file, "an .npz file of plain arrays, each with its name"),
        file.open("rb") as binary,
        np.load(binary, allow_pickle=False) as opened,
    ):
        for name in opened.files:
            try:
                values = opened[name]
            except ValueError:
                aside[name] = f"objects; save them as numbers, with {name}.astype(float)"
                continue
            whole = along(values) if values.dtype.kind in "iufb" else None
            vectors += [] if whole is None else [Vector((name,), whole)]
    yield grouped(str(file), vectors, FileLayout(), aside)


def _read_stored(file: Path, wanted: Names) -> Columns:
    """Read a file of one of the formats that raw records have, or an archive of arrays."""
    with _open_npz(file) if file.suffix.lower() == ".npz" else open_stored(file) as table:
        for name in wanted or ():
            found, expected = table.left_aside.get(name), "a vector of numbers, as many as of time"
            require(found is None, f"{file}: {name}", expected, str(found))
        kept = tuple(n for n in table.names if wanted is None or n in (*TIMES, *wanted))
        blocks = list(table.blocks(kept))
    columns = zip(kept, map(np.concatenate, zip(*blocks, strict=True)), strict=True)
    return {name: values.astype(np.float64) for name, values in columns}


_READERS = {
    ".csv": _read_csv,
    **dict.fromkeys((".mat", ".nc", ".nc4", ".netcdf", ".npz"), _read_stored),
}


def _period(where: str, time_s: FloatArray) -> float:
    """Return the sample period of a uniform clock; refuse another with its row."""
    for row in np.flatnonzero(~np.isfinite(time_s))[:1]:
        require(False, where, "finite times", f"{time_s[row]} in row {row + 1}")
    n, period_s = time_s.size, uniform_period_s(time_s, where, UNEVEN)
    off = np.abs(time_s - (time_s[0] + period_s * np.arange(n))) / period_s
    row = int(np.argmax(off))
    require(
        off[row] <= LARGEST_JITTER,
        where,
        f"a uniform clock within {LARGEST_JITTER:g} of its period, {period_s:.6g} s",
        f"row {row + 1} off by {off[row]:.3g} periods",
        UNEVEN,
    )
    return _rounded(period_s, n, float(off[row]))


def _rounded(period_s: float, n: int, jitter: float) -> float:
    """Return the roundest period that a clock allows: records of one sampler share it then.

    A clock that was written with few decimals would give each record a period of its own.
    """
    allowed = max(jitter, LEAST_JITTER) * period_s / (n - 1)
    for digits in range(1, MOST_DIGITS):
        rounded = float(f"{period_s:.{digits}g}")
        if abs(rounded - period_s) <= allowed:
            return rounded
    return period_s
