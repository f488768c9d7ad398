"""Short records of the rig for the total-system method, read once for all its tests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from rig_records import rig_run, through_files

from classic_ml.io import TestDescription
from classic_ml.records import Record
from comparisons.rig import CASES, RigRun, SensorSettings
from comparisons.total_system import (
    Measured,
    TotalSystemModel,
    TotalSystemSettings,
    measured_signals,
)
from comparisons.total_system.facility import facility_of_case

TRUE_TAU_S = 0.018


@cache
def ideal(case: str) -> tuple[RigRun, Record, TestDescription]:
    """Two seconds of the rig with sensors that hide nothing, but for a little noise."""
    sensors = replace(SensorSettings.ideal(), noise_percent=0.02, thermocouple_noise_k=0.05)
    run = rig_run(case, 3, duration_s=2.0, sensors=sensors)
    return run, *through_files(run)


@cache
def signals(case: str) -> Measured:
    """The truth as a record without noise."""
    run, _, test = ideal(case)
    return measured_signals(run.truth, test, smoothing_s=0.0)


def settings(case: str, **given: object) -> TotalSystemSettings:
    """Settings with the rig's own facility."""
    return TotalSystemSettings(facility_of_case(case), **given)  # type: ignore[arg-type]


def near_truth(case: str, **given: object) -> TotalSystemSettings:
    """The same, started at the truth."""
    beta = CASES[case].pressure_terms
    return settings(case, initial_beta=beta, initial_tau_s=TRUE_TAU_S, **given)


def model_of(case: str, start_s: float = np.inf) -> TotalSystemModel:
    """The model with the rig's own numbers."""
    plant, flow = CASES[case], signals(case).near_stall_flow_kg_s
    test = ideal(case)[2]
    return TotalSystemModel(
        test, facility_of_case(case), flow, plant.pressure_terms, plant.tau_s, start_s
    )
