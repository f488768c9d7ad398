"""The effects that a compressor's lag model may lack, by name: effects.toml says what each is."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib.resources import files

from comparisons.missing_effect.catalogue.workings import WORKINGS
from comparisons.missing_effect.effect import Effect, Parameter
from surge_core.errors import require

__all__ = ["CATALOGUE", "FLOW_NOISE", "find_effect"]


def _read() -> Iterator[Effect]:
    text = files(__name__).joinpath("effects.toml").read_text("utf-8")
    for name, entry in tomllib.loads(text).items():
        parameters = tuple(Parameter(*row) for row in entry.pop("parameters"))
        yield Effect(name, parameters=parameters, **entry, **WORKINGS[name])


# Noise on φ is not searched among the others: it is found from the errors, as noise.
*_NAMES, FLOW_NOISE = _read()
CATALOGUE: tuple[Effect, ...] = tuple(_NAMES)
# What records from counts take for other names where a catalogue lacks theirs, in words.
NAMELESS = {
    "transport_delay": "a dead time",
    "second_order_lag": "one more lag",
    "sensitivity_drift": "a gain that moves",
}


def find_effect(name: str) -> Effect:
    """Return an effect of the catalogue.

    Parameters
    ----------
    name : str
        Its identifier.

    Raises
    ------
    InputError
        For an unknown name.
    """
    known = {effect.name: effect for effect in (*CATALOGUE, FLOW_NOISE)}
    require(name in known, "effect", f"one of {', '.join(known)}", repr(name))
    return known[name]
