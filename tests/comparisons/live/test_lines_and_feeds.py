"""Lines of text over a pipe, TCP and a Unix socket: what is a row, and what follows what."""

from __future__ import annotations

import os
import socket
from collections import Counter
from pathlib import Path

import pytest
from live_records import cut

from comparisons.live.feeds import Closed, Feed, Opened, calling, listening, parse_address, piped
from comparisons.live.lines import LONGEST_LINE, Lines, RowOrder
from surge_core.errors import InputError

HEAD = b"\xef\xbb\xbftime_s,a,b\r\ns,count,K\r\n"
PATIENCE_S = 60.0


def test_rows_are_the_same_however_the_bytes_are_cut() -> None:
    rows = [f"{0.001 * i:.3f},{i},{-i / 7!r}\r\n".encode() for i in range(200)]
    bad = [b"\n", b"# note\n", b"1,2\n", b"1,x,2\n", b"1_0,1,1\n", b"nan,1,1\n", b"1e999,1,1\n"]
    content = HEAD + b"".join(rows[:90] + bad + rows[90:]) + b"#end\n0.5,1,1\n"
    for seed, mean in ((0, 3), (1, 40), (2, 100_000)):
        refused: Counter[str] = Counter()
        lines = Lines("time_s", refused)
        found = [row for data in cut(content, seed, mean) for row in lines.take(data)]
        assert [line for _, line in found] == [row.strip() for row in rows]
        assert [clock for clock, _ in found] == pytest.approx([0.001 * i for i in range(200)])
        assert (lines.names, lines.units) == (["time_s", "a", "b"], b"s,count,K")
        assert lines.ended
        assert refused.total() == 5


def test_a_line_without_an_end_takes_no_memory() -> None:
    lines = Lines("time_s", Counter())
    lines.take(HEAD)
    for _ in range(50):
        assert lines.take(b"1" * LONGEST_LINE) == []
    assert len(lines._rest) <= LONGEST_LINE


def rows_at(*clocks: float) -> list[tuple[float, bytes]]:
    return [(clock, b"%r" % clock) for clock in clocks]


def steps(first: int, last: int) -> list[tuple[float, bytes]]:
    return rows_at(*(0.01 * i for i in range(first, last)))


def order_of(*parts: list[tuple[float, bytes]]) -> tuple[list[tuple[str, int]], RowOrder, int]:
    """Return why each piece begins and its rows, and how many rows fitted nowhere."""
    refused: Counter[str] = Counter()
    order = RowOrder(100.0, refused)
    pieces: list[tuple[str, int]] = []
    for run in [run for part in parts for run in order.take(part)] + order.close():
        if run.begins:
            pieces.append((run.why_new, 0))
        pieces[-1] = (pieces[-1][0], pieces[-1][1] + len(run.lines))
    return pieces, order, refused.total()


def test_rows_that_follow_one_another_are_one_piece_however_few() -> None:
    for n in (1, 5, 16, 17, 500):
        pieces, order, lost = order_of(*([row] for row in steps(0, n)))
        assert (pieces, order.repeated, lost) == ([("", n)], 0, 0)


def test_a_gap_begins_a_piece_and_a_garbled_clock_does_not() -> None:
    pieces, _, lost = order_of(steps(0, 100), rows_at(77.7), steps(100, 200), steps(250, 300))
    assert pieces == [("", 200), ("50 rows are missing before the clock 2.5", 50)]
    assert lost == 1


def test_repeats_are_dropped_and_a_clock_that_stays_back_begins_a_piece() -> None:
    pieces, order, lost = order_of(steps(0, 500), steps(300, 800))
    assert (pieces, order.repeated, lost) == ([("", 800)], 200, 0)
    pieces, _, _ = order_of(steps(100, 500), steps(0, 300))
    assert pieces[1] == ("the clock was set back from 4.99 to 0", 300)
    pieces, _, _ = order_of(steps(0, 3000), steps(500, 2500))
    assert pieces[1] == ("the clock was set back from 29.99 to 5", 2000)


def arrivals(feed: Feed, until: int) -> tuple[bytes, list[type]]:
    """Return all bytes, and what else came, until so many connections were closed."""
    data, kinds = b"", list[type]()
    while kinds.count(Closed) < until:
        arrival = feed.next(PATIENCE_S)
        assert arrival is not None
        if isinstance(arrival, bytes):
            data += arrival
        else:
            kinds.append(type(arrival))
    feed.stopped.set()
    return data, kinds


SENT = HEAD + b"0.0,1,2\n" * 20_000


@pytest.mark.parametrize("kind", ["tcp", "unix"])
def test_a_socket_takes_one_sender_after_another(kind: str, tmp_path: Path) -> None:
    feed = listening(("127.0.0.1", 0) if kind == "tcp" else tmp_path / "feed")
    feed.start()
    place = feed.waiting.removeprefix("waiting for a sender at ")
    for _ in range(2):
        if kind == "tcp":
            sender = socket.create_connection(parse_address(place))
        else:
            sender = socket.socket(socket.AF_UNIX)
            sender.connect(place)
        with sender:
            sender.sendall(SENT)
    data, kinds = arrivals(feed, until=2)
    assert data == 2 * SENT
    assert kinds == [Opened, Closed, Opened, Closed]


def test_a_server_that_sends_is_called() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        feed = calling(*server.getsockname()[:2])
        feed.start()
        connection, _ = server.accept()
        with connection:
            connection.sendall(SENT)
        assert arrivals(feed, until=1) == (SENT, [Opened, Closed])


def test_the_end_of_a_pipe_is_for_good() -> None:
    ours, theirs = os.pipe()
    feed = piped(ours)
    feed.start()
    os.write(theirs, HEAD)
    os.close(theirs)
    assert isinstance(feed.next(PATIENCE_S), Opened)
    assert feed.next(PATIENCE_S) == HEAD
    assert feed.next(PATIENCE_S) == Closed("the input ended", for_good=True)
    os.close(ours)


def test_an_address_that_is_taken_is_refused() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    with server, pytest.raises(InputError, match="--listen"):
        listening(server.getsockname()[:2])
    assert parse_address("[::1]:80") == ("::1", 80)
    assert parse_address("7000") == ("127.0.0.1", 7000)
    with pytest.raises(ValueError, match="1:70000"):
        parse_address("1:70000")
