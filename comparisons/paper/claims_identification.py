"""Claims 33 to 48: the identified curves and time constants, and what they hang on.

Each function checks the claims on one subject and gives a finding for each, by its number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.flow import LBM_KG
from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import score_fit, trusted_range
from comparisons.harness.rows import stack_rows
from comparisons.paper.claim import Finding, Findings
from comparisons.paper.claims_facility import cell_power_ratio
from comparisons.paper.instabilities import (
    STEADY_STALL,
    THRESHOLD_LBM_S,
    TRIAL_TIME_CONSTANT_S,
    WRONG_TIME_CONSTANT_S,
    Instabilities,
    InstabilityRun,
    fit_paper,
    reduce_run,
    run_case,
)
from comparisons.results import FitRows, FitScore, FittedLag
from comparisons.rig import CASES, simulate
from comparisons.rig.drawn import SHAPES, shaped
from comparisons.rig.plant import PLANT_RATE_HZ, run_plant
from surge_core.segments import intervals_where
from surge_core.types import FloatArray, IntArray

MAIN, SLOW = "985", "90"
FASTER = ("95", "985", "985-second")
# Flows at which curves are compared: the forward part of the range that the paper calls reliable.
CURVE_PHI = np.linspace(0.0, 0.15, 31)
RELIABLE_PHI = (-0.025, 0.175)
VALID_PHI = np.linspace(0.0, 0.1, 21)
# An estimate that moves by no more than this is "insensitive" (list of claims, number 34).
INSENSITIVE = 0.05
# A curve is a valid estimate where it is this near the truth.
VALID_WITHIN = 0.1
TRIALS_MS = np.arange(6.0, 61.0, 1.0)
SEEDS = 6
SHIFTS_MS = (2.0, 5.0, 10.0)
# Below this calculated Mach number the probes' law is varied: b of Eq 2 falls to nothing in
# proportion in place of its jump at zero flow. No calibration says which holds there.
PROBE_RAMP = 0.03
# Truths that are no parabola: a kink, and a cubic part.
BENT = ("kink 25", "+300 φ³")
# "Steeper near zero flow" is a result where the slope there is known to this share.
SLOPE_WITHIN = 0.5
# Thresholds between the regimes, in lbm/s, at which τ is looked for: all that separate something.
WIDE_LBM_S = tuple(float(value) for value in range(14, 63, 6))
# Facilities that differ from the paper's: in words, a number of the case and its factor.
FACILITIES = (
    ("V31 +5 %", "discharge_volume_m3", 1.05),
    ("V31 -3 %", "discharge_volume_m3", 0.97),
    ("throttle +3 %", "open_ratio", 1.03),
    ("Vin +20 %", "inlet_volume_m3", 1.2),
    ("supply slope +10 %", "supply_pump_kg_s_pa", 1.1),
)


def curve_change(
    fit: FittedLag, other: FittedLag | FloatArray, phi: FloatArray = CURVE_PHI
) -> float:
    """Return the largest relative difference of a characteristic from another, its measure."""
    reference = other.quasi_steady(phi) if isinstance(other, FittedLag) else other
    return float(np.max(np.abs(fit.quasi_steady(phi) / reference - 1.0)))


def steady_points(series: CoefficientSeries) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return φ, mean ψ' and its standard deviation in bins of φ, as steady readings would be."""
    phi, psi_p = series.phi[series.scored], series.psi_p[series.scored]
    bins = np.floor(phi / 0.02).astype(np.int64)
    groups = [bins == b for b in np.unique(bins) if np.count_nonzero(bins == b) >= 50]
    table = [(np.mean(phi[g]), np.mean(psi_p[g]), np.std(psi_p[g], ddof=1)) for g in groups]
    means, values, spreads = np.asarray(table, dtype=np.float64).T
    return means, values, spreads


def regimes(runs: Instabilities) -> Findings:
    """Check which thresholds split the cycles into the two regimes."""
    run = runs[MAIN]
    flow = run.paper.record["Wc25_kg_s"] / LBM_KG
    stalls = intervals_where((run.rig.truth["in_stall"] > 0.5) & run.window)
    split = [
        threshold
        for threshold in range(10, 91)
        if _one_to_one(stalls, intervals_where((flow < threshold) & run.window))
    ]
    low, high = (min(split), max(split)) if split else (0, 0)
    used = run.paper.test.threshold_lbm_s == THRESHOLD_LBM_S
    holds = low <= THRESHOLD_LBM_S <= high and used
    return {33: Finding(f"any of {low} to {high} lbm/s", holds, {"n": len(stalls)})}


