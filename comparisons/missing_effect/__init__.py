"""What is missing: where simulation and measurement part, and which physical effect it is."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from comparisons.missing_effect.catalogue import CATALOGUE as CATALOGUE
    from comparisons.missing_effect.catalogue import find_effect as find_effect
    from comparisons.missing_effect.diagnosis import diagnose as diagnose
    from comparisons.missing_effect.effect import Effect as Effect
    from comparisons.missing_effect.effect import Parameter as Parameter
    from comparisons.missing_effect.lag_result import LagDiagnosis as LagDiagnosis
    from comparisons.missing_effect.results import Diagnosis as Diagnosis
    from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE as SYSTEM_CATALOGUE
    from comparisons.missing_effect.systems.diagnosis import diagnose_model as diagnose_model
    from comparisons.missing_effect.systems.experiments import Experiment as Experiment
    from comparisons.missing_effect.systems.model import Model as Model
    from comparisons.missing_effect.systems.model import P as P
    from comparisons.missing_effect.systems.open_terms import open_effect as open_effect
    from comparisons.missing_effect.systems.places import SystemEffect as SystemEffect
    from comparisons.missing_effect.systems.results import SystemDiagnosis as SystemDiagnosis

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
__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    """Import what is asked for: the compiled engine is not needed by `--help`."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
