"""Feeds over sockets, which a sender may leave and come back to."""

from __future__ import annotations

import os
import socket
import stat
import time
from pathlib import Path

from comparisons.live.callers import Caller, Callers
from comparisons.live.feed import CHUNK, POLL_S, Closed, Data, Feed
from surge_core.errors import InputError

__all__ = ["CallingFeed", "ListeningFeed", "parse_address"]

# A sender that has been silent for so long gives way to another one with a header of this test.
# One that sends every few seconds keeps its place; one that was cut off, and comes back while its
# old connection is still thought to be there, does not wait for long.
SILENT_S = 5.0


class ListeningFeed(Feed):
    """A server that one sender at a time connects to, as often as it likes.

    Whoever else connects is heard aside, and takes the place of the sender only with a header of
    this test, and only when the sender has closed its connection, is silent, or has sent no such
    header itself.

    Parameters
    ----------
    server : socket
        Listening.
    name : str
        Its address, in words.
    path : path, optional
        File of a Unix socket, removed at the end.
    """

    def __init__(self, server: socket.socket, name: str, path: Path | None = None) -> None:
        super().__init__()
        server.setblocking(False)
        self._server = server
        self._name = name
        self._path = path

    @classmethod
    def on_address(cls, host: str, port: int) -> ListeningFeed:
        """Listen on a TCP address."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            server = socket.create_server((host, port), family=family, backlog=1)
        except OSError as error:
            raise InputError(
                "--listen",
                expected="an address that is free on this machine",
                found=f"{host}:{port}: {error.strerror or error}",
            ) from None
        return cls(server, f"{host}:{server.getsockname()[1]}")

    @classmethod
    def on_path(cls, path: Path) -> ListeningFeed:
        """Listen on a Unix socket that only this user can reach."""
        if not hasattr(socket, "AF_UNIX"):
            raise InputError(
                "--unix", expected="a system with Unix sockets", found="none", remedy="use --listen"
            )
        server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _remove_left_over(path)
            mask = os.umask(0o177)
            try:
                server.bind(str(path))
            finally:
                os.umask(mask)
            server.listen(1)
        except OSError as error:
            server.close()
            raise InputError(
                "--unix",
                expected="a path where a socket can be made",
                found=f"{path}: {error.strerror or error}",
            ) from None
        return cls(server, str(path), path)

    @property
    def waiting(self) -> str:
        """What is waited for."""
        return f"waiting for a sender on {self._name}"

    def close(self) -> None:
        """Stop listening."""
        super().close()
        if self._thread.is_alive():
            self._thread.join(2.0 * POLL_S + 1.0)
        self._server.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def _run(self) -> None:
        others = Callers(self._server, self.accepts)
        with others:
            while not self._stop.is_set():
                caller = others.next()
                if caller is None:
                    continue
                self._opened()
                with caller.connection:
                    if caller.head:
                        self._put(Data(caller.head, time.monotonic()))
                    why = self._read(caller, others)
                self._put(Closed(why))

    def _read(self, caller: Caller, others: Callers) -> str:
        """Read until the connection ends; return why it ended."""
        heard_s = time.monotonic()
        while not self._stop.is_set():
            ready = others.ready(caller.connection)
            if self._is_dropped:
                return "it was refused"
            if caller.connection in ready:
                at_s = time.monotonic()
                try:
                    data = caller.connection.recv(CHUNK)
                except OSError as error:
                    return error.strerror or str(error)
                if not data:
                    return "the sender closed it"
                caller.hear(data, self.accepts)
                self._put(Data(data, at_s))
                # Where the session has much to do, it is not the sender that was silent.
                heard_s = time.monotonic()
            others.hear(ready)
            silent = time.monotonic() - heard_s > SILENT_S
            if others.has_sender and (silent or not caller.is_sender):
                return "another sender took over"
        return "the session ended"


class CallingFeed(Feed):
    """A client that connects to a server, and again whenever the connection is lost.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
        Port.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._address = (host, port)

    @property
    def waiting(self) -> str:
        """What is waited for."""
        return f"trying to reach {self._address[0]}:{self._address[1]}"

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                connection = socket.create_connection(self._address, timeout=2.0)
            except OSError:
                self._stop.wait(POLL_S)
                continue
            with connection:
                self._opened()
                self._put(Closed(self._read(connection)))
            # A server that hangs up at once is not to be called a thousand times a second.
            self._stop.wait(POLL_S)

    def _read(self, connection: socket.socket) -> str:
        connection.settimeout(POLL_S)
        while not (self._stop.is_set() or self._is_dropped):
            try:
                data = connection.recv(CHUNK)
            except TimeoutError:
                continue
            except OSError as error:
                return error.strerror or str(error)
            if not data:
                return "the server closed it"
            self._put(Data(data, time.monotonic()))
        return "it was refused" if self._is_dropped else "the session ended"


def _remove_left_over(path: Path) -> None:
    """Remove the socket of a session that was killed; one that somebody listens on stays."""
    if not path.exists() or not stat.S_ISSOCK(path.stat().st_mode):
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        try:
            trial.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of "HOST:PORT" or "PORT", the host being 127.0.0.1 without one.

    Parameters
    ----------
    text : str
        As typed.

    Raises
    ------
    ValueError
        When there is no port from 0 to 65535.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) <= 65_535):
        raise ValueError(text)
    return host.removeprefix("[").removesuffix("]") or "127.0.0.1", int(port)
