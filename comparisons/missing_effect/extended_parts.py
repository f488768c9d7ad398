"""What a lag model with effects is made of: the effects with their numbers, and references."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.catalogue.characteristic_effects import clock_s
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.lag_data import LagData
from comparisons.results import FitRows
from surge_core.types import BoolArray, FloatArray, IntArray

# Three effects beside one lag are as many as records of one test have ever separated.
MOST_EFFECTS = 3
# Effects that are functions of φ alone, and so bend the characteristic.
REVERSE, SHAPE = BENDING = ("reverse_flow_branch", "characteristic_shape")


@dataclass(frozen=True)
class AddedEffect:
    """One effect of a model, with its numbers.

    Parameters
    ----------
    effect : Effect
        Of the built-in catalogue, or one's own.
    values, stderr : tuple of float
        Its parameters in their order and units, and their standard errors; NaN where the effect
        was added and not fitted yet.
    coefficients : tuple of float
        Of the columns that it adds; empty for an effect without any, and for a ripple, whose
        phases belong to the episodes that it was fitted to.
    """

    effect: Effect
    values: tuple[float, ...]
    stderr: tuple[float, ...]
    coefficients: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Its identifier."""
        return self.effect.name

    @property
    def nonlinear(self) -> FloatArray:
        """Values of the parameters that are no coefficients, in their order."""
        pairs = zip(self.effect.parameters, self.values, strict=True)
        return np.array([value for p, value in pairs if p.kind != "linear"])

    @property
    def acts(self) -> bool:
        """Whether it changes what the model simulates."""
        if self.effect.episodes:
            return False
        return any(self.coefficients) if self.effect.linear else self.values[0] != 0.0

    @property
    def fitted(self) -> bool:
        """Whether its numbers come from a fit."""
        return bool(np.all(np.isfinite((*self.values, *self.stderr))))

    @property
    def numbers(self) -> tuple[FittedParameter, ...]:
        """Its numbers with names and units."""
        rows = zip(self.effect.parameters, self.values, self.stderr, strict=True)
        return tuple(FittedParameter(p.name, value, error, p.unit) for p, value, error in rows)

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types."""
        return {
            "effect": self.name,
            "equation": self.effect.equation,
            "parameters": [
                {
                    "name": p.name,
                    "value": finite(p.value),
                    "stderr": finite(p.stderr),
                    "unit": p.unit,
                }
                for p in self.numbers
            ],
            "coefficients": list(self.coefficients),
        }


@dataclass(frozen=True)
class FrozenReferences:
    """What effects are measured from; frozen with the fit, or they would mean another thing.

    Parameters
    ----------
    mean_amplitude, mean_amplitude_as_is : float
        Mean amplitude of φ, at which τ is stated.
    mean_speed : float
        Mean corrected speed, at which the characteristic is stated.
    phi_range : tuple of float
        Range of φ that was fitted.
    clock_zero_s : float
        Facility clock from which drifts and the heating of the facility count, in seconds.
    """

    mean_amplitude: float
    mean_amplitude_as_is: float
    mean_speed: float
    phi_range: tuple[float, float]
    clock_zero_s: float

    @classmethod
    def of(cls, data: LagData) -> FrozenReferences:
        """Take the references of the rows that a model is fitted to."""
        # The engine's own clock is the facility clock less its zero.
        zero_s = float(data["time_s"][0] - clock_s(data)[0])
        return cls(
            data.mean_amplitude, data.mean_amplitude_as_is, data.mean_speed, data.phi_range, zero_s
        )

    def on(self, data: LagData) -> LagData:
        """Return rows in which every effect is measured from these references."""
        data = data.with_signal("time_s", data["time_s"] - self.clock_zero_s)
        return replace(data, origin_s=0.0, **self.levels)

    @property
    def levels(self) -> dict[str, Any]:
        """All but the clock, by their names in `LagData`."""
        return {name: value for name, value in vars(self).items() if name != "clock_zero_s"}


def on_segments(record: CoefficientSeries, segment: IntArray) -> CoefficientSeries:
    """Return a record of such segments, without the unfiltered columns that it may carry."""
    return replace(
        record,
        segment=segment,
        phi_unfiltered=None,
        psi_p_unfiltered=None,
        stalled=None,
        free_run=None,
    )


def by_record(
    rows: FitRows, records: Sequence[CoefficientSeries]
) -> Iterator[tuple[CoefficientSeries, BoolArray, IntArray]]:
    """Return each record with the rows of a comparison that are its own, and where they stand."""
    for i, record in enumerate(records):
        own = rows.record == i
        yield record, own, rows_in(record, rows.time_s[own])


def rows_in(record: CoefficientSeries, time_s: FloatArray) -> IntArray:
    """Return the rows of a record at given times of its clock, of shape (n,)."""
    at = np.rint((time_s - record.time_s[0]) / record.sample_period_s)
    return np.asarray(at.astype(np.int64))


def finite(value: float) -> float | None:
    """Return a number for JSON, None where it is not known."""
    return float(value) if math.isfinite(value) else None
