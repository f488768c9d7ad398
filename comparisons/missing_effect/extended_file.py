"""Files of lag models with effects: data that is checked as it is read, nothing of it executed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.harness.saved_models import (
    MOST_BLOCKS,
    Fields,
    ModelFormat,
    read_models,
    write_models,
)
from comparisons.missing_effect.catalogue import CATALOGUE, find_effect
from comparisons.missing_effect.catalogue.characteristic_effects import shape_columns
from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.extended_lag import ExtendedLag
from comparisons.missing_effect.extended_parts import (
    MOST_EFFECTS,
    REFERENCES,
    SHAPE,
    AddedEffect,
    FrozenReferences,
    n_powers,
)
from comparisons.results import is_known_term

__all__ = [
    "EXTENDED_SCHEMA",
    "extended_from_json",
    "is_extended_file",
    "load_extended",
    "save_extended",
]

EXTENDED_SCHEMA = "sindy-surge/extended-model/1"
EXTENDED_FORMAT = ModelFormat(
    EXTENDED_SCHEMA, "a file of a lag model with effects,", "sindy-surge diagnose --save"
)
# More than any record can tell, and few enough to be evaluated.
MOST_TERMS, MOST_INTERVALS = 40, 64
_NAMES = tuple(effect.name for effect in CATALOGUE if effect.port != "noise")


def save_extended(models: Mapping[str, ExtendedLag], path: str | Path) -> None:
    """Write lag models with effects as JSON, whole or not at all.

    Parameters
    ----------
    models : mapping of str to ExtendedLag
        By name.
    path : str or path
        Target.
    """
    write_models(models, path, EXTENDED_FORMAT)


def load_extended(path: str | Path) -> dict[str, ExtendedLag]:
    """Read models that :func:`save_extended` wrote; the file is data, nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.

    Raises
    ------
    InputError
        When it is missing or is not such a file.
    """
    return {name: _from_fields(f) for name, f in read_models(path, EXTENDED_FORMAT).items()}


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


def extended_from_json(data: Mapping[str, Any], where: str = "model") -> ExtendedLag:
    """Build a model from plain JSON types.

    Parameters
    ----------
    data : mapping
        What :meth:`ExtendedLag.to_json` gave.
    where : str
        File and key of the model, for errors.

    Raises
    ------
    InputError
        Naming the key that cannot be used.
    """
    return _from_fields(Fields.of(data, where, EXTENDED_FORMAT.remedy))


def _from_fields(fields: Fields) -> ExtendedLag:
    fields.text("hold", 'the hold "first"', ("first",))
    fields.text("target", '"psi_p"', ("psi_p",))
    rows = fields.tables("terms")
    terms = tuple(row.text("name", "the name of a term") for row in rows)
    _check_terms(fields, terms)
    noise = fields.table("noise")
    return ExtendedLag(
        fields.number("time_constant_s", "a time constant above 0 s", above=0.0),
        fields.maybe("time_constant_stderr_s", "a standard error in s, or null", least=0.0),
        terms,
        tuple(row.number("coefficient", "a coefficient, a finite number") for row in rows),
        tuple(row.maybe("stderr", "a standard error, or null", least=0.0) for row in rows),
        _effects(fields, terms),
        _references(fields.table("references")),
        noise.number("sigma", "a noise above 0", above=0.0),
        noise.number("innovation", "a noise above 0", above=0.0),
        noise.numbers("ar", "a coefficient, a finite number"),
        fields.range("valid_phi"),
        fields.points("characteristic"),
        fields.whole("n_blocks", "a number of blocks", MOST_BLOCKS),
        fields.text("estimator", "the name of an estimator"),
        "first",
    )


def _references(fields: Fields) -> FrozenReferences:
    amplitude, as_is, speed = (
        fields.number(name, "a number above 0", above=0.0) for name in REFERENCES[:3]
    )
    clock_zero_s = fields.number("clock_zero_s", "a time in s")
    return FrozenReferences(amplitude, as_is, speed, fields.range("phi_range"), clock_zero_s)


def _effects(fields: Fields, terms: tuple[str, ...]) -> tuple[AddedEffect, ...]:
    effects = tuple(_effect(entry, terms) for entry in fields.tables("effects"))
    names = [added.name for added in effects]
    if len(set(names)) < len(names) or len(names) > MOST_EFFECTS:
        raise fields.refuse(
            "effects", f"at most {MOST_EFFECTS} effects, each once", ", ".join(names)
        )
    return effects


def _effect(entry: Fields, terms: tuple[str, ...]) -> AddedEffect:
    name = entry.text("effect", "an effect of the catalogue", _NAMES)
    effect = find_effect(name)
    rows = entry.tables("parameters")
    own = [parameter.name for parameter in effect.parameters]
    if [row.values.get("name") for row in rows] != own:
        raise entry.refuse("parameters", f"{', '.join(own)} of {name}", "others")
    added = AddedEffect(
        name,
        tuple(row.maybe("value", "a number, or null") for row in rows),
        tuple(row.maybe("stderr", "a standard error, or null", least=0.0) for row in rows),
        entry.numbers("coefficients", "a coefficient, a finite number"),
    )
    for row, parameter, value in zip(rows, effect.parameters, added.values, strict=True):
        own_unit = f'"{parameter.unit}", the unit of {parameter.name}'
        row.text("unit", own_unit, (parameter.unit,))
        _check_value(row, effect, parameter, value, acts=added.acts)
    _check_coefficients(entry, effect, added, terms)
    return added


def _check_value(
    row: Fields, effect: Effect, parameter: Parameter, value: float, *, acts: bool
) -> None:
    # What was added and not fitted yet has no shape.
    if math.isnan(value) and not acts:
        return
    counts = parameter.name == "intervals"
    if counts and value in range(1, MOST_INTERVALS):
        return
    if not counts and parameter.low <= value <= parameter.high:
        return
    what = f"1 to {MOST_INTERVALS - 1}" if counts else f"{parameter.low:g} to {parameter.high:g}"
    found = "null" if math.isnan(value) else f"{value:g}"
    raise row.refuse("value", f"{parameter.name} of {effect.name} from {what}", found)


def _check_coefficients(
    entry: Fields, effect: Effect, added: AddedEffect, terms: tuple[str, ...]
) -> None:
    allowed = _column_counts(entry, effect, added, terms)
    found = len(added.coefficients)
    if found not in allowed:
        expected = " or ".join(map(str, allowed))
        raise entry.refuse("coefficients", f"{expected} of {effect.name}", f"{found}")


def _column_counts(
    entry: Fields, effect: Effect, added: AddedEffect, terms: tuple[str, ...]
) -> tuple[int, ...]:
    """Return how many coefficients an effect may have; none where it was not fitted yet."""
    if not effect.linear or effect.episodes:
        return (0,)
    if effect.name != SHAPE:
        return (0, 1)
    intervals, low, high = added.nonlinear
    if math.isnan(intervals):
        return (0,)
    if not low < high:
        raise entry.refuse(
            "parameters", f"a range of φ for {effect.name}, low to high", f"{low:g} to {high:g}"
        )
    one = shape_columns(np.array([low]), (low, high), int(intervals), n_powers(terms))
    return (0, one.shape[1])


def _check_terms(fields: Fields, terms: tuple[str, ...]) -> None:
    for number, name in enumerate(terms):
        if not is_known_term(name):
            what = "a power of φ or another known term"
            raise fields.refuse(f"terms[{number}].name", what, f"'{name}'")
    if not 0 < len(terms) <= MOST_TERMS or len(set(terms)) < len(terms):
        raise fields.refuse(
            "terms",
            f"1 to {MOST_TERMS} terms, each once",
            f"{len(terms)}, {len(set(terms))} of them different",
        )
