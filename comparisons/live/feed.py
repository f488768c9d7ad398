"""Where the bytes come from: what every feed does, and the pipe."""

from __future__ import annotations

import os
import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

__all__ = ["CHUNK", "POLL_S", "Arrival", "Closed", "Data", "Feed", "Opened", "PipeFeed"]

CHUNK = 65_536
# At most 128 chunks of 64 KiB wait to be worked on; then the sender is made to wait.
WAITING_CHUNKS = 128
POLL_S = 0.2


@dataclass(frozen=True)
class Opened:
    """A connection begins: its first line or frame is the header.

    Parameters
    ----------
    number : int
        Of the connection, from 1.
    """

    number: int = 1


@dataclass(frozen=True)
class Data:
    """Bytes, and when they came (monotonic clock).

    Parameters
    ----------
    data : bytes
        What came.
    at_s : float
        When.
    """

    data: bytes
    at_s: float


@dataclass(frozen=True)
class Closed:
    """A connection ends.

    Parameters
    ----------
    why : str
        In words.
    for_good : bool
        Whether no other can follow.
    """

    why: str
    for_good: bool = False


Arrival = Opened | Data | Closed


class Feed(ABC):
    """A source of bytes, read in a thread of its own so that arrivals are timed when they come."""

    # Whether another sender may come where one was no good.
    comes_back: ClassVar[bool] = True

    def __init__(self) -> None:
        self._arrivals: queue.Queue[Arrival] = queue.Queue(WAITING_CHUNKS)
        self._stop = threading.Event()
        self._n_opened = 0
        self._dropped = 0
        # Whether the first bytes of a connection begin a feed of this test; None while that is
        # open. Asked in the thread that reads.
        self.accepts: Callable[[bytes], bool | None] = _anything
        self._thread = threading.Thread(target=self._run, name="feed", daemon=True)

    @property
    @abstractmethod
    def waiting(self) -> str:
        """What is waited for while there is no connection."""

    @abstractmethod
    def _run(self) -> None:
        """Read until told to stop."""

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def next(self, timeout_s: float) -> Arrival | None:
        """Return the next arrival, or None when there was none for so long.

        Parameters
        ----------
        timeout_s : float
            How long to wait; 0 takes only what is there.
        """
        try:
            return self._arrivals.get(timeout=timeout_s) if timeout_s else self._arrivals.get(False)
        except queue.Empty:
            return None

    def drop(self, number: int) -> None:
        """Close a connection, if it is still there.

        Parameters
        ----------
        number : int
            Its number: by now another one may have taken its place.
        """
        self._dropped = number

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()

    def _opened(self) -> None:
        """Tell of a connection, which is the present one from now on."""
        self._n_opened += 1
        self._put(Opened(self._n_opened))

    @property
    def _is_dropped(self) -> bool:
        """Whether the present connection is to be closed."""
        return self._dropped == self._n_opened

    def _put(self, arrival: Arrival) -> None:
        while not self._stop.is_set():
            try:
                return self._arrivals.put(arrival, timeout=POLL_S)
            except queue.Full:
                continue


def _anything(head: bytes) -> bool | None:
    """Take whatever comes."""
    return True if head else None


class PipeFeed(Feed):
    """A pipe or a file, such as the standard input; its end is the end of the run.

    Parameters
    ----------
    handle : int
        File descriptor.
    """

    comes_back = False

    def __init__(self, handle: int) -> None:
        super().__init__()
        self._handle = handle

    @property
    def waiting(self) -> str:
        """What is waited for."""
        return "waiting for the standard input"

    def _run(self) -> None:
        self._opened()
        while not self._stop.is_set():
            try:
                data = os.read(self._handle, CHUNK)
            except OSError as error:
                return self._put(Closed(error.strerror or str(error), for_good=True))
            if not data:
                return self._put(Closed("the end of the input", for_good=True))
            self._put(Data(data, time.monotonic()))
