"""Compilation of inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

__all__ = ["compiled", "inlined"]

# No "nnan" and no "ninf": outliers must still come out as what they are.
FAST = {"reassoc", "contract", "nsz", "arcp"}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with an on-disk cache where some directory can be written, else without."""
    return _compiled(function, forceinline=False)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of every loop that calls it, whose bits shall not depend on the cache.

    Of a function that is called, a process that compiles has two versions, its own and that of its
    caller, and takes either for both; one that loads them from the disk has the latter alone. Sums
    are regrouped otherwise in the two.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: Callable[..., Any], *, forceinline: bool) -> Callable[..., Any]:
    options: dict[str, Any] = {"fastmath": FAST, "error_model": "numpy", "forceinline": forceinline}
    try:
        machine: Callable[..., Any] = njit(cache=True, **options)(function)
    except RuntimeError:
        machine = njit(**options)(function)
    return machine
