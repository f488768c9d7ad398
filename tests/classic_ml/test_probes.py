"""Probes beside each other: a lost one, a wrong sensitivity, a zero that drifts."""

from __future__ import annotations

import numpy as np
import pytest
from raw_data import RawTest, make_test

from classic_ml.calibration import calibrate, near_stall_match
from classic_ml.faults.choice import compare_probes, disagreements, slow_pressures
from classic_ml.io import TestDescription
from classic_ml.records import Channel, Record

CYCLES = slice(700, 2000)
PROBE = "P31_B_hub_forward"


@pytest.fixture(scope="module")
def loaded() -> tuple[Record, TestDescription]:
    made: RawTest = make_test(seconds=2.0, seed=3, noise_counts=1.0, cells_lbm_s=6.0)
    record, test = made.load()
    shifts, _ = near_stall_match(calibrate(record, test), test)
    return calibrate(record, test, shifts), test


def changed(record: Record, name: str, values: np.ndarray) -> Record:
    return record.after(record.history[-1], add=[Channel(name, values, "Pa")])


def test_sound_probes_agree(loaded: tuple[Record, TestDescription]) -> None:
    found = compare_probes(slow_pressures(*loaded, CYCLES), loaded[1])
    assert set(found) == {p.name for p in loaded[1].pressures}
    assert max(abs(a.gain - 1.0) for a in found.values()) < 0.04
    assert max(a.apart for a in found.values()) < 0.1


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_a_wrong_sensitivity_is_read_off(
    loaded: tuple[Record, TestDescription], factor: float
) -> None:
    record, test = loaded
    mean = record[PROBE][CYCLES].mean()
    values = mean + factor * (record[PROBE] - mean)
    spoiled = changed(record, PROBE, values)
    slow = slow_pressures(spoiled, test, CYCLES)
    found = compare_probes(slow, test)
    assert any(PROBE in text for text in disagreements(slow, test, found))
    # What both rakes show at one immersion is the gas.
    slow = slow_pressures(changed(spoiled, "P31_A_hub_forward", values), test, CYCLES)
    assert disagreements(slow, test, compare_probes(slow, test)) == []
    assert found[PROBE].gain == pytest.approx(factor, abs=0.02)
    others = [a for n, a in found.items() if n != PROBE]
    assert max(abs(a.gain - 1.0) for a in others) < 0.05


def test_a_probe_that_came_off_has_no_part_in_the_cycles(
    loaded: tuple[Record, TestDescription],
) -> None:
    record, test = loaded
    noise = np.random.default_rng(1).normal(0.0, 300.0, record.n_samples)
    spoiled = changed(record, PROBE, record[PROBE][0] + noise)
    lost = compare_probes(slow_pressures(spoiled, test, CYCLES), test)[PROBE]
    assert abs(lost.gain) < 0.02
    assert lost.apart == pytest.approx(1.0, abs=0.03)


def test_two_probes_or_a_quiet_record_tell_nothing(
    loaded: tuple[Record, TestDescription],
) -> None:
    record, test = loaded
    aft = [p.name for p in test.pressures if p.plane == 25 and p.facing == "aft"]
    slow = slow_pressures(record, test, CYCLES)
    few = {name: means for name, means in slow.items() if name not in aft[:2]}
    assert not set(aft) & set(compare_probes(few, test))
    assert compare_probes(slow_pressures(record, test, slice(0, 290)), test) == {}
    assert compare_probes(slow_pressures(record, test, slice(700, 900)), test) == {}


def test_a_zero_that_drifts_between_near_stall_and_the_cycles_is_found(
    loaded: tuple[Record, TestDescription],
) -> None:
    record, test = loaded
    assert disagreements(slow_pressures(record, test, CYCLES), test, {}) == []
    name = "P25_A_hub_forward"
    spoiled = changed(record, name, 1.03 * record[name])
    (found,) = disagreements(slow_pressures(spoiled, test, CYCLES), test, {})
    assert found.startswith(name)
    assert "above P25_B_hub_forward" in found
