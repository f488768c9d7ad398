"""Claims 1 to 15: the machine, its rakes, their calibration and the flow equations."""

from __future__ import annotations

from itertools import product

import numpy as np

from classic_ml.calibration import volts
from classic_ml.flow import (
    calculated_mach,
    corrected_flow,
    mach_from_corrected_flow,
    physical_flow,
    true_mach,
)
from comparisons.paper.claims_base import PSI_PA, Claim, ClaimCheck, near_stall_mean, sensors_of
from comparisons.paper.instabilities import INSTABILITIES, Instabilities
from comparisons.rig.gas import probe_pressures_pa
from comparisons.rig.readings import remote_pressure_pa
from comparisons.rig.sensors import lag, rake_temperature_k, tube
from surge_core.types import FloatArray

__all__ = ["CLAIMS"]

SECTION = "Data acquisition"
MAIN = "985"
RATE_HZ = 10_000.0


def claim_01(runs: Instabilities) -> Claim:
    """Check claim 1: planes 25 and 31 of a machine in the E3 compressor's class."""
    test = runs[MAIN].paper.test
    planes = tuple(sorted(test.areas_m2))
    ratio = near_stall_mean(runs[MAIN], "P31_Pa") / near_stall_mean(runs[MAIN], "P25_Pa")
    return Claim(
        1,
        "Introduction",
        "A 10-stage E3 compressor (pressure ratio 23) with planes 25 (inlet) and 31 (exit)",
        "planes 25 and 31",
        f"planes {planes[0]} and {planes[1]}, pressure ratio {ratio:.1f} near stall",
        planes == (25, 31) and abs(ratio / 23.0 - 1.0) < 0.1,
        "planes in the test description; pressure ratio near stall within 10 % of 23. The rig is "
        "lumped: it has no stages to count",
    )


def claim_02(runs: Instabilities) -> Claim:
    """Check claim 2: two rakes with two immersions at each plane."""
    test = runs[MAIN].paper.test
    places = {p: {(pair.forward.rake, pair.immersion) for pair in test.pairs(p)} for p in (25, 31)}
    rakes = {p: {rake for rake, _ in places[p]} for p in places}
    sides = {side for p in places for _, side in places[p]}
    return Claim(
        2,
        SECTION,
        "Two rakes at each plane with two immersions, hub and tip: four local flows a plane",
        4.0,
        float(min(len(found) for found in places.values())),
        all(len(p) == 4 for p in places.values())
        and all(len(r) == 2 for r in rakes.values())
        and sides == {"hub", "tip"},
        "probe pairs in the test description, and the local flows computed from them",
        "flows",
    )


def claim_03(runs: Instabilities) -> Claim:
    """Check claim 3: five sensors on each rake."""
    run = runs[MAIN]
    test = run.paper.test
    each = {}
    for plane, rake in product((25, 31), ("A", "B")):
        pressures = [c for c in test.pressures if (c.plane, c.rake) == (plane, rake)]
        couples = [c for c in test.temperatures if (c.plane, c.rake) == (plane, rake)]
        forward = sum(c.facing == "forward" for c in pressures)
        each[plane, rake] = (forward, len(pressures) - forward, len(couples))
    return Claim(
        3,
        SECTION,
        "Five sensors a rake: two forward and two aft pressures and a thermocouple; 20 channels",
        20.0,
        float(len(run.rig.raw.channels)),
        len(run.rig.raw.channels) == 20 and set(each.values()) == {(2, 2, 1)},
        "channels of the raw record, by plane and rake",
        "channels",
    )


def claim_04(runs: Instabilities) -> Claim:
    """Check claim 4: natural frequency of the tubes, from an impulse through the rig's tube."""
    settings = sensors_of(runs[MAIN])
    impulse = np.zeros(20_001)
    impulse[1] = 1.0
    response = np.fft.rfft(
        tube(
            impulse,
            frequency_hz=settings.tube_frequency_hz,
            damping=settings.tube_damping,
            rate_hz=RATE_HZ,
        )
    )
    response *= np.conj(np.fft.rfft(impulse))
    frequency = np.fft.rfftfreq(impulse.size, 1.0 / RATE_HZ)
    # A second-order response lags by a quarter turn at its natural frequency.
    natural = float(np.interp(-0.5 * np.pi, np.angle(response)[2000:1:-1], frequency[2000:1:-1]))
    error = {hz: abs(response[np.argmin(np.abs(frequency - hz))]) - 1.0 for hz in (7.0, 16.0, 82.5)}
    return Claim(
        4,
        SECTION,
        "The tubes' natural frequency is 400 Hz, well above the frequencies of surge",
        400.0,
        round(natural, 1),
        abs(natural / 400.0 - 1.0) < 0.01 and abs(error[16.0]) < 0.01,
        "frequency of a quarter turn of phase of the rig's tube; its gain is off by "
        + ", ".join(f"{100 * e:.2f} % at {hz:g} Hz" for hz, e in error.items()),
        "Hz",
    )


