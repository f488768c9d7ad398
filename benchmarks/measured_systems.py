"""What the models of measured systems lack: names, doubts, and the error on records not fitted.

FOLDER holds a folder a system, with CSV files of its records.

    python benchmarks/measured_systems.py FOLDER
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

from comparisons.missing_effect import Model, P
from comparisons.missing_effect.systems.diagnosis import diagnose_model
from comparisons.missing_effect.systems.files import read_experiment

SYSTEMS: dict[str, tuple[Model, tuple[str, ...], tuple[str, ...]]] = {
    "tanks": (
        Model(
            states={"h1": "V", "h2": "V"},
            inputs={"u": "V"},
            outputs={"y": "V"},
            params={
                "kp": P(0.05, 0.001, 1.0, "1/s"),
                "k1": P(0.05, 0.001, 1.0, "V^0.5/s"),
                "k2": P(0.05, 0.001, 1.0, "V^0.5/s"),
            },
            rhs=lambda t, x, u, p: (
                p.kp * u.u - p.k1 * math.sqrt(max(x.h1, 0.0)),
                p.k1 * math.sqrt(max(x.h1, 0.0)) - p.k2 * math.sqrt(max(x.h2, 0.0)),
            ),
            output=lambda t, x, u, p: x.h2,
        ),
        ("train",),
        ("test",),
    ),
    "drives": (
        Model(
            states={"m": "ticks/s", "w": "ticks/s", "a": "ticks/s^2"},
            inputs={"u": "V"},
            outputs={"y": "ticks/s"},
            params={
                "K": P(1.0, 0.01, 20.0, "ticks/s/V"),
                "tau": P(0.3, 0.01, 5.0, "s"),
                "wn2": P(200.0, 5.0, 3000.0, "1/s^2"),
                "d": P(3.0, 0.0, 100.0, "1/s"),
            },
            rhs=lambda t, x, u, p: (
                (p.K * u.u - x.m) / p.tau,
                x.a,
                p.wn2 * (x.m - x.w) - p.d * x.a,
            ),
            output=lambda t, x, u, p: x.w,
            exact=("w",),
        ),
        ("train_11", "train_12"),
        ("test_11", "test_12"),
    ),
    "exchanger": (
        Model(
            states={"wall": "degC", "T": "degC"},
            inputs={"flow": "l/s"},
            outputs={"temp": "degC"},
            params={
                "T0": P(100.0, 80.0, 120.0, "degC"),
                "K": P(10.0, 0.0, 100.0, "K s/l"),
                "tau1": P(30.0, 1.0, 500.0, "s"),
                "tau2": P(10.0, 0.5, 500.0, "s"),
            },
            rhs=lambda t, x, u, p: (
                (p.T0 - p.K * u.flow - x.wall) / p.tau1,
                (x.wall - x.T) / p.tau2,
            ),
            output=lambda t, x, u, p: x.T,
        ),
        ("train",),
        ("test",),
    ),
    "ball_and_beam": (
        Model(
            states={"q": "m", "v": "m/s"},
            inputs={"beam": "rad"},
            outputs={"ball": "m"},
            params={
                "g": P(5.0, 0.1, 50.0, "m/s^2"),
                "level": P(0.0, -0.5, 0.5, "rad"),
                "c": P(0.5, 0.0, 20.0, "1/s"),
            },
            rhs=lambda t, x, u, p: (x.v, p.g * (u.beam - p.level) - p.c * x.v),
            output=lambda t, x, u, p: x.q,
            exact=("q",),
        ),
        ("train",),
        ("test",),
    ),
    "beam_servo": (
        Model(
            states={"q": "V", "v": "V/s"},
            inputs={"u": "V"},
            outputs={"y": "V"},
            params={
                "K": P(1.0, 0.01, 100.0, "1/s"),
                "tau": P(0.1, 0.005, 2.0, "s"),
                "bias": P(0.0, -5.0, 5.0, "V", per_record=True),
            },
            rhs=lambda t, x, u, p: (x.v, (p.K * (u.u - p.bias) - x.v) / p.tau),
            output=lambda t, x, u, p: x.q,
            exact=("q",),
        ),
        ("ms1", "steps1"),
        ("ms2", "swept", "steps2"),
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    args = parser.parse_args()
    for name in args.only:
        model, fit, check = SYSTEMS[name]
        begun, at = time.process_time(), args.folder / name
        d = diagnose_model(
            model,
            [read_experiment(at / f"{n}.csv", model) for n in fit],
            [read_experiment(at / f"{n}.csv", model) for n in check],
        )
        print(f"{name}: {d.verdict}, {time.process_time() - begun:.0f} s of processor time")
        for item in d.missing:
            kind = "without a name" if item.unnamed else "; ".join(item.doubts) or "firm"
            numbers = ", ".join(f"{n.name} {n.value:.4g} ± {n.stderr:.2g}" for n in item.parameters)
            print(f"  {' or '.join(item.alias_labels)}: {numbers} ({kind})")
        for run in d.checks:
            print(f"  {run.name}: {run.before_rms} before, {run.after_rms} after")


if __name__ == "__main__":
    main()
