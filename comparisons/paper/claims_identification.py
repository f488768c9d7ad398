"""Claims 33 to 48: the identified curves and time constants, and what they hang on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.flow import LBM_KG
from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import score_fit, trusted_range
from comparisons.harness.rows import stack_rows
from comparisons.paper.claim import Finding
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
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

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
# "Little" beside "much": a tenth.
LITTLE = 0.1
# "Steeper near zero flow" is a result where the slope there is known to this share.
SLOPE_WITHIN = 0.5
# Thresholds between the regimes, in lbm/s, at which τ is looked for: all that separate something.
WIDE_LBM_S = tuple(float(value) for value in range(14, 63, 6))


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


def claim_33(runs: Instabilities) -> Finding:
    """Check: the threshold splits the cycles into the two regimes."""
    run = runs[MAIN]
    flow = run.paper.record["Wc25_kg_s"] / LBM_KG
    stalls = _intervals(run.stalled & run.window)
    split = [
        threshold
        for threshold in range(10, 91)
        if _one_to_one(stalls, _intervals((flow < threshold) & run.window))
    ]
    low, high = (min(split), max(split)) if split else (0, 0)
    return Finding(
        f"any of {low} to {high} lbm/s",
        low <= THRESHOLD_LBM_S <= high and run.paper.test.threshold_lbm_s == THRESHOLD_LBM_S,
        {"n": len(stalls)},
    )


def _intervals(state: BoolArray) -> list[slice]:
    return [run for run in runs_of(state, state.size) if state[run.start]]


def _one_to_one(stalls: list[slice], found: list[slice]) -> bool:
    """Whether each interval that was found holds the middle of exactly one stall."""
    middles = [(s.start + s.stop - 1) // 2 for s in stalls]
    return len(found) == len(stalls) and all(
        sum(f.start <= m < f.stop for m in middles) == 1 for f in found
    )


def claim_34(runs: Instabilities) -> Finding:
    """Check: the estimate does not hang on the threshold or on hysteresis."""
    run = runs[MAIN]
    varied = [replace(run.paper.settings, threshold_lbm_s=value) for value in (40.0, 45.0, 55.0)]
    varied.append(replace(run.paper.settings, hysteresis_lbm_s=8.0))
    changes = [
        curve_change(fit_paper(reduce_run(run.rig, settings).series), run.fits["psi_p"])
        for settings in varied
    ]
    return Finding(round(100.0 * max(changes), 1), max(changes) < INSENSITIVE)


def claim_35(runs: Instabilities) -> Finding:
    """Check: linking the intervals, against equations that respect the gaps."""
    fits = runs[MAIN].fits
    change = curve_change(fits["psi_p_linked"], fits["psi_p"])
    truth = runs[MAIN].machine.in_stall_psi_p(CURVE_PHI)
    linked, apart = (100.0 * curve_change(fits[n], truth) for n in ("psi_p_linked", "psi_p"))
    return Finding(
        round(100.0 * change, 1), change < INSENSITIVE, {"linked": linked, "apart": apart}
    )


def claim_36(runs: Instabilities) -> Finding:
    """Check: a parabola, as low-speed in-stall data suggest it; also where the truth is none."""
    terms = runs[MAIN].fits["psi_p"].terms
    series = runs[STEADY_STALL].paper.series
    phi, measured, _ = steady_points(series)
    off = float(np.max(np.abs(_steady_parabola(series)(phi) / measured - 1.0)))
    errors = {
        shape: curve_change(run.fits["psi_p"], run.machine.in_stall_psi_p(CURVE_PHI))
        for shape, run in _bent(runs).items()
    }
    return Finding(
        len(terms),
        terms == ("1", "phi", "phi^2") and off < 0.02 and max(errors.values()) < VALID_WITHIN,
        {"n": phi.size, "off": 100.0 * off, "errors": _by_shape(errors)},
    )


def _by_shape(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{100 * error:.0f} % ({shape})" for shape, error in errors.items())


def _bent(runs: Instabilities) -> dict[str, InstabilityRun]:
    """Return the 98.5 % test of machines whose in-stall curve is no parabola."""
    main = runs[MAIN]
    return {shape: run_case(shaped(main.machine, *SHAPES[shape]), main.seed) for shape in BENT}


def _steady_parabola(series: CoefficientSeries) -> np.polynomial.Polynomial:
    """Return the static parabola of a steady record, as a low-speed test gives it."""
    return np.polynomial.Polynomial.fit(series.phi[series.scored], series.psi_p[series.scored], 2)


def claim_37(runs: Instabilities) -> Finding:
    """Check: the range of φ in which the in-stall data dwell, by the measured histogram."""
    run = runs[MAIN]
    low, high = trusted_range(run.paper.series.phi[run.paper.series.scored])
    phi = np.linspace(*RELIABLE_PHI, 41)
    error = curve_change(run.fits["psi_p"], run.machine.in_stall_psi_p(phi), phi)
    return Finding(
        f"{low:.3f} to {high:.3f}",
        abs(low - RELIABLE_PHI[0]) <= 0.03 and abs(high - RELIABLE_PHI[1]) <= 0.03,
        {"error": 100.0 * error},
    )


def claim_38(runs: Instabilities) -> Finding:
    """Check: a time constant that is far too long, looked for at 98.5 % speed."""
    run = runs[MAIN]
    found_ms, true_ms = 1e3 * run.fits["psi_p"].time_constant_s, 1e3 * run.true_tau_s
    slow = fit_paper(reduce_run(simulate("blowdown", seed=run.seed)).series)
    others = {}
    for threshold in WIDE_LBM_S:
        settings = replace(run.paper.settings, threshold_lbm_s=threshold)
        others[threshold] = 1e3 * fit_paper(reduce_run(run.rig, settings).series).time_constant_s
    worst = max(others, key=lambda threshold: others[threshold])
    return Finding(
        round(found_ms, 1),
        found_ms > 3.0 * true_ms,
        {
            "true": true_ms,
            "worst": others[worst],
            "threshold": worst,
            "slow": 1e3 * slow.time_constant_s,
        },
    )


def claim_39(runs: Instabilities) -> Finding:
    """Check: the estimate lies below steady rotating stall and is steeper at no flow."""
    surge, series = runs[MAIN].fits["psi_p"], runs[STEADY_STALL].paper.series
    phi, measured, _ = steady_points(series)
    below = measured - surge.quasi_steady(phi)
    slope, steady_slope = _slope(surge.quasi_steady), _slope(_steady_parabola(series))
    wrong = {}
    for shape, run in _bent(runs).items():
        true = _slope(run.machine.in_stall_psi_p)
        wrong[shape] = abs(_slope(run.fits["psi_p"].quasi_steady) / true - 1.0)
    return Finding(
        f"lower by {below.min():.2f} to {below.max():.2f}; slope {slope:.1f} for "
        f"{steady_slope:.1f}",
        float(below.min()) > 0.0 and slope > steady_slope and max(wrong.values()) < SLOPE_WITHIN,
        {"n": phi.size, "phi": (phi.min(), phi.max()), "wrong": _by_shape(wrong)},
    )


def _slope(curve: Callable[[FloatArray], ArrayLike]) -> float:
    """Return the mean slope of a characteristic from φ = 0 to 0.05."""
    return float(np.diff(np.asarray(curve(np.array([0.0, 0.05]))))[0]) / 0.05


def claim_40(runs: Instabilities) -> Finding:
    """Check: no segmentation at 90 %, and both coefficients estimated."""
    run = runs[SLOW]
    series = run.paper.series
    whole = series.n_segments == 1 and bool(series.scored[run.window].all())
    taus = [run.fits[name].time_constant_s for name in ("psi_p", "psi") if name in run.fits]
    ratio = cell_power_ratio(run)
    return Finding(
        f"{len(taus)} coefficients, {series.n_segments} segment",
        whole and len(taus) == 2 and bool(np.isfinite(taus).all()) and ratio < 4.0,
        {
            "ratio": ratio,
            "high": cell_power_ratio(runs[MAIN]),
            "taus": " and ".join(f"{1e3 * tau:.0f} ms" for tau in taus),
        },
    )


def claim_41(runs: Instabilities) -> Finding:
    """Check: t31 beyond the acquisition's limit above 90 % speed."""
    clipped = {}
    for case in (SLOW, *FASTER):
        rig = runs[case].rig
        rows = rig.raw.time_s <= rig.test["near_stall"]["to_s"]
        clipped[case] = float(np.mean(rig.raw["T31_A"][rows] >= rig.test["limits"]["T31_A"][1]))
    known = [case for case in clipped if runs[case].paper.series.psi is not None]
    seen = ", ".join(f"{100 * share:.0f} % of rows ({case})" for case, share in clipped.items())
    return Finding(
        "ψ at " + ", ".join(f"{case} %" for case in known),
        known == [SLOW]
        and "W31_kg_s" in runs[SLOW].paper.record
        and clipped == {SLOW: 0.0} | dict.fromkeys(FASTER, 1.0),
        {"clipped": seen},
    )