def claim_05(runs: Instabilities) -> Claim:
    """Check claim 5: the remote transducers read the steady pressure of the tubes."""
    run = runs[MAIN]
    settings, truth = sensors_of(run), run.rig.truth
    window = (truth.time_s >= 1.8) & (truth.time_s <= 3.6)
    remote = remote_pressure_pa(truth["P25_Pa"], settings, rate_hz=truth.sample_rate_hz)[window]
    swing = float(np.std(remote - _line(remote)) / np.std(truth["P25_Pa"][window]))
    reading = run.rig.test["near_stall"]
    before = truth.time_s <= reading["to_s"]
    off = max(
        abs(reading[f"{name}_Pa"] / float(np.mean(truth[f"{name}_Pa"][before])) - 1.0)
        for name in ("P25", "P31")
    )
    return Claim(
        5,
        SECTION,
        "A leak path lets a remote transducer read the steady pressure of the tube",
        "steady pressure",
        f"steady pressure within {100 * off:.3f} %, {100 * swing:.0f} % of the surge",
        swing < 0.1 and off < 1e-3,
        "the rig's leak path is a low-pass; the facility's near-stall reading comes through it. "
        "Less than 10 % of the surge may pass, and the reading must be right to 0.1 %",
    )


def _line(values: FloatArray) -> FloatArray:
    x = np.arange(values.size)
    return np.asarray(np.polyval(np.polyfit(x, values, 1), x))


def claim_06(runs: Instabilities) -> Claim:
    """Check claim 6: time constant of the thermocouples, from a step."""
    settings = sensors_of(runs[MAIN])
    described = {c.time_constant_s for c in runs[MAIN].paper.test.temperatures}
    step = np.ones(2001)
    step[0] = 0.0
    rise = lag(step, time_constant_s=settings.thermocouple_lag_s, rate_hz=RATE_HZ)
    # The step itself takes one sample; its middle is the time zero.
    time_ms = 1e3 * (np.arange(step.size) - 0.5) / RATE_HZ
    found = float(np.interp(1.0 - np.exp(-1.0), rise, time_ms))
    return Claim(
        6,
        SECTION,
        "Type E thermocouples 0.001 in thick have a time constant of 10 ms",
        10.0,
        round(found, 2),
        abs(found / 10.0 - 1.0) < 0.02 and described == {0.010},
        "time to 63 % of a step through the rig's thermocouple; the test description says the same",
        "ms",
    )


def claim_07(runs: Instabilities) -> Claim:
    """Check claim 7: recovery of the thermocouples, from raw readings against the facility's."""
    ratios = []
    for case in INSTABILITIES:
        run = runs[case]
        reading = run.rig.test["near_stall"]
        rows = run.rig.raw.time_s <= reading["to_s"]
        ratios += [float(np.mean(run.rig.raw[f"T25_{rake}"][rows])) for rake in ("A", "B")]
        ratios[-2:] = [value / reading["T25_K"] for value in ratios[-2:]]
    found = float(np.mean(ratios))
    factors = {c.recovery_factor for c in runs[MAIN].paper.test.temperatures}
    return Claim(
        7,
        SECTION,
        "Temperature recovery of the probes, indicated over total",
        0.994,
        round(found, 4),
        abs(found - 0.994) < 0.001 and factors == {0.994},
        f"raw T25 over the facility's reading near stall, {len(ratios)} thermocouple readings",
    )


