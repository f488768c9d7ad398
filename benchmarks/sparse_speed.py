"""What the sparse regression costs: a whole selection, and its weak equations beside pysindy.

    python benchmarks/sparse_speed.py [--quick] [--json FILE]

The weak equations (`weak_rows`: one set; `weak_lag`: both regressions, twice) and pysindy's
`SINDy.fit` with its finite difference get the same record and the same four terms 1, ψ', φ, φ².
They take turns in one process, so that the ratios do not depend on the machine; the processor time
is the median of the turns, on one core. Memory is what the process holds at its peak beyond what
it held before, in float64 a sample; `!` marks growth that is more than linear.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import resident
from resident import ONE_THREAD
from surge_truths import PERIOD_S, TRUTHS, FloatArray, Record, make_record, response

LENGTHS = (10_000, 100_000, 1_000_000)
SELECTION_SAMPLES = 5000
LONG_SELECTION_SAMPLES = 100_000
# Twice τ = 18 ms, as the estimator would choose.
HALF_WIDTH = 36
NOISE = 0.02
WARM_UP_SAMPLES = 3000
# A tenth more memory a sample from one length to the next is still taken for linear.
LINEAR = 1.1


@dataclass(frozen=True)
class Row:
    """Cost of one thing at one length.

    Parameters
    ----------
    what : str
        What was run.
    n_samples, n_runs : int
        Length of the record, and how many times.
    cpu_s, most_s : float
        Median and largest processor time.
    floats_per_sample : float or None
        Peak memory above the start, by eight bytes and the number of samples; None where the
        system does not tell.
    time_ratio, memory_ratio : float or None
        Both by those of pysindy's fit of the same record.
    linear : bool
        Whether memory grew no faster than the record since the length before.
    """

    what: str
    n_samples: int
    n_runs: int
    cpu_s: float
    most_s: float
    floats_per_sample: float | None
    time_ratio: float | None = None
    memory_ratio: float | None = None
    linear: bool = True


def long_record(n_samples: int) -> Record:
    """Make a record of any length at once: φ swings like a relaxation oscillation of 5 to 7 Hz."""
    rng = np.random.default_rng(n_samples)
    corners = rng.uniform(5, 7, n_samples // 500 + 2)
    hertz = np.interp(np.arange(n_samples), 500.0 * np.arange(corners.size), corners)
    swing = np.tanh(3 * np.sin(2 * np.pi * np.cumsum(hertz) * PERIOD_S))
    phi = 0.235 + 0.2765 * swing
    psi_p = response(TRUTHS["quadratic"], phi, PERIOD_S)
    phi += NOISE * phi.std() * rng.standard_normal(n_samples)
    psi_p += NOISE * psi_p.std() * rng.standard_normal(n_samples)
    return Record(phi, psi_p)


def terms_of(record: Record) -> FloatArray:
    """Return 1, φ, φ²; ψ' itself is the fourth term."""
    return np.column_stack((np.ones_like(record.phi), record.phi, record.phi**2))


def run_pysindy(record: Record) -> None:
    """Fit by finite difference: dψ'/dt on 1, ψ', φ, φ²."""
    import pysindy

    model = pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=0.0, normalize_columns=True),
        feature_library=pysindy.PolynomialLibrary(1),
    )
    inputs = np.column_stack((record.phi, record.phi**2))
    with warnings.catch_warnings():
        # pysindy's own book-keeping of axes.
        warnings.simplefilter("ignore")
        model.fit(record.psi_p[:, None], t=PERIOD_S, u=inputs)


def run_weak_rows(record: Record) -> None:
    """Set up the weak equations of one test function."""
    from sindy_surge.segments import Segments
    from sindy_surge.weak import weak_rows

    runs = Segments.from_labels(None, record.phi.size)
    weak_rows(record.psi_p, terms_of(record), runs, HALF_WIDTH, PERIOD_S)


def run_weak_lag(record: Record) -> None:
    """Estimate τ by weak regression in both directions."""
    from sindy_surge.segments import Segments
    from sindy_surge.weak import weak_lag

    runs = Segments.from_labels(None, record.phi.size)
    weak_lag(record.psi_p, terms_of(record), runs, PERIOD_S)


def run_selection(record: Record) -> None:
    """Select the terms and fit them."""
    from sindy_surge import SparseLagRegressor

    SparseLagRegressor(PERIOD_S).fit(record.phi[:, None], record.psi_p)


PYSINDY = "pysindy SINDy.fit, FD"
WEAK: dict[str, Callable[[Record], None]] = {
    PYSINDY: run_pysindy,
    "weak_rows": run_weak_rows,
    "weak_lag": run_weak_lag,
}
SELECTION = "SparseLagRegressor.fit"


