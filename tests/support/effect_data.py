"""Records with an effect hidden in them, and their diagnoses, each made once in a test run."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect import Diagnosis, diagnose
from comparisons.rig.coefficient_tests import CoefficientTest, simulate_test

CUBIC = ("1", "phi", "phi^2", "phi^3")
# The records of the small study: three of 2 000 samples with white noise.
STUDY = {"seed": 3, "n_samples": 2000}
# What the truth calls the parameters of each effect, by the name that the catalogue gives them.
TRUE_NAMES = {
    "transport_delay": {"d": "delay_s"},
    "facility_heating": {"a": "loss_frac", "T_h": "heating_time_s"},
    "speed_droop": {"c": "exponent"},
    "hysteresis": {"Delta": "step", "phi_lo": "phi_lo", "phi_hi": "phi_hi"},
    "reverse_flow_branch": {"c": "coefficient", "lagged": "lagged"},
    "characteristic_shape": {},
    "second_order_lag": {"a2": "a2_s2"},
    "amplitude_dependent_lag": {"k": "slope"},
    "asymmetric_lag": {"k": "slope"},
    "flow_dependent_lag": {"k": "slope", "phi_t": "phi_threshold"},
    "flow_inertia": {"l": "length_s"},
    "thermocouple_lag": {"tau_tc": "lag_s"},
    "sensitivity_drift": {"s": "rate_per_s"},
    "bias_drift": {"c": "rate_per_s"},
    "rotating_stall_ripple": {"r": "amplitude", "f": "frequency_hz"},
}


def series_of(test: CoefficientTest) -> list[CoefficientSeries]:
    """The records of a test as a user has them, in the order of the clock."""
    return [
        CoefficientSeries(
            record.time_s,
            record.phi,
            record.psi_p,
            np.ones(record.phi.size, dtype=np.int64) if record.segment is None else record.segment,
            T25_K=record.T25_K,
            Nc_frac=record.Nc_frac,
            in_stall=record.in_stall,
            source=f"record-{number}.csv",
        )
        for number, record in enumerate(test.records, start=1)
    ]


@cache
def hidden(effect: str | tuple[str, ...] | None, **options: Any) -> CoefficientTest:
    """A test with an effect hidden in it; 1.5 sigma unless the options say otherwise."""
    return simulate_test(effect, **{"strength": 1.5, **options})


@cache
def diagnosed(
    effect: str | tuple[str, ...] | None, degree: int = 3, **options: Any
) -> tuple[CoefficientTest, Diagnosis]:
    """A test and what a diagnosis makes of its records."""
    test = hidden(effect, **options)
    return test, diagnose(series_of(test), degree)


def without_channels(record: CoefficientSeries) -> CoefficientSeries:
    """The record of a rig that wrote neither temperature nor speed nor the state."""
    return replace(record, T25_K=None, Nc_frac=None, in_stall=None)


def named_sets(diagnosis: Diagnosis) -> list[set[str]]:
    """The alias set of each effect that was found."""
    return [set(item.alias_set) for item in diagnosis.missing]


def firm(diagnosis: Diagnosis) -> bool:
    """Whether the verdict gives a name of the catalogue without reserve."""
    return diagnosis.verdict in ("named", "alias_set")
