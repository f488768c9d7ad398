"""Surge cycles of whole records and of their beginnings, in which stall oscillates mildly."""

from __future__ import annotations

import pytest
from clean_records import SURGES, clean_record
from rig_records import rig_record

from classic_ml.records import LedgerEntry, Record
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError

# Cycles and their period in ms, as found before mild oscillations were told from them.
WHOLE = {
    "independent": (18, 147),
    "985/1": (19, 144),
    "985/2": (19, 144),
    "90/1": (16, 134),
    "90/3": (16, 134),
    "95/1": (30, 111),
    "985-second/1": (17, 143),
    "blowdown/1": (8, 189),
    "blowdown/2": (8, 189),
    "made/0/0": (16, 140),
    "made/1/1": (16, 140),
    "made/2/5": (16, 140),
}
# Those of which the stall oscillates for a second or more before the cycles begin.
OSCILLATING = ("independent", "985/1", "985/2", "985-second/1")


def found(record: Record, name: str) -> LedgerEntry:
    history = reduce_record(record, clean_record(name)[1]).record.history
    return next(entry for entry in history if entry.step == "window")


def head(name: str, n_rows: int) -> Record:
    return clean_record(name)[0].part(slice(0, n_rows))


@pytest.mark.parametrize("name", SURGES)
def test_the_cycles_of_whole_records_are_found_at_all_speeds(name: str) -> None:
    n_cycles, period_ms = WHOLE[name]
    entry = found(clean_record(name)[0], name)
    assert entry.parameters["n_cycles"] == n_cycles
    assert f"cycles of {period_ms} ms" in entry.did


@pytest.mark.parametrize("n_rows", [760, 950, 1100, 1200, 1350, 1501])
@pytest.mark.parametrize("name", OSCILLATING)
def test_mild_oscillations_in_stall_are_no_cycles(name: str, n_rows: int) -> None:
    """They are as regular as cycles, and run backwards now and then; but never pump."""
    with pytest.raises(InputError, match=r"at least 3 surge cycles .* found [01] beside \d+ mild"):
        reduce_record(head(name, n_rows), clean_record(name)[1])


def test_a_machine_that_oscillates_mildly_for_good_is_reduced_and_it_is_said() -> None:
    """With a strong hysteresis the case of 98.5 % speed settles on small limit cycles."""
    record, test = rig_record("985", 3, hide="hysteresis")
    history = reduce_record(record, test).record.history
    entry = next(entry for entry in history if entry.step == "window")
    assert int(entry.parameters["n_cycles"]) > 30
    (flag,) = entry.flags
    assert "no deep surge cycle is in the record" in flag
    # The beginning of the same record may still become a deep surge.
    short = record.part(slice(0, 1200))
    with pytest.raises(InputError, match=r"found 0 beside \d+ mild oscillations"):
        reduce_record(short, test)


@pytest.mark.parametrize("n_rows", [2100, 2600, 2950])
@pytest.mark.parametrize("name", SURGES)
def test_the_first_cycles_are_found_without_the_later_ones(name: str, n_rows: int) -> None:
    period_ms = float(found(head(name, n_rows), name).did.partition("cycles of ")[2].split()[0])
    # They settle within a second or two: 98 to 134 ms at 90 %, 244 to 189 ms in the blowdown.
    assert 0.7 * WHOLE[name][1] < period_ms < 1.3 * WHOLE[name][1]
