"""Files of lag models with effects: data that is checked as it is read, nothing of it executed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from comparisons.harness.saved_models import (
    ModelFormat,
    Saved,
    SavedModel,
    Span,
    StandardError,
    read_models,
    save_models,
)
from comparisons.missing_effect.catalogue import CATALOGUE
from comparisons.missing_effect.catalogue.workings import shape_columns
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.extended_lag import MOST_EFFECTS, AddedEffect, ExtendedLag
from comparisons.missing_effect.lag_data import FrozenReferences
from comparisons.missing_effect.ports import n_powers
from comparisons.results import FittedLag, is_known_term
from surge_core.errors import InputError, require

EXTENDED_SCHEMA = "sindy-surge/extended-model/1"
EXTENDED_FORMAT = ModelFormat(
    EXTENDED_SCHEMA, "a file of a lag model with effects,", "sindy-surge diagnose --save"
)


def save_extended(models: Mapping[str, ExtendedLag], path: str | Path) -> None:
    """Write lag models with effects as JSON, whole or not at all.

    An effect is written by its name; one of a catalogue of one's own is found again by
    ``load_extended(path, catalogue=…)``.

    Parameters
    ----------
    models : mapping of str to ExtendedLag
        By name.
    path : str or path
        Target.
    """
    for name, model in models.items():
        unfitted = [added.name for added in model.effects if not added.fitted]
        expected, found = "effects that were fitted", ", ".join(unfitted)
        require(not unfitted, f"models.{name}", expected, f"{found}, added and not fitted yet")
    save_models(models, path, form=EXTENDED_FORMAT)


def load_extended(
    path: str | Path, catalogue: Sequence[Effect] = CATALOGUE
) -> dict[str, ExtendedLag]:
    """Read models that :func:`save_extended` wrote; the file is data, nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.
    catalogue : sequence of Effect
        Effects that the file may name.

    Raises
    ------
    InputError
        When it is missing, is not such a file, or names an effect of another catalogue.
    """
    saved = read_models(path, EXTENDED_FORMAT, _SavedExtended)
    return {name: entry.model(f"{path}: models.{name}", catalogue) for name, entry in saved.items()}


def is_extended_file(path: str | Path) -> bool:
    """Tell whether a file says of itself that it holds lag models with effects.

    Parameters
    ----------
    path : str or path
        The file; one that cannot be read is none.
    """
    try:
        document = json.loads(Path(path).read_text("utf-8"))
        return bool(document["schema"] == EXTENDED_SCHEMA)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


class _SavedParameter(Saved):
    name: str
    value: float = Field(description="a finite number")
    stderr: StandardError = Field(description="a standard error, or null")
    unit: str


class _SavedEffect(Saved):
    effect: str
    parameters: list[_SavedParameter]
    coefficients: list[float]

    def added(self, where: str, terms: Sequence[str], catalogue: Sequence[Effect]) -> AddedEffect:
        """Return the effect with its numbers, refused where they are not its own."""
        known = {effect.name: effect for effect in catalogue if effect.port != "noise"}
        if self.effect not in known:
            raise InputError(
                f"{where}.effect",
                expected=f"one of {', '.join(known)}",
                found=f"'{self.effect}'",
                remedy="an effect of your own is read by load_extended(path, catalogue=…)",
            )
        effect = known[self.effect]
        found = ", ".join(f"{row.name} [{row.unit}]" for row in self.parameters)
        own = ", ".join(f"{p.name} [{p.unit}]" for p in effect.parameters)
        require(found == own, f"{where}.parameters", own, found)
        values = tuple(row.value for row in self.parameters)
        for number, (value, p) in enumerate(zip(values, effect.parameters, strict=True), 1):
            at, bounds = f"{where}.parameters[{number}].value", f"from {p.low:g} to {p.high:g}"
            whole = p.name != "intervals" or value.is_integer()
            require(whole and p.low <= value <= p.high, at, f"{p.name} {bounds}", f"{value:g}")
        errors = tuple(row.stderr for row in self.parameters)
        added = AddedEffect(effect, values, errors, tuple(self.coefficients))
        n, found = _n_columns(where, added, terms), str(len(self.coefficients))
        require(found == str(n), f"{where}.coefficients", f"{n} of {added.name}", found)
        return added


class _SavedReferences(Saved):
    mean_amplitude: float = Field(gt=0.0, description="a number above 0")
    mean_amplitude_as_is: float = Field(gt=0.0, description="a number above 0")
    mean_speed: float = Field(gt=0.0, description="a number above 0")
    phi_range: Span
    clock_zero_s: float = Field(description="a time in s")


class _SavedNoise(Saved):
    sigma: float = Field(gt=0.0, description="a noise above 0")
    innovation: float = Field(gt=0.0, description="a noise above 0")
    ar: list[float]


class _SavedExtended(SavedModel):
    target: Literal["psi_p"] = Field(description='"psi_p"')
    hold: Literal["first"] = Field(description='the hold "first"')
    time_constant_s: float = Field(gt=0.0, description="a time constant above 0 s")
    effects: list[_SavedEffect] = Field(max_length=MOST_EFFECTS)
    references: _SavedReferences
    noise: _SavedNoise

    def model(self, where: str, catalogue: Sequence[Effect]) -> ExtendedLag:
        """Return the model as a value."""
        names = tuple(term.name for term in self.terms)
        unknown = [name for name in names if not is_known_term(name)]
        at, expected = f"{where}.terms", "powers of φ or other known terms"
        require(bool(names) and not unknown, at, expected, ", ".join(unknown) or "none")
        effects = [entry.effect for entry in self.effects]
        once = len(set(effects)) == len(effects)
        require(once, f"{where}.effects", "each effect once", ", ".join(effects))
        return ExtendedLag(
            FittedLag(
                target=self.target,
                time_constant_s=self.time_constant_s,
                hold=self.hold,
                **self.common(),
            ),
            tuple(
                entry.added(f"{where}.effects[{number}]", names, catalogue)
                for number, entry in enumerate(self.effects, 1)
            ),
            FrozenReferences(**dict(self.references)),
            self.noise.sigma,
            self.noise.innovation,
            tuple(self.noise.ar),
        )


def _n_columns(where: str, added: AddedEffect, terms: Sequence[str]) -> int:
    """Return how many coefficients an effect has."""
    if not added.effect.linear or added.effect.episodes:
        return 0
    if added.name != "characteristic_shape":
        return 1
    intervals, low, high = added.nonlinear
    at, expected = f"{where}.parameters", f"a range of φ for {added.name}, low to high"
    require(low < high, at, expected, f"{low:g} to {high:g}")
    one = shape_columns(np.array([low]), (low, high), int(intervals), n_powers(terms))
    return int(one.shape[1])
