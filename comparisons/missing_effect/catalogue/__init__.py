"""The effects that a compressor's lag model may lack, by name."""

from __future__ import annotations

from comparisons.missing_effect.catalogue.characteristic_effects import CHARACTERISTIC_EFFECTS
from comparisons.missing_effect.catalogue.lag_effects import INPUT_EFFECTS, LAG_EFFECTS
from comparisons.missing_effect.catalogue.output_effects import FLOW_NOISE, OUTPUT_EFFECTS
from comparisons.missing_effect.effect import Effect
from surge_core.errors import InputError

__all__ = ["CATALOGUE", "FLOW_NOISE", "find_effect"]

CATALOGUE: tuple[Effect, ...] = (
    *INPUT_EFFECTS,
    *CHARACTERISTIC_EFFECTS,
    *LAG_EFFECTS,
    *OUTPUT_EFFECTS,
)


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
    known = (*CATALOGUE, FLOW_NOISE)
    for effect in known:
        if effect.name == name:
            return effect
    raise InputError(
        "effect", expected="one of " + ", ".join(e.name for e in known), found=repr(name)
    )
