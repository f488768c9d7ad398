"""Lines of text over a pipe, TCP and a Unix socket: what is a row, and what follows what."""

from __future__ import annotations

import os
import socket
from collections import Counter
from pathlib import Path

import pytest

from comparisons.live.feeds import Closed, Feed, Opened, listening, piped
from comparisons.live.rows import Lines, RowOrder
from surge_core.errors import InputError

HEAD = b"\xef\xbb\xbftime_s,a,b\r\ns,count,K\r\n"
PATIENCE_S = 60.0


@pytest.mark.parametrize(("separator", "decimal"), [(b",", b"."), (b";", b","), (b"\t", b".")])
def test_rows_are_read_under_any_separator_and_what_is_none_is_counted(
    separator: bytes, decimal: bytes
) -> None:
    rows = [f"{0.001 * i:.3f}@{i}@{-i / 7!r}".encode() for i in range(200)]
    bad = [b"", b"# note", b"1@2", b"1@x@2", b"1_0@1@1", b"nan@1@1", b"1e999@1@1"]
    content = [b"\xef\xbb\xbftime_s@a@b\r", b"s@count@K", *rows[:90], *bad, *rows[90:]]
    written = [line.replace(b".", decimal).replace(b"@", separator) for line in content]
    refused: Counter[str] = Counter()
    lines = Lines("time_s", refused)
    found = lines.take(written) + lines.take([b"#end", b"0.5,1,1"])
    assert [clock for clock, _ in found] == pytest.approx([0.001 * i for i in range(200)])
    assert found[7][1] == rows[7].replace(b".", decimal).replace(b"@", separator)
    assert (lines.names, lines.units) == (
        ["time_s", "a", "b"],
        b"s@count@K".replace(b"@", separator),
    )
    assert lines.ended
    assert refused.total() == 5


def steps(first: int, last: int) -> list[tuple[float, bytes]]:
    return [(0.01 * i, b"%d" % i) for i in range(first, last)]


def order_of(*parts: list[tuple[float, bytes]]) -> tuple[list[tuple[str, int]], int, int]:
    """Return gap and rows of each piece, how many rows were had, and how many fitted nowhere."""
    refused: Counter[str] = Counter()
    order = RowOrder(refused)
    pieces: list[tuple[str, int]] = []
    for gap, lines in [run for part in parts for run in order.take(part)]:
        if gap or not pieces:
            pieces.append((gap, 0))
        pieces[-1] = (pieces[-1][0], pieces[-1][1] + len(lines))
    order.close()
    return pieces, order.repeated, refused.total()


def test_rows_that_follow_one_another_are_one_piece_however_they_come() -> None:
    assert order_of(*([row] for row in steps(0, 500))) == ([("", 500)], 0, 0)
    # As after a connection that was lost: what was had is dropped.
    assert order_of(steps(0, 500), steps(300, 800)) == ([("", 800)], 200, 0)


def test_a_gap_begins_a_piece_and_a_garbled_clock_does_not() -> None:
    garbled = [(77.7, b"?")]
    pieces, _, lost = order_of(steps(0, 100), garbled, steps(100, 200), steps(250, 300))
    assert pieces == [("", 200), ("50 rows are missing before the clock 2.5", 50)]
    assert lost == 1


def arrivals(feed: Feed, until: int) -> tuple[list[bytes], list[type]]:
    """Return all lines, and what else came, until so many connections were closed."""
    lines, kinds = list[bytes](), list[type]()
    while kinds.count(Closed) < until:
        arrival = feed.next(PATIENCE_S)
        assert arrival is not None
        if isinstance(arrival, list):
            lines += arrival
        else:
            kinds.append(type(arrival))
    return lines, kinds


SENT = HEAD + b"0.0,1,2\n" * 20_000


@pytest.mark.parametrize("kind", ["tcp", "unix"])
def test_a_socket_takes_one_sender_after_another(kind: str, tmp_path: Path) -> None:
    feed = listening(("127.0.0.1", 0) if kind == "tcp" else tmp_path / "feed")
    feed.start()
    place = feed.waiting.removeprefix("waiting for a sender at ")
    for _ in range(2):
        if kind == "tcp":
            host, port = place.split(":")
            sender = socket.create_connection((host, int(port)))
        else:
            sender = socket.socket(socket.AF_UNIX)
            sender.connect(place)
        with sender:
            # The last row is cut off: it may lack digits.
            sender.sendall(SENT + b"0.1,1")
    lines, kinds = arrivals(feed, until=2)
    assert b"\n".join([*lines, b""]) == 2 * SENT
    assert kinds == [Opened, Closed, Opened, Closed]


def test_the_last_line_of_a_pipe_needs_no_end_and_its_end_is_for_good() -> None:
    ours, theirs = os.pipe()
    feed = piped(ours)
    feed.start()
    os.write(theirs, HEAD + b"0.0,1,2")
    os.close(theirs)
    came = [feed.next(PATIENCE_S) for _ in range(4)]
    assert came[0] == Opened()
    assert came[2] == [b"0.0,1,2"]
    assert came[3] == Closed("the input ended", for_good=True)
    os.close(ours)


def test_an_address_that_is_taken_is_refused() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    with server, pytest.raises(InputError, match="--listen"):
        listening(server.getsockname()[:2])
