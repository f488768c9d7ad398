"""One session: from the bytes of a feed to the pieces of a record on disk, shown as they come."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import replace
from datetime import datetime

import numpy as np

from comparisons.live.columns import FEED, FeedColumns, described_columns, feed_columns
from comparisons.live.feed import Arrival, Closed, Data, Opened
from comparisons.live.frames import MAGIC
from comparisons.live.monitor import Monitor
from comparisons.live.rate import RateCheck
from comparisons.live.row_order import RowOrder, Stretch
from comparisons.live.rows import Decoder, End, Header, Rows, Tally, Units
from comparisons.live.session_parts import SessionParts
from comparisons.live.silence import Silence
from comparisons.live.spool import RawSpool
from comparisons.live.state import Event, LiveState, latency_words, tau_words
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["Session"]

# Even when the rows come faster than they can be worked on, the display moves this often.
SELDOM_S = 1.0
# Rows are worked on in batches of at most so many bytes, between two looks at signals and clock.
BATCH_BYTES = 262_144
EVENTS_KEPT = 200


class Session:
    """Follow a feed until it ends.

    Parameters
    ----------
    parts : SessionParts
        What it is made of.
    """

    def __init__(self, parts: SessionParts) -> None:
        self._parts = parts
        self.tally = Tally()
        self.order = RowOrder(parts.test.sample_rate_hz, self.tally)
        self.spool: RawSpool | None = None
        self.silence = Silence(parts.feed.waiting, parts.timeout_s)
        self._columns: FeedColumns | None = None
        self._estimator = parts.estimator
        self._monitor: Monitor | None = None
        self._rate: RateCheck | None = None
        self._shift_s: float | None = None
        self._connection_number = 0
        self._decoder: Decoder | None = None
        # Whether the present connection began with the header of this test.
        self._welcome = False
        self._has_units = False
        self._n_remedies_told = 0
        self._stopped = ""
        self._next_update_s = 0.0
        self._last_update_s = 0.0
        self._unshown: list[float] = []
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)

    def stop(self, why: str) -> None:
        """End the session in order, from any thread or a signal handler."""
        self._stopped = self._stopped or why

    def run(self) -> str:
        """Follow the feed until it ends, is silent for too long, or the session is stopped.

        Returns
        -------
        str
            Why it ended.

        Raises
        ------
        InputError
            When the first header does not fit the test, or the first rows its sample rate.
        """
        parts = self._parts
        parts.feed.accepts = self._accepts
        parts.feed.start()
        self.say("feed", parts.feed.waiting)
        try:
            while not self._stopped:
                self._step()
            for stretch in self.order.close():
                self._place(stretch)
            self.show("running")
        finally:
            parts.feed.close()
            if self.spool is not None:
                self.spool.close()
            self._estimator.close()
        self.say("feed", f"ended: {self._stopped}")
        return self._stopped

    def state(self, phase: str) -> LiveState:
        """Return what is known now.

        Parameters
        ----------
        phase : str
            ``"waiting"``, ``"running"``, ``"reducing"`` or ``"done"``.
        """
        pieces = [] if self.spool is None else self.spool.pieces
        state = LiveState(
            test=self._parts.test.name,
            phase=phase,
            feed=f"ended: {self._stopped}" if self._stopped else self.silence.words(),
            latency=self._parts.meter.read(),
            feed_silent=self.silence.stopped and not self._stopped,
            n_rows=sum(piece.n_rows for piece in pieces),
            n_pieces=len(pieces),
            n_refused=self.tally.total,
            n_repeated=self.order.repeated,
            events=tuple(self._events),
        )
        monitor = self._monitor
        if monitor is None:
            return state
        return replace(
            state,
            point=monitor.point,
            shown=monitor.shown,
            machine=monitor.machine,
            n_cycles=monitor.n_cycles,
            period_s=monitor.period_s,
            estimate=monitor.estimate,
            trail=monitor.trail,
        )

    def show(self, phase: str) -> None:
        """Show what is known now.

        Parameters
        ----------
        phase : str
            As in :meth:`state`.
        """
        arrivals, self._unshown = self._unshown, []
        self._parts.display.offer(self.state(phase), arrivals)

    def sum_up(self) -> None:
        """Say how the estimate and the latency were in the end."""
        if self._monitor is not None and self._monitor.estimate is not None:
            self.say("estimate", f"last running estimate of τ: {tau_words(self._monitor.estimate)}")
        self.say("latency", f"latency: {latency_words(self._parts.meter.read())}")

    def discard(self) -> None:
        """Remove the raw record, of which nothing is lost by now."""
        if self.spool is not None:
            self.spool.discard()

    def _step(self) -> None:
        """Work on what has come by now, and update the display when it is time."""
        feed = self._parts.feed
        arrival = feed.next(self._parts.display.interval_s)
        oldest_s, n_bytes, rows = math.inf, 0, []
        while arrival is not None:
            if isinstance(arrival, Data):
                oldest_s = min(oldest_s, arrival.at_s)
                self._unshown.append(arrival.at_s)
                n_bytes += len(arrival.data)
                rows += self._decoded(arrival.data)
            else:
                self._take(rows)
                rows = []
                self._connection(arrival)
            if n_bytes >= BATCH_BYTES or self._stopped:
                break
            arrival = feed.next(0.0)
        self._take(rows)
        self._tell_remedies()
        if self._monitor is not None:
            self._tell(self._monitor.poll())
        self._watch_silence()
        self._update(oldest_s)

    def _connection(self, arrival: Arrival) -> None:
        if isinstance(arrival, Opened):
            self._decoder = self._parts.decoder(self.tally)
            self._connection_number = arrival.number
            self._welcome = False
            self.silence.connected = True
            self.silence.n_connections += 1
            if self.silence.n_connections > 1:
                self.say("feed", "reconnected")
        elif isinstance(arrival, Closed):
            self.silence.connected = False
            if self._decoder is not None:
                self._decoder.close()
                self._decoder = None
            if arrival.for_good:
                self.stop(arrival.why)
            else:
                self.say("feed", f"connection lost: {arrival.why}; {self._parts.feed.waiting}")

    def _decoded(self, data: bytes) -> list[Rows]:
        if self._decoder is None:
            return []
        rows = []
        for item in self._decoder.feed(data):
            if isinstance(item, Header):
                self._header(item)
            elif not self._welcome:
                # Whoever sent another header, or none, has no say in this run.
                continue
            elif isinstance(item, Units):
                self._units(item)
            elif isinstance(item, End):
                self.stop("the sender says that the run is over")
            else:
                rows.append(item)
        return rows

    def _header(self, header: Header) -> None:
        parts = self._parts
        if self._columns is None and self._is_stranger(header):
            frames = " but with a binary frame: use --format binary" * _is_frame(header)
            self._refuse(f"it did not begin with a header of this test{frames}")
        elif self._columns is None and _is_frame(header):
            raise InputError(
                FEED, expected="lines of text", found="binary frames", remedy="use --format binary"
            )
        elif self._columns is None:
            self._columns = feed_columns(header.names, parts.test)
            self._rate = RateCheck(parts.test, self._columns.clock.column)
            self.spool = RawSpool(parts.raw, header.names)
            self.spool.begin()
            self._monitor = Monitor(self._columns, self._estimator)
            self._welcome = True
            self.say("feed", f"receiving {len(header.names)} columns")
        elif header.names != self._columns.names:
            # Its rows would be read as other channels.
            self._refuse("it began with another header than the first one")
        else:
            self._welcome = True

    def _units(self, units: Units) -> None:
        """Heed a line of units as the reader of files does; it stays with the record."""
        if self._columns is None or self.spool is None:
            return
        is_first = not any(piece.n_rows for piece in self.spool.pieces)
        try:
            stated = feed_columns(self._columns.names, self._parts.test, units.labels)
        except InputError:
            if is_first:
                self.discard()
                raise
            stated = None
        if is_first and not self._has_units:
            self._columns, self._has_units = stated or self._columns, True
            self.spool.state_units(units.line)
        elif stated != self._columns:
            self._refuse("it states other units than the first one")

    def _is_stranger(self, header: Header) -> bool:
        """Tell a program that connected by mistake from a sender with a wrong header."""
        known = described_columns(self._parts.test).names
        return self._parts.feed.comes_back and not set(known) & set(header.names)

    def _accepts(self, head: bytes) -> bool | None:
        """Tell whether a connection begins with a header of this test; None while that is open."""
        items = self._parts.decoder(Tally()).feed(head)
        header = next((item for item in items if isinstance(item, Header)), None)
        if header is None:
            return None
        if self._columns is None:
            return not self._is_stranger(header)
        return header.names == self._columns.names

    def _refuse(self, why: str) -> None:
        self.say("feed", f"a connection was refused: {why}")
        self._parts.feed.drop(self._connection_number)
        self._decoder = None
        self._welcome = False

    def _take(self, rows: list[Rows]) -> None:
        if not rows or self._columns is None:
            return
        batch = Rows.joined(rows)
        time_s = self._columns.time_s(batch.values)
        bad = self._columns.impossible(time_s, self._columns.readings(batch.values))
        if bad.any():
            self.tally.refuse("a row with an impossible reading", int(np.sum(bad)))
            batch, time_s = batch.those(~bad), time_s[~bad]
        self.silence.heard()
        self._check_rate(time_s)
        time_s = self._set(time_s)
        for stretch in self.order.take(time_s, batch):
            self._place(stretch)

    def _check_rate(self, time_s: FloatArray) -> None:
        """Refuse the feed where its first rows run at another rate: most would be lost."""
        try:
            if self._rate is not None:
                self._rate.take(time_s)
        except InputError:
            if self.spool is not None:
                self.spool.close()
            self.discard()
            raise

    def _set(self, time_s: FloatArray) -> FloatArray:
        """Return the clock as [file] start_s sets it at the first row, as it does in a file."""
        start_s = self._parts.test.file.start_s
        if start_s is None or not time_s.size:
            return time_s
        if self._shift_s is None:
            self._shift_s = start_s - float(time_s[0])
        return time_s + self._shift_s

    def _place(self, stretch: Stretch) -> None:
        if self.spool is None or self._columns is None or self._monitor is None:
            return
        if stretch.why_new:
            self.say("record", f"a new piece of the record begins: {stretch.why_new}")
            self.spool.begin(stretch.why_new)
            self._monitor.restart()
        time_s, rows = stretch.time_s, stretch.rows
        self.spool.append(rows.lines, len(rows), float(time_s[0]), float(time_s[-1]))
        self._tell(self._monitor.take(time_s, self._columns.readings(rows.values)))

    def _watch_silence(self) -> None:
        news = self.silence.news()
        if news:
            self.say("feed", news)
        if self.silence.too_long:
            self.stop(self.silence.too_long)

    def _update(self, oldest_s: float) -> None:
        now_s = time.monotonic()
        if now_s < self._next_update_s:
            return
        self._next_update_s = now_s + self._parts.display.interval_s
        behind = now_s - oldest_s > self._parts.meter.budget_s
        if behind and now_s - self._last_update_s < SELDOM_S:
            self._parts.meter.skip()
            return
        self._last_update_s = now_s
        self.show("waiting" if self._columns is None else "running")

    def _tell_remedies(self) -> None:
        """Say at once what can be mended: where nothing is as expected, no end may ever come."""
        for why, remedy in list(self.tally.remedies.items())[self._n_remedies_told :]:
            self.say("feed", f"left out: {why}; {remedy}")
        self._n_remedies_told = len(self.tally.remedies)

    def _tell(self, notes: list[tuple[str, str]]) -> None:
        for kind, text in notes:
            self.say(kind, text)

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
        self._parts.tell(event)


def _is_frame(header: Header) -> bool:
    """Tell a line of text from binary frames that were read as one."""
    return header.names[0].startswith(MAGIC.decode())
