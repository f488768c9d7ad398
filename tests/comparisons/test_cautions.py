"""Cautions said once, and the filter found in the ledger."""

from __future__ import annotations

import dataclasses

import pytest
from comparison_data import made_comparison

from classic_ml.records import Dropped, LedgerEntry
from comparisons.harness.cautions import (
    grouped_cautions,
    low_pass_before_flow,
    ranking_caution,
    tau_caution,
    unknown_work,
)


def test_many_of_a_kind_become_one_that_counts_the_channels() -> None:
    cautions = [f"a.csv: P25_{i}: {13 - i} rows clipped" for i in range(8)]
    assert grouped_cautions(cautions) == ("a.csv: P25_0 and 7 more channels: 6 to 13 rows clipped",)


def test_a_span_of_several_channels_holds_that_of_each() -> None:
    cautions = [
        "a.csv: P1: 43 rows clipped, 0.451 to 0.621 s",
        "a.csv: P2: 43 rows clipped, 0.442 to 0.509 s",
        "a.csv: P3: 43 rows clipped, 0.500 to 10.733 s",
    ]
    assert grouped_cautions(cautions) == (
        "a.csv: P1 and 2 more channels: 43 rows clipped, 0.442 to 10.733 s",
    )


def test_a_fault_and_its_place_to_the_window_are_one_caution() -> None:
    outside = "faulty rows outside the window only"
    inside = "3 faulty rows in the window, few enough to keep it"
    cautions = [
        *(f"a.csv: P{i}: {i} rows clipped" for i in range(1, 5)),
        "a.csv: T25: stuck or dropped out",
        "a.csv: P1: stuck or dropped out",
        *(f"a.csv: P{i}: {outside}" for i in range(1, 4)),
        f"a.csv: P4: {inside}",
        f"a.csv: P9: {outside}",
        f"b.csv: P2: {outside}",
    ]
    assert grouped_cautions(cautions) == (
        f"a.csv: P4: 4 rows clipped ({inside})",
        "a.csv: T25: stuck or dropped out",
        "a.csv: P1: stuck or dropped out (outside the window)",
        f"a.csv: P9: {outside}",
        f"b.csv: P2: {outside}",
        "a.csv: P1 and 2 more channels: 1 to 3 rows clipped (outside the window)",
    )


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
    assert grouped[2] == "a.csv: P0 and 2 more channels: stuck"


def test_two_are_both_named_and_one_is_left_as_it_is() -> None:
    cautions = ("a.csv: P1: stuck", "a.csv: P2: stuck")
    assert grouped_cautions(cautions) == ("a.csv: P1 and P2: stuck",)
    assert grouped_cautions(cautions[:1]) == cautions[:1]


def test_prose_with_colons_names_no_channel() -> None:
    cautions = [f"{name}.csv: the flows disagree by {i} %: ψ is off" for i, name in enumerate("ab")]
    assert grouped_cautions([*cautions, "x", "x"]) == (*cautions, "x")


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


def test_only_the_time_constant_of_the_pressure_coefficient_is_said_to_be_high() -> None:
    histories = [[LedgerEntry("filter", "", {"phase": "zero", "cutoff_hz": 48.0})]]
    assert tau_caution(histories, target="psi") is None
    assert tau_caution(histories, target="psi_p") == tau_caution(histories) is not None


def test_what_the_ranking_means_is_said_where_the_best_failed_a_check() -> None:
    passed = made_comparison()
    assert ranking_caution(passed) is None  # the second fails, and is not ranked first
    turned = dataclasses.replace(passed, table=passed.table[1::-1])
    assert "not how near the characteristic is" in (ranking_caution(turned) or "")


def test_why_the_work_coefficient_is_not_known() -> None:
    choice = LedgerEntry(
        "choose channels",
        "",
        dropped=(
            Dropped("pair A", 3, "P25_A is stuck"),
            Dropped("T31_A", 2615, "beyond its limits in 2615 of 2758 rows in the window"),
            Dropped("T31_B", 2612, "beyond its limits in 2612 of 2758 rows in the window"),
            Dropped("W31 and ψ", 4001, "no thermocouple left there"),
        ),
    )
    gone = LedgerEntry("work coefficient", "ψ is not known", {}, (Dropped("ψ", 9, "no W31"),))
    assert unknown_work([choice, gone]) == (
        "ψ is not known: no W31 (T31_A and T31_B: beyond their limits in 2612 to 2615 of 2758 rows "
        "in the window)."
    )
    assert unknown_work([gone]) == "ψ is not known: no W31."
    known = LedgerEntry("work coefficient", "ψ by the temperature rise", {}, gone.dropped)
    assert unknown_work([choice, known]) is None
