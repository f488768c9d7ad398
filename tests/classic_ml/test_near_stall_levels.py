"""Levels near stall that are wrong for a whole plane, or for the machine, are flagged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clean_records import CLEAN, clean_record, with_channels

from classic_ml.io import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import reduce_record


def flagged(record: Record, test: TestDescription) -> list[str]:
    history = reduce_record(record, test).record.history
    steps = ("near-stall match", "near-stall flow")
    return [flag for entry in history if entry.step in steps for flag in entry.flags]


def facility(test: TestDescription, **factors: float) -> TestDescription:
    near = test.near_stall
    moved = {name: getattr(near, name) * factor for name, factor in factors.items()}
    return replace(test, near_stall=near.model_copy(update=moved))


@pytest.mark.parametrize("name", CLEAN)
def test_clean_records_have_the_levels_of_a_machine(name: str) -> None:
    assert flagged(*clean_record(name)) == []


@pytest.mark.parametrize("factor", [0.9, 0.97, 1.03, 1.15])
@pytest.mark.parametrize("plane", [25, 31])
@pytest.mark.parametrize("name", ["985/1", "90/1", "made/1/1", "independent"])
def test_a_wrong_reading_of_the_facility_is_flagged(name: str, plane: int, factor: float) -> None:
    record, test = clean_record(name)
    flags = flagged(record, facility(test, **{f"P{plane}_Pa": factor}))
    (flag,) = [f for f in flags if f.startswith("near stall all probes")]
    share = float(flag.partition("read ")[2].partition("%")[0]) / 100.0
    assert share == pytest.approx(abs(1.0 - 1.0 / factor), abs=0.006)
    assert f"all probes of plane {plane} " in flag
    assert ("above" if factor < 1.0 else "below") in flag
    assert f"P{plane}_Pa of [near_stall]" in flag


@pytest.mark.parametrize("name", ["985/1", "independent"])
def test_the_drift_of_single_amplifiers_is_what_the_match_is_for(name: str) -> None:
    record, test = clean_record(name)
    rng = np.random.default_rng(2)
    for start, drift in (("P31", 20.0), ("P25", 20.0)):
        for _ in range(3):
            shifts = drift * rng.standard_normal(4)
            shifts -= shifts.mean()
            drifted = record
            for pair, shift in zip(("A_tip", "A_hub", "B_tip", "B_hub"), shifts, strict=True):
                drifted = with_channels(
                    drifted, lambda v, s=shift: np.clip(np.round(v + s), 0, 4095), f"{start}_{pair}"
                )
            flags = flagged(drifted, test)
            assert not [f for f in flags if f.startswith("near stall all probes")]
