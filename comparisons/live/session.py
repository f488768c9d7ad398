"""One session: from the bytes of a feed to the pieces of a record on disk, shown as they come."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from classic_ml.readers import TestDescription
from classic_ml.records import Dropped, LedgerEntry
from comparisons.live.feeds import Closed, Feed, Opened
from comparisons.live.lines import Lines, RowOrder, Run
from comparisons.live.monitor import Monitor
from comparisons.live.pieces import FEED, Pieces
from comparisons.live.state import Event, LiveState
from surge_core.errors import InputError

__all__ = ["Screen", "Session"]

# The display moves this often, and no wait is longer.
TICK_S = 0.1
# No rows for so long, and the feed is reported as silent.
SILENT_S = 1.0
EVENTS_KEPT = 200


class Screen(Protocol):
    """Something that shows a state."""

    def show(self, state: LiveState) -> None:
        """Show it."""


@dataclass
class Session:
    """Follow a feed until it ends.

    Parameters
    ----------
    test : TestDescription
        The test.
    feed : Feed
        Where the rows come from.
    pieces : Pieces
        Where they are kept.
    monitor : Monitor
        What is known of the machine.
    screens : sequence of Screen
        What shows it.
    tell : callable
        Takes each event.
    timeout_s : float
        How long to wait without a row.
    """

    test: TestDescription
    feed: Feed
    pieces: Pieces
    monitor: Monitor
    screens: Sequence[Screen] = ()
    tell: Callable[[Event], object] = lambda event: None
    timeout_s: float = math.inf

    def __post_init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self.order = RowOrder(self.test.sample_rate_hz, self.refused)
        self.n_connections = self.n_silences = 0
        self._lines: Lines | None = None
        self._welcome = False
        self._why_stopped = ""
        self._heard_s = time.monotonic()
        self._silent = False
        self._shown_s = 0.0
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)

    def stop(self, why: str) -> None:
        """End the session in order, from any thread or a signal handler."""
        self._why_stopped = self._why_stopped or why

    def run(self) -> None:
        """Follow the feed until it ends, is silent for too long, or the session is stopped.

        Raises
        ------
        InputError
            When the first rows cannot be read as those of the test, or there are none.
        """
        if self.test.file.clock != "column":
            raise InputError(
                f"{self.test.source}: [file] clock",
                expected='"column": the rows of a feed are put in order by the clock they bring',
                found=f'"{self.test.file.clock}"',
            )
        self.feed.start()
        self.say("feed", self.feed.waiting)
        try:
            while not self._why_stopped:
                self._step()
            if self._lines is not None:
                self._lines.close()
            self._place(self.order.close())
            self._say_all(self.monitor.update())
        except InputError:
            # The first rows were refused: there is no record.
            self.pieces.discard()
            raise
        finally:
            self.feed.stopped.set()
            self.pieces.close()
            notes = self.monitor.close()
        self._say_all(notes)
        for why, count in sorted(self.refused.items()):
            self.say("feed", f"left out: {count} x {why}")
        self.say("feed", f"ended: {self._why_stopped}")
        self.show("reducing")
        if not self.pieces.pieces:
            left_out = "".join(f", {count} x {why}" for why, count in self.refused.items())
            raise InputError(FEED, expected="rows", found=f"none{left_out}")

    def entry(self) -> LedgerEntry:
        """Return what is to be said of the feed in the ledger of the series."""
        pieces = self.pieces.pieces
        n_rows = sum(piece.n_rows for piece in pieces)
        repeated = self.order.repeated
        dropped = [Dropped("rows", repeated, "had already")] if repeated else []
        dropped += [Dropped("lines", count, why) for why, count in sorted(self.refused.items())]
        return LedgerEntry(
            "live feed",
            f"{n_rows} rows, {len(pieces)} pieces, {self.n_connections} connections",
            {
                "rows": n_rows,
                "pieces": len(pieces),
                "connections": self.n_connections,
                "silences": self.n_silences,
            },
            tuple(dropped),
            tuple(f"piece {piece.number} begins: {piece.why}" for piece in pieces if piece.why),
        )

    def state(self, phase: str) -> LiveState:
        """Return what is known now.

        Parameters
        ----------
        phase : str
            ``"waiting"``, ``"running"``, ``"reducing"`` or ``"done"``.
        """
        monitor, pieces = self.monitor, self.pieces.pieces
        return LiveState(
            test=self.test.name,
            phase=phase,
            feed=self._feed_words(),
            feed_silent=self._silent and not self._why_stopped,
            n_rows=sum(piece.n_rows for piece in pieces),
            n_pieces=len(pieces),
            n_refused=self.refused.total(),
            n_repeated=self.order.repeated,
            point=monitor.point,
            shown=monitor.shown,
            machine=monitor.machine,
            n_cycles=monitor.n_cycles,
            period_s=monitor.period_s,
            estimate=monitor.estimate,
            trail=tuple(monitor.trail),
            events=tuple(self._events),
        )

    def show(self, phase: str) -> None:
        """Show what is known now."""
        state = self.state(phase)
        for screen in self.screens:
            screen.show(state)

    def say(self, kind: str, text: str) -> None:
        """Add to the log.

        Parameters
        ----------
        kind : str
            One word.
        text : str
            One sentence.
        """
        event = Event(datetime.now().strftime("%H:%M:%S"), kind, text)
        self._events.append(event)
        self.tell(event)

    def _step(self) -> None:
        """Work on what has come by now, and update the display when it is time."""
        arrival = self.feed.next(TICK_S)
        if isinstance(arrival, bytes):
            self._take(arrival)
        elif isinstance(arrival, Opened):
            self.n_connections += 1
            self._lines = Lines(self._clock, self.refused)
            self._welcome = False
            if self.n_connections > 1:
                self.say("feed", "connected again")
        elif isinstance(arrival, Closed):
            self._closed(arrival)
        self._say_all(self.monitor.poll())
        self._watch_silence()
        if time.monotonic() - self._shown_s > TICK_S:
            self._say_all(self.monitor.update())
            self._shown_s = time.monotonic()
            self.show("running" if self.pieces.pieces else "waiting")

    @property
    def _clock(self) -> str:
        return self.test.file.time

    def _closed(self, arrival: Closed) -> None:
        if self._lines is not None:
            self._lines.close()
            self._lines = None
        if arrival.for_good:
            self.stop(arrival.why)
        else:
            self.say("feed", f"connection lost: {arrival.why}; {self.feed.waiting}")

    def _take(self, data: bytes) -> None:
        lines = self._lines
        if lines is None:
            return
        rows = lines.take(data)
        if not self._welcome and lines.header and not self._accepted(lines):
            self._lines = None
            self.feed.dropped.set()
            return
        if rows and self._same_units(lines.units):
            self._place(self.order.take(rows))
            # Behind the work on them, which is no silence of the feed.
            self._heard_s = time.monotonic()
        if lines.ended and self._welcome:
            self.stop("the sender says that the run is over")

    def _accepted(self, lines: Lines) -> bool:
        """Return whether a connection begins with the header of this test."""
        head = self.pieces.head
        if not head and self._clock in lines.names:
            self.pieces.head = lines.header + b"\n"
            self.say("feed", f"receiving {len(lines.names)} columns")
        elif not head and not self.feed.comes_back:
            names = ", ".join(lines.names)
            raise InputError(
                FEED,
                expected=f"a table with a header and a column {self._clock}",
                found=f"the columns {names[:200]}",
            )
        elif lines.header + b"\n" != head[: len(lines.header) + 1]:
            self.say("feed", "a connection was refused: it began with another header")
            return False
        self._welcome = True
        return True

    def _same_units(self, units: bytes) -> bool:
        """Take the units that the first connection states; refuse one that states others."""
        if not units or units + b"\n" in self.pieces.head:
            return True
        if self.pieces.pieces:
            self.say("feed", "a connection was refused: it states other units")
            self._lines = None
            self.feed.dropped.set()
            return False
        self.pieces.head += units + b"\n"
        return True

    def _place(self, runs: Sequence[Run]) -> None:
        for run in runs:
            if run.begins:
                if run.why_new:
                    self._say_all(self.monitor.update())
                    self.say("record", f"a new piece of the record begins: {run.why_new}")
                self.pieces.begin(run.why_new)
                self.monitor.head = self.pieces.head
                self.monitor.restart()
            self.pieces.append(run.lines)
            self._say_all(self.monitor.take(run.lines))

    def _say_all(self, notes: Sequence[tuple[str, str]]) -> None:
        for kind, text in notes:
            self.say(kind, text)

    @property
    def _quiet_s(self) -> float:
        return time.monotonic() - self._heard_s

    def _watch_silence(self) -> None:
        silent = bool(self.pieces.pieces) and self._quiet_s > SILENT_S
        if silent and not self._silent:
            self.n_silences += 1
            self.say("feed", f"silent: no data for {self._quiet_s:.1f} s")
        elif self._silent and not silent:
            self.say("feed", "data come again")
        self._silent = silent
        if self._quiet_s > self.timeout_s:
            self.stop(f"no data for {self.timeout_s:g} s")

    def _feed_words(self) -> str:
        if self._why_stopped:
            return f"ended: {self._why_stopped}"
        if self._lines is None:
            return self.feed.waiting
        if not self.pieces.pieces:
            return "connected, no rows yet"
        return f"no data for {self._quiet_s:.1f} s" if self._silent else "receiving"
