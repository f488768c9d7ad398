"""Sparse regression of the lag model, of surge loops and of any measured system, from arrays."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sindy_surge.discover.dynamics import SparseDynamics
    from sindy_surge.discover.loops import SurgeLoop, discover_loop
    from sindy_surge.regressor import SparseLagRegressor
    from surge_core.errors import InputError
    from surge_core.fit_state import FitState

__all__ = [
    "FitState",
    "InputError",
    "SparseDynamics",
    "SparseLagRegressor",
    "SurgeLoop",
    "discover_loop",
]


def __getattr__(name: str) -> Any:
    # scikit-learn takes half a second to import; a command that only prints its help need not.
    homes = {"FitState": "surge_core.fit_state", "InputError": "surge_core.errors"}
    homes["SparseLagRegressor"] = "sindy_surge.regressor"
    homes["SparseDynamics"] = "sindy_surge.discover.dynamics"
    if name in __all__:
        return getattr(import_module(homes.get(name, "sindy_surge.discover.loops")), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
