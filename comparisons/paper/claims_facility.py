"""Claims 1 to 32: machine, rakes, calibration, flow equations and filter; the surge they show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import detrend

from classic_ml.calibration import calibrate
from classic_ml.cycles import find_cycles
from classic_ml.filters import low_pass, peak_frequency_hz, power_spectrum
from classic_ml.flow import (
    LBM_KG,
    calculated_mach,
    corrected_flow,
    local_flows,
    mach_from_corrected_flow,
    physical_flow,
    plane_averages,
    true_mach,
)
from comparisons.paper.claim import Finding
from comparisons.paper.instabilities import (
    INSTABILITIES,
    THRESHOLD_LBM_S,
    Instabilities,
    InstabilityRun,
)
from comparisons.rig.gas import PSI_PA, probe_pressures_pa
from comparisons.rig.sensors import rake_temperature_k
from surge_core.types import FloatArray

MAIN, SECOND = "985", "985-second"
RANKINE_PER_K = 1.8
# Fig 3 to 6 are of the 90 % instability.
SPECTRA = "90"
MINIMUM_CYCLES = 3
# What is read back from how the rig was made, and nothing else, by the number of the claim.
READ_BACK: Mapping[int, Callable[[InstabilityRun], float]] = {
    3: lambda run: len(run.rig.raw.channels),
    4: lambda run: run.sensors.tube_frequency_hz or 0.0,
    6: lambda run: 1e3 * run.sensors.thermocouple_lag_s,
    7: lambda run: run.sensors.recovery_factor,
}


def claim_01(runs: Instabilities) -> Finding:
    """Check: planes and near-stall reading of the test description."""
    test = runs[MAIN].paper.test
    low, high = sorted(test.areas_m2)
    ratio = test.near_stall.pressure_Pa(high) / test.near_stall.pressure_Pa(low)
    return Finding(f"planes {low} and {high}, pressure ratio {ratio:.0f}")


def claim_02(runs: Instabilities) -> Finding:
    """Check: places with a probe pair, at the plane that has fewest."""
    test = runs[MAIN].paper.test
    places = [{(q.forward.rake, q.immersion) for q in test.pairs(p)} for p in (25, 31)]
    return Finding(min(len(found) for found in places))


def claim_05(runs: Instabilities) -> Finding:
    """Check: the remote transducers read the steady pressure of the tubes."""
    share = 1.0 / np.hypot(1.0, 2.0 * np.pi * 7.0 * runs[MAIN].sensors.leak_lag_s)
    return Finding(f"{100 * share:.0f} % of a 7 Hz surge passes", share < 0.1)


def claim_08(runs: Instabilities) -> Finding:
    """Check: temperatures of the rakes, which circulation keeps."""
    run = runs[MAIN]
    truth = run.rig.truth
    inlet, leaving = (
        1.8 * rake_temperature_k(p, truth[f"T{p}_K"], run.sensors, rate_hz=truth.sample_rate_hz)
        - 459.67
        for p in (25, 31)
    )
    return Finding(
        f"{inlet.min():.0f} to {inlet.max():.0f} °F; at most {leaving.max():.0f} °F",
        abs(inlet[0] - 100.0) < 1.0 and float(np.ptp(inlet)) < 10.0 and leaving.max() < 110.0,
    )


def claim_09(runs: Instabilities) -> Finding:
    """Check: the reference pressure extends the range of the differential transducers."""
    run = runs[MAIN]
    test, after = run.paper.test, run.rig.raw.time_s > 1.2
    codes = [run.rig.raw[c.name][after] for c in test.pressures]
    clipped = max(float(np.mean((c <= 0) | (c >= test.adc.top_code))) for c in codes)
    inlet = [c for c in test.pressures if c.plane == 25]
    per_pa = min((c.calibrate_count - c.zero_count) / c.calibrate_pressure_Pa for c in inlet)
    gauge = 0.5 * (test.adc.top_code + 1) / per_pa
    return Finding(
        f"±{gauge / PSI_PA:.0f} psi about {test.pressures[0].zoc_reference_Pa / PSI_PA:.0f} psia, "
        f"at most {100 * clipped:.1f} % of a channel clipped",
        clipped < 0.01,
    )


def claim_10(runs: Instabilities) -> Finding:
    """Check: sensitivity and bias from the readings, against the transducers' own."""
    sensitivity, bias = [], []
    for case in INSTABILITIES:
        test, own = runs[case].paper.test, runs[case].rig.truth_parameters["sensors"]
        for channel in test.pressures:
            counts = np.array([channel.zero_count, channel.calibrate_count])
            zero, high = (test.adc.low_V + test.adc.volts_per_count * counts).tolist()
            found = (high - zero) / channel.calibrate_pressure_Pa
            sensitivity.append(found / own[channel.name]["sensitivity_V_Pa"] - 1.0)
            bias.append((zero - own[channel.name]["bias_V"]) / test.adc.volts_per_count)
    percent = 100.0 * float(np.sqrt(np.mean(np.square(sensitivity))))
    off = float(np.sqrt(np.mean(np.square(bias))))
    return Finding(
        f"sensitivity to {percent:.3f} %, bias to {off:.2f} counts",
        percent < 0.1 and off < 0.5,
        {"n": len(bias)},
    )


