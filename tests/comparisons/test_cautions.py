"""Cautions said once, and the filter found in the ledger."""

from __future__ import annotations

import pytest

from classic_ml.records import LedgerEntry
from comparisons.cautions import grouped_cautions, low_pass_before_flow, tau_caution


def test_many_of_a_kind_become_one_that_names_all_channels() -> None:
    cautions = [f"a.csv: P25_{i}: {3 + i} rows clipped" for i in range(8)]
    (grouped,) = grouped_cautions(cautions)
    assert all(f"P25_{i}" in grouped for i in range(8))
    assert "3 rows clipped" in grouped
    assert "see the ledger" in grouped


def test_different_kinds_and_records_stay_apart() -> None:
    cautions = [
        *(f"a.csv: P{i}: stuck" for i in range(3)),
        *(f"b.csv: P{i}: stuck" for i in range(3)),
        "the estimators disagree",
        "a.csv: T25: stuck at 3 K",
    ]
    grouped = grouped_cautions(cautions)
    assert grouped[:2] == ("the estimators disagree", "a.csv: T25: stuck at 3 K")
    assert len(grouped) == 4
    assert "see the ledger" not in grouped[2]  # they say the very same


def test_few_are_left_as_they_are() -> None:
    cautions = ("a.csv: P1: stuck", "a.csv: P2: stuck")
    assert grouped_cautions(cautions) == cautions


@pytest.mark.parametrize(
    ("entry", "cutoff"),
    [
        (LedgerEntry("filter", "", {"phase": "zero", "cutoff_hz": 48.0}), 48.0),
        (LedgerEntry("filter", "", {"phase": "none"}), None),
        (LedgerEntry("filter", "", {"phase": "none", "cutoff_hz": 48.0}), None),
        (LedgerEntry("calibrate", "", {"cutoff_hz": 48.0}), None),
    ],
)
def test_the_filter_is_found_in_the_ledger(entry: LedgerEntry, cutoff: float | None) -> None:
    assert low_pass_before_flow([LedgerEntry("read", ""), entry]) == cutoff


def test_every_cutoff_is_named_once() -> None:
    histories = [
        [LedgerEntry("filter", "", {"phase": "zero", "cutoff_hz": cutoff})]
        for cutoff in (60.0, 48.0, 48.0)
    ]
    caution = tau_caution([*histories, []])
    assert caution is not None
    assert "low-passed at 48 and 60 Hz" in caution
    assert tau_caution([[]]) is None
