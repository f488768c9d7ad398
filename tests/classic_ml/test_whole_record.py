"""τ from all forward rows of a record: truth, hysteresis, cells, twins, and what is withheld."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_records import rig_record, rig_run, rig_series, through_files

from classic_ml.calibration import calibrate
from classic_ml.flow import local_flows
from classic_ml.io.series import read_series, write_series
from classic_ml.record_reading import RecordReading
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.reduction import reduce_record
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record.branches import Specification, fit_branches
from classic_ml.whole_record.passes import Passes, cell_frequency_hz, passes_of, without_cells
from classic_ml.whole_record.rakes import Planes, RakeSignals, rake_signals_of
from classic_ml.whole_record.stall_state import StallLevels, estimated_state, state_by_levels
from classic_ml.whole_record_fit import fit_whole_record, jackknife, variants, with_stored_gas
from classic_ml.whole_record_run import WholeRecordRun, _combined, _curve_at, fit_whole_records
from classic_ml.whole_run import fit_whole_runs
from classic_ml.work.alignment import ON_TIME_S
from comparisons.missing_effect import diagnose
from comparisons.rig import CASES, SensorSettings
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray

TAU_S = 0.018
PERIOD_S = 0.001


@pytest.fixture(scope="module")
def series() -> CoefficientSeries:
    return rig_series("985", 71)


@pytest.fixture(scope="module")
def signals(series: CoefficientSeries) -> RakeSignals:
    found = rake_signals_of(series)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def fitted(series: CoefficientSeries) -> WholeRecordRun:
    found = fit_whole_records([series], n_twins=8)
    assert isinstance(found, WholeRecordRun)
    return found


def made(
    tau_s: float = TAU_S, noise: float = 0.0, seed: int = 0, phi: FloatArray | None = None
) -> Passes:
    """Return passes of a machine with two branches and no sensors."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(4000) * PERIOD_S
    if phi is None:
        phi = 0.09 + 0.11 * np.sin(2.0 * np.pi * 6.0 * time_s + 0.6 * np.sin(2.3 * time_s))
    plain = Passes(
        np.arange(phi.size),
        np.zeros(phi.size, dtype=np.int64),
        phi,
        np.zeros(phi.size),
        0.01 * np.sin(1.7 * time_s),
        np.ones(phi.size, dtype=np.bool_),
        None,
        0.015,
        PERIOD_S,
        Planes(phi, phi, phi),
    )
    state = state_by_levels(plain, StallLevels(0.15, 0.17))
    share = plain.smooth(state.astype(np.float64), 0.006)
    curve = 1.2 + 3.0 * phi + 47.0 * phi**2
    other = 2.5 - 20.0 * (phi - 0.2) ** 2 + 4.0 * plain.speed
    psi_p = FirstOrderLag(tau_s, PERIOD_S, "first").respond(
        share * curve + (1.0 - share) * other, np.array(1.5)
    )
    return replace(plain, psi_p=psi_p + noise * rng.standard_normal(phi.size), in_stall=state)


SPEC = Specification(0.001, 0.005, 0.001)


@pytest.mark.parametrize("tau_s", [0.007, 0.018, 0.03])
def test_without_noise_both_branches_give_the_truth(tau_s: float) -> None:
    passes = made(tau_s)
    fit = fit_branches(passes, SPEC, passes.in_stall)
    assert fit.tau_s == pytest.approx(tau_s, rel=1e-3)
    assert fit.coefficients[:3] == pytest.approx([1.2, 3.0, 47.0], rel=5e-3)


def test_the_top_of_a_loop_in_stall_is_no_recovery() -> None:
    passes = made()
    phi, shown = passes.phi, np.ones(4000, dtype=np.bool_)
    shown[500:3000:600] = False
    curve = 1.2 + 3.0 * phi + 47.0 * phi**2 - 8.0 * np.maximum(phi - 0.15, 0.0)
    psi_p = FirstOrderLag(TAU_S, PERIOD_S, "first").respond(curve, np.array(1.5))
    unseen = replace(passes, psi_p=psi_p, in_stall=shown)
    assert estimated_state(unseen, SPEC)[1] is not None
    shift = 0.1 * np.random.default_rng(0).standard_normal(4000)
    state, levels = estimated_state(replace(unseen, shift=shift), SPEC)
    assert levels is None
    assert np.array_equal(state, shown)


