"""Is a missing effect named rightly, and is nothing named where nothing is missing?

    python benchmarks/effect_study.py [--jobs 2] [--seeds N] [--only PART ...] [--json FILE]

Each test is three simulated records of known truth (`comparisons.rig.coefficient_tests`), given to
`comparisons.missing_effect.diagnose` as a user would give them. The strength of an effect is the
rms, in standard deviations of the noise, of what is left of it after the model without it has been
fitted again. The in-stall flag is in the records of even seeds. Parts:

    effects   15 effects, at each strength
    nulls     nothing missing; white, AR(1), Student, outliers, noise on the flow of 1 and 3 %
    outside   effects that no catalogue holds: no name is the right answer
    left_out  the 15 again, each taken out of the catalogue: no name is the right answer
    pairs     two effects at once, each of strength 2

`--quick` is for its working alone. `peers.py` asks the published recipe the same.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from effect_study_tables import Row, report
from threadpoolctl import threadpool_limits

from comparisons.rig.coefficient_effects import EFFECTS, OUTSIDE, PAIRS
from comparisons.rig.coefficient_tests import NOISES, CoefficientTest, Noise, simulate_test
from comparisons.study.sources import series_of
from surge_core.files import to_strict_json

PARTS = ("effects", "nulls", "outside", "left_out", "pairs")
STRENGTHS = (0.5, 1.5, 3.0)
PAIR_STRENGTH = 2.0
SAVE_EVERY_ROWS = 50
DEGREE = 3


@dataclass(frozen=True)
class Case:
    """One test."""

    kind: str  # "effect", "null", "outside", "left_out" or "pair"
    planted: tuple[str, ...]  # The effects
    strength: float  # In sigma; 0 where nothing is planted
    seed: int
    noise: Noise = "white"  # See `simulate_test`

    def simulate(self) -> CoefficientTest:
        """Make its records."""
        test = simulate_test(
            self.planted or None,
            strength=self.strength,
            seed=self.seed,
            noise=self.noise,
            degree=DEGREE,
        )
        if self.seed % 2 == 0:
            return test
        unmarked = tuple(replace(record, in_stall=None) for record in test.records)
        return replace(test, records=unmarked)


def diagnosed(test: CoefficientTest, left_out: tuple[str, ...] = ()) -> Row:
    """Ask the diagnosis what is missing; all that the study knows of its interface is here."""
    from comparisons.missing_effect import CATALOGUE, diagnose

    records = series_of(test)
    begun = time.process_time()
    found = diagnose(
        records, degree=DEGREE, catalogue=[e for e in CATALOGUE if e.name not in left_out]
    )
    seconds = time.process_time() - begun
    return {
        "verdict": str(found.verdict),
        "missing": [
            {
                "effect": str(item.effect),
                "alias_set": [str(name) for name in item.alias_set],
                "provisional": bool(item.provisional),
            }
            for item in found.missing
        ],
        "before_rms": float(found.gap.before_rms),
        "after_rms": float(found.gap.after_rms),
        "floor_rms": float(found.gap.floor_rms),
        "shrink": float(found.gap.shrink),
        "tau_before_s": float(found.tau_before_s),
        "tau_after_s": float(found.tau_after_s),
        "tau_by_alias_s": {str(k): float(v) for k, v in found.tau_by_alias_s.items()},
        "seconds": seconds,
    }


def try_case(case: Case) -> Row:
    """Make one test and diagnose it; a failure is a row as well."""
    with threadpool_limits(1):
        test = case.simulate()
        row: Row = {
            "kind": case.kind,
            "planted": list(case.planted),
            "strength": case.strength,
            "reached": dict(test.strengths),
            "noise": case.noise,
            "seed": case.seed,
            "tau_true_s": test.tau_s,
            "sigma": test.sigma,
            "parameters": {name: dict(p) for name, p in test.effects.items()},
            "verdict": "",
            "missing": [],
            "error": "",
        }
        try:
            row |= diagnosed(test, case.planted if case.kind == "left_out" else ())
        except Exception as error:
            # One test that breaks the diagnosis is a test lost, not the end of the study.
            row["error"] = f"{type(error).__name__}: {error}"
    return row


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Return the tests asked for."""
    first = options.first_seed
    seeds = range(first, first + options.seeds)
    parts = options.only
    cases: list[Case] = []
    for part, kind in (("effects", "effect"), ("left_out", "left_out")):
        cases += [
            Case(kind, (e,), s, seed) for e in options.effects for s in options.strengths
            for seed in seeds if part in parts
        ]  # fmt: skip
    if "nulls" in parts:
        null_seeds = range(first, first + options.null_seeds)
        cases += [Case("null", (), 0.0, seed, noise) for noise in NOISES for seed in null_seeds]
    if "outside" in parts:
        cases += [
            Case("outside", (e,), s, seed) for e in OUTSIDE for s in options.strengths
            for seed in seeds
        ]  # fmt: skip
    if "pairs" in parts:
        cases += [Case("pair", pair, PAIR_STRENGTH, seed) for pair in PAIRS for seed in seeds]
    # One of each kind.
    return list({case.kind: case for case in cases}.values()) if options.quick else cases


def warm_up() -> None:
    """Pay for imports and compilation once in each process, outside every time taken."""
    try_case(Case("effect", ("bias_drift",), 3.0, 0))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one test of each kind")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="tests of each kind")
    parser.add_argument("--null-seeds", type=int, default=170, metavar="N", help="of each noise")
    parser.add_argument("--first-seed", type=int, default=0, metavar="SEED")
    parser.add_argument("--strengths", type=float, nargs="+", default=STRENGTHS, metavar="SIGMA")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--effects", nargs="+", choices=EFFECTS, default=EFFECTS, metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    options = parser.parse_args()
    cases = cases_of(options)
    rows: list[Row] = []
    with ProcessPoolExecutor(options.jobs, get_context("spawn"), warm_up) as pool:
        for row in pool.map(try_case, cases, chunksize=4):
            rows.append(row)
            if sys.stderr.isatty():
                print(f"\r{len(rows)}/{len(cases)} ", end="", file=sys.stderr)
            if options.json is not None and len(rows) % SAVE_EVERY_ROWS == 0:
                options.json.write_text(to_strict_json(rows), "utf-8")
    if options.json is not None:
        options.json.write_text(to_strict_json(rows), "utf-8")
    print(report(rows))


if __name__ == "__main__":
    main()
