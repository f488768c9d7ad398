"""Everything beside its peers: the ML fit, the sparse fit, the diagnosis and the reduction.

    python benchmarks/peers.py [--quick] [--only ml,sparse,diagnosis,reduction] [--seeds N]
                               [--json FILE] [--peers PYTHON]

Times are processor time, one thread, as ratios within one run: the mean of the middle half of the
calls by that of the first line of the block. `efficiency` is 1 / mean((error / bound)^2) against
the Cramer-Rao bound of each record, paired with an estimate that attains the bound.

The peers of the ML fit run in an environment of their own; without it their lines are left out:

    python -m venv benchmarks/.venv
    benchmarks/.venv/bin/python -m pip install -r benchmarks/requirements-peers.txt
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from lag_problem import MOVING_AVERAGE, TAU_S, FloatArray, simulate
from scipy.stats import sem, trim_mean

HERE = Path(__file__).resolve().parent
BLOCKS = ("ml", "sparse", "diagnosis", "reduction")
OWN_FIT = "LagRegressor"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
Row = dict[str, Any]


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Return what a call gives and the processor seconds that it took."""
    begun = time.process_time()
    return call(*arguments), time.process_time() - begun


def rms(values: Any) -> float:
    """Return the rms of the finite values, nan without any."""
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def efficiency(error: FloatArray, control: FloatArray | None = None) -> tuple[float, float]:
    """Return 1 / mean(error²) and its standard error, of errors over their bounds.

    A control is the same of an estimate that attains the bound on these records. Its mean square is
    known to be 1, so that mean(error² - control²) + 1 estimates mean(error²), and the chance of the
    records, which moves both alike, drops out.
    """
    squared = error**2 if control is None else error**2 - control**2
    if squared.size == 0:
        return float("nan"), float("nan")
    mean, se = float(squared.mean()), float(sem(squared)) if squared.size > 1 else float("nan")
    if control is not None:
        mean += 1.0
    # By the delta method; a mean of few differences can come out negative and then says nothing.
    return (1.0 / mean, se / mean**2) if mean > 0.0 else (float("nan"), float("nan"))


def middle_half(values: FloatArray) -> float:
    """Return the mean without the lowest and the highest quarter; nan of nothing.

    A median alone moves in steps where the kernel counts CPU time in ticks, and a mean alone
    follows the few fits beside which something else ran.
    """
    return float(trim_mean(values, 0.25)) if values.size else float("nan")


def percent(holds: Any) -> float:
    """Return the share of what holds, in per cent."""
    return 100.0 * float(np.mean(holds)) if len(holds) else float("nan")


def ml_rows(options: argparse.Namespace) -> list[Row]:
    """Fit ARMAX records of `lag_problem.py` with C = 1 - 0.6 q⁻¹ by each package."""
    lengths = {500: 3} if options.quick else {2_000: 36, 20_000: 16, 200_000: 8}
    rows = []
    for n_samples, n_records in lengths.items():
        seeds = range(options.seeds or n_records)
        records = [simulate(n_samples, seed, MOVING_AVERAGE) for seed in seeds]
        bounds = [record.bound() for record in records]
        bound, one_step = (np.array([pair[i][0] for pair in bounds]) for i in (0, 1))
        own_s = np.nan
        for name in _fits(options):
            found, seconds = _fitted_by(name, records, options)
            if not found.size:
                continue
            own_s = middle_half(seconds) if name == OWN_FIT else own_s
            error = found - TAU_S
            known = np.flatnonzero(np.isfinite(error))
            got, se = efficiency((error / bound[: error.size])[known], (one_step / bound)[known])
            rows.append({
                "what": f"{name}, N = {n_samples}",
                "n": known.size,
                "tau_error_percent": 100.0 * rms(error) / TAU_S,
                "over_bound": rms(error / bound[: error.size]),
                "efficiency": got,
                "efficiency_stderr": se,
                "time": middle_half(seconds) / own_s,
            })  # fmt: skip
    return rows


def _fits(options: argparse.Namespace) -> list[str]:
    from peer_fits import FITS

    return list(FITS) if options.peers.is_file() else list(FITS)[:2]


