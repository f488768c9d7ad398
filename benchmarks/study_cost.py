"""What a study costs beside its fits, and whether its memory stays flat.

The first study is `examples/study.toml` with more seeds on two workers: the share of the workers'
time that goes into fits (the rest is records, reduction, hand-over and the start of the workers).
The second has many small cells in two workers: resident memory of the command, which hands out
tasks, keeps the journal and writes the table, as cells go by; and of its workers at the end.

    python benchmarks/study_cost.py [--seeds 12] [--cells 10000]
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "study.toml"
WORKERS = 2
# Cells of the second study are as small as they can be.
CHEAP = (
    "linear_model:LinearRegression",
    "linear_model:Ridge",
    "linear_model:Lasso",
    "dummy:DummyRegressor",
)


def resident_mb(pid: int | None = None) -> float:
    """Resident memory of a process and not of its children, in MB."""
    import psutil

    return psutil.Process(pid).memory_info().rss / 1e6


def children_mb() -> list[float]:
    """Resident memory of each worker, in MB."""
    import psutil

    every = psutil.Process().children(recursive=True)
    return sorted((p.memory_info().rss / 1e6 for p in every), reverse=True)[:WORKERS]


def share_in_fits(seeds: int, folder: Path) -> None:
    """Print the share of two workers' time that goes into fits."""
    from comparisons.study.engines import joblib_engine
    from comparisons.study.run import run_study
    from comparisons.study.spec import spec_from

    given = tomllib.loads(EXAMPLE.read_text("utf-8")) | {"seeds": seeds}
    begun = time.perf_counter()
    table = run_study(spec_from(given), folder, engine=joblib_engine(WORKERS), workers=WORKERS)
    wall = time.perf_counter() - begun
    offered = WORKERS * wall
    print(f"{len(table)} cells on {WORKERS} workers, {wall:.0f} s")
    for name in ("seconds_fit", "seconds_record", "seconds_reduction"):
        print(f"  {name:18s} {table[name].sum():8.1f} s {100 * table[name].sum() / offered:6.1f} %")


def memory(cells: int, folder: Path) -> None:
    """Print resident memory while many small cells go by."""
    from comparisons.study.engines import joblib_engine
    from comparisons.study.run import run_study
    from comparisons.study.spec import spec_from

    spec = spec_from(
        {
            "seeds": cells // len(CHEAP),
            "record": {"duration_s": 1.0, "n_records": 1},
            "method": [{"name": name, "class": f"sklearn.{name}"} for name in CHEAP],
        }
    )
    finished, rows = 0, []

    def told(count: int) -> None:
        nonlocal finished
        finished += count
        if finished // 500 > (rows[-1][0] // 500 if rows else -1):
            rows.append((finished, resident_mb(), sum(children_mb())))

    begun = time.perf_counter()
    run_study(spec, folder, engine=joblib_engine(WORKERS), workers=WORKERS, told=told)
    print(f"{finished} cells, {1e3 * (time.perf_counter() - begun) / finished:.1f} ms each")
    print(f"{'cells':>8s} {'command, MB':>12s} {'workers, MB':>12s}")
    for at in (1, len(rows) // 4, len(rows) // 2, 3 * len(rows) // 4, len(rows) - 1):
        print(f"{rows[at][0]:8d} {rows[at][1]:12.0f} {rows[at][2]:12.0f}")
    half = np.array(rows[len(rows) // 2 :])
    for column, name in ((1, "command"), (2, "workers")):
        slope = np.polyfit(half[:, 0], half[:, column], 1)[0]
        print(f"growth of the {name} over the second half: {1e3 * slope:.2f} MB in 1000 cells")
    print(f"with the table: {resident_mb():.0f} MB")


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--cells", type=int, default=10_000)
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        if given.seeds:
            share_in_fits(given.seeds, Path(folder) / "share")
        if given.cells:
            memory(given.cells, Path(folder) / "memory")


if __name__ == "__main__":
    main()
