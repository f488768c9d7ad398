"""Is a missing effect named rightly, and is nothing named where nothing is missing?

    python benchmarks/effect_study.py [--jobs 2] [--seeds N] [--only PART,...] [--json FILE]
    python benchmarks/effect_study.py --from FILE...      tables of rows written before

Each test is three simulated records of known truth (`comparisons.rig.coefficient_tests`), given to
`comparisons.missing_effect.diagnose` as a user would give them. The strength of an effect is the
rms, in standard deviations of the noise, of what is left of it after the model without it has been
fitted again. The in-stall flag is in the records of even seeds. Parts:

    effects   15 effects, at each strength
    nulls     nothing missing; white, AR(1), Student, outliers, noise on the flow of 1 and 3 %
    outside   effects that no catalogue holds: no name is the right answer
    without   15 effects, each with its own name taken out of the catalogue
    pairs     two effects at once, each of strength 2
    speed     seconds by length of the records
    pysindy   the published recipe alone, on the tests of effects and nulls

`--quick` is for its working alone.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from effect_study_pysindy import RIGHT_TERMS, sparse_discrepancy
from effect_study_tables import Row, report
from threadpoolctl import threadpool_limits

from classic_ml.series import CoefficientSeries
from comparisons.rig.coefficient_effects import EFFECTS, OUTSIDE, PAIRS
from comparisons.rig.coefficient_tests import NOISES, CoefficientTest, Noise, simulate_test

PARTS = ("effects", "nulls", "outside", "without", "pairs", "speed")
STRENGTHS = (0.5, 1.5, 3.0)
PAIR_STRENGTH = 2.0
DEGREE = 3
LENGTHS = (1000, 2000, 4000, 8000)
SPEED_EFFECTS = (None, "transport_delay", "hysteresis")
SPEED_SEEDS = 3
SAVE_EVERY_ROWS = 50


@dataclass(frozen=True)
class Case:
    """One test.

    Parameters
    ----------
    kind : str
        "effect", "null", "outside", "pair" or "speed".
    planted : tuple of str
        The effects.
    strength : float
        In sigma; 0 where nothing is planted.
    seed : int
        Of the test.
    noise : str
        See `simulate_test`.
    n_samples : int
        Rows of each record.
    """

    kind: str
    planted: tuple[str, ...]
    strength: float
    seed: int
    noise: Noise = "white"
    n_samples: int = 2000

    def simulate(self) -> CoefficientTest:
        """Make its records."""
        test = simulate_test(
            self.planted or None,
            strength=self.strength,
            seed=self.seed,
            noise=self.noise,
            n_samples=self.n_samples,
            degree=DEGREE,
        )
        if self.seed % 2 == 0:
            return test
        unmarked = tuple(replace(record, in_stall=None) for record in test.records)
        return replace(test, records=unmarked)


def diagnosed(test: CoefficientTest, unknown: str = "") -> Row:
    """Ask the diagnosis what is missing; all that the study knows of its interface is here."""
    from comparisons.missing_effect import CATALOGUE, diagnose

    records = [
        CoefficientSeries(
            one.time_s,
            one.phi,
            one.psi_p,
            np.ones(one.phi.size, dtype=np.int64),
            T25_K=one.T25_K,
            Nc_frac=one.Nc_frac,
            in_stall=one.in_stall,
            source=f"record {number}",
        )
        for number, one in enumerate(test.records, start=1)
    ]
    begun = time.process_time()
    names = [effect for effect in CATALOGUE if effect.name != unknown]
    found = diagnose(records, degree=DEGREE, catalogue=names)
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


def asked_pysindy(case: Case, test: CoefficientTest) -> Row:
    """Ask the published recipe."""
    terms, explained = sparse_discrepancy(test.records, DEGREE)
    right = RIGHT_TERMS[case.planted[0]] if case.planted else None
    return {
        "terms": terms,
        "explained": explained,
        "right": None if right is None else bool(terms) and terms[0] in right,
    }


def try_case(case: Case, *, diagnosis: bool, pysindy: bool) -> Row:
    """Make one test and put it to those who are asked; a failure is a row as well."""
    with threadpool_limits(1):
        test = case.simulate()
        row: Row = {
            "kind": case.kind,
            "planted": list(case.planted),
            "strength": case.strength,
            "reached": dict(test.strengths),
            "noise": case.noise,
            "seed": case.seed,
            "n_samples": case.n_samples,
            "tau_true_s": test.tau_s,
            "sigma": test.sigma,
            "parameters": {name: dict(p) for name, p in test.effects.items()},
            "verdict": None,
            "missing": [],
            "error": "",
        }
        if diagnosis:
            try:
                row |= diagnosed(test, case.planted[0] if case.kind == "outside" else "")
            except Exception as error:
                # One test that breaks the diagnosis is a test lost, not the end of the study.
                row |= {"verdict": "", "error": f"{type(error).__name__}: {error}"}
        if pysindy and case.kind in ("effect", "null"):
            row["pysindy"] = asked_pysindy(case, test)
    return row


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Return the tests asked for."""
    first = options.first_seed
    seeds = range(first, first + options.seeds)
    parts = options.only or PARTS
    if parts == ("pysindy",):
        parts = ("effects", "nulls")
    cases: list[Case] = []
    if "effects" in parts:
        effects = options.effects or EFFECTS
        cases += [
            Case("effect", (e,), s, seed) for e in effects for s in options.strengths
            for seed in seeds
        ]  # fmt: skip
    if "nulls" in parts:
        null_seeds = range(first, first + options.null_seeds)
        cases += [Case("null", (), 0.0, seed, noise) for noise in NOISES for seed in null_seeds]
    if "outside" in parts:
        cases += [
            Case("outside", (e,), s, seed) for e in OUTSIDE for s in options.strengths
            for seed in seeds
        ]  # fmt: skip
    if "without" in parts:
        cases += [
            Case("outside", (e,), s, seed) for e in options.effects or EFFECTS
            for s in options.strengths for seed in seeds
        ]  # fmt: skip
    if "pairs" in parts:
        cases += [Case("pair", pair, PAIR_STRENGTH, seed) for pair in PAIRS for seed in seeds]
    if "speed" in parts:
        cases += [
            Case("speed", (e,) if e else (), 1.5 if e else 0.0, seed, n_samples=n)
            for n in LENGTHS for e in SPEED_EFFECTS for seed in range(first, first + SPEED_SEEDS)
        ]  # fmt: skip
    return cases


