"""What the diagnosis says of small thermal, hydraulic, electrical and mechanical systems.

Each truth is integrated by a Runge-Kutta method of its own, with an effect that the model lacks or
with none, and noise of 1 % of each output's spread; a model that starts from wrong parameters is
diagnosed on one record and checked on another. Columns: records; the truth in the set named; the
set of one name; records with a further name that was not hidden, and with such a name that is firm;
verdicts that are provisional or without a name; and the medians of the check error over the noise,
before and after. With --leave-out the right name is taken out of the catalogue, so that every firm
name is false.

    python benchmarks/hidden_in_systems.py [--seeds 5] [--first-seed 100] [--jobs 2]
        [--only NAME,...] [--leave-out]
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

# The truths and models are those of the tests.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

ROWS, CHECK_ROWS, NOISE = 2000, 800, 0.01
CHECK_SEED = 5000
NOTHING = "nothing"


def _drag(t: float, q: float, v: float) -> float:
    return -1.0 * v * abs(v)


def _dry(t: float, q: float, v: float) -> float:
    return -1.5 * float(np.tanh(v / 1e-3))


def _cubic(t: float, q: float, v: float) -> float:
    return -100.0 * q**3


# Row of the table: system, what its truth has, the names that are right.
CASES: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "thermal, complete": ("thermal", {}, (NOTHING,)),
    "tanks, complete": ("tanks", {}, (NOTHING,)),
    "pipe, complete": ("pipe", {}, (NOTHING,)),
    "circuit, complete": ("circuit", {}, (NOTHING,)),
    "body, complete": ("body", {}, (NOTHING,)),
    "thermal, delay of 3 s": ("thermal", {"delay_s": 3.0}, ("transport_delay",)),
    "thermal, sensor lag of 10 s": ("thermal", {"sensor_lag_s": 10.0}, ("further_lag",)),
    "thermal, valve lag of 4 s": ("thermal", {"valve_lag_s": 4.0}, ("further_lag",)),
    "thermal, loss drifts 30 %": ("thermal", {"drift": 0.3}, ("parameter_drift",)),
    "tanks, first spills at 9.5": ("tanks", {"rim": 9.5}, ("overflow",)),
    "tanks, spills into second": ("tanks", {"rim": 9.5, "into_second": True}, ("overflow",)),
    "pipe, turbulent": ("pipe", {"drag": 0.3}, ("quadratic_drag",)),
    "pipe, one direction worse": ("pipe", {"asymmetric": 0.5}, ("asymmetric_damping",)),
    "circuit, drive limited": ("circuit", {"drive_limit": 10.0}, ("saturation",)),
    "circuit, drive with dead zone": ("circuit", {"drive_gap": 1.0}, ("dead_zone",)),
    "circuit, cubic capacitor": ("circuit", {"cubic": 5e6}, ("cubic_stiffness",)),
    "body, dry friction": ("body", {"force": _dry}, ("coulomb_friction",)),
    "body, drag": ("body", {"force": _drag}, ("quadratic_drag",)),
    "body, hardening spring": ("body", {"force": _cubic}, ("cubic_stiffness",)),
    "body, play in the drive": ("body", {"play": 2.0}, ("backlash",)),
    "body, hysteresis": ("body", {"hysteresis": (4.0, 0.05)}, ("hysteresis",)),
    "body, blind to the sign": ("body", {"sensor": np.abs}, ("absolute_value_sensor",)),
}


def outcome(case: str, seed: int, leave_out: bool) -> dict[str, Any]:
    """Make a record, diagnose it, and compare."""
    import system_models
    import system_truths

    from comparisons.missing_effect import SYSTEM_CATALOGUE, diagnose_model

    kind, hidden, right = CASES[case]
    made, model = getattr(system_truths, kind), getattr(system_models, kind)()
    fit = system_models.experiment(kind, made(seed, ROWS, noise=NOISE, **hidden), "training")
    check = made(seed + CHECK_SEED, CHECK_ROWS, noise=NOISE, **hidden)
    catalogue = [e for e in SYSTEM_CATALOGUE if not (leave_out and e.name in right)]
    checks = system_models.experiment(kind, check, "check")
    said = diagnose_model(model, fit, checks, catalogue=catalogue)
    sets = [item.alias_set for item in said.missing]
    if right == (NOTHING,):
        found, alone, further = not sets, not sets, tuple(n for s in sets for n in s[:1])
    else:
        found = any(set(right) & set(names) for names in sets)
        alone = any(tuple(names) == right for names in sets)
        further = tuple(names[0] for names in sets if not set(right) & set(names))
    run = said.checks[0]
    noise = NOISE * np.std(run.measured, axis=0)
    return {
        "hidden": case,
        "named": found,
        "alone": alone,
        "further": bool(further),
        "firm": any(
            not (item.provisional or item.unnamed or set(right) & set(item.alias_set))
            for item in said.missing
        ),
        "vague": said.verdict in ("provisional", "unnamed_term"),
        "before": float(np.max(run.before_rms / noise)),
        "after": float(np.max(run.after_rms / noise)),
        "further names": further,
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="rows whose name holds one of these")
    parser.add_argument("--leave-out", action="store_true", help="the right name does not compete")
    given = parser.parse_args()
    wanted = [part for part in given.only.split(",") if part]
    cases = [c for c in CASES if not wanted or any(part in c for part in wanted)]
    if given.leave_out:
        cases = [case for case in cases if CASES[case][2] != (NOTHING,)]
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    jobs = [(case, seed, given.leave_out) for case in cases for seed in seeds]
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        rows = pd.DataFrame(list(pool.map(outcome, *zip(*jobs, strict=True))))
    groups = rows.groupby("hidden", sort=False)
    shown = groups[["named", "alone", "further", "firm", "vague"]].sum()
    shown.insert(0, "n", groups.size())
    shown = shown.join(groups[["before", "after"]].median())
    names = groups["further names"].agg(lambda several: ", ".join(sorted({*several.sum()})))
    print(shown.join(names).to_string(float_format="%.2f"))


if __name__ == "__main__":
    main()
