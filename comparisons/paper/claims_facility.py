"""Claims 1 to 32: machine, rakes, calibration, flow equations and filter; the surge they show.

Each function checks the claims on one subject and gives a finding for each, by its number.
"""

from __future__ import annotations

import math

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
from comparisons.paper.claim import Finding, Findings
from comparisons.paper.instabilities import (
    INSTABILITIES,
    THRESHOLD_LBM_S,
    Instabilities,
    InstabilityRun,
)
from comparisons.rig.gas import PSI_PA, probe_pressures_pa
from comparisons.rig.sensors import rake_temperature_k

MAIN, SECOND = "985", "985-second"
# Fig 3 to 6 are of the 90 % instability.
SPECTRA = "90"
MINIMUM_CYCLES = 3


def description(runs: Instabilities) -> Findings:
    """Check planes, probe pairs, channels and converter in what describes the test."""
    test, raw = runs[MAIN].paper.test, runs[MAIN].rig.raw
    low, high = sorted(test.areas_m2)
    ratio = test.near_stall.pressure_Pa(high) / test.near_stall.pressure_Pa(low)
    pairs = {plane: list(test.pairs(plane)) for plane in (25, 31)}
    places = [{(q.forward.rake, q.immersion) for q in found} for found in pairs.values()]
    slopes = [q.forward.probe_slope for found in pairs.values() for q in found]
    return {
        1: Finding(f"planes {low} and {high}, pressure ratio {ratio:.0f}"),
        2: Finding(min(len(found) for found in places)),
        3: Finding(len(raw.channels)),
        13: Finding(f"{test.adc.bits} bits, {raw.sample_rate_hz:g} /s"),
        15: Finding(f"a {min(slopes):g} to {max(slopes):g}", min(slopes) > 1.0),
    }


def sensors(runs: Instabilities) -> Findings:
    """Check how the sensors of the rig were made."""
    made, truth = runs[MAIN].sensors, runs[MAIN].rig.truth
    passed = 1.0 / np.hypot(1.0, 2.0 * np.pi * 7.0 * made.leak_lag_s)
    inlet, leaving = (
        1.8 * rake_temperature_k(p, truth[f"T{p}_K"], made, rate_hz=truth.sample_rate_hz) - 459.67
        for p in (25, 31)
    )
    scatter = (made.noise_percent, 100.0 * made.sensitivity_scatter, made.bias_scatter_v)
    return {
        4: Finding(made.tube_frequency_hz or 0.0),
        5: Finding(f"{100 * passed:.0f} % of a 7 Hz surge passes", passed < 0.1),
        6: Finding(1e3 * made.thermocouple_lag_s),
        7: Finding(made.recovery_factor),
        8: Finding(
            f"{inlet.min():.0f} to {inlet.max():.0f} °F; at most {leaving.max():.0f} °F",
            abs(inlet[0] - 100.0) < 1.0 and float(np.ptp(inlet)) < 10.0 and leaving.max() < 110.0,
        ),
        12: Finding(
            "noise {:g} % of full scale, gains ±{:g} %, offsets ±{:g} V".format(*scatter),
            min(scatter) > 0.0,
        ),
    }


def calibration(runs: Instabilities) -> Findings:
    """Check the range of the transducers, their readings and the near-stall match."""
    test, raw = runs[MAIN].paper.test, runs[MAIN].rig.raw
    codes = [raw[c.name][raw.time_s > 1.2] for c in test.pressures]
    clipped = max(float(np.mean((c <= 0) | (c >= test.adc.top_code))) for c in codes)
    inlet = [c for c in test.pressures if c.plane == 25]
    per_pa = min((c.calibrate_count - c.zero_count) / c.calibrate_pressure_Pa for c in inlet)
    gauge = 0.5 * (test.adc.top_code + 1) / per_pa
    sensitivity, bias, off = [], [], []
    for run in (runs[case] for case in INSTABILITIES):
        test, own = run.paper.test, run.rig.truth_parameters["sensors"]
        for channel in test.pressures:
            counts = np.array([channel.zero_count, channel.calibrate_count])
            zero, high = (test.adc.low_V + test.adc.volts_per_count * counts).tolist()
            found = (high - zero) / channel.calibrate_pressure_Pa
            sensitivity.append(found / own[channel.name]["sensitivity_V_Pa"] - 1.0)
            bias.append((zero - own[channel.name]["bias_V"]) / test.adc.volts_per_count)
            if channel.facing == "forward":
                known = test.near_stall.pressure_Pa(channel.plane)
                off.append(abs(run.near_stall(channel.name) / known - 1.0))
    percent = 100.0 * float(np.sqrt(np.mean(np.square(sensitivity))))
    steps = float(np.sqrt(np.mean(np.square(bias))))
    return {
        9: Finding(
            f"±{gauge / PSI_PA:.0f} psi about "
            f"{inlet[0].zoc_reference_Pa / PSI_PA:.0f} psia, "
            f"at most {100 * clipped:.1f} % of a channel clipped",
            clipped < 0.01,
        ),
        10: Finding(
            f"sensitivity to {percent:.3f} %, bias to {steps:.2f} counts",
            percent < 0.1 and steps < 0.5,
            {"n": len(bias)},
        ),
        11: Finding(round(100.0 * max(off), 4), max(off) < 1e-3, {"n": len(off)}),
    }


