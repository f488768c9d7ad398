"""Where the lines come from: the standard input, a TCP or a Unix socket; a thread reads them."""

from __future__ import annotations

import os
import queue
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from surge_core.errors import InputError

CHUNK = 65_536
# 2,000 columns of 30 characters: more than any test has, and nothing beside the memory.
LONGEST_LINE = 65_536
# At most so many chunks wait to be worked on; then the sender is made to wait.
WAITING_CHUNKS = 128


@dataclass(frozen=True)
class Opened:
    """A connection begins: its first line is the header."""


@dataclass(frozen=True)
class Closed:
    """A connection ends, and why; ``for_good`` where no other can follow."""

    why: str
    for_good: bool = False


Arrival = Opened | list[bytes] | Closed


@dataclass
class Feed:
    """Lines of one connection after another, as they come."""

    waiting: str  # What is waited for while there is no connection
    read: Callable[[Feed], None]  # Puts arrivals into the feed, in a thread that ends with us
    comes_back: bool = True  # Whether another sender may come where one was no good
    refuse: Callable[[], object] = lambda: None  # Ends the present connection
    arrivals: queue.Queue[Arrival] = field(default_factory=lambda: queue.Queue(WAITING_CHUNKS))

    def start(self) -> None:
        """Begin to read."""
        threading.Thread(target=self.read, args=(self,), name="feed", daemon=True).start()

    def next(self, timeout_s: float) -> Arrival | None:
        """Return the next arrival, or None when there was none for so long."""
        try:
            return self.arrivals.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def pass_on(self, receive: Callable[[int], bytes]) -> bytes:
        """Read a connection to its end, and return what stood behind its last line feed.

        ``receive`` gives the next bytes, at most so many; none at the end.
        """
        self.arrivals.put(Opened())
        rest = b""
        while data := receive(CHUNK):
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[:LONGEST_LINE]
            self.arrivals.put(lines)
        return rest


def piped(handle: int) -> Feed:
    """Return the feed of a pipe or file, by its descriptor; its end is the end of the run."""

    def read(feed: Feed) -> None:
        # The last line of a file may lack its end.
        feed.arrivals.put([feed.pass_on(partial(os.read, handle))])
        feed.arrivals.put(Closed("the input ended", for_good=True))

    return Feed("waiting for the input", read, comes_back=False)


def listening(address: tuple[str, int] | Path) -> Feed:
    """Return the feed of a socket that waits for a sender, and again when it is gone.

    The address is host and port of TCP (port 0: any that is free), or the path of a Unix socket.
    """
    try:
        if isinstance(address, Path):
            server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            server.bind(str(address))
            server.listen()
            place = str(address)
        else:
            server = socket.create_server(address)
            place = "{}:{}".format(*server.getsockname()[:2])
    except OSError as error:
        raise InputError(
            "--unix" if isinstance(address, Path) else "--listen",
            expected="an address that is free",
            found=f"{address}: {error.strerror or error}",
        ) from error

    def read(feed: Feed) -> None:
        while True:
            connection, _ = server.accept()
            feed.refuse = partial(connection.shutdown, socket.SHUT_RDWR)
            why = "the sender closed it"
            with connection:
                try:
                    feed.pass_on(connection.recv)
                except OSError as error:
                    why = error.strerror or str(error)
            feed.arrivals.put(Closed(why))

    return Feed(f"waiting for a sender at {place}", read)