def claim_42(runs: Instabilities) -> Finding:
    """Check: reverse flow at the inlet and at the exit."""
    run = runs[SLOW]
    inlet, leaving = (run.paper.record[f"W{p}_kg_s"][run.window] / LBM_KG for p in (25, 31))
    share = float(np.sum(np.minimum(leaving, 0.0)) / np.sum(np.minimum(inlet, 0.0)))
    return Finding(
        f"at most {-leaving.min():.1f} lbm/s reversed at the exit, {-inlet.min():.1f} at the inlet",
        share < LITTLE,
        {"share": 100.0 * share},
    )


def claim_43(runs: Instabilities) -> Finding:
    """Check: the estimates hold for φ from 0 to 0.1."""
    run = runs[SLOW]
    pressure = curve_change(run.fits["psi_p"], run.machine.in_stall_psi_p(VALID_PHI), VALID_PHI)
    work = curve_change(run.fits["psi"], run.machine.in_stall_psi(VALID_PHI), VALID_PHI)
    return Finding(
        f"ψ' within {100 * pressure:.0f} %, ψ within {100 * work:.0f} %",
        max(pressure, work) < VALID_WITHIN,
    )


def claim_44(runs: Instabilities) -> Finding:
    """Check: the time constant by trial and error."""
    rows, fit = stack_rows([runs[SLOW].paper.series]), runs[SLOW].fits["psi_p"]
    errors = [_reconstruct(fit, rows, 1e-3 * tau).rms for tau in TRIALS_MS]
    best, ramped = _best_trial_ms(rows, fit), _best_trial_ms(*_ramped(runs[SLOW]))
    chosen = _reconstruct(fit, rows, TRIAL_TIME_CONSTANT_S).rms
    wrong = _reconstruct(fit, rows, WRONG_TIME_CONSTANT_S).rms
    a = float(np.exp(-1e-3 / TRIAL_TIME_CONSTANT_S))
    return Finding(
        best,
        max(abs(best - 18.0), abs(ramped - 18.0)) <= 4.0
        and chosen < 1.1 * min(errors)
        and wrong > 2.0 * chosen
        and abs(a - 0.945959) < 1e-6,
        {"ramped": ramped, "chosen": chosen, "wrong": wrong, "moves": np.std(rows.measured)},
    )


