"""Sparse regression of the lag model: terms of ψ'_QS(φ) and τ from arrays of φ and ψ'."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sindy_surge.errors import InputError
    from sindy_surge.regressor import SparseLagRegressor
    from sindy_surge.states import FitState

__all__ = ["FitState", "InputError", "SparseLagRegressor"]

_HOMES = {
    "FitState": "sindy_surge.states",
    "InputError": "sindy_surge.errors",
    "SparseLagRegressor": "sindy_surge.regressor",
}


def __getattr__(name: str) -> Any:
    # scikit-learn takes half a second to import; a command that only prints its help need not.
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
