"""Claims 40 to 45: the identification at 90 % corrected speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from classic_ml.flow import LBM_KG
from comparisons.harness.fit_quality import score_fit
from comparisons.harness.rows import stack_rows
from comparisons.paper.claims_analysis import cell_power_ratio
from comparisons.paper.claims_base import Claim, ClaimCheck, curve_change, window_mask
from comparisons.paper.figures_truth import in_stall_psi, in_stall_psi_p, reverse_flow_psi_p
from comparisons.paper.instabilities import (
    TRIAL_TIME_CONSTANT_S,
    WRONG_TIME_CONSTANT_S,
    Instabilities,
    reduce_run,
)
from comparisons.paper.paper_fit import fit_paper
from comparisons.results import FitRows, FitScore, FittedLag
from surge_core.types import FloatArray

__all__ = ["CLAIMS"]

SECTION = "Identification at 90 %"
CASE = "90"
FASTER = ("95", "985", "985-second")
VALID_PHI = np.linspace(0.0, 0.1, 21)
# ψ is a power over the flow: below this it is not known.
WORK_PHI = np.linspace(0.05, 0.1, 11)
# A curve is a valid estimate where it is this near the truth.
VALID_WITHIN = 0.1
TRIALS_MS = np.arange(6.0, 61.0, 1.0)


def claim_40(runs: Instabilities) -> Claim:
    """Check claim 40: no segmentation at 90 %, and both coefficients estimated."""
    run = runs[CASE]
    scored = run.paper.series.scored
    whole = run.paper.series.n_segments == 1 and bool(scored[window_mask(run)].all())
    found = [name for name in ("psi_p", "psi") if name in run.fits]
    taus = [run.fits[name].time_constant_s for name in found]
    ratio = cell_power_ratio(run)
    (by_flow,) = reduce_run(run.rig, replace(run.paper.settings, work_form="exit-flow"))
    strict = fit_paper(by_flow.series, target="psi")
    off = curve_change(strict, in_stall_psi(run, WORK_PHI), WORK_PHI)
    return Claim(
        40,
        SECTION,
        "Stall cells throughout make segmentation needless; ψ' and ψ are both estimated",
        "ψ' and ψ, one segment",
        f"{len(found)} coefficients, {run.paper.series.n_segments} segment",
        whole and len(found) == 2 and bool(np.isfinite(taus).all()) and ratio < 4.0,
        f"power of the cells at low over that at high flow {ratio:.1f} "
        f"({cell_power_ratio(runs['985']):.0f} at 98.5 %; below 4 they are there throughout); time "
        "constants "
        + " and ".join(f"{1e3 * tau:.0f} ms" for tau in taus)
        + ". ψ is from the temperature rise: by Eq 13 with W31 as measured it would be off by "
        f"up to {100 * off:.0f} % and its time constant {1e3 * strict.time_constant_s:.0f} ms",
    )


def claim_41(runs: Instabilities) -> Claim:
    """Check claim 41: T31 beyond the acquisition's limit above 90 % speed."""
    clipped = {}
    for case in (CASE, *FASTER):
        run = runs[case]
        limit = run.rig.test["limits"]["T31_A"][1]
        rows = run.rig.raw.time_s <= run.rig.test["near_stall"]["to_s"]
        clipped[case] = float(np.mean(run.rig.raw["T31_A"][rows] >= limit))
    known = [case for case in clipped if runs[case].paper.series.psi is not None]
    exits = [case for case in clipped if "W31_kg_s" in runs[case].paper.record]
    relative = {
        round(
            runs[case].rig.test["limits"]["T31_A"][1]
            / runs[case].rig.truth_parameters["case"]["supply_temperature_k"],
            3,
        )
        for case in clipped
    }
    return Claim(
        41,
        SECTION,
        "Above 90 % T31 exceeds the limits of the acquisition: no W31, so no work coefficient",
        "ψ at 90 % alone",
        "ψ at " + ", ".join(f"{case} %" for case in known),
        known == [CASE] == exits
        and clipped[CASE] == 0.0
        and all(clipped[case] == 1.0 for case in FASTER)
        and len(relative) == 1,
        "T31 near stall at its limit in "
        + ", ".join(f"{100 * share:.0f} % of rows ({case})" for case, share in clipped.items())
        + f"; the limit is {min(relative):.2f} times the supply temperature in every test",
    )


