"""Cycles are found where they are and only there; segments follow the threshold to the row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raw_data import LBM, surge_waves

from classic_ml.cycles import deep_ones, find_cycles
from classic_ml.intervals import bridged, label_intervals
from classic_ml.records import Record
from classic_ml.segments import (
    RAKE_DIFFERENCE,
    cell_frequency_hz,
    estimated_threshold_lbm_s,
    hub_tip_stall,
    in_stall_by_threshold,
    near,
    segment,
    window_rows,
)
from surge_core.errors import InputError

RATE = 1000.0


def record_of(
    *,
    seconds: float = 3.0,
    period_s: float = 0.14,
    surge: bool = True,
    shift: float = 8.0,
    **changes: np.ndarray,
) -> Record:
    time_s = np.arange(round(seconds * RATE)) / RATE
    waves = surge_waves(time_s, period_s, surge) | changes
    speed = 0.985 * np.sqrt(255.0 / waves["T25"])
    cells = 3e3 * np.sin(2 * np.pi * 82.5 * time_s) * waves["after"]
    apart = shift * waves["after"] * (waves["flow"] < 50)
    return Record.from_arrays(
        {
            "P31_Pa": (waves["P31"], "Pa"),
            "Wc25_kg_s": (waves["flow"] * LBM, "kg/s"),
            "Wc25_hub_kg_s": ((waves["flow"] + apart) * LBM, "kg/s"),
            "Wc25_tip_kg_s": ((waves["flow"] - apart) * LBM, "kg/s"),
            "P25_unfiltered_Pa": (waves["P25"] + cells, "Pa"),
            "Nc_frac": (speed, "1"),
        },
        sample_rate_hz=RATE,
        source="made up",
    )


def inside_of(window: slice, n_rows: int = 3000) -> np.ndarray:
    inside = np.zeros(n_rows, dtype=bool)
    inside[window] = True
    return inside


@pytest.mark.parametrize("period_s", [0.08, 0.14, 0.35])
def test_cycles_are_found_with_their_period(period_s: float) -> None:
    cycles = find_cycles(record_of(period_s=period_s, seconds=4.0))
    assert cycles.period_s == pytest.approx(period_s, rel=0.02)
    assert cycles.first_reversal_s == pytest.approx(0.31, abs=0.02)
    # Quasi-steady: the growth (150 ms) and the heating of the inlet (200 ms) are over.
    assert 0.5 < cycles.from_s < 1.5
    assert cycles.to_s > 4.0 - 2 * period_s
    assert cycles.n_cycles == pytest.approx((cycles.to_s - cycles.from_s) / period_s, abs=0.1)


def test_stall_that_does_not_cycle_is_refused() -> None:
    time_s = np.arange(3000) / RATE
    locked = 1.285e6 * np.exp(-np.maximum(time_s - 0.3, 0) / 0.06) + 2.2e5
    with pytest.raises(InputError, match="no rise of P31"):
        find_cycles(record_of(P31=locked))


def test_cycles_that_stop_repeating_are_left_out() -> None:
    time_s = np.arange(4000) / RATE
    waves = surge_waves(time_s, 0.14, True)
    level = 300e3
    fading = np.where(time_s > 3.0, level + 0.4 * (waves["P31"] - level), waves["P31"])
    cycles = find_cycles(record_of(seconds=4.0, P31=fading))
    assert cycles.to_s == pytest.approx(3.0, abs=0.15)


def test_the_threshold_is_exact() -> None:
    flow = np.array([60.0, 50.0, 49.9, 0.0, -10.0, 50.0, 70.0])
    expected = np.array([False, False, True, True, True, False, False])
    np.testing.assert_array_equal(in_stall_by_threshold(flow, 50.0), expected)


def test_hysteresis_holds_the_state_inside_the_band() -> None:
    flow = np.array([60.0, 50.0, 45.0, 41.9, 45.0, 57.9, 58.0, 45.0, 41.0])
    state = in_stall_by_threshold(flow, 50.0, 8.0)
    np.testing.assert_array_equal(state, [0, 0, 0, 1, 1, 1, 0, 0, 1])
    # Starting inside the band, the middle decides.
    assert in_stall_by_threshold(np.array([45.0, 46.0]), 50.0, 8.0).all()
    assert not in_stall_by_threshold(np.array([55.0, 46.0]), 50.0, 8.0).any()


def test_intervals_are_numbered_in_order_and_short_ones_left_out() -> None:
    state = np.array([1, 1, 1, 0, 1, 0, 1, 1, 1, 1], dtype=bool)
    labels, short = label_intervals(state, 2)
    np.testing.assert_array_equal(labels, [1, 1, 1, 0, 0, 0, 2, 2, 2, 2])
    assert short == [1]
    assert label_intervals(np.zeros(4, dtype=bool), 1) == (pytest.approx(np.zeros(4)), [])


@given(
    rows=st.lists(st.booleans(), min_size=1, max_size=40).map(lambda v: np.array(v, dtype=bool)),
    before=st.integers(0, 50),
    behind=st.integers(0, 50),
)
def test_near_is_what_it_says(rows: np.ndarray, before: int, behind: int) -> None:
    places = np.flatnonzero(rows)
    expected = [np.any((places - k <= before) & (k - places <= behind)) for k in range(rows.size)]
    np.testing.assert_array_equal(near(rows, before, behind), np.array(expected, dtype=bool))


def test_segments_lie_in_stall_and_in_the_window() -> None:
    record = record_of()
    window = window_rows(record, (1.0, 2.5))
    out = segment(record, window, threshold_lbm_s=50.0)
    inside = out["segment"] > 0
    assert np.all(out["in_stall"][inside] == 1)
    assert np.all(inside_of(window)[inside])
    assert out["segment"].max() == pytest.approx(1.5 / 0.14, abs=1.0)
    # Rows of stall outside the window are marked as stall, but not as segments.
    assert np.any((out["in_stall"] == 1) & ~inside_of(window))
    assert out.history[-1].dropped[-1].count == np.count_nonzero(~inside)


def test_short_grazes_of_the_threshold_are_left_out_and_counted() -> None:
    record = record_of(seconds=4.0)
    flow = record["Wc25_kg_s"].copy()
    # A spike of 3 ms up to unstalled flow in every 10 ms of stall.
    flow[np.arange(flow.size) % 10 < 3] = 60.0 * LBM
    spiky = Record.from_arrays(
        {"Wc25_kg_s": (np.where(np.arange(4000) > 3500, 0.0, flow), "kg/s")}, sample_rate_hz=RATE
    )
    out = segment(spiky, slice(1000, 4000), threshold_lbm_s=50.0)
    grazes, _ = out.history[-1].dropped
    assert grazes.what.endswith("in-stall intervals")
    stalled = np.count_nonzero(out["in_stall"][1000:])
    assert grazes.count + np.count_nonzero(out["segment"]) == stalled


def test_a_window_without_stall_is_refused() -> None:
    record = record_of(surge=False)
    with pytest.raises(InputError, match="in-stall intervals inside the window, found none"):
        segment(record, window_rows(record, (1.0, 2.0)), threshold_lbm_s=50.0)


@pytest.mark.parametrize("window_s", [(-1.0, 2.0), (1.0, 9.0), (1.0, 1.001)])
def test_a_window_that_the_record_does_not_hold_is_refused(window_s: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="window: expected a window"):
        window_rows(record_of(), window_s)


@pytest.mark.parametrize("shift", [8.0, 1.3, -8.0])
def test_the_hub_minus_tip_flow_tells_the_stall_state(shift: float) -> None:
    record = record_of(shift=shift)
    window = window_rows(record, (1.0, 2.5))
    state = hub_tip_stall(record, window, 82.5, slice(200))
    assert state is not None
    got = state[window]
    true = (record["Wc25_kg_s"] / LBM < 50.0)[window]
    # The average over 12 ms blurs each switch, but does not move it by more than a row or two.
    changes = np.flatnonzero(np.diff(true.astype(int)))
    wrong = np.flatnonzero(got != true)
    assert all(np.abs(changes - row).min() <= 2 for row in wrong)
    assert hub_tip_stall(record, window, 82.5, window) is None


def test_a_deep_rise_is_half_of_the_second_deepest() -> None:
    assert deep_ones(np.array([4.0, 1.9, 2.1, 9.0])).tolist() == [True, False, True, True]
    assert deep_ones(np.array([3.0])).tolist() == [True]


def test_the_threshold_is_estimated_from_the_shift_between_hub_and_tip() -> None:
    """The flow at which the made-up machine leaves stall is 50 lbm/s."""
    record = record_of(seconds=4.0)
    window = window_rows(record, (1.0, 3.8))
    state = hub_tip_stall(record, window, 82.5, slice(200))
    threshold, entry = estimated_threshold_lbm_s(record, record["Wc25_kg_s"], window, state)
    assert threshold == pytest.approx(50.0, abs=1.5)
    assert entry.parameters["threshold_lbm_s"] == pytest.approx(threshold, abs=1e-3)
    # The machine was unstalled at the flow before its surge, whatever hub and tip say.
    flow = np.where(record.time_s < 0.25, 60.0 * LBM, record["Wc25_kg_s"])
    threshold, _ = estimated_threshold_lbm_s(record, flow, window, np.roll(state, 40))
    assert threshold < 60.0
    # What it swings by into the surge, in fewer than half of those rows, is none of that flow.
    flow = np.where((record.time_s > 0.1) & (record.time_s < 0.2), 5.0 * LBM, flow)
    threshold, _ = estimated_threshold_lbm_s(record, flow, window, state)
    assert threshold == pytest.approx(50.0, abs=1.5)


def test_without_a_shift_the_threshold_divides_the_two_levels_of_the_flow() -> None:
    time_s = np.arange(4000) / RATE
    high = (np.sin(2 * np.pi * np.maximum(time_s - 0.3, 0) / 0.14) > 0.5) & (time_s > 0.5)
    noise = np.random.default_rng(3).normal(0.0, 2.0, time_s.size)
    flow = np.where(time_s < 0.3, 112.0, np.where(high, 70.0, 10.0)) + noise
    record = record_of(seconds=4.0, flow=np.where((time_s > 0.32) & (time_s < 0.36), -9.0, flow))
    window = window_rows(record, (1.0, 3.8))
    threshold, _ = estimated_threshold_lbm_s(record, record["Wc25_kg_s"], window, None)
    assert threshold is not None
    assert 20.0 < threshold < 60.0


@pytest.mark.parametrize("least", [-np.inf, 15.0])
def test_a_record_that_never_recovers_has_no_threshold(least: float) -> None:
    record = record_of()
    flow = np.where(record.time_s < 0.25, 112.0, np.clip(record["Wc25_kg_s"] / LBM, least, 45.0))
    mild = record_of(flow=flow)
    window = window_rows(mild, (1.0, 2.5))
    assert hub_tip_stall(mild.without(["Wc25_hub_kg_s"]), window, 82.5, slice(0)) is None
    for state in (hub_tip_stall(mild, window, 82.5, slice(200)), None):
        assert estimated_threshold_lbm_s(mild, mild["Wc25_kg_s"], window, state)[0] is None
    flags = segment(mild, window, threshold_lbm_s=None).history[-1].flags
    assert (least > 0.0) is bool(flags)


def test_straight_lines_are_drawn_across_what_does_not_count() -> None:
    values = np.array([9.0, 1.0, 7.0, 7.0, 4.0, 9.0])
    known = np.array([False, True, False, False, True, False])
    np.testing.assert_allclose(bridged(values, known), [1.0, 1.0, 2.0, 3.0, 4.0, 4.0])
    assert bridged(values, np.zeros(6, dtype=bool)) is values


@pytest.mark.parametrize("in_mean", [1.0, 0.0])
def test_a_resonance_of_the_ducts_is_not_taken_for_the_cells(in_mean: float) -> None:
    """It is alike at both rakes, in the mean of which the cells may cancel."""
    time_s = np.arange(4000) / RATE
    rng = np.random.default_rng(5)
    planar, cells = (
        size * np.sin(2 * np.pi * hz * time_s) for size, hz in ((900.0, 43.0), (200.0, 93.0))
    )
    noise = 5.0 * rng.standard_normal((2, time_s.size))
    both = {
        "P25_unfiltered_Pa": (planar + in_mean * cells + noise[0], "Pa"),
        RAKE_DIFFERENCE: (3.0 * cells + noise[1], "Pa"),
    }
    record = Record.from_arrays(both, sample_rate_hz=RATE)
    window = slice(0, time_s.size)
    assert cell_frequency_hz(record, window, 12_000.0) == pytest.approx(93.0, abs=0.3)
    alone = record.without({RAKE_DIFFERENCE})
    assert cell_frequency_hz(alone, window, 12_000.0) == pytest.approx(43.0, abs=0.3)
