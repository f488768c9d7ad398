"""A study from its declaration to its table."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from array import array
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.study.design import Task, count_cells, tasks_of
from comparisons.study.engines import Engine, Outcome, serial_engine
from comparisons.study.journal import Journal, finished_cells, read_rows
from comparisons.study.methods import check_methods
from comparisons.study.scores import NUMBERS
from comparisons.study.sources import defaults_of
from comparisons.study.spec import SCHEMA, Range, StudySpec
from comparisons.study.work import failed_row
from surge_core.errors import InputError
from surge_core.files import replace_whole, write_whole

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["StudyFiles", "check_study", "resolved", "run_study", "study_table"]

# Workers to reckon with where their number is not known.
CLUSTER = 16
DIED = "its worker died each time it was tried"
PACKAGES = ("sindy-surge", "numpy", "scipy", "pandas", "scikit-learn", "pysindy", "numba", "joblib")
TEXTS = ("record", "draw", "reduction", "method", "state", "reason")
TIMES = ("seconds_fit", "seconds_record", "seconds_reduction")

Told = Callable[[int], object]


@dataclass(frozen=True)
class StudyFiles:
    """Where a study leaves what.

    Parameters
    ----------
    folder : path
        The study's folder.
    """

    folder: Path

    @property
    def journal(self) -> Path:
        """Every finished cell, as it came."""
        return self.folder / "journal.jsonl"

    @property
    def spec(self) -> Path:
        """The specification with all that it leaves to defaults."""
        return self.folder / "study.json"

    @property
    def provenance(self) -> Path:
        """Versions, machine and times of each run."""
        return self.folder / "provenance.json"

    @property
    def results(self) -> Path:
        """The table."""
        return self.folder / "results.parquet"

    @property
    def report(self) -> Path:
        """The page."""
        return self.folder / "report.html"


def run_study(
    spec: StudySpec,
    folder: Path,
    *,
    engine: Engine = serial_engine,
    resume: bool = False,
    retry_failed: bool = False,
    workers: int | None = 1,
    told: Told = lambda _: None,
) -> pd.DataFrame:
    """Run the cells of a study that are not finished yet, and write its table.

    Parameters
    ----------
    spec : StudySpec
        The study.
    folder : path
        Where its files go; it is made where it is missing.
    engine : Engine
        Who works.
    resume : bool
        Go on with what is in the folder; without it a folder with a study is refused.
    retry_failed : bool
        Run the cells that failed once more; those whose worker died are run again anyway.
    workers : int
        Number of workers, for the share of their time that goes into fits; None: not known.
    told : callable
        Called with the number of cells finished each time some are.

    Returns
    -------
    pandas.DataFrame
        The table, one row a cell.

    Raises
    ------
    InputError
        When the folder holds another study, or a class cannot be had.
    """

    def again(row: Mapping[str, Any]) -> bool:
        return retry_failed or row["reason"] == DIED

    files = StudyFiles(folder)
    check_study(spec, folder, resume=resume)
    if not files.spec.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(files.spec, json.dumps(resolved(spec), indent=2, ensure_ascii=False) + "\n")
    done = finished_cells(files.journal, lambda row: row["state"] == "failed" and again(row))
    told(len(done))
    begun, begun_at = time.perf_counter(), datetime.now(UTC)
    spent = dict.fromkeys(TIMES, 0.0)
    with Journal(files.journal) as journal:
        outcomes = engine(tasks_of(spec, done, workers or CLUSTER))
        try:
            for rows in _worked_off(outcomes):
                journal.write(rows)
                for name in TIMES:
                    spent[name] += sum(float(row[name]) for row in rows)
                told(len(rows))
        finally:
            # An engine that is a generator lets go of its workers when it is closed.
            if isinstance(outcomes, Generator):
                outcomes.close()
    table = study_table(spec, files)
    replace_whole(files.results, lambda path: table.to_parquet(path, index=False))
    run = {
        "begun": begun_at.isoformat(timespec="seconds"),
        "cells": len(table) - len(done),
        "workers": workers,
        "seconds_wall": time.perf_counter() - begun,
        **spent,
    }
    _write_provenance(files, run)
    return table


def _worked_off(outcomes: Iterator[Outcome]) -> Iterator[list[dict[str, Any]]]:
    for task, rows in outcomes:
        yield _dead_rows(task) if rows is None else rows


def _dead_rows(task: Task) -> list[dict[str, Any]]:
    return [failed_row(number, point, method.name, DIED) for number, point, method in task.cells]


def check_study(spec: StudySpec, folder: Path, *, resume: bool = False) -> None:
    """Refuse, before anything is computed or written, a study that cannot be run into a folder.

    Parameters
    ----------
    spec : StudySpec
        The study.
    folder : path
        Where its files are to go.
    resume : bool
        Go on with what is in the folder.

    Raises
    ------
    InputError
        When the folder holds another study or cannot be made, or a class cannot be had.
    """
    check_methods(spec.methods)
    files = StudyFiles(folder)
    if files.spec.exists():
        _check_same(spec, files, resume)
    elif files.journal.exists():
        raise InputError(
            str(files.folder),
            expected=f"{files.spec.name} beside {files.journal.name}",
            found="a journal alone",
            remedy="name another folder",
        )
    _check_folder(folder)


def _check_same(spec: StudySpec, files: StudyFiles, resume: bool) -> None:
    if not resume:
        raise InputError(
            str(files.folder),
            expected="a folder without a study",
            found=files.spec.name,
            remedy="--resume goes on with it; or name another folder",
        )
    document = resolved(spec)
    held = _read_json(files.spec)
    if held != json.loads(json.dumps(document)):
        changed = sorted(k for k in {*held, *document} if held.get(k) != document.get(k))
        raise InputError(
            str(files.spec),
            expected="the same study as the one that is resumed",
            found="another " + ", ".join(changed),
            remedy="name another folder for it",
        )


def _check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made, or that nothing can be written to."""
    there = next(place for place in (folder, *folder.parents) if place.exists())
    if not there.is_dir():
        found = "a file" if there == folder else f"the file {there} on the way to it"
        raise InputError(
            str(folder), expected="a folder", found=found, remedy="name another folder"
        )
    if not os.access(there, os.W_OK):
        raise InputError(
            str(folder),
            expected="a folder that can be written to",
            found=f"no right to write to {there}",
            remedy="name another folder",
        )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        held = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            str(path),
            expected="the JSON that a study wrote",
            found="something else",
            remedy="name another folder",
        ) from error
    return held if isinstance(held, dict) else {}


