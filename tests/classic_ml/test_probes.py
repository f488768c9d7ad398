"""Probes of one place beside each other: a lost one, an exchanged one, a zero that drifts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from raw_data import RawTest, make_test

from classic_ml.calibration import calibrate, near_stall_match
from classic_ml.faults.likes import compare_likes
from classic_ml.io import TestDescription
from classic_ml.records import Channel, Record
from surge_core.errors import InputError

CYCLES = slice(700, 2000)
PROBE, LIKE = "P31_B_hub_forward", "P31_A_hub_forward"
Loaded = tuple[Record, TestDescription]


@pytest.fixture(scope="module")
def loaded() -> Loaded:
    made: RawTest = make_test(seconds=2.0, seed=3, noise_counts=1.0, cells_lbm_s=6.0)
    record, test = made.load()
    shifts, _ = near_stall_match(calibrate(record, test), test)
    return calibrate(record, test, shifts), test


def changed(record: Record, **channels: np.ndarray) -> Record:
    units = {name: record.channel(name).unit for name in channels}
    return record.after(
        record.history[-1], add=[Channel(n, values, units[n]) for n, values in channels.items()]
    )


def scaled(record: Record, name: str, factor: float) -> np.ndarray:
    mean = record[name][CYCLES].mean()
    return np.asarray(mean + factor * (record[name] - mean))


def test_sound_probes_agree(loaded: Loaded) -> None:
    assert compare_likes(*loaded, CYCLES, {}) == ({}, [])
    assert compare_likes(*loaded, slice(700, 900), {}) == ({}, [])


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_a_wrong_sensitivity_is_read_off(loaded: Loaded, factor: float) -> None:
    record, test = loaded
    spoiled = changed(record, **{PROBE: scaled(record, PROBE, factor)})
    bad, (doubt,) = compare_likes(spoiled, test, CYCLES, {})
    assert not bad
    assert doubt.startswith(f"{PROBE} moves {factor:.2f} times as much as {LIKE}: check its zero")
    # What both rakes show at one immersion is the gas.
    spoiled = changed(spoiled, **{LIKE: scaled(record, LIKE, factor)})
    assert compare_likes(spoiled, test, CYCLES, {}) == ({}, [])


@pytest.mark.parametrize("name", [PROBE, "P25_A_tip_forward"])
def test_a_probe_that_came_off_has_no_part_in_the_cycles(loaded: Loaded, name: str) -> None:
    record, test = loaded
    noise = np.random.default_rng(1).normal(0.0, 30.0, record.n_samples)
    spoiled = changed(record, **{name: record[name][CYCLES].mean() + noise})
    assert list(compare_likes(spoiled, test, CYCLES, {})[0]) == [name]
    one = replace(test, pressures=tuple(p for p in test.pressures if p.rake == "A"))
    assert compare_likes(record, one, CYCLES, {}) == ({}, [])


def test_probes_exchanged_on_a_rake_are_refused(loaded: Loaded) -> None:
    record, test = loaded
    hub, tip = "P25_A_hub_forward", "P25_A_tip_forward"
    tips = {f"P25_{r}_tip_{f}": 1.0 for r in "AB" for f in ("forward", "aft")}
    record = changed(record, **{name: scaled(record, name, 0.5) for name in tips})
    assert compare_likes(record, test, CYCLES, {}) == ({}, [])
    spoiled = changed(record, **{hub: record[tip], tip: record[hub]})
    with pytest.raises(InputError, match=rf"{tip} and {hub}: .* exchanged on rake A$"):
        compare_likes(spoiled, test, CYCLES, {})


def test_a_thermocouple_that_holds_is_left_out(loaded: Loaded) -> None:
    record, test = loaded
    level_K = test.near_stall.T25_K
    held = {"T25_A": record["T25_A"] + 20.0, "T25_B": np.full(record.n_samples, level_K + 0.1)}
    bad, doubts = compare_likes(changed(record, **held), test, CYCLES, {})
    assert (list(bad), doubts) == (["T25_B"], [])


def test_a_zero_that_drifts_between_near_stall_and_the_cycles_is_found(loaded: Loaded) -> None:
    record, test = loaded
    name = "P25_A_hub_forward"
    bad, (found,) = compare_likes(changed(record, **{name: 1.03 * record[name]}), test, CYCLES, {})
    assert not bad
    assert found.startswith(name)
    assert "above P25_B_hub_forward" in found
