"""A session ends with the series that `reduce` makes of the same rows, whatever the feed does."""

from __future__ import annotations

from pathlib import Path

import pytest
from live_records import LiveRecord, changed, cut, play, series_of

from comparisons.live import session as session_module
from comparisons.live.feeds import Closed, Feed, Opened
from comparisons.live.state import LiveState
from surge_core.errors import InputError

LOST = Closed("lost")


@pytest.mark.parametrize(("seed", "mean"), [(1, 37), (2, 5_000), (3, 60_000)])
def test_the_series_at_the_end_is_that_of_reduce(
    record: LiveRecord, tmp_path: Path, seed: int, mean: int
) -> None:
    played = play(record, tmp_path, cut(record.raw.read_bytes(), seed, mean))
    (result,) = played.results()
    assert played.out.read_bytes() == record.series
    assert result.reduction is not None
    entry = result.reduction.series.history[1]
    assert (entry.step, entry.parameters["rows"]) == ("live feed", len(record.lines))
    assert "matched to the near-stall reading" in played.said
    assert "surge: the flow runs backwards from" in played.said
    assert "cycle 5 ended at" in played.said


def test_lines_that_are_no_rows_are_counted_and_rows_that_were_had_are_dropped(
    record: LiveRecord, tmp_path: Path
) -> None:
    lines = record.lines
    again = [*lines[:1500], b"# a comment\r\n", b"buffer overrun\n", *lines[1400:], lines[-1][:20]]
    played = play(record, tmp_path, [b"".join([record.header, *again])])
    (result,) = played.results()
    assert played.out.read_bytes() == record.series
    assert played.session.order.repeated == 100
    assert dict(played.session.refused) == {
        "a line that is no row of numbers": 1,
        "a line cut off by the end of the connection": 1,
    }
    assert result.reduction is not None
    dropped = result.reduction.series.history[1].dropped
    assert {(d.what, d.count) for d in dropped} == {("rows", 100), ("lines", 1)}


def test_a_sender_that_comes_back_goes_on_with_the_record(
    record: LiveRecord, tmp_path: Path
) -> None:
    first = b"".join([record.header, *record.lines[:1000], record.lines[1000][:9]])
    other = b"time_s,other\n1,2\n"
    again = b"".join([record.header, *record.lines[950:], b"#end\n", b"1,2,3\n"])
    arrivals = [first, LOST, Opened(), other, LOST, Opened(), again]
    played = play(record, tmp_path, arrivals)
    played.results()
    assert played.out.read_bytes() == record.series
    assert "connection lost: lost" in played.said
    assert "a connection was refused: it began with another header" in played.said
    assert "ended: the sender says that the run is over" in played.said


def test_each_piece_ends_with_its_series_matched_by_the_reading_before_the_gap(
    record: LiveRecord, tmp_path: Path
) -> None:
    lines = [*record.lines[:2000], record.lines[2000].replace(b",", b",nan", 1)]
    lines += record.lines[2001:]
    played = play(record, tmp_path, [b"".join([record.header, *lines])])
    results = played.results()
    assert [r.piece.n_rows for r in results] == [2000, len(record.lines) - 2001]
    assert "1 row is missing before the clock 2.001" in played.said
    assert [r.piece.matched_by for r in results] == [0, 1]
    for result in results:
        assert result.series is not None
        # What is kept gives the same by `reduce`.
        test = result.piece.test or record.test_path
        assert result.series.read_bytes() == series_of(result.piece.path, test)
    assert played.out in [result.series for result in results]
    entry = results[1].reduction.series.history[1]  # type: ignore[union-attr]
    assert "matched by that of piece 1" in entry.flags[-1]