def test_a_curve_that_the_record_rejects_does_not_widen_the_interval(signals: RakeSignals) -> None:
    passes = made(noise=0.02)
    bend = np.where(passes.in_stall, 300.0 * np.maximum(passes.phi - 0.15, 0.0), 0.0)
    bent = FirstOrderLag(TAU_S, PERIOD_S, "first").respond(bend, np.array(0.0))
    passes = replace(passes, psi_p=passes.psi_p + bent)
    reading = RecordReading(signals, None, passes, SPEC, passes.in_stall, None)
    fit, straight = (replace(reading, spec=replace(SPEC, hinges=h)).fit() for h in (True, False))
    apart = abs(math.log(straight.tau_s / fit.tau_s))
    assert abs(math.log(fit.tau_s / TAU_S)) < 0.02 < apart
    assert variants(reading, fit).log_tau < 0.2 * apart


@pytest.mark.parametrize("cycles", ["alike", "one knows τ"])
def test_the_scatter_over_seeds_is_the_one_stated(signals: RakeSignals, cycles: str) -> None:
    # Large loops in stall make one cycle of 0.7 s, small ones the others.
    wave, phi = np.sin(2.0 * np.pi * 6.0 * PERIOD_S * np.arange(4000)), None
    if cycles == "one knows τ":
        phi = np.where(np.arange(4000) < 700, 0.06 + 0.05 * wave, 0.13 + 0.006 * wave)
    off, stated = [], []
    for seed in range(12):
        passes = made(noise=0.05, seed=seed, phi=phi)
        reading = RecordReading(signals, None, passes, SPEC, passes.in_stall, None)
        fit = reading.fit()
        off.append(math.log(fit.tau_s / TAU_S))
        stated.append(jackknife(reading, fit).log_tau)
    # The rms of twelve is known to 20 %.
    assert 0.6 < np.linalg.norm(off) / np.linalg.norm(stated) < 1.6


def test_stall_ends_on_the_way_up_and_begins_on_the_way_down() -> None:
    passes = made()
    state = state_by_levels(passes, StallLevels(0.15, 0.1))
    ends = np.flatnonzero(state[:-1] & ~state[1:])
    begins = np.flatnonzero(~state[:-1] & state[1:])
    assert ends.size == begins.size or ends.size == begins.size + 1
    assert passes.phi[ends] == pytest.approx(0.15, abs=0.006)
    assert passes.phi[begins] == pytest.approx(0.1, abs=0.006)


def test_the_cells_are_found_and_cancelled(signals: RakeSignals) -> None:
    passes = passes_of(signals)
    every = np.zeros(signals.counts.size, dtype=np.bool_)
    every[passes.row] = True
    cell_hz = cell_frequency_hz(signals, every)
    assert cell_hz is not None
    assert cell_hz == pytest.approx(CASES["985"].cell_frequency_hz, rel=0.01)
    plain = signals.planes().corrected_kg_s
    clean = without_cells(signals, every, every, cell_hz).corrected_kg_s

    def line(values: FloatArray) -> float:
        turning = np.exp(-2j * np.pi * cell_hz * PERIOD_S * np.arange(values.size))
        return float(np.abs(np.mean((values * turning)[passes.row])))

    assert line(clean) < 0.2 * line(plain)


def test_tau_of_a_record_and_its_interval(fitted: WholeRecordRun) -> None:
    assert fitted.fit_state_ in (FitState.CONVERGED, FitState.TWO_READINGS)
    low_s, high_s = fitted.ci95_s_
    assert low_s < TAU_S < high_s
    assert high_s / low_s < 2.0
    assert "held" not in str(fitted)
    low, high = np.percentile(fitted.trusted_phi, [5.0, 95.0]).tolist()
    phi = np.linspace(low, high, 30)
    truth = np.polynomial.polynomial.polyval(phi, CASES["985"].pressure_terms)
    assert np.sqrt(np.mean((fitted.characteristic(phi)[0] - truth) ** 2)) < 0.15