def _best_trial_ms(rows: FitRows, fit: FittedLag) -> float:
    """Return the time constant with which the curve reconstructs best, in ms."""
    errors = [_reconstruct(fit, rows, 1e-3 * tau).rms for tau in TRIALS_MS]
    return float(TRIALS_MS[int(np.argmin(errors))])


def _ramped(run: InstabilityRun) -> tuple[FitRows, FittedLag]:
    """Reduce and fit a run with a law of the probes that has no jump at zero flow."""
    series = reduce_run(run.rig, replace(run.paper.settings, probe_ramp=PROBE_RAMP)).series
    return stack_rows([series]), fit_paper(series)


def _reconstruct(fit: FittedLag, rows: FitRows, time_constant_s: float) -> FitScore:
    trial = replace(fit, time_constant_s=time_constant_s)
    free = trial.free_run(rows.phi, rows.sample_period_s, rows.labels, start=rows.measured)
    return score_fit(rows.measured, free)


def claim_45(runs: Instabilities) -> Finding:
    """Check: the reconstruction is the deterministic part of the model."""
    rows = stack_rows([runs[SLOW].paper.series])
    score = _reconstruct(runs[SLOW].fits["psi_p"], rows, TRIAL_TIME_CONSTANT_S)
    return Finding(round(score.r2, 3), score.r2 > 0.8, {"n": score.n_rows})


