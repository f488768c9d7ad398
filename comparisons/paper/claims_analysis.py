"""Claims 23 to 32: what the surge looks like, mostly at 98.5 % speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.calibration import calibrate
from classic_ml.cycles import find_cycles
from classic_ml.filters import low_pass
from comparisons.paper.claims_base import (
    LBM_KG,
    PSI_PA,
    Claim,
    ClaimCheck,
    near_stall_mean,
    window_mask,
)
from comparisons.paper.instabilities import Instabilities, InstabilityRun
from surge_core.types import FloatArray

__all__ = ["CLAIMS", "cell_power_ratio"]

SECTION = "Data analysis"
MAIN, SECOND = "985", "985-second"
# K to °R.
RANKINE = 1.8
# The paper's threshold between in-stall and unstalled flow.
RECOVERED_KG_S = 50.0 * LBM_KG


def claim_23(runs: Instabilities) -> Claim:
    """Check claim 23: time from the first reversal to the first of the cycles that repeat."""
    found = {case: _settling_s(runs[case]) for case in (MAIN, SECOND)}
    return Claim(
        23,
        SECTION,
        "Quasi-steady surge cycles are established about 1.4 s after the initial instability",
        1.4,
        round(found[MAIN], 2),
        all(abs(wait - 1.4) <= 0.4 for wait in found.values()),
        "from the first flow reversal to the stall (reversal) with which the first repeating cycle "
        f"begins; {found[SECOND]:.2f} s in the second 98.5 % instability. 0.4 s allowed for each",
        "s",
    )


def _settling_s(run: InstabilityRun) -> float:
    """Return the wait; a surge cycle starts at stall, in the paper's words."""
    record = run.paper.record
    cycles = find_cycles(record)
    flow, time_s = record["Wc25_kg_s"], record.time_s
    # From its trough of P31 the machine recovers and then stalls: that stall starts the cycle.
    recovered = np.flatnonzero((time_s > cycles.from_s) & (flow > RECOVERED_KG_S))[0]
    stalled = recovered + np.flatnonzero(flow[recovered:] < 0.0)[0]
    return float(time_s[stalled]) - cycles.first_reversal_s


def claim_24(runs: Instabilities) -> Claim:
    """Check claim 24: inlet pressure and temperature rise after the first reversal."""
    pressure, heat = _rise(runs[MAIN], "P25_Pa"), _rise(runs[MAIN], "T25_K")
    return Claim(
        24,
        SECTION,
        "Inlet pressure and temperature rise significantly after the initial flow reversal",
        "a significant rise",
        f"P25 {pressure[0] / PSI_PA:.1f} to {pressure[1] / PSI_PA:.1f} psia, T25 "
        f"{RANKINE * heat[0]:.0f} to {RANKINE * heat[1]:.0f} °R",
        pressure[1] > 1.2 * pressure[0] and heat[1] > 1.2 * heat[0],
        "near stall against the median of the quasi-steady cycles; a fifth more is significant",
    )


def _rise(run: InstabilityRun, channel: str) -> tuple[float, float]:
    cycles = run.paper.record[channel][window_mask(run)]
    return near_stall_mean(run, channel), float(np.median(cycles))


def claim_25(runs: Instabilities) -> Claim:
    """Check claim 25: corrected speed during the quasi-steady cycles."""
    run = runs[MAIN]
    speed = 100.0 * run.paper.record["Nc_frac"][window_mask(run)]
    return Claim(
        25,
        SECTION,
        "At constant physical speed the corrected speed is driven down to 70 to 80 %",
        "70 to 80 %",
        round(float(np.median(speed)), 1),
        float(speed.min()) >= 70.0 and float(speed.max()) <= 80.0,
        f"median of the window; all of it lies between {speed.min():.1f} and {speed.max():.1f} %",
        "%",
    )


def claim_26(runs: Instabilities) -> Claim:
    """Check claim 26: the rise of T25 that this fall of corrected speed means."""
    before, after = _rise(runs[MAIN], "T25_K")
    speed = _rise(runs[MAIN], "Nc_frac")
    ratio, implied = after / before, (speed[0] / speed[1]) ** 2
    return Claim(
        26,
        SECTION,
        "That takes a T25 of (98.5/Nc)² times its first value, 1.52 to 1.98",
        "1.52 to 1.98",
        round(ratio, 3),
        1.52 <= ratio <= 1.98 and abs(implied / ratio - 1.0) < 0.01,
        f"median T25 of the window over that near stall; (Nc/Nc)² gives {implied:.3f}",
    )


def claim_27(runs: Instabilities) -> Claim:
    """Check claim 27: recoveries fall short of the first stall point."""
    run = runs[MAIN]
    record, window = run.paper.record, window_mask(run)
    first = near_stall_mean(run, "P31_Pa") / near_stall_mean(run, "P25_Pa")
    peak = float(np.max((record["P31_Pa"] / record["P25_Pa"])[window]))
    flow = near_stall_mean(run, "Wc25_kg_s") / LBM_KG
    top = float(np.max(record["Wc25_kg_s"][window])) / LBM_KG
    return Claim(
        27,
        SECTION,
        "The recoveries do not return to the pressure ratio and flow of the first stall",
        "much lower",
        f"pressure ratio {peak:.1f} for {first:.1f}, flow {top:.0f} for {flow:.0f} lbm/s",
        peak < 0.5 * first and top < 0.75 * flow,
        "highest of the window against near stall; less than half the pressure ratio and three "
        "quarters of the flow",
    )


