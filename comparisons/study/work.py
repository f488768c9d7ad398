"""One task of a study: the same function on every engine, from a task to rows of the table."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from classic_ml.series import CoefficientSeries
from comparisons.study.design import Point, Task
from comparisons.study.methods import scores_of
from comparisons.study.sources import FIT_DEFAULTS, Made, make_record, prepare
from surge_core.errors import InputError

__all__ = ["failed_row", "rows_of", "run_task"]

Row = dict[str, Any]
Series = tuple[CoefficientSeries, ...]


def run_task(task: Task) -> list[Row]:
    """Work off the cells of a task; whatever goes wrong in a cell is its row's reason.

    One thread: sums over several are taken in another order and differ in their last bits.

    Parameters
    ----------
    task : Task
        Cells that share a record.

    Returns
    -------
    list of dict
        One row a cell.
    """
    return list(rows_of(task))


def rows_of(task: Task) -> Iterator[Row]:
    """Yield the rows of a task as they come; see `run_task`.

    Parameters
    ----------
    task : Task
        Cells that share a record.
    """
    _load()
    shop = _Workshop()
    for cell in task.cells:
        with threadpool_limits(limits=1):
            row = shop.row(*cell)
        yield row


def _load() -> None:
    """Import what brings libraries with threads of their own, before they are limited."""
    import comparisons.harness.compare
    import comparisons.harness.sparse_whole_run  # noqa: F401


class _Workshop:
    """The record and its reduction that were made last; cells that share them lie side by side."""

    def __init__(self) -> None:
        self._record: tuple[str, Made | Exception] | None = None
        self._reduced: tuple[tuple[str, str], Series | Exception] | None = None
        # Times of shared work go to the first row that needed it.
        self._seconds = {"seconds_record": 0.0, "seconds_reduction": 0.0}

    def row(self, number: int, point: Point, method: Any) -> Row:
        """Return the row of one cell."""
        self._seconds = dict.fromkeys(self._seconds, 0.0)
        begun = time.perf_counter()
        here = os.getcwd()
        # Other people's classes may draw from numpy's shared generator: by its cell, so that
        # nothing depends on who runs it and after what.
        drawn = np.random.get_state()  # noqa: NPY002
        np.random.seed(number % 2**32)  # noqa: NPY002
        try:
            # A class of somebody else may change what all share.
            with np.errstate():
                made = self._made(point)
                prepared = self._prepared(made, point)
                fit = {k.removeprefix("fit."): v for k, v in FIT_DEFAULTS.items()}
                fit |= point.table("fit")
                begun = time.perf_counter()
                found = scores_of(method, prepared, made, fit)
        except (Exception, SystemExit) as error:
            # A cell that fails is a row, not a stopped study.
            found = {"state": "failed", "reason": _told(error)}
        finally:
            os.chdir(here)
            np.random.set_state(drawn)  # noqa: NPY002
        found.setdefault("seconds_fit", time.perf_counter() - begun)
        return {**_head(number, point, method.name), **found, **self._seconds}

    def _made(self, point: Point) -> Made:
        if self._record is None or self._record[0] != point.record:
            begun = time.perf_counter()
            self._record = (point.record, _tried(make_record, point))
            self._seconds["seconds_record"] = time.perf_counter() - begun
        made: Made = _given(self._record[1])
        return made

    def _prepared(self, made: Made, point: Point) -> Series:
        key = (point.record, point.reduction)
        if self._reduced is None or self._reduced[0] != key:
            begun = time.perf_counter()
            self._reduced = (key, _tried(prepare, made, point))
            self._seconds["seconds_reduction"] = time.perf_counter() - begun
        series: Series = _given(self._reduced[1])
        return series


def _tried(make: Any, *arguments: Any) -> Any:
    """Return what is made, or the error; either is kept for the cells that share it."""
    try:
        return make(*arguments)
    except Exception as error:
        return error


def _given(made: Any) -> Any:
    if isinstance(made, Exception):
        raise made
    return made


def _told(error: BaseException) -> str:
    name = type(error).__name__
    try:
        first = str(error).strip().splitlines()
    except Exception:
        return f"{name}: no message"
    if isinstance(error, InputError):
        return " ".join(first)
    return f"{name}: {first[0] if first else 'no message'}"


def _head(number: int, point: Point, method: str) -> Row:
    return {
        "cell": number,
        "record": point.record,
        "draw": point.draw,
        "reduction": point.reduction,
        "method": method,
        "seed": point.seed,
        "settings": dict(point.settings),
    }


def failed_row(number: int, point: Point, method: str, reason: str) -> Row:
    """Return the row of a cell that could not be worked off at all.

    Parameters
    ----------
    number : int
        Of the cell.
    point : Point
        Of the cell.
    method : str
        Name of its estimator.
    reason : str
        Why.
    """
    times = {"seconds_fit": 0.0, "seconds_record": 0.0, "seconds_reduction": 0.0}
    return {**_head(number, point, method), "state": "failed", "reason": reason, **times}
