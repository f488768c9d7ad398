"""Whatever happens to the feed, the series is that of a file with the same rows."""

from __future__ import annotations

import errno
import json
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from live_records import LiveRecord, cut, play, series_of

from comparisons.live.feed import Closed, Opened
from comparisons.live.frames import FrameDecoder, columns_frame, end_frame, rows_frame
from comparisons.live.state import LiveState
from surge_core.errors import InputError

LOST = Closed("lost")


@pytest.mark.parametrize("seed", range(3))
def test_cut_anywhere_it_is_that_of_the_file(record: LiveRecord, tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    played = play(record, tmp_path, cut(record.content, rng))
    assert (tmp_path / "spool.csv").read_bytes() == record.content
    result = played.results()[0]
    assert result.series == played.out
    assert played.out.read_bytes() == record.series
    assert played.session.tally.total == 0


def test_from_binary_frames_it_is_that_of_the_file(record: LiveRecord, tmp_path: Path) -> None:
    whole = (record.values == np.round(record.values)).all(axis=0)
    columns = {n: "i2" if w else "f8" for n, w in zip(record.names, whole, strict=True)}
    starts = range(0, len(record.values), 40)
    parts = [columns_frame(columns)]
    parts += [rows_frame(columns, record.values[s : s + 40], i + 1) for i, s in enumerate(starts)]
    content = b"".join([*parts, end_frame(len(starts) + 1)])
    pieces = cut(content, np.random.default_rng(1))
    played = play(record, tmp_path, pieces, decoder=FrameDecoder, ends=False)
    assert "the run is over" in played.told
    played.results()
    assert played.out.read_bytes() == record.series


def _frames(columns: dict[str, str], values: np.ndarray, n_rows: int = 300) -> list[bytes]:
    starts = range(0, len(values), n_rows)
    return [rows_frame(columns, values[s : s + n_rows], i + 1) for i, s in enumerate(starts)]


def test_a_damaged_frame_that_is_sent_again_after_a_reconnect_is_not_missed(
    record: LiveRecord, tmp_path: Path
) -> None:
    columns = dict.fromkeys(record.names, "f8")
    v = record.values
    first = [columns_frame(columns), *_frames(columns, v[:1500])]
    spoiled = bytearray(rows_frame(columns, v[1500:1600], len(first)))
    spoiled[500] ^= 1
    again = [columns_frame(columns), *_frames(columns, v[1400:])]
    arrivals = [*first, bytes(spoiled), LOST, Opened(), *again]
    played = play(record, tmp_path, arrivals, decoder=FrameDecoder)
    played.results()
    assert played.out.read_bytes() == record.series
    assert played.session.order.repeated == 100
    assert played.session.tally.refused["damaged bytes between two frames"] == 1


def test_a_connection_lost_in_the_middle_of_a_line_goes_on_with_the_rows_by_their_clock(
    record: LiveRecord, tmp_path: Path
) -> None:
    lines = record.lines
    first = record.header + b"".join(lines[:1200]) + lines[1200][:31]
    second = record.header + b"".join(lines[1100:])
    played = play(record, tmp_path, [first, LOST, 0.05, Opened(), second])
    results = played.results()
    assert played.out.read_bytes() == record.series
    ledger = json.loads(played.out.with_suffix(".ledger.json").read_text("utf-8"))
    entry = next(e for e in ledger if e["step"] == "live feed")
    assert {"what": "rows", "count": 100, "why": "had already"} in entry["dropped"]
    assert entry["parameters"]["connections"] == 2
    assert len(results) == 1
    assert "reconnected" in played.told


def test_a_silent_feed_is_told_and_waited_for(record: LiveRecord, tmp_path: Path) -> None:
    half = len(record.content) // 2
    shown: list[LiveState] = []
    played = play(
        record,
        tmp_path,
        [record.content[:half], 1.4, record.content[half:]],
        screens=[_Screen(shown)],
    )
    played.results()
    assert played.out.read_bytes() == record.series
    assert "silent: no data for 1." in played.told
    assert "data come again" in played.told
    words = [s.feed for s in shown if s.feed_silent]
    assert words
    assert all("no data for" in w for w in words)
    ledger = json.loads(played.out.with_suffix(".ledger.json").read_text("utf-8"))
    assert next(e for e in ledger if e["step"] == "live feed")["parameters"]["silences"] == 1


def test_garbage_between_the_lines_changes_nothing(record: LiveRecord, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    lines = list(record.lines)
    for place in rng.integers(1, len(lines), 20):
        lines.insert(int(place), rng.bytes(60).replace(b"\n", b"?") + b"\n")
    wrong_code = record.lines[900].replace(b",", b",99999,", 1).rsplit(b",", 1)[0] + b"\n"
    lines.insert(1000, wrong_code)
    played = play(record, tmp_path, cut(record.header + b"".join(lines), rng))
    played.results()
    assert played.out.read_bytes() == record.series
    assert played.session.tally.total >= 21
    assert played.session.tally.refused["a row with an impossible reading"] == 1


def test_lost_rows_cut_the_record_and_each_piece_is_reduced_by_itself(
    record: LiveRecord, tmp_path: Path
) -> None:
    lines = record.lines
    content = record.header + b"".join(lines[:2600]) + b"".join(lines[2605:])
    played = play(record, tmp_path, cut(content, np.random.default_rng(2)))
    results = played.results()
    assert [r.piece.n_rows for r in results] == [2600, len(lines) - 2605]
    assert "5e-03 s are missing" in played.told or "0.005 s are missing" in played.told
    # The first piece is what a file with its rows gives; the second is too short.
    alone = tmp_path / "alone.csv"
    alone.write_bytes(record.header + b"".join(lines[:2600]))
    assert played.out.read_bytes() == series_of(alone, record.test_path)
    assert results[1].series is None
    assert "near_stall" not in str(results[1].error)
    assert results[1].piece.path == tmp_path / "spool-piece2.csv"
    assert results[1].piece.path.read_bytes() == record.header + b"".join(lines[2605:])


def test_the_longest_piece_that_can_be_reduced_has_the_plain_name(
    record: LiveRecord, tmp_path: Path
) -> None:
    # A clock that ran from 100 s on before it was set right: the second piece is the whole record.
    early = [
        f"{100 + 0.001 * i:.3f}".encode() + b"," + record.lines[i].split(b",", 1)[1]
        for i in range(150)
    ]
    played = play(record, tmp_path, [record.header + b"".join(early), b"".join(record.lines)])
    results = played.results()
    assert [r.series for r in results] == [None, played.out]
    assert played.out.read_bytes() == record.series
    assert "set back from 100.1490 to 0.0000 s" in played.told


def test_too_few_rows_are_refused_and_kept(record: LiveRecord, tmp_path: Path) -> None:
    content = record.header + b"".join(record.lines[:60])
    played = play(record, tmp_path, [content])
    with pytest.raises(InputError, match="at least 100 rows") as refused:
        played.results()
    assert str(tmp_path / "spool.csv") in str(refused.value)
    assert (tmp_path / "spool.csv").read_bytes() == content


@pytest.mark.parametrize("sent", [[], [b"time_s,P25"], [b"#end\n"]])
def test_nothing_received_is_said(record: LiveRecord, tmp_path: Path, sent: list[bytes]) -> None:
    played = play(record, tmp_path, sent)
    with pytest.raises(InputError, match="the feed: expected rows, found none"):
        played.results()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (b"time_s,P25_A_tip_forward\n", "no such column"),
        (b"extra,", "a table \\[channels.extra\\]"),
        (b"time_s,", "channel time_s: expected each column once"),
    ],
)
def test_a_header_that_does_not_fit_the_test_is_refused(
    record: LiveRecord, tmp_path: Path, header: bytes, said: str
) -> None:
    sent = header if header.endswith(b"\n") else header + record.header
    with pytest.raises(InputError, match=said):
        play(record, tmp_path, [sent + record.lines[0]])
    assert list(tmp_path.iterdir()) == []