def flow_equations(runs: Instabilities) -> Findings:
    """Check Eq 1 to 4 with the reverse rule, against the rig's own inverse of them."""
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
    return {14: Finding(float(f"{worst:.1e}"), worst < 1e-9)}


def spectra(runs: Instabilities) -> Findings:
    """Check the peaks of unfiltered P25 at 90 %, its first-order trend removed, 1600 samples."""
    paper = runs[SPECTRA].paper
    rate_hz, signal = paper.record.sample_rate_hz, paper.record["P25_unfiltered_Pa"]
    signal = signal[runs[SPECTRA].window]
    frequency, density = power_spectrum(signal, rate_hz)
    cells, second, surge, twice = (
        peak_frequency_hz(frequency, density, *band)
        for band in ((40.0, 130.0), (130.0, 200.0), (3.0, 11.0), (11.0, 22.0))
    )
    slope = np.polyfit(np.arange(signal.size) / rate_hz, detrend(signal), 1)[0]
    left = abs(float(slope)) / PSI_PA
    return {
        17: Finding(round(cells, 2), abs(cells - 81.2) <= 1.5),
        18: Finding(round(second, 2), abs(second - 162.0) <= 4.0),
        19: Finding(
            f"{surge:.1f} and {twice:.1f} Hz", abs(surge - 7.0) <= 1.0 and abs(twice - 16.0) <= 2.0
        ),
        20: Finding(round(left, 9), left < 1e-9),
    }


def filters(runs: Instabilities) -> Findings:
    """Check the filters in use, and that pressures are filtered before flows are averaged."""
    paper = runs[SPECTRA].paper
    record, settings, rate_hz = paper.record, paper.settings, paper.record.sample_rate_hz
    gains = {order: _gain_db(order, settings.cutoff_hz, rate_hz) for order in (3, 5)}
    right = all(abs(corner + 3.01) < 0.05 for corner, _ in gains.values())
    # The bilinear map at 1 kHz takes a little more than the analogue -14.3 and -23.5 dB.
    right &= -15.5 < gains[3][1] < -14.3 and -25.5 < gains[5][1] < -23.5
    again = plane_averages(local_flows(record, paper.test), paper.test)["Wc25_kg_s"]
    other = low_pass(
        record["Wc25_unfiltered_kg_s"],
        rate_hz,
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )
    apart, differ = (
        float(np.max(np.abs(flow - record["Wc25_kg_s"]))) / LBM_KG for flow in (again, other)
    )
    return {
        21: Finding(
            round(gains[settings.filter_order][0], 2),
            right and settings.cutoff_hz == 48.0 and settings.phase == "causal",
            {"third": gains[3][1], "fifth": gains[5][1]},
        ),
        22: Finding(round(apart, 9), apart < 1e-9 and differ > 1.0, {"differ": differ}),
    }


def _gain_db(order: int, cutoff_hz: float, rate_hz: float) -> tuple[float, float]:
    """Return the gain of a filter at 48 and at 82.5 Hz, from its response to an impulse."""
    impulse = np.zeros(4000)
    # Not the first sample: the filter starts from the steady state of that one.
    impulse[1] = 1.0
    response = low_pass(impulse, rate_hz, order=order, cutoff_hz=cutoff_hz, phase="causal")
    turns = np.outer((48.0, 82.5), np.arange(impulse.size)) / rate_hz
    corner, cells = 20.0 * np.log10(np.abs(np.exp(-2j * np.pi * turns) @ response))
    return float(corner), float(cells)


def cycles(runs: Instabilities) -> Findings:
    """Check that each test surges, and when cycles that repeat begin."""
    found = {case: find_cycles(runs[case].paper.record) for case in INSTABILITIES}
    surging = sum(each.n_cycles >= MINIMUM_CYCLES for each in found.values())
    speeds = {round(2000.0 * runs[case].near_stall("Nc_frac")) / 20.0 for case in INSTABILITIES}
    at_each = all(min(abs(s - v) for v in speeds) < 0.2 for s in (90.0, 95.0, 98.5))
    waits = {case: _settling_s(runs[case]) for case in (MAIN, SECOND)}
    main, window_s = found[MAIN], runs[MAIN].paper.window_s
    return {
        16: Finding(
            surging,
            surging == 4 and at_each,
            {"speeds": ", ".join(f"{s:g} %" for s in sorted(speeds))},
        ),
        23: Finding(
            round(waits[MAIN], 2),
            all(abs(wait - 1.4) <= 0.4 for wait in waits.values()),
            {"second": waits[SECOND]},
        ),
        28: Finding(
            f"{main.from_s:.2f} to {main.to_s:.2f} s",
            main.from_s <= 1.8 and main.to_s >= 3.6 and window_s == (1.8, 3.6),
            {"n": main.n_cycles},
        ),
    }


