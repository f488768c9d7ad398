"""What a session says on a terminal: one screen refreshed in place, or one line an event."""

from __future__ import annotations

import shutil
import threading
from collections import deque
from typing import TextIO

from comparisons.live.state import Event, LiveState, field_rows

__all__ = ["EventLines", "TerminalScreen"]

EVENTS_SHOWN = 6
# Lines that wait for a pipe nobody reads; beyond these the oldest are lost.
LINES_KEPT = 1000
_HIDE, _SHOW, _CLEAR_LINE, _CLEAR_BELOW = "\x1b[?25l", "\x1b[?25h", "\x1b[K", "\x1b[J"


class TerminalScreen:
    """One screen, drawn over itself.

    Parameters
    ----------
    stream : text stream
        A terminal that knows the ANSI sequences.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._n_lines = 0

    def show(self, state: LiveState) -> None:
        """Draw the state over the one before."""
        size = shutil.get_terminal_size()
        lines = [f"{label:>16}  {_plain(value)}" for label, value in field_rows(state)]
        lines += ["", *(f"{e.clock}  {_plain(e.text)}" for e in state.events[-EVENTS_SHOWN:])]
        shown = [line[: size.columns - 1] for line in lines[: max(1, size.lines - 1)]]
        up = f"\x1b[{self._n_lines}A" if self._n_lines else _HIDE
        body = "".join(f"{line}{_CLEAR_LINE}\n" for line in shown)
        self._stream.write(f"\r{up}{body}{_CLEAR_BELOW}")
        self._stream.flush()
        self._n_lines = len(shown)

    def close(self) -> None:
        """Leave the last screen standing and give the cursor back."""
        if self._n_lines:
            self._stream.write(_SHOW)
            self._stream.flush()


class EventLines:
    """One line an event, for a log or a pipe.

    Parameters
    ----------
    stream : text stream
        Where to write.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._waiting: deque[Event] = deque(maxlen=LINES_KEPT)

    def tell(self, event: Event) -> None:
        """Take an event, to be written with the next state.

        Parameters
        ----------
        event : Event
            What happened.
        """
        with self._lock:
            self._waiting.append(event)

    def show(self, state: LiveState) -> None:
        """Write the events that have come."""
        with self._lock:
            events = list(self._waiting)
            self._waiting.clear()
        for event in events:
            self._stream.write(f"{event.clock} {_plain(event.text)}\n")
        if events:
            self._stream.flush()

    def close(self) -> None:
        """Do nothing: what was told has been written."""


def _plain(text: str) -> str:
    """Return text without control characters: names of columns come from outside."""
    return "".join(c if c.isprintable() else "�" for c in text)