def test_columns_in_another_order_are_the_same_channels(record: LiveRecord, tmp_path: Path) -> None:
    turned = [
        b",".join(reversed(line.strip().split(b","))) + b"\n"
        for line in [record.header, *record.lines]
    ]
    played = play(record, tmp_path, turned)
    played.results()
    assert played.out.read_bytes() == record.series


def test_a_reconnect_with_another_header_is_refused_and_the_next_one_is_taken(
    record: LiveRecord, tmp_path: Path
) -> None:
    lines = record.lines
    first = record.header + b"".join(lines[:1500])
    # Two channels have changed places: taken by position, their rows would be read as the other's.
    names = list(record.names)
    names[1], names[2] = names[2], names[1]
    other = ",".join(names).encode() + b"\n" + b"".join(lines[1500:])
    good = record.header + b"".join(lines[1500:])
    played = play(record, tmp_path, [first, LOST, Opened(), other, LOST, Opened(), good])
    played.results()
    assert played.out.read_bytes() == record.series
    assert "a connection was refused" in played.told


def test_a_program_that_connects_by_mistake_does_not_end_the_session(
    record: LiveRecord, tmp_path: Path
) -> None:
    request = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    played = play(record, tmp_path, [request, record.content, LOST, Opened(), record.content])
    played.results()
    assert played.out.read_bytes() == record.series
    assert "it did not begin with a header of this test" in played.told


