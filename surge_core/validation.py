"""Checks of parameters, each with one uniform sentence."""

from __future__ import annotations

import numpy as np

from surge_core.errors import InputError


def one_of(name: str, value: object, allowed: tuple[object, ...]) -> None:
    """Refuse a value that is not one of those allowed."""
    if value not in allowed:
        raise InputError(
            name, expected="one of " + ", ".join(repr(a) for a in allowed), found=repr(value)
        )


def positive(name: str, value: object) -> None:
    """Refuse a value that is not a positive, finite number."""
    if not isinstance(value, (int, float, np.number)) or not np.isfinite(value) or value <= 0:
        raise InputError(name, expected="a positive number", found=repr(value))


def whole_number(name: str, value: object, low: int, high: int) -> None:
    """Refuse a value that is not a whole number in [low, high]."""
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, np.integer))
        or not (low <= value <= high)
    ):
        raise InputError(name, expected=f"a whole number from {low} to {high}", found=repr(value))