def _fitted_by(
    name: str, records: list[Any], options: argparse.Namespace
) -> tuple[np.ndarray, np.ndarray]:
    """Return τ of each record that was reached, and the seconds of the fits."""
    own = name in list(_fits(options))[:2]
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "records.npz", Path(folder) / "rows.json"
        np.savez(file, phi=[r.phi for r in records], y=[r.y for r in records])
        python = sys.executable if own else str(options.peers)
        command = [python, str(HERE / "peer_fits.py"), name, str(file), str(out), "45"]
        subprocess.run(command, env={**os.environ, **ONE_THREAD}, check=False, timeout=600)
        rows = json.loads(out.read_text()) if out.is_file() else []
    taus, seconds = np.array(rows, dtype=np.float64).reshape(-1, 2).T
    return taus, seconds


def sparse_rows(options: argparse.Namespace) -> list[Row]:
    """Recover structures in white noise, beside pysindy at the best threshold in hindsight."""
    from plain_pysindy import DERIVATIVES, fit_once, make_model, plain_pysindy
    from structure_recovery import LEVELS, MAIN_TRUTHS, same_structure, warm_up
    from surge_truths import PERIOD_S, TAU_S, TRUTHS, simulate_record, tau_bound

    from sindy_surge import SparseLagRegressor

    warm_up()
    cases = [(truth, noise) for truth in MAIN_TRUTHS for noise in LEVELS]
    cases = cases[1:2] if options.quick else cases
    first, count = 300, options.seeds or (1 if options.quick else 6)
    own = "SparseLagRegressor"
    trials: list[Row] = []
    for truth, noise in cases:
        for seed in range(first, first + count):
            made, terms = simulate_record(truth, noise, seed), TRUTHS[truth]
            bound = tau_bound(terms, made, noise)
            phi, psi_p = made.measured.phi[:, None], made.measured.psi_p
            base = {"bound": bound.stderr_s, "one_step": bound.one_step_s}
            model, seconds = timed(SparseLagRegressor(PERIOD_S).fit, phi, psi_p)
            right, off = same_structure(model.terms_, terms), model.time_constant_s_ - TAU_S
            trials.append({**base, "what": own, "right": right, "off": off, "s": seconds})
            swept = plain_pysindy(made.measured, terms)
            for name in DERIVATIVES:
                one, _ = make_model(name, False)
                _, seconds = timed(fit_once, one, made.measured)
                right, off = bool(swept[name]["right"]), swept[name]["tau_s"] - TAU_S
                what = f"pysindy {name}, best threshold in hindsight"
                trials.append({**base, "what": what, "right": right, "off": off, "s": seconds})
    table = pd.DataFrame(trials)
    own_s = table[table["what"] == own]["s"].to_numpy()
    rows = []
    for what, mine in table.groupby("what", sort=False):
        got, se = efficiency(
            (mine["off"] / mine["bound"]).to_numpy(), (mine["one_step"] / mine["bound"]).to_numpy()
        )
        rows.append({
            "what": what,
            "n": len(mine),
            "right_percent": percent(mine["right"]),
            "tau_error_percent": 100.0 * rms(mine["off"]) / TAU_S,
            "over_bound": rms(mine["off"] / mine["bound"]),
            "efficiency": got,
            "efficiency_stderr": se,
            "time": middle_half(mine["s"].to_numpy() / own_s),
        })  # fmt: skip
    return rows


