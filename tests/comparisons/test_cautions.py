"""Cautions: how often they fire on clean records, what they see, and their sentences."""

from __future__ import annotations

import numpy as np
import pytest
from comparison_data import fit_rows
from lag_data import PERIOD_S, flow, lagged
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt

from classic_ml.records import LedgerEntry
from comparisons.harness.cautions import filter_cautions, tau_caution

N = 3000


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
        found = filter_cautions(fit_rows(phi, low_pass(psi_p, phase), 6))
        assert [caution.code for caution in found] == ["psi_low_passed"]


def test_filtering_both_alike_or_none_is_not_held_against_them() -> None:
    alarms = 0
    for seed in range(8):
        phi, psi_p = record(seed)
        alarms += bool(filter_cautions(fit_rows(phi, psi_p, 6)))
        alike = [low_pass(values, "causal") for values in (phi, psi_p)]
        alarms += bool(filter_cautions(fit_rows(*alike, 6)))
    assert alarms <= 1


def test_a_low_pass_in_the_ledger_makes_the_tau_of_the_pressure_coefficient_doubtful() -> None:
    def ledger(cutoff: float, step: str = "filter", phase: str = "zero") -> list[LedgerEntry]:
        filtered = LedgerEntry(step, "", {"phase": phase, "cutoff_hz": cutoff})
        return [LedgerEntry("read", ""), filtered]

    found = tau_caution([ledger(60.0), ledger(48.0), ledger(48.0), []])
    assert found is not None
    assert found.numbers["cutoff_hz"] == "48 and 60"
    assert tau_caution([ledger(48.0)], target="psi") is None
    assert tau_caution([ledger(48.0, phase="none"), ledger(48.0, "calibrate"), []]) is None
