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

from classic_ml.io.formats import open_stored
from classic_ml.series import uniform_period_s
from comparisons.missing_effect.systems.experiments import FEWEST_ROWS, Experiment
from comparisons.missing_effect.systems.model import Model
from surge_core.errors import InputError
from surge_core.types import FloatArray

TIMES = ("time_s", "t")
# How far a clock may be off a uniform one, in sample periods.
LARGEST_JITTER = 1e-3
# A period is as round as the jitter of its clock leaves open; a float's own noise at least.
LEAST_JITTER, MOST_DIGITS = 1e-6, 12
LONGEST_CAUSE = 200

Names: TypeAlias = tuple[str, ...]
Columns: TypeAlias = dict[str, FloatArray]


def read_experiment(path: str | os.PathLike[str], model: Model) -> Experiment:
    """Read one measured run of a system; a record is data and is never executed.

    Parameters
    ----------
    path : str or path
        ``.csv`` with a header, ``.mat``, ``.npz``, or ``.nc``. A column
        ``time_s`` or ``t`` is the clock, in seconds; the others are called as in the model, in its
        units. In files of arrays a vector may lie either way; other columns are left alone.
    model : Model
        Whose inputs and outputs must be there.

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
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(str(file), expected=expected, found=f"the suffix '{file.suffix}'")
    columns = reader(file, (*TIMES, *model.input_names, *model.output_names))
    clocks = [name for name in TIMES if name in columns]
    found = "both" if clocks else f"columns {', '.join(columns) or 'of other names'}"
    expected = "one column of time in seconds, 'time_s' or 't'"
    _require(len(clocks) == 1, str(file), expected, found)
    time_s = columns.pop(clocks[0])
    n = time_s.size
    _require(n >= FEWEST_ROWS, f"{file}: rows", f"at least {FEWEST_ROWS}", f"{n}")
    for key, values in columns.items():
        _require(values.size == n, f"{file}: {key}", f"{n} values", f"{values.size}")
    period_s = _period(f"{file}: {clocks[0]}", time_s)
    return Experiment(file.stem, period_s, columns, float(time_s[0]), origin=str(file)).of(model)


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
    _require(good, str(file), expected, found, remedy)
    return space[name]  # type: ignore[no-any-return]


def _require(good: bool, where: str, expected: str, found: str, remedy: str = "") -> None:
    if not good:
        raise InputError(where, expected=expected, found=found, remedy=remedy)


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
    except InputError:
        raise
    except Exception as error:
        found = f"what cannot be read ({_cause(error)})"
        if isinstance(error, UnicodeDecodeError):
            found = "bytes that are no text"
        raise InputError(str(file), expected=what, found=found) from error


def _read_csv(file: Path, wanted: Names) -> Columns:
    import pandas as pd

    how: Any = {"header": None, "encoding": "utf-8-sig", "skipinitialspace": True}
    with _parsed(file, "a table as UTF-8 text"):
        names = [str(name).strip() for name in pd.read_csv(file, nrows=1, **how).iloc[0]]
    _require(
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
    for name in (name for name in names if name in wanted):
        numbers = pd.to_numeric(table[name], errors="coerce")
        words = np.flatnonzero(numbers.isna() & table[name].notna())
        for row in words[:1]:
            found = f"'{str(table[name][row])[:40]}' in row {row + 1}"
            _require(False, f"{file}: {name}", "numbers", found)
        out[name] = numbers.to_numpy(dtype=np.float64)
    return out


def _read_npz(file: Path, wanted: Names) -> Columns:
    """Read an archive of arrays; objects would be executed as they are loaded, and are refused."""
    out = {}
    what = "an .npz file of arrays of numbers, since a file is read as data and never executed"
    with _parsed(file, what), np.load(file, allow_pickle=False) as opened:
        for name in set(opened.files).intersection(wanted):
            out[name] = opened[name].ravel().astype(np.float64)
    return out


def _read_stored(file: Path, wanted: Names) -> Columns:
    """Read a file of one of the formats that raw records have."""
    with open_stored(file) as table:
        expected = "a vector of numbers, as many as of time"
        for name in table.left_aside.keys() & wanted:
            _require(False, f"{file}: {name}", expected, str(table.left_aside[name]))
        kept = tuple(name for name in table.names if name in wanted)
        blocks = list(table.blocks(kept))
    columns = zip(kept, map(np.concatenate, zip(*blocks, strict=True)), strict=True)
    return {name: values.astype(np.float64) for name, values in columns}


_READERS = {
    ".csv": _read_csv,
    ".npz": _read_npz,
    **dict.fromkeys((".mat", ".nc", ".nc4", ".netcdf"), _read_stored),
}


def _period(where: str, time_s: FloatArray) -> float:
    """Return the sample period of a uniform clock; refuse another with its row."""
    for row in np.flatnonzero(~np.isfinite(time_s))[:1]:
        _require(False, where, "finite times", f"{time_s[row]} in row {row + 1}")
    n, period_s = time_s.size, uniform_period_s(time_s, where)
    off = np.abs(time_s - (time_s[0] + period_s * np.arange(n))) / period_s
    row = int(np.argmax(off))
    _require(
        off[row] <= LARGEST_JITTER,
        where,
        f"a uniform clock within {LARGEST_JITTER:g} of its period, {period_s:.6g} s",
        f"row {row + 1} off by {off[row]:.3g} periods",
        "resample the record to a uniform clock",
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