def quick_cases(first_seed: int) -> list[Case]:
    """Return one test of each kind."""
    return [
        Case("effect", ("bias_drift",), 1.5, first_seed),
        Case("null", (), 0.0, first_seed),
        Case("outside", (OUTSIDE[0],), 1.5, first_seed),
        Case("pair", PAIRS[3], PAIR_STRENGTH, first_seed),
        Case("speed", (), 0.0, first_seed, n_samples=LENGTHS[0]),
    ]


def warm_up() -> None:
    """Pay for imports and compilation once in each process, outside every time taken."""
    case = Case("effect", ("bias_drift",), 3.0, 0, n_samples=500)
    try_case(case, diagnosis=True, pysindy=True)


def run(cases: Sequence[Case], jobs: int, *, diagnosis: bool, pysindy: bool) -> Iterator[Row]:
    """Yield the rows in order, made by several processes if asked."""
    attempt = partial(try_case, diagnosis=diagnosis, pysindy=pysindy)
    if jobs > 1:
        with ProcessPoolExecutor(jobs, get_context("spawn"), warm_up) as pool:
            yield from pool.map(attempt, cases, chunksize=4)
    else:
        warm_up()
        yield from map(attempt, cases)


def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = ",".join((*PARTS, "pysindy"))
    parser.add_argument("--quick", action="store_true", help="one test of each kind")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="tests of each kind")
    parser.add_argument("--null-seeds", type=int, default=170, metavar="N", help="of each noise")
    parser.add_argument("--first-seed", type=int, default=0, metavar="SEED")
    parser.add_argument("--strengths", type=float, nargs="+", default=STRENGTHS, metavar="SIGMA")
    parser.add_argument("--only", metavar="PART,...", help=f"of {parts}")
    parser.add_argument("--effects", metavar="NAME,...", help="of the catalogue; default all")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--without-pysindy", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument(
        "--from", dest="files", type=Path, nargs="+", metavar="FILE", help="rows written before"
    )
    options = parser.parse_args(arguments)
    options.only = _chosen(parser, "--only", options.only, (*PARTS, "pysindy"))
    options.effects = _chosen(parser, "--effects", options.effects, EFFECTS)
    return options


def _chosen(
    parser: argparse.ArgumentParser, option: str, text: str | None, known: tuple[str, ...]
) -> tuple[str, ...]:
    chosen = tuple(text.split(",")) if text else ()
    unknown = sorted(set(chosen) - set(known))
    if unknown:
        parser.error(f"{option}: expected some of {','.join(known)}; found {', '.join(unknown)}")
    return chosen


def main(arguments: Sequence[str] | None = None) -> None:
    options = options_of(arguments)
    if options.files:
        rows = [row for file in options.files for row in json.loads(file.read_text("utf-8"))]
        print(report(rows))
        return
    cases = quick_cases(options.first_seed) if options.quick else cases_of(options)
    alone = options.only == ("pysindy",)
    rows = []
    made = run(
        cases, options.jobs, diagnosis=not alone, pysindy=alone or not options.without_pysindy
    )
    for row in made:
        rows.append(row)
        if sys.stderr.isatty():
            print(f"\r{len(rows)}/{len(cases)} ", end="", file=sys.stderr)
        if options.json is not None and len(rows) % SAVE_EVERY_ROWS == 0:
            save(options.json, rows)
    if options.json is not None:
        save(options.json, rows)
    print(report(rows))


def save(file: Path, rows: list[Row]) -> None:
    """Write the rows, with null for what is no number."""
    file.write_text(json.dumps([_known(row) for row in rows], indent=1) + "\n", "utf-8")


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _known(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_known(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


if __name__ == "__main__":
    main()
