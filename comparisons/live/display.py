"""Screens, and the thread that draws them: nothing that is slow to show holds up the rows."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Protocol

from comparisons.live.latency import FRAMES, LatencyMeter
from comparisons.live.state import LiveState

__all__ = ["Display", "Screen"]

# No display is refreshed more often: nobody reads faster, and drawing costs time.
SHORTEST_S = 0.1


class Screen(Protocol):
    """Something that shows a state."""

    def show(self, state: LiveState) -> None:
        """Show it, and return when it is shown."""

    def close(self) -> None:
        """Leave the screen as it should stay."""


class Display:
    """Hand states to the screens in a thread of its own.

    A state that comes while the screens are still busy with the one before waits; one that waits
    is replaced by a newer one, and that update counts as skipped.

    Parameters
    ----------
    screens : sequence of Screen
        All of them show each state.
    meter : LatencyMeter
        Where latencies and skipped updates are counted.
    """

    def __init__(self, screens: Sequence[Screen], meter: LatencyMeter) -> None:
        self._screens = list(screens)
        self._meter = meter
        self._changed = threading.Condition()
        self._state: LiveState | None = None
        self._arrivals: deque[float] = deque(maxlen=FRAMES)
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)
        self._thread.start()

    @property
    def interval_s(self) -> float:
        """Time between two updates: half of the budget, so that a frame that just missed one is
        still shown within it.
        """
        return min(0.5 * self._meter.budget_s, SHORTEST_S)

    def offer(self, state: LiveState, arrivals_s: Iterable[float] = ()) -> None:
        """Show a state as soon as the screens are free.

        Parameters
        ----------
        state : LiveState
            The moment.
        arrivals_s : iterable of float
            When the frames came that are shown for the first time (monotonic clock).
        """
        with self._changed:
            if self._state is not None:
                self._meter.skip()
            self._state = state
            self._arrivals.extend(arrivals_s)
            self._changed.notify()

    def close(self, timeout_s: float = 2.0) -> None:
        """Show the last state and end; a screen that does not answer is left behind.

        Parameters
        ----------
        timeout_s : float
            How long to wait for it.
        """
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._state is not None or self._ended)
                state, self._state = self._state, None
                arrivals = list(self._arrivals)
                self._arrivals.clear()
            if state is None:
                break
            for screen in list(self._screens):
                try:
                    screen.show(state)
                except (OSError, ValueError):
                    # A terminal or pipe that is gone ends its display, not the run.
                    self._screens.remove(screen)
            now_s = time.monotonic()
            self._meter.add(now_s - at_s for at_s in arrivals)
        for screen in self._screens:
            with suppress(OSError, ValueError):
                screen.close()
