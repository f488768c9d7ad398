"""τ and curve from raw counts on the rig, as `compare` reads them, over many records.

Each record is simulated (98.5, 95 and 90 %, volumes and ducts changed by 3 %), written as counts,
read back, reduced with the default settings and fitted as `compare` fits it. The truth is known.

    python benchmarks/tau_on_the_rig.py [--seeds 3] [--first-seed 5000] [--noise 0.2] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from classic_ml.io import read_raw
from classic_ml.reduction import reduce_record
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.rig import CASES, SensorSettings, simulate, write_run

AT = np.array([0.0, 0.05, 0.1, 0.15])
TAU_MS = 18.0
ESTIMATORS = ("classic_ml", "sindy", "paper")
CHANGES: dict[str, dict[str, float]] = {
    "as is": {},
    "discharge volume +3 %": {"discharge_volume_m3": 1.03},
    "discharge volume -2 %": {"discharge_volume_m3": 0.98},
    "duct inertia +3 %": {"inertia_per_m": 1.03},
    "inlet volume +3 %": {"inlet_volume_m3": 1.03},
}
INDEPENDENT = Path(__file__).parents[2] / "shared" / "data" / "independent_rig_985"
INDEPENDENT_BETA = (1.2135, 2.941, 47.358)


def one_record(job: tuple[str, str, int], noise: float) -> dict[str, object]:
    """Return what `compare` makes of one record, against its truth."""
    name, change, seed = job
    if name == "independent":
        return _row(job, INDEPENDENT, INDEPENDENT_BETA)
    case = CASES[name]
    factors = CHANGES[change]
    if factors:
        case = replace(case, **{key: getattr(case, key) * by for key, by in factors.items()})
    run = simulate(
        case, seed=seed, sensors=SensorSettings(noise_percent=noise, reading_noise_percent=noise)
    )
    with tempfile.TemporaryDirectory() as folder:
        write_run(run, Path(folder) / "run")
        return _row(job, Path(folder) / "run", case.pressure_terms)


def _row(job: tuple[str, str, int], folder: Path, beta: tuple[float, ...]) -> dict[str, object]:
    series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
    row: dict[str, object] = {"case": job[0], "change": job[1], "seed": job[2]}
    wanted = [spec for spec in default_estimators() if spec.name in ESTIMATORS]
    comparison = compare_records([series], estimators=wanted)
    for key in ESTIMATORS:
        result = comparison.result(key)
        model = result.model
        stderr = np.interp(AT, *np.asarray(model.table).T[[0, 2]])
        row[key] = {
            "state": result.state,
            "terms": list(model.terms),
            "tau_ms": 1e3 * model.time_constant_s,
            "stderr_ms": 1e3 * model.time_constant_stderr_s,
            "ci95_ms": [1e3 * edge for edge in model.ci95_s],
            "curve_error": (
                model.quasi_steady(AT) - np.polynomial.polynomial.polyval(AT, beta)
            ).tolist(),
            "curve_stderr": stderr.tolist(),
        }
    return row


def summary(rows: list[dict[str, object]], key: str) -> dict[str, object]:
    """Return the figures over records."""
    fits = [row[key] for row in rows]
    tau = np.array([fit["tau_ms"] for fit in fits])  # type: ignore[index]
    edges = np.array([fit["ci95_ms"] for fit in fits])  # type: ignore[index]
    error = np.array([fit["curve_error"] for fit in fits])  # type: ignore[index]
    stderr = np.array([fit["curve_stderr"] for fit in fits])  # type: ignore[index]
    off = tau - TAU_MS
    return {
        "records": tau.size,
        "refused": int(np.sum(~np.isfinite(tau))),
        "tau_mean_ms": float(np.nanmean(tau)),
        "tau_rms_error_ms": float(np.sqrt(np.nanmean(off**2))),
        "tau_within_2_ms": float(np.mean(np.abs(off) < 2.0)),
        "tau_worst_ms": float(np.nanmax(np.abs(off))),
        "interval_holds_truth": float(np.mean((edges[:, 0] < TAU_MS) & (edges[:, 1] > TAU_MS))),
        "curve_within_0.1": float(np.mean(np.max(np.abs(error), axis=1) < 0.1)),
        "curve_rms_error": np.sqrt(np.nanmean(error**2, axis=0)).round(3).tolist(),
        "curve_z": np.sqrt(np.nanmean((error / stderr) ** 2, axis=0)).round(2).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="seeds of each plant")
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument("--noise", type=float, default=0.2, help="transducer noise, %% of range")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one seed of one plant a speed")
    options = parser.parse_args()
    changes = ["as is"] if options.quick else list(CHANGES)
    seeds = 1 if options.quick else options.seeds
    jobs = [
        (case, change, options.first_seed + 10 * i + seed)
        for case in ("985", "95", "90")
        for i, change in enumerate(changes)
        for seed in range(seeds)
    ]
    if INDEPENDENT.is_dir():
        jobs.append(("independent", "as is", 0))
    with ProcessPoolExecutor() as pool:
        rows = list(pool.map(partial(one_record, noise=options.noise), jobs))
    result = {}
    for key in ESTIMATORS:
        groups = {case: [row for row in rows if row["case"] == case] for case, *_ in jobs}
        result[key] = {case: summary(group, key) for case, group in groups.items()}
        result[key]["all"] = summary(rows, key)
        print(
            f"{key}\n{'':12s}{'n':>4s}{'mean':>7s}{'rms':>6s}{'worst':>7s}{'<2 ms':>7s}"
            f"{'in 95 %':>9s}{'curve <.1':>11s}  rms error of the curve, z"
        )
        for case, s in result[key].items():
            print(
                f"{case:12s}{s['records']:4d}{s['tau_mean_ms']:7.2f}{s['tau_rms_error_ms']:6.2f}"
                f"{s['tau_worst_ms']:7.2f}{s['tau_within_2_ms']:7.0%}"
                f"{s['interval_holds_truth']:9.0%}{s['curve_within_0.1']:11.0%}  "
                f"{s['curve_rms_error']} {s['curve_z']}"
            )
    if options.json:
        options.json.write_text(json.dumps({"summary": result, "rows": rows}, indent=1), "utf-8")


if __name__ == "__main__":
    main()
