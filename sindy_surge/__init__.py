"""Sparse regression of the lag model, of surge loops and of any measured system, from arrays."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sindy_surge.discover.dynamics import SparseDynamics as SparseDynamics
    from sindy_surge.discover.loops import SurgeLoop as SurgeLoop
    from sindy_surge.discover.loops import discover_loop as discover_loop
    from sindy_surge.regressor import SparseLagRegressor as SparseLagRegressor
    from surge_core.errors import InputError as InputError
    from surge_core.fit_state import FitState as FitState

_HOMES = {
    "FitState": "surge_core.fit_state",
    "InputError": "surge_core.errors",
    "SparseDynamics": "sindy_surge.discover.dynamics",
    "SparseLagRegressor": "sindy_surge.regressor",
    "SurgeLoop": "sindy_surge.discover.loops",
    "discover_loop": "sindy_surge.discover.loops",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    # scikit-learn takes half a second to import; a command that only prints its help need not.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
