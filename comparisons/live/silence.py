"""How a feed does: receiving, silent, broken, or silent for too long."""

from __future__ import annotations

import time

__all__ = ["Silence"]

# No rows for so long, and the feed is said to be silent.
SILENT_S = 1.0


class Silence:
    """Watch the time since the last row.

    Parameters
    ----------
    waiting : str
        What is waited for without a connection.
    timeout_s : float
        When to give up.

    Attributes
    ----------
    connected : bool
        Whether there is a connection.
    n_connections, n_silences : int
        How many there were.
    silent : bool
        Whether rows have stopped to come over a connection that is still there.
    """

    def __init__(self, waiting: str, timeout_s: float) -> None:
        self._waiting = waiting
        self._timeout_s = timeout_s
        self._heard_s = time.monotonic()
        self._begun = False
        self.connected = False
        self.silent = False
        self.n_connections = 0
        self.n_silences = 0

    @property
    def silent_s(self) -> float:
        """Time since the last row."""
        return time.monotonic() - self._heard_s

    @property
    def stopped(self) -> bool:
        """Whether rows came before, and none come now."""
        return self._begun and (self.silent or not self.connected)

    @property
    def too_long(self) -> str:
        """Why to give up; empty while there is hope."""
        if self.silent_s <= self._timeout_s:
            return ""
        return f"no data for {self._timeout_s:g} s"

    def heard(self) -> None:
        """Take note of rows."""
        self._heard_s = time.monotonic()
        self._begun = True

    def news(self) -> str:
        """Return what is worth telling since it was last asked: that it fell silent, or goes on."""
        was, silent_s = self.silent, self.silent_s
        self.silent = self._begun and self.connected and silent_s > SILENT_S
        if self.silent and not was:
            self.n_silences += 1
            return f"silent: no data for {silent_s:.1f} s"
        if was and silent_s <= SILENT_S:
            return "data come again"
        return ""

    def words(self) -> str:
        """Return how the feed does now."""
        if not self.connected:
            lost = f"connection lost {self.silent_s:.1f} s ago; " if self.n_connections else ""
            return lost + self._waiting
        if not self._begun:
            return "connected, no rows yet"
        if self.silent_s > 0.5 * SILENT_S:
            return f"no data for {self.silent_s:.1f} s"
        return "receiving"
