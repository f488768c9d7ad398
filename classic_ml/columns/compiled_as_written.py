"""Compilation of inner loops whose numbers must not depend on where a block of rows ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

__all__ = ["as_written"]


def as_written(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with every operation in the order in which it is written.

    Under ``fastmath`` sums are regrouped and products fused as suits
    the vector registers, which the last rows of a block do not fill: there a row's last bit
    would tell where its block ended.
    """
    try:
        machine: Callable[..., Any] = njit(cache=True, error_model="numpy")(function)
    except RuntimeError:
        machine = njit(error_model="numpy")(function)
    return machine
