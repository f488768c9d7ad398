"""What the reader of a file would refuse, shift or convert, a session does too, and at once."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_records import LiveRecord, play, series_of

from classic_ml.io import read_raw
from comparisons.cli import main
from comparisons.live.columns import feed_columns
from comparisons.live.feed import Arrival, Closed, Data, Opened
from comparisons.live.frames import FrameDecoder, columns_frame, end_frame, rows_frame
from comparisons.live.sockets import CallingFeed, ListeningFeed
from surge_core.errors import InputError

LOST = Closed("lost")


def changed(
    record: LiveRecord, folder: Path, *edits: tuple[str, str], content: bytes | None = None
) -> LiveRecord:
    """Return a record with another description, and perhaps other rows."""
    folder.mkdir()
    text = record.test_path.read_text("utf-8")
    for old, new in edits:
        assert text.count(old) == 1
        text = text.replace(old, new)
    (folder / "test.toml").write_text(text, "utf-8")
    (folder / "raw.csv").write_bytes(record.content if content is None else content)
    return LiveRecord(folder)


def with_header(record: LiveRecord, header: bytes) -> bytes:
    return header + b"".join(record.lines)


IMPOSSIBLE = (
    ("T25_A", 49.9),
    ("T31_A", 3000.5),
    ("T25_A", -1.0),
    ("P25_A_tip_forward", -1.0),
    ("P31_B_hub_aft", 4096.0),
    ("T25_A", np.nan),
    ("T31_A", np.inf),
)


@pytest.mark.parametrize(("name", "value"), IMPOSSIBLE)
def test_a_row_is_left_out_for_what_a_file_would_be_refused_for(
    record: LiveRecord, tmp_path: Path, name: str, value: float
) -> None:
    columns = feed_columns(record.names, record.test)
    values = record.values[:200].copy()
    values[150, record.names.index(name)] = value
    bad = columns.impossible(columns.time_s(values), columns.readings(values))
    assert np.flatnonzero(bad).tolist() == [150]
    rows = "".join(",".join(map(repr, row)) + "\n" for row in values.tolist())
    spoiled = changed(record, tmp_path / "spoiled", content=record.header + rows.encode())
    with pytest.raises(InputError, match=f"channel {name}.*in row 151"):
        read_raw(spoiled.raw, spoiled.test_path)


def test_a_reading_of_10_K_costs_its_row_and_not_the_record(
    record: LiveRecord, tmp_path: Path
) -> None:
    cells = record.lines[-1].strip().split(b",")
    cells[record.names.index("T25_A")] = b"10.0"
    played = play(record, tmp_path, [record.header, *record.lines[:-1], b",".join(cells) + b"\n"])
    played.results()
    whole = record.header + b"".join(record.lines[:-1])
    without = changed(record, tmp_path / "without", content=whole)
    assert played.out.read_bytes() == series_of(without.raw, without.test_path)


def test_a_clock_that_is_too_large_in_seconds_is_impossible(
    record: LiveRecord, tmp_path: Path
) -> None:
    in_years = changed(record, tmp_path / "years", ("[adc]", '[file]\ntime_unit = "year"\n\n[adc]'))
    columns = feed_columns(record.names, in_years.test)
    values = record.values[:3].copy()
    values[1, 0] = 1e305
    bad = columns.impossible(columns.time_s(values), columns.readings(values))
    assert bad.tolist() == [False, True, False]


def test_a_unit_in_the_name_of_the_clock_is_heeded(record: LiveRecord, tmp_path: Path) -> None:
    header = record.header.replace(b"time_s", b"Time [ms]")
    lines = [
        repr(1e3 * time_s).encode() + b"," + line.split(b",", 1)[1]
        for time_s, line in zip(record.values[:, 0].tolist(), record.lines, strict=True)
    ]
    content = header + b"".join(lines)
    edit = ("[adc]", '[file]\ntime = "Time [ms]"\n\n[adc]')
    named = changed(record, tmp_path / "named", edit, content=content)
    played = play(named, tmp_path, [content])
    played.results()
    assert played.session.tally.total == 0
    assert played.out.read_bytes() == named.series


def test_a_clock_that_is_set_is_set_as_in_a_file(record: LiveRecord, tmp_path: Path) -> None:
    shifted = changed(
        record,
        tmp_path / "shifted",
        ("[adc]", "[file]\nstart_s = 100.0\n\n[adc]"),
        ("from_s = 0.0\nto_s = 0.14", "from_s = 100.0\nto_s = 100.14"),
    )
    half = len(record.lines) // 2
    again = record.header + b"".join(record.lines[half - 50 :])
    first = record.header + b"".join(record.lines[:half])
    played = play(shifted, tmp_path, [first, LOST, Opened(), again])
    assert "matched to the near-stall reading" in played.told
    assert "surge: the flow runs backwards from 100." in played.told
    piece = played.results()[0].piece
    assert (piece.from_s, piece.to_s) == pytest.approx((100.0, 103.0))
    assert played.out.read_bytes() == shifted.series


def test_a_unit_in_a_name_that_is_not_that_of_the_test_is_refused_at_the_header(
    record: LiveRecord, tmp_path: Path
) -> None:
    column = "P25_A_tip_forward [psia]"
    edit = (
        "[channels.P25_A_tip_forward]\n",
        f'[channels.P25_A_tip_forward]\ncolumn = "{column}"\n',
    )
    header = record.header.replace(b"P25_A_tip_forward", column.encode())
    other = changed(record, tmp_path / "other", edit, content=with_header(record, header))
    with pytest.raises(InputError, match=r'expected the unit "count", .* found "psia"') as refused:
        play(other, tmp_path, [header, b"".join(record.lines)])
    with pytest.raises(InputError) as of_the_file:
        read_raw(other.raw, other.test_path)
    assert refused.value.found == of_the_file.value.found
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def units_line(record: LiveRecord, clock: str, pressure: str = "counts") -> bytes:
    by_letter = {"t": clock, "P": pressure, "T": "K"}
    return ",".join(by_letter[name[0]] for name in record.names).encode() + b"\n"


def test_a_line_of_units_is_heeded_and_stays_with_the_record(
    record: LiveRecord, tmp_path: Path
) -> None:
    lines = [
        repr(1e3 * time_s).encode() + b"," + line.split(b",", 1)[1]
        for time_s, line in zip(record.values[:, 0].tolist(), record.lines, strict=True)
    ]
    head = record.header + units_line(record, "ms")
    # Five rows are lost, so that a second piece begins with the same two lines.
    content = head + b"".join(lines[:2600])
    stated = changed(record, tmp_path / "stated", content=content)
    again = head + b"".join(lines[2000:2600] + lines[2605:])
    played = play(stated, tmp_path, [head, *lines[:2500], LOST, Opened(2), again])
    assert played.session.tally.total == 0
    first, second = played.results()
    assert first.piece.path.read_bytes() == content
    assert second.piece.path.read_bytes() == head + b"".join(lines[2605:])
    assert played.out.read_bytes() == stated.series


def test_a_line_of_units_that_are_not_those_of_the_test_is_refused(
    record: LiveRecord, tmp_path: Path
) -> None:
    wrong = units_line(record, "s", "psia")
    with pytest.raises(InputError, match=r'expected the unit "count", .* found "psia"'):
        play(record, tmp_path, [record.header, wrong, *record.lines])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("clock", "pressure"), [("ms", "counts"), ("s", "psia")])
def test_a_sender_that_comes_back_with_other_units_is_refused(
    record: LiveRecord, tmp_path: Path, clock: str, pressure: str
) -> None:
    first = record.header + b"".join(record.lines[:1500])
    rest = b"".join(record.lines[1500:])
    other = record.header + units_line(record, clock, pressure) + rest
    played = play(record, tmp_path, [first, LOST, Opened(2), other, LOST, Opened(3), first + rest])
    assert "it states other units than the first one" in played.told
    played.results()
    assert played.out.read_bytes() == record.series


STRANGERS = (
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n#end\n",
    b"#end\n",
    b"time_s,other\n1,2\n#end\n",
)


@pytest.mark.parametrize("sent", STRANGERS)
def test_only_who_sent_the_header_can_end_the_run(
    record: LiveRecord, tmp_path: Path, sent: bytes
) -> None:
    first = record.header + b"".join(record.lines[:1500])
    rest = record.header + b"".join(record.lines[1500:]) + b"#end\n"
    played = play(
        record, tmp_path, [first, LOST, Opened(2), sent, LOST, Opened(3), rest], ends=False
    )
    played.results()
    assert played.out.read_bytes() == record.series


def test_a_frame_that_ends_the_run_is_heeded_behind_its_columns_alone(
    record: LiveRecord, tmp_path: Path
) -> None:
    columns = dict.fromkeys(record.names, "f8")
    starts = range(0, len(record.values), 300)
    frames = [rows_frame(columns, record.values[s : s + 300], 1) for s in starts]
    begin, end = columns_frame(columns), end_frame(0)
    sent = [begin, *frames[:5], LOST, Opened(2), end, LOST, Opened(3), begin, *frames[5:], end]
    played = play(record, tmp_path, sent, decoder=FrameDecoder, ends=False)
    played.results()
    assert played.out.read_bytes() == record.series


class Counted(str):
    """A name that counts how often names are compared."""

    __slots__ = ()
    compared = 0

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


def test_the_work_on_a_header_grows_with_its_length_alone(
    record: LiveRecord, tmp_path: Path
) -> None:
    text = "[adc]", '[file]\nother_columns = "ignore"\n\n[adc]'
    test = changed(record, tmp_path / "wide", text).test
    counts = []
    for n in (500, 1000, 2000):
        names = tuple(map(Counted, (*record.names, *(f"other{i}" for i in range(n)))))
        Counted.compared = 0
        feed_columns(names, test)
        counts.append(Counted.compared)
    assert counts[2] - counts[1] <= 3 * (counts[1] - counts[0]) + 1000


def arrival(feed: ListeningFeed | CallingFeed, kind: type) -> Arrival:
    """Return the next arrival of a kind."""
    for _ in range(100):
        found = feed.next(0.1)
        if isinstance(found, kind):
            return found
        assert found is None, found
    raise AssertionError(kind)


@contextmanager
def started(feed: ListeningFeed | CallingFeed) -> Iterator[int]:
    feed.start()
    try:
        yield int(feed.waiting.rpartition(":")[2])
    finally:
        feed.close()


def test_a_refusal_that_comes_late_does_not_cut_off_who_came_next() -> None:
    feed = ListeningFeed.on_address("127.0.0.1", 0)
    with started(feed) as port:
        with socket.create_connection(("127.0.0.1", port)):
            stranger = arrival(feed, Opened)
        arrival(feed, Closed)
        with socket.create_connection(("127.0.0.1", port)) as sender:
            own = arrival(feed, Opened)
            assert isinstance(stranger, Opened)
            assert isinstance(own, Opened)
            feed.drop(stranger.number)
            for content in (b"one", b"two"):
                sender.sendall(content)
                data = arrival(feed, Data)
                assert isinstance(data, Data)
                assert data.data == content
            feed.drop(own.number)
            closed = arrival(feed, Closed)
            assert isinstance(closed, Closed)
            assert closed.why == "it was refused"


def test_a_call_is_dropped_by_its_number() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        feed = CallingFeed("127.0.0.1", server.getsockname()[1])
        with started(feed):
            server.accept()[0].close()
            first = arrival(feed, Opened)
            arrival(feed, Closed)
            with server.accept()[0] as connection:
                second = arrival(feed, Opened)
                assert isinstance(first, Opened)
                assert isinstance(second, Opened)
                feed.drop(first.number)
                connection.sendall(b"rows")
                data = arrival(feed, Data)
                assert isinstance(data, Data)
                feed.drop(second.number)
                arrival(feed, Closed)


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets here")
def test_nothing_is_left_behind_where_the_port_of_the_page_is_taken(
    record: LiveRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "feed.sock"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        options = ["--unix", str(path), "--page", port, "--no-estimate", "--quiet"]
        options += ["--test", str(record.test_path), "-o", str(tmp_path / "series.csv")]
        assert main(["live", *options]) == 2
    assert "--page: expected a port" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
