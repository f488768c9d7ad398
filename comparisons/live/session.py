"""One session: from the lines of a feed to the pieces of a record on disk, shown as they come."""

from __future__ import annotations

import math
import signal
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from classic_ml.io import TestDescription
from classic_ml.records import Dropped, LedgerEntry
from comparisons.live.feeds import Closed, Feed, Opened
from comparisons.live.monitor import FEED, Monitor
from comparisons.live.pieces import Pieces
from comparisons.live.rows import Lines, RowOrder
from comparisons.live.screens import Page, Terminal, live_document
from surge_core.errors import InputError

# The display moves this often, and no wait is longer.
TICK_S = 0.1
# No rows for so long, and the feed is shown as silent.
SILENT_S = 1.0
EVENTS_KEPT = 200


@dataclass
class Session:
    """Follow a feed until it ends.

    ``pieces`` keep the rows, ``monitor`` knows the machine, ``screens`` show it; ``timeout_s`` is
    how long to wait without a row.
    """

    test: TestDescription
    feed: Feed
    pieces: Pieces
    monitor: Monitor
    screens: Sequence[Terminal | Page] = ()
    timeout_s: float = math.inf

    def __post_init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self.order = RowOrder(self.refused)
        self._n_connections = 0
        # Those of the present connection.
        self._lines: Lines | None = None
        self._why_stopped = ""
        self._heard_s = time.monotonic()
        self._shown_s = 0.0
        self._events: deque[str] = deque(maxlen=EVENTS_KEPT)

    def stop(self, why: str | int) -> None:
        """End the session in order: why in words, or by the number of a signal."""
        words = why if isinstance(why, str) else signal.Signals(why).name
        self._why_stopped = self._why_stopped or words

    def run(self) -> None:
        """Follow the feed until it ends, is silent for too long, or the session is stopped.

        First rows that cannot be read as those of the test are refused; so is a feed without any.
        """
        if self.test.file.clock != "column":
            raise InputError(
                f"{self.test.source}: [file] clock",
                expected='"column": the rows of a feed are put in order by the clock they bring',
                found=f'"{self.test.file.clock}"',
            )
        self.feed.start()
        self.say(self.feed.waiting)
        try:
            while not self._why_stopped:
                self._step()
            self.order.close()
            self.say(*self.monitor.update())
        except InputError:
            # The first rows were refused: there is no record.
            self.pieces.discard()
            raise
        finally:
            notes = self.monitor.close()
        left_out = [f"{count} x {why}" for why, count in sorted(self.refused.items())]
        self.say(*notes, *(f"left out: {words}" for words in left_out))
        self.say(f"ended: {self._why_stopped}")
        self.show("reducing")
        if not self.pieces.pieces:
            raise InputError(FEED, expected="rows", found=", ".join(["none", *left_out]))

    def entry(self) -> LedgerEntry:
        """Return what is to be said of the feed in the ledger of the series."""
        pieces = self.pieces.pieces
        counts = {"rows": self.pieces.n_rows, "pieces": len(pieces)}
        counts["connections"] = self._n_connections
        dropped = [Dropped("lines", count, why) for why, count in sorted(self.refused.items())]
        if self.order.repeated:
            dropped.insert(0, Dropped("rows", self.order.repeated, "had already"))
        return LedgerEntry(
            "live feed",
            ", ".join(f"{count} {name}" for name, count in counts.items()),
            counts,
            tuple(dropped),
            tuple(f"piece {piece.number} begins: {piece.gap}" for piece in pieces if piece.gap),
        )

    def show(self, phase: str) -> None:
        """Show what is known now, with the phase ("waiting", "running", "reducing" or "done")."""
        record = f"{self.pieces.n_rows} rows"
        if len(self.pieces.pieces) > 1:
            record += f", in {len(self.pieces.pieces)} pieces"
        if self.refused.total() + self.order.repeated:
            record += f", {self.refused.total() + self.order.repeated} lines left out"
        document = live_document(
            self.monitor,
            test=self.test.name,
            phase=phase,
            feed=self._feed_words(),
            record=record,
            events=self._events,
        )
        for screen in self.screens:
            screen.show(document)

    def say(self, *texts: str) -> None:
        """Add sentences to the log, with the time of day."""
        for text in texts:
            event = f"{datetime.now():%H:%M:%S} {text}"
            self._events.append(event)
            for screen in self.screens:
                screen.say(event)

    def _step(self) -> None:
        """Work on what has come by now, and update the display when it is time."""
        arrival = self.feed.next(TICK_S)
        if isinstance(arrival, Opened):
            self._n_connections += 1
            self._lines = Lines(self.test.file.time, self.refused)
        elif isinstance(arrival, Closed):
            self._lines = None
            if arrival.for_good:
                self.stop(arrival.why)
            else:
                self.say(f"connection lost: {arrival.why}; {self.feed.waiting}")
        elif arrival is not None and self._lines is not None:
            self._take(self._lines, arrival)
        self.say(*self.monitor.poll())
        if self._quiet_s > self.timeout_s:
            self.stop(f"no data for {self.timeout_s:g} s")
        if time.monotonic() - self._shown_s > TICK_S:
            self.say(*self.monitor.update())
            self._shown_s = time.monotonic()
            self.show("running" if self.pieces.pieces else "waiting")

    def _take(self, lines: Lines, arrived: list[bytes]) -> None:
        rows = lines.take(arrived)
        if lines.header and not self._is_accepted(lines):
            self._lines = None
            self.feed.refuse()
            return
        for gap, kept in self.order.take(rows):
            if gap or not self.pieces.pieces:
                self.say(*self.monitor.update())
                if gap:
                    self.say(f"a new piece of the record begins: {gap}")
                self.pieces.begin(gap)
                self.monitor.head = self.pieces.head
                self.monitor.restart()
            self.pieces.append(kept)
            self.say(*self.monitor.take(kept))
        if rows:
            # Behind the work on them, which is no silence of the feed.
            self._heard_s = time.monotonic()
        if lines.ended:
            self.stop("the sender says that the run is over")

    def _is_accepted(self, lines: Lines) -> bool:
        """Take the header of the first connection, and refuse one that begins with another."""
        head = b"\n".join(filter(None, [lines.header, lines.units])) + b"\n"
        if self.pieces.pieces:
            if self.pieces.head.startswith(head):
                return True
        elif self.test.file.time in lines.names:
            if not self.pieces.head:
                self.say(f"receiving {len(lines.names)} columns")
            self.pieces.head = head
            return True
        elif not self.feed.comes_back:
            raise InputError(
                FEED,
                expected=f"a table with a header and a column {self.test.file.time}",
                found=f"the columns {', '.join(lines.names)[:200]}",
            )
        self.say("a connection was refused: it began with another header")
        return False

    @property
    def _quiet_s(self) -> float:
        return time.monotonic() - self._heard_s

    def _feed_words(self) -> str:
        if self._why_stopped:
            return f"ended: {self._why_stopped}"
        if self._lines is None:
            return self.feed.waiting
        silent = self._quiet_s > SILENT_S
        return f"no data for {self._quiet_s:.0f} s" if silent else "receiving"
