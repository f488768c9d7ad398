"""What a session says on a terminal: a line an event, and below them a line that moves."""

from __future__ import annotations

import shutil
from contextlib import suppress
from typing import TextIO

from comparisons.live.state import Event, LiveState, status_line

__all__ = ["Terminal"]

CLEAR_LINE = "\r\x1b[K"


class Terminal:
    """Write events and, where the stream is a terminal, the newest state.

    Parameters
    ----------
    stream : text stream
        Where to write.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._moving = stream.isatty()

    def tell(self, event: Event) -> None:
        """Write an event."""
        self._write(f"{event.clock} {_plain(event.text)}\n")

    def show(self, state: LiveState) -> None:
        """Write the state over the one before."""
        if self._moving:
            width = shutil.get_terminal_size().columns - 1
            self._write(_plain(status_line(state))[:width])

    def close(self) -> None:
        """Leave the line."""
        if self._moving:
            self._write("")

    def _write(self, text: str) -> None:
        # A terminal or pipe that is gone ends its display, not the run.
        with suppress(OSError, ValueError):
            self._stream.write((CLEAR_LINE if self._moving else "") + text)
            self._stream.flush()


def _plain(text: str) -> str:
    """Return text without control characters, which a terminal would obey."""
    return "".join(c if c.isprintable() else "?" for c in text)
