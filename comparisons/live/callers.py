"""Who connects to a session: heard aside until it is known whether it sends a test."""

from __future__ import annotations

import select
import socket
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

from comparisons.live.feed import CHUNK, POLL_S

__all__ = ["Accepts", "Caller", "Callers"]

# What tells of the first bytes of a connection whether they begin a feed of this test; None while
# they may or may not.
Accepts = Callable[[bytes], bool | None]

# A header has a few hundred bytes; nobody is heard for longer than this without one.
LONGEST_HEAD = 1 << 18
# Connections that are heard aside at the same time.
MOST_WAITING = 8


class Caller:
    """A connection, and what it sent before it was known what it is.

    Parameters
    ----------
    connection : socket
        Connected.

    Attributes
    ----------
    head : bytes
        What came, until it was known.
    is_sender : bool or None
        Whether it began with a header of this test; None while that is not known.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.head = b""
        self.is_sender: bool | None = None

    def hear(self, data: bytes, accepts: Accepts) -> None:
        """Take note of bytes while it is not known what they are.

        Parameters
        ----------
        data : bytes
            The next ones.
        accepts : callable
            What tells.
        """
        if self.is_sender is not None:
            return
        self.head += data
        self.is_sender = accepts(self.head)
        if self.is_sender is None and len(self.head) > LONGEST_HEAD:
            self.is_sender = False


class Callers:
    """Those who wait while another one is the sender.

    Parameters
    ----------
    server : socket
        Listening, and not blocking.
    accepts : callable
        What tells who sends a test.
    """

    def __init__(self, server: socket.socket, accepts: Accepts) -> None:
        self._server = server
        self._accepts = accepts
        self._waiting: list[Caller] = []

    def __enter__(self) -> Callers:
        """Wait for callers."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        """Hang up on all of them."""
        while self._waiting:
            self._leave(self._waiting[-1])

    @property
    def has_sender(self) -> bool:
        """Whether one of them sends a test."""
        return any(caller.is_sender for caller in self._waiting)

    def next(self) -> Caller | None:
        """Return who is next, a sender of a test before others; None when nobody came for long."""
        if not self._waiting:
            self.hear(self.ready())
        if not self._waiting:
            return None
        caller = next((one for one in self._waiting if one.is_sender), self._waiting[0])
        self._waiting.remove(caller)
        return caller

    def ready(self, *connections: socket.socket) -> list[socket.socket]:
        """Wait for news, of some connections too, and return where there are any.

        Parameters
        ----------
        *connections : socket
            Other connections.
        """
        # Who is known to send a test is not read any further: its rows wait on its own side.
        unknown = [one.connection for one in self._waiting if one.is_sender is None]
        return select.select([*connections, self._server, *unknown], [], [], POLL_S)[0]

    def hear(self, ready: list[socket.socket]) -> None:
        """Hear those who have something to say, and let in who knocks.

        Parameters
        ----------
        ready : list of socket
            Where there are news.
        """
        for caller in [one for one in self._waiting if one.connection in ready]:
            data = b""
            with suppress(OSError):
                data = caller.connection.recv(CHUNK)
            if data:
                caller.hear(data, self._accepts)
            if not data or caller.is_sender is False:
                self._leave(caller)
        if self._server in ready:
            # Nobody is there any more where somebody knocked and went away.
            with suppress(OSError):
                self._waiting.append(Caller(self._server.accept()[0]))
        if len(self._waiting) > MOST_WAITING:
            unknown = [one for one in self._waiting if not one.is_sender]
            self._leave((unknown or self._waiting[::-1])[0])

    def _leave(self, caller: Caller) -> None:
        self._waiting.remove(caller)
        caller.connection.close()
