"""ψ_QS of the 90 % case from raw counts on the rig, as `sindy-surge work` fits it.

Run as `python benchmarks/work_on_the_rig.py [--seeds 6] [--first-seed 0] [--json FILE]`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.io import read_raw
from comparisons.harness.work_fit import fit_work
from comparisons.rig import CASES, simulate, write_run

AT = np.array([0.02, 0.05, 0.1])
WAYS: dict[str, dict[str, Any]] = {
    "breakpoints given, τ fitted": {"breakpoints": CASES["90"].work_breaks},
    "breakpoints given, τ 18 ms": {
        "breakpoints": CASES["90"].work_breaks,
        "time_constant_s": 0.018,
    },
    "breakpoints searched, τ fitted": {},
}


def one_record(seed: int) -> dict[str, Any]:
    """Return τ and the error of the curve, each way, of one seed."""
    run, true = simulate("90", seed=seed), CASES["90"].in_stall_psi(AT)
    with tempfile.TemporaryDirectory() as folder:
        write_run(run, Path(folder) / "run")
        raw = read_raw(Path(folder) / "run" / "raw.csv", Path(folder) / "run" / "test.toml")
    row: dict[str, Any] = {"seed": seed}
    for way, options in WAYS.items():
        fit = fit_work(*raw, **options)
        value, stderr = fit.characteristic(AT)
        row[way] = {
            "tau_ms": 1e3 * fit.time_constant_s,
            "error": (value - true).tolist(),
            "stderr": stderr.tolist(),
        }
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one seed")
    options = parser.parse_args()
    n_seeds = 1 if options.quick else options.seeds
    with ProcessPoolExecutor() as pool:
        rows = list(pool.map(one_record, range(options.first_seed, options.first_seed + n_seeds)))
    print(f"{'':32s}{'τ [ms]':>14s}  error at φ 0.02, 0.05, 0.1: rms, largest, z")
    for way in WAYS:
        tau = np.array([row[way]["tau_ms"] for row in rows])
        error = np.array([row[way]["error"] for row in rows])
        stderr = np.array([row[way]["stderr"] for row in rows])
        rms = np.sqrt(np.mean(error**2, axis=0)).round(2)
        z = np.sqrt(np.mean((error / stderr) ** 2, axis=0)).round(1)
        print(
            f"{way:32s}{tau.mean():7.1f} ± {tau.std():4.1f}  {rms} "
            f"{np.abs(error).max(axis=0).round(2)} {z}"
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), "utf-8")


if __name__ == "__main__":
    main()