def claim_28(runs: Instabilities) -> Claim:
    """Check claim 28: the window of the quasi-steady cycles."""
    cycles = find_cycles(runs[MAIN].paper.record)
    return Claim(
        28,
        SECTION,
        "From 1.8 to 3.6 s the surge cycles repeat and serve for the identification",
        "1.8 to 3.6 s",
        f"{cycles.from_s:.2f} to {cycles.to_s:.2f} s",
        cycles.from_s <= 1.8 and cycles.to_s >= 3.6 and runs[MAIN].paper.window_s == (1.8, 3.6),
        f"the search for cycles that repeat finds {cycles.n_cycles} of them and must cover the "
        "paper's window, which is what the 98.5 % fits use",
    )


def claim_29(runs: Instabilities) -> Claim:
    """Check claim 29: the tips reverse more than the hub."""
    run = runs[MAIN]
    window = window_mask(run)
    low = {
        side: float(np.mean(np.minimum(run.paper.record[f"Wc25_{side}_kg_s"][window], 0.0)))
        / LBM_KG
        for side in ("tip", "hub")
    }
    return Claim(
        29,
        SECTION,
        "The flow at the tips reverses to a much greater extent than at the hub",
        "much more at the tip",
        f"mean reversed flow {-low['tip']:.1f} lbm/s at the tip, {-low['hub']:.1f} at the hub",
        low["tip"] < 2.0 * low["hub"],
        "reversed part of the corrected flow at plane 25, averaged over the window; twice as much "
        "at the tip is much more",
    )


def claim_30(runs: Instabilities) -> Claim:
    """Check claim 30: the order of events of the first stall."""
    run = runs[MAIN]
    record = run.paper.record
    flow, exit_pa, inlet_pa = (
        record[f"{name}_unfiltered_{unit}"]
        for name, unit in (("Wc25", "kg_s"), ("P31", "Pa"), ("P25", "Pa"))
    )
    reversal = int(np.flatnonzero(flow < 0.0)[0])
    onset = reversal - 30
    near = slice(onset, reversal + 10)
    spike = onset + int(np.argmax(inlet_pa[near]))
    rise = float(inlet_pa[spike] / inlet_pa[onset] - 1.0)
    drop = float(1.0 - np.min(inlet_pa[spike : spike + 10]) / inlet_pa[spike])
    fall = float(1.0 - exit_pa[reversal + 30] / exit_pa[onset])
    return Claim(
        30,
        SECTION,
        "At stall P31 and flow drop, the flow reverses; P25 jumps up and as sharply drops",
        "P31 down, W < 0, P25 up and down",
        f"P31 -{100 * fall:.0f} %, flow reversed, P25 +{100 * rise:.0f} % and -{100 * drop:.0f} %",
        fall > 0.1 and rise > 0.1 and drop > 0.5 * rise and flow[onset] > 0.0,
        "unfiltered plane averages from 30 ms before to 30 ms after the first reversal; P25 has "
        f"its peak {abs(spike - reversal)} ms from it",
    )


def claim_31(runs: Instabilities) -> Claim:
    """Check claim 31: T25 rises in stall and falls in recovery."""
    run = runs[MAIN]
    record, window = run.paper.record, window_mask(run)
    slope = np.gradient(record["T25_K"], record.sample_period_s)
    stalled = record["in_stall"] > 0.5
    inside, outside = (float(np.mean(slope[window & mask])) for mask in (stalled, ~stalled))
    return Claim(
        31,
        SECTION,
        "The inlet temperature rises in stall and drops off in recovery",
        "up in stall, down in recovery",
        f"{inside:+.0f} K/s in stall, {outside:+.0f} K/s in recovery",
        inside > 0.0 > outside,
        "mean slope of T25 in the in-stall and in the unstalled rows of the window",
    )


def claim_32(runs: Instabilities) -> Claim:
    """Check claim 32: stall cells in the in-stall part of the cycles."""
    found = cell_power_ratio(runs[MAIN])
    return Claim(
        32,
        SECTION,
        "Rotating stall cells are present during the in-stall phase of the cycles",
        "cells in stall",
        round(found, 1),
        found > 4.0,
        "power of the difference of two rakes' tip pressures, in stall over unstalled: both see "
        "the same surge and not the same cells. Cells must double the amplitude",
        "times the power",
    )


def cell_power_ratio(run: InstabilityRun) -> float:
    """Return the power of the cells in stall over that in unstalled rows of the cycles.

    Parameters
    ----------
    run : InstabilityRun
        A run.
    """
    record = calibrate(run.rig.raw, run.paper.test)
    apart = record["P25_A_tip_forward"] - record["P25_B_tip_forward"]
    return _power(apart, run, stalled=True) / _power(apart, run, stalled=False)


def _power(signal: FloatArray, run: InstabilityRun, *, stalled: bool) -> float:
    rows = window_mask(run) & (_stalled(run) == stalled)
    return float(np.median(np.square(signal[rows] - np.mean(signal[rows]))))


def _stalled(run: InstabilityRun) -> NDArray[np.bool_]:
    """Tell the regimes by 50 lbm/s of flow, filtered without the delay of the causal filter."""
    record = run.paper.record
    flow = low_pass(
        record["Wc25_unfiltered_kg_s"], record.sample_rate_hz, order=3, cutoff_hz=48.0, phase="zero"
    )
    return np.asarray(flow < RECOVERED_KG_S)


CLAIMS: tuple[ClaimCheck, ...] = (
    claim_23,
    claim_24,
    claim_25,
    claim_26,
    claim_27,
    claim_28,
    claim_29,
    claim_30,
    claim_31,
    claim_32,
)
