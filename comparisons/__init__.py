"""The harness that sets the estimators side by side, and the simulated rig they are tried on."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from comparisons.analysis import Analysis, analyse

__all__ = ["Analysis", "analyse"]


def __getattr__(name: str) -> object:
    """Import a public name when it is asked for: `--help` needs none of them."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("comparisons.analysis"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
