"""Compilation of inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

__all__ = ["compiled"]

# No "nnan" and no "ninf": outliers must still come out as what they are.
FAST = {"reassoc", "contract", "nsz", "arcp"}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with an on-disk cache where some directory can be written, else without."""
    try:
        machine: Callable[..., Any] = njit(cache=True, fastmath=FAST, error_model="numpy")(function)
    except RuntimeError:
        machine = njit(fastmath=FAST, error_model="numpy")(function)
    return machine