def cost(call: Callable[[Record], None], record: Record) -> tuple[float, float | None]:
    """Run once; return processor seconds, and float64 a sample at the peak above the start."""
    spent = resident.cost(lambda: call(record))
    grown = spent.peak_bytes
    return spent.seconds, None if grown is None else grown / 8 / record.phi.size


def row_of(what: str, n_samples: int, costs: list[tuple[float, float | None]]) -> Row:
    """Sum up the runs of one thing; memory is that of the hungriest."""
    seconds = [one for one, _ in costs]
    floats = [one for _, one in costs if one is not None]
    most = max(floats) if floats else None
    return Row(what, n_samples, len(costs), float(np.median(seconds)), max(seconds), most)


def weak_costs(n_samples: int, turns: int) -> list[Row]:
    """Measure pysindy and the weak equations in turns, in this process."""
    small, record = long_record(WARM_UP_SAMPLES), long_record(n_samples)
    costs: dict[str, list[tuple[float, float | None]]] = {what: [] for what in WEAK}
    for call in WEAK.values():
        call(small)
    for _ in range(turns):
        for what, call in WEAK.items():
            costs[what].append(cost(call, record))
    return [row_of(what, n_samples, found) for what, found in costs.items()]


def selection_costs(n_samples: int, turns: int) -> list[Row]:
    """Measure whole selections, each on a record of its own, in this process."""
    run_selection(make_record("quadratic", NOISE, 0, 400))
    kinds = [(truth, noise) for noise in (NOISE, 0.05, 0.01) for truth in list(TRUTHS)[:4]]
    costs = []
    for turn in range(turns):
        truth, noise = kinds[turn % len(kinds)]
        costs.append(cost(run_selection, make_record(truth, noise, turn, n_samples)))
    return [row_of(SELECTION, n_samples, costs)]


def measure(what: str, n_samples: int, turns: int) -> list[Row]:
    """Measure in a process of its own, whose memory nothing else has touched."""
    done = subprocess.run(
        [sys.executable, __file__, "--measure", what, str(n_samples), str(turns)],
        env={**os.environ, **ONE_THREAD},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [Row(**row) for row in json.loads(done.stdout)]


def with_ratios(rows: list[Row], before: list[Row]) -> list[Row]:
    """Put the ratios to pysindy at the same length, and the growth since the length before."""
    peer = next(row for row in rows if row.what == PYSINDY)
    last = {row.what: row.floats_per_sample for row in before}
    result = []
    for row in rows:
        now, then = row.floats_per_sample, last.get(row.what)
        memory = None
        if now is not None and peer.floats_per_sample:
            memory = now / peer.floats_per_sample
        linear = now is None or then is None or now <= LINEAR * then
        result.append(Row(**{
            **asdict(row),
            "time_ratio": row.cpu_s / peer.cpu_s,
            "memory_ratio": memory,
            "linear": linear,
        }))  # fmt: skip
    return result


HEADER = (
    f"{'':<24}{'N':>9}{'runs':>6}{'CPU s':>9}{'most':>9}{'x pysindy':>11}"
    f"{'MB':>8}{'floats/sample':>15}{'x pysindy':>11}"
)


def line(row: Row) -> str:
    """Return one line of the table."""
    time_ratio = "" if row.time_ratio is None else f"{row.time_ratio:.2f}"
    memory_ratio = "" if row.memory_ratio is None else f"{row.memory_ratio:.2f}"
    floats, megabytes = "", ""
    if row.floats_per_sample is not None:
        floats = f"{row.floats_per_sample:.1f}{' ' if row.linear else '!'}"
        megabytes = f"{8e-6 * row.floats_per_sample * row.n_samples:.0f}"
    return (
        f"{row.what:<24}{row.n_samples:>9}{row.n_runs:>6}{row.cpu_s:>9.4f}{row.most_s:>9.4f}"
        f"{time_ratio:>11}{megabytes:>8}{floats:>15}{memory_ratio:>11}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="up to 100 000 samples, in seconds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        what, n_samples, turns = options.measure
        run = selection_costs if what == "selection" else weak_costs
        print(json.dumps([asdict(row) for row in run(int(n_samples), int(turns))]))
        return
    print(HEADER)
    rows = measure("selection", SELECTION_SAMPLES, 3 if options.quick else 12)
    print("\n".join(map(line, rows)), flush=True)
    before: list[Row] = []
    for n_samples in LENGTHS[:2] if options.quick else LENGTHS:
        before = with_ratios(measure("weak", n_samples, 3 if options.quick else 7), before)
        rows += before
        print("\n".join(map(line, before)), flush=True)
    if not options.quick:
        whole = measure("selection", LONG_SELECTION_SAMPLES, 2)
        rows += whole
        print("\n".join(map(line, whole)), flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