def test_a_feed_of_the_other_format_is_told_while_it_runs(
    record: LiveRecord, tmp_path: Path
) -> None:
    # Over a socket nothing ends here: whoever waits for rows must hear why there are none.
    played = play(record, tmp_path, [record.content], decoder=FrameDecoder)
    assert "left out: bytes that are no frame; they are text" in played.told
    frames = [columns_frame(dict.fromkeys(record.names, "f8")), b"\n"]
    told = play(record, tmp_path, [*frames, LOST, Opened(2), record.content]).told
    assert "a connection was refused" in told
    assert "use --format binary" in told


def test_silence_ends_the_session_after_the_timeout(record: LiveRecord, tmp_path: Path) -> None:
    played = play(record, tmp_path, [record.content, 60.0], timeout_s=0.5)
    assert "ended: no data for 0.5 s" in played.told
    played.results()
    assert played.out.read_bytes() == record.series


def test_a_record_that_exists_is_not_written_over(record: LiveRecord, tmp_path: Path) -> None:
    kept = tmp_path / "spool.csv"
    kept.write_text("a session that was cut off", "utf-8")
    with pytest.raises(InputError, match="found one that exists"):
        play(record, tmp_path, [record.content])
    assert kept.read_text("utf-8") == "a session that was cut off"


class _Screen:
    """Keep what is shown; take a while for it, if wanted."""

    def __init__(self, shown: list[LiveState], takes_s: float = 0.0) -> None:
        self.shown = shown
        self.takes_s = takes_s

    def show(self, state: LiveState) -> None:
        time.sleep(self.takes_s)
        self.shown.append(state)

    def close(self) -> None:
        return


def test_a_slow_screen_costs_updates_and_no_rows(record: LiveRecord, tmp_path: Path) -> None:
    shown: list[LiveState] = []
    pieces = cut(record.content, np.random.default_rng(4), mean=4000.0)
    paced = [item for piece in pieces for item in (piece, 0.02)]
    played = play(record, tmp_path, paced, screens=[_Screen(shown, 0.3)], budget_s=0.05)
    latency = played.meter.read()
    assert latency.skipped > 0
    assert latency.longest_s >= 0.3
    assert len(shown) < len(pieces)
    assert (tmp_path / "spool.csv").read_bytes() == record.content
    played.results()
    assert played.out.read_bytes() == record.series


def test_a_screen_that_fails_is_dropped_and_the_session_goes_on(
    record: LiveRecord, tmp_path: Path
) -> None:
    class Gone(_Screen):
        def show(self, state: LiveState) -> None:
            raise BrokenPipeError

    shown: list[LiveState] = []
    play(record, tmp_path, [record.content, 0.1], screens=[Gone([]), _Screen(shown)])
    assert shown
    assert (tmp_path / "spool.csv").read_bytes() == record.content


def test_every_frame_is_shown_within_the_budget_at_twenty_times_the_pace(
    record: LiveRecord, tmp_path: Path
) -> None:
    shown: list[LiveState] = []
    lines = record.lines
    # 10 ms of record every half a millisecond: the pace of the pieces, not of the clock, is 20.
    pieces = [record.header] + [b"".join(lines[i : i + 10]) for i in range(0, len(lines), 10)]
    paced = [item for piece in pieces for item in (piece, 5e-4)]
    played = play(record, tmp_path, paced, screens=[_Screen(shown)], budget_s=1.0)
    latency = played.meter.read()
    assert latency.frames == len(pieces)
    # Generous for a busy machine: the median is some 60 ms on an idle one.
    assert latency.median_s < 1.0
    assert shown[-1].n_rows == len(lines)


def test_a_session_can_be_stopped_from_elsewhere(record: LiveRecord, tmp_path: Path) -> None:
    half = record.header + b"".join(record.lines[:2500])
    played = play(
        record,
        tmp_path,
        [half, 60.0],
        begun=lambda session: threading.Timer(0.5, session.stop, ["SIGTERM"]).start(),
    )
    assert "ended: SIGTERM" in played.told
    assert (tmp_path / "spool.csv").read_bytes() == half
    assert played.results()[0].piece.n_rows == 2500


def test_a_full_disk_is_said_and_leaves_what_was_written(
    record: LiveRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    written = []

    def write(handle: int, data: bytes) -> int:
        if sum(written) + len(data) > 60_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(real(handle, data))
        return written[-1]

    monkeypatch.setattr("comparisons.live.spool.os.write", write)
    pieces = cut(record.content, np.random.default_rng(6), 9000.0)
    paced = [item for piece in pieces for item in (piece, 0.01)]
    with pytest.raises(InputError, match="room for the raw record, found No space left"):
        play(record, tmp_path, paced)
    kept = (tmp_path / "spool.csv").read_bytes()
    assert record.content.startswith(kept)
    assert kept.endswith(b"\n")