def resolved(spec: StudySpec) -> dict[str, Any]:
    """Return a specification as plain values, defaults included.

    Parameters
    ----------
    spec : StudySpec
        The study.
    """
    return {
        "schema": SCHEMA,
        "title": spec.title,
        "source": spec.source,
        "design": {
            "kind": spec.design.kind,
            "points": spec.design.points,
            "seed": spec.design.seed,
        },
        "seeds": list(spec.seeds),
        "settings": {
            name: _range(value) if isinstance(value, Range) else list(value)
            for name, value in spec.settings.items()
        },
        "axes": list(spec.axes),
        "methods": [
            {
                "name": method.name,
                "class": method.import_path or method.built_in,
                "parameters": dict(method.parameters),
            }
            for method in spec.methods
        ],
        "scores": list(spec.scores),
        "reference": spec.reference,
        "by": list(spec.by),
        "cells": count_cells(spec),
        "defaults": defaults_of(spec),
    }


def _range(value: Range) -> dict[str, Any]:
    return {"from": value.low, "to": value.high, "log": value.log, "steps": value.steps}


def study_table(spec: StudySpec, files: StudyFiles) -> pd.DataFrame:
    """Return the table of the cells in a study's journal, in the order of their numbers.

    Parameters
    ----------
    spec : StudySpec
        The study.
    files : StudyFiles
        Its files.
    """
    import numpy as np
    import pandas as pd

    texts: dict[str, list[str]] = {name: [] for name in TEXTS}
    axes: dict[str, list[Any]] = {name: [] for name in spec.axes}
    numbers = {name: array("d") for name in (*NUMBERS, *TIMES)}
    cells, seeds = array("q"), array("q")
    # Row by row into narrow columns: a journal of many cells is never in memory as a whole.
    for row in read_rows(files.journal):
        cells.append(row["cell"])
        seeds.append(row["seed"])
        for name, values in texts.items():
            values.append(sys.intern(row[name]))
        for name, held in axes.items():
            held.append(row["settings"].get(name))
        for name, column in numbers.items():
            value = row.get(name)
            column.append(np.nan if value is None else value)
    columns: dict[str, Any] = {"cell": np.array(cells, dtype=np.int64)}
    for name in TEXTS[:4]:
        columns[name] = pd.Series(texts[name], dtype="str")
    columns["seed"] = np.array(seeds, dtype=np.int64)
    columns |= {name: _axis_column(values) for name, values in axes.items()}
    for name in TEXTS[4:]:
        columns[name] = pd.Series(texts[name], dtype="str")
    columns |= {name: np.array(values) for name, values in numbers.items()}
    table = pd.DataFrame(columns).drop_duplicates("cell", keep="last")
    return table.sort_values("cell", kind="stable", ignore_index=True)


def _axis_column(values: list[Any]) -> Any:
    """Return the values of an axis as numbers where all are, else as texts."""
    import numpy as np
    import pandas as pd

    known = [v for v in values if v is not None]
    if known and all(isinstance(v, bool) for v in known) and len(known) == len(values):
        return np.array(values, dtype=np.bool_)
    if known and all(isinstance(v, int | float) and not isinstance(v, bool) for v in known):
        whole = all(isinstance(v, int) for v in known) and len(known) == len(values)
        return np.array([np.nan if v is None else v for v in values], np.int64 if whole else float)
    return pd.Series(["none" if v is None else str(v) for v in values], dtype="str")


def _write_provenance(files: StudyFiles, run: Mapping[str, Any]) -> None:
    held = _read_json(files.provenance) if files.provenance.exists() else {}
    document = {
        "python": platform.python_version(),
        "system": platform.system(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "runs": [
            *held.get("runs", []),
            {**run, "versions": {name: _version(name) for name in PACKAGES}},
        ],
    }
    write_whole(files.provenance, json.dumps(document, indent=2) + "\n")


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
