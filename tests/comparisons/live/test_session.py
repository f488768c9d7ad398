"""A session ends with the series that `reduce` makes of the same rows, whatever the feed does."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from live_records import LiveRecord, changed, play, series_of

from classic_ml.io import read_raw
from classic_ml.reduction import reduce_record
from comparisons.live.feeds import Closed, Opened
from surge_core.errors import InputError

LOST = Closed("lost")


@pytest.mark.parametrize("step", [7, 1000])
def test_the_series_at_the_end_is_that_of_reduce(
    record: LiveRecord, tmp_path: Path, step: int
) -> None:
    rows = record.rows
    parts = [rows[start : start + step] for start in range(0, len(rows), step)]
    played = play(record, tmp_path / "play", *parts)
    _, reduction = played.reduce()
    assert played.out.read_bytes() == record.series
    entry = reduction.series.history[1]
    assert (entry.step, entry.parameters["rows"]) == ("live feed", len(rows) - 1)
    assert "matched to the near-stall reading" in played.said
    assert "surge: the flow runs backwards from" in played.said
    assert "cycle 5 ended at" in played.said
    assert played.monitor.estimate is not None
    assert played.monitor.estimate.tau_s == pytest.approx(0.018, abs=0.003)


def test_lines_that_are_no_rows_are_counted_and_a_sender_may_come_back(
    record: LiveRecord, tmp_path: Path
) -> None:
    rows = record.rows
    first = [*rows[:1000], b"# a comment", b"buffer overrun"]
    other = [b"time_s,other", b"1,2"]
    again = [rows[0], *rows[950:], b"#end", b"1,2,3"]
    arrivals = (first, LOST, Opened(), other, LOST, Opened(), again)
    played = play(record, tmp_path / "play", *arrivals)
    played.reduce()
    assert played.out.read_bytes() == record.series
    assert "connection lost: lost" in played.said
    assert "a connection was refused: it began with another header" in played.said
    assert "ended: the sender says that the run is over" in played.said
    assert played.session.order.repeated == 50
    assert dict(played.session.refused) == {"a line that is no row of numbers": 1}


def test_the_longest_piece_is_matched_by_the_reading_before_the_gap(
    record: LiveRecord, tmp_path: Path
) -> None:
    rows = [*record.rows]
    del rows[1201]
    played = play(record, tmp_path / "play", rows)
    piece, reduction = played.reduce()
    assert [piece.n_rows for piece in played.pieces.pieces] == [1200, len(record.rows) - 1202]
    assert "1 row is missing before the clock 1.2" in played.said
    assert piece.number == 2
    assert "near-stall reading of piece 1" in reduction.series.history[1].flags[-1]
    # Away from the ends of the filter it is the series of the record without a gap.
    whole = reduce_record(*read_raw(record.raw, record.test_path)).series
    psi_p = whole.psi_p[1201:]
    assert np.std((reduction.series.psi_p - psi_p)[500:-500]) < 0.01 * np.std(psi_p)


def test_a_table_with_semicolons_decimal_commas_and_units_is_read_as_a_file_is(
    record: LiveRecord, tmp_path: Path
) -> None:
    header, *rows = record.rows
    by_letter = {"t": b"ms", "P": b"counts", "T": b"K"}
    units = b";".join(by_letter[name[:1]] for name in header.decode().split(","))
    cells = [row.split(b",") for row in rows]
    in_ms = [b";".join([b"%r" % (1e3 * float(first)), *rest]) for first, *rest in cells]
    table = [header.replace(b",", b";"), units, *(row.replace(b".", b",") for row in in_ms)]
    raw = tmp_path / "in ms.csv"
    raw.write_bytes(b"\n".join(table) + b"\n")
    played = play(record, tmp_path / "play", table)
    played.reduce()
    assert played.out.read_bytes() == series_of(raw, record.test_path)


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
    header, *rows = record.rows
    sent = [header.replace(column, other) if column else header]
    with pytest.raises(InputError, match=sentence):
        play(made, tmp_path / "play", sent + (rows if case != "no rows" else []), comes_back=False)
    assert list((tmp_path / "play").glob("live*.csv")) == []


def test_where_no_piece_can_be_reduced_the_rows_are_kept(
    record: LiveRecord, tmp_path: Path
) -> None:
    played = play(record, tmp_path, record.rows[:251])
    with pytest.raises(InputError, match=r"no surge.*the raw record is kept: .*live\.raw\.csv"):
        played.reduce()
    assert len((tmp_path / "live.raw.csv").read_bytes().splitlines()) == 251


def test_a_silent_feed_is_shown_and_ends_after_the_timeout(
    record: LiveRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each look at the clock takes a tenth of a second: no test waits.
    ticks = iter(range(10**9))
    monkeypatch.setattr(time, "monotonic", lambda: 0.1 * next(ticks))
    monkeypatch.setattr("comparisons.live.session.TICK_S", 0.0)
    played = play(record, tmp_path, record.rows[:301], end=False, timeout_s=60.0)
    assert "no data for 30 s" in played.feed_words
    assert "ended: no data for 60 s" in played.said
