"""Claims 23 to 32: what the surge looks like, mostly at 98.5 % speed."""

from __future__ import annotations

import math

import numpy as np

from classic_ml.calibration import calibrate
from classic_ml.cycles import find_cycles
from classic_ml.filters import low_pass
from classic_ml.flow import LBM_KG
from comparisons.paper.claim import Finding
from comparisons.paper.instabilities import THRESHOLD_LBM_S, Instabilities, InstabilityRun
from comparisons.rig.gas import PSI_PA

MAIN, SECOND = "985", "985-second"
RANKINE_PER_K = 1.8


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
    seen = {"low": low, "high": high}
    return Finding(round(float(np.median(speed)), 1), low >= 70.0 and high <= 80.0, seen)


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
