"""Cautions said once, and the filter found in the ledger."""

from __future__ import annotations

import pytest

from classic_ml.records import Dropped, LedgerEntry
from comparisons.harness.cautions import low_pass_before_flow, tau_caution, unknown_work
from comparisons.results import Caution, texts_of


def test_each_code_has_a_sentence_that_its_numbers_fill() -> None:
    speeds = Caution.of("speeds_apart", low_percent=70.2, high_percent=98.5)
    assert "between 70 and 98 % corrected speed" in str(speeds)
    assert Caution.of("odd_rate", "a.csv", rate_hz=1.0).text.startswith("a.csv: 1 rows a second")


def test_findings_of_one_step_are_one_sentence_that_counts_the_rest() -> None:
    def finding(record: str, step: str, text: str) -> Caution:
        return Caution("ledger", record, step, {"finding": text})

    cautions = [
        Caution.of("no_ledger", "c.csv"),
        *(finding("a.csv", "inspect", f"P{i}: {i} rows clipped") for i in range(8)),
        finding("b.csv", "inspect", "P0: 0 rows clipped"),
        finding("a.csv", "segment", "no threshold"),
        finding("a.csv", "segment", "no threshold"),
    ]
    first, *others = texts_of(cautions)
    assert first == cautions[0].text
    assert others == [
        "a.csv: P0: 0 rows clipped; P1: 1 rows clipped; P2: 2 rows clipped; and 5 more of the "
        "step “inspect” in the ledger",
        "b.csv: P0: 0 rows clipped",
        "a.csv: no threshold",
    ]


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
    assert "low-passed at 48 and 60 Hz" in caution.text
    assert tau_caution([[]]) is None


def test_only_the_time_constant_of_the_pressure_coefficient_is_said_to_be_high() -> None:
    histories = [[LedgerEntry("filter", "", {"phase": "zero", "cutoff_hz": 48.0})]]
    assert tau_caution(histories, target="psi") is None
    assert tau_caution(histories, target="psi_p") == tau_caution(histories) is not None


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
    found = unknown_work([choice, gone])
    assert found is not None
    assert found.text.startswith("ψ is not known: no W31 (T31_A: beyond its limits in 2615 of")
    alone = unknown_work([gone])
    assert alone is not None
    assert alone.text == "ψ is not known: no W31"
    known = LedgerEntry("work coefficient", "ψ by the temperature rise", {}, gone.dropped)
    assert unknown_work([choice, known]) is None