def test_the_interval_holds_the_truth_at_other_speeds_and_noises() -> None:
    held = []
    for case, seed, noise in [("90", 5, 0.1), ("95", 6, 0.2), ("985-second", 7, 0.3)]:
        fit = fit_whole_records(
            [rig_series(case, seed, sensors=SensorSettings(noise_percent=noise))], n_twins=4
        )
        assert isinstance(fit, WholeRecordRun)
        if not fit.fit_state_.withholds:
            held.append(fit.ci95_s_[0] < TAU_S < fit.ci95_s_[1])
    assert sum(held) >= len(held) - 1 >= 1


def test_a_file_gives_what_the_series_gives(
    series: CoefficientSeries, signals: RakeSignals, tmp_path: Path
) -> None:
    for suffix in (".csv", ".nc"):
        write_series(series, tmp_path / f"series{suffix}")
        again = rake_signals_of(read_series(tmp_path / f"series{suffix}"))
        assert again is not None
        assert again.chain == signals.chain
        for name, flow in signals.flow_kg_s.items():
            np.testing.assert_allclose(again.flow_kg_s[name], flow, rtol=1e-12)
            np.testing.assert_allclose(again.total_Pa[name], signals.total_Pa[name], rtol=1e-12)


def test_without_the_columns_of_the_rakes_the_fall_back_answers(series: CoefficientSeries) -> None:
    fit = fit_whole_records([replace(series, rakes={})])
    assert not isinstance(fit, WholeRecordRun)
    assert abs(fit.time_constant_s_ - TAU_S) < 3.0 * fit.time_constant_stderr_s_


def test_a_twin_without_noise_reads_the_model(signals: RakeSignals, fitted: WholeRecordRun) -> None:
    """Eq 3, 2 and 1 backwards and forwards: τ of the twin is that which made it."""
    fit = fitted.fits_[0]
    quiet = replace(
        signals.chain,
        pairs=tuple(replace(p, noise_Pa=0.0, noise_aft_Pa=0.0) for p in signals.chain.pairs),
    )
    model = replace(fit.reading, signals=replace(signals, chain=quiet)).twin_under(fit.fit)
    twin = replace(model, offset_Pa=0.0).measured(np.random.default_rng(0))
    for pair in quiet.of_plane(25):
        at = np.abs(twin.flow_kg_s[pair.name]) > 5.0
        smooth = twin.flow_kg_s[pair.name][at] - signals.flow_kg_s[pair.name][at]
        assert abs(np.median(smooth)) < 0.05
    again = fit_whole_record(twin, interval=False)
    assert again.tau_s == pytest.approx(fit.tau_s, rel=0.1)


def test_rakes_that_disagree_show_the_error_of_calibration(
    signals: RakeSignals, fitted: WholeRecordRun
) -> None:
    """Two rakes at two immersions: two degrees of freedom a record, over sixteen records."""
    fit = fitted.fits_[0]
    twin = fit.reading.twin_under(fit.fit)
    # Rakes that agree: both carry the flow of rake A.
    alike = {name: twin.flow_kg_s[name.replace("_B_", "_A_")] for name in twin.flow_kg_s}
    twin = replace(twin, flow_kg_s=alike, offset_Pa=15.0)
    found = []
    for seed in range(16):
        measured = twin.measured(np.random.default_rng(seed))
        found.append(replace(fit.reading, signals=measured).twin_under(fit.fit).offset_Pa)
    # The square of a deviation from 32 degrees of freedom is known to a quarter.
    assert np.mean(np.square(found)) == pytest.approx(15.0**2, rel=0.5)


def test_what_is_not_known_is_not_printed(
    series: CoefficientSeries, fitted: WholeRecordRun
) -> None:
    fit = fitted.fits_[0]
    biased = replace(fit, twins=replace(fit.twins, bias=5.0 * fit.share))
    for wrong, state in (
        (replace(fit, n_cycles=4), FitState.TOO_FEW_CYCLES),
        (biased, FitState.TWIN_BIASED),
        (replace(fit, fit=replace(fit.fit, at_end=True)), FitState.AT_SEARCH_END),
    ):
        found = _combined([series], (wrong,), None)
        assert found.fit_state_ is state
        assert math.isnan(found.time_constant_s_)
        assert np.isnan(found.covariance_).all()
        assert all(math.isnan(end) for end in found.ci95_s_)