def claim_08(runs: Instabilities) -> Claim:
    """Check claim 8: temperatures of the rakes, which circulation keeps."""
    run = runs[MAIN]
    truth, settings = run.rig.truth, sensors_of(run)
    fahrenheit = {
        plane: 1.8
        * rake_temperature_k(plane, truth[f"T{plane}_K"], settings, rate_hz=truth.sample_rate_hz)
        - 459.67
        for plane in (25, 31)
    }
    inlet, leaving = fahrenheit[25], fahrenheit[31]
    drift = settings.sensitivity_per_k * float(np.ptp(inlet)) / 1.8
    return Claim(
        8,
        SECTION,
        "Oil keeps the plane 25 rakes at 100 °F, water the plane 31 transducers below 110 °F",
        "100 °F; below 110 °F",
        f"{inlet.min():.0f} to {inlet.max():.0f} °F; at most {leaving.max():.0f} °F",
        abs(inlet[0] - 100.0) < 1.0 and float(np.ptp(inlet)) < 10.0 and leaving.max() < 110.0,
        "rake temperatures of the rig through the surge, plane 25 within 10 °F; sensitivity "
        f"moves by {100 * drift:.2f} %",
    )


def claim_09(runs: Instabilities) -> Claim:
    """Check claim 9: the reference pressure extends the range of the differential transducers."""
    run = runs[MAIN]
    test, after = run.paper.test, run.rig.raw.time_s > 1.2
    clipped, gauge = 0.0, 0.0
    for channel in test.pressures:
        codes = run.rig.raw[channel.name][after]
        clipped = max(clipped, float(np.mean((codes <= 0) | (codes >= test.adc.top_code))))
        per_pa = (channel.calibrate_count - channel.zero_count) / channel.calibrate_pressure_Pa
        if channel.plane == 25:
            gauge = max(gauge, 0.5 * (test.adc.top_code + 1) / per_pa)
    readings = [run.rig.truth_parameters["sensors"][f"zoc_{plane}"] for plane in (25, 31)]
    apart = max(abs(r["tape_Pa"] / r["true_Pa"] - 1.0) for r in readings)
    return Claim(
        9,
        SECTION,
        "Differential transducers about a ZOC reference, which is on tape and read by the facility",
        "range about a reference",
        f"±{gauge / PSI_PA:.0f} psi about {test.pressures[0].zoc_reference_Pa / PSI_PA:.0f} psia, "
        f"at most {100 * clipped:.1f} % of a channel clipped",
        clipped < 0.01 and apart < 1e-3,
        "range at plane 25 from zero and calibrate readings; less than 1 % of any channel may "
        f"clip in the cycles. Tape and facility readings agree with the reference to {apart:.0e}",
    )


def claim_10(runs: Instabilities) -> Claim:
    """Check claim 10: sensitivity and bias from the readings, against the transducers' own."""
    sensitivity, bias = [], []
    for case in INSTABILITIES:
        test, own = runs[case].paper.test, runs[case].rig.truth_parameters["sensors"]
        for channel in test.pressures:
            zero, high = (
                float(volts(c, test.adc)) for c in (channel.zero_count, channel.calibrate_count)
            )
            found = (high - zero) / channel.calibrate_pressure_Pa
            sensitivity.append(found / own[channel.name]["sensitivity_V_Pa"] - 1.0)
            bias.append((zero - own[channel.name]["bias_V"]) / test.adc.volts_per_count)
    percent = 100.0 * float(np.sqrt(np.mean(np.square(sensitivity))))
    counts = float(np.sqrt(np.mean(np.square(bias))))
    return Claim(
        10,
        SECTION,
        "The zero and calibrate readings suffice to find sensitivity and bias of each transducer",
        "sufficient",
        f"sensitivity to {percent:.3f} %, bias to {counts:.2f} counts",
        percent < 0.1 and counts < 0.5,
        f"rms error over {len(bias)} transducers; 0.1 % and half a count allowed. Worst: "
        f"{100 * max(map(abs, sensitivity)):.3f} % and {max(map(abs, bias)):.2f} counts",
    )


def claim_11(runs: Instabilities) -> Claim:
    """Check claim 11: the near-stall match, on the matched record."""
    before, after = [], []
    for case in INSTABILITIES:
        run = runs[case]
        entry = next(e for e in run.paper.record.history if e.step == "near-stall match")
        for channel in run.paper.test.pressures:
            if channel.facing == "forward":
                target = run.paper.test.near_stall.pressure_Pa(channel.plane)
                name = f"shift_{channel.plane}_{channel.rake}_{channel.immersion}_Pa"
                before.append(abs(float(entry.parameters[name])) / target)
                after.append(abs(near_stall_mean(run, channel.name) / target - 1.0))
    return Claim(
        11,
        SECTION,
        "A near-stall point sets a DC bias that makes the rakes match the facility's reading",
        0.0,
        round(100.0 * max(after), 4),
        max(after) < 1e-3,
        f"largest mean error of {len(after)} forward probes near stall; up to "
        f"{100 * max(before):.2f} % before the match, 0.1 % allowed after it",
        "%",
    )


