"""What is missing: where simulation and measurement part, and which physical effect it is."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from comparisons.missing_effect.catalogue import CATALOGUE, find_effect
    from comparisons.missing_effect.diagnosis import diagnose
    from comparisons.missing_effect.effect import Effect, Parameter
    from comparisons.missing_effect.lag_result import LagDiagnosis
    from comparisons.missing_effect.results import Diagnosis
    from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
    from comparisons.missing_effect.systems.diagnosis import diagnose_model
    from comparisons.missing_effect.systems.experiments import Experiment
    from comparisons.missing_effect.systems.model import Model, P
    from comparisons.missing_effect.systems.open_terms import open_effect
    from comparisons.missing_effect.systems.places import SystemEffect
    from comparisons.missing_effect.systems.results import SystemDiagnosis

__all__ = [
    "CATALOGUE",
    "SYSTEM_CATALOGUE",
    "Diagnosis",
    "Effect",
    "Experiment",
    "LagDiagnosis",
    "Model",
    "P",
    "Parameter",
    "SystemDiagnosis",
    "SystemEffect",
    "diagnose",
    "diagnose_model",
    "find_effect",
    "open_effect",
]

_HOMES = {
    "CATALOGUE": "catalogue",
    "find_effect": "catalogue",
    "Diagnosis": "results",
    "LagDiagnosis": "lag_result",
    "diagnose": "diagnosis",
    "Effect": "effect",
    "Parameter": "effect",
    "SYSTEM_CATALOGUE": "systems.catalogue",
    "diagnose_model": "systems.diagnosis",
    "Experiment": "systems.experiments",
    "Model": "systems.model",
    "P": "systems.model",
    "open_effect": "systems.open_terms",
    "SystemEffect": "systems.places",
    "SystemDiagnosis": "systems.results",
}


def __getattr__(name: str) -> object:
    """Import what is asked for: the compiled engine is not needed by `--help`."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