def claim_11(runs: Instabilities) -> Finding:
    """Check: the near-stall match, on the matched record."""
    off = [
        abs(run.near_stall(c.name) / run.paper.test.near_stall.pressure_Pa(c.plane) - 1.0)
        for run in (runs[case] for case in INSTABILITIES)
        for c in run.paper.test.pressures
        if c.facing == "forward"
    ]
    return Finding(round(100.0 * max(off), 4), max(off) < 1e-3, {"n": len(off)})


def claim_12(runs: Instabilities) -> Finding:
    """Check: tape and amplifiers: noise, and a gain and an offset of each channel."""
    sensors = runs[MAIN].sensors
    scatter = (sensors.noise_percent, 100.0 * sensors.sensitivity_scatter, sensors.bias_scatter_v)
    return Finding(
        "noise {:g} % of full scale, gains ±{:g} %, offsets ±{:g} V".format(*scatter),
        min(scatter) > 0.0,
    )


def claim_13(runs: Instabilities) -> Finding:
    """Check: bits and rate of the converter."""
    run = runs[MAIN]
    return Finding(f"{run.paper.test.adc.bits} bits, {run.rig.raw.sample_rate_hz:g} /s")


def claim_14(runs: Instabilities) -> Finding:
    """Check: Eq 1 to 4 with the reverse rule, against the rig's own inverse of them."""
    test = runs[MAIN].paper.test
    area, machine = test.areas_m2[25], test.compressor
    mach = np.concatenate([np.linspace(-0.6, -0.05, 56), np.linspace(0.05, 0.6, 56)])
    flow = corrected_flow(mach, area, machine)
    worst = float(np.max(np.abs(mach_from_corrected_flow(flow, area, machine) - mach)))
    for pair in test.pairs(25):
        slope, offset = pair.forward.probe_slope, pair.forward.probe_offset
        forward, aft = probe_pressures_pa(flow, 1e5, area_m2=area, slope=slope, offset=offset)
        again = true_mach(calculated_mach(forward, aft, machine.gamma), slope, offset)
        back = physical_flow(corrected_flow(again, area, machine), np.array(1e5), np.array(300.0))
        there = physical_flow(flow, np.array(1e5), np.array(300.0))
        worst = max(worst, float(np.max(np.abs(back / there - 1.0))))
    return Finding(float(f"{worst:.1e}"), worst < 1e-9)


def claim_15(runs: Instabilities) -> Finding:
    """Check: the aft probe reads slightly above static pressure."""
    slopes = [q.forward.probe_slope for p in (25, 31) for q in runs[MAIN].paper.test.pairs(p)]
    return Finding(f"a {min(slopes):g} to {max(slopes):g}", min(slopes) > 1.0)


