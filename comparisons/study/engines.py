"""Who works off the tasks of a study: this process, joblib's workers, or a Dask cluster.

Each engine takes tasks and gives back, in whatever order they end, every task with its rows. A
task whose worker dies is tried again, alone; one that takes its worker with it every time comes
back without rows.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any, Protocol

from comparisons.study.design import Task
from comparisons.study.work import Row, failed_row, rows_of, run_task
from surge_core.errors import InputError

__all__ = ["Engine", "Outcome", "dask_engine", "engine_for", "joblib_engine", "serial_engine"]

# Tasks handed out ahead of each worker: enough that none waits, few enough that memory stays flat.
AHEAD = 2
# Times that a task is tried alone after it was seen beside a worker's death.
MOST_TRIES = 1
CONNECT_S = 10.0

Outcome = tuple[Task, list[Row] | None]


class Engine(Protocol):
    """Works off tasks."""

    def __call__(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Yield every task with its rows, or with None where no worker survived it."""


def serial_engine(tasks: Iterable[Task]) -> Iterator[Outcome]:
    """Work in this process; each cell is given back as it ends.

    Parameters
    ----------
    tasks : iterable of Task
        The tasks.
    """
    for task in tasks:
        for row in rows_of(task):
            yield task, [row]


def joblib_engine(jobs: int) -> Engine:
    """Return an engine of worker processes on this machine.

    Parameters
    ----------
    jobs : int
        Their number.
    """

    def work(tasks: Iterable[Task]) -> Iterator[Outcome]:
        waiting = iter(tasks)
        while True:
            out: dict[int, Task] = {}
            taken = _remembered(waiting, out)
            try:
                for outcome in _parallel(taken, jobs):
                    del out[outcome[0].number]
                    yield outcome
            except _worker_deaths():
                # Nobody says whose fault it was: those that were out are tried one by one.
                for task in list(out.values()):
                    yield from _one_by_one(task)
                continue
            return

    return work


def _remembered(tasks: Iterator[Task], out: dict[int, Task]) -> Iterator[Task]:
    """Yield tasks and remember which are out."""
    for task in tasks:
        out[task.number] = task
        yield task


def _with_task(task: Task) -> Outcome:
    return task, run_task(task)


def _parallel(tasks: Iterable[Task], jobs: int) -> Iterator[Outcome]:
    from joblib import Parallel, delayed

    parallel = Parallel(
        n_jobs=jobs,
        backend="loky",
        return_as="generator_unordered",
        pre_dispatch=AHEAD * jobs,
        batch_size=1,
        inner_max_num_threads=1,
    )
    found: Iterator[Outcome] = parallel(delayed(_with_task)(task) for task in tasks)
    return found


def _worker_deaths() -> tuple[type[BaseException], ...]:
    from joblib.externals.loky.process_executor import BrokenProcessPool, TerminatedWorkerError

    return (TerminatedWorkerError, BrokenProcessPool)


def _one_by_one(task: Task) -> Iterator[Outcome]:
    """Try a task by itself, and what does not survive cell by cell."""
    outcome = _alone(task)
    if outcome[1] is not None or len(task.cells) == 1:
        yield outcome
        return
    for cell in task.cells:
        yield _alone(replace(task, cells=(cell,)))


def _alone(task: Task) -> Outcome:
    """Try a task by itself, in a process that may die."""
    for _ in range(MOST_TRIES):
        try:
            (outcome,) = _parallel([task], 2)
            return outcome
        except _worker_deaths():
            continue
    return task, None


def dask_engine(address: str, timeout_s: float = CONNECT_S) -> Engine:
    """Return an engine of the workers of a Dask scheduler.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://host:8786``; its workers have this package installed.
    timeout_s : float
        How long to wait for it, in seconds.

    Raises
    ------
    InputError
        When dask.distributed is not installed or nobody answers.
    """
    distributed = _distributed()
    # Once now, so that a wrong address is told before anything is begun.
    _connected(distributed, address, timeout_s).close()

    def work(tasks: Iterable[Task]) -> Iterator[Outcome]:
        client = _connected(distributed, address, timeout_s)
        try:
            waiting = iter(tasks)
            room = AHEAD * max(1, sum(client.nthreads().values()))
            pending = distributed.as_completed([], loop=client.loop)
            known: dict[str, Task] = {}

            def hand_out(handed: Iterable[Task]) -> None:
                for task in handed:
                    future = client.submit(run_task, task, pure=False)
                    known[future.key] = task
                    pending.add(future)

            hand_out(islice(waiting, room))
            while known:
                future = next(pending)
                task = known.pop(future.key)
                outcome = _dask_outcome(distributed, task, future)
                future.release()
                if outcome[1] is None and len(task.cells) > 1:
                    hand_out(replace(task, cells=(cell,)) for cell in task.cells)
                    continue
                hand_out(islice(waiting, 1))
                yield outcome
        finally:
            client.close()

    return work


def _distributed() -> Any:
    """Return the package, whose functions carry no types."""
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise InputError(
            "--scheduler",
            expected="the package distributed",
            found="it is not installed",
            remedy="pip install 'sindy-surge[cluster]'",
        ) from error


def _connected(distributed: Any, address: str, timeout_s: float) -> Any:
    try:
        with warnings.catch_warnings():
            # Dask warns of other versions of packages that no cell uses.
            warnings.simplefilter("ignore")
            client = distributed.Client(address, timeout=timeout_s, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            "--scheduler",
            expected="the address of a Dask scheduler, such as tcp://host:8786",
            found=f"{address!r} ({type(error).__name__})",
        ) from error
    if not client.nthreads():
        client.close()
        raise InputError(
            "--scheduler",
            expected="a scheduler with workers",
            found=f"none at {address}",
            remedy="start one with 'dask worker ADDRESS'",
        )
    return client


def _dask_outcome(distributed: Any, task: Task, future: Any) -> Outcome:
    try:
        return task, future.result()
    except distributed.KilledWorker:
        return task, None
    except ImportError as error:
        reason = f"a worker lacks what it needs: {error}"
        return task, [failed_row(n, point, method.name, reason) for n, point, method in task.cells]


def engine_for(jobs: int, scheduler: str | None) -> Engine:
    """Return the engine that a user asks for.

    Parameters
    ----------
    jobs : int
        Worker processes on this machine; 1 works in this process.
    scheduler : str or None
        Address of a Dask scheduler, in place of them.
    """
    if scheduler is not None:
        return dask_engine(scheduler)
    return serial_engine if jobs == 1 else joblib_engine(jobs)
