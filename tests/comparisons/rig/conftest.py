from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from comparisons.rig import CASES, RigRun, SensorSettings, simulate
from comparisons.rig.plant import PlantRun, run_plant


@cache
def _default_run(case: str) -> RigRun:
    return simulate(case)


@cache
def _ideal_run(case: str) -> RigRun:
    return simulate(case, sensors=SensorSettings.ideal())


@cache
def _plant(case: str) -> PlantRun:
    return run_plant(CASES[case], n_rows=40_001)


@pytest.fixture(scope="session")
def default_run() -> Callable[[str], RigRun]:
    """Four seconds of a case with the paper's instrumentation, seed 0."""
    return _default_run


@pytest.fixture(scope="session")
def ideal_run() -> Callable[[str], RigRun]:
    """Four seconds of a case with sensors that hide nothing."""
    return _ideal_run


@pytest.fixture(scope="session")
def plant_run() -> Callable[[str], PlantRun]:
    """Four seconds of a case's plant at 10 kHz."""
    return _plant
