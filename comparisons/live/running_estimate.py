"""The running estimate in a process of its own.

It keeps the rows it was sent and works on one job at a time, so that neither the rows nor the
display wait for it.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from comparisons.live.columns import FeedColumns
from comparisons.live.estimate import Estimate, estimate_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from classic_ml.reduction import ReductionSettings

__all__ = ["MOST_ROWS", "Estimator", "NoEstimate", "RunningEstimate"]

# Rows from the near-stall reading on: five minutes at 1 kHz, 50 MB, and a second or two of work.
# What the cycles behind them would add is smaller than the errors that all cycles share.
MOST_ROWS = 300_000
# Share of the time that the process may work: the other core belongs to somebody else.
MOST_SHARE = 0.3
# On a busy machine scikit-learn takes its time to load.
LOADING_S = 30.0


class Estimator(Protocol):
    """What a session asks of a running estimate."""

    def begin(self) -> None:
        """Wait until it can be asked."""

    def restart(self) -> None:
        """Begin anew behind a gap."""

    def take(self, time_s: FloatArray, readings: FloatArray) -> None:
        """Take the next rows."""

    def ask(self) -> None:
        """Ask for a fit of the rows so far, when there is time for one."""

    def poll(self) -> Estimate | None:
        """Return a new estimate, if there is one."""

    def close(self) -> None:
        """End the work."""


class NoEstimate:
    """Stand in where no running estimate is wanted."""

    def begin(self) -> None:
        """Do nothing."""

    def restart(self) -> None:
        """Do nothing."""

    def take(self, time_s: FloatArray, readings: FloatArray) -> None:
        """Do nothing."""

    def ask(self) -> None:
        """Do nothing."""

    def poll(self) -> Estimate | None:
        """Return nothing."""
        return None

    def close(self) -> None:
        """Do nothing."""


class RunningEstimate:
    """Fit the rows so far in a process of its own, one job at a time.

    Parameters
    ----------
    columns : FeedColumns
        The channels.
    settings : ReductionSettings, optional
        The switches of its reductions; the defaults without them.
    """

    def __init__(self, columns: FeedColumns, settings: ReductionSettings | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self._connection = ours
        self._process = context.Process(
            target=_serve, args=(theirs, columns, settings), daemon=True
        )
        with _interrupts_held_back():
            self._process.start()
        theirs.close()
        reading, half_s = columns.test.near_stall, 0.5 / columns.test.sample_rate_hz
        # Without its near-stall reading a piece cannot be reduced, unless the test says what the
        # match would be.
        stated = bool(columns.test.near_stall_shifts)
        self._from_s = -math.inf if stated else reading.from_s - half_s
        self._to_s = math.inf if stated else reading.to_s
        # The process says once that it has begun.
        self._busy = True
        self._dead = False
        self._n_jobs = 0
        self._wanted = False
        self._not_before = 0.0
        self.restart()

    def begin(self) -> None:
        """Wait until the process has loaded what it needs, or for half a minute."""
        self._connection.poll(LOADING_S)

    def restart(self) -> None:
        """Begin anew behind a gap."""
        self._pending: list[FloatArray] = []
        self._start_s: float | None = None
        self._n_rows = 0
        self._fresh = True
        self._shut = False

    def take(self, time_s: FloatArray, readings: FloatArray) -> None:
        """Take the next rows.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clock of rows that follow on those before.
        readings : ndarray of shape (n, n_channels)
            Counts, Pa and K.
        """
        if self._shut:
            return
        if self._start_s is None:
            wanted = time_s >= self._from_s
            if not wanted.any():
                return
            self._start_s = float(time_s[wanted][0])
            self._shut = self._start_s > self._to_s
            readings = readings[wanted]
        self._pending.append(readings)
        self._n_rows += len(readings)
        self._shut = self._shut or self._n_rows > MOST_ROWS

    def ask(self) -> None:
        """Ask for a fit of the rows so far, when there is time for one."""
        self._wanted = True

    def poll(self) -> Estimate | None:
        """Return a new estimate, if there is one, and set the next job going."""
        if self._dead:
            return None
        try:
            estimate = self._answer()
            self._send()
        except (OSError, EOFError):
            self._dead = self._shut = True
            return Estimate("the process of the running estimate has ended")
        return estimate

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.terminate()
        self._process.join()

    def _answer(self) -> Estimate | None:
        # Where the process has ended, the pipe has its end to be read.
        if not self._connection.poll():
            return None
        estimate: Estimate | None = self._connection.recv()
        self._busy = False
        if estimate is not None:
            # The first job loads and compiles, which says nothing of the next one.
            rest = estimate.seconds * (1.0 / MOST_SHARE - 1.0) if self._n_jobs else 0.0
            self._n_jobs += 1
            self._not_before = time.monotonic() + rest
        return estimate

    def _send(self) -> None:
        due = self._wanted and not self._busy and time.monotonic() >= self._not_before
        if not due or not self._pending or self._start_s is None:
            return
        rows = np.concatenate(self._pending)
        self._connection.send((self._fresh, self._start_s, rows))
        self._pending, self._fresh = [], False
        self._wanted, self._busy = False, True


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Hold interrupts back, which a process that is begun here will never get then.

    One from the terminal goes to both: the other process would say so while it loads.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    # This process of multiprocessing's own, once begun, would let interrupts through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(
    connection: Connection[Any, Any], columns: FeedColumns, settings: ReductionSettings | None
) -> None:
    """Answer each job with an estimate until the other end is closed."""
    from threadpoolctl import threadpool_limits

    # The end of a session is the parent's business; where it is gone, the pipe tells.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(5)
    rows: list[FloatArray] = []
    with threadpool_limits(1):
        _load()
        try:
            connection.send(None)
            while True:
                fresh, start_s, more = connection.recv()
                rows = [more] if fresh else [np.concatenate([*rows, more])]
                connection.send(_tried(columns, rows[0], start_s, settings))
        except (EOFError, OSError):
            return


def _tried(
    columns: FeedColumns, readings: FloatArray, start_s: float, settings: ReductionSettings | None
) -> Estimate:
    """Return an estimate, whatever happens: no provisional fit is worth the end of a session."""
    try:
        return estimate_of(columns, readings, start_s, settings)
    except Exception as error:
        return Estimate(f"the fit failed: {type(error).__name__}: {error}")


def _load() -> None:
    """Load what takes seconds to load, its compiled kernels too, before the first rows come."""
    import classic_ml.reduction
    import classic_ml.whole_run  # noqa: F401
    from classic_ml.filters import low_pass
    from classic_ml.lag_regressor import LagRegressor

    phase = np.linspace(0.0, 20.0, 400)
    signal = low_pass(np.sin(phase), 1e3, order=3, cutoff_hz=48.0, phase="zero")
    LagRegressor(1e-3, noise="output-error", hold="first").fit(
        signal[:, None], np.sin(phase - 0.3), sample_weight=np.ones(phase.size)
    )
