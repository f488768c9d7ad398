"""Cautions: how often they fire on clean records, what they see, and their sentences."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, flow, lagged
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt

from classic_ml.records import Dropped, LedgerEntry
from comparisons.harness.cautions import filter_cautions, tau_caution, unknown_work
from comparisons.results import Caution, FitRows, texts_of

N = 3000


def rows_of(phi: np.ndarray, measured: np.ndarray, n_segments: int = 6) -> FitRows:
    n = phi.size
    return FitRows(
        phi,
        measured,
        PERIOD_S * np.arange(n),
        np.arange(n) * n_segments // n,
        np.zeros(n, dtype=np.int64),
        PERIOD_S,
        "psi_p",
        np.ones(n, dtype=np.bool_),
    )


def record(seed: int, n: int = N) -> tuple[np.ndarray, np.ndarray]:
    """φ with a little noise, ψ' with white noise."""
    rng = np.random.default_rng(seed)
    phi = flow(n, rng)
    psi_p = lagged(phi, "first") + 0.003 * rng.standard_normal(n)
    return phi + 0.002 * rng.standard_normal(n), psi_p


def low_pass(values: np.ndarray, phase: str) -> np.ndarray:
    sections = butter(5, 48.0, fs=1.0 / PERIOD_S, output="sos")
    if phase == "zero":
        return sosfiltfilt(sections, values)
    return sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0]


@pytest.mark.parametrize("phase", ["causal", "zero"])
def test_filtering_the_coefficient_alone_is_seen(phase: str) -> None:
    for seed in range(4):
        phi, psi_p = record(seed)
        found = filter_cautions(rows_of(phi, low_pass(psi_p, phase)))
        assert [caution.code for caution in found] == ["psi_low_passed"]


def test_filtering_both_alike_or_none_is_not_held_against_them() -> None:
    alarms = 0
    for seed in range(8):
        phi, psi_p = record(seed)
        alarms += bool(filter_cautions(rows_of(phi, psi_p)))
        alarms += bool(filter_cautions(rows_of(low_pass(phi, "causal"), low_pass(psi_p, "causal"))))
    assert alarms <= 1


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


def test_a_low_pass_in_the_ledger_makes_the_tau_of_the_pressure_coefficient_doubtful() -> None:
    def ledger(cutoff: float, step: str = "filter", phase: str = "zero") -> list[LedgerEntry]:
        return [
            LedgerEntry("read", ""),
            LedgerEntry(step, "", {"phase": phase, "cutoff_hz": cutoff}),
        ]

    found = tau_caution([ledger(60.0), ledger(48.0), ledger(48.0), []])
    assert found is not None
    assert found.numbers["cutoff_hz"] == "48 and 60"
    assert tau_caution([ledger(48.0)], target="psi") is None
    assert tau_caution([ledger(48.0, phase="none"), ledger(48.0, "calibrate"), []]) is None


def test_why_the_work_coefficient_is_not_known() -> None:
    choice = LedgerEntry(
        "choose channels",
        "",
        dropped=(Dropped("pair A", 3, "stuck"), Dropped("T31_A", 2615, "beyond its limits")),
    )
    gone = LedgerEntry("work coefficient", "ψ is not known", {}, (Dropped("ψ", 9, "no W31"),))
    found = unknown_work([choice, gone])
    assert found is not None
    assert found.text == "ψ is not known: no W31 (T31_A: beyond its limits)"
    known = LedgerEntry("work coefficient", "ψ by the temperature rise", {}, gone.dropped)
    assert unknown_work([choice, known]) is None
