"""Every step of the reduction gives the same bits wherever blocks end and columns lie."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from classic_ml.columns.workspace import IN_MEMORY, OnDisk, Workspace
from raw_data import make_test

from classic_ml import filtering
from classic_ml.calibration import (
    calibrate,
    calibrate_and_match,
    check_facing,
    invert_thermocouples,
    match_near_stall,
)
from classic_ml.coefficients import coefficients
from classic_ml.columns import workspace
from classic_ml.faults.choice import choose_channels
from classic_ml.faults.search import inspect_readings
from classic_ml.filters import filter_channels, low_pass, period_average
from classic_ml.planes import local_flows, plane_averages, plane_flows
from classic_ml.readers import TestDescription
from classic_ml.records import Channel, Record
from classic_ml.work.forms import WORK_FORMS
from surge_core.errors import InputError

BLOCKS = [97, 1000]


@cache
def spoiled() -> tuple[Record, TestDescription]:
    """A surge with cells, noise, and a fault of every kind."""
    made = make_test(seconds=2.6, seed=3, noise_counts=1.0, cells_lbm_s=4.0)
    columns = {name: values.copy() for name, values in made.columns.items()}
    columns["P25_A_tip_forward"][400:420] = 4095.0
    columns["P25_B_hub_aft"][1700:1760] = columns["P25_B_hub_aft"][1700]
    columns["P31_A_hub_forward"][1500:1511] = 2048.0
    columns["T31_A"][1200:1420] = 700.0
    columns["T25_B"][2590:] = 700.0
    limits = {name: [100.0, 696.0] for name in ("T31_A", "T25_B")}
    description = {**made.description, "limits": limits}
    record, test = dataclasses.replace(made, columns=columns, description=description).load()
    return record, test


def steps(place: Workspace) -> Iterator[tuple[str, Record]]:
    """Go through the reduction, each step by itself."""
    raw, test = spoiled()
    record = dataclasses.replace(raw, workspace=place)
    yield "inspected", (inspected := inspect_readings(record, test))
    yield "calibrated", (record := calibrate(inspected, test))
    check_facing(record, test)
    yield "matched", (record := match_near_stall(record, test))
    yield "at once", calibrate_and_match(inspected, test)
    window = record.rows_between(1.6, 2.5)
    yield "chosen", (record := choose_channels(record, test, window))
    for order, phase in ((3, "zero"), (5, "zero"), (3, "causal"), (3, "none")):
        names = tuple(name for name in test.channel_names if name in record)
        filtered = filter_channels(record, names, order=order, cutoff_hz=48.0, phase=phase)
        yield f"filtered {order} {phase}", filtered
        inverted = invert_thermocouples(filtered, test)
        yield f"inverted {order} {phase}", inverted
        planes = plane_flows(inverted, test)
        yield f"planes {order} {phase}", planes
        for form in WORK_FORMS:
            for cell_s in (None, 1.0 / 82.5):
                found = coefficients(planes, test, work_form=form, cell_period_s=cell_s)
                yield f"coefficients {order} {phase} {form} {cell_s}", found


@cache
def in_one_piece() -> dict[str, Record]:
    return dict(steps(IN_MEMORY))


@pytest.mark.parametrize("on_disk", [False, True], ids=["in memory", "on disk"])
@pytest.mark.parametrize("rows", BLOCKS)
def test_every_step_gives_the_same_bits(
    rows: int, on_disk: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = in_one_piece()
    monkeypatch.setattr(workspace, "BLOCK_ROWS", rows)
    for name, record in steps(OnDisk() if on_disk else IN_MEMORY):
        assert record.history == expected[name].history, name
        assert list(record.channels) == list(expected[name].channels), name
        for channel in record.channels:
            got, whole = np.asarray(record[channel]), expected[name][channel]
            assert got.tobytes() == whole.tobytes(), (name, channel)


def test_the_record_has_what_the_steps_must_carry_across_blocks() -> None:
    expected = in_one_piece()
    faults = [name for name in expected["inspected"].channels if name.startswith("fault_")]
    assert len(faults) == 5
    chosen = expected["chosen"].history[-1]
    assert {d.what for d in chosen.dropped} == {"pair 25_B_hub"}
    for form in WORK_FORMS[1:]:
        work = expected[f"coefficients 3 zero {form} None"].history[-1]
        assert work.parameters["form"] == form
        assert 300 < work.dropped[0].count < 2000


def test_averages_straight_from_pressures_are_those_by_way_of_the_pairs() -> None:
    _, test = spoiled()
    record = in_one_piece()["inverted 3 zero"]
    for probes in ("all", "hub"):
        straight = plane_flows(record, test, probes)
        by_pairs = plane_averages(local_flows(record, test), test, probes)
        assert straight.history == by_pairs.history
        assert {c for c in by_pairs.channels if "_A_" not in c and "_B_" not in c} == {
            c for c in straight.channels if "_A_" not in c and "_B_" not in c
        }
        for name in straight.channels:
            np.testing.assert_array_equal(straight[name], by_pairs[name])


@pytest.mark.parametrize("rows", BLOCKS)
@pytest.mark.parametrize("n", [1, 13, 96, 97, 98, 195, 2001])
def test_signals_of_any_length(n: int, rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    signal = np.random.default_rng(n).standard_normal(n).cumsum()

    def results() -> list[np.ndarray]:
        averages = [period_average(signal, s, 1000.0) for s in (0.0004, 0.001, 0.0123, 0.3)]
        phases = ("causal", "zero") if n > 12 else ("causal",)
        return averages + [
            low_pass(signal, 1000.0, order=3, cutoff_hz=48.0, phase=phase) for phase in phases
        ]

    whole = results()
    monkeypatch.setattr(workspace, "BLOCK_ROWS", rows)
    for got, expected in zip(results(), whole, strict=True):
        assert got.size == n
        assert got.tobytes() == expected.tobytes()


def test_the_worst_row_of_the_whole_record_is_refused_not_that_of_a_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", 97)
    _, test = spoiled()
    record = in_one_piece()["planes 3 zero"]

    def changed(name: str, values: dict[int, float], source: Record = record) -> Record:
        column = source[name].copy()
        column[list(values)] = list(values.values())
        channel = Channel(name, column, source.channel(name).unit)
        return source.after(source.history[-1], add=[channel])

    with pytest.raises(InputError, match=r"found -3.0.*e\+07 Pa in row 1501"):
        coefficients(changed("P31_Pa", {100: -1e7, 1500: -3e7}), test)
    with pytest.raises(InputError, match=r"found 500 kg/s"):
        coefficients(changed("Wc25_kg_s", {100: 300.0, 1500: -500.0}), test)
    probes = in_one_piece()["chosen"]
    name = "P25_A_tip_aft"
    low = changed(name, {100: -1.0, 1500: -2.0}, probes)
    for step in (local_flows, plane_flows):
        with pytest.raises(InputError, match=rf"{name}: .* found -2 Pa at 1.500 s"):
            step(low, test)


def test_no_step_needs_memory_of_the_record_s_length(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", 8192)
    monkeypatch.setattr(filtering, "PIECE_ROWS", 8192)
    raw, test = spoiled()
    place, times = OnDisk(), 200
    long = {}
    for name, channel in raw.channels.items():
        column = place.writer()
        for _ in range(times):
            column.append(channel.values)
        long[name] = Channel(name, column.finished(), channel.unit)
    record = dataclasses.replace(raw, channels=long, workspace=place)
    peaks = {}
    tracemalloc.start()
    try:
        for name, step in whole_reduction(test):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            record = step(record)
            peaks[name] = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    column_bytes = 8 * record.n_samples
    assert column_bytes > 4e6
    # A few blocks of some channels, and what counts the steps and digits of codes and keys.
    assert max(peaks.values()) < 0.8 * column_bytes, peaks


def whole_reduction(
    test: TestDescription,
) -> Iterator[tuple[str, Callable[[Record], Record]]]:
    yield "inspect", lambda r: inspect_readings(r, test)
    yield "calibrate", lambda r: calibrate_and_match(r, test)
    yield "choose", lambda r: choose_channels(r, test, r.rows_between(1.6, 2.5))
    yield (
        "filter",
        lambda r: filter_channels(
            r, [n for n in test.channel_names if n in r], order=3, cutoff_hz=48.0, phase="zero"
        ),
    )
    yield "invert", lambda r: invert_thermocouples(r, test)
    yield "planes", lambda r: plane_flows(r, test)
    for form in ("exit-flow", "mass-balance"):
        yield form, lambda r, form=form: coefficients(r, test, work_form=form, cell_period_s=0.01)
