"""What is missing: where simulation and measurement part, and which physical effect it is."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from comparisons.missing_effect.catalogue import CATALOGUE, find_effect
    from comparisons.missing_effect.diagnosis import Diagnosis, diagnose
    from comparisons.missing_effect.effect import Effect, Parameter

__all__ = ["CATALOGUE", "Diagnosis", "Effect", "Parameter", "diagnose", "find_effect"]

_HOMES = {
    "CATALOGUE": "catalogue",
    "find_effect": "catalogue",
    "Diagnosis": "diagnosis",
    "diagnose": "diagnosis",
    "Effect": "effect",
    "Parameter": "effect",
}


def __getattr__(name: str) -> object:
    """Import what is asked for: the compiled engine is not needed by `--help`."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