def diagnosis_rows(options: argparse.Namespace) -> list[Row]:
    """Give tests of `effect_study.py` to `diagnose` and to the published recipe."""
    from effect_study import DEGREE, STRENGTHS, Case, diagnosed, warm_up
    from effect_study_pysindy import RIGHT_TERMS, sparse_discrepancy
    from effect_study_tables import false_names, outcome, tau_error_after

    from comparisons.rig.coefficient_effects import EFFECTS
    from comparisons.rig.coefficient_tests import NOISES

    warm_up()
    first, count = 1000, options.seeds or 2
    effects, strengths, noises, nulls = EFFECTS, STRENGTHS, NOISES, 5
    if options.quick:
        effects, strengths, noises, nulls, count = EFFECTS[:1], STRENGTHS[1:2], NOISES[:1], 1, 1
    cases = [
        Case("effect", (effect,), strength, first + seed)
        for effect in effects for strength in strengths for seed in range(count)
    ] + [
        Case("null", (), 0.0, first + seed, noise)
        for noise in noises for seed in range(nulls * count)
    ]  # fmt: skip
    own: list[Row] = []
    recipe: list[Row] = []
    for case in cases:
        test = case.simulate()
        known = {"planted": case.planted, "noise": case.noise, "tau_true_s": test.tau_s}
        answer, seconds = timed(diagnosed, test)
        own.append({**known, "error": "", **answer, "kind": case.kind, "s": seconds})
        terms, seconds = timed(sparse_discrepancy, test.records, DEGREE)
        recipe.append({**known, "terms": terms, "kind": case.kind, "s": seconds})
    named = [row for row in own if row["kind"] == "effect"]
    inside = [outcome(row) in ("unique", "set", "extra", "prov. right") for row in named]
    hits = [
        bool(set(RIGHT_TERMS[row["planted"][0]] or ()) & set(row["terms"]))
        for row in recipe
        if row["kind"] == "effect"
    ]
    own_s = np.array([row["s"] for row in own])
    return [
        {
            "what": "diagnose",
            "n": len(own),
            "right_percent": percent(inside),
            "alone_percent": percent([outcome(row) == "unique" for row in named]),
            "false_percent": percent([bool(false_names(r)) for r in own if r["kind"] == "null"]),
            "tau_error_percent": float(np.median([tau_error_after(row) for row in named])),
            "time": 1.0,
        },
        {
            "what": "published recipe (pysindy STLSQ)",
            "n": len(recipe),
            "right_percent": percent(hits),
            "false_percent": percent([bool(r["terms"]) for r in recipe if r["kind"] == "null"]),
            "time": middle_half(np.array([row["s"] for row in recipe]) / own_s),
        },
    ]


def reduction_rows(options: argparse.Namespace) -> list[Row]:
    """Reduce counts to φ and ψ', beside the same equations in a script of pandas and scipy."""
    from script_reduction import read, reduce_by_script

    from classic_ml.io import read_raw
    from classic_ml.reduction import reduce_record
    from comparisons.rig import simulate, write_run

    rows = []
    for duration_s in (2.5,) if options.quick else (4.0, 40.0):
        own_s: list[float] = []
        script_s: list[float] = []
        differs = 0.0
        for seed in range(60, 60 + (options.seeds or (1 if options.quick else 3))):
            with tempfile.TemporaryDirectory() as parent:
                folder = Path(parent) / "run"
                write_run(simulate("985", seed=seed, duration_s=duration_s), folder)
                raw, test = read_raw(folder / "raw.csv", folder / "test.toml")
                table, description = read(folder)
            reduce_record(raw, test)
            for _ in range(5):
                reduction, seconds = timed(reduce_record, raw, test)
                own_s.append(seconds)
                (phi, psi_p), seconds = timed(reduce_by_script, table, description)
                script_s.append(seconds)
            series = reduction.series
            for one, other in ((series.phi, phi), (series.psi_p, psi_p)):
                differs = max(differs, float(np.max(np.abs(one - other)) / np.ptp(one)))
        own = middle_half(np.array(own_s))
        rows += [
            {"what": f"reduce_record, {duration_s:g} s", "n": len(own_s), "time": 1.0,
             "times_real_time": duration_s / own},
            {"what": f"script (pandas, scipy), {duration_s:g} s", "n": len(script_s),
             "time": middle_half(np.array(script_s)) / own, "differs": differs,
             "times_real_time": duration_s / middle_half(np.array(script_s))},
        ]  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="for its working alone")
    parser.add_argument("--only", default=",".join(BLOCKS), metavar="BLOCK,...")
    parser.add_argument("--seeds", type=int, metavar="N", help="records of each kind in a block")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument("--peers", type=Path, default=HERE / ".venv" / "bin" / "python")
    options = parser.parse_args()
    rows: list[Row] = []
    for block in options.only.split(","):
        found = [{"block": block, **row} for row in globals()[f"{block}_rows"](options)]
        table = pd.DataFrame(found).to_string(index=False, na_rep="-", float_format="%.3g")
        print(table, end="\n\n", flush=True)
        rows += found
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    os.environ.update(ONE_THREAD)
    main()