def test_no_match_is_carried_behind_a_clock_that_was_set_back(
    record: LiveRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # For so long rows that were had are repeats.
    monkeypatch.setattr("comparisons.live.lines.REPEATED_S", 0.5)
    head = b"".join([record.header, *record.lines, *record.lines[300:1000]])
    played = play(record, tmp_path, [head])
    assert "the clock was set back from 3 to 0.3" in played.said
    first, second = played.results()
    assert first.series == played.out
    assert (second.piece.n_rows, second.piece.matched_by) == (700, 0)
    assert second.error is not None


def test_units_below_the_header_are_heeded_as_in_a_file(record: LiveRecord, tmp_path: Path) -> None:
    by_letter = {"t": "ms", "P": "counts", "T": "K"}
    units = ",".join(by_letter[name[0]] for name in record.names).encode() + b"\n"
    lines = [
        repr(1e3 * float(line.split(b",", 1)[0])).encode() + b"," + line.split(b",", 1)[1]
        for line in record.lines
    ]
    played = play(record, tmp_path, [b"".join([record.header, units, *lines])])
    played.results()
    raw = tmp_path / "in ms.csv"
    raw.write_bytes(b"".join([record.header, units, *lines]))
    assert played.out.read_bytes() == series_of(raw, record.test_path)


def test_a_clock_that_test_toml_sets_is_set_as_in_a_file(
    record: LiveRecord, tmp_path: Path
) -> None:
    later = changed(record, tmp_path / "later", "[adc]", "[file]\nstart_s = 0.01\n\n[adc]")
    played = play(later, tmp_path / "play", [later.raw.read_bytes()])
    played.results()
    assert played.out.read_bytes() == later.series
    assert "surge: the flow runs backwards from 0.3" in played.said
    point = played.session.monitor.point
    assert point is not None
    assert point.time_s == pytest.approx(3.009)


BAD: dict[str, tuple[str, str, bytes, bytes, str]] = {
    "no rows": ("", "", b"", b"", "expected rows, found none"),
    "no header": ("", "", b"time_s", b"0.0", "a table with a header and a column time_s"),
    "a channel is missing": ("", "", b"P31_B_hub_aft", b"other", "P31_B_hub_aft"),
    "another rate": ("sample_rate_hz = 1000.0", "sample_rate_hz = 500.0", b"", b"", "1000"),
    "no clock": ("[adc]", '[file]\nclock = "from rate"\n\n[adc]', b"", b"", "clock"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_feed_that_is_not_of_this_test_ends_at_once_and_leaves_nothing(
    record: LiveRecord, tmp_path: Path, case: str
) -> None:
    old, new, column, other, sentence = BAD[case]
    made = changed(record, tmp_path / "made", old, new) if old else record
    header = record.header.replace(column, other) if column else record.header
    rows = [] if case == "no rows" else record.lines
    with pytest.raises(InputError, match=sentence):
        play(made, tmp_path / "play", [b"".join([header, *rows])], comes_back=False)
    assert list((tmp_path / "play").glob("*.csv")) == []


def test_where_no_piece_can_be_reduced_the_rows_are_kept(
    record: LiveRecord, tmp_path: Path
) -> None:
    played = play(record, tmp_path, [b"".join([record.header, *record.lines[:250]])])
    with pytest.raises(InputError, match=r"no surge.*the raw record is kept: .*live\.raw\.csv"):
        played.results()
    assert len((tmp_path / "live.raw.csv").read_bytes().splitlines()) == 251


def test_a_silent_feed_is_reported_and_ends_after_the_timeout(
    record: LiveRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Clock:
        now_s = 0.0

        def monotonic(self) -> float:
            # Each look at the clock takes a tenth of a second: no test waits.
            self.now_s += 0.1
            return self.now_s

    clock = Clock()
    monkeypatch.setattr(session_module, "time", clock)
    monkeypatch.setattr(session_module, "TICK_S", 0.0)
    states: list[LiveState] = []

    rows = b"".join([record.header, *record.lines[:300]])
    played = play(record, tmp_path, [rows])
    feed = Feed("waiting", lambda feed: None)
    # All that ever comes is there before the session looks.
    feed.put(Opened())
    feed.put(rows)
    made = session_module.Session(
        record.test, feed, played.session.pieces, played.session.monitor, timeout_s=60.0
    )

    class Keeps:
        def show(self, state: LiveState) -> None:
            states.append(state)

    made.screens = [Keeps()]
    made.run()
    assert made.n_silences >= 1
    assert any(state.feed_silent and "no data for" in state.feed for state in states)
    assert states[-1].feed == "ended: no data for 60 s"
