"""From the arrival of a frame to the operating point that shows it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

__all__ = ["FRAMES", "Latency", "LatencyMeter"]

# The median is that of the last so many frames: half a minute at 100 frames a second.
FRAMES = 3000


@dataclass(frozen=True)
class Latency:
    """What is known of the latency so far.

    Parameters
    ----------
    budget_s : float
        What it is to stay below.
    median_s : float
        Of the last 3000 frames; NaN before the first.
    longest_s : float
        Of all frames.
    frames : int
        Frames that were shown.
    late : int
        Of these, frames that took longer than the budget.
    skipped : int
        Updates of the display that were left out; never a row.
    """

    budget_s: float
    median_s: float = float("nan")
    longest_s: float = float("nan")
    frames: int = 0
    late: int = 0
    skipped: int = 0


class LatencyMeter:
    """Gather latencies, from any thread.

    Parameters
    ----------
    budget_s : float
        What the latency is to stay below.
    """

    def __init__(self, budget_s: float) -> None:
        self._lock = threading.Lock()
        self._recent: deque[float] = deque(maxlen=FRAMES)
        self._longest_s = float("nan")
        self._frames = self._late = self._skipped = 0
        self.budget_s = budget_s

    def add(self, latencies_s: Iterable[float]) -> None:
        """Add frames that have been shown."""
        with self._lock:
            for latency in latencies_s:
                self._recent.append(latency)
                self._frames += 1
                self._late += latency > self.budget_s
                if not latency <= self._longest_s:
                    self._longest_s = latency

    def skip(self) -> None:
        """Count an update of the display that is left out."""
        with self._lock:
            self._skipped += 1

    def read(self) -> Latency:
        """Return the numbers so far."""
        with self._lock:
            recent = list(self._recent)
            median = float(np.median(recent)) if recent else float("nan")
            return Latency(
                self.budget_s, median, self._longest_s, self._frames, self._late, self._skipped
            )
