"""A gap costs the rows that are lost, and not the near-stall match of those behind it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_records import LiveRecord, Played, cut, made_record, play, series_of

from classic_ml.readers import read_raw, read_test_description
from classic_ml.readers.series_files import read_series
from classic_ml.reduction import near_stall_shifts, reduce_record
from comparisons.cli import main
from comparisons.live.columns import feed_columns
from comparisons.live.near_stall import NearStallMatch
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> LiveRecord:
    # Above 90 % speed T31 leaves its range; here it does not.
    return made_record(tmp_path_factory.mktemp("carried") / "90", case="90", seed=2, seconds=4.0)


def ledger(series: Path) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = json.loads(series.with_suffix(".ledger.json").read_text())
    return entries


def entry(series: Path, step: str) -> dict[str, Any]:
    return next(e for e in ledger(series) if e["step"] == step)


def played_without(record: LiveRecord, folder: Path, *lost: slice) -> Played:
    gone = {row for rows in lost for row in range(*rows.indices(len(record.lines)))}
    kept = [line for row, line in enumerate(record.lines) if row not in gone]
    return play(record, folder, cut(record.header + b"".join(kept), np.random.default_rng(1)))


def test_a_lost_row_costs_a_row(record: LiveRecord, tmp_path: Path) -> None:
    played = played_without(record, tmp_path, slice(1500, 1501))
    first, second = played.results()
    assert second.error is None
    assert second.series == played.out
    # What `reduce` makes of the piece with the description beside it is the same, byte for byte.
    assert second.piece.test == tmp_path / "spool-piece2.test.toml"
    again = tmp_path / "again.csv"
    where = [str(second.piece.path), "--test", str(second.piece.test), "-o", str(again)]
    assert main(["reduce", *where]) == 0
    assert again.read_bytes() == played.out.read_bytes()
    assert entry(again, "near-stall match") == entry(played.out, "near-stall match")
    # And what the first piece has is what a file with its rows gives.
    alone = tmp_path / "alone.csv"
    alone.write_bytes(record.header + b"".join(record.lines[:1500]))
    if first.series is not None:
        assert first.series.read_bytes() == series_of(alone, record.test_path)


def test_the_rows_behind_a_gap_are_matched_as_if_there_were_none(
    record: LiveRecord, tmp_path: Path
) -> None:
    played = played_without(record, tmp_path, slice(1500, 1501))
    played.results()
    whole = tmp_path / "whole.csv"
    whole.write_bytes(record.series)
    whole_series, behind = read_series(whole), read_series(played.out)
    assert whole_series.phi_unfiltered is not None
    assert behind.phi_unfiltered is not None
    # φ without a filter takes nothing from the rows beside it but the slope of T, at the edge.
    inner = slice(3, -3)
    assert behind.phi_unfiltered[inner] == pytest.approx(
        whole_series.phi_unfiltered[1501:][inner], rel=1e-12, abs=1e-12
    )


def test_the_ledger_says_where_the_match_comes_from(record: LiveRecord, tmp_path: Path) -> None:
    played = played_without(record, tmp_path, slice(1500, 1501))
    played.results()
    match = entry(played.out, "near-stall match")
    assert "the near-stall reading that it is matched by is not in this record" in match["flags"]
    assert "spool-piece2.test.toml [near_stall_shifts]" in match["did"]
    feed = entry(played.out, "live feed")
    assert feed["parameters"]["matched_by_piece"] == 1
    assert any("matched by that of piece 1" in flag for flag in feed["flags"])
    found = near_stall_shifts(*read_raw(tmp_path / "spool.csv", record.test_path))
    test = read_test_description(tmp_path / "spool-piece2.test.toml")
    assert dict(test.near_stall_shifts) == found
    assert len(found) == 12
    assert match["parameters"]["shift_25_A_tip_Pa"] == round(found["P25_A_tip_forward"], 2)


def test_a_gap_before_the_surge_leaves_the_match_too(record: LiveRecord, tmp_path: Path) -> None:
    # The first piece holds the near-stall reading and no surge: it cannot be reduced itself.
    played = played_without(record, tmp_path, slice(200, 203), slice(3700, 3701))
    first, second, third = played.results()
    assert "no surge" in str(first.error)
    assert second.series == played.out
    assert (second.piece.matched_by, third.piece.matched_by) == (1, 1)
    assert len(read_series(played.out).phi) == 3497


def test_a_gap_in_the_reading_leaves_each_piece_its_own(record: LiveRecord, tmp_path: Path) -> None:
    # 60 of 141 rows of the reading are enough, 10 are not.
    for name, row, by in (("half", 80, 0), ("end", 131, 1)):
        folder = tmp_path / name
        folder.mkdir()
        played = play(
            record, folder, [record.header, *record.lines[:row], *record.lines[row + 1 :]]
        )
        assert played.results()[1].piece.matched_by == by


def test_what_was_not_matched_is_not_used_behind_a_gap(record: LiveRecord, tmp_path: Path) -> None:
    # A thermocouple at its upper end near stall, and sound behind.
    place = record.names.index("T31_A")
    lines = []
    for row, line in enumerate(record.lines):
        cells = line.strip().split(b",")
        if row < 400:
            cells[place] = b"720.0"
        lines.append(b",".join(cells) + b"\n")
    folder = tmp_path / "limited"
    folder.mkdir()
    (folder / "raw.csv").write_bytes(record.header + b"".join(lines))
    text = record.test_path.read_text("utf-8")
    assert "[limits]" in text
    limits = text.split("[limits]")[1]
    assert "T31_A" in limits
    (folder / "test.toml").write_text(text, "utf-8")
    limited = LiveRecord(folder)
    played = played_without(limited, tmp_path, slice(1500, 1501))
    results = played.results()
    assert results[1].reduction is not None
    dropped = entry(played.out, "choose channels")["dropped"]
    why = next(drop["why"] for drop in dropped if drop["what"] == "T31_A")
    assert "[near_stall_shifts], so that it cannot be matched" in why


def test_behind_a_clock_that_was_set_back_nothing_is_carried_over(
    record: LiveRecord, tmp_path: Path
) -> None:
    # Two seconds in, the recorder begins anew and calls it 0.5 s.
    again = [
        f"{0.5 + 0.001 * i:.3f}".encode() + b"," + line.split(b",", 1)[1]
        for i, line in enumerate(record.lines[2000:])
    ]
    played = play(record, tmp_path, [record.header, *record.lines[:2000], *again])
    first, second = played.results()
    assert first.error is None
    assert "[near_stall]" in str(second.error)
    assert second.piece.test is None


def test_the_descriptions_go_with_the_raw_record(record: LiveRecord, tmp_path: Path) -> None:
    played = played_without(record, tmp_path, slice(1500, 1501))
    played.results()
    assert (tmp_path / "spool-piece2.test.toml").exists()
    played.session.discard()
    assert not list(tmp_path.glob("spool*"))


def with_table(record: LiveRecord, folder: Path, table: str) -> Path:
    path = folder / "test.toml"
    path.write_text(record.test_path.read_text("utf-8") + "\n[near_stall_shifts]\n" + table)
    return path


def stated(shifts: dict[str, float]) -> str:
    return "".join(f"{name} = {shift!r}\n" for name, shift in shifts.items())


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("", "[near_stall_shifts]: expected a shift for each channel, found none"),
        ("P99 = 1.0\n", "the name of a forward probe or a thermocouple, found no such channel"),
        ("P25_A_tip_aft = 1.0\n", "found an aft probe; it moves with its forward mate"),
        ("P25_A_tip_forward = 30e3\n", "found 30000; it is added to the calibrated reading"),
        ('T25_A = "1 degC"\n', "T25_A: expected a number at least -3"),
    ],
)
def test_shifts_that_cannot_be_are_refused(
    record: LiveRecord, tmp_path: Path, table: str, says: str
) -> None:
    with pytest.raises(InputError) as refused:
        read_test_description(with_table(record, tmp_path, table))
    assert says in str(refused.value)


def test_stated_shifts_are_those_that_are_found(record: LiveRecord, tmp_path: Path) -> None:
    raw, test = read_raw(record.raw, record.test_path)
    path = with_table(record, tmp_path, stated(near_stall_shifts(raw, test)))
    one = reduce_record(raw, test).series
    other = reduce_record(*read_raw(record.raw, path)).series
    assert np.array_equal(one.phi, other.phi)
    assert np.array_equal(one.psi_p, other.psi_p)
    assert one.psi is not None
    assert other.psi is not None
    assert np.array_equal(one.psi, other.psi)


def test_a_session_is_matched_by_stated_shifts_from_its_first_row_on(
    record: LiveRecord, tmp_path: Path
) -> None:
    found = near_stall_shifts(*read_raw(record.raw, record.test_path))
    path = with_table(record, tmp_path, stated(found))
    columns = feed_columns(record.names, read_test_description(path))
    shifts = NearStallMatch(columns).shifts
    assert shifts is not None
    assert shifts["P31_A_tip_aft"] == shifts["P31_A_tip_forward"] == found["P31_A_tip_forward"]
    folder = tmp_path / "stated"
    folder.mkdir()
    path.rename(folder / "test.toml")
    (folder / "raw.csv").write_bytes(record.header + b"".join(record.lines[1000:]))
    late = LiveRecord(folder)
    played = play(late, tmp_path, [late.content])
    played.results()
    assert played.out.read_bytes() == late.series
