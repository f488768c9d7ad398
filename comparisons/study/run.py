"""A study from its declaration to its table: tasks by joblib, finished cells kept as they come."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed, parallel_config

from classic_ml.series import CoefficientSeries
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.harness.methods import OwnMethod
from comparisons.study.design import Cell, cells_of, tasks_of
from comparisons.study.scores import NUMBERS
from comparisons.study.sources import FIT_DEFAULTS, Made, make_record, prepare
from comparisons.study.spec import Method, StudySpec
from surge_core.errors import InputError, require
from surge_core.files import replace_whole, write_whole
from surge_core.threads import one_thread

RESULTS, FINISHED = "results.parquet", "cells.jsonl"
# Workers of a cluster to reckon with: their number may change while it works.
CLUSTER = 16
CONNECT_S = 10.0
CURVE_POINTS = 50
NAN = float("nan")

Row = dict[str, Any]


def run_study(
    spec: StudySpec,
    folder: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Callable[[int], object] = lambda _: None,
) -> pd.DataFrame:
    """Run the cells of a study that are not finished yet, and write its table.

    Parameters
    ----------
    spec : StudySpec
        The study.
    folder : path
        Where its files go; it is made where it is missing.
    jobs : int
        Number of worker processes.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do the work instead.
    resume : bool
        Keep the finished cells in the folder, but for those that failed.
    progress : callable
        Called with the number of cells finished each time some are.

    Returns
    -------
    pandas.DataFrame
        The table, one row a cell.

    Raises
    ------
    InputError
        When a class cannot be had, the folder holds a study or no scheduler answers.
    """
    check_study(spec, folder, resume=resume)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / FINISHED
    cells = cells_of(spec)
    rows = {row["key"]: row for row in _finished(file)}
    # Without the failed ones, and a line that a crash cut off.
    write_whole(file, _lines(rows.values()))
    left = [cell for cell in cells if cell.key not in rows]
    progress(len(cells) - len(left))
    with file.open("a", encoding="utf-8") as kept:
        for done in _worked_off(tasks_of(left), jobs, scheduler):
            kept.write(_lines(done))
            kept.flush()
            rows |= {row["key"]: row for row in done}
            progress(len(done))
    table = _table(spec, [(cell, rows[cell.key]) for cell in cells])
    replace_whole(folder / RESULTS, lambda path: table.to_parquet(path, index=False))
    return table


def check_study(spec: StudySpec, folder: Path, *, resume: bool = False) -> None:
    """Refuse, before anything is computed or written, a study that cannot be run into a folder.

    Parameters
    ----------
    spec : StudySpec
        The study.
    folder : path
        Where its files are to go.
    resume : bool
        Whether finished cells may be there.

    Raises
    ------
    InputError
        When the folder holds a study, or a class cannot be had.
    """
    for method in spec.method:
        own = OwnMethod(method.import_path, method.name, method.parameters)
        if method.import_path and own.naming() is None:
            own.check()
    free, remedy = not (folder / FINISHED).exists(), "--resume goes on; or name another folder"
    require(resume or free, str(folder), "a folder without a study", FINISHED, remedy)


def _finished(file: Path) -> Iterator[Row]:
    """Yield the rows that need not be made again; a line that a crash cut off is none."""
    for line in file.read_text("utf-8").splitlines() if file.exists() else ():
        try:
            row = json.loads(line)
        except ValueError:
            continue
        if row["state"] != "failed":
            yield row


def _lines(rows: Iterable[Row]) -> str:
    return "".join(json.dumps(row) + "\n" for row in rows)


def _worked_off(tasks: list[list[Cell]], jobs: int, scheduler: str | None) -> Iterator[list[Row]]:
    """Yield the rows of each task, in any order: by processes here, or by a Dask cluster."""
    with ExitStack() as stack:
        # Outside any other parallel region, whose backend would be taken over.
        backend: dict[str, Any] = {"backend": "loky" if jobs > 1 else "sequential", "n_jobs": jobs}
        if scheduler is not None:
            client = stack.enter_context(_client(scheduler))
            backend = {"backend": "dask", "client": client, "n_jobs": CLUSTER}
        stack.enter_context(parallel_config(**backend))
        yield from Parallel(return_as="generator_unordered")(map(delayed(run_task), tasks))


def _client(scheduler: str) -> Any:
    try:
        from distributed import Client

        return Client(scheduler, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (ImportError, OSError, ValueError) as error:
        raise InputError(
            "--scheduler",
            expected="the address of a Dask scheduler, and the package 'distributed'",
            found=f"{scheduler}: {error}",
        ) from error


def run_task(cells: Sequence[Cell]) -> list[Row]:
    """Work off cells that share a record; whatever goes wrong in a cell is its row's reason.

    One thread: sums over several are taken in another order and differ in their last bits.

    Parameters
    ----------
    cells : sequence of Cell
        Of one record.

    Returns
    -------
    list of dict
        One row a cell. The seconds of shared work are those of the first row that needed it.
    """
    points = {cell.point.reduction: cell.point for cell in cells}
    record = cache(lambda: make_record(cells[0].point))
    series = cache(lambda reduction: prepare(record(), points[reduction]))
    with one_thread():
        return [_row(cell, record, series) for cell in cells]


def _row(cell: Cell, record: Callable[[], Made], series: Callable[[str], Any]) -> Row:
    # A class may draw from numpy's shared generator: the same numbers for a cell in any worker and
    # any order.
    np.random.seed(int(cell.key.removeprefix("c-"), 16) % 2**32)  # noqa: NPY002
    begun = time.perf_counter()
    try:
        reduced, fit = series(cell.point.reduction), FIT_DEFAULTS | cell.point.table("fit")
        found = _scores(cell.method, reduced, record(), fit)
    except Exception as error:
        # A cell that fails is a row, not a stopped study.
        text = " ".join(str(error).splitlines()[:1])
        named = text if isinstance(error, InputError) else f"{type(error).__name__}: {text}"
        found = {"state": "failed", "reason": named}
    return {"key": cell.key, "seconds": time.perf_counter() - begun, **found}


def _scores(
    method: Method,
    records: Sequence[CoefficientSeries],
    made: Made,
    fit: dict[str, Any],
) -> dict[str, Any]:
    """Fit one method with a degree and a hold, and return its state, reason and scores by name."""
    if method.import_path:
        own = OwnMethod(method.import_path, method.name, method.parameters)
        naming = own.naming()
        if naming is not None:
            names = tuple(naming(records))
            wrong = [name for name in names if name not in made.effects]
            counts = {"firm_names": float(len(names)), "false_names": float(len(wrong))}
            return {"state": "ok", "reason": ", ".join(names), **counts}
        spec = own.spec()
    else:
        spec = {each.name: each for each in default_estimators(**fit)}[method.name]
    comparison = compare_records(records, estimators=[spec], hold=fit["hold"])
    result = comparison.results[0]
    model = result.model
    out: dict[str, Any] = {
        "state": "ok" if result.state == "converged" else result.state,
        "reason": "" if result.state == "converged" else result.advice,
        "scored": result.rows.kind,
        "tau_ms": 1e3 * model.time_constant_s,
        "tau_stderr_ms": 1e3 * model.time_constant_stderr_s,
        "free_run_rms": result.free_run.rms,
        "free_run_percent": result.free_run.fit_percent,
        "one_step_rms": result.one_step.rms,
        "held_out_rms": NAN if result.held_out is None else result.held_out.rms,
        "held_out_percent": NAN if result.held_out is None else result.held_out.fit_percent,
        "n_terms": float(len(model.terms)) if model.terms else NAN,
    }
    if np.isfinite(made.tau_s) and result.has_tau:
        low, high = model.ci95_s
        out["tau_error_ms"] = 1e3 * (model.time_constant_s - made.tau_s)
        # What a fit says is not to be used states no interval either.
        stated = result.state in ("converged", "two_readings")
        if stated and np.isfinite(low) and np.isfinite(high):
            out["tau_covered"] = float(low <= made.tau_s <= high)
    # Where this method scored φ, as far as the truth is known there.
    low, high = np.clip(model.valid_phi, *made.known_phi)
    if low < high and made.curve is not None and result.has_curve and result.states_curve:
        phi = np.linspace(low, high, CURVE_POINTS)
        error = model.quasi_steady(phi) - made.curve(phi)
        out["curve_rms_error"] = float(np.sqrt(np.mean(error**2)))
    return out


def _table(spec: StudySpec, cells: Sequence[tuple[Cell, Row]]) -> pd.DataFrame:
    """Return the table, one row a cell, in the order of the design."""
    rows = [
        {
            "cell": cell.number,
            "record": cell.point.record,
            "draw": cell.point.draw,
            "reduction": cell.point.reduction,
            "method": cell.method.name,
            "seed": cell.point.seed,
            **{name: dict(cell.point.settings)[name] for name in spec.axes},
            "state": found["state"],
            "reason": found["reason"],
            "scored": found.get("scored", ""),
            **{name: float(found.get(name, np.nan)) for name in (*NUMBERS, "seconds")},
        }
        for cell, found in cells
    ]
    for name in spec.axes:
        # A column of a Parquet file is of one type.
        if {type(row[name]) for row in rows} - {float, int, bool, type(None)}:
            for row in rows:
                row[name] = "none" if row[name] is None else str(row[name])
    return pd.DataFrame(rows)
