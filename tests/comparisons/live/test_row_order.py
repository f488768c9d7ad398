"""Rows by their clock: nothing twice, nothing in the wrong place, and no gap that is not told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comparisons.live.row_order import ROWS_TO_BELIEVE, RowOrder, Stretch
from comparisons.live.rows import Rows, Tally

RATE_HZ = 1000.0


def rows_at(numbers: list[int], value: str = "7") -> tuple[np.ndarray, Rows]:
    time_s = np.array(numbers) / RATE_HZ
    lines = tuple(f"{t:.3f},{value}".encode() for t in time_s)
    return time_s, Rows(np.column_stack([time_s, np.full(time_s.size, float(value))]), lines)


def pieces(stretches: list[Stretch]) -> list[list[int]]:
    out: list[list[int]] = [[]]
    for stretch in stretches:
        if stretch.why_new:
            out.append([])
        out[-1] += np.round(stretch.time_s * RATE_HZ).astype(int).tolist()
        assert stretch.rows.values[:, 0].tolist() == stretch.time_s.tolist()
    return out


def ordered(batches: list[tuple[np.ndarray, Rows]]) -> tuple[list[list[int]], RowOrder, Tally]:
    tally = Tally()
    order = RowOrder(RATE_HZ, tally)
    stretches = [s for time_s, rows in batches for s in order.take(time_s, rows)]
    return pieces([*stretches, *order.close()]), order, tally


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_repeated_and_shuffled_rows_come_out_once_and_in_order(data: st.DataObject) -> None:
    n = data.draw(st.integers(40, 120))
    numbers = list(range(n))
    # Rows change places over a few rows, as datagrams do, and stretches are sent again.
    for start in range(1, n - 8, 8):
        numbers[start : start + 7] = data.draw(st.permutations(numbers[start : start + 7]))
    sent, place = [], 0
    while place < n:
        step = data.draw(st.integers(1, 30))
        again = data.draw(st.integers(0, min(place, 20)))
        sent.append(rows_at(numbers[place - again : place + step]))
        place += step
    found, order, tally = ordered(sent)
    assert found == [list(range(n))]
    assert tally.total == 0
    assert order.repeated == sum(len(rows) for _, rows in sent) - n


def test_a_gap_begins_a_new_piece() -> None:
    found, _, tally = ordered([rows_at(list(range(50))), rows_at(list(range(51, 120)))])
    assert found == [list(range(50)), list(range(51, 120))]
    assert tally.total == 0


def test_a_gap_that_is_filled_in_time_is_none() -> None:
    late = [*range(50), *range(51, 50 + ROWS_TO_BELIEVE), 50, *range(50 + ROWS_TO_BELIEVE, 120)]
    found, order, tally = ordered([rows_at(late)])
    assert found == [list(range(120))]
    assert order.late == ROWS_TO_BELIEVE - 1
    assert tally.total == 0


def test_one_row_with_a_garbled_clock_breaks_nothing_but_its_own_place() -> None:
    first, wild, rest = rows_at(list(range(50))), rows_at([987_654]), rows_at(list(range(50, 200)))
    found, _, tally = ordered([first, wild, rest])
    assert found == [list(range(200))]
    assert tally.total == 1


@pytest.mark.parametrize("jump", [-40, -5000])
def test_a_clock_that_is_set_back_begins_a_new_piece(jump: int) -> None:
    before = list(range(10_000, 10_100))
    behind = [n + jump for n in range(10_100, 10_200)]
    # Other readings: the same ones would be rows that were sent twice.
    found, order, _ = ordered([rows_at(before, "7"), rows_at(behind, "8")])
    assert found == [before, behind]
    assert order.repeated == 0


def test_a_record_sent_a_second_time_from_its_beginning_adds_nothing() -> None:
    whole = list(range(3000))
    found, order, tally = ordered([rows_at(whole[:2000]), rows_at(whole)])
    assert found == [whole]
    assert order.repeated == 2000
    assert tally.total == 0


def test_another_row_at_a_time_that_was_had_is_refused() -> None:
    found, order, tally = ordered(
        [rows_at(list(range(60))), rows_at([30], "9"), rows_at(list(range(60, 120)))]
    )
    assert found == [list(range(120))]
    assert tally.total == 1
    assert order.repeated == 0


def test_what_is_remembered_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("comparisons.live.row_order.REMEMBERED_ROWS", 1000)
    batches = [rows_at(list(range(start, start + 300))) for start in range(0, 9000, 300)]
    tally = Tally()
    order = RowOrder(RATE_HZ, tally)
    found = pieces([s for time_s, rows in batches for s in order.take(time_s, rows)])
    assert found == [list(range(9000))]
    assert order._memory.n_rows <= 1000
    assert order.take(*rows_at(list(range(8700, 9000)))) == []
    assert order.repeated == 300
