"""Files of lag models with effects: data that is checked as it is read, nothing of it executed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.errors import InputError
from classic_ml.files import write_whole
from comparisons.missing_effect.catalogue.characteristic_effects import shape_columns
from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.extended_lag import ExtendedLag
from comparisons.missing_effect.extended_parts import (
    MOST_EFFECTS,
    SHAPE,
    AddedEffect,
    FrozenReferences,
    check_catalogue,
    n_powers,
)
from comparisons.terms import is_known_term

__all__ = [
    "EXTENDED_SCHEMA",
    "extended_from_json",
    "extended_to_json",
    "is_extended_file",
    "load_extended",
    "save_extended",
]

EXTENDED_SCHEMA = "sindy-surge/extended-model/1"
# More than any record can tell, and few enough to be evaluated.
MOST_TERMS, MOST_INTERVALS = 40, 64
_REFERENCES = ("mean_amplitude", "mean_amplitude_as_is", "mean_speed", "clock_zero_s")


def save_extended(models: Mapping[str, ExtendedLag], path: str | Path) -> None:
    """Write lag models with effects as JSON, whole or not at all.

    Parameters
    ----------
    models : mapping of str to ExtendedLag
        By name.
    path : str or path
        Target.
    """
    document = {
        "schema": EXTENDED_SCHEMA,
        "models": {name: model.to_json() for name, model in models.items()},
    }
    write_whole(Path(path), json.dumps(document, indent=1, allow_nan=False) + "\n")


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
    file = Path(path)
    expected = "a file of a lag model with effects, written by `sindy-surge diagnose --save`"
    if not file.is_file():
        raise InputError(str(file), expected=expected, found="no such file")
    try:
        document = json.loads(file.read_text("utf-8"))
        if document["schema"] != EXTENDED_SCHEMA:
            raise ValueError(f"the schema {document['schema']!r}")
        models = {str(k): extended_from_json(v) for k, v in document["models"].items()}
    except RecursionError:
        raise InputError(str(file), expected=expected, found="something else (nested)") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(str(file), expected=expected, found=f"something else ({error})") from None
    if not models:
        raise InputError(str(file), expected=expected, found="a file without a model")
    return models


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


def extended_to_json(model: ExtendedLag) -> dict[str, Any]:
    """Return a model as plain JSON types."""
    rows = zip(model.terms, model.coefficients, model.stderr, strict=True)
    return {
        "estimator": model.estimator,
        "target": model.target,
        "equation": model.equation(),
        "time_constant_s": model.time_constant_s,
        "time_constant_stderr_s": _finite(model.time_constant_stderr_s),
        "hold": model.hold,
        "terms": [
            {"name": name, "coefficient": value, "stderr": _finite(stderr)}
            for name, value, stderr in rows
        ],
        "effects": [_effect_to_json(added) for added in model.effects],
        "references": {
            **{name: getattr(model.references, name) for name in _REFERENCES},
            "phi_range": list(model.references.phi_range),
        },
        "noise": {
            "sigma": model.noise_sigma,
            "innovation": model.noise_innovation,
            "ar": list(model.noise_ar),
        },
        "valid_phi": list(model.valid_phi),
        "n_blocks": model.n_blocks,
        "characteristic": [[_finite(v) for v in row] for row in model.table],
    }


def extended_from_json(data: Mapping[str, Any]) -> ExtendedLag:
    """Build a model from plain JSON types; KeyError, TypeError or ValueError where it is none."""
    if data["hold"] != "first":
        raise ValueError(f"hold {data['hold']!r}")
    if data["target"] != "psi_p":
        raise ValueError(f"target {data['target']!r}")
    terms = tuple(str(term["name"]) for term in data["terms"])
    _check_terms(terms)
    effects = tuple(_effect_from_json(entry, terms) for entry in data["effects"])
    names = [added.name for added in effects]
    if len(set(names)) < len(names) or len(names) > MOST_EFFECTS:
        raise ValueError(f"the effects {', '.join(names)}")
    references, noise = data["references"], data["noise"]
    numbers = {name: _known(references[name]) for name in _REFERENCES}
    for name in _REFERENCES[:3]:
        _positive(name, numbers[name])
    return ExtendedLag(
        _positive("a time constant", data["time_constant_s"]),
        _number(data["time_constant_stderr_s"]),
        terms,
        tuple(_known(term["coefficient"]) for term in data["terms"]),
        tuple(_number(term["stderr"]) for term in data["terms"]),
        effects,
        FrozenReferences(phi_range=_range(references["phi_range"]), **numbers),
        _positive("a noise", noise["sigma"]),
        _positive("a noise", noise["innovation"]),
        tuple(_known(a) for a in noise["ar"]),
        _range(data["valid_phi"]),
        tuple((_known(p), _number(v), _number(s)) for p, v, s in data["characteristic"]),
        int(data["n_blocks"]),
        str(data["estimator"]),
        "first",
    )


def _effect_to_json(added: AddedEffect) -> dict[str, Any]:
    rows = zip(added.effect.parameters, added.values, added.stderr, strict=True)
    return {
        "effect": added.name,
        "equation": added.effect.equation,
        "parameters": [
            {"name": p.name, "value": _finite(value), "stderr": _finite(stderr), "unit": p.unit}
            for p, value, stderr in rows
        ],
        "coefficients": list(added.coefficients),
    }


def _effect_from_json(entry: Mapping[str, Any], terms: tuple[str, ...]) -> AddedEffect:
    effect = check_catalogue(str(entry["effect"]))
    rows = entry["parameters"]
    if [row["name"] for row in rows] != [p.name for p in effect.parameters]:
        raise ValueError(f"the parameters of {effect.name}")
    added = AddedEffect(
        effect.name,
        tuple(_number(row["value"]) for row in rows),
        tuple(_number(row["stderr"]) for row in rows),
        tuple(_known(b) for b in entry["coefficients"]),
    )
    for row, parameter, value in zip(rows, effect.parameters, added.values, strict=True):
        _check_parameter(effect, parameter, str(row["unit"]), value, acts=added.acts)
    allowed = _column_counts(effect, added, terms)
    if len(added.coefficients) not in allowed:
        raise ValueError(f"{len(added.coefficients)} coefficients of {effect.name}")
    return added


def _check_parameter(
    effect: Effect, parameter: Parameter, unit: str, value: float, *, acts: bool
) -> None:
    where = f"{effect.name}: {parameter.name}"
    if unit != parameter.unit:
        raise ValueError(f"{where} in {unit!r}")
    # What was added and not fitted yet has no shape.
    if math.isnan(value) and not acts:
        return
    if not parameter.low <= value <= parameter.high:
        raise ValueError(f"{where} = {value:g}")
    if parameter.name == "intervals" and value not in range(1, MOST_INTERVALS):
        raise ValueError(f"{where} = {value:g}")


def _column_counts(effect: Effect, added: AddedEffect, terms: tuple[str, ...]) -> tuple[int, ...]:
    """Return how many coefficients an effect may have; none where it was not fitted yet."""
    if not effect.linear or effect.episodes:
        return (0,)
    if effect.name != SHAPE:
        return (0, 1)
    intervals, low, high = added.nonlinear
    if math.isnan(intervals):
        return (0,)
    if not low < high:
        raise ValueError(f"{effect.name} from {low:g} to {high:g}")
    one = shape_columns(np.array([low]), (low, high), int(intervals), n_powers(terms))
    return (0, one.shape[1])


def _check_terms(terms: tuple[str, ...]) -> None:
    unknown = [name for name in terms if not is_known_term(name)]
    if unknown:
        raise ValueError(f"the term {unknown[0]!r}")
    if not 0 < len(terms) <= MOST_TERMS or len(set(terms)) < len(terms):
        raise ValueError(f"{len(terms)} terms, {len(set(terms))} of them different")


def _range(edges: Any) -> tuple[float, float]:
    low, high = (_known(edge) for edge in edges)
    if not low < high:
        raise ValueError(f"the range {low:g} to {high:g}")
    return low, high


def _positive(what: str, value: Any) -> float:
    number = _known(value)
    if number <= 0.0:
        raise ValueError(f"{what} of {number}")
    return number


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _known(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"a coefficient of {number}")
    return number


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
