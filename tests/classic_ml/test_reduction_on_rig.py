"""The reduction against the simulated rig, whose truth is known and whose equations are its own."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from rig_records import rig_record, rig_run, through_files

from classic_ml.coefficients import psi_is_known
from classic_ml.faults.search import inspect_readings
from classic_ml.reduction import Reduction, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from comparisons.rig import SensorSettings


@cache
def reduced(case: str, seed: int, phase: str = "zero") -> Reduction:
    return reduce_record(*rig_record(case, seed), ReductionSettings(phase=phase))


def rms(case: str, seed: int, name: str, phase: str = "zero", late: int = 0) -> float:
    reduction, truth = reduced(case, seed, phase), rig_run(case, seed).truth
    rows = np.flatnonzero(reduction.series.scored)
    rows = rows[rows + late < reduction.series.n_samples]
    error = getattr(reduction.series, name)[rows + late] - truth[name][rows]
    return float(np.sqrt(np.mean(error**2)))


@pytest.mark.parametrize("case", ["985", "90"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_phi_is_the_rig_s_within_0_02(case: str, seed: int) -> None:
    assert rms(case, seed, "phi") < 0.02
    # The causal filter is 8 ms late, with the 1 ms of tubes and anti-alias filter.
    assert rms(case, seed, "phi", "causal", late=8) < 0.02
    assert rms(case, seed, "phi", "causal") > 0.05


@pytest.mark.parametrize("case", ["985", "90", "95", "985-second"])
def test_psi_p_is_the_rig_s_within_0_1(case: str) -> None:
    # Of 1.2 to 3.6.
    assert rms(case, 0, "psi_p") < 0.1


@pytest.mark.parametrize("case", ["985", "90", "95", "985-second", "blowdown"])
def test_the_window_holds_the_repeating_cycles_of_every_plant(case: str) -> None:
    reduction = reduced(case, 0)
    truth = rig_run(case, 0).truth
    entry = next(e for e in reduction.record.history if e.step == "window")
    assert int(entry.parameters["n_cycles"]) >= 8
    start, stop = reduction.window_s
    assert start > 0.3
    inside = (truth.time_s >= start) & (truth.time_s <= stop)
    speed = truth["Nc_frac"]
    settled = np.median(speed[inside])
    half = inside & (truth.time_s < 0.5 * (start + stop))
    assert np.abs(np.median(speed[half]) - settled) < 0.02


def work_error(form: str, sensors: SensorSettings | None = None) -> tuple[float, str]:
    """Return the rms error of ψ in the segments, and the form that was taken."""
    run = rig_run("90", sensors=sensors)
    reduction = reduce_record(*through_files(run), ReductionSettings(work_form=form))
    assert reduction.series.psi is not None
    rows = reduction.series.scored & psi_is_known(reduction.series.phi)
    error = (reduction.series.psi - run.truth["psi"])[rows]
    entry = next(e for e in reduction.record.history if e.step == "work coefficient")
    return float(np.sqrt(np.mean(error**2))), str(entry.parameters["form"])


def test_eq_13_gives_way_where_the_flows_of_the_planes_disagree() -> None:
    measured, form = work_error("auto")
    by_eq_13, _ = work_error("exit-flow")
    assert form == "temperature-rise"
    assert measured < 0.35 * by_eq_13
    _, form = work_error("auto", SensorSettings.ideal())
    assert form == "exit-flow"


@pytest.mark.parametrize("case", ["985", "90", "95", "985-second", "blowdown", "75-stall"])
@pytest.mark.parametrize("seed", [0, 1])
def test_no_thermocouple_of_a_sound_record_is_off(case: str, seed: int) -> None:
    record, test = rig_record(case, seed)
    flags = inspect_readings(record, test).history[-1].flags
    assert not [flag for flag in flags if flag.startswith("T") and "spiked" in flag]