def test_a_wide_interval_is_refused_and_a_second_record_helps(
    series: CoefficientSeries, fitted: WholeRecordRun
) -> None:
    fit = fitted.fits_[0]
    wide = replace(fit, cycles=replace(fit.cycles, log_tau=0.13))
    second = fit_whole_runs([series])
    unlikely = replace(second, time_constant_stderr_s_=0.5 * second.time_constant_s_)
    one = _combined([series], (wide,), unlikely)
    assert one.fit_state_ is FitState.UNCERTAIN
    assert one.left_open_.endswith("what lessens the first is a longer record")
    both = _combined([series, series], (wide, wide), unlikely)
    assert both.fit_state_ is FitState.CONVERGED
    # One law of the probes holds for both.
    by_law = replace(fit, probe_law=0.1)
    both = _combined([series, series], (by_law, by_law), None)
    assert both.time_constant_stderr_s_ > 0.1 * both.time_constant_s_


def test_two_readings_span_both(series: CoefficientSeries, fitted: WholeRecordRun) -> None:
    second = fit_whole_runs([series])
    far = replace(second, time_constant_s_=0.04, time_constant_stderr_s_=0.002)
    found = _combined([series], fitted.fits_, far)
    assert found.fit_state_ is FitState.TWO_READINGS
    own, other = fitted.fits_[0], found.second_reading_
    assert other is not None
    phi = found.trusted_phi
    apart = found.characteristic(phi)[0] - np.vander(phi, 3)[:, ::-1] @ _curve_at(0.04, own)
    assert np.all(np.abs(apart) < 1.96 * found.characteristic(phi)[1])
    assert found.ci95_s_[0] < own.tau_s
    assert found.ci95_s_[1] == pytest.approx(other.ci95_s[1])
    # One that is well known and hardly agrees counts for half, and widens the interval.
    near_s = own.tau_s * math.exp(1.9 * own.share)
    near = replace(second, time_constant_s_=near_s, time_constant_stderr_s_=0.001 * near_s)
    found = _combined([series], fitted.fits_, near)
    assert found.time_constant_s_ == pytest.approx(math.sqrt(near_s * own.tau_s))
    assert found.ci95_s_[0] < own.tau_s < near_s < found.ci95_s_[1]


def without(what: str, which: str) -> CoefficientSeries:
    """Return the series of a record that lacks a rake or an immersion."""
    run = rig_run("985", 72)
    gone = [name for name, channel in run.test["channels"].items() if channel.get(what) == which]
    kept = ("channels", "limits")
    left = {k: {n: v for n, v in run.test[k].items() if n not in gone} for k in kept}
    test = {**run.test, **left}
    return reduce_record(*through_files(replace(run, raw=run.raw.without(gone), test=test))).series


def test_with_one_rake_hub_and_tip_cancel_the_cells() -> None:
    fit = fit_whole_records([without("rake", "B")], n_twins=4)
    assert isinstance(fit, WholeRecordRun)
    period_s = fit.fits_[0].reading.passes.period_s
    assert period_s == pytest.approx(1.0 / CASES["985"].cell_frequency_hz, rel=0.01)
    assert fit.ci95_s_[0] < TAU_S < fit.ci95_s_[1]
    assert abs(fit.time_constant_s_ - TAU_S) < 0.002


def test_one_immersion_states_no_time_constant() -> None:
    series = without("immersion", "hub")
    fit = fit_whole_records([series])
    assert fit.fit_state_.withholds
    assert math.isnan(fit.time_constant_s_)
    with pytest.raises(InputError, match="one immersion alone"):
        diagnose([series])


@pytest.mark.parametrize("rows", [-5, 0, 3, 8])
@pytest.mark.parametrize("case", ["985", "90"])
def test_a_late_plane_shows_in_its_flow_and_withholds(case: str, rows: int) -> None:
    """Whatever τ is: no lag of ψ' is in the flows. A wave takes 2.9 ms: 5 are another clock."""
    raw, test = rig_record(case, 72)
    late = [channel for channel in raw.channels if channel.startswith("P31")]
    at = np.clip(np.arange(raw.n_samples) - rows, 0, raw.n_samples - 1)
    moved = [replace(raw.channel(n), values=raw[n][at]) for n in late]
    entry = LedgerEntry("late", "plane 31 moved in time")
    series = reduce_record(raw.without(late).after(entry, add=moved), test).series
    fit = fit_whole_records([series], n_twins=2)
    assert isinstance(fit, WholeRecordRun)
    alignment = fit.fits_[0].reading.signals.chain.alignment
    assert alignment.late_s == pytest.approx(rows * PERIOD_S, abs=ON_TIME_S)
    assert alignment.off_clock is bool(rows)
    assert (fit.fit_state_ is FitState.MISALIGNED) is bool(rows)
    withheld = np.isnan([fit.time_constant_s_, fit.time_constant_stderr_s_])
    assert withheld.all() == withheld.any() == bool(rows)
    assert any("late" in caution or "early" in caution for caution in fit.cautions_) is bool(rows)