def _settling_s(run: InstabilityRun) -> float:
    """Return the time from the first reversal to the first cycle that repeats.

    A surge cycle starts at stall, in the paper's words.
    """
    record = run.paper.record
    found = find_cycles(record)
    flow, time_s = record["Wc25_kg_s"], record.time_s
    # From its trough of P31 the machine recovers and then stalls: that stall starts the cycle.
    above = flow > THRESHOLD_LBM_S * LBM_KG
    recovered = np.flatnonzero((time_s > found.from_s) & above)
    stalled = np.flatnonzero((flow < 0.0) & (np.arange(flow.size) > min(recovered, default=0)))
    if not (recovered.size and stalled.size):
        return math.nan
    return float(time_s[stalled[0]]) - found.first_reversal_s


def heating(runs: Instabilities) -> Findings:
    """Check inlet state, corrected speed and recoveries of the cycles against near stall."""
    run = runs[MAIN]
    record, window = run.paper.record, run.window
    before, after = (
        {name: state(name) for name in ("P25_Pa", "T25_K", "Nc_frac")}
        for state in (run.near_stall, lambda name: float(np.median(record[name][window])))
    )
    speed = 100.0 * record["Nc_frac"][window]
    low, high = float(speed.min()), float(speed.max())
    ratio = after["T25_K"] / before["T25_K"]
    implied = (before["Nc_frac"] / after["Nc_frac"]) ** 2
    first = run.near_stall("P31_Pa") / before["P25_Pa"]
    peak = float(np.max((record["P31_Pa"] / record["P25_Pa"])[window]))
    flow = run.near_stall("Wc25_kg_s") / LBM_KG
    top = float(np.max(record["Wc25_kg_s"][window])) / LBM_KG
    return {
        24: Finding(
            f"P25 {before['P25_Pa'] / PSI_PA:.1f} to {after['P25_Pa'] / PSI_PA:.1f} psia, T25 "
            f"{1.8 * before['T25_K']:.0f} to {1.8 * after['T25_K']:.0f} °R",
            after["P25_Pa"] > 1.2 * before["P25_Pa"] and after["T25_K"] > 1.2 * before["T25_K"],
        ),
        25: Finding(
            round(float(np.median(speed)), 1), low >= 70.0 and high <= 80.0, {"ends": (low, high)}
        ),
        26: Finding(
            round(ratio, 3),
            1.52 <= ratio <= 1.98 and abs(implied / ratio - 1.0) < 0.01,
            {"implied": implied},
        ),
        27: Finding(
            f"pressure ratio {peak:.1f} for {first:.1f}, flow {top:.0f} for {flow:.0f} lbm/s",
            peak < 0.5 * first and top < 0.75 * flow,
        ),
    }


def stall(runs: Instabilities) -> Findings:
    """Check reversal at hub and tip, the first stall, heating in stall, and the stall cells."""
    record, window = runs[MAIN].paper.record, runs[MAIN].window
    tip, hub = (
        float(np.mean(np.minimum(record[f"Wc25_{side}_kg_s"][window], 0.0))) / LBM_KG
        for side in ("tip", "hub")
    )
    flow, exit_pa, inlet_pa = (
        record[name] for name in ("Wc25_unfiltered_kg_s", "P31_unfiltered_Pa", "P25_unfiltered_Pa")
    )
    reversal = int(np.flatnonzero(flow < 0.0)[0])
    onset = reversal - 30
    spike = onset + int(np.argmax(inlet_pa[onset : reversal + 10]))
    rise = float(inlet_pa[spike] / inlet_pa[onset] - 1.0)
    drop = float(1.0 - np.min(inlet_pa[spike : spike + 10]) / inlet_pa[spike])
    fall = float(1.0 - exit_pa[reversal + 30] / exit_pa[onset])
    slope = np.gradient(record["T25_K"], record.sample_period_s)
    stalled = record["in_stall"] > 0.5
    # Some machines never leave stall in the window: then there is no recovery to fall in.
    inside, outside = (
        float(np.sum(slope[window & mask])) / max(int(np.count_nonzero(window & mask)), 1)
        for mask in (stalled, ~stalled)
    )
    cells = cell_power_ratio(runs[MAIN])
    return {
        29: Finding(
            f"mean reversed flow {-tip:.1f} lbm/s at the tip, {-hub:.1f} at the hub",
            tip < 2.0 * hub,
        ),
        30: Finding(
            f"P31 -{100 * fall:.0f} %, flow reversed, P25 +{100 * rise:.0f} % and "
            f"-{100 * drop:.0f} %",
            fall > 0.1 and rise > 0.1 and drop > 0.5 * rise and flow[onset] > 0.0,
            {"apart": abs(spike - reversal)},
        ),
        31: Finding(
            f"{inside:+.0f} K/s in stall, {outside:+.0f} K/s in recovery", inside > 0.0 > outside
        ),
        32: Finding(round(cells, 1), cells > 4.0),
    }


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
    if not (inside.size and outside.size):
        return math.nan
    power = [float(np.median(np.square(s - np.mean(s)))) for s in (inside, outside)]
    return power[0] / power[1]
