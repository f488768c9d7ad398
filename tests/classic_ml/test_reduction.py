"""From counts back to the coefficients that made them, with every switch doing what it says."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from raw_data import INERTIA_PER_M, U_M_S, RawTest, make_test

from classic_ml.filters import low_pass
from classic_ml.flow import LBM_KG
from classic_ml.reduction import Reduction, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(cells_lbm_s=8.0, noise_counts=1.5, lag_thermocouples=True)


def reduced(made: RawTest, **settings: Any) -> Reduction:
    return reduce_record(*made.load(), ReductionSettings(**settings))


def rms(made: RawTest, reduction: Reduction, name: str, late: int = 0) -> float:
    """Return the rms error in the segments, the reduction taken ``late`` rows later."""
    rows = np.flatnonzero(reduction.series.scored)
    rows = rows[rows + late < reduction.series.n_samples]
    error = getattr(reduction.series, name)[rows + late] - made.truth[name][rows]
    return float(np.sqrt(np.mean(error**2)))


def test_without_noise_and_filter_the_coefficients_come_back() -> None:
    ideal = make_test(quantise=False, lag_thermocouples=True)
    reduction = reduced(ideal, phase="none", thermocouple_inversion=True)
    # What is left is the dead band of the probes, |M| < b, where the flow cannot be seen.
    assert rms(ideal, reduction, "phi") < 0.002
    assert rms(ideal, reduction, "psi_p") < 0.015
    fast = np.abs(ideal.truth["phi"]) > 0.12
    fast &= reduction.record["window"] > 0.5
    error = reduction.series.phi[fast] - ideal.truth["phi"][fast]
    assert np.abs(error).max() < 5e-4


@pytest.mark.parametrize("order", [3, 5])
def test_the_zero_phase_filter_keeps_phi_within_0_02(made: RawTest, order: int) -> None:
    reduction = reduced(made, filter_order=order)
    assert rms(made, reduction, "phi") < 0.02
    assert rms(made, reduction, "psi_p") < 0.06


@pytest.mark.parametrize(("order", "delay"), [(3, 7), (5, 11)])
def test_the_causal_filter_delays_and_does_little_else(
    made: RawTest, order: int, delay: int
) -> None:
    reduction = reduced(made, phase="causal", filter_order=order)
    assert rms(made, reduction, "phi") > 0.03
    assert rms(made, reduction, "phi", late=delay) < 0.02
    assert rms(made, reduction, "psi_p", late=delay) < 0.06


def test_filter_first_and_flow_afterwards() -> None:
    """The filter acts on the pressures: near zero flow that is not the filtered flow."""
    rough = make_test(cells_lbm_s=8.0, quantise=False)
    record = reduced(rough).record
    other = low_pass(record["Wc25_unfiltered_kg_s"], 1000.0, order=3, cutoff_hz=48.0, phase="zero")
    window = record["window"] > 0.5
    assert np.abs(other - record["Wc25_kg_s"])[window].max() > 2 * LBM_KG


def test_without_an_unstalled_regime_there_is_one_segment(made: RawTest) -> None:
    description = {**made.description, "segmentation": {"threshold_lbm_s": "none"}}
    told = dataclasses.replace(made, description=description)
    for reduction in (reduced(told), reduced(made, threshold_lbm_s="none")):
        assert reduction.series.n_segments == 1
        assert reduction.series.scored.sum() == (reduction.record["window"] > 0.5).sum()
    # A number in the settings wins over the file.
    assert reduced(told, threshold_lbm_s=50.0).series.n_segments > 10


def test_a_window_is_taken_from_settings_then_file_then_cycles(made: RawTest) -> None:
    description = {**made.description, "window": {"from_s": 1.2, "to_s": 2.2}}
    told = dataclasses.replace(made, description=description)
    assert reduced(told).window_s == (1.2, 2.2)
    assert reduced(told, window_s=(1.0, 2.0)).window_s == (1.0, 2.0)
    found = reduced(made)
    assert found.window_s != (1.2, 2.2)
    origins = [e.parameters["origin"] for e in found.record.history if e.step == "window"]
    assert origins == ["found"]
    with pytest.raises(InputError, match="a window with surge cycles inside the record"):
        reduced(made, window_s=(2.0, 30.0))


def test_the_work_coefficient_follows_the_temperature_rise() -> None:
    ideal = make_test(quantise=False, lag_thermocouples=True)
    reduction = reduced(ideal, phase="none", thermocouple_inversion=True, work_form="exit-flow")
    series = reduction.series
    assert series.psi is not None
    assert np.all(np.isfinite(series.psi))
    rows = np.flatnonzero(series.scored & (series.phi > 0.15))
    heat = 1.4 * 287.05 / 0.4
    truth = ideal.truth
    # The made-up exit flow stores nothing, so that only the pressure's own storage is left.
    delivered = truth["P31"] + INERTIA_PER_M * np.gradient(truth["W25_kg_s"], 1e-3)
    storage = 0.08 / 0.4 * np.gradient(0.5 * (truth["P25"] + delivered), 1e-3)
    rise = truth["T31"] - truth["T25"] + storage / heat / truth["W25_kg_s"]
    expected = 2 * heat / U_M_S**2 * rise
    assert np.median(np.abs(series.psi[rows] - expected[rows])) < 0.01


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"filter_order": 4}, "filter_order: expected one of 3, 5, found 4"),
        ({"phase": "both"}, "phase: expected one of 'zero', 'causal', 'none', found 'both'"),
        ({"cutoff_hz": 0.5}, "cutoff_hz: expected at least 1 Hz"),
        ({"cutoff_hz": float("nan")}, "cutoff_hz"),
        ({"threshold_lbm_s": -1.0}, "threshold_lbm_s"),
        ({"threshold_lbm_s": "off"}, "threshold_lbm_s"),
        ({"hysteresis_lbm_s": -1.0}, "hysteresis_lbm_s: expected a positive number"),
        ({"window_s": (2.0, 1.0)}, "window_s: expected two times, the earlier first"),
    ],
)
def test_a_setting_that_means_nothing_is_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        ReductionSettings(**settings)


def described(made: RawTest, **tables: Any) -> RawTest:
    return dataclasses.replace(made, description={**made.description, **tables})


def areas(inlet_m2: float, exit_m2: float) -> dict[str, Any]:
    return {"25": {"area_m2": inlet_m2}, "31": {"area_m2": exit_m2}}


@pytest.mark.parametrize("everywhere", [False, True])
def test_probes_with_forward_and_aft_exchanged_are_refused(made: RawTest, everywhere: bool) -> None:
    columns = dict(made.columns)
    names = [n for n in columns if n.endswith("_forward")] if everywhere else ["P25_B_hub_forward"]
    for name in names:
        mate = name.replace("_forward", "_aft")
        columns[name], columns[mate] = columns[mate], columns[name]
    # The zero and calibrate readings go with the wires, or the pressures would be off as well.
    channels = dict(made.description["channels"])
    for name in names:
        mate = name.replace("_forward", "_aft")
        channels[name], channels[mate] = (
            {**channels[mate], "facing": "forward"},
            {**channels[name], "facing": "aft"},
        )
    wrong = dataclasses.replace(described(made, channels=channels), columns=columns)
    with pytest.raises(InputError, match=r"pair P25_\w+: .* are forward and aft exchanged\?"):
        reduced(wrong)


def test_areas_that_do_not_agree_are_refused_or_flagged(made: RawTest) -> None:
    with pytest.raises(InputError, match=r"W25 and W31 within 20% .* kg/s; check area_m2 of"):
        reduced(described(made, planes=areas(0.065, 0.2938)))
    with pytest.raises(InputError, match=r"found 29\.\d* and 22\.\d* kg/s; .*/test.toml"):
        reduced(described(made, planes=areas(0.2938, 0.05)))
    for exit_m2, flags in ((0.065 * 1.1, 1), (0.065 * 0.9, 1), (0.065 * 1.03, 0)):
        history = reduced(described(made, planes=areas(0.2938, exit_m2))).record.history
        entry = next(e for e in history if e.step == "near-stall flow")
        assert len(entry.flags) == flags


def test_without_t31_areas_that_do_not_agree_are_flagged(made: RawTest) -> None:
    limits = {"T31_A": [200.0, 620.0], "T31_B": [200.0, 620.0]}
    for inlet_m2, flags in ((0.2938, 0), (0.6, 1)):
        told = described(made, limits=limits, planes=areas(inlet_m2, 0.065))
        history = reduced(told, threshold_lbm_s=100.0).record.history
        entry = next(e for e in history if e.step == "near-stall flow")
        assert len(entry.flags) == flags
        assert "with the facility's T31" in entry.did


def test_a_flow_coefficient_that_no_compressor_has_is_refused(made: RawTest) -> None:
    for key, value in (("mean_radius_m", 0.028), ("mean_radius_m", 1.8)):
        machine = {**made.description["compressor"], key: value}
        with pytest.raises(InputError, match=r"φ near stall: expected 0.1 to 1.5, .*mean_radius_m"):
            reduced(described(made, compressor=machine))


def test_regimes_that_were_not_split_are_flagged(made: RawTest) -> None:
    def flags(**settings: Any) -> tuple[str, ...]:
        history = reduced(made, **settings).record.history
        return next(entry.flags for entry in history if entry.step == "segment")

    assert flags() == ()
    assert "all rows in the window are in stall" in flags(threshold_lbm_s=1e9)[0]
    assert "no unstalled regime was declared" in flags(threshold_lbm_s="none")[0]
