"""Records of a study: made or read, reduced, and what is true of them."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from classic_ml.description import TestDescription
from classic_ml.io import read_raw
from classic_ml.io.series import read_series
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.series import CoefficientSeries
from comparisons.rig import CASES, SensorSettings, simulate, write_run
from comparisons.rig.coefficient_tests import CoefficientTest, simulate_test
from comparisons.study.design import Point
from comparisons.study.rigs import draw_of
from comparisons.study.spec import Scalar
from surge_core.errors import InputError
from surge_core.models import read_toml
from surge_core.types import FloatArray

FIT_DEFAULTS: dict[str, Scalar] = {"degree": 2, "hold": "first"}


@dataclass(frozen=True)
class Made:
    """A record before its reduction, and its truth."""

    series: tuple[CoefficientSeries, ...]  # Where it is made or read as coefficients
    raw: tuple[Record, TestDescription] | None  # Where it is counts
    tau_s: float  # True time constant; NaN where it is not known
    # True characteristic, ψ' at φ of shape (n,), and where in φ it is known.
    curve: Callable[[FloatArray], Any] | None = None
    known_phi: tuple[float, float] = (-math.inf, math.inf)
    # Effects beyond lag and parabola that the machine truly has: no false name.
    effects: frozenset[str] = frozenset()


def make_record(point: Point) -> Made:
    """Make or read the record of a point by its source, seed and record settings."""
    makers: dict[str, Callable[..., Made]] = {
        "coefficients": _coefficients,
        "rig": _rig,
        "machines": _machine,
        "files": _files,
    }
    return makers[point.source](point.seed, **point.table("record"))


def prepare(made: Made, point: Point) -> tuple[CoefficientSeries, ...]:
    """Reduce the record of a point, where it is counts."""
    if made.raw is not None:
        settings = ReductionSettings(**point.table("reduction"))  # type: ignore[arg-type]
        return (reduce_record(*made.raw, settings).series,)
    if point.table("reduction"):
        raise InputError(
            "[reduction]", expected="a raw record to reduce", found="a file of coefficients"
        )
    return made.series


def _coefficients(
    seed: int,
    *,
    sample_period_s: float = 0.01,
    duration_s: float = 20.0,
    noise_percent: float = 1.0,
    hide: str | None = None,
    **settings: Any,
) -> Made:
    test = simulate_test(
        hide,
        seed=seed,
        n_samples=round(duration_s / sample_period_s),
        sample_period_s=sample_period_s,
        noise_frac=noise_percent / 100.0,
        **settings,
    )
    return Made(series_of(test), None, test.tau_s, partial(polyval, c=test.beta))


def series_of(test: CoefficientTest) -> tuple[CoefficientSeries, ...]:
    """Return the records of a test at the level of coefficients as series."""
    return tuple(
        CoefficientSeries(
            r.time_s,
            r.phi,
            r.psi_p,
            np.ones(r.phi.size, dtype=np.int64) if r.segment is None else r.segment,
            T25_K=r.T25_K,
            Nc_frac=r.Nc_frac,
            in_stall=r.in_stall,
            source=f"record {i}",
        )
        for i, r in enumerate(test.records, start=1)
    )


def _through_files(write: Callable[[Path], object]) -> tuple[Any, dict[str, Any]]:
    """Return a raw record as a user's comes, nothing but counts and description, and its truth."""
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "record"
        write(kept)
        # The truth is set apart before anything reads the record, and goes to the scores alone.
        truth = read_toml(kept / "truth" / "truth.toml", "the truth of a record")
        shutil.rmtree(kept / "truth")
        return read_raw(kept / "raw.csv", kept / "test.toml"), truth


def _rig(
    seed: int, *, case: str = "985", noise_percent: float | None = None, **settings: Any
) -> Made:
    sensors = SensorSettings()
    if noise_percent is not None:
        sensors = replace(sensors, noise_percent=noise_percent, reading_noise_percent=noise_percent)
    run = simulate(case, seed=seed, sensors=sensors, **settings)
    raw, _ = _through_files(partial(write_run, run))
    machine = CASES[case]
    return Made((), raw, machine.tau_s, partial(polyval, c=machine.pressure_terms))


def _machine(seed: int, *, rig: str) -> Made:
    raw, truth = _through_files(partial(draw_of(rig), seed))
    table, beta = truth.get("quasi_steady"), truth.get("beta", ())
    curve: Callable[[FloatArray], Any] | None = None
    known_phi = (-math.inf, math.inf)
    if table:
        curve = partial(np.interp, xp=table["phi"], fp=table["psi_p"])
        known_phi = (table["phi"][0], table["phi"][-1])
    elif beta and "hidden" not in truth:
        # What is hidden may bend the curve.
        curve = partial(polyval, c=beta)
    # What is no parabola has a shape, and a loss in reversed flow is an effect of its own.
    bent = ("characteristic_shape",) if table or len(beta) > 3 else ()
    lossy = ("reverse_flow_branch",) if truth.get("reverse_loss") else ()
    hidden = (truth["hidden"]["effect"],) if "hidden" in truth else ()
    effects = frozenset((*truth.get("effects", ()), *hidden, *bent, *lossy))
    return Made((), raw, float(truth["tau_s"]), curve, known_phi, effects)


def _files(_: int, *, path: str) -> Made:
    place = Path(path)
    if place.is_dir():
        return Made((), read_raw(place / "raw.csv", place / "test.toml"), math.nan)
    return Made((read_series(place),), None, math.nan)