def test_gas_that_the_duct_stores_widens_the_interval_of_both_readings(
    signals: RakeSignals, series: CoefficientSeries, fitted: WholeRecordRun
) -> None:
    fit = fitted.fits_[0]
    assert fit.planes.n == 2
    machine = signals.chain.compressor
    # Ten times the volume takes waves √10 times as long from plane to plane.
    large = machine.model_copy(update={"internal_volume_m3": 10.0 * machine.internal_volume_m3})
    none = machine.model_copy(update={"internal_volume_m3": 0.0})
    moved = []
    for other in (none, machine, large):
        own = replace(signals, chain=replace(signals.chain, compressor=other))
        moved.append(with_stored_gas(replace(fit.reading, signals=own), fit.fit))
    apart = [abs(math.log(each.tau_s / fit.tau_s)) for each in moved]
    assert apart[0] < 1e-3 < apart[2]
    assert apart[1] < apart[2]
    second = fit_whole_runs([series])
    wide = replace(fit, planes=replace(fit.planes, log_tau=0.08))
    narrow = replace(fit, planes=replace(fit.planes, log_tau=0.0))
    one, other = (_combined([series], (each,), second) for each in (wide, narrow))
    assert one.time_constant_s_ == other.time_constant_s_
    shares = [each.time_constant_stderr_s_ / each.time_constant_s_ for each in (one, other)]
    assert shares[0] == pytest.approx(math.hypot(shares[1], 0.08))


def test_a_ramp_in_the_law_of_the_probes_moves_only_what_is_near_zero(signals: RakeSignals) -> None:
    moved = signals.ramped(0.03)
    for name, flow in signals.flow_kg_s.items():
        apart = np.abs(moved.flow_kg_s[name] - flow)
        assert apart.max() > 0.0
        assert np.all(np.abs(moved.flow_kg_s[name]) <= np.abs(flow) + 1e-9)
        assert apart[np.abs(flow) > 0.2 * np.abs(flow).max()].max() < 1e-9


@pytest.mark.parametrize("rate_hz", [500.0, 2000.0])
def test_other_sample_rates_give_the_same_time_constant(rate_hz: float) -> None:
    sensors = SensorSettings(sample_rate_hz=rate_hz, anti_alias_hz=0.45 * rate_hz)
    signals = rake_signals_of(rig_series("985", 73, sensors=sensors))
    assert signals is not None
    fit = fit_whole_record(signals, n_twins=0)
    assert fit.state is FitState.CONVERGED
    assert abs(math.log(fit.tau_s / TAU_S)) < max(2.0 * fit.share, 0.1)


def test_one_reading_that_is_no_pressure_is_bridged_and_many_are_refused() -> None:
    record, test = rig_record("985", 71)
    calibrated = calibrate(record, test)
    name = test.pairs(25)[0].forward.name
    whole = local_flows(calibrated, test)

    def spoilt(n_rows: int) -> Record:
        values = np.array(calibrated[name])
        values[2000 : 2000 + n_rows] = -849.0
        channel = Channel(name, values, "Pa")
        return replace(calibrated, channels={**calibrated.channels, name: channel})

    flow = local_flows(spoilt(1), test)
    pair = f"Wc{test.pairs(25)[0].name}_kg_s"
    np.testing.assert_array_equal(np.delete(flow[pair], 2000), np.delete(whole[pair], 2000))
    assert np.isfinite(flow[pair][2000])
    assert "1 readings that are no absolute pressure" in flow.history[-1].flags[0]
    with pytest.raises(InputError, match="positive absolute pressure"):
        local_flows(spoilt(100), test)
