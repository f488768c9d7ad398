"""Efficiency of LagRegressor against the Cramer-Rao bound and coverage of its 95 % intervals.

    python benchmarks/accuracy_against_bound.py [--quick] [--json FILE]

For each noise model, on records that it describes: efficiency = 1 / mean((error / bound)²), the
bound taken for each record from its φ. Its sampling error is cut with a paired control: the
squared error of the one-step estimate from the truth, whose mean is the bound itself, is
subtracted record by record; bias and coverage are controlled alike. The intervals are those that a
comparison prints: by Student's t for as many blocks as stand behind the standard error.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from peers.efficiency import coverage, efficiency, mean_and_se
from peers.lag_problem import NAMES, PERIOD_S, FloatArray, Problem
from scipy.stats import t as student

from classic_ml import LagRegressor
from comparisons.results import FittedLag

PROBLEMS = (
    Problem("armax", -0.6),
    Problem("armax", 0.5),
    Problem("arx"),
    Problem("output-error"),
)
RECORDS = {2_000: 2000, 20_000: 1000, 200_000: 400}
QUICK_RECORDS = {300: 6}
LEAST_EFFICIENCY = 0.95
COVERAGE_RANGE = (0.93, 0.97)


@dataclass(frozen=True)
class Row:
    """One parameter of one problem at one length.

    Parameters
    ----------
    error, c : str, float
        The problem.
    n_samples, n_records : int
        Length and number of records.
    name : str
        The parameter.
    bias, bias_se : float
        Mean of error / bound, with the paired control, whose own mean is 0.
    efficiency, efficiency_se : float
        With the paired control.
    plain_efficiency, plain_efficiency_se : float
        Without.
    coverage, coverage_se : float
        Share of intervals that hold the truth, with the paired control.
    plain_coverage : float
        Without.
    stated : float
        Root mean square of stated standard error / bound.
    """

    error: str
    c: float
    n_samples: int
    n_records: int
    name: str
    bias: float
    bias_se: float
    efficiency: float
    efficiency_se: float
    plain_efficiency: float
    plain_efficiency_se: float
    coverage: float
    coverage_se: float
    plain_coverage: float
    stated: float


def fit_one(problem: Problem, n_samples: int, seed: int) -> dict[str, FloatArray]:
    """Fit one record: errors and stated errors by the bound, and which intervals hold."""
    record = problem.record(n_samples, seed)
    bound, one_step = record.bound()
    model = LagRegressor(sample_period_s=PERIOD_S, noise=problem.error).fit(
        record.phi[:, None], record.y
    )
    ends = (float(record.phi.min()), float(record.phi.max()))
    value = FittedLag.from_estimator(model, "classic_ml", "psi_p", "zero", record.phi[:2], ends)
    estimate = np.array([value.time_constant_s, *value.coefficients])
    stderr = np.array([value.time_constant_stderr_s, *value.stderr])
    reach = student.isf(0.025, value.n_blocks - 1) * stderr
    holds = np.abs(estimate - problem.truth) <= reach
    low, high = value.ci95_s
    holds[0] = low <= problem.truth[0] <= high
    return {
        "error": (estimate - problem.truth) / bound,
        "one_step": one_step / bound,
        "stated": stderr / bound,
        "holds": holds.astype(np.float64),
    }


def rows_of(problem: Problem, n_samples: int, n_records: int) -> Iterator[Row]:
    """Fit the records of one setting and sum up, parameter by parameter."""
    fits = []
    # Other records for every problem, so that luck is not shared between the rows.
    first_seed = 10_000 * PROBLEMS.index(problem)
    for i in range(n_records):
        fits.append(fit_one(problem, n_samples, first_seed + i))
        if sys.stderr.isatty():
            done = f"{problem.error} c={problem.c:+.1f} N={n_samples} {i + 1}/{n_records}"
            print(f"\r{done}   ", end="", file=sys.stderr, flush=True)
    for i, name in enumerate(NAMES):
        error, one_step, stated, holds = (
            np.array([fit[key][i] for fit in fits])
            for key in ("error", "one_step", "stated", "holds")
        )
        yield Row(
            problem.error,
            problem.c,
            n_samples,
            n_records,
            name,
            *mean_and_se(error - one_step),
            *efficiency(error, one_step),
            *efficiency(error),
            *coverage(holds, one_step),
            float(holds.mean()),
            float(np.sqrt(np.mean(stated**2))),
        )


HEADER = (
    f"{'error':<12} {'c':>4} {'N':>7} {'records':>7} {'':<5} {'bias/bound':>13} "
    f"{'efficiency':>14} {'without control':>15} {'coverage':>15} {'without':>7} "
    f"{'stated/bound':>12}"
)


def line(row: Row) -> str:
    """Return one row of the table; ``!`` marks a figure outside its range by two of its errors."""
    low, high = COVERAGE_RANGE
    missed = row.efficiency + 2.0 * row.efficiency_se < LEAST_EFFICIENCY
    off = row.coverage + 2.0 * row.coverage_se < low or row.coverage - 2.0 * row.coverage_se > high
    return (
        f"{row.error:<12} {row.c:>+4.1f} {row.n_samples:>7} {row.n_records:>7} {row.name:<5} "
        f"{row.bias:>+6.3f} ± {row.bias_se:.3f} "
        f"{row.efficiency:>6.3f} ± {row.efficiency_se:.3f}{'!' if missed else ' '} "
        f"{row.plain_efficiency:>6.3f} ± {row.plain_efficiency_se:.3f} "
        f"{row.coverage:>6.3f} ± {row.coverage_se:.3f}{'!' if off else ' '} "
        f"{row.plain_coverage:>7.3f} {row.stated:>12.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few short records, in seconds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument(
        "--samples", type=int, action="append", metavar="N", help="only records of this length"
    )
    options = parser.parse_args()
    lengths = QUICK_RECORDS if options.quick else RECORDS
    rows: list[Row] = []
    print(HEADER)
    for n_samples, n_records in lengths.items():
        if options.samples and n_samples not in options.samples:
            continue
        for problem in PROBLEMS:
            for row in rows_of(problem, n_samples, n_records):
                rows.append(row)
                print(line(row), flush=True)
    print(
        f"! efficiency below {LEAST_EFFICIENCY}, or coverage outside "
        f"{COVERAGE_RANGE[0]:.0%}-{COVERAGE_RANGE[1]:.0%}, by more than two sampling errors"
    )
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
