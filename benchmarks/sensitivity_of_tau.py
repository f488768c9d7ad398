"""How far τ moves when a constant of the estimate is halved and doubled, in standard deviations.

    python benchmarks/sensitivity_of_tau.py [--records "FOLDER/m*"]

Two records of the simulated rig, and any folders with raw.csv and test.toml. The standard deviation
is that which the estimate states without twins.
"""

from __future__ import annotations

import argparse
import glob
import math
import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np

import classic_ml.whole_record_fit as estimate
from classic_ml import segments
from classic_ml.io.raw import read_raw
from classic_ml.reduction import reduce_record
from classic_ml.whole_record import branches, passes, stall_state
from classic_ml.whole_record.rakes import RakeSignals, rake_signals_of
from comparisons.rig import simulate, write_run

CONSTANTS: dict[ModuleType, str] = {
    branches: "AVERAGE_PERIODS LONGEST_AVERAGE_S START_S LOSS_AVERAGE_S HIGHER_HINGE",
    passes: "BEFORE_OVERLOAD_S AFTER_OVERLOAD_S SHORTEST_PIECE_S END_S LONGEST_QUIET_S "
    "QUIET_KEPT_S SHORTEST_STATE_S SPEED_AVERAGE_S PIECE_S REACH_PERIODS RIDGE",
    segments: "LOWEST_CELL_SHARE",
    stall_state: "REARMED_SHARE LEVEL_AVERAGE_S SLOPE_AVERAGE_S LOWEST_RECOVERY LOWEST_ENTRY "
    "PEAK_S INDEPENDENT_S",
}


def signals_in(folder: Path) -> RakeSignals:
    """Return the probe pairs of a record."""
    series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
    found = rake_signals_of(series)
    assert found is not None
    return found


def main() -> None:
    """Print the table: root mean square and largest move over the records."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--records", default="")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        for case in ("985", "90"):
            write_run(simulate(case, seed=41), Path(place) / case)
        folders = [Path(place) / "985", Path(place) / "90", *map(Path, glob.glob(given.records))]
        records = [signals_in(folder) for folder in folders]
    fits = [estimate.fit_whole_record(each, n_twins=0) for each in records]
    print(f"{len(records)} records{'':26s} halved: rms, largest   doubled: rms, largest")
    for module, name in ((m, n) for m, names in CONSTANTS.items() for n in names.split()):
        value, cells_ = getattr(module, name), []
        for factor in (0.5, 2.0):
            setattr(module, name, factor * value)
            moved = []
            for each, fit in zip(records, fits, strict=True):
                tau_s = estimate.fit_whole_record(each, interval=False).tau_s
                moved.append(math.log(tau_s / fit.tau_s) / fit.share)
            cells_.append(f"{np.sqrt(np.mean(np.square(moved))):10.2f}{np.abs(moved).max():8.2f}")
        setattr(module, name, value)
        where = module.__name__.rpartition(".")[2]
        print(f"{where + '.' + name:34s}{value:8g}{cells_[0]}{cells_[1]}", flush=True)


if __name__ == "__main__":
    main()