def claim_12(runs: Instabilities) -> Claim:
    """Check claim 12: tape and amplifiers: noise, and a gain and an offset of each channel."""
    run = runs[MAIN]
    test, settings = run.paper.test, sensors_of(run)
    rows = run.rig.raw.time_s <= 0.14
    full = 0.5 * (test.adc.top_code + 1)
    noise = np.array([np.std(np.diff(run.rig.raw[c.name][rows])) for c in test.pressures])
    percent = 100.0 * float(np.median(noise)) / np.sqrt(2.0) / full
    span = [
        (c.calibrate_count - c.zero_count) / c.calibrate_pressure_Pa
        for c in test.pressures
        if c.plane == 25
    ]
    scatter = float(np.std(span) / np.mean(span))
    offset = float(np.std([c.zero_count - full for c in test.pressures]))
    return Claim(
        12,
        SECTION,
        "Analog FM tape, playback to DC volts, an amplifier, then the converter",
        "tape and amplifier",
        f"noise {percent:.2f} % of full scale, gains ±{100 * scatter:.1f} %, offsets ±"
        f"{offset:.0f} counts",
        0.0 < percent < 1.0 and scatter > 0.0 and offset > 0.0,
        f"raw counts near stall; the rig's tape puts {settings.noise_percent:g} % of white noise "
        "on each channel before the anti-alias filter",
    )


def claim_13(runs: Instabilities) -> Claim:
    """Check claim 13: the converter."""
    run = runs[MAIN]
    codes = [run.rig.raw[c.name] for c in run.paper.test.pressures]
    whole = all(np.array_equal(c, np.round(c)) for c in codes)
    inside = all(float(c.min()) >= 0 and float(c.max()) <= 4095 for c in codes)
    bits, rate = run.paper.test.adc.bits, run.rig.raw.sample_rate_hz
    return Claim(
        13,
        SECTION,
        "A 12-bit converter at 1000 samples a second",
        "12 bits, 1000 /s",
        f"{bits} bits, {rate:g} /s",
        bits == 12 and rate == 1000.0 and whole and inside,
        "test description and clock; every code of the 16 pressures is a whole number of 0 to 4095",
    )


def claim_14(runs: Instabilities) -> Claim:
    """Check claim 14: Eq 1 to 4 with the reverse rule, against the rig's own inverse of them."""
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
    return Claim(
        14,
        SECTION,
        "Eq 1 to 4 give the flow in both directions from the pressures of a probe pair",
        0.0,
        float(f"{worst:.1e}"),
        worst < 1e-9,
        "largest relative error of the flow, from pressures that the rig made with its own "
        "equations, M from -0.6 to 0.6 without the dead band",
    )


def claim_15(runs: Instabilities) -> Claim:
    """Check claim 15: the aft probe reads slightly above static pressure."""
    test = runs[MAIN].paper.test
    slopes = [pair.forward.probe_slope for plane in (25, 31) for pair in test.pairs(plane)]
    excess = []
    for pair in test.pairs(25):
        mach = 0.5
        flow = corrected_flow(np.array([mach]), test.areas_m2[25], test.compressor)
        _, aft = probe_pressures_pa(
            flow,
            1.0,
            area_m2=test.areas_m2[25],
            slope=pair.forward.probe_slope,
            offset=pair.forward.probe_offset,
        )
        excess.append(float(aft[0]) * (1.0 + 0.2 * mach**2) ** 3.5 - 1.0)
    return Claim(
        15,
        SECTION,
        "The aft probe reads slightly above static, so that a of Eq 2 is above 1",
        "a above 1",
        f"a {min(slopes):g} to {max(slopes):g}; {100 * min(excess):.1f} to "
        f"{100 * max(excess):.1f} % above static",
        min(slopes) > 1.0 and min(excess) > 0.0,
        "constants of the probe pairs, and the rig's aft pressure against static at M = 0.5",
    )


CLAIMS: tuple[ClaimCheck, ...] = (
    claim_01,
    claim_02,
    claim_03,
    claim_04,
    claim_05,
    claim_06,
    claim_07,
    claim_08,
    claim_09,
    claim_10,
    claim_11,
    claim_12,
    claim_13,
    claim_14,
    claim_15,
)