def claim_46(runs: Instabilities) -> Finding:
    """Check: the curve hardly moves under disturbances that move the time constant."""
    main = runs[MAIN]
    fits = [main.fits["psi_p"]]
    for seed in range(main.seed + 1, main.seed + SEEDS):
        fits.append(fit_paper(reduce_run(simulate(MAIN, seed=seed), main.paper.settings).series))
    curves = [fit.quasi_steady(CURVE_PHI) for fit in fits]
    taus = [fit.time_constant_s for fit in fits]
    spread, spread_tau = _variation(curves), _variation(taus)
    curve = _rms_error(curves, main.machine.in_stall_psi_p(CURVE_PHI))
    tau = _rms_error(taus, main.true_tau_s)
    _, ramped = _ramped(main)
    moved = curve_change(ramped, main.fits["psi_p"])
    moved_tau = abs(ramped.time_constant_s / main.fits["psi_p"].time_constant_s - 1.0)
    return Finding(
        f"curve off by {100 * curve:.0f} %, τ by {100 * tau:.0f} %",
        spread < 0.05
        and spread < spread_tau
        and curve < 0.1
        and tau > 2.0 * curve
        and moved < min(0.1, moved_tau),
        {
            "scatter": 100.0 * spread,
            "scatter_tau": 100.0 * spread_tau,
            "moved": 100.0 * moved,
            "moved_tau": 100.0 * moved_tau,
        },
    )


def _variation(values: Sequence[FloatArray] | Sequence[float]) -> float:
    """Return the coefficient of variation over the fits, the worst over φ."""
    return float(np.max(np.std(values, axis=0, ddof=1) / np.mean(values, axis=0)))


def _rms_error(values: Sequence[FloatArray] | Sequence[float], truth: FloatArray | float) -> float:
    return float(np.sqrt(np.mean((np.asarray(values) / truth - 1.0) ** 2)))


def claim_47(_: Instabilities) -> Finding:
    """Check: a total-system model that starts its surge a little late."""
    case, end_s = CASES[MAIN], 3.6
    n_rows = round(end_s * PLANT_RATE_HZ) + 1
    window = slice(round(1.8 * PLANT_RATE_HZ), n_rows)
    measured, *late = (
        run_plant(replace(case, close_start_s=case.close_start_s + 1e-3 * shift), n_rows=n_rows)[
            "P31"
        ][window]
        for shift in (0.0, *SHIFTS_MS)
    )
    errors = [
        100.0 * float(np.sqrt(np.mean((run - measured) ** 2)) / np.std(measured)) for run in late
    ]
    late_s = ", ".join(f"{e:.0f} % for {s:g} ms" for e, s in zip(errors, SHIFTS_MS, strict=True))
    return Finding(round(errors[0], 1), errors[0] > 5.0 and errors[-1] > 50.0, {"errors": late_s})


def claim_48(runs: Instabilities) -> Finding:
    """Check: the component's curve in other facilities."""
    main, base = runs[MAIN], CASES[MAIN]
    others = {
        "V31 +5 %": replace(base, discharge_volume_m3=1.05 * base.discharge_volume_m3),
        "V31 -3 %": replace(base, discharge_volume_m3=0.97 * base.discharge_volume_m3),
        "throttle +3 %": replace(base, open_ratio=1.03 * base.open_ratio),
        "Vin +20 %": replace(base, inlet_volume_m3=1.2 * base.inlet_volume_m3),
        "supply slope +10 %": replace(base, supply_pump_kg_s_pa=1.1 * base.supply_pump_kg_s_pa),
    }
    changes = {}
    for name, case in others.items():
        series = reduce_run(simulate(case, seed=main.seed), main.paper.settings).series
        changes[name] = curve_change(fit_paper(series), main.fits["psi_p"])
    seen = ", ".join(f"{name} {100 * change:.1f} %" for name, change in changes.items())
    largest = max(changes.values())
    return Finding(round(100.0 * largest, 1), largest < 0.1, {"changes": seen})