def claim_42(runs: Instabilities) -> Claim:
    """Check claim 42: reverse flow at the inlet and at the exit."""
    run = runs[CASE]
    window = window_mask(run)
    inlet, leaving = (run.paper.record[f"W{p}_kg_s"][window] / LBM_KG for p in (25, 31))
    share = _reversed_share(inlet, leaving)
    own = _reversed_share(*(run.rig.truth[f"W{p}_kg_s"][window] for p in (25, 31)))
    return Claim(
        42,
        SECTION,
        "There is much reverse flow at the inlet and little at the exit: gas recirculates inside",
        "little at the exit",
        f"at most {-leaving.min():.1f} lbm/s reversed at the exit, {-inlet.min():.1f} at the inlet",
        bool(leaving.min() > inlet.min()),
        "the largest reversed flow at the exit is below that at the inlet. It is less, not little: "
        f"of the reversed mass at the inlet {100 * share:.0f} % passes the exit, in the rig itself "
        f"{100 * own:.0f} %",
    )


def _reversed_share(inlet: FloatArray, leaving: FloatArray) -> float:
    return float(np.sum(np.minimum(leaving, 0.0)) / np.sum(np.minimum(inlet, 0.0)))


def claim_43(runs: Instabilities) -> Claim:
    """Check claim 43: the estimates hold for φ from 0 to 0.1."""
    run = runs[CASE]
    pressure = curve_change(run.fits["psi_p"], in_stall_psi_p(run, VALID_PHI), VALID_PHI)
    work = curve_change(run.fits["psi"], in_stall_psi(run, VALID_PHI), VALID_PHI)
    backward = np.linspace(-0.1, 0.0, 21)
    outside = curve_change(run.fits["psi_p"], reverse_flow_psi_p(run, backward), backward)
    return Claim(
        43,
        SECTION,
        "The 90 % estimates are valid in the positive flow region, φ from 0.0 to 0.1",
        "valid",
        f"ψ' within {100 * pressure:.0f} %, ψ within {100 * work:.0f} %",
        max(pressure, work) < VALID_WITHIN,
        "largest error against the rig's own curves over φ from 0 to 0.1, 10 % allowed; over φ "
        f"from -0.1 to 0 ψ' is off by up to {100 * outside:.0f} %",
    )


def claim_44(runs: Instabilities) -> Claim:
    """Check claim 44: the time constant by trial and error."""
    rows = stack_rows([runs[CASE].paper.series])
    fit = runs[CASE].fits["psi_p"]
    errors = [_reconstruct(fit, rows, 1e-3 * tau).rms for tau in TRIALS_MS]
    best = float(TRIALS_MS[int(np.argmin(errors))])
    chosen = _reconstruct(fit, rows, TRIAL_TIME_CONSTANT_S)
    wrong = _reconstruct(fit, rows, WRONG_TIME_CONSTANT_S)
    a = float(np.exp(-1e-3 / TRIAL_TIME_CONSTANT_S))
    return Claim(
        44,
        SECTION,
        "By trial and error 18 ms (a = 0.945959) gives an acceptable reconstruction",
        18.0,
        best,
        abs(best - 18.0) <= 4.0
        and chosen.rms < 1.1 * min(errors)
        and wrong.rms > 2.0 * chosen.rms
        and abs(a - 0.945959) < 1e-6,
        "best of 6 to 60 ms in steps of 1 ms with the estimated curve kept, 4 ms allowed; rms of "
        f"ψ' {chosen.rms:.2f} with 18 ms and {wrong.rms:.2f} with 243 ms, ψ' itself moves by "
        f"{np.std(rows.measured):.2f}",
        "ms",
    )


def _reconstruct(fit: FittedLag, rows: FitRows, time_constant_s: float) -> FitScore:
    trial = replace(fit, time_constant_s=time_constant_s)
    return score_fit(
        rows.measured,
        trial.free_run(rows.phi, rows.sample_period_s, rows.labels, start=rows.measured),
    )


def claim_45(runs: Instabilities) -> Claim:
    """Check claim 45: the reconstruction is the deterministic part of the model."""
    rows = stack_rows([runs[CASE].paper.series])
    trial = replace(runs[CASE].fits["psi_p"], time_constant_s=TRIAL_TIME_CONSTANT_S)
    noise = np.random.default_rng(runs.seed).standard_normal(rows.measured.size)
    noise[[run.start for run in rows.runs]] = 0.0
    free, other = (
        trial.free_run(rows.phi, rows.sample_period_s, rows.labels, start=rows.measured + n)
        for n in (0.0 * noise, noise)
    )
    score = score_fit(rows.measured, free)
    return Claim(
        45,
        SECTION,
        "The deterministic part of the model, run on the measured flow, reconstructs ψ'",
        "reconstructed",
        round(score.r2, 3),
        bool(np.array_equal(free, other)) and score.r2 > 0.8,
        f"share of the variance of ψ' over {score.n_rows} rows without a break; measured ψ' but at "
        "the first row has no part in it: noise put on it changes nothing. 0.8 is acceptable",
    )


CLAIMS: tuple[ClaimCheck, ...] = (
    claim_40,
    claim_41,
    claim_42,
    claim_43,
    claim_44,
    claim_45,
)