def _one_to_one(stalls: IntArray, found: IntArray) -> bool:
    """Whether each interval that was found holds the middle of exactly one stall."""
    middles = (stalls.sum(axis=1) - 1) // 2
    inside = (found[:, :1] <= middles) & (middles < found[:, 1:])
    return len(found) == len(stalls) and bool(np.all(inside.sum(axis=1) == 1))


def other_thresholds(runs: Instabilities) -> Findings:
    """Check that the estimate does not hang on the threshold or on hysteresis."""
    run = runs[MAIN]
    varied = [replace(run.paper.settings, threshold_lbm_s=value) for value in (40.0, 45.0, 55.0)]
    varied.append(replace(run.paper.settings, hysteresis_lbm_s=8.0))
    changes = [
        curve_change(fit_paper(reduce_run(run.rig, settings).series), run.fits["psi_p"])
        for settings in varied
    ]
    return {34: Finding(round(100.0 * max(changes), 1), max(changes) < INSENSITIVE)}


def linking(runs: Instabilities) -> Findings:
    """Check what linking the intervals does to the curve, and where in φ the data dwell."""
    run = runs[MAIN]
    fit, linked = run.fits["psi_p"], run.fits["psi_p_linked"]
    change, truth = curve_change(linked, fit), run.machine.in_stall_psi_p(CURVE_PHI)
    off = {"linked": 100.0 * curve_change(linked, truth), "apart": 100.0 * curve_change(fit, truth)}
    low, high = trusted_range(run.paper.series.phi[run.paper.series.scored])
    phi = np.linspace(*RELIABLE_PHI, 41)
    error = curve_change(fit, run.machine.in_stall_psi_p(phi), phi)
    dwells = abs(low - RELIABLE_PHI[0]) <= 0.03 and abs(high - RELIABLE_PHI[1]) <= 0.03
    return {
        35: Finding(round(100.0 * change, 1), change < INSENSITIVE, off),
        37: Finding(f"{low:.3f} to {high:.3f}", dwells, {"error": 100.0 * error}),
    }


def parabola(runs: Instabilities) -> Findings:
    """Check the parabola against steady rotating stall, and where the truth is none."""
    surge, series = runs[MAIN].fits["psi_p"], runs[STEADY_STALL].paper.series
    phi, measured, _ = steady_points(series)
    # The static parabola of a steady record, as a low-speed test gives it.
    steady = np.polynomial.Polynomial.fit(series.phi[series.scored], series.psi_p[series.scored], 2)
    off = float(np.max(np.abs(steady(phi) / measured - 1.0)))
    below = measured - surge.quasi_steady(phi)
    slope, steady_slope = _slope(surge.quasi_steady), _slope(steady)
    errors, wrong = {}, {}
    for shape in BENT:
        bent = run_case(shaped(runs[MAIN].machine, *SHAPES[shape]), runs[MAIN].seed)
        fit, true = bent.fits["psi_p"], bent.machine.in_stall_psi_p
        errors[shape] = curve_change(fit, true(CURVE_PHI))
        wrong[shape] = abs(_slope(fit.quasi_steady) / _slope(true) - 1.0)
    right = surge.terms == ("1", "phi", "phi^2") and off < 0.02
    steeper = float(below.min()) > 0.0 and slope > steady_slope
    return {
        36: Finding(
            len(surge.terms),
            right and max(errors.values()) < VALID_WITHIN,
            {"n": phi.size, "off": 100.0 * off, "errors": _by_shape(errors)},
        ),
        39: Finding(
            f"lower by {below.min():.2f} to {below.max():.2f}; slope {slope:.1f} for "
            f"{steady_slope:.1f}",
            steeper and max(wrong.values()) < SLOPE_WITHIN,
            {"n": phi.size, "phi": (phi.min(), phi.max()), "wrong": _by_shape(wrong)},
        ),
    }


