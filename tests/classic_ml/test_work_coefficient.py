"""The work characteristic: exact recovery from made-up planes, and from the rig's raw counts."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from raw_data import GAMMA, GAS, U_M_S, make_test
from rig_records import rig_record, rig_run

from classic_ml.flow import corrected_flow
from classic_ml.io import TestDescription
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.reduction import Reduction, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.work.balance import (
    EXIT_WEIGHT,
    MIXING_PHI,
    delivered_power,
    flat_average,
    with_work,
)
from classic_ml.work.coefficient import WorkCharacteristic, fit_work_characteristic
from comparisons.show.json_output import work_document
from comparisons.show.table import work_table
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.fit_state import FitState

HEAT = GAMMA * GAS / (GAMMA - 1)
HEAD = 2 * HEAT / U_M_S**2
RATE_HZ = 1000.0
CELL_HZ = 82.5
TAU_S = 0.018
# Value at zero flow and slopes, breaks: those of the rig.
BETA, BREAKS = np.array([3.4, -12.0, 4.0, -3.0]), (0.05, 0.125)
PHI = np.array([0.02, 0.05, 0.1])


def curve(phi: np.ndarray) -> np.ndarray:
    pieces = np.minimum(phi, 0.05), np.clip(phi - 0.05, 0, 0.075), np.maximum(phi - 0.125, 0)
    return BETA[0] + sum(b * p for b, p in zip(BETA[1:], pieces, strict=True))


def lagged(inputs: np.ndarray, tau_s: float) -> np.ndarray:
    """The lag by a plain loop, straight lines between samples, on a grid ten times as fine."""
    fine = np.interp(np.arange(10 * inputs.size - 9) / 10, np.arange(inputs.size), inputs)
    step = 0.1 / RATE_HZ / tau_s
    state, out = fine[0], np.empty_like(fine)
    out[0] = state
    for k in range(1, fine.size):
        middle = 0.5 * (fine[k - 1] + fine[k])
        state += step / (1 + 0.5 * step) * (middle - state)
        out[k] = state
    return out[::10]


@cache
def planes(
    tau_s: float = TAU_S, size: float = 1.0, seconds: float = 3.0
) -> tuple[Record, TestDescription]:
    """Plane averages of stall cycles whose ψ follows the lag and whose volume stores gas."""
    _, test = make_test(seconds=0.5).load()
    lengths = {
        "internal_volume_m3": size * 0.08,
        "inertia_per_m": test.compressor.inertia_per_m / size,
    }
    machine = test.compressor.model_copy(update=lengths)
    test = replace(
        test,
        compressor=machine,
        areas_m2={plane: size * area for plane, area in test.areas_m2.items()},
    )
    time_s = np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
    angle = 2 * np.pi * 7.0 * time_s
    phi = 0.085 + 0.05 * np.sin(angle) + 0.012 * np.sin(0.61 * angle) + 0.01 * np.sin(2 * angle)
    # Out of stall for 28 ms of each cycle, on a straight branch of its own.
    free = (time_s * 7.0) % 1.0 < 0.2
    psi = lagged(np.where(free, 3.3 + 5.0 * phi, curve(phi)), tau_s)
    inlet_K, inlet_Pa = np.full(time_s.size, 440.0), np.full(time_s.size, 1.2e5)
    exit_Pa = 2.6e5 + 4e4 * np.cos(angle - 0.6)
    static = inlet_K - (phi * U_M_S) ** 2 / (2 * HEAT)
    mach = phi * U_M_S / np.sqrt(GAMMA * GAS * static)
    corrected = corrected_flow(mach, size * 0.2938, machine)
    flow = corrected * inlet_Pa / 101325 * np.sqrt(288.15 / inlet_K)
    surge = machine.inertia_per_m * np.gradient(np.gradient(flow, 1e-3), 1e-3)
    exit_rate = np.gradient(exit_Pa, 1e-3)
    volume = machine.internal_volume_m3 / GAS
    delivered_K = inlet_K + psi / HEAD
    mass = EXIT_WEIGHT * volume / (0.5 * (inlet_K + delivered_K)) * exit_rate
    energy = volume / GAMMA * EXIT_WEIGHT * (exit_rate + surge)
    exit_K = (flow * delivered_K - energy) / (flow - mass)
    stored = EXIT_WEIGHT * volume / (0.5 * (inlet_K + exit_K)) * exit_rate
    ripple = 1 + 0.02 * np.sin(2 * np.pi * CELL_HZ * time_s)
    columns = {
        "P25_Pa": (inlet_Pa, "Pa"),
        "P25_unfiltered_Pa": (inlet_Pa * ripple, "Pa"),
        "P31_Pa": (exit_Pa, "Pa"),
        "T25_K": (inlet_K, "K"),
        "T31_K": (exit_K, "K"),
        "Wc25_kg_s": (corrected, "kg/s"),
        "Wc25_hub_kg_s": (corrected + 5.0, "kg/s"),
        "Wc25_tip_kg_s": (corrected - 5.0, "kg/s"),
        "W25_kg_s": (flow, "kg/s"),
        "W31_kg_s": (flow - stored, "kg/s"),
        "psi_true": (psi, "1"),
        "phi_true": (phi, "1"),
    }
    # In stall the hub passes more than the tip.
    for name, sign in (("Wc25_hub_kg_s", -5.0), ("Wc25_tip_kg_s", 5.0)):
        columns[name] = (columns[name][0] + sign * free, "kg/s")
    return Record.from_arrays(columns, sample_rate_hz=RATE_HZ), test


def everywhere(record: Record) -> np.ndarray:
    return np.ones(record.n_samples, dtype=np.bool_)


def fitted(record: Record, test: TestDescription, **options: float) -> WorkCharacteristic:
    window = everywhere(record)
    window[:100] = window[-100:] = False
    # The made-up gas does not mix at plane 31.
    options = {"mixing_phi": 0.0, **options}
    return fit_work_characteristic(record, test, window, breakpoints=BREAKS, **options)


def test_the_flat_average_removes_cells_and_keeps_parabolas() -> None:
    time_s = np.arange(400) / RATE_HZ
    for harmonic in (1, 2, 3):
        wave = np.sin(2 * np.pi * harmonic * CELL_HZ * time_s + 0.3)
        kept = flat_average(wave, 1 / CELL_HZ, RATE_HZ)[40:-40]
        # The ends of the window get fractional weights, which leaves a few per cent of the higher.
        assert np.max(np.abs(kept)) < (0.01 if harmonic == 1 else 0.15)
    parabola = 3 + 2 * time_s - 40 * time_s**2
    np.testing.assert_allclose(
        flat_average(parabola, 1 / CELL_HZ, RATE_HZ)[40:-40], parabola[40:-40], atol=1e-12
    )


def test_the_delivered_power_is_the_work_that_was_put_in() -> None:
    record, test = planes()
    phi, flow = record["phi_true"], record["W25_kg_s"]
    power = delivered_power(record, test, flow, phi)
    # Far above the mixing flow all of the storage counts; near it a part of some 20 K does.
    rows = phi > 2.5 * MIXING_PHI
    np.testing.assert_allclose((power / flow)[rows], record["psi_true"][rows], atol=0.03)
    rise = HEAD * (record["T31_K"] - record["T25_K"])
    assert np.std((rise - record["psi_true"])[rows]) > 5 * np.std(
        (power / flow - record["psi_true"])[rows]
    )
    light = replace(test, compressor=test.compressor.model_copy(update={"inertia_per_m": 0.0}))
    without = delivered_power(record, light, flow, phi)
    assert np.max(np.abs(without - power)) > 0.1


def test_power_without_storage_is_flow_times_temperature_rise_in_either_direction() -> None:
    record, test = planes()
    flow = np.linspace(-5.0, 5.0, record.n_samples)
    still = replace(test, compressor=test.compressor.model_copy(update={"internal_volume_m3": 0.0}))
    power = delivered_power(record, still, flow, flow / 60.0)
    rise = HEAD * (record["T31_K"] - record["T25_K"])
    np.testing.assert_allclose(power, flow * rise, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("tau_s", [0.012, 0.018, 0.025])
def test_lag_and_curve_come_back_from_planes_without_error(tau_s: float) -> None:
    work = fitted(*planes(tau_s))
    assert work.fit_state is FitState.CONVERGED
    assert work.time_constant_s == pytest.approx(tau_s, rel=0.015)
    # The lowest flow of the made-up cycles is 0.013.
    np.testing.assert_allclose(work.characteristic(PHI)[0], curve(PHI), atol=0.02)
    assert work.terms == ("1", "min(phi,0.05)", "clip(phi-0.05,0,0.075)", "relu(phi-0.125)")
    assert work.n_cycles >= 15
    assert "simulated, not scored" in work.entry.did


def test_a_given_time_constant_is_kept_and_has_no_error() -> None:
    work = fitted(*planes(), time_constant_s=TAU_S)
    assert work.time_constant_s == pytest.approx(TAU_S)
    assert work.time_constant_stderr_s == 0.0
    np.testing.assert_allclose(work.characteristic(PHI)[0], curve(PHI), atol=0.02)
    assert np.all(np.linalg.eigvalsh(work.covariance) > -1e-12)


def test_errors_of_the_flow_do_not_flatten_the_curve() -> None:
    record, test = planes(seconds=8.0)
    rng = np.random.default_rng(3)
    found = []
    for _ in range(4):
        # 1.2 kg/s of 13, correlated over a cell period; the planes' errors are independent.
        noisy = [
            Channel(
                name,
                record[name]
                + 4.0
                * np.convolve(rng.standard_normal(record.n_samples), np.ones(12) / 12, "same"),
                "kg/s",
            )
            for name in ("W25_kg_s", "W31_kg_s")
        ]
        work = fitted(
            record.after(LedgerEntry("test", "noise"), add=noisy), test, time_constant_s=TAU_S
        )
        found.append(work.characteristic(PHI)[0] - curve(PHI))
    # One plane alone would be off by -0.16, 0.09 and -0.02, the mean of both by half of that.
    assert np.all(np.abs(np.mean(found, axis=0)) < [0.08, 0.04, 0.01]), found


def test_where_nothing_is_stored_the_balance_without_storage_is_taken() -> None:
    record, test = planes()
    columns = [
        Channel("T31_K", record["T25_K"] + record["psi_true"] / HEAD, "K"),
        Channel("W31_kg_s", record["W25_kg_s"], "kg/s"),
    ]
    plain = record.after(LedgerEntry("test", "no storage"), add=columns)
    work = fitted(plain, test)
    assert work.entry.parameters["storage_between_planes"] is False
    assert work.time_constant_s == pytest.approx(TAU_S, rel=0.03)
    assert fitted(record, test).entry.parameters["storage_between_planes"] is True


def test_single_impossible_rows_are_left_out_and_many_refused() -> None:
    record, test = planes()

    def spiked(step: int) -> Record:
        flow = record["W31_kg_s"].copy()
        flow[150:-150:step] += 900.0
        spikes = [Channel("W31_kg_s", flow, "kg/s")]
        return record.after(LedgerEntry("test", "spikes"), add=spikes)

    work = fitted(spiked(500), test)
    assert "6 rows left out" in work.entry.flags[0]
    assert work.time_constant_s == pytest.approx(TAU_S, rel=0.02)
    with pytest.raises(InputError, match="more in 10% of the rows"):
        fitted(spiked(10), test)


def test_too_few_cycles_are_answered_by_a_code() -> None:
    record, test = planes()
    window = np.zeros(record.n_samples, dtype=np.bool_)
    window[200:500] = True
    work = fit_work_characteristic(record, test, window, breakpoints=BREAKS)
    assert work.fit_state is FitState.TOO_FEW_CYCLES
    assert np.isnan(work.time_constant_s)
    assert np.isnan(work.characteristic(PHI)[0]).all()


@pytest.mark.parametrize(
    ("tau_s", "state"), [(0.0005, FitState.AT_LOWER_BOUND), (0.6, FitState.AT_UPPER_BOUND)]
)
def test_a_fit_that_ends_at_a_bound_states_no_number(tau_s: float, state: FitState) -> None:
    work = fitted(*planes(tau_s))
    assert work.fit_state is state
    assert np.isnan(work.time_constant_s)
    assert np.isnan(work.characteristic(PHI)).all()
    text = work_table(work)
    assert "not stated" in text
    assert state.advice in text
    document = json.loads(to_strict_json(work_document(work, "planes")))
    assert document["time_constant_s"] == {"value": None, "stderr": None}
    assert set(document["characteristic"]["psi"]) == {None}
    assert document["state"]["code"] == state.code


@pytest.mark.parametrize("bad", [-18e-3, float("nan"), 5.0])
def test_a_tau_that_is_not_positive_or_longer_than_a_cycle_is_refused(bad: float) -> None:
    with pytest.raises(InputError, match=r"a positive number|shorter than a surge cycle"):
        fitted(*planes(), time_constant_s=bad)


def test_breakpoints_out_of_order_are_refused() -> None:
    record, test = planes()
    with pytest.raises(InputError, match="increasing flow coefficients"):
        fit_work_characteristic(record, test, everywhere(record), breakpoints=(0.1, 0.05))


@cache
def rig_reduction(case: str, seed: int) -> Reduction:
    settings = ReductionSettings(phase="none", thermocouple_inversion=True)
    return reduce_record(*rig_record(case, seed), replace(settings, window_s=(1.2, 4.0)))


@cache
def rig_work(seed: int) -> WorkCharacteristic:
    reduction = rig_reduction("90", seed)
    record = reduction.record
    return fit_work_characteristic(
        record, reduction.test, record["window"] > 0.5, breakpoints=BREAKS
    )


SEEDS = (0, 1, 2, 3, 4, 5)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_rig_s_work_characteristic_comes_back_from_raw_counts(seed: int) -> None:
    work = rig_work(seed)
    error = work.characteristic(PHI)[0] - curve(PHI)
    # At the bend, 0.05, the noise of φ flattens the curve: 0.1 on average, ± 0.1 between seeds.
    assert np.all(np.abs(error) < [0.2, 0.4, 0.1]), error
    assert abs(work.time_constant_s - TAU_S) < 0.006
    assert work.valid_phi[0] < 0.03
    assert work.valid_phi[1] > 0.1


def test_errors_of_the_rig_s_characteristic_are_stated_over_seeds() -> None:
    works = [rig_work(seed) for seed in SEEDS]
    value, stderr = (np.array(v) for v in zip(*(w.characteristic(PHI) for w in works), strict=True))
    error = value - curve(PHI)
    assert np.all(np.abs(error.mean(axis=0)) < [0.15, 0.2, 0.05])
    z = np.sqrt(np.mean((error / stderr) ** 2, axis=0))
    assert np.all(z < 2.0), z
    tau = np.array([w.time_constant_s for w in works])
    tau_stderr = np.array([w.time_constant_stderr_s for w in works])
    assert abs(tau.mean() - TAU_S) < 0.003
    assert np.sqrt(np.mean(((tau - TAU_S) / tau_stderr) ** 2)) < 1.5


def test_the_mass_balance_shows_psi_row_by_row_where_the_other_forms_do_not() -> None:
    reduction, truth = rig_reduction("90", 0), rig_run("90").truth
    record = reduction.record
    rows = (record["window"] > 0.5) & (truth["in_stall"] > 0.5)
    rows &= (truth["phi"] > 0.07) & (record["phi"] > 0.07)

    def rms(form: str, cell_period_s: float | None) -> float:
        out = with_work(record, reduction.test, form, cell_period_s)
        return float(np.sqrt(np.mean((out["psi"] - truth["psi"])[rows] ** 2)))

    balanced = rms("mass-balance", 1 / CELL_HZ)
    assert balanced < 0.15
    assert rms("temperature-rise", None) > 2 * balanced
    assert rms("exit-flow", None) > 10 * balanced


def test_a_machine_twice_the_size_has_the_same_characteristic() -> None:
    one, two = fitted(*planes()), fitted(*planes(size=2.0))
    assert two.time_constant_s == pytest.approx(one.time_constant_s, rel=1e-6)
    np.testing.assert_allclose(two.coef, one.coef, rtol=1e-5)
