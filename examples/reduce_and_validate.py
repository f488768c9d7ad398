"""From counts to a curve, and a validation run on an instability that nothing was fitted to."""

from __future__ import annotations

import tempfile
from pathlib import Path

from classic_ml.io import read_raw
from classic_ml.reduction import Reduction, reduce_record
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.rig import simulate, write_run
from comparisons.show.table import comparison_table


def reduced(case: str, seed: int, folder: Path) -> Reduction:
    write_run(simulate(case, seed=seed), folder)
    return reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml"))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        fitted = reduced("985", 0, Path(name) / "first")
        second = reduced("985-second", 1, Path(name) / "second")
    for entry in fitted.record.history:
        print(f"{entry.step}: {entry.did}")
    comparison = compare_records([fitted.series], estimators=default_estimators()[:2])
    print(comparison_table(comparison))
    for result in comparison.results:
        score = reconstruct_record(result.model, second.series).score
        print(f"{result.label} on the second instability: rms {score.rms:.3f}, R² {score.r2:.2f}")


if __name__ == "__main__":
    main()