def claim_16(runs: Instabilities) -> Finding:
    """Check: four instabilities at three speeds, each of them surge."""
    cycles = [find_cycles(runs[case].paper.record).n_cycles for case in INSTABILITIES]
    speeds = {round(2000.0 * runs[case].near_stall("Nc_frac")) / 20.0 for case in INSTABILITIES}
    surging = sum(n >= MINIMUM_CYCLES for n in cycles)
    return Finding(
        surging,
        surging == 4 and all(min(abs(s - v) for v in speeds) < 0.2 for s in (90.0, 95.0, 98.5)),
        {"speeds": ", ".join(f"{s:g} %" for s in sorted(speeds))},
    )


def _inlet_pressure(runs: Instabilities) -> FloatArray:
    """Return the unfiltered P25 at 90 % in the window of the cycles."""
    return runs[SPECTRA].paper.record["P25_unfiltered_Pa"][runs[SPECTRA].window]


def _peak(runs: Instabilities, low_hz: float, high_hz: float) -> float:
    """Return a peak in the spectrum of P25 at 90 %, first-order trend removed, 1600 samples."""
    rate_hz = runs[SPECTRA].paper.record.sample_rate_hz
    frequency, density = power_spectrum(_inlet_pressure(runs), rate_hz)
    return peak_frequency_hz(frequency, density, low_hz, high_hz)


def claim_17(runs: Instabilities) -> Finding:
    """Check: the rotating-stall fundamental in P25."""
    found = _peak(runs, 40.0, 130.0)
    return Finding(round(found, 2), abs(found - 81.2) <= 1.5)


def claim_18(runs: Instabilities) -> Finding:
    """Check: its second harmonic."""
    found = _peak(runs, 130.0, 200.0)
    return Finding(round(found, 2), abs(found - 162.0) <= 4.0)


def claim_19(runs: Instabilities) -> Finding:
    """Check: the peaks of surge."""
    first, second = _peak(runs, 3.0, 11.0), _peak(runs, 11.0, 22.0)
    return Finding(
        f"{first:.1f} and {second:.1f} Hz", abs(first - 7.0) <= 1.0 and abs(second - 16.0) <= 2.0
    )


def claim_20(runs: Instabilities) -> Finding:
    """Check: the first-order trend, removed before the spectrum."""
    signal = _inlet_pressure(runs)
    seconds = np.arange(signal.size) / runs[SPECTRA].paper.record.sample_rate_hz
    left = abs(float(np.polyfit(seconds, detrend(signal), 1)[0])) / PSI_PA
    return Finding(round(left, 9), left < 1e-9)


def claim_21(runs: Instabilities) -> Finding:
    """Check: gain of the filters in use, from their response to an impulse."""
    settings = runs[SPECTRA].paper.settings
    rate_hz = runs[SPECTRA].rig.raw.sample_rate_hz
    gains = {order: _gain_db(order, settings.cutoff_hz, rate_hz) for order in (3, 5)}
    right = all(abs(corner + 3.01) < 0.05 for corner, _ in gains.values())
    # The bilinear map at 1 kHz takes a little more than the analogue -14.3 and -23.5 dB.
    right &= -15.5 < gains[3][1] < -14.3 and -25.5 < gains[5][1] < -23.5
    return Finding(
        round(gains[settings.filter_order][0], 2),
        right and settings.cutoff_hz == 48.0 and settings.phase == "causal",
        {"third": gains[3][1], "fifth": gains[5][1]},
    )


def _gain_db(order: int, cutoff_hz: float, rate_hz: float) -> tuple[float, float]:
    """Return the gain of a filter at 48 and at 82.5 Hz, from its response to an impulse."""
    impulse = np.zeros(4000)
    # Not the first sample: the filter starts from the steady state of that one.
    impulse[1] = 1.0
    response = low_pass(impulse, rate_hz, order=order, cutoff_hz=cutoff_hz, phase="causal")
    turns = np.outer((48.0, 82.5), np.arange(impulse.size)) / rate_hz
    corner, cells = 20.0 * np.log10(np.abs(np.exp(-2j * np.pi * turns) @ response))
    return float(corner), float(cells)


