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
from typing import Any

import numpy as np
import pandas as pd

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


def one_record(job: tuple[str, str, int], noise: float) -> list[dict[str, Any]]:
    """Return what each estimator of `compare` makes of one record, against its truth."""
    name, change, seed = job
    if name == "independent":
        return _rows(job, INDEPENDENT, INDEPENDENT_BETA)
    case = CASES[name]
    factors = CHANGES[change]
    if factors:
        case = replace(case, **{key: getattr(case, key) * by for key, by in factors.items()})
    run = simulate(
        case, seed=seed, sensors=SensorSettings(noise_percent=noise, reading_noise_percent=noise)
    )
    with tempfile.TemporaryDirectory() as folder:
        write_run(run, Path(folder) / "run")
        return _rows(job, Path(folder) / "run", case.pressure_terms)


def _rows(job: tuple[str, str, int], folder: Path, beta: tuple[float, ...]) -> list[dict[str, Any]]:
    series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
    wanted = [spec for spec in default_estimators() if spec.name in ESTIMATORS]
    rows = []
    for result in compare_records([series], estimators=wanted).results:
        model = result.model
        low_ms, high_ms = (1e3 * edge for edge in model.ci95_s)
        error = model.quasi_steady(AT) - np.polynomial.polynomial.polyval(AT, beta)
        rows.append({
            "estimator": result.name,
            "case": job[0],
            "change": job[1],
            "seed": job[2],
            "state": result.state,
            "terms": list(model.terms),
            "tau_ms": 1e3 * model.time_constant_s,
            "stderr_ms": 1e3 * model.time_constant_stderr_s,
            "ci95_ms": [low_ms, high_ms],
            "held": low_ms < TAU_MS < high_ms,
            "curve_error": error.tolist(),
            "curve_stderr": np.interp(AT, *np.asarray(model.table).T[[0, 2]]).tolist(),
        })  # fmt: skip
    return rows


def summary(rows: pd.DataFrame) -> dict[str, Any]:
    """Return the figures over records."""
    off, error = rows["tau_ms"] - TAU_MS, np.array(rows["curve_error"].tolist())
    z = error / np.array(rows["curve_stderr"].tolist())
    return {
        "n": len(rows),
        "refused": int(off.isna().sum()),
        "mean": float(rows["tau_ms"].mean()),
        "rms": float(np.sqrt((off**2).mean())),
        "worst": float(off.abs().max()),
        "< 2 ms %": 100.0 * float((off.abs() < 2.0).mean()),
        "in 95 % %": 100.0 * float(rows["held"].mean()),
        "curve < .1 %": 100.0 * float(np.mean(np.max(np.abs(error), axis=1) < 0.1)),
        "rms error of the curve": np.sqrt(np.nanmean(error**2, axis=0)).round(3).tolist(),
        "z": np.sqrt(np.nanmean(z**2, axis=0)).round(2).tolist(),
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
        rows = [row for some in pool.map(partial(one_record, noise=options.noise), jobs)
                for row in some]  # fmt: skip
    table = pd.DataFrame(rows)
    groups = [*table.groupby(["estimator", "case"]), *table.groupby(["estimator"])]
    figures = {"  ".join(place): summary(part) for place, part in groups}
    shown = pd.DataFrame(figures).T
    print(shown.map(lambda x: f"{x:.2f}" if isinstance(x, float) else str(x)).to_string())
    if options.json:
        options.json.write_text(json.dumps({"summary": figures, "rows": rows}, indent=1), "utf-8")


if __name__ == "__main__":
    main()
