"""How often the right terms are found in noisy surge records, beside plain pysindy.

    python benchmarks/structure_recovery.py [--quick] [--seeds N] [--only CASE ...] [--json FILE]

Each record is one independent draw of wave and noise (see surge_truths.py); a structure is right if
it is the set of terms of the truth and nothing else. `SparseLagRegressor` runs with its defaults.

pysindy gets the same record, the same kind of library and every favour: the terms are STLSQ's on
normalised columns, with and without its ridge, and the record counts if ANY threshold of a fine
range gives the truth (`any`; `one` is the count at the single best setting for all records of the
row); its τ is that of its regression on the true terms alone. FD is its finite difference, SFD its
smoothed one over 11 samples. Powers of ψ' are offered to it only where the truth holds one.
"""

from __future__ import annotations

import argparse
import re
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from plain_pysindy import DERIVATIVES, plain_pysindy
from surge_truths import PERIOD_S, TAU_S, TRUTHS, FloatArray, Record, canonical, simulate_record
from threadpoolctl import threadpool_limits

from sindy_surge import SparseLagRegressor
from surge_core.files import to_strict_json

MAIN_TRUTHS = ("quadratic", "cubic", "hinge", "reverse")
LEVELS = (0.01, 0.02, 0.05)
# A knot that is in no library is found if it is within a tenth of the library's own step.
KNOT_TOLERANCE = 0.005
NORMAL_975 = 1.959964
Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One setting; the last three as of `surge_truths.simulate_record`."""

    group: str  # Name for `--only`
    truth: str  # Key of `surge_truths.TRUTHS`
    noise: float  # Share of each signal's standard deviation
    n_samples: int = 5000
    # Share of records in which the truth must be found; None where that is only reported.
    wanted: float | None = None
    colour: float = 0.0
    late: int = 0
    pieces: bool = False

    def record(self, seed: int) -> Record:
        """Make one record."""
        kind = {"colour": self.colour, "late": self.late, "pieces": self.pieces}
        made = simulate_record(self.truth, self.noise, seed, self.n_samples, **kind)
        return made.measured


def all_cases() -> list[Case]:
    """Return the cases, those with a goal first."""
    cases = [Case("white", t, s, wanted=1.0) for t in MAIN_TRUTHS for s in LEVELS]
    cases += [
        Case("ar1", t, s, wanted=0.95, colour=0.9) for t in ("quadratic", "hinge") for s in LEVELS
    ]
    late = (("quadratic", 0.01, 1), ("quadratic", 0.05, 1), ("reverse", 0.02, 1))
    cases += [
        Case("late", truth, noise, wanted=0.95, late=samples)
        for truth, noise, samples in (*late, ("hinge", 0.02, 2))
    ]
    cases += [Case("psi", t, s) for t in ("with psi'^2", "with psi' phi") for s in LEVELS]
    cases += [Case("knot", "hinge at 0.27", s) for s in LEVELS]
    cases += [Case("mg", "Moore-Greitzer", s) for s in LEVELS]
    cases += [Case("pieces", t, s, pieces=True) for t in ("quadratic", "reverse") for s in LEVELS]
    cases += [Case("exact", t, 0.0) for t in TRUTHS]
    for n_samples in (2000, 20_000):
        cases += [Case("length", t, 0.05, n_samples) for t in MAIN_TRUTHS]
    return cases


QUICK = (
    "white quadratic 0.02",
    "white reverse 0.02",
    "ar1 quadratic 0.02",
    "pieces quadratic 0.02",
)


def try_record(case: Case, seed: int, with_pysindy: bool) -> Row:
    """Make one record, fit it and hold the fit against the truth."""
    with threadpool_limits(1):
        record, truth = case.record(seed), TRUTHS[case.truth]
        trial = {"seed": seed, "terms": [], "rivals": [], "right": False, "scores": []}
        trial |= _own_fit(record, truth)
        if with_pysindy and not case.pieces:
            trial["pysindy"] = plain_pysindy(record, truth)
    return trial


def _own_fit(record: Record, truth: dict[str, float]) -> Row:
    model = SparseLagRegressor(PERIOD_S)
    begun = time.process_time()
    try:
        model.fit(record.phi[:, None], record.psi_p, segments=record.labels)
    except Exception as error:
        # One record that breaks the fit is a record not found, not the end of the table.
        state = f"{type(error).__name__}: {error}"
        return {"state": state, "cpu_s": time.process_time() - begun}
    cpu_s = time.process_time() - begun
    right = same_structure(model.terms_, truth)
    scores: list[float] = []
    if right:
        # (estimate − truth) / standard error of each coefficient.
        off = model.coef_ - true_coefficients(model.terms_, truth)
        stderr = np.sqrt(np.diag(model.covariance_))
        scores = (off / np.where(stderr > 0, stderr, np.nan)).tolist()
    return {
        "terms": list(model.terms_),
        "rivals": [list(rival) for rival in model.rivals_],
        "state": str(model.fit_state_.value),
        "right": right,
        "tau_off": 100.0 * (float(model.time_constant_s_) / TAU_S - 1.0),
        "tau_stated": 100.0 * float(model.time_constant_stderr_s_) / TAU_S,
        "scores": scores,
        "cpu_s": cpu_s,
        "dead_time_samples": float(model.dead_time_s_) / PERIOD_S,
    }


def warm_up() -> None:
    """Pay for imports once in each process, outside every time taken."""
    record = simulate_record("quadratic", 0.02, 0, 400).measured
    SparseLagRegressor(PERIOD_S).fit(record.phi[:, None], record.psi_p)


def same_structure(terms: Sequence[str], truth: dict[str, float]) -> bool:
    """Return whether a structure is that of the truth, a hinge at a nearly right knot included."""
    return canonical(_snapped(name, truth) for name in terms) == canonical(truth)


def true_coefficients(terms: Sequence[str], truth: dict[str, float]) -> FloatArray:
    """Return the true coefficients in the order of the terms of a right structure."""
    known = {next(iter(canonical([name]))): value for name, value in truth.items()}
    names = [next(iter(canonical([_snapped(name, truth)]))) for name in terms]
    return np.array([known.get(name, np.nan) for name in names])


def _snapped(name: str, truth: dict[str, float]) -> str:
    found = re.fullmatch(r"relu\(phi-([\d.eE-]+)\)", name)
    if found:
        for other in truth:
            if other.startswith("relu(phi-"):
                off = abs(float(found[1]) - float(other[9:-1]))
                return other if off <= KNOT_TOLERANCE else name
    return name


def summarise(case: Case, trials: list[Row]) -> Row:
    """Sum up the records of one case: shares of τ in per cent, intervals that hold, seconds."""
    table = pd.DataFrame(trials)
    lags = table.reindex(columns=["tau_off", "tau_stated"]).dropna()
    scores = np.array([score for trial in trials for score in trial["scores"]])
    row = asdict(case) | {
        "n_records": len(trials),
        "n_right": int(table["right"].sum()),
        "tau_bias_percent": lags["tau_off"].mean(),
        "tau_bias_se_percent": lags["tau_off"].sem(),
        "tau_stated_percent": lags["tau_stated"].mean(),
        "tau_covered": int((lags["tau_off"].abs() <= NORMAL_975 * lags["tau_stated"]).sum()),
        "coefficients_covered": int(np.sum(np.abs(scores) <= NORMAL_975)),
        "n_coefficients": scores.size,
        "cpu_s": table["cpu_s"].median(),
        "cpu_most_s": table["cpu_s"].max(),
        "dead_time_samples": table.get("dead_time_samples", pd.Series([0.0])).median(),
        "pysindy": {},
        "wrong": [
            {name: trial[name] for name in ("seed", "state", "terms", "rivals")}
            for trial in trials
            if not trial["right"]
        ],
    }
    row["missed"] = case.wanted is not None and row["n_right"] < case.wanted * len(trials)
    for derivative in DERIVATIVES:
        fits = [trial["pysindy"][derivative] for trial in trials if "pysindy" in trial]
        if fits:
            met = Counter(setting for fit in fits for setting in fit["right"])
            row["pysindy"][derivative] = {
                "any": sum(bool(fit["right"]) for fit in fits),
                "one": max(met.values(), default=0),
                "tau_bias_percent": float(np.mean([100 * (f["tau_s"] / TAU_S - 1) for f in fits])),
                "cpu_ratio": row["cpu_s"] / float(np.median([fit["cpu_s"] for fit in fits])),
            }
    return row


HEADER = (
    f"{'':<71} {'covered':^17} {'CPU s':^11}   {'plain pysindy, FD':^13} {'SFD':^13}\n"
    f"{'case':<9}{'truth':<15}{'noise':>5}{'N':>7}{'right':>8} "
    f"{'tau off %':>16} {'stated':>7} {'tau':>8} {'beta':>9} {'med':>5} {'most':>5} "
    + f" {'right':>6} {'tau %':>6}" * 2
    + f" {'x':>4}"
)


def line(row: Row) -> str:
    """Return one line of the table, ``!`` at a goal that is not reached; then other terms found."""
    digits = 2 if row["noise"] else 4
    off = f"{row['tau_bias_percent']:+.{digits}f} ± {row['tau_bias_se_percent']:.{digits}f}"
    text = (
        f"{row['group']:<9}{row['truth']:<15}{100 * row['noise']:>4.0f}%{row['n_samples']:>7}"
        f"{row['n_right']:>5}/{row['n_records']}{'!' if row['missed'] else ' '}"
        f"{off:>16} {row['tau_stated_percent']:>7.{digits}f} "
        f"{row['tau_covered']:>4}/{row['n_records']:<3} {row['coefficients_covered']:>4}/"
        f"{row['n_coefficients']:<4} {row['cpu_s']:>5.2f} {row['cpu_most_s']:>5.2f} "
    )
    for found in row["pysindy"].values():
        bias = found["tau_bias_percent"]
        text += f" {found['any']}/{found['one']}".rjust(7)
        text += f" {'' if np.isnan(bias) else f'{bias:+.2f}':>6}"
    if row["pysindy"]:
        text += f" {row['pysindy']['FD']['cpu_ratio']:>4.0f}"
    if row["dead_time_samples"]:
        text += f"  dead time {row['dead_time_samples']:+.3f} samples"
    for one in row["wrong"]:
        rivals = "; ".join(" + ".join(rival) for rival in one["rivals"])
        beside = f" [as good: {rivals}]" if rivals else ""
        terms = f": {' + '.join(one['terms'])}" if one["terms"] else ""
        text += f"\n    seed {one['seed']} {one['state']}{terms}{beside}"
    return text


def report(rows: list[Row]) -> None:
    """Print the figures that are about all cases together."""
    table = pd.DataFrame(rows)
    white = table[table["group"] == "white"]
    at_five = white[white["noise"] == 0.05]
    if len(at_five):
        se = np.sqrt(np.sum(at_five["tau_bias_se_percent"] ** 2)) / len(at_five)
        bias = at_five["tau_bias_percent"].mean()
        print(f"bias of tau at 5 %: {bias:+.3f} ± {se:.3f} %   (wanted: within 0.3)")
    for name in ("white", "ar1", "late"):
        group = table[(table["group"] == name) & ((name != "white") | (table["n_samples"] == 5000))]
        if len(group):
            sums = group.sum(numeric_only=True)
            tau = _share(sums["tau_covered"], sums["n_records"], sums["n_records"])
            # As if the coefficients of one record erred all together: the error stated is the most.
            beta = _share(sums["coefficients_covered"], sums["n_coefficients"], sums["n_right"])
            print(f"95 % intervals, {name}: tau {tau}, coefficients {beta}   (wanted: 93-97 %)")
    if len(white):
        times = white["cpu_s"].median(), white["cpu_most_s"].max()
        print(f"CPU s a selection: median {times[0]:.2f}, most {times[1]:.2f}   (wanted: below 1)")
    goals = table[table["wanted"].notna()]
    reached = int((~goals["missed"]).sum())
    print(f"{reached} of {len(goals)} cases with a goal reach it; ! marks the rest")


def _share(hits: int, n: int, independent: int) -> str:
    if n == 0:
        return "none"
    share = hits / n
    error = np.sqrt(share * (1 - share) / independent)
    return f"{100 * share:.1f} ± {100 * error:.1f} % of {n:.0f}"


def chosen_cases(options: argparse.Namespace) -> list[tuple[Case, range]]:
    """Return the cases asked for, each with its seeds."""
    cases = all_cases()
    seeds = range(options.first_seed, options.first_seed + (2 if options.quick else options.seeds))
    if options.only:
        cases = [case for case in cases if case.group in options.only]
    elif options.quick:
        cases = [case for case in cases if f"{case.group} {case.truth} {case.noise}" in QUICK]
    return [(case, seeds) for case in cases]


def run(jobs: list[tuple[Case, range]], workers: int, with_pysindy: bool) -> Iterator[Row]:
    """Fit all records, on several cores if asked, and yield the rows in order."""
    cases = [case for case, seeds in jobs for _ in seeds]
    numbers = [seed for _, seeds in jobs for seed in seeds]
    attempt = partial(try_record, with_pysindy=with_pysindy)
    with ProcessPoolExecutor(workers, get_context("spawn"), warm_up) as pool:
        trials = pool.map(attempt, cases, numbers)
        for case, seeds in jobs:
            yield summarise(case, list(islice(trials, len(seeds))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    groups = list(dict.fromkeys(case.group for case in all_cases()))
    parser.add_argument("--quick", action="store_true", help="two seeds of four cases, in seconds")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="records of each case")
    parser.add_argument("--first-seed", type=int, default=300, metavar="SEED")
    parser.add_argument("--only", nargs="+", choices=groups)
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--without-pysindy", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    options = parser.parse_args()
    print(HEADER)
    rows = []
    for row in run(chosen_cases(options), options.workers, not options.without_pysindy):
        rows.append(row)
        print(line(row), flush=True)
    report(rows)
    if options.json is not None:
        options.json.write_text(to_strict_json(rows), "utf-8")


if __name__ == "__main__":
    main()