def claim_22(runs: Instabilities) -> Finding:
    """Check: pressures are filtered, then made into local flows, then averaged."""
    paper = runs[SPECTRA].paper
    record, settings = paper.record, paper.settings
    again = plane_averages(local_flows(record, paper.test), paper.test)["Wc25_kg_s"]
    other = low_pass(
        record["Wc25_unfiltered_kg_s"],
        record.sample_rate_hz,
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )
    apart, differ = (
        float(np.max(np.abs(flow - record["Wc25_kg_s"]))) / LBM_KG for flow in (again, other)
    )
    return Finding(round(apart, 9), apart < 1e-9 and differ > 1.0, {"differ": differ})


def claim_23(runs: Instabilities) -> Finding:
    """Check: time from the first reversal to the first of the cycles that repeat."""
    found = {case: _settling_s(runs[case]) for case in (MAIN, SECOND)}
    holds = all(abs(wait - 1.4) <= 0.4 for wait in found.values())
    return Finding(round(found[MAIN], 2), holds, {"second": found[SECOND]})


def _settling_s(run: InstabilityRun) -> float:
    """Return the wait; a surge cycle starts at stall, in the paper's words."""
    record = run.paper.record
    cycles = find_cycles(record)
    flow, time_s = record["Wc25_kg_s"], record.time_s
    # From its trough of P31 the machine recovers and then stalls: that stall starts the cycle.
    above = flow > THRESHOLD_LBM_S * LBM_KG
    recovered = np.flatnonzero((time_s > cycles.from_s) & above)
    stalled = np.flatnonzero((flow < 0.0) & (np.arange(flow.size) > min(recovered, default=0)))
    if not (recovered.size and stalled.size):
        return math.nan
    return float(time_s[stalled[0]]) - cycles.first_reversal_s


def _rise(run: InstabilityRun, channel: str) -> tuple[float, float]:
    """Return a channel's mean near stall and its median in the quasi-steady cycles."""
    return run.near_stall(channel), float(np.median(run.paper.record[channel][run.window]))


def claim_24(runs: Instabilities) -> Finding:
    """Check: inlet pressure and temperature rise after the first reversal."""
    pressure, heat = _rise(runs[MAIN], "P25_Pa"), _rise(runs[MAIN], "T25_K")
    return Finding(
        f"P25 {pressure[0] / PSI_PA:.1f} to {pressure[1] / PSI_PA:.1f} psia, T25 "
        f"{RANKINE_PER_K * heat[0]:.0f} to {RANKINE_PER_K * heat[1]:.0f} °R",
        pressure[1] > 1.2 * pressure[0] and heat[1] > 1.2 * heat[0],
    )


def claim_25(runs: Instabilities) -> Finding:
    """Check: corrected speed during the quasi-steady cycles."""
    speed = 100.0 * runs[MAIN].paper.record["Nc_frac"][runs[MAIN].window]
    low, high = float(speed.min()), float(speed.max())
    found = round(float(np.median(speed)), 1)
    return Finding(found, low >= 70.0 and high <= 80.0, {"ends": (low, high)})


def claim_26(runs: Instabilities) -> Finding:
    """Check: the rise of T25 that this fall of corrected speed means."""
    before, after = _rise(runs[MAIN], "T25_K")
    speed = _rise(runs[MAIN], "Nc_frac")
    ratio, implied = after / before, (speed[0] / speed[1]) ** 2
    holds = 1.52 <= ratio <= 1.98 and abs(implied / ratio - 1.0) < 0.01
    return Finding(round(ratio, 3), holds, {"implied": implied})


def claim_27(runs: Instabilities) -> Finding:
    """Check: recoveries fall short of the first stall point."""
    run = runs[MAIN]
    record, window = run.paper.record, run.window
    first = run.near_stall("P31_Pa") / run.near_stall("P25_Pa")
    peak = float(np.max((record["P31_Pa"] / record["P25_Pa"])[window]))
    flow = run.near_stall("Wc25_kg_s") / LBM_KG
    top = float(np.max(record["Wc25_kg_s"][window])) / LBM_KG
    return Finding(
        f"pressure ratio {peak:.1f} for {first:.1f}, flow {top:.0f} for {flow:.0f} lbm/s",
        peak < 0.5 * first and top < 0.75 * flow,
    )


