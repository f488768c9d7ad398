"""The effects that a compressor's lag model may lack, by name."""

from __future__ import annotations

from comparisons.missing_effect.catalogue.characteristic_effects import CHARACTERISTIC_EFFECTS
from comparisons.missing_effect.catalogue.lag_effects import INPUT_EFFECTS, LAG_EFFECTS
from comparisons.missing_effect.catalogue.output_effects import FLOW_NOISE, OUTPUT_EFFECTS
from comparisons.missing_effect.effect import Effect

__all__ = ["CATALOGUE", "DRIFT_FAMILY", "FLOW_NOISE", "find_effect"]

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
    from surge_core.errors import InputError

    known = (*CATALOGUE, FLOW_NOISE)
    for effect in known:
        if effect.name == name:
            return effect
    raise InputError(
        "effect", expected="one of " + ", ".join(e.name for e in known), found=repr(name)
    )


# Without a channel of its own the data cannot always tell which of these moved.
DRIFT_FAMILY = ("sensitivity_drift", "facility_heating", "bias_drift", "speed_droop")
