"""What a lag model with effects is made of: the effects with their numbers, and references."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.catalogue.characteristic_effects import clock_s
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.lag_data import LagData
from surge_core.types import FloatArray

__all__ = [
    "MOST_EFFECTS",
    "REFERENCES",
    "REVERSE",
    "SHAPE",
    "AddedEffect",
    "FrozenReferences",
    "finite",
    "n_powers",
]

# Three effects beside one lag are as many as records of one test have ever separated.
MOST_EFFECTS = 3
REVERSE, SHAPE = "reverse_flow_branch", "characteristic_shape"
REFERENCES = ("mean_amplitude", "mean_amplitude_as_is", "mean_speed", "clock_zero_s")


def finite(value: float) -> float | None:
    """Return a number for JSON, None where it is not known."""
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True)
class AddedEffect:
    """One effect of a model, with its numbers.

    Parameters
    ----------
    name : str
        Identifier in the catalogue.
    values, stderr : tuple of float
        Its parameters in the order and units of the catalogue, and their standard errors; NaN
        where the effect was added and not fitted yet.
    coefficients : tuple of float
        Of the columns that it adds; empty for an effect without any, and for a ripple, whose
        phases belong to the episodes that it was fitted to.
    """

    name: str
    values: tuple[float, ...]
    stderr: tuple[float, ...]
    coefficients: tuple[float, ...] = ()

    @classmethod
    def neutral(cls, effect: Effect) -> AddedEffect:
        """Return an effect that is not there yet: amplitude 0, its shape unknown."""
        unknown = (np.nan,) * (len(effect.parameters) - 1)
        return cls(effect.name, (0.0, *unknown), (np.nan,) * len(effect.parameters))

    @property
    def effect(self) -> Effect:
        """The effect in the catalogue."""
        return find_effect(self.name)

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

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types."""
        rows = zip(self.effect.parameters, self.values, self.stderr, strict=True)
        return {
            "effect": self.name,
            "equation": self.effect.equation,
            "parameters": [
                {"name": p.name, "value": finite(value), "stderr": finite(stderr), "unit": p.unit}
                for p, value, stderr in rows
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
        signals = {**data.signals, "time_s": data["time_s"] - self.clock_zero_s}
        return replace(
            data,
            signals=signals,
            mean_amplitude=self.mean_amplitude,
            mean_amplitude_as_is=self.mean_amplitude_as_is,
            mean_speed=self.mean_speed,
            phi_range=self.phi_range,
            origin_s=0.0,
        )


def n_powers(terms: Sequence[str]) -> int:
    """Return how many powers of φ, from the constant on without a gap, are among the terms."""
    powers = ["1", "phi", *(f"phi^{k}" for k in range(2, len(terms) + 1))]
    return next((k for k, name in enumerate(powers) if name not in terms), len(terms))