def claim_28(runs: Instabilities) -> Finding:
    """Check: the window of the quasi-steady cycles."""
    cycles = find_cycles(runs[MAIN].paper.record)
    return Finding(
        f"{cycles.from_s:.2f} to {cycles.to_s:.2f} s",
        cycles.from_s <= 1.8 and cycles.to_s >= 3.6 and runs[MAIN].paper.window_s == (1.8, 3.6),
        {"n": cycles.n_cycles},
    )


def claim_29(runs: Instabilities) -> Finding:
    """Check: the tips reverse more than the hub."""
    record, window = runs[MAIN].paper.record, runs[MAIN].window
    tip, hub = (
        float(np.mean(np.minimum(record[f"Wc25_{side}_kg_s"][window], 0.0))) / LBM_KG
        for side in ("tip", "hub")
    )
    return Finding(
        f"mean reversed flow {-tip:.1f} lbm/s at the tip, {-hub:.1f} at the hub", tip < 2.0 * hub
    )


def claim_30(runs: Instabilities) -> Finding:
    """Check: the order of events of the first stall."""
    record = runs[MAIN].paper.record
    flow, exit_pa, inlet_pa = (
        record[name] for name in ("Wc25_unfiltered_kg_s", "P31_unfiltered_Pa", "P25_unfiltered_Pa")
    )
    reversal = int(np.flatnonzero(flow < 0.0)[0])
    onset = reversal - 30
    spike = onset + int(np.argmax(inlet_pa[onset : reversal + 10]))
    rise = float(inlet_pa[spike] / inlet_pa[onset] - 1.0)
    drop = float(1.0 - np.min(inlet_pa[spike : spike + 10]) / inlet_pa[spike])
    fall = float(1.0 - exit_pa[reversal + 30] / exit_pa[onset])
    return Finding(
        f"P31 -{100 * fall:.0f} %, flow reversed, P25 +{100 * rise:.0f} % and -{100 * drop:.0f} %",
        fall > 0.1 and rise > 0.1 and drop > 0.5 * rise and flow[onset] > 0.0,
        {"apart": abs(spike - reversal)},
    )


def claim_31(runs: Instabilities) -> Finding:
    """Check: T25 rises in stall and falls in recovery."""
    record, window = runs[MAIN].paper.record, runs[MAIN].window
    slope = np.gradient(record["T25_K"], record.sample_period_s)
    stalled = record["in_stall"] > 0.5
    # Some machines never leave stall in the window: then there is no recovery to fall in.
    inside, outside = (
        float(np.sum(slope[window & mask])) / max(int(np.count_nonzero(window & mask)), 1)
        for mask in (stalled, ~stalled)
    )
    return Finding(
        f"{inside:+.0f} K/s in stall, {outside:+.0f} K/s in recovery", inside > 0.0 > outside
    )


def claim_32(runs: Instabilities) -> Finding:
    """Check: stall cells in the in-stall part of the cycles."""
    found = cell_power_ratio(runs[MAIN])
    return Finding(round(found, 1), found > 4.0)


def cell_power_ratio(run: InstabilityRun) -> float:
    """Return the power of the cells in stall over that in unstalled rows of the cycles.

    The regimes are split at 50 lbm/s of a flow that is filtered without delay.
    """
    raw, record = calibrate(run.rig.raw, run.paper.test), run.paper.record
    apart = raw["P25_A_tip_forward"] - raw["P25_B_tip_forward"]
    flow = low_pass(
        record["Wc25_unfiltered_kg_s"], record.sample_rate_hz, order=3, cutoff_hz=48.0, phase="zero"
    )
    stalled = flow < THRESHOLD_LBM_S * LBM_KG
    inside, outside = (apart[run.window & rows] for rows in (stalled, ~stalled))
    power = [float(np.median(np.square(s - np.mean(s)))) for s in (inside, outside)]
    return power[0] / power[1]