def _by_shape(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{100 * error:.0f} % ({shape})" for shape, error in errors.items())


def _slope(curve: Callable[[FloatArray], ArrayLike]) -> float:
    """Return the mean slope of a characteristic from φ = 0 to 0.05."""
    return float(np.diff(np.asarray(curve(np.array([0.0, 0.05]))))[0]) / 0.05


def slow_dynamics(runs: Instabilities) -> Findings:
    """Check for a time constant that is far too long, looked for at 98.5 % speed."""
    run = runs[MAIN]
    found_ms, true_ms = 1e3 * run.fits["psi_p"].time_constant_s, 1e3 * run.machine.tau_s
    slow = fit_paper(reduce_run(simulate("blowdown", seed=run.seed)).series)
    others = {}
    for threshold in WIDE_LBM_S:
        settings = replace(run.paper.settings, threshold_lbm_s=threshold)
        others[threshold] = 1e3 * fit_paper(reduce_run(run.rig, settings).series).time_constant_s
    worst = max(others, key=lambda threshold: others[threshold])
    seen = {"true": true_ms, "slow": 1e3 * slow.time_constant_s}
    seen |= {"worst": others[worst], "threshold": worst}
    return {38: Finding(round(found_ms, 1), found_ms > 3.0 * true_ms, seen)}


def low_speed(runs: Instabilities) -> Findings:
    """Check the 90 % test: no segmentation, both coefficients, reversal, curves, free run."""
    run, ratio = runs[SLOW], cell_power_ratio(runs[SLOW])
    series, window = run.paper.series, run.window
    whole = series.n_segments == 1 and bool(series.scored[window].all())
    taus = [run.fits[name].time_constant_s for name in ("psi_p", "psi") if name in run.fits]
    clipped = {}
    for case in (SLOW, *FASTER):
        rig = runs[case].rig
        rows = rig.raw.time_s <= rig.test["near_stall"]["to_s"]
        clipped[case] = float(np.mean(rig.raw["T31_A"][rows] >= rig.test["limits"]["T31_A"][1]))
    known = [case for case in clipped if runs[case].paper.series.psi is not None]
    limited = clipped == {SLOW: 0.0} | dict.fromkeys(FASTER, 1.0)
    inlet, leaving = (run.paper.record[f"W{p}_kg_s"][window] / LBM_KG for p in (25, 31))
    share = float(np.sum(np.minimum(leaving, 0.0)) / np.sum(np.minimum(inlet, 0.0)))
    pressure, work = (
        curve_change(run.fits[name], truth(VALID_PHI), VALID_PHI)
        for name, truth in (
            ("psi_p", run.machine.in_stall_psi_p),
            ("psi", run.machine.in_stall_psi),
        )
    )
    score = _reconstruct(run.fits["psi_p"], stack_rows([series]), TRIAL_TIME_CONSTANT_S)
    return {
        40: Finding(
            f"{len(taus)} coefficients, {series.n_segments} segment",
            whole and len(taus) == 2 and bool(np.isfinite(taus).all()) and ratio < 4.0,
            {
                "ratio": ratio,
                "high": cell_power_ratio(runs[MAIN]),
                "taus": " and ".join(f"{1e3 * tau:.0f} ms" for tau in taus),
            },
        ),
        41: Finding(
            "ψ at " + ", ".join(f"{case} %" for case in known),
            known == [SLOW] and "W31_kg_s" in run.paper.record and limited,
            {"clipped": ", ".join(f"{100 * s:.0f} % of rows ({c})" for c, s in clipped.items())},
        ),
        42: Finding(
            f"at most {-leaving.min():.1f} lbm/s reversed at the exit, {-inlet.min():.1f} at the "
            "inlet",
            share < 0.1,
            {"share": 100.0 * share},
        ),
        43: Finding(
            f"ψ' within {100 * pressure:.0f} %, ψ within {100 * work:.0f} %",
            max(pressure, work) < VALID_WITHIN,
        ),
        45: Finding(round(score.r2, 3), score.r2 > 0.8, {"n": score.n_rows}),
    }


def trial_and_error(runs: Instabilities) -> Findings:
    """Check the time constant by trial and error."""
    rows, fit = stack_rows([runs[SLOW].paper.series]), runs[SLOW].fits["psi_p"]
    errors, ramped = (
        [_reconstruct(curve, over, 1e-3 * tau).rms for tau in TRIALS_MS]
        for over, curve in ((rows, fit), _ramped(runs[SLOW]))
    )
    best, best_ramped = (float(TRIALS_MS[int(np.argmin(each))]) for each in (errors, ramped))
    chosen, wrong = (
        _reconstruct(fit, rows, tau).rms for tau in (TRIAL_TIME_CONSTANT_S, WRONG_TIME_CONSTANT_S)
    )
    near = max(abs(best - 18.0), abs(best_ramped - 18.0)) <= 4.0
    pole = float(np.exp(-1e-3 / TRIAL_TIME_CONSTANT_S))
    return {
        44: Finding(
            best,
            near
            and chosen < 1.1 * min(errors)
            and wrong > 2.0 * chosen
            and abs(pole - 0.945959) < 1e-6,
            {
                "ramped": best_ramped,
                "chosen": chosen,
                "wrong": wrong,
                "moves": np.std(rows.measured),
            },
        )
    }


def _ramped(run: InstabilityRun) -> tuple[FitRows, FittedLag]:
    """Reduce and fit a run with a law of the probes that has no jump at zero flow."""
    series = reduce_run(run.rig, replace(run.paper.settings, probe_ramp=PROBE_RAMP)).series
    return stack_rows([series]), fit_paper(series)


def _reconstruct(fit: FittedLag, rows: FitRows, time_constant_s: float) -> FitScore:
    """Return the fit of the deterministic part of a model with another time constant."""
    trial = replace(fit, time_constant_s=time_constant_s)
    return score_fit(rows.measured, trial.free_run_over(rows, []))


def disturbances(runs: Instabilities) -> Findings:
    """Check that the curve hardly moves under disturbances that move the time constant."""
    main = runs[MAIN]
    own = main.fits["psi_p"]
    fits = [own]
    for seed in range(main.seed + 1, main.seed + SEEDS):
        fits.append(fit_paper(reduce_run(simulate(MAIN, seed=seed), main.paper.settings).series))
    curves = np.array([fit.quasi_steady(CURVE_PHI) for fit in fits])
    taus = np.array([[fit.time_constant_s] for fit in fits])
    # Coefficient of variation over the fits, the worst over φ, and rms error.
    spread, spread_tau = (
        float(np.max(np.std(values, axis=0, ddof=1) / np.mean(values, axis=0)))
        for values in (curves, taus)
    )
    curve, tau = (
        float(np.sqrt(np.mean((values / truth - 1.0) ** 2)))
        for values, truth in (
            (curves, main.machine.in_stall_psi_p(CURVE_PHI)),
            (taus, main.machine.tau_s),
        )
    )
    _, ramped = _ramped(main)
    moved = curve_change(ramped, own)
    moved_tau = abs(ramped.time_constant_s / own.time_constant_s - 1.0)
    steady = spread < min(0.05, spread_tau) and moved < min(0.1, moved_tau)
    seen = {"scatter": spread, "scatter_tau": spread_tau, "moved": moved, "moved_tau": moved_tau}
    return {
        46: Finding(
            f"curve off by {100 * curve:.0f} %, τ by {100 * tau:.0f} %",
            steady and curve < 0.1 and tau > 2.0 * curve,
            {name: 100.0 * share for name, share in seen.items()},
        )
    }


def late_start(_: Instabilities) -> Findings:
    """Check a total-system model that starts its surge a little late."""
    case, n_rows = CASES[MAIN], round(3.6 * PLANT_RATE_HZ) + 1
    measured, *late = (
        run_plant(replace(case, close_start_s=case.close_start_s + 1e-3 * shift), n_rows=n_rows)[
            "P31"
        ][round(1.8 * PLANT_RATE_HZ) :]
        for shift in (0.0, *SHIFTS_MS)
    )
    errors = [
        100.0 * float(np.sqrt(np.mean((run - measured) ** 2)) / np.std(measured)) for run in late
    ]
    late_s = ", ".join(f"{e:.0f} % for {s:g} ms" for e, s in zip(errors, SHIFTS_MS, strict=True))
    needed = errors[0] > 5.0 and errors[-1] > 50.0
    return {47: Finding(round(errors[0], 1), needed, {"errors": late_s})}


def other_facilities(runs: Instabilities) -> Findings:
    """Check the component's curve in other facilities."""
    main, base = runs[MAIN], CASES[MAIN]
    changes = {}
    for words, field, factor in FACILITIES:
        case = replace(base, **{field: factor * getattr(base, field)})
        series = reduce_run(simulate(case, seed=main.seed), main.paper.settings).series
        changes[words] = curve_change(fit_paper(series), main.fits["psi_p"])
    seen = ", ".join(f"{name} {100 * change:.1f} %" for name, change in changes.items())
    largest = max(changes.values())
    return {48: Finding(round(100.0 * largest, 1), largest < 0.1, {"changes": seen})}
