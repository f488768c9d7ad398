"""The reduction on a record of a rig that shares no code with this project."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shared_data import INDEPENDENT, needs_independent

from classic_ml import LagRegressor
from classic_ml.filters import peak_frequency_hz, power_spectrum
from classic_ml.flow import LBM_KG
from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.reduction import Reduction, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from surge_core.errors import InputError
from surge_core.types import FloatArray

pytestmark = needs_independent

# The window of the paper, which the statements about this record refer to.
PAPER_S = (1.8, 3.6)
PHI = np.array([0.0, 0.05, 0.10, 0.15])
TRUTH = 1.2135 + 2.941 * PHI + 47.358 * PHI**2


@pytest.fixture(scope="module")
def raw() -> tuple[Record, TestDescription]:
    """The record with the paper's threshold, which its test.toml leaves to be estimated."""
    record, test = read_raw(INDEPENDENT / "raw.csv", INDEPENDENT / "test.toml")
    return record, replace(test, threshold_lbm_s=50.0)


@pytest.fixture(scope="module")
def paper(raw: tuple[Record, TestDescription]) -> Reduction:
    return reduce_record(*raw, ReductionSettings(window_s=PAPER_S))


def near_stall(record: Record, name: str) -> float:
    return float(np.mean(record[name][record.time_s <= 0.14]))


def in_window(reduction: Reduction, name: str) -> FloatArray:
    return reduction.record[name][reduction.record["window"] > 0.5]


def characteristic(reduction: Reduction) -> tuple[float, FloatArray]:
    rows = reduction.series.scored
    # The paper's way to the letter: Eq 9 and a recursion of C that starts from zero.
    fit = LagRegressor(1e-3, noise="armax", degree=2, hold="zero", exact_start=False).fit(
        reduction.series.phi[rows][:, None],
        reduction.series.psi_p[rows],
        segments=reduction.series.segment[rows],
    )
    return fit.time_constant_s_, fit.characteristic(PHI)[0]


def test_near_stall_is_the_facility_s_reading(paper: Reduction) -> None:
    record = paper.record
    assert near_stall(record, "P25_Pa") == pytest.approx(55_000.32, rel=1e-4)
    assert near_stall(record, "T25_K") == pytest.approx(255.0, abs=0.05)
    assert near_stall(record, "P31_Pa") == pytest.approx(1_285_261.4, rel=1e-4)
    assert near_stall(record, "T31_K") == pytest.approx(698.387, abs=0.1)
    assert near_stall(record, "pressure_ratio") == pytest.approx(23.368, rel=2e-4)
    assert near_stall(record, "Nc_frac") == pytest.approx(0.985, abs=2e-4)
    assert near_stall(record, "phi") == pytest.approx(0.443, abs=0.002)


def test_near_stall_flow_is_112_lbm_s_and_the_same_at_both_planes(paper: Reduction) -> None:
    record = paper.record
    assert near_stall(record, "Wc25_kg_s") / LBM_KG == pytest.approx(112.0, abs=0.3)
    assert near_stall(record, "W25_kg_s") == pytest.approx(29.3, abs=0.1)
    ratio = near_stall(record, "W31_kg_s") / near_stall(record, "W25_kg_s")
    assert ratio == pytest.approx(1.0, abs=0.01)


def test_the_window_is_found_where_the_cycles_repeat(raw: tuple[Record, TestDescription]) -> None:
    reduction = reduce_record(*raw)
    entry = next(e for e in reduction.record.history if e.step == "window")
    start, stop = reduction.window_s
    # The paper: about 1.4 s from the first instability to quasi-steady cycles; here 0.9.
    assert 0.8 < start - 0.304 < 1.5
    assert start < PAPER_S[0]
    assert stop > PAPER_S[1]
    assert 17 <= int(entry.parameters["n_cycles"]) <= 19
    assert reduction.series.n_segments == pytest.approx(18, abs=1)


def test_the_spectrum_has_the_cells_their_harmonic_and_the_surge(paper: Reduction) -> None:
    frequency, density = power_spectrum(in_window(paper, "P25_unfiltered_Pa"), 1000.0)
    assert frequency[1] == pytest.approx(0.625)
    assert peak_frequency_hz(frequency, density, 3, 10) == pytest.approx(6.9, abs=0.2)
    assert peak_frequency_hz(frequency, density, 10, 20) == pytest.approx(13.8, abs=0.3)
    assert peak_frequency_hz(frequency, density, 60, 120) == pytest.approx(82.5, abs=0.7)
    assert peak_frequency_hz(frequency, density, 120, 250) == pytest.approx(165.0, abs=1.0)


@pytest.mark.parametrize("phase", ["zero", "causal"])
def test_the_classical_estimate_is_what_is_known_of_it(
    raw: tuple[Record, TestDescription], phase: str
) -> None:
    """30 ms instead of 18 from the classical way, with a curve that is nearly right."""
    settings = ReductionSettings(
        window_s=PAPER_S, phase=phase, thermocouple_inversion=False, hysteresis_lbm_s=0.0
    )
    tau_s, curve = characteristic(reduce_record(*raw, settings))
    assert 0.026 < tau_s < 0.036
    assert np.abs(curve - TRUTH).max() < 0.3


def test_the_curve_hardly_depends_on_the_threshold_or_on_hysteresis(
    raw: tuple[Record, TestDescription],
) -> None:
    def curve(threshold: float, hysteresis: float) -> FloatArray:
        settings = ReductionSettings(
            window_s=PAPER_S, threshold_lbm_s=threshold, hysteresis_lbm_s=hysteresis
        )
        return characteristic(reduce_record(*raw, settings))[1]

    base = curve(50.0, 0.0)
    for threshold, hysteresis in ((40.0, 0.0), (45.0, 0.0), (55.0, 0.0), (50.0, 8.0)):
        assert np.abs(curve(threshold, hysteresis) - base).max() < 0.1


def test_ten_percent_more_inlet_pressure_would_clip_and_is_refused(
    raw: tuple[Record, TestDescription],
) -> None:
    record, test = raw
    raised = []
    for probe in test.pressures:
        if probe.plane == 25:
            gain = (probe.calibrate_count - probe.zero_count) / probe.calibrate_pressure_Pa
            offset = 0.1 * gain * probe.zoc_reference_Pa
            codes = 1.1 * (record[probe.name] - probe.zero_count) + probe.zero_count + offset
            raised.append(Channel(probe.name, np.clip(np.round(codes), 0, 4095), "count"))
    reading = test.near_stall.model_copy(update={"P25_Pa": 1.1 * test.near_stall.P25_Pa})
    with pytest.raises(InputError, match=r"P25_._tip_.*: .* last tip pair .* clipped in \d+ of"):
        reduce_record(
            record.after(LedgerEntry("raise", "P25 by 10 %"), add=raised),
            replace(test, near_stall=reading),
            ReductionSettings(window_s=PAPER_S),
        )


def test_the_estimated_threshold_agrees_with_the_machine_better_than_the_paper_s(
    raw: tuple[Record, TestDescription],
) -> None:
    record, test = raw
    wrong = []
    for stated in (None, 50.0):
        reduction = reduce_record(record, replace(test, threshold_lbm_s=stated))
        wrong.append(in_window(reduction, "in_stall") != in_window(reduction, "stalled"))
    assert np.mean(wrong[0]) < min(np.mean(wrong[1]), 0.05)
