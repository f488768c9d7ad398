"""Whoever connects to a running session, its feed stays that of the sender of the test."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live_records import LiveRecord

from comparisons.live import sockets
from comparisons.live.callers import LONGEST_HEAD, MOST_WAITING
from comparisons.live.display import Display
from comparisons.live.ending import reduce_pieces
from comparisons.live.feed import Arrival, Closed, Data, Opened
from comparisons.live.latency import LatencyMeter
from comparisons.live.running_estimate import NoEstimate
from comparisons.live.session import Session
from comparisons.live.session_parts import SessionParts
from comparisons.live.sockets import ListeningFeed
from comparisons.live.state import Event
from comparisons.live.text_lines import TextDecoder

PATIENCE_S = 10.0
SILENT_S = 0.2


def header_or_not(head: bytes) -> bool | None:
    """Take HEAD for the header of this test."""
    return head.startswith(b"HEAD\n") if b"\n" in head else None


@pytest.fixture
def feed(monkeypatch: pytest.MonkeyPatch) -> Iterator[ListeningFeed]:
    monkeypatch.setattr(sockets, "SILENT_S", SILENT_S)
    listening = ListeningFeed.on_address("127.0.0.1", 0)
    listening.accepts = header_or_not
    listening.start()
    yield listening
    listening.close()


def connected(feed: ListeningFeed, sends: bytes = b"") -> socket.socket:
    port = int(feed.waiting.rpartition(":")[2])
    connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    connection.sendall(sends)
    return connection


def received(feed: ListeningFeed, content: bytes) -> list[Arrival]:
    """Return what arrives until so many bytes came, with these joined."""
    got, others = b"", []
    until_s = time.monotonic() + PATIENCE_S
    while len(got) < len(content):
        assert time.monotonic() < until_s, (got, others)
        arrival = feed.next(0.05)
        if isinstance(arrival, Data):
            got += arrival.data
        elif arrival is not None:
            others.append(arrival)
    assert got == content
    return others


def hung_up(connection: socket.socket) -> bool:
    """Tell whether the other end closes the connection, which is waited for."""
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


@pytest.mark.parametrize("sends", [b"", b"GET / HTTP/1.1\r\n\r\n", b"HEA", b"OTHER\n1,2\n"])
def test_a_sender_that_pauses_is_not_lost_to_whoever_connects(
    feed: ListeningFeed, sends: bytes
) -> None:
    with connected(feed, b"HEAD\n1\n") as sender:
        assert received(feed, b"HEAD\n1\n") == [Opened(1)]
        time.sleep(3.0 * SILENT_S)
        stranger = connected(feed, sends)
        time.sleep(2.0 * SILENT_S)
        stranger.close()
        time.sleep(2.0 * SILENT_S)
        sender.sendall(b"2\n")
        assert received(feed, b"2\n") == []


def test_a_second_feed_waits_while_the_first_one_sends_and_loses_nothing(
    feed: ListeningFeed,
) -> None:
    with connected(feed, b"HEAD\n") as sender:
        received(feed, b"HEAD\n")
        second = connected(feed, b"HEAD\n8\n")
        for _ in range(8):
            sender.sendall(b"1\n")
            assert received(feed, b"1\n") == []
            time.sleep(0.4 * SILENT_S)
        second.sendall(b"9\n")
    with second:
        others = received(feed, b"HEAD\n8\n9\n")
    assert others == [Closed("the sender closed it"), Opened(2)]


def test_a_second_feed_takes_over_from_one_that_was_cut_off(feed: ListeningFeed) -> None:
    # The first connection is still there, as it is where a cable was pulled.
    with connected(feed, b"HEAD\n1\n"):
        received(feed, b"HEAD\n1\n")
        with connected(feed, b"HEAD\n2\n"):
            others = received(feed, b"HEAD\n2\n")
    assert others == [Closed("another sender took over"), Opened(2)]


def test_a_connection_that_says_nothing_does_not_keep_the_sender_out(
    feed: ListeningFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sockets, "SILENT_S", 1e9)
    with connected(feed), connected(feed), connected(feed, b"HEAD\n1\n"):
        others = received(feed, b"HEAD\n1\n")
        assert others == [Opened(1), Closed("another sender took over"), Opened(2)]


def test_who_sends_no_header_is_hung_up_on(feed: ListeningFeed) -> None:
    with connected(feed, b"HEAD\n1\n"):
        received(feed, b"HEAD\n1\n")
        with connected(feed, b"OTHER\n") as stranger:
            assert hung_up(stranger)
        with connected(feed, b"x" * (LONGEST_HEAD + 1)) as endless:
            assert hung_up(endless)
        silent = [connected(feed) for _ in range(MOST_WAITING + 1)]
        assert hung_up(silent[0])
        for connection in silent:
            connection.close()


def session_on(record: LiveRecord, folder: Path) -> tuple[Session, list[Event], ListeningFeed]:
    feed, events, meter = ListeningFeed.on_address("127.0.0.1", 0), list[Event](), LatencyMeter(1.0)
    parts = SessionParts(
        record.test,
        feed,
        TextDecoder,
        folder / "spool.csv",
        NoEstimate(),
        Display((), meter),
        meter,
        events.append,
        PATIENCE_S,
    )
    return Session(parts), events, feed


@contextmanager
def running(session: Session) -> Iterator[None]:
    thread = threading.Thread(target=session.run)
    thread.start()
    try:
        yield
    finally:
        thread.join(3.0 * PATIENCE_S)
        assert not thread.is_alive()


def wait_until(there: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not there():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def test_with_strangers_all_along_the_series_is_that_of_the_file(
    record: LiveRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sockets, "SILENT_S", SILENT_S)
    session, events, feed = session_on(record, tmp_path)
    half = len(record.lines) // 2
    spool = tmp_path / "spool.csv"
    first = record.header + b"".join(record.lines[:half])
    with running(session), connected(feed, first) as sender:
        wait_until(lambda: spool.exists() and spool.stat().st_size == len(first))
        time.sleep(2.0 * SILENT_S)
        connected(feed).close()
        names = ",".join(reversed(record.names)).encode()
        with connected(feed, names + b"\n1,2,3\n") as other:
            assert hung_up(other)
        sender.sendall(b"".join(record.lines[half:]) + b"#end\n")
    assert "took over" not in "".join(event.text for event in events)
    (result,) = reduce_pieces(session, record.test_path, tmp_path / "series.csv")
    assert result.series is not None
    assert result.series.read_bytes() == record.series
