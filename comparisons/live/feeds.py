"""Where the bytes come from: the standard input, a TCP or a Unix socket; a thread reads them."""

from __future__ import annotations

import os
import queue
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from surge_core.errors import InputError

__all__ = ["Closed", "Feed", "Opened", "calling", "listening", "parse_address", "piped"]

CHUNK = 65_536
# At most so many chunks wait to be worked on; then the sender is made to wait.
WAITING_CHUNKS = 128
# How long a blocked call lasts before it is asked whether the run is over; how long a caller rests.
POLL_S, REST_S = 0.2, 1.0


@dataclass(frozen=True)
class Opened:
    """A connection begins: its first line is the header."""


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


Arrival = Opened | bytes | Closed


@dataclass
class Feed:
    """Bytes of one connection after another, as they come.

    Parameters
    ----------
    waiting : str
        What is waited for while there is no connection.
    read : callable
        Puts arrivals into the feed until it is stopped; run in a thread of its own.
    comes_back : bool
        Whether another sender may come where one was no good.
    """

    waiting: str
    read: Callable[[Feed], None]
    comes_back: bool = True
    stopped: threading.Event = field(default_factory=threading.Event)
    # Set by the session to refuse the present connection.
    dropped: threading.Event = field(default_factory=threading.Event)
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

    def put(self, arrival: Arrival) -> None:
        """Hand an arrival over, waiting while too many wait."""
        while not self.stopped.is_set():
            try:
                return self.arrivals.put(arrival, timeout=POLL_S)
            except queue.Full:
                continue

    def pass_on(self, connection: socket.socket) -> None:
        """Read a connection to its end."""
        self.dropped.clear()
        self.put(Opened())
        connection.settimeout(POLL_S)
        with connection:
            while not (self.stopped.is_set() or self.dropped.is_set()):
                try:
                    data = connection.recv(CHUNK)
                except TimeoutError:
                    continue
                except OSError as error:
                    return self.put(Closed(error.strerror or str(error)))
                if not data:
                    return self.put(Closed("the sender closed it"))
                self.put(data)
        self.put(Closed("refused"))


def piped(handle: int) -> Feed:
    """Return the feed of a pipe or file; its end is the end of the run.

    Parameters
    ----------
    handle : int
        File descriptor, such as that of the standard input.
    """

    def read(feed: Feed) -> None:
        feed.put(Opened())
        while not feed.stopped.is_set():
            try:
                data = os.read(handle, CHUNK)
            except OSError as error:
                return feed.put(Closed(error.strerror or str(error), for_good=True))
            if not data:
                return feed.put(Closed("the input ended", for_good=True))
            feed.put(data)

    return Feed("waiting for the input", read, comes_back=False)


def listening(address: tuple[str, int] | Path) -> Feed:
    """Return the feed of a socket that waits for a sender, and again when it is gone.

    Parameters
    ----------
    address : tuple of str and int, or path
        TCP host and port (0: any that is free), or the path of a Unix socket.

    Raises
    ------
    InputError
        When the address cannot be had.
    """
    try:
        if isinstance(address, Path):
            server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            server.bind(str(address))
            server.listen()
            place = str(address)
        else:
            server = socket.create_server(address)
            host, port = server.getsockname()[:2]
            place = f"{host}:{port}"
    except OSError as error:
        option = "--unix" if isinstance(address, Path) else "--listen"
        raise InputError(
            option,
            expected="an address that is free",
            found=f"{address}: {error.strerror or error}",
        ) from error
    server.settimeout(POLL_S)

    def read(feed: Feed) -> None:
        with server:
            while not feed.stopped.is_set():
                try:
                    connection, _ = server.accept()
                except TimeoutError:
                    continue
                feed.pass_on(connection)
        if isinstance(address, Path):
            address.unlink(missing_ok=True)

    return Feed(f"waiting for a sender at {place}", read)


def calling(host: str, port: int) -> Feed:
    """Return the feed of a server that sends, called again while it does not answer.

    Parameters
    ----------
    host, port : str, int
        Its address.
    """

    def read(feed: Feed) -> None:
        while not feed.stopped.is_set():
            try:
                connection = socket.create_connection((host, port), timeout=REST_S)
            except OSError:
                feed.stopped.wait(REST_S)
                continue
            feed.pass_on(connection)

    return Feed(f"calling {host}:{port}", read)


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``; the host is this machine without one.

    Parameters
    ----------
    text : str
        As typed.

    Raises
    ------
    ValueError
        When it is no address.
    """
    host, _, port = text.rpartition(":")
    number = int(port)
    if not 0 <= number <= 65_535:
        raise ValueError(text)
    return host.strip("[]") or "127.0.0.1", number
