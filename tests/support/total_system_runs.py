"""Short records of the rig for the total-system method, read once for all its tests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Record
from comparisons.rig import CASES, RigRun, SensorSettings, simulate, write_run
from comparisons.total_system import (
    Measured,
    TotalSystemModel,
    TotalSystemSettings,
    measured_signals,
)
from comparisons.total_system.rig_facility import facility_of_case

TRUE_TAU_S = 0.018


@cache
def ideal(case: str, duration_s: float) -> tuple[RigRun, Record, TestDescription]:
    """A short record with sensors that hide nothing."""
    return _run(case, duration_s, SensorSettings.ideal())


@cache
def real(case: str, duration_s: float) -> tuple[RigRun, Record, TestDescription]:
    """A record with the paper's instrumentation."""
    return _run(case, duration_s, None)


def _run(
    case: str, duration_s: float, sensors: SensorSettings | None
) -> tuple[RigRun, Record, TestDescription]:
    run = simulate(case, seed=3, duration_s=duration_s, sensors=sensors)
    with TemporaryDirectory() as folder:
        write_run(run, Path(folder) / "run")
        record, test = read_raw(
            Path(folder) / "run" / "raw.csv", Path(folder) / "run" / "test.toml"
        )
    return run, record, test


@cache
def signals(case: str, duration_s: float) -> Measured:
    run, _, test = ideal(case, duration_s)
    return measured_signals(run.truth, test, smoothing_s=0.0)


def settings(case: str, **given: object) -> TotalSystemSettings:
    return TotalSystemSettings(facility_of_case(case), smoothing_s=0.0, **given)  # type: ignore[arg-type]


def near_truth(case: str, **given: object) -> TotalSystemSettings:
    beta = CASES[case].pressure_terms
    return settings(case, initial_beta=beta, initial_tau_s=TRUE_TAU_S, **given)


def model_of(case: str, start_s: float = np.inf, **facility: float) -> TotalSystemModel:
    plant, (_, _, test) = CASES[case], ideal(case, 2.0)
    changed = replace(facility_of_case(case), **facility)
    flow = signals(case, 2.0).near_stall_flow_kg_s
    return TotalSystemModel(test, changed, flow, plant.pressure_terms, plant.tau_s, start_s)
