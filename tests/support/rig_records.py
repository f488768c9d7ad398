"""Records of the simulated rig, each made once in a test run and read back from its files."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from classic_ml.series import CoefficientSeries
from comparisons.rig import RigRun, simulate, write_run


@cache
def rig_run(case: str, seed: int = 0, **options: Any) -> RigRun:
    """A run of the rig; the options are those of `simulate`."""
    return simulate(case, seed=seed, **options)


def through_files(run: RigRun) -> tuple[Record, TestDescription]:
    """A run as its files give it back."""
    with TemporaryDirectory() as folder:
        files = Path(folder) / "run"
        write_run(run, files)
        return read_raw(files / "raw.csv", files / "test.toml")


@cache
def rig_record(case: str, seed: int = 0, **options: Any) -> tuple[Record, TestDescription]:
    """The counts and the description of a run."""
    return through_files(rig_run(case, seed, **options))


@cache
def rig_series(case: str, seed: int = 0, **options: Any) -> CoefficientSeries:
    """What the reduction makes of a run by its defaults."""
    return reduce_record(*rig_record(case, seed, **options)).series
